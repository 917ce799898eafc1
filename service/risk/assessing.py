"""A drive folder through the assessment of risk: by the filter's solution, by GNSS alone, or by the reference."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from core.earth import STANDARD_GRAVITY_MPS2, ned_offset_m
from core.measurements import GNSS, FloatArray, TimeArray
from core.navigation.poses import covariance_at
from core.navigation.solution import SLOW, Solution
from core.navigation.track import Mode, Track
from core.risk.assessment import Assessment, RiskModel, assess
from core.risk.driver import Driver
from core.risk.environment import Environment, Road, solar_offset_s
from core.risk.motion import WINDOW_S, Motion, motion_at
from service.errors import UsageError
from service.recordings.drive_folder import Drive
from service.recordings.fusing import Fused, Outage, withhold
from service.roads.protocol import RoadClass, RoadMatcher, Surroundings

SOURCES: Final = ("fused", "raw", "reference")
EVERY_NS: Final = 1_000_000_000
"""An instant a second of the drive: as often as a receiver says where it is."""
GNSS_POSITION_SD_M: Final = 5.0
"""Of a receiver that does not say its own, for matching; a choice."""


SETTLING_NS: Final = 3_000_000_000
"""For how long after an outage corrections of the velocity are no acceleration: the first fixes set it right, later
ones tell of the motion; a choice."""
LEAST_SD_M: Final = 1.0
"""Least sd of a position that is matched to a map, as maps are no better; a choice."""

_PLACE: Final = ("lat_rad", "lon_rad", "position_sd_m", "doubt_m", "course_rad")

BoolArray = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Clock:
    """When a drive is taken to have begun, if not when it says; how local time differs from UTC, if that is known."""

    start_t_ns: int | None = None
    utc_offset_s: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Instants:
    """Where a vehicle was and how it moved at n instants, by one source; NaN where that does not say.

    ``lat_rad`` and ``lon_rad`` are of the last place known. ``doubt_m`` is the sd of a position as far as it makes the
    road doubtful, ``position_sd_m`` that by which it is matched.
    """

    t_ns: TimeArray
    lat_rad: FloatArray
    lon_rad: FloatArray
    position_sd_m: FloatArray
    doubt_m: FloatArray
    course_rad: FloatArray
    motion: Motion


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
    return _by_solution(fused.solution, t_ns, raw)


def _by_reference(drive: Drive, t_ns: TimeArray) -> Instants:
    reference = drive.reference
    if reference is None or len(reference.t_ns) < 2:
        raise UsageError(f"{drive.name}: has no reference.csv; expected one for --source reference")
    exact = np.zeros(len(t_ns))
    motion = motion_at(t_ns, reference.t_ns, reference.v_n_mps, exact, exact)
    return _placed(t_ns, reference.t_ns, reference.lat_rad, reference.lon_rad, reference.v_n_mps, exact, exact, motion)


def _by_gnss(drive: Drive, t_ns: TimeArray, outages: Sequence[Outage]) -> Instants:
    """Fixes outside the outages alone, taken for what they say, as in the paper: only their absence is doubt."""
    m = withhold(drive, outages)
    there = np.isfinite(m.gnss[:, [GNSS["lat_rad"], GNSS["lon_rad"]]]).all(axis=1)
    fixes, fix_t_ns = m.gnss[there], m.gnss_t_ns[there]
    if len(fixes) < 2:
        nothing = np.full(len(t_ns), np.nan)
        unmoved = Motion(nothing, nothing, nothing, nothing, nothing)
        return Instants(t_ns, nothing.copy(), nothing.copy(), nothing, nothing, nothing, unmoved)
    v_n = _velocity(fixes, fix_t_ns)
    exact = np.zeros(len(t_ns))
    motion = motion_at(t_ns, fix_t_ns, v_n, exact, exact)
    position_sd = _nearest(t_ns, fix_t_ns, np.nan_to_num(fixes[:, GNSS["sd_h_m"]], nan=GNSS_POSITION_SD_M))
    lat, lon = fixes[:, GNSS["lat_rad"]], fixes[:, GNSS["lon_rad"]]
    placed = _placed(t_ns, fix_t_ns, lat, lon, v_n, position_sd, exact, motion)
    # In an outage the last place known holds, as in the paper; before the first fix there is none.
    held = np.searchsorted(fix_t_ns, t_ns, side="right") - 1
    lost = ~motion.known
    for array, values in ((placed.lat_rad, lat), (placed.lon_rad, lon)):
        array[lost] = np.where(held[lost] >= 0, values[np.maximum(held[lost], 0)], np.nan)
    return placed


def _by_solution(solution: Solution, t_ns: TimeArray, raw: Instants) -> Instants:
    """The filter's solution; GNSS alone until it is aligned."""
    track = solution.track
    used = np.isfinite(track.column("lat_rad")) & (track.column("mode") != Mode.ALIGNING)
    track = Track(track.t_ns[used], track.values[used])
    if len(track.t_ns) < 2:
        return raw
    position_sd, speed_sd, tilt_sd = _horizontal_sd(solution, t_ns)
    bias_sd = solution.slow_sd[:, [SLOW["accel_bias_x_mps2"], SLOW["accel_bias_y_mps2"]]].mean(axis=1)
    # Two bounds of the error of a change of velocity, of which the lesser holds. Errors of velocity a second apart go
    # together, so that of the change is less than that of both; and it is less than what tilt and bias make of gravity,
    # as these are known together better than either.
    half_ns = round(0.5e9 * WINDOW_S)
    ends = [_horizontal_sd(solution, t_ns + side * half_ns)[1] for side in (-1, 1)]
    by_tilt = np.hypot(STANDARD_GRAVITY_MPS2 * tilt_sd, _nearest(t_ns, solution.t_ns, bias_sd))
    acceleration_sd = np.fmin(np.hypot(*ends) / WINDOW_S, by_tilt)
    v_n = np.column_stack([track.column("vn_mps"), track.column("ve_mps")])
    motion = motion_at(t_ns, track.t_ns, v_n, speed_sd, acceleration_sd, _set_right(track))
    lat, lon = track.column("lat_rad"), track.column("lon_rad")
    ours = _placed(t_ns, track.t_ns, lat, lon, v_n, position_sd, position_sd, motion)
    return _first_known(ours, raw)


