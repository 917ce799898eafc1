"""Districts: which of the map's administrative areas a point lies in."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from service.errors import UsageError
from service.recordings.files import write_whole
from service.roads.boundaries import areas_of, by_level
from service.roads.extract import Extract, Roads
from service.roads.protocol import NO_NAME, FloatArray, IntArray

LEVELS: Final = range(7, 11)
"""``admin_level`` of what people call a district: from parts of a county to parts of a town (OpenStreetMap's wiki)."""
COVERING_SHARE: Final = 0.5
"""Of the roads, that the areas of a level have to hold for the level to be taken; a choice."""
NEAR_BORDER_DEG: Final = 15.0 / 111_200.0
"""So near a border, as much as a street is wide, a point's own side does not tell the street's district."""
_STEP_DEG: Final = 20.0 / 111_200.0
"""Distance of the points by which a way's district is found."""


@dataclass(frozen=True, slots=True, eq=False)
class Districts:
    """Areas with their names; a point may be in none."""

    names: tuple[str, ...]
    areas: tuple[BaseGeometry, ...]
    level: int | None = None
    _tree: Any = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_tree", shapely.STRtree(self.areas))

    @classmethod
    def of(cls, extract: Extract, level: int | None = None) -> Districts:
        """The areas of a level, or of the deepest in ``LEVELS`` that covers the roads; raises UsageError for a level
        that the extract does not have."""
        levels = by_level(extract.boundaries)
        if level is not None and level not in levels:
            there = ", ".join(str(one) for one in sorted(levels)) or "none"
            raise UsageError(f"{extract.path}: no boundaries of admin_level {level}; it has {there}")
        asked = [level] if level is not None else [one for one in reversed(LEVELS) if one in levels]
        found = []
        for one in asked:
            areas = areas_of(extract, levels[one])
            named = [
                (boundary.name, areas[boundary.relation_id])
                for boundary in levels[one]
                if boundary.relation_id in areas
            ]
            found.append(cls(tuple(name for name, _ in named), tuple(area for _, area in named), one))
        chosen = next(
            (one for one in found if level is not None or one.share_of(extract.roads) >= COVERING_SHARE), None
        )
        return chosen or next((one for one in found if one.names), cls((), ()))

    def share_of(self, roads: Roads) -> float:
        """Share of the roads' nodes that lie in one of the areas."""
        return float(np.mean(self.within(roads.lon_lat_deg) != NO_NAME)) if self.names else 0.0

    def within(self, lon_lat_deg: FloatArray) -> IntArray:
        """Index of the area around each point (n, 2), ``NO_NAME`` where there is none; the first where several are."""
        found = np.full(len(lon_lat_deg), NO_NAME, np.int64)
        points, areas = self._tree.query(shapely.points(lon_lat_deg), predicate="intersects")
        order = np.lexsort((areas, points))[::-1]
        found[points[order]] = areas[order]
        return found

    def of_ways(self, roads: Roads) -> IntArray:
        """The district in which most of each way lies, by points laid along it."""
        lines = shapely.from_ragged_array(shapely.GeometryType.LINESTRING, roads.lon_lat_deg, (roads.first_node,))
        dense = shapely.segmentize(lines, _STEP_DEG)
        points, way = shapely.get_coordinates(dense, return_index=True)
        votes = np.zeros((roads.way_id.size, len(self.names) + 1), np.int32)
        np.add.at(votes, (way, self.within(points)), 1)  # NO_NAME is the last column
        best = np.argmax(votes, axis=1)
        return np.where(best == len(self.names), NO_NAME, best)

    def along(self, lon_lat_deg: FloatArray, district_of_way: IntArray) -> IntArray:
        """District of points on ways: near a border the way's own, so that a street along it does not flicker."""
        found = self.within(lon_lat_deg)
        known = district_of_way != NO_NAME
        if known.any():
            own = np.array(self.areas, dtype=object)[district_of_way[known]]
            near = shapely.dwithin(shapely.points(lon_lat_deg[known]), own, NEAR_BORDER_DEG)
            found[np.flatnonzero(known)[near]] = district_of_way[known][near]
        return found

    def write(self, path: Path) -> None:
        """As GeoJSON, so that it can be looked at."""
        features = [
            {"type": "Feature", "properties": {"name": name}, "geometry": json.loads(shapely.to_geojson(area))}
            for name, area in zip(self.names, self.areas, strict=True)
        ]
        document = {"type": "FeatureCollection", "admin_level": self.level, "features": features}
        write_whole(path, json.dumps(document, ensure_ascii=False).encode())

    @classmethod
    def read(cls, path: Path) -> Districts:
        """What ``write`` wrote."""
        document: Mapping[str, Any] = json.loads(path.read_text("utf-8"))
        features = document["features"]
        areas = tuple(shapely.from_geojson(json.dumps(one["geometry"])) for one in features)
        for area in areas:
            shapely.prepare(area)
        return cls(tuple(one["properties"]["name"] for one in features), areas, document["admin_level"])
