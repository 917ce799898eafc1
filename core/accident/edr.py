"""What an event data recorder would have kept of an accident: the elements of 49 CFR part 563, from calibrated samples.

Signs are those of SAE J1733, as the regulation has them: longitudinal is positive forward, lateral positive to the
right. Speeds and changes of velocity are in km/h, the regulation's unit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from core.earth import STANDARD_GRAVITY_MPS2
from core.measurements import FloatArray, TimeArray

KMH: Final = 3.6
"""Kilometres an hour in a metre a second."""

ONSET_KMH: Final = 0.8
"""Time zero is where this much is gained within ``ONSET_S``; the end of the event where it no longer is (563.5)."""
ONSET_S: Final = 0.020
LATERAL_ONSET_S: Final = 0.005
"""Likewise for a lateral change alone; where samples are further apart than that, one of their periods."""
TRIGGER_KMH: Final = 8.0
"""An event is to be recorded where this much is gained within ``TRIGGER_S`` (563.5, trigger threshold)."""
TRIGGER_S: Final = 0.150
DELTA_V_S: Final = 0.250
MAXIMUM_S: Final = 0.300
AFTER_END_S: Final = 0.030
"""What is kept after the end of an event, where that comes first."""
DELTA_V_STEP_S: Final = 0.010
MULTI_EVENT_S: Final = 5.0
"""A later event that begins within this belongs to the same crash (563.5, multi-event crash)."""
SEARCHED_S: Final = 0.5
"""Where time zero is looked for around the start that the detector gives: a choice."""
FORMS: Final = {"5s_2hz": (5.0, 2.0), "20s_10hz": (20.0, 10.0)}
"""Pre-crash speed as of 2006 and as amended (89 FR 102810): seconds before time zero, samples a second."""
ROLL_S: Final = (-1.0, 5.0)
ROLL_HZ: Final = 10.0
FRESH_S: Final = 0.05
"""A sample holds for so long; beyond, an element is not recorded: two and a half periods of the slowest box."""


@dataclass(frozen=True, slots=True, eq=False)
class CrashMotion:
    """Calibrated motion around an accident, in increasing time, without the clock's jumps.

    Parameters
    ----------
    t_ns : (n,) int64
    f_b : (n, 3) specific force, m/s2, body axes: forward, right, down
    omega_b : (n, 3) angular rate, rad/s
    down_b : (n, 3) unit vector of the vertical, down, in body axes; NaN rows while unknown
    speed_mps : (n,) horizontal speed, NaN while unknown
    clipped : (n,) above 0 where the accelerometer read its full scale
    """

    t_ns: TimeArray
    f_b: FloatArray
    omega_b: FloatArray
    down_b: FloatArray
    speed_mps: FloatArray
    clipped: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """Values at times relative to time zero; NaN where nothing was recorded."""

    t_s: FloatArray
    values: FloatArray


@dataclass(frozen=True, slots=True)
class Maximum:
    """The greatest change of velocity by its length, with its sign, and when it was reached; NaN where unknown."""

    delta_v_kmh: float
    t_s: float


@dataclass(frozen=True, slots=True, eq=False)
class EventData:
    """The elements of table I, and those of table II that are known here.

    ``time_zero_ns`` is by the regulation's own rule where that was met (``time_zero_found``), else the start that was
    given. ``end_s`` is the end of the event, NaN if it does not end within the recording. ``triggered`` is whether the
    regulation's threshold was reached. ``events`` counts events of one crash, ``to_next_s`` is the time from the first
    to the second, NaN without one. ``clipped`` is whether the accelerometer read its full scale in the event:
    changes of velocity are then lower bounds. ``complete`` is whether every sample of the elements is there.
    """

    time_zero_ns: int
    time_zero_found: bool
    end_s: float
    triggered: bool
    longitudinal: Series
    lateral: Series
    maximum_longitudinal: Maximum
    maximum_lateral: Maximum
    maximum_resultant: Maximum
    acceleration_t_s: FloatArray
    acceleration_mps2: FloatArray
    speed_kmh: dict[str, Series]
    roll_deg: Series
    events: int
    to_next_s: float
    clipped: bool
    complete: bool


def event_data(motion: CrashMotion, start_ns: int) -> EventData:
    """The elements of an event that began at about ``start_ns``.

    Gravity is taken out with the fused vertical, sample by sample; where that is unknown, with the vehicle level.
    Velocity is the trapezoidal sum of the acceleration in the vehicle's own axes, as a recorder's is. Roll is that of
    the vertical at time zero carried on by the rate about the forward axis, so that it does not end at 180 degrees.
    """
    t_s: FloatArray = np.asarray((motion.t_ns - start_ns) * 1e-9, float)
    a_b = acceleration(motion)
    v_kmh = velocity_kmh(t_s, a_b)
    zero, found = _time_zero(t_s, v_kmh)
    t_s = t_s - zero
    end_s = _end(t_s, v_kmh)
    until_s = end_s + AFTER_END_S if math.isfinite(end_s) else math.inf
    grid = _grid(0.0, DELTA_V_S, DELTA_V_STEP_S)
    grid = grid[grid <= until_s + 1e-9]
    origin = np.array([_at(t_s, v_kmh[:, axis], np.zeros(1))[0] for axis in range(2)])
    gained = [_at(t_s, v_kmh[:, axis], grid) - origin[axis] for axis in range(2)]
    inside = (t_s >= 0.0) & (t_s <= min(MAXIMUM_S, until_s))
    relative = v_kmh[inside] - origin
    span = (t_s >= 0.0) & (t_s <= DELTA_V_S)
    speeds = {
        name: _before(t_s, KMH * motion.speed_mps, seconds, rate_hz) for name, (seconds, rate_hz) in FORMS.items()
    }
    events, to_next_s = _events(t_s, v_kmh, end_s)
    longest_s = max(seconds for seconds, _ in FORMS.values())
    needed = t_s[(t_s >= -longest_s - FRESH_S) & (t_s <= MAXIMUM_S + FRESH_S)]
    whole = len(needed) > 1 and needed[0] <= -longest_s and needed[-1] >= MAXIMUM_S
    whole = whole and float(np.diff(needed).max()) <= FRESH_S
    known = all(np.isfinite(series.values).all() for series in speeds.values())
    return EventData(
        time_zero_ns=start_ns + round(zero * 1e9),
        time_zero_found=found,
        end_s=end_s,
        triggered=_gained_within(t_s, v_kmh, TRIGGER_S, TRIGGER_KMH, (-TRIGGER_S, MAXIMUM_S)),
        longitudinal=Series(grid, gained[0]),
        lateral=Series(grid, gained[1]),
        maximum_longitudinal=_maximum(t_s[inside], relative[:, 0]),
        maximum_lateral=_maximum(t_s[inside], relative[:, 1]),
        maximum_resultant=_maximum(t_s[inside], np.hypot(relative[:, 0], relative[:, 1])),
        acceleration_t_s=t_s[span],
        acceleration_mps2=a_b[span],
        speed_kmh=speeds,
        roll_deg=_roll_deg(t_s, motion),
        events=events,
        to_next_s=to_next_s,
        clipped=bool((motion.clipped[inside] > 0).any()),
        complete=bool(whole and known),
    )


def acceleration(motion: CrashMotion) -> FloatArray:
    """Acceleration in body axes (n, 3), m/s2: specific force and gravity."""
    known = np.isfinite(motion.down_b[:, 0])[:, None]
    down_b = np.where(known, motion.down_b, np.array([0.0, 0.0, 1.0]))
    return motion.f_b + STANDARD_GRAVITY_MPS2 * down_b


def velocity_kmh(t_s: FloatArray, a_b: FloatArray) -> FloatArray:
    """Forward and right velocity gained since the first sample (n, 2), km/h."""
    gained: FloatArray = np.column_stack([_integral(t_s, a_b[:, axis]) for axis in range(2)])
    return np.asarray(KMH * gained)


def _integral(t_s: FloatArray, rate: FloatArray) -> FloatArray:
    """Trapezoidal sum from the first sample on, (n,)."""
    gained = 0.5 * (rate[:-1] + rate[1:]) * np.diff(t_s)
    return np.concatenate([np.zeros(min(len(t_s), 1)), np.cumsum(gained)])


def _at(t_s: FloatArray, values: FloatArray, at_s: FloatArray) -> FloatArray:
    """Linear between samples; NaN where the nearest one is too far away."""
    if not len(t_s):
        return np.full(len(at_s), math.nan)
    found = np.interp(at_s, t_s, values)
    after = np.clip(np.searchsorted(t_s, at_s), 0, len(t_s) - 1)
    before = np.clip(after - 1, 0, len(t_s) - 1)
    away = np.minimum(np.abs(t_s[after] - at_s), np.abs(t_s[before] - at_s))
    return np.where(away <= FRESH_S, found, math.nan)


def _grid(from_s: float, to_s: float, step_s: float) -> FloatArray:
    return np.asarray(from_s + step_s * np.arange(round((to_s - from_s) / step_s) + 1), float)


def _windows(t_s: FloatArray, v_kmh: FloatArray, span_s: float) -> FloatArray:
    """What is gained within ``span_s`` from each sample on (n, 2)."""
    return np.column_stack([np.interp(t_s + span_s, t_s, v_kmh[:, axis]) - v_kmh[:, axis] for axis in range(2)])


def _onsets(t_s: FloatArray, v_kmh: FloatArray) -> npt.NDArray[np.bool_]:
    """Whether an event's rate of change begins at each sample (n,)."""
    if len(t_s) < 2:
        return np.zeros(len(t_s), np.bool_)
    lateral_s = max(LATERAL_ONSET_S, float(np.median(np.diff(t_s))))
    long = np.abs(_windows(t_s, v_kmh, ONSET_S)[:, 0]) > ONSET_KMH
    return np.asarray(long | (np.abs(_windows(t_s, v_kmh, lateral_s)[:, 1]) > ONSET_KMH))


