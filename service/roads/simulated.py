"""Simulated drives on the real streets of built roads: a route of Valhalla's, driven, with its ways as the truth."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from core.earth import horizontal_distance_m
from core.simulation.scenarios import Scenario, SimulatedDrive, check_asked, perform
from core.simulation.street_route import StreetDrive, StreetPath, drive_streets
from service.errors import UsageError
from service.roads import extra
from service.roads.districts import Districts
from service.roads.folder import ATTRIBUTION, RoadFolder
from service.roads.network import RoadNetwork
from service.roads.protocol import NO_NAME, BoolArray, Certainty, FloatArray, IntArray, RoadClass
from service.roads.tiles import NOT_FOUND, actor, decoded

DURATION_S: Final = 600.0
OUTAGE_S: Final = 60.0
_OUTAGES_AT: Final = (0.3, 0.65)
"""Where in the drive they begin."""
_SHORTEST_FOR_OUTAGES_S: Final = 300.0

LANE_M: Final = 1.7
"""From the line of a road with two directions to the middle of the lane: half of 3.4 m; a choice."""
LEFT_HAND: Final = frozenset({"GB", "IE", "MT", "CY", "JP", "AU", "NZ", "IN", "ZA", "TH", "SG", "HK", "KE"})
_NO_LIMIT_KMH: Final = 130.0
_UNKNOWN_LIMIT_KMH: Final = 50.0
_REVERSAL_DEG: Final = 140.0
"""A route that turns back on itself more sharply is given up there."""
_SAME_PLACE_M: Final = 1.0
_TRIES: Final = 25
_LEGS: Final = 2000
_EDGE: Final = (
    "shape",
    "edge.way_id",
    "edge.forward",
    "edge.traversability",
    "edge.begin_shape_index",
    "edge.end_shape_index",
    "node.intersecting_edge.driveability",
)


@dataclass(frozen=True, slots=True, eq=False)
class _Drawn:
    """A route: its points (n, 2) longitude and latitude, and of each of its n - 1 pieces the way and the direction."""

    lon_lat_deg: FloatArray
    row: IntArray
    forward: BoolArray
    both_ways: BoolArray
    junction: BoolArray

    def cut(self, first: int, last: int) -> _Drawn:
        """From one of its points to another."""
        pieces = slice(first, last)
        return _Drawn(
            self.lon_lat_deg[first : last + 1],
            self.row[pieces],
            self.forward[pieces],
            self.both_ways[pieces],
            self.junction[first : last + 1],
        )


def simulate_on_roads(
    folder: Path, seed: int = 1, duration_s: float | None = None, rate_hz: float = 200.0, draw: int = 0
) -> SimulatedDrive:
    """Simulate a drive on built roads; its truth holds, for each second, the way under the car.

    Raises UsageError for a folder that is none, or roads that are too few for so long a drive.
    """
    extra.require()
    length_s = DURATION_S if duration_s is None else duration_s
    check_asked(seed, draw, length_s)
    roads = _StreetRoutes(folder)
    rng = np.random.default_rng([seed, 0])
    drawn = roads.draw(rng, length_s)
    path = roads.path_of(drawn)
    streets = drive_streets(path, rng, length_s, _outages(length_s))
    scenario = Scenario(
        "streets of an OpenStreetMap extract", lambda _, __: streets.route, length_s, place=streets.place
    )
    simulated = perform("streets", scenario, seed, length_s, rate_hz, draw)
    return replace(simulated, truth={**simulated.truth, "roads": roads.truth_of(drawn, streets, simulated)})


def _outages(duration_s: float) -> tuple[tuple[float, float], ...]:
    if duration_s < _SHORTEST_FOR_OUTAGES_S:
        return ()
    return tuple((round(share * duration_s), round(share * duration_s) + OUTAGE_S) for share in _OUTAGES_AT)


class _StreetRoutes:
    def __init__(self, folder: Path) -> None:
        built = RoadFolder(folder)
        self._folder = folder
        self._manifest = built.manifest()
        self._network = RoadNetwork.read(built.ways)
        self._districts = Districts.read(built.districts)
        self._actor = actor(built.tiles, 4.0)

    def draw(self, rng: np.random.Generator, duration_s: float) -> _Drawn:
        """A route that takes at least so long at the limits, through places drawn by length of street."""
        place = self._places(rng)
        best_s = 0.0
        for _ in range(_TRIES):
            drawn = self._leg(place(), place())
            for _ in range(_LEGS):
                if drawn is None:
                    break
                lasts_s = float(np.sum(_lengths_m(drawn) / self._limits_mps(drawn)))
                best_s = max(best_s, lasts_s)
                if lasts_s >= duration_s:
                    return drawn
                drawn = self._longer(drawn, place)
        raise UsageError(
            f"{self._folder}: no route of {duration_s:g} s was found, the longest takes {best_s:.0f} s;"
            " give a shorter --duration or a larger extract"
        )

    def path_of(self, drawn: _Drawn) -> StreetPath:
        """As the simulation takes it."""
        side = -1.0 if LEFT_HAND & set(self._manifest.countries) else 1.0
        lon, lat = np.radians(drawn.lon_lat_deg).T
        return StreetPath(
            lat_rad=lat,
            lon_rad=lon,
            limit_mps=self._limits_mps(drawn),
            lane_m=np.where(drawn.both_ways, side * LANE_M, 0.0),
            tunnel=np.asarray(self._network.tunnel[drawn.row]),
            junction=drawn.junction,
        )

    def truth_of(self, drawn: _Drawn, streets: StreetDrive, simulated: SimulatedDrive) -> dict[str, Any]:
        """The way under the car at each second, with what is known of it, in columns."""
        network, track = self._network, simulated.trajectory
        t_s = np.arange(math.floor(float(track.t_s[-1])) + 1.0)
        piece = streets.piece[np.searchsorted(streets.piece_t_s, t_s, side="right") - 1]
        row, direction = drawn.row[piece], np.where(drawn.forward[piece], 0, 1)
        place = np.degrees([np.interp(t_s, track.t_s, one) for one in (track.lon_rad, track.lat_rad)]).T
        district = self._districts.along(place, network.district_index[row])
        limit = network.limit_kmh[row, direction]
        return {
            "extract": self._manifest.extract,
            "extract_sha256": self._manifest.extract_sha256,
            "attribution": ATTRIBUTION,
            "t_s": t_s.tolist(),
            "way_id": network.way_id[row].tolist(),
            "street": [None if one == NO_NAME else network.names[one] for one in network.name_index[row]],
            "road_class": [RoadClass(one).name.lower() for one in network.road_class[row]],
            "limit_kmh": [one if math.isfinite(one) else None for one in limit.tolist()],
            "limit_certainty": [Certainty(one).name.lower() for one in network.limit_certainty[row, direction]],
            "district": [None if one == NO_NAME else self._districts.names[one] for one in district],
            "tunnel": network.tunnel[row].tolist(),
        }

    def _places(self, rng: np.random.Generator) -> Callable[[], dict[str, Any]]:
        """Draws places on the extract's streets, each piece of street as likely as it is long."""
        network = self._network
        way = np.repeat(np.arange(network.way_id.size), np.diff(network.first_node))
        start, end = network.lon_lat_deg[:-1], network.lon_lat_deg[1:]
        west, south, east, north = self._manifest.box_deg
        inside = ((start > [west, south]) & (start < [east, north])).all(axis=1)
        usual = (network.road_class > RoadClass.UNKNOWN) & (network.road_class <= RoadClass.LIVING_STREET)
        length = horizontal_distance_m(*np.radians([start[:, 1], start[:, 0], end[:, 1], end[:, 0]]))
        weight = length * (inside & (way[:-1] == way[1:]) & usual[way[:-1]])
        if not weight.sum() > 0.0:
            raise UsageError(f"{self._folder}: holds no streets to drive on")
        up_to = np.cumsum(weight) / weight.sum()

        def place() -> dict[str, Any]:
            piece = min(int(np.searchsorted(up_to, rng.random(), side="right")), length.size - 1)
            lon, lat = start[piece] + rng.random() * (end[piece] - start[piece])
            return {"lat": float(lat), "lon": float(lon)}

        return place

    def _leg(self, start: dict[str, Any], end: dict[str, Any]) -> _Drawn | None:
        """A route from one place to another, up to where it turns back; None where Valhalla finds none."""
        auto = {"use_ferry": 0.0, "use_tracks": 0.0, "service_penalty": 120.0}
        common = {"costing": "auto", "costing_options": {"auto": auto}}
        try:
            told = self._actor.route({"locations": [start, end], **common})
            walked = self._actor.trace_attributes(
                {
                    "encoded_polyline": told["trip"]["legs"][0]["shape"],
                    "shape_match": "edge_walk",
                    "filters": {"attributes": _EDGE, "action": "include"},
                    **common,
                }
            )
        except NOT_FOUND:
            return None
        drawn = self._drawn(walked)
        return None if drawn is None else _before_reversal(_joined([drawn]))

    def _longer(self, drawn: _Drawn, place: Callable[[], dict[str, Any]]) -> _Drawn | None:
        """The route with a leg that begins at its last point, in its direction; None where none is found."""
        (lon0, lat0), (lon1, lat1) = drawn.lon_lat_deg[-2:]
        heading = math.degrees(math.atan2((lon1 - lon0) * math.cos(math.radians(lat1)), lat1 - lat0)) % 360.0
        start = {"lat": float(lat1), "lon": float(lon1), "heading": round(heading), "heading_tolerance": 30}
        for _ in range(_TRIES):
            leg = self._leg(start, place())
            # Where no road goes on in its direction, Valhalla begins on another one near by.
            if leg is not None and _apart_m(drawn.lon_lat_deg[-1], leg.lon_lat_deg[0]) < _SAME_PLACE_M:
                kept = _before_reversal(_joined([drawn, leg]))
                if len(kept.lon_lat_deg) >= len(drawn.lon_lat_deg) + len(leg.lon_lat_deg) - 2:
                    return kept
        return None

    def _drawn(self, walked: dict[str, Any]) -> _Drawn | None:
        points = decoded(walked["shape"])
        n = len(points)
        row, forward = np.full(n - 1, NO_NAME, np.int64), np.ones(n - 1, np.bool_)
        both_ways, junction = np.ones(n - 1, np.bool_), np.zeros(n, np.bool_)
        rows = self._network.rows_of(np.array([edge["way_id"] for edge in walked["edges"]], np.int64))
        for edge, which in zip(walked["edges"], rows, strict=True):
            pieces = slice(edge["begin_shape_index"], edge["end_shape_index"])
            row[pieces], forward[pieces] = which, edge["forward"]
            both_ways[pieces] = edge["traversability"] == "both"
            others = edge.get("end_node", {}).get("intersecting_edges", ())
            junction[edge["end_shape_index"]] = any(one.get("driveability", "none") != "none" for one in others)
        if (row == NO_NAME).any():
            return None
        return _Drawn(points, row, forward, both_ways, junction)

    def _limits_mps(self, drawn: _Drawn) -> FloatArray:
        limit = self._network.limit_kmh[drawn.row, np.where(drawn.forward, 0, 1)]
        return np.nan_to_num(np.minimum(limit, _NO_LIMIT_KMH), nan=_UNKNOWN_LIMIT_KMH) / 3.6


