"""Where a vehicle was and how it moved, second by second, as the assessment of risk takes it, and the road under it."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from core.earth import STANDARD_GRAVITY_MPS2
from core.measurements import FloatArray, TimeArray
from core.navigation.track import Mode, Track
from core.risk.environment import Road
from core.risk.motion import WINDOW_S, Motion, motion_at
from service.roads.protocol import MatchedPoints, RoadClass, RoadMatcher, Surroundings

EVERY_NS: Final = 1_000_000_000
"""An instant a second of the drive: as often as a receiver says where it is."""
SETTLING_NS: Final = 3_000_000_000
"""For how long after an outage corrections of the velocity are no acceleration: the first fixes set it right, later
ones tell of the motion; a choice."""
LEAST_SD_M: Final = 1.0
"""Least sd of a position that is matched to a map, as maps are no better; a choice."""
_SPANS_FIX_NS: Final = 500_000_000
"""Rows farther apart have a fix between them, which ``gnss_used`` of the later one need not show."""

_PLACE: Final = ("lat_rad", "lon_rad", "position_sd_m", "doubt_m", "course_rad")

BoolArray = npt.NDArray[np.bool_]


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


def nothing_at(t_ns: TimeArray) -> Instants:
    """Instants of which nothing is known."""
    nan = np.full(len(t_ns), np.nan)
    return Instants(t_ns, nan.copy(), nan.copy(), nan, nan, nan, Motion(nan, nan, nan, nan, nan))


def by_track(track: Track, t_ns: TimeArray) -> Instants:
    """What rows of a fused track say, those that are not aligning: all of a drive's, or one a second as are stored."""
    used = np.isfinite(track.column("lat_rad")) & (track.column("mode") != Mode.ALIGNING)
    track = Track(track.t_ns[used], track.values[used])
    if len(track.t_ns) < 2:
        return nothing_at(t_ns)
    at_ns = track.t_ns
    position_sd = nearest(t_ns, at_ns, np.hypot(track.column("sd_n_m"), track.column("sd_e_m")) / np.sqrt(2.0))
    speed_sd, tilt_sd, bias_sd = (
        nearest(t_ns, at_ns, track.column(name)) for name in ("sd_v_h_mps", "sd_tilt_rad", "sd_accel_bias_mps2")
    )
    # Two bounds of the error of a change of velocity, of which the lesser holds. Errors of velocity a second apart go
    # together, so that of the change is less than that of both; and it is less than what tilt and bias make of gravity,
    # as these are known together better than either.
    half_ns = round(0.5e9 * WINDOW_S)
    ends = [nearest(t_ns + side * half_ns, at_ns, track.column("sd_v_h_mps")) for side in (-1, 1)]
    by_tilt = np.hypot(STANDARD_GRAVITY_MPS2 * tilt_sd, bias_sd)
    acceleration_sd = np.fmin(np.hypot(*ends) / WINDOW_S, by_tilt)
    v_n = np.column_stack([track.column("vn_mps"), track.column("ve_mps")])
    motion = motion_at(t_ns, at_ns, v_n, speed_sd, acceleration_sd, _set_right(track))
    lat, lon = track.column("lat_rad"), track.column("lon_rad")
    return placed(t_ns, at_ns, lat, lon, v_n, position_sd, position_sd, motion)


def by_fixes(
    t_ns: TimeArray,
    at_ns: TimeArray,
    lat_rad: FloatArray,
    lon_rad: FloatArray,
    v_n_mps: FloatArray,
    sd_m: FloatArray,
) -> Instants:
    """What fixes (m,) say alone, taken for what they say, as in the paper: only their absence is doubt."""
    if len(at_ns) < 2:
        return nothing_at(t_ns)
    exact = np.zeros(len(t_ns))
    motion = motion_at(t_ns, at_ns, v_n_mps, exact, exact)
    known = placed(t_ns, at_ns, lat_rad, lon_rad, v_n_mps, nearest(t_ns, at_ns, sd_m), exact, motion)
    # In an outage the last place known holds, as in the paper; before the first fix there is none.
    held = np.searchsorted(at_ns, t_ns, side="right") - 1
    lost = ~motion.known
    for array, values in ((known.lat_rad, lat_rad), (known.lon_rad, lon_rad)):
        array[lost] = np.where(held[lost] >= 0, values[np.maximum(held[lost], 0)], np.nan)
    return known


def first_known(one: Instants, other: Instants) -> Instants:
    """One where it knows the motion, elsewhere the other."""
    known = one.motion.known

    def chosen(a: FloatArray, b: FloatArray) -> FloatArray:
        return np.where(known, a, b)

    of_motion = [field.name for field in fields(Motion)]
    motion = {name: chosen(getattr(one.motion, name), getattr(other.motion, name)) for name in of_motion}
    places: dict[str, Any] = {name: chosen(getattr(one, name), getattr(other, name)) for name in _PLACE}
    return replace(one, motion=Motion(**motion), **places)


def placed(
    t_ns: TimeArray,
    at_ns: TimeArray,
    lat_rad: FloatArray,
    lon_rad: FloatArray,
    v_n: FloatArray,
    position_sd_m: FloatArray,
    doubt_m: FloatArray,
    motion: Motion,
) -> Instants:
    """Instants with their place and course, linear between those of a series."""
    t, at = (t_ns - t_ns[0]).astype(float), (at_ns - t_ns[0]).astype(float)
    lon = np.interp(t, at, np.unwrap(lon_rad))
    moving = np.isfinite(v_n[:, :2]).all(axis=1)
    north, east = (np.interp(t, at[moving], v_n[moving, axis]) if moving.any() else np.zeros(len(t)) for axis in (0, 1))
    course = np.where(motion.known, np.arctan2(east, north), np.nan)
    return Instants(t_ns, np.interp(t, at, lat_rad), lon, position_sd_m, doubt_m, course, motion)


def nearest(t_ns: TimeArray, at_ns: TimeArray, values: FloatArray) -> FloatArray:
    """Of a series' values the one nearest in time to each instant."""
    after = np.clip(np.searchsorted(at_ns, t_ns), 1, max(len(at_ns) - 1, 1))
    chosen = np.where(t_ns - at_ns[after - 1] <= at_ns[np.minimum(after, len(at_ns) - 1)] - t_ns, after - 1, after)
    return np.asarray(values[np.minimum(chosen, len(values) - 1)])


def matched_under(instants: Instants, matcher: RoadMatcher) -> MatchedPoints:
    """The road under each instant."""
    if not matcher.known:
        return MatchedPoints.unknown(len(instants.t_ns))
    return matcher.match(
        instants.t_ns,
        np.degrees(instants.lat_rad),
        np.degrees(instants.lon_rad),
        np.maximum(instants.position_sd_m, LEAST_SD_M),
        np.degrees(instants.course_rad) % 360.0,
    )


def road_of(found: MatchedPoints, instants: Instants) -> Road:
    """The same as the core's tables name it."""
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


def _set_right(track: Track) -> BoolArray:
    """Rows at which a fix set right what had run away without any, (m,)."""
    coasted_ns = np.where(track.column("mode") == Mode.COASTING, track.t_ns, track.t_ns[0] - SETTLING_NS - 1)
    since_ns = track.t_ns - np.maximum.accumulate(coasted_ns)
    apart_ns = np.diff(track.t_ns, prepend=track.t_ns[0])
    fixed = (track.column("gnss_used") > 0.0) | ((apart_ns > _SPANS_FIX_NS) & (track.column("mode") != Mode.COASTING))
    return np.asarray(fixed & (since_ns <= SETTLING_NS))