def _time_zero(t_s: FloatArray, v_kmh: FloatArray) -> tuple[float, bool]:
    near = (t_s >= -SEARCHED_S) & (t_s <= SEARCHED_S) & _onsets(t_s, v_kmh)
    if not near.any():
        return 0.0, False
    return float(t_s[np.flatnonzero(near)[0]]), True


def _end(t_s: FloatArray, v_kmh: FloatArray) -> float:
    """When the change within 20 ms has fallen to 0.8 km/h, both ways; NaN where it does not within the samples."""
    if len(t_s) < 2:
        return math.nan
    gained = np.abs(_windows(t_s, v_kmh, ONSET_S)).max(axis=1)
    moved = np.flatnonzero((t_s >= 0.0) & (gained > ONSET_KMH))
    if not len(moved):
        return 0.0
    over = np.flatnonzero((t_s > t_s[moved[0]]) & (gained <= ONSET_KMH) & (t_s <= t_s[-1] - ONSET_S))
    return float(t_s[over[0]]) if len(over) else math.nan


def _gained_within(
    t_s: FloatArray, v_kmh: FloatArray, span_s: float, threshold_kmh: float, between_s: tuple[float, float]
) -> bool:
    inside = (t_s >= between_s[0]) & (t_s <= between_s[1])
    return bool(len(t_s) > 1 and (np.abs(_windows(t_s, v_kmh, span_s)[inside]) >= threshold_kmh).any())