def _apart_m(one_deg: FloatArray, other_deg: FloatArray) -> float:
    (lon_a, lat_a), (lon_b, lat_b) = np.radians([one_deg, other_deg])
    return float(horizontal_distance_m(lat_a, lon_a, lat_b, lon_b))


def _lengths_m(drawn: _Drawn) -> FloatArray:
    lon, lat = np.radians(drawn.lon_lat_deg).T
    return horizontal_distance_m(lat[:-1], lon[:-1], lat[1:], lon[1:])


def _joined(legs: list[_Drawn]) -> _Drawn:
    """One leg after the other, without pieces of no length."""
    first, *others = legs

    def pieces(name: str) -> Any:
        """What is said of each piece; that from one leg to the next is as the next one's first."""
        more = [part for leg in others for part in (getattr(leg, name)[:1], getattr(leg, name))]
        return np.concatenate([getattr(first, name), *more])

    drawn = _Drawn(
        np.vstack([one.lon_lat_deg for one in legs]),
        pieces("row"),
        pieces("forward"),
        pieces("both_ways"),
        np.concatenate([one.junction for one in legs]),
    )
    kept = _lengths_m(drawn) > 0.05
    points = np.concatenate([[True], kept])
    return _Drawn(
        drawn.lon_lat_deg[points], drawn.row[kept], drawn.forward[kept], drawn.both_ways[kept], drawn.junction[points]
    )


def _before_reversal(drawn: _Drawn) -> _Drawn:
    step = np.diff(drawn.lon_lat_deg, axis=0) * [np.cos(np.radians(drawn.lon_lat_deg[0, 1])), 1.0]
    heading = np.degrees(np.arctan2(step[:, 0], step[:, 1]))
    turned = np.abs((np.diff(heading) + 180.0) % 360.0 - 180.0)
    back = np.flatnonzero(turned > _REVERSAL_DEG)
    return drawn.cut(0, int(back[0]) + 1) if back.size else drawn