def _set_right(track: Track) -> BoolArray:
    """Rows at which a fix set right what had run away without any, (m,)."""
    coasted_ns = np.where(track.column("mode") == Mode.COASTING, track.t_ns, track.t_ns[0] - SETTLING_NS - 1)
    since_ns = track.t_ns - np.maximum.accumulate(coasted_ns)
    return np.asarray((track.column("gnss_used") > 0.0) & (since_ns <= SETTLING_NS))


def _horizontal_sd(solution: Solution, t_ns: TimeArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Sd of an axis of horizontal position (m), horizontal velocity (m/s) and tilt (rad), (n,); NaN without nodes."""
    covariance, reached = covariance_at(solution, t_ns)
    variance = np.where(reached[:, None], np.diagonal(covariance, axis1=1, axis2=2), np.nan)
    position, velocity, tilt = (np.sqrt(variance[:, [i, i + 1]].mean(axis=1)) for i in (0, 3, 6))
    return position, velocity, tilt


def _first_known(one: Instants, other: Instants) -> Instants:
    """One where it knows the motion, elsewhere the other."""
    known = one.motion.known

    def chosen(a: FloatArray, b: FloatArray) -> FloatArray:
        return np.where(known, a, b)

    of_motion = [field.name for field in fields(Motion)]
    motion = {name: chosen(getattr(one.motion, name), getattr(other.motion, name)) for name in of_motion}
    places: dict[str, Any] = {name: chosen(getattr(one, name), getattr(other, name)) for name in _PLACE}
    return replace(one, motion=Motion(**motion), **places)


def _placed(
    t_ns: TimeArray,
    at_ns: TimeArray,
    lat_rad: FloatArray,
    lon_rad: FloatArray,
    v_n: FloatArray,
    position_sd_m: FloatArray,
    doubt_m: FloatArray,
    motion: Motion,
) -> Instants:
    t, at = (t_ns - t_ns[0]).astype(float), (at_ns - t_ns[0]).astype(float)
    lon = np.interp(t, at, np.unwrap(lon_rad))
    moving = np.isfinite(v_n[:, :2]).all(axis=1)
    north, east = (np.interp(t, at[moving], v_n[moving, axis]) if moving.any() else np.zeros(len(t)) for axis in (0, 1))
    course = np.where(motion.known, np.arctan2(east, north), np.nan)
    return Instants(t_ns, np.interp(t, at, lat_rad), lon, position_sd_m, doubt_m, course, motion)


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


def _nearest(t_ns: TimeArray, at_ns: TimeArray, values: FloatArray) -> FloatArray:
    after = np.clip(np.searchsorted(at_ns, t_ns), 1, max(len(at_ns) - 1, 1))
    chosen = np.where(t_ns - at_ns[after - 1] <= at_ns[np.minimum(after, len(at_ns) - 1)] - t_ns, after - 1, after)
    return np.asarray(values[np.minimum(chosen, len(values) - 1)])


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
        road=road_under(instants, matcher),
    )
    t_s = drive.t_s(instants.t_ns)
    without_gnss = ~_by_gnss(drive, instants.t_ns, outages).motion.known
    for outage in outages:
        without_gnss |= (t_s >= outage.start_s) & (t_s < outage.end_s)
    assessment = assess(model, driver, environment, instants.motion)
    return AssessedDrive(instants, environment, assessment, without_gnss, clock.utc_offset_s is None)


def road_under(instants: Instants, matcher: RoadMatcher) -> Road:
    """The road under each instant as the core's tables name it."""
    if not matcher.known:
        return Road.unknown(len(instants.t_ns))
    sd_m = instants.position_sd_m
    found = matcher.match(
        instants.t_ns,
        np.degrees(instants.lat_rad),
        np.degrees(instants.lon_rad),
        np.maximum(sd_m, LEAST_SD_M),
        np.degrees(instants.course_rad) % 360.0,
    )
    kinds = np.array(["", *(kind.name.lower() for kind in list(RoadClass)[1:])])
    surroundings = np.array(["", *(one.name.lower() for one in list(Surroundings)[1:])])
    districts = np.array([*found.districts, ""])
    return Road(
        limit_kmh=found.limit_kmh,
        kind=kinds[found.road_class],
        surroundings=surroundings[found.surroundings],
        district=districts[found.district_index],
        position_sd_m=np.nan_to_num(instants.doubt_m, nan=0.0),
    )
