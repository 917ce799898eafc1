"""Prepares an OpenStreetMap extract for matching: tiles, ways with their limits, districts; whole or not at all."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Final

import numpy as np
import shapely

from service.errors import UsageError
from service.roads.boundaries import areas_of
from service.roads.districts import Districts
from service.roads.extract import Extract, read_extract
from service.roads.folder import FORMAT, Manifest, RoadFolder
from service.roads.limits import CountryLimits, assumed_rule
from service.roads.network import RoadNetwork
from service.roads.own_districts import read_districts
from service.roads.protocol import BoolArray, Certainty, FloatArray, IntArray, RoadClass, Surroundings
from service.roads.surroundings import middles, surroundings_of
from service.roads.tiles import build_tiles, version

Tell = Callable[[str, float, float], None]
"""Hears a step's name, how far it is, and how far it goes."""
_COUNTRY_LEVEL: Final = 2


def build(
    path: Path,
    out: Path,
    tell: Tell,
    *,
    limits: Path | None = None,
    country: str | None = None,
    district_level: int | None = None,
    own_districts: Path | None = None,
) -> Manifest:
    """Build ``out`` from an extract; a folder of roads that is there is replaced once the new one is whole.

    ``country`` holds for roads outside the countries whose borders the extract has. ``own_districts`` is a file of
    polygons that are the districts instead of the map's. Raises UsageError.
    """
    if out.exists() and not (out.is_dir() and (RoadFolder(out).is_built() or not any(out.iterdir()))):
        raise UsageError(f"{out}: is there and holds no built roads; choose a new or an empty folder")
    defaults = CountryLimits.read(limits)
    if country is not None and country not in defaults.by_country:
        known = " ".join(sorted(defaults.by_country))
        raise UsageError(f"country {country}: no default limits; expected one of {known}, or a table by --limits")
    own = None if own_districts is None else read_districts(own_districts)
    extract = read_extract(path, defaults, lambda share: tell("reading", 100.0 * share, 100.0))
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=f".{out.name}.", dir=out.parent) as scratch:
            made = RoadFolder(Path(scratch) / "roads")
            made.path.mkdir()
            tell("limits and districts", 0.0, 1.0)
            manifest = _write_ways(extract, made, defaults, country, own or Districts.of(extract, district_level))
            tell("building tiles", 0.0, 1.0)
            build_tiles(path, made.tiles, Path(scratch))
            made.write_manifest(manifest)
            tell("building tiles", 1.0, 1.0)
            if out.exists():
                out.rename(Path(scratch) / "before")
            made.path.rename(out)
    except OSError as error:
        raise UsageError(f"{out}: cannot be written: {error.strerror or error}") from error
    return manifest


def _write_ways(
    extract: Extract, made: RoadFolder, defaults: CountryLimits, country: str | None, districts: Districts
) -> Manifest:
    roads = extract.roads
    surroundings = surroundings_of(extract)
    countries, country_of_way = countries_of(extract, country)
    limit_kmh, certainty = settled_limits(extract, surroundings, countries, country_of_way, defaults)
    low = np.minimum.reduceat(roads.lon_lat_deg, roads.first_node[:-1])
    high = np.maximum.reduceat(roads.lon_lat_deg, roads.first_node[:-1])
    RoadNetwork(
        way_id=roads.way_id,
        road_class=roads.road_class,
        surroundings=surroundings,
        limit_kmh=limit_kmh,
        limit_certainty=certainty,
        tunnel=roads.tunnel,
        name_index=roads.name_index,
        district_index=districts.of_ways(roads),
        lon_lat_deg=roads.lon_lat_deg,
        first_node=roads.first_node,
        bounds_deg=np.hstack([low, high]),
        names=roads.names,
    ).write(made.ways)
    districts.write(made.districts)
    return Manifest(
        format=FORMAT,
        extract=extract.path.name,
        extract_sha256=extract.sha256,
        extract_made=extract.made,
        box_deg=extract.box_deg,
        countries=countries,
        ways=int(roads.way_id.size),
        ways_with_stated_limit=int(np.sum((certainty == Certainty.TAGGED).any(axis=1))),
        ways_with_assumed_limit=int(np.sum((certainty == Certainty.ASSUMED).any(axis=1))),
        district_level=districts.level,
        districts=len(set(districts.names)),
        valhalla=version(),
    )


def countries_of(extract: Extract, fallback: str | None) -> tuple[tuple[str, ...], IntArray]:
    """The countries of the extract, and of each way the index of its own, -1 where it is not known.

    By the borders that it has; outside them ``fallback``; and without any, the country that most addresses name.
    """
    nations = [one for one in extract.boundaries if one.level == _COUNTRY_LEVEL]
    areas = areas_of(extract, nations)
    named = [(one.country, areas[one.relation_id]) for one in nations if one.country and one.relation_id in areas]
    elsewhere = fallback or (None if named else extract.addressed_country)
    countries = tuple(dict.fromkeys([code for code, _ in named if code] + ([elsewhere] if elsewhere else [])))
    index = np.full(extract.roads.way_id.size, countries.index(elsewhere) if elsewhere else -1, np.int64)
    points = shapely.points(middles(extract.roads))
    for code, area in named:
        if code:
            shapely.prepare(area)
            index[shapely.intersects(area, points)] = countries.index(code)
    return countries, index


def settled_limits(
    extract: Extract,
    surroundings: IntArray,
    countries: tuple[str, ...],
    country_of_way: IntArray,
    defaults: CountryLimits,
) -> tuple[FloatArray, IntArray]:
    """Limits (n, 2) as stated, else by the country's rule for the kind of road, and how each is known."""
    roads = extract.roads
    assumed = np.full(roads.way_id.size, np.nan)
    for road_class in RoadClass:
        for lies in Surroundings:
            for motorroad in (False, True):
                if (rule := assumed_rule(road_class, motorroad, lies)) is None:
                    continue
                kind: BoolArray = (
                    (roads.road_class == road_class) & (surroundings == lies) & (roads.motorroad == motorroad)
                )
                for index, code in enumerate(countries):
                    assumed[kind & (country_of_way == index)] = defaults.of(code, rule)
    stated = ~np.isnan(roads.limit_kmh)
    limit_kmh = np.where(stated, roads.limit_kmh, assumed[:, None])
    certainty = np.where(stated, int(Certainty.TAGGED), int(Certainty.ASSUMED))
    certainty[np.isnan(limit_kmh)] = int(Certainty.UNKNOWN)
    return limit_kmh, certainty
