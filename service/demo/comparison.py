"""What the service found beside what really happened: pure functions of both."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from core.earth import radii_m
from core.measurements import FloatArray, TimeArray
from schemas.times import parse_time
from service.recordings.drive_folder import Drive

SAME_ACCIDENT_S: Final = 5.0
"""An accident found within this time of a true one is that one."""

FOUND_WITHIN_M: Final = 15.0
"""How near its place must be (the project's promise for a tunnel, 20 s in)."""


@dataclass(frozen=True, slots=True)
class Crash:
    """A true accident with what was found of it; errors are None where nothing was."""

    vehicle_id: str
    t_s: float
    in_outage: bool
    true_severity: str
    found: Mapping[str, Any] | None
    position_error_m: float | None = None
    position_sd_m: float | None = None
    delta_v_error_mps: float | None = None
    alert_latency_ms: float | None = None


@dataclass(frozen=True, slots=True)
class Tunnel:
    """A stretch without GNSS: the greatest error of the fused track in it, and up to the first crash in it."""

    vehicle_id: str
    start_s: float
    duration_s: float
    max_error_m: float
    max_error_before_crash_m: float


def compare_accidents(
    vehicle_id: str, drive: Drive, found: Sequence[Mapping[str, Any]], alert_ns: Mapping[str, int]
) -> tuple[list[Crash], list[Mapping[str, Any]]]:
    """True accidents with what was found of each, and what was found of none.

    ``found`` are GeoJSON features of ``/v1/accidents``; ``alert_ns`` when the alert of an accident id arrived.
    """
    left = list(found)
    crashes = []
    for truth in _truth(drive, "accidents"):
        t_ns = drive.start_t_ns + round(truth["t_s"] * 1e9)
        near = [one for one in left if abs(_impact_ns(one) - t_ns) <= SAME_ACCIDENT_S * 1e9]
        match = min(near, key=lambda one: abs(_impact_ns(one) - t_ns), default=None)
        if match is not None:
            left.remove(match)
        crashes.append(_crash(vehicle_id, truth, match, alert_ns))
    return crashes, left


def compare_tunnels(vehicle_id: str, drive: Drive, track: Mapping[str, Any]) -> list[Tunnel]:
    """Errors of a fused track (GeoJSON of ``/v1/trips/ID/track``) in each stretch that truly had no GNSS."""
    if drive.reference is None:
        return []
    t_s, error_m = _track_errors_m(drive, track)
    crash_times = [accident["t_s"] for accident in _truth(drive, "accidents")]
    tunnels = []
    for outage in _truth(drive, "outages"):
        start_s, duration_s = outage["start_s"], outage["duration_s"]
        end_s = start_s + duration_s
        crash_s = min((t for t in crash_times if start_s <= t < end_s), default=end_s)
        inside = error_m[(t_s >= start_s) & (t_s <= end_s)]
        before = error_m[(t_s >= start_s) & (t_s <= crash_s)]
        if len(inside) and len(before):
            tunnels.append(Tunnel(vehicle_id, start_s, duration_s, float(inside.max()), float(before.max())))
    return tunnels


def distance_m(lat_a_deg: float, lon_a_deg: float, lat_b_deg: float, lon_b_deg: float) -> float:
    """Horizontal distance of two near places."""
    meridian, transverse = radii_m(math.radians(lat_a_deg))
    north_m = math.radians(lat_b_deg - lat_a_deg) * meridian
    east_m = math.radians(lon_b_deg - lon_a_deg) * transverse * math.cos(math.radians(lat_a_deg))
    return math.hypot(north_m, east_m)


def _crash(
    vehicle_id: str, truth: Mapping[str, Any], found: Mapping[str, Any] | None, alert_ns: Mapping[str, int]
) -> Crash:
    if found is None:
        return Crash(vehicle_id, truth["t_s"], truth["in_outage"], truth["severity"], None)
    lon_deg, lat_deg = found["geometry"]["coordinates"][:2]
    facts = found["properties"]
    arrived_ns = alert_ns.get(found["id"])
    return Crash(
        vehicle_id=vehicle_id,
        t_s=truth["t_s"],
        in_outage=truth["in_outage"],
        true_severity=truth["severity"],
        found=found,
        position_error_m=distance_m(truth["lat_deg"], truth["lon_deg"], lat_deg, lon_deg),
        position_sd_m=math.hypot(facts["sd_n_m"], facts["sd_e_m"]),
        delta_v_error_mps=facts["delta_v_mps"] - truth["delta_v_mps"],
        alert_latency_ms=None if arrived_ns is None else (arrived_ns - parse_time(facts["received_at"])) * 1e-6,
    )


def _track_errors_m(drive: Drive, track: Mapping[str, Any]) -> tuple[FloatArray, FloatArray]:
    reference = drive.reference
    assert reference is not None
    t_ns, lat_deg, lon_deg = _positions(track["features"])
    t_s, reference_s = drive.t_s(t_ns), drive.t_s(reference.t_ns)
    true_lat_deg = np.degrees(np.interp(t_s, reference_s, reference.lat_rad))
    true_lon_deg = np.degrees(np.interp(t_s, reference_s, reference.lon_rad))
    places = zip(true_lat_deg, true_lon_deg, lat_deg, lon_deg, strict=True)
    return t_s, np.array([distance_m(*place) for place in places])


def _positions(features: Iterable[Mapping[str, Any]]) -> tuple[TimeArray, FloatArray, FloatArray]:
    times: list[int] = []
    places: list[Sequence[float]] = []
    for feature in features:
        geometry = feature["geometry"]
        if geometry is None:
            continue
        coordinates = geometry["coordinates"]
        places += [coordinates] if geometry["type"] == "Point" else coordinates
        times += [parse_time(text) for text in feature["properties"]["times"]]
    rows = np.array(places, dtype=float).reshape(-1, 3)
    return np.array(times, dtype=np.int64), rows[:, 1], rows[:, 0]


def _truth(drive: Drive, name: str) -> Sequence[Mapping[str, Any]]:
    return () if drive.truth is None else drive.truth.get(name, ())


def _impact_ns(feature: Mapping[str, Any]) -> int:
    return parse_time(feature["properties"]["time"])
