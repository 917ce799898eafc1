"""Matches one stretch of a drive to the roads of a folder; runs in a process of its own."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np

from service.roads.candidates import Candidates, candidates, confidence
from service.roads.districts import Districts
from service.roads.folder import RoadFolder
from service.roads.network import RoadNetwork
from service.roads.path import MatchedPath
from service.roads.protocol import (
    NO_NAME,
    NO_WAY,
    BoolArray,
    Certainty,
    FloatArray,
    IntArray,
    MatchedPoints,
    RoadClass,
    RoadPlace,
    Surroundings,
)
from service.roads.segments import ROAD_SD_M, Frame, Segments
from service.roads.tiles import FARTHEST_M, NOT_FOUND, actor

SPREADS_M: Final = (4.0, 8.0, 16.0, 32.0)
"""Spreads of positions that the matcher is set up for; a stretch is matched by the one that fits it."""
RADIUS_SD: Final = 3.0
_RADIUS_M: Final = (25.0, FARTHEST_M)
_ATTRIBUTES: Final = (
    "shape",
    "edge.begin_shape_index",
    "edge.end_shape_index",
    "edge.way_id",
    "edge.forward",
    "matched.type",
    "matched.edge_index",
)


class Tracer:
    """The roads of a folder, opened."""

    def __init__(self, folder: Path) -> None:
        self._folder = RoadFolder(folder)
        self._folder.manifest()
        self._actors: dict[float, Any] = {}

    @cached_property
    def network(self) -> RoadNetwork:
        """The ways."""
        return RoadNetwork.read(self._folder.ways)

    @cached_property
    def districts(self) -> Districts:
        """The districts."""
        return Districts.read(self._folder.districts)

    def match(
        self, t_ns: IntArray, lat_deg: FloatArray, lon_deg: FloatArray, sd_m: FloatArray, heading_deg: FloatArray
    ) -> MatchedPoints:
        """The roads under a stretch of some minutes; every position is finite."""
        place = np.column_stack([lon_deg, lat_deg])
        near = candidates(self.network, place, sd_m[:, None, None] ** 2 * np.eye(2), heading_deg)
        if t_ns.size == 1:  # is no trace
            row, forward, on_road, distance = self._likeliest(near, heading_deg)
        else:
            row, forward, on_road, distance = self._trace(t_ns, place, sd_m, heading_deg)
        return self._told(place, row, forward, on_road, distance, confidence(self.network, near, row))

    def place(self, lon_lat_deg: FloatArray, covariance_en_m2: FloatArray, heading_deg: float) -> RoadPlace:
        """The likeliest road at one place; its covariance is of east and north, the heading NaN if not known."""
        place = lon_lat_deg.reshape(1, 2)
        near = candidates(self.network, place, covariance_en_m2.reshape(1, 2, 2), np.array([heading_deg]))
        row, forward, on_road, distance = self._likeliest(near, np.array([heading_deg]))
        return RoadPlace.of(self._told(place, row, forward, on_road, distance, confidence(self.network, near, row)), 0)

    def _likeliest(
        self, near: Candidates, heading_deg: FloatArray
    ) -> tuple[IntArray, BoolArray, FloatArray, FloatArray]:
        """Of one point what ``_trace`` says of many: the candidate of most weight."""
        row, forward = np.array([NO_NAME]), np.array([True])
        on_road, distance = np.full((1, 2), np.nan), np.array([np.nan])
        if near.row.size:
            best = int(np.argmax(near.weight))
            row[0], on_road[0], distance[0] = near.row[best], near.lon_lat_deg[best], near.distance_m[best]
            forward[0] = self._goes_forward(int(row[0]), on_road[0], float(heading_deg[0]))
        return row, forward, on_road, distance

    def _trace(
        self, t_ns: IntArray, place: FloatArray, sd_m: FloatArray, heading_deg: FloatArray
    ) -> tuple[IntArray, BoolArray, FloatArray, FloatArray]:
        """Of each point the row of its way, whether it is driven forward, the point on it, and how far that is."""
        n = t_ns.size
        row, forward = np.full(n, NO_NAME, np.int64), np.ones(n, np.bool_)
        on_road, distance = np.full((n, 2), np.nan), np.full(n, np.nan)
        radius = np.clip(RADIUS_SD * np.hypot(sd_m, ROAD_SD_M), *_RADIUS_M)
        shape = [
            {"lat": lat, "lon": lon, "time": t, "accuracy": accuracy, "radius": reach}
            for lon, lat, t, accuracy, reach in zip(
                *place.T.tolist(),
                ((t_ns - t_ns[0]) / 1e9).tolist(),
                np.minimum(sd_m, FARTHEST_M).tolist(),
                radius.tolist(),
                strict=True,
            )
        ]
        request = {
            "shape": shape,
            "costing": "auto",
            "shape_match": "map_snap",
            "filters": {"attributes": _ATTRIBUTES, "action": "include"},
        }
        try:
            told = self._actor(float(np.sqrt(np.mean(np.hypot(sd_m, ROAD_SD_M) ** 2)))).trace_attributes(request)
        except NOT_FOUND:  # no road there, or no way from one to the next
            return row, forward, on_road, distance
        path = MatchedPath.of(told, place)
        rows = self.network.rows_of(np.array([edge["way_id"] for edge in told["edges"]], np.int64))
        along = np.array([edge["forward"] for edge in told["edges"]])
        on = path.edge != NO_NAME
        edge, on_road[on], distance[on] = path.nearest(np.flatnonzero(on), sd_m, heading_deg)
        row[on], forward[on] = rows[edge], along[edge]
        return row, forward, on_road, distance

    def _actor(self, spread_m: float) -> Any:
        spread = min(SPREADS_M, key=lambda one: abs(np.log(one / spread_m)))
        if spread not in self._actors:
            self._actors[spread] = actor(self._folder.tiles, spread)
        return self._actors[spread]

    def _goes_forward(self, row: int, on_road: FloatArray, heading_deg: float) -> bool:
        """Whether a heading goes along the way's own direction, by the piece nearest to a point on it."""
        nodes, first, last = self.network.nodes_of(np.array([row]))
        frame = Frame.about(on_road[None])
        pieces = Segments.of(frame.metres(nodes), first, last)
        every = np.arange(pieces.line.size)
        nearest = int(np.argmin(np.hypot(*pieces.projected(np.zeros((every.size, 2)), every).T)))
        east, north = pieces.end[nearest] - pieces.start[nearest]
        heading = np.radians(heading_deg)
        return bool(np.isnan(heading) or east * np.sin(heading) + north * np.cos(heading) >= 0.0)

    def _told(
        self,
        place: FloatArray,
        row: IntArray,
        forward: BoolArray,
        on_road: FloatArray,
        distance: FloatArray,
        sure: FloatArray,
    ) -> MatchedPoints:
        network, known = self.network, row != NO_NAME
        on_road, distance = np.where(known[:, None], on_road, np.nan), np.where(known, distance, np.nan)
        district_of_way = np.where(known, network.district_index[row], NO_NAME)
        district = self.districts.along(np.where(known[:, None], on_road, place), district_of_way)
        street_index, streets = _used(np.where(known, network.name_index[row], NO_NAME), network.names)
        district_index, districts = _used(district, self.districts.names)
        direction = np.where(forward, 0, 1)
        return MatchedPoints(
            way_id=np.where(known, network.way_id[row], NO_WAY),
            lat_deg=on_road[:, 1],
            lon_deg=on_road[:, 0],
            distance_m=distance,
            confidence=sure,
            road_class=np.where(known, network.road_class[row], int(RoadClass.UNKNOWN)),
            surroundings=np.where(known, network.surroundings[row], int(Surroundings.UNKNOWN)),
            limit_kmh=np.where(known, network.limit_kmh[row, direction], np.nan),
            limit_certainty=np.where(known, network.limit_certainty[row, direction], int(Certainty.UNKNOWN)),
            tunnel=known & network.tunnel[row],
            street_index=street_index,
            district_index=district_index,
            failed=np.zeros(known.size, np.bool_),
            streets=streets,
            districts=districts,
        )


def _used(index: IntArray, names: tuple[str, ...]) -> tuple[IntArray, tuple[str, ...]]:
    """The index into only those names that occur."""
    used = np.unique(index[index != NO_NAME])
    return np.where(index == NO_NAME, NO_NAME, np.searchsorted(used, index)), tuple(names[one] for one in used)
