"""A shock, or a train of them, read off the level rows: what naming goes by."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from core.accident.level import (
    A_X,
    A_Y,
    A_Z,
    CLIP_S,
    GAP,
    HEADING_COS,
    HEADING_SIN,
    PITCH_RATE,
    REST_S,
    ROLL_RATE,
    ROUGH,
    SLOW_X,
    SLOW_Y,
    SPEED,
    UPRIGHT,
    V_X,
    V_Y,
    V_Z,
    YAW_RATE,
    Flags,
)
from core.accident.naming import Shock
from core.measurements import FloatArray, TimeArray

AROUND_NS = 150_000_000
"""What before the first and after the last shock belongs to it, ns: a wheel's way back. A choice."""

SHAKING_NS = 450_000_000
"""How far around a shock its shaking is looked at, ns: a car at 50 km/h takes both axles over two tracks. A choice."""

GAUGE_M: Final = 1.435
"""Between the rails of a track, m: standard gauge."""
ONSET_NS: Final = 120_000_000
SWING_NS: Final = 350_000_000
"""From before to after a shock's first third, ns: what its first swing lies within, both axles at 30 km/h. A choice."""


def read_shock(
    t_ns: TimeArray,
    x: FloatArray,
    flags: Flags,
    start_ns: int,
    last_ns: int,
    *,
    shocks: int,
    fell: bool,
    moved: bool,
    towed: bool,
) -> tuple[Shock, float, float, float]:
    """A shock between two times with range of vertical velocity, change of horizontal one (m/s), and length (s)."""
    first = int(np.searchsorted(t_ns, start_ns - AROUND_NS))
    end = max(int(np.searchsorted(t_ns, last_ns + AROUND_NS, side="right")), first + 1)
    gaps = np.flatnonzero(flags[first:end] & GAP)
    if len(gaps):  # nothing is known across
        first += int(gaps[-1]) if first + int(gaps[-1]) < end - 1 else 0
    around_ns, around_x = _around(t_ns, x, flags, start_ns, last_ns)
    shaken_s = _shaken_s(around_ns, around_x[:, A_Z])
    x = x[first:end]
    vertical, horizontal = np.abs(x[:, A_Z]), np.hypot(x[:, A_X], x[:, A_Y])
    largest = np.maximum(vertical, horizontal)
    cos, sin = float(x[0, HEADING_COS]), float(x[0, HEADING_SIN])
    # The last mean of some tenths of a second, whichever is larger: before, as when a kerb ends braking, or by the end.
    at = int(np.argmax(np.hypot(x[:, SLOW_X], x[:, SLOW_Y])))
    slow_x, slow_y = float(x[at, SLOW_X]), float(x[at, SLOW_Y])
    heave_s = _same_way_s(t_ns[first:end], x[:, A_Z], int(np.argmax(vertical)))
    shock = Shock(
        speed_mps=float(x[0, SPEED]),
        stood=bool(x[0, REST_S] > 0.0),
        moved=moved,
        shocks=shocks,
        abrupt=_abruptness(largest),
        clipping_s=float(np.max(x[:, CLIP_S])),
        heave_s=heave_s,
        rises=rises(around_ns, around_x[:, A_Z]),
        gauge=_repeats(around_ns, around_x[:, A_Z], GAUGE_M, float(x[0, SPEED])),
        uneven=_rms(x[:, ROLL_RATE]) / max(_rms(x[:, PITCH_RATE]), 1e-6),
        shaken_s=shaken_s,
        sway_radps=float(np.max(np.abs(x[:, ROLL_RATE]))),
        nod_radps=float(np.max(np.abs(x[:, PITCH_RATE]))),
        turn_radps=float(np.max(np.abs(x[:, YAW_RATE]))),
        rough_mps2=math.sqrt(max(float(x[0, ROUGH]), 0.0)),
        forward_mps2=slow_x * cos + slow_y * sin,
        right_mps2=-slow_x * sin + slow_y * cos,
        vertical_mps2=float(np.max(vertical)),
        horizontal_mps2=float(np.max(horizontal)),
        fell=fell,
        tilt_deg=math.degrees(math.acos(max(-1.0, min(1.0, float(np.min(x[:, UPRIGHT])))))),
        towed=towed,
    )
    change = float(np.max(np.hypot(x[:, V_X] - x[0, V_X], x[:, V_Y] - x[0, V_Y])))
    return shock, float(np.ptp(x[:, V_Z])), change, (last_ns - start_ns) * 1e-9


