"""Reads an OpenStreetMap extract: its roads as columns, its boundaries and built-up land as geometry."""

from __future__ import annotations

import hashlib
import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
import osmium
import shapely
from shapely.geometry.base import BaseGeometry

from service.errors import UsageError
from service.roads.limits import CountryLimits, stated_limits, stated_surroundings
from service.roads.protocol import BoolArray, FloatArray, IntArray, RoadClass

HIGHWAYS: Final[Mapping[str, RoadClass]] = {
    **{f"{one.name.lower()}": one for one in RoadClass if one is not RoadClass.UNKNOWN},
    **{f"{one.name.lower()}_link": one for one in RoadClass if 1 <= one <= RoadClass.TERTIARY},
    "road": RoadClass.UNCLASSIFIED,
}
"""Values of ``highway`` that cars may drive on."""
BUILT_UP: Final = frozenset({"residential", "commercial", "retail", "industrial", "civil", "education"})
"""Values of ``landuse`` that make an area built up."""
Line = list[tuple[float, float] | None]
"""Longitude and latitude of a way's nodes, degrees; None for a node that the extract does not hold."""

_PASSES: Final = 4
_TELL_EVERY: Final = 20_000
_HASH_BLOCK: Final = 1 << 20


@dataclass(frozen=True, slots=True)
class Boundary:
    """An administrative boundary: its relation's facts, and the lines that the extract holds of it."""

    relation_id: int
    level: int
    name: str
    country: str | None
    lines: tuple[tuple[str, Line], ...]
    """Role and nodes of each member that is there."""
    complete: bool
    centre_ids: tuple[int, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Roads:
    """The roads of an extract, a row each by increasing id; limits are those that tags state, NaN without."""

    way_id: IntArray
    road_class: IntArray
    surroundings: IntArray
    motorroad: BoolArray
    tunnel: BoolArray
    limit_kmh: FloatArray
    """(n, 2): along the way's own direction, and against it."""
    name_index: IntArray
    names: tuple[str, ...]
    lon_lat_deg: FloatArray
    """(m, 2): the nodes of all ways, one way after the other."""
    first_node: IntArray
    """(n + 1,): where each way's nodes begin, and the end."""


@dataclass(frozen=True, slots=True, eq=False)
class Extract:
    """What is used of an extract."""

    path: Path
    sha256: str
    made: str | None
    """When its data were current, as the file says."""
    box_deg: tuple[float, float, float, float]
    """West, south, east, north: as the file says, or of its roads."""
    roads: Roads
    boundaries: tuple[Boundary, ...]
    places: Mapping[str, tuple[float, float]]
    """Longitude and latitude of places inside towns, and of whole ones, by name."""
    centres: Mapping[int, tuple[float, float]]
    built_up: tuple[BaseGeometry, ...]
    addressed_country: str | None
    """The country that most addresses name."""


def read_extract(path: Path, defaults: CountryLimits, tell: Callable[[float], None]) -> Extract:
    """Read an extract; ``tell`` hears the share that is done. Raises UsageError for a file that is none."""
    if not path.is_file():
        raise UsageError(f"{path}: no such file; expected an OpenStreetMap extract, EXTRACT.osm.pbf")
    try:
        return _Reader(path, defaults, tell).read()
    except (RuntimeError, OSError) as error:
        raise UsageError(
            f"{path}: cannot be read as an OpenStreetMap extract in PBF form ({error}); expected a whole .osm.pbf file"
        ) from error


@dataclass(slots=True)
class _Columns:
    """Rows of roads as they are read."""

    rows: list[tuple[int, int, int, bool, bool, float, float, int]] = field(default_factory=list)
    lines: list[list[tuple[float, float]]] = field(default_factory=list)
    names: dict[str, int] = field(default_factory=dict)

    def roads(self) -> Roads:
        order = sorted(range(len(self.rows)), key=lambda index: self.rows[index][0])
        table = np.array([self.rows[index] for index in order], dtype=np.float64).reshape(-1, 8)
        lines = [self.lines[index] for index in order]
        return Roads(
            way_id=np.array([self.rows[index][0] for index in order], np.int64),
            road_class=table[:, 1].astype(np.int64),
            surroundings=table[:, 2].astype(np.int64),
            motorroad=table[:, 3] > 0,
            tunnel=table[:, 4] > 0,
            limit_kmh=table[:, 5:7].copy(),
            name_index=table[:, 7].astype(np.int64),
            names=tuple(self.names),
            lon_lat_deg=np.array([node for line in lines for node in line], np.float64).reshape(-1, 2),
            first_node=np.concatenate([[0], np.cumsum([len(line) for line in lines])]).astype(np.int64),
        )


class _Reader:
    def __init__(self, path: Path, defaults: CountryLimits, tell: Callable[[float], None]) -> None:
        self._path = path
        self._file = osmium.io.File(str(path), "pbf")
        self._defaults = defaults
        self._tell = tell
        self._columns = _Columns()
        self._built_up: list[BaseGeometry] = []
        self._places: dict[str, tuple[float, float]] = {}
        self._countries: Counter[str] = Counter()

    def read(self) -> Extract:
        digest = self._digest()
        with osmium.io.Reader(self._file, osmium.osm.NOTHING) as reader:
            header = reader.header()
        self._tell(1 / _PASSES)
        relations = list(self._relations())
        self._tell(2 / _PASSES)
        self._read_ways_and_nodes()
        self._tell(3 / _PASSES)
        lines = self._lines({ref for _, members, _ in relations for _, ref in members})
        centres = self._centres({ref for *_, refs in relations for ref in refs})
        roads = self._columns.roads()
        if roads.way_id.size == 0:
            raise UsageError(f"{self._path}: holds no roads for cars with their places; expected a map's extract")
        west, south = roads.lon_lat_deg.min(axis=0)
        east, north = roads.lon_lat_deg.max(axis=0)
        box = header.box()
        if box.valid() and box.size() < 360.0 * 180.0 - 1.0:
            west, south = box.bottom_left.lon, box.bottom_left.lat
            east, north = box.top_right.lon, box.top_right.lat
        self._tell(1.0)
        return Extract(
            path=self._path,
            sha256=digest,
            made=header.get("osmosis_replication_timestamp") or None,
            box_deg=(float(west), float(south), float(east), float(north)),
            roads=roads,
            boundaries=tuple(_boundary(tags, members, centre, lines) for tags, members, centre in relations),
            places=self._places,
            centres=centres,
            built_up=tuple(self._built_up),
            addressed_country=self._countries.most_common(1)[0][0] if self._countries else None,
        )

    def _digest(self) -> str:
        digest = hashlib.sha256()
        with self._path.open("rb") as file:
            while block := file.read(_HASH_BLOCK):
                digest.update(block)
        return digest.hexdigest()

    def _relations(self) -> Iterator[tuple[dict[str, str], list[tuple[str, int]], tuple[int, ...]]]:
        wanted = osmium.filter.TagFilter(("boundary", "administrative"))
        for one in osmium.FileProcessor(self._file, osmium.osm.RELATION).with_filter(wanted):
            tags = {tag.k: tag.v for tag in one.tags}
            if tags.get("admin_level", "").isdigit() and "name" in tags:
                tags["id"] = str(one.id)
                members = [(member.role, member.ref) for member in one.members if member.type == "w"]
                nodes = [member for member in one.members if member.type == "n"]
                yield tags, members, tuple(node.ref for node in nodes if node.role in ("label", "admin_centre"))

    def _read_ways_and_nodes(self) -> None:
        wanted = osmium.filter.KeyFilter("highway", "landuse", "place", "addr:country")
        entities = osmium.osm.NODE | osmium.osm.WAY
        for count, one in enumerate(osmium.FileProcessor(self._file, entities).with_locations().with_filter(wanted)):
            if count % _TELL_EVERY == 0:  # how many there are is not known: ever slower toward the next quarter
                self._tell((3 - math.exp(-count / 1e6)) / _PASSES)
            tags = one.tags
            if country := tags.get("addr:country"):
                self._countries[country.upper()] += 1
            if one.is_node():
                if "place" in tags and "name" in tags:
                    self._places.setdefault(tags["name"], (one.location.lon, one.location.lat))
            elif tags.get("highway") in HIGHWAYS and tags.get("area") != "yes":
                self._add_road(one)
            elif tags.get("landuse") in BUILT_UP:
                self._add_built_up(one)

    def _add_road(self, way: Any) -> None:
        line = [node for node in _nodes(way) if node is not None]
        if len(line) < 2:
            return
        tags = {tag.k: tag.v for tag in way.tags}
        name = tags.get("name") or tags.get("ref")
        index = -1 if name is None else self._columns.names.setdefault(name, len(self._columns.names))
        forward, backward = stated_limits(tags, self._defaults)
        self._columns.lines.append(line)
        self._columns.rows.append(
            (
                way.id,
                int(HIGHWAYS[tags["highway"]]),
                int(stated_surroundings(tags)),
                tags.get("motorroad") == "yes",
                tags.get("tunnel", "no") != "no",
                forward,
                backward,
                index,
            )
        )

    def _add_built_up(self, way: Any) -> None:
        line = [node for node in _nodes(way) if node is not None]
        if len(line) >= 4 and line[0] == line[-1]:
            self._built_up.append(shapely.make_valid(shapely.Polygon(line)))

    def _lines(self, ids: set[int]) -> dict[int, Line]:
        if not ids:
            return {}
        ways = (
            osmium.FileProcessor(self._file, osmium.osm.NODE | osmium.osm.WAY)
            .with_locations()
            .with_filter(osmium.filter.EntityFilter(osmium.osm.WAY))
            .with_filter(osmium.filter.IdFilter(ids))
        )
        return {way.id: _nodes(way) for way in ways}

    def _centres(self, ids: set[int]) -> dict[int, tuple[float, float]]:
        if not ids:
            return {}
        nodes = osmium.FileProcessor(self._file, osmium.osm.NODE).with_filter(osmium.filter.IdFilter(ids))
        return {node.id: (node.location.lon, node.location.lat) for node in nodes}


def _nodes(way: Any) -> Line:
    return [(node.lon, node.lat) if node.location.valid() else None for node in way.nodes]


def _boundary(
    tags: Mapping[str, str], members: list[tuple[str, int]], centre: tuple[int, ...], lines: Mapping[int, Line]
) -> Boundary:
    there = tuple((role, lines[ref]) for role, ref in members if ref in lines)
    whole = len(there) == len(members) > 0 and all(None not in line for _, line in there)
    country = next((tags[key] for key in ("ISO3166-1", "ISO3166-1:alpha2", "country_code") if key in tags), "").upper()
    return Boundary(
        relation_id=int(tags["id"]),
        level=int(tags["admin_level"]),
        name=tags["name"],
        country=country if tags["admin_level"] == "2" and len(country) == 2 else None,
        lines=there,
        complete=whole,
        centre_ids=centre,
    )
