"""A drive folder through the assessment of risk: by the filter's solution, by GNSS alone, or by the reference."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from core.earth import ned_offset_m
from core.measurements import GNSS, FloatArray, TimeArray
from core.risk.assessment import Assessment, RiskModel, assess
from core.risk.driver import Driver
from core.risk.environment import Environment, solar_offset_s
from core.risk.motion import motion_at
from service.errors import UsageError
from service.recordings.drive_folder import Drive
from service.recordings.fusing import Fused, Outage, withhold
from service.risk.instants import (
    EVERY_NS,
    BoolArray,
    Instants,
    by_fixes,
    by_track,
    first_known,
    matched_under,
    nothing_at,
    placed,
    road_of,
)
from service.roads.protocol import RoadMatcher

SOURCES: Final = ("fused", "raw", "reference")
GNSS_POSITION_SD_M: Final = 5.0
"""Of a receiver that does not say its own, for matching; a choice."""


@dataclass(frozen=True, slots=True)
class Clock:
    """When a drive is taken to have begun, if not when it says; how local time differs from UTC, if that is known."""

    start_t_ns: int | None = None
    utc_offset_s: float | None = None


def instants_of(drive: Drive) -> TimeArray:
    """The instants of a drive, the same for every source: whole seconds of its own time while all of it is recorded."""
    first, last = int(drive.measurements.imu_t_ns[0]), int(drive.measurements.imu_t_ns[-1])
    if drive.reference is not None and len(drive.reference.t_ns):
        first, last = max(first, int(drive.reference.t_ns[0])), min(last, int(drive.reference.t_ns[-1]))
    begin = drive.start_t_ns + -((drive.start_t_ns - first) // EVERY_NS) * EVERY_NS
    return np.arange(begin, last + 1, EVERY_NS, dtype=np.int64)


def by_source(drive: Drive, source: str, outages: Sequence[Outage], fused: Fused | None) -> Instants:
    """What a source says of each instant of a drive; ``fused`` is needed for ``fused`` alone, with its solution."""
    t_ns = instants_of(drive)
    if not len(t_ns):
        raise UsageError(f"{drive.name}: no second of it is recorded whole; expected a drive of some seconds")
    if source == "reference":
        return _by_reference(drive, t_ns)
    raw = _by_gnss(drive, t_ns, outages)
    if source == "raw":
        return raw
    if fused is None or fused.solution is None:
        raise ValueError("a fused source needs its solution")
    return first_known(by_track(fused.solution.track, t_ns), raw)  # GNSS alone until it is aligned


def _by_reference(drive: Drive, t_ns: TimeArray) -> Instants:
    reference = drive.reference
    if reference is None or len(reference.t_ns) < 2:
        raise UsageError(f"{drive.name}: has no reference.csv; expected one for --source reference")
    exact = np.zeros(len(t_ns))
    motion = motion_at(t_ns, reference.t_ns, reference.v_n_mps, exact, exact)
    return placed(t_ns, reference.t_ns, reference.lat_rad, reference.lon_rad, reference.v_n_mps, exact, exact, motion)


def _by_gnss(drive: Drive, t_ns: TimeArray, outages: Sequence[Outage]) -> Instants:
    """Fixes outside the outages alone."""
    m = withhold(drive, outages)
    there = np.isfinite(m.gnss[:, [GNSS["lat_rad"], GNSS["lon_rad"]]]).all(axis=1)
    fixes, fix_t_ns = m.gnss[there], m.gnss_t_ns[there]
    if len(fixes) < 2:
        return nothing_at(t_ns)
    sd_m = np.nan_to_num(fixes[:, GNSS["sd_h_m"]], nan=GNSS_POSITION_SD_M)
    lat, lon = fixes[:, GNSS["lat_rad"]], fixes[:, GNSS["lon_rad"]]
    return by_fixes(t_ns, fix_t_ns, lat, lon, _velocity(fixes, fix_t_ns), sd_m)


def _velocity(fixes: FloatArray, t_ns: TimeArray) -> FloatArray:
    """North and east velocity of fixes: as told, from speed and course, or by the positions around; (n, 2)."""
    told = fixes[:, [GNSS["vn_mps"], GNSS["ve_mps"]]]
    course, speed = fixes[:, GNSS["course_rad"]], fixes[:, GNSS["speed_mps"]]
    by_course = speed[:, None] * np.column_stack([np.cos(course), np.sin(course)])
    v_n = np.where(np.isfinite(told), told, by_course)
    if np.isfinite(v_n).all(axis=1).any():
        return v_n
    origin = (float(fixes[0, GNSS["lat_rad"]]), float(fixes[0, GNSS["lon_rad"]]), 0.0)
    lat, lon = fixes[:, GNSS["lat_rad"]], fixes[:, GNSS["lon_rad"]]
    place = ned_offset_m(lat, lon, np.zeros(len(lat)), origin)[:, :2]
    return np.asarray(np.gradient(place, (t_ns - t_ns[0]) * 1e-9, axis=0))


@dataclass(frozen=True, slots=True, eq=False)
class AssessedDrive:
    """An assessment with what it was made from; ``in_outage`` is where fixes were withheld or did not come, (n,)."""

    instants: Instants
    environment: Environment
    assessment: Assessment
    in_outage: BoolArray
    local_by_longitude: bool


def assess_drive(
    drive: Drive,
    model: RiskModel,
    driver: Driver,
    instants: Instants,
    outages: Sequence[Outage],
    matcher: RoadMatcher,
    clock: Clock,
) -> AssessedDrive:
    """Assess a drive's instants."""
    placed = np.flatnonzero(np.isfinite(instants.lon_rad))
    offset_s = clock.utc_offset_s
    if offset_s is None:
        offset_s = solar_offset_s(float(instants.lon_rad[placed[0]])) if placed.size else 0.0
    shift_ns = 0 if clock.start_t_ns is None else clock.start_t_ns - drive.start_t_ns
    environment = Environment(
        t_ns=instants.t_ns + shift_ns,
        utc_offset_s=offset_s,
        lat_rad=instants.lat_rad,
        lon_rad=instants.lon_rad,
        road=road_of(matched_under(instants, matcher), instants),
    )
    t_s = drive.t_s(instants.t_ns)
    without_gnss = ~_by_gnss(drive, instants.t_ns, outages).motion.known
    for outage in outages:
        without_gnss |= (t_s >= outage.start_s) & (t_s < outage.end_s)
    assessment = assess(model, driver, environment, instants.motion)
    return AssessedDrive(instants, environment, assessment, without_gnss, clock.utc_offset_s is None)