def _around(t_ns: TimeArray, x: FloatArray, flags: Flags, start_ns: int, last_ns: int) -> tuple[TimeArray, FloatArray]:
    """Times and rows so far around a shock as its shaking is looked at, since the series broke off last."""
    first, end = (int(row) for row in np.searchsorted(t_ns, [start_ns - SHAKING_NS, last_ns + SHAKING_NS + 1]))
    gaps = np.flatnonzero(flags[first:end] & GAP)
    if len(gaps):
        first = min(first + int(gaps[-1]), end - 1)
    return t_ns[first:end], x[first:end]


def _shaken_s(t_ns: TimeArray, z: FloatArray) -> float:
    """For how long it shakes by more than a third of its peak, s."""
    loud = np.flatnonzero(np.abs(z) >= np.max(np.abs(z)) / 3.0)  # never none, also where nothing shakes
    return float(t_ns[loud[-1]] - t_ns[loud[0]]) * 1e-9


def rises(t_ns: TimeArray, z: FloatArray) -> float:
    """Share of the vertical change of velocity that is upwards before it is downwards; negative where it is not."""
    begin = int(t_ns[np.argmax(np.abs(z) >= 0.35 * np.max(np.abs(z)))])
    rows = (t_ns >= begin - ONSET_NS) & (t_ns <= begin + SWING_NS)
    t_s, z = (t_ns[rows] - begin) * 1e-9, z[rows]
    v = np.concatenate([[0.0], np.cumsum(0.5 * (z[1:] + z[:-1]) * np.diff(t_s))])  # down
    up, down = int(np.argmin(v)), int(np.argmax(v))
    share = float(-v[up] / max(v[down] - v[up], 1e-9))
    return share if up < down else share - 1.0


def _repeats(t_ns: TimeArray, z: FloatArray, way_m: float, speed_mps: float) -> float:
    """Autocorrelation of an acceleration after a way at a speed, -1..1; 0 where that is unknown or too long a time."""
    if not speed_mps > 0.0:
        return 0.0
    lag_s, span_s = way_m / speed_mps, float(t_ns[-1] - t_ns[0]) * 1e-9
    if lag_s > 0.5 * span_s:
        return 0.0
    t_s, even = (t_ns - t_ns[0]) * 1e-9, z - np.mean(z)
    later = np.interp(t_s[t_s <= span_s - lag_s] + lag_s, t_s, even)
    return float(np.sum(even[: later.size] * later) / max(np.sum(even * even), 1e-9))


def _rms(values: FloatArray) -> float:
    return math.sqrt(float(np.mean(values * values)))


def _abruptness(felt: FloatArray) -> float:
    """Larger of the samples just before and after those above 0.3 of the peak, over the peak."""
    loud = np.flatnonzero(felt >= 0.3 * np.max(felt))  # never none, also where nothing is felt
    if loud[0] == 0 or loud[-1] == len(felt) - 1:  # it goes on beyond what was looked at
        return 1.0
    beside = felt[[loud[0] - 1, loud[-1] + 1]]
    return float(np.max(beside) / max(np.max(felt), 1e-9))


def _same_way_s(t_ns: TimeArray, values: FloatArray, at: int) -> float:
    """For how long a series keeps the sign that it has at an index, s."""
    sign = math.copysign(1.0, values[at])
    low = high = at
    while low > 0 and values[low - 1] * sign > 0.0:
        low -= 1
    while high < len(values) - 1 and values[high + 1] * sign > 0.0:
        high += 1
    return float(t_ns[high] - t_ns[low]) * 1e-9