def _events(t_s: FloatArray, v_kmh: FloatArray, end_s: float) -> tuple[int, float]:
    """How many events there are within ``MULTI_EVENT_S``, and the time from the first to the second."""
    count, to_next_s, now_s = 1, math.nan, end_s
    onsets = _onsets(t_s, v_kmh)
    trigger = np.abs(_windows(t_s, v_kmh, TRIGGER_S)).max(axis=1) >= TRIGGER_KMH if len(t_s) > 1 else onsets
    while math.isfinite(now_s):
        begun = np.flatnonzero((t_s > now_s + AFTER_END_S) & (t_s <= MULTI_EVENT_S) & onsets & trigger)
        if not len(begun):
            break
        count += 1
        at_s = float(t_s[begun[0]])
        to_next_s = at_s if count == 2 else to_next_s
        now_s = at_s + _end(t_s - at_s, v_kmh)
    return count, to_next_s


def _maximum(t_s: FloatArray, gained_kmh: FloatArray) -> Maximum:
    if not len(t_s):
        return Maximum(math.nan, math.nan)
    at = int(np.abs(gained_kmh).argmax())
    return Maximum(float(gained_kmh[at]), float(t_s[at]))


def _before(t_s: FloatArray, speed_kmh: FloatArray, seconds: float, rate_hz: float) -> Series:
    at_s = _grid(-seconds, 0.0, 1.0 / rate_hz)
    return Series(at_s, _at(t_s, speed_kmh, at_s))


def _roll_deg(t_s: FloatArray, motion: CrashMotion) -> Series:
    at_s = _grid(*ROLL_S, 1.0 / ROLL_HZ)
    zero = int(np.searchsorted(t_s, 0.0))
    if zero >= len(t_s) or not np.isfinite(motion.down_b[zero]).all():
        return Series(at_s, np.full(len(at_s), math.nan))
    turned = _integral(t_s, motion.omega_b[:, 0])
    first = math.atan2(motion.down_b[zero, 1], motion.down_b[zero, 2])
    return Series(at_s, _at(t_s, np.degrees(first + turned - turned[zero]), at_s))
