"""The compiled loop of ``ManoeuvreTracker``: excursions of the low-passed acceleration, and what they make."""

from __future__ import annotations

import math
from typing import Final

from numba import njit

from core.measurements import FloatArray, TimeArray

BRAKING, ACCELERATION, CORNERING, LANE_CHANGE = range(4)
NEVER: Final = -(1 << 61)
BUFFER: Final = 16
"""Episodes that one call tells at most; at a sample there are up to four."""

(KIND, SIDE, PEAK, SPEED_BEFORE, SPEED_AFTER, SPEED_AT_PEAK, ACROSS, YAW_AT_PEAK, HEADING) = range(9)
TOLD: Final = 9
"""Columns of what is told, float64; beside it start, peak and end, int64."""

(
    _LOW_PASS, _BRAKING, _ACCELERATION, _CORNERING, _LANE, _EXIT, _SETTLED, _LEAST, _KEPT, _KEPT_SHARE, _GATE,
    _SHOWN, _CORNER_GATE, _FLOOR, _LANE_S, _LANE_GAP, _LANE_HEADING, _LANE_TURN, _LANE_LEAST, _LANE_MOST, _REPEAT,
    _RECOVERY, _GAP,
) = range(23)  # fmt: skip
"""Limits in the order of ``ManoeuvreThresholds``."""

_LAST: Final = 0
_START, _PEAK_T, _ABOVE, _ACTIVE = range(4)
"""Of an excursion, int64: its begin, its peak, the last sample above; 0 none, 1 running."""
_T0: Final = 1
_HELD_T: Final = _T0 + 3 * 4
TIMES: Final = _HELD_T + 4
"""The last sample; three excursions (braking, acceleration, lateral); a lateral one that is held for its pair."""

_LP: Final = 0
"""Two poles each of forward, right and yaw."""
_V0: Final = 6
_SIZE: Final = 12
(
    _X_PEAK, _X_BEFORE, _X_AFTER, _X_SPEED, _X_ACROSS, _X_YAW, _X_HEADING, _X_SIDE, _X_AWAY, _X_WAY, _X_SUM, _X_KEPT,
) = range(12)  # fmt: skip
"""Of an excursion: as told; its side; how far it led aside of the heading at its begin, and how far along; the
integral of its acceleration, and how long it was kept up."""
_HELD: Final = _V0 + 3 * _SIZE
VALUES: Final = _HELD + _SIZE


@njit(cache=True, nogil=True)
def scan(
    t_ns: TimeArray,
    forward: FloatArray,
    right: FloatArray,
    yaw: FloatArray,
    speed: FloatArray,
    row: int,
    times: TimeArray,
    values: FloatArray,
    limits: FloatArray,
    told: FloatArray,
    told_ns: TimeArray,
) -> tuple[int, int]:
    """Go on from ``row`` until the rows end or what is told fills its buffer; the next row, and how many are told."""
    count = 0
    while row < t_ns.shape[0] and count <= BUFFER - 4:
        now = t_ns[row]
        a_x, a_y, w, v = forward[row], right[row], yaw[row], speed[row]
        row += 1
        if not math.isfinite(a_x + a_y + w) or now <= times[_LAST]:
            continue
        dt = (now - times[_LAST]) * 1e-9
        if times[_LAST] == 0 or dt > limits[_GAP]:
            times[_T0:], values[_V0:] = 0, 0.0
            values[0], values[1], values[2], values[3], values[4], values[5] = a_x, a_x, a_y, a_y, w, w
            dt = 0.0
        times[_LAST] = now
        share = 1.0 - math.exp(-2.0 * math.pi * limits[_LOW_PASS] * dt)
        for k, x in enumerate((a_x, a_y, w)):
            values[2 * k] += share * (x - values[2 * k])
            values[2 * k + 1] += share * (values[2 * k] - values[2 * k + 1])
        a_x, a_y, w = values[1], values[3], values[5]

        for kind in (BRAKING, ACCELERATION):
            x = -a_x if kind == BRAKING else a_x
            level = limits[_BRAKING + kind]
            at, of = times[_T0 + 4 * kind : _T0 + 4 * kind + 4], values[_V0 + _SIZE * kind : _V0 + _SIZE * (kind + 1)]
            if _follow(at, of, now, dt, x, 1.0, limits[_EXIT] * level, a_y, w, v, limits[_SETTLED]):
                fastest = max(of[_X_BEFORE], of[_X_AFTER])
                gained = (of[_X_AFTER] - of[_X_BEFORE]) * (-1.0 if kind == BRAKING else 1.0)
                # What the speed does not show is an error of tilt.
                sound = not (fastest < limits[_GATE] or gained < limits[_SHOWN] * of[_X_SUM])
                kept = kind == BRAKING or of[_X_KEPT] >= limits[_KEPT]
                if of[_X_PEAK] >= level and kept and _lasted(at, limits[_LEAST]) and sound:
                    _tell(told, told_ns, count, kind, at, of)
                    count += 1
                at[_ACTIVE] = 0
            elif x >= limits[_KEPT_SHARE] * level:
                of[_X_KEPT] += dt

        at, of = times[_T0 + 8 : _T0 + 12], values[_V0 + 2 * _SIZE : _V0 + 3 * _SIZE]
        held_at, held = times[_HELD_T : _HELD_T + 4], values[_HELD : _HELD + _SIZE]
        # Another side at once is another pulse.
        turned = at[_ACTIVE] == 1 and a_y * of[_X_SIDE] < -limits[_FLOOR]
        side = of[_X_SIDE] if at[_ACTIVE] == 1 else (1.0 if a_y > 0.0 else -1.0)
        ended = turned or _follow(at, of, now, dt, a_y * side, side, limits[_FLOOR], a_x, w, v, limits[_SETTLED])
        if ended:
            paired = held_at[_ACTIVE] == 1 and _is_lane_change(held_at, held, at, of, limits)
            if paired:
                _join(held_at, held, at, of)
                _tell(told, told_ns, count, LANE_CHANGE, held_at, held)
                count += 1
                held_at[_ACTIVE] = 0
            else:
                if held_at[_ACTIVE] == 1:
                    count = _corner(told, told_ns, count, held_at, held, limits)
                held_at[:], held[:] = at, of
            at[_ACTIVE] = 0
        follows = at[_ACTIVE] == 1 and not _lasted(at, limits[_LANE_S])
        waits = follows and (at[_START] - held_at[_ABOVE]) * 1e-9 <= limits[_LANE_GAP]
        late = (now - held_at[_ABOVE]) * 1e-9 > limits[_LANE_GAP] + limits[_SETTLED]
        if held_at[_ACTIVE] == 1 and late and not (waits and _may_be_half(held_at, held, limits)):
            count = _corner(told, told_ns, count, held_at, held, limits)
            held_at[_ACTIVE] = 0
    return row, count


@njit(cache=True, nogil=True)
def _follow(
    at: TimeArray,
    of: FloatArray,
    now: int,
    dt: float,
    x: float,
    side: float,
    low: float,
    across: float,
    w: float,
    v: float,
    settled_s: float,
) -> bool:
    """Follow an excursion of x above ``low``; whether it is over, being below for ``settled_s``."""
    if at[_ACTIVE] == 0:
        if x < low:
            return False
        at[_ACTIVE], at[_START], at[_PEAK_T] = 1, now, now
        of[:] = 0.0
        of[_X_PEAK], of[_X_BEFORE], of[_X_SIDE] = -1.0, v, side
        dt = 0.0
    if x >= low:
        at[_ABOVE], of[_X_AFTER] = now, v
    elif (now - at[_ABOVE]) * 1e-9 >= settled_s:
        return True
    of[_X_HEADING] += w * dt
    of[_X_SUM] += x * dt
    if v == v:
        of[_X_AWAY] += v * of[_X_HEADING] * dt
        of[_X_WAY] += v * dt
    else:
        of[_X_WAY] = math.nan
    if x > of[_X_PEAK]:
        at[_PEAK_T] = now
        of[_X_PEAK], of[_X_SPEED], of[_X_ACROSS], of[_X_YAW] = x, v, across, w
    return False


@njit(cache=True, nogil=True)
def _lasted(at: TimeArray, least_s: float) -> bool:
    return bool((at[_ABOVE] - at[_START]) * 1e-9 >= least_s)


@njit(cache=True, nogil=True)
def _may_be_half(at: TimeArray, of: FloatArray, limits: FloatArray) -> bool:
    return (
        abs(of[_X_HEADING]) <= limits[_LANE_TURN] and _lasted(at, limits[_LEAST]) and not _lasted(at, limits[_LANE_S])
    )


@njit(cache=True, nogil=True)
def _is_lane_change(held_at: TimeArray, held: FloatArray, at: TimeArray, of: FloatArray, limits: FloatArray) -> bool:
    """Whether two pulses to opposite sides led one lane aside, and straight on again."""
    if held[_X_SIDE] * of[_X_SIDE] > 0.0 or (at[_START] - held_at[_ABOVE]) * 1e-9 > limits[_LANE_GAP]:
        return False
    if not (_may_be_half(held_at, held, limits) and _may_be_half(at, of, limits)):
        return False
    if abs(held[_X_HEADING] + of[_X_HEADING]) > limits[_LANE_HEADING]:
        return False
    away = _aside(held_at, held, at, of)
    if away == away:
        return bool(limits[_LANE_LEAST] <= abs(away) <= limits[_LANE_MOST] and away * held[_X_SIDE] > 0.0)
    # With no speed a bend cannot be told from a lane but by its harshness.
    return bool(min(held[_X_PEAK], of[_X_PEAK]) >= limits[_LANE])


@njit(cache=True, nogil=True)
def _aside(held_at: TimeArray, held: FloatArray, at: TimeArray, of: FloatArray) -> float:
    """How far both led aside of the heading at the first one's begin, m; NaN where the speed is unknown."""
    between = held[_X_AFTER] * max((at[_START] - held_at[_ABOVE]) * 1e-9, 0.0)
    return float(held[_X_AWAY] + held[_X_HEADING] * (between + of[_X_WAY]) + of[_X_AWAY])


@njit(cache=True, nogil=True)
def _join(held_at: TimeArray, held: FloatArray, at: TimeArray, of: FloatArray) -> None:
    """The second pulse into the first: the harder peak, the first one's side."""
    held_at[_ABOVE] = at[_ABOVE]
    held[_X_AFTER] = of[_X_AFTER]
    held[_X_HEADING] += of[_X_HEADING]
    if of[_X_PEAK] > held[_X_PEAK]:
        held_at[_PEAK_T] = at[_PEAK_T]
        held[_X_PEAK], held[_X_SPEED], held[_X_ACROSS], held[_X_YAW] = (
            of[_X_PEAK],
            of[_X_SPEED],
            of[_X_ACROSS],
            of[_X_YAW],
        )


@njit(cache=True, nogil=True)
def _corner(told: FloatArray, told_ns: TimeArray, count: int, at: TimeArray, of: FloatArray, limits: FloatArray) -> int:
    harsh = of[_X_PEAK] >= limits[_CORNERING] and _lasted(at, limits[_LEAST])
    # A turn to the other side than the force is a road's banking or a side wind.
    if harsh and of[_X_HEADING] * of[_X_SIDE] > 0.0 and not of[_X_SPEED] < limits[_CORNER_GATE]:
        _tell(told, told_ns, count, CORNERING, at, of)
        return count + 1
    return count


@njit(cache=True, nogil=True)
def _tell(told: FloatArray, told_ns: TimeArray, count: int, kind: int, at: TimeArray, of: FloatArray) -> None:
    told_ns[count, 0], told_ns[count, 1], told_ns[count, 2] = at[_START], at[_PEAK_T], at[_ABOVE]
    told[count, KIND], told[count, SIDE], told[count, PEAK] = kind, of[_X_SIDE], of[_X_PEAK]
    told[count, SPEED_BEFORE], told[count, SPEED_AFTER] = of[_X_BEFORE], of[_X_AFTER]
    told[count, SPEED_AT_PEAK], told[count, ACROSS] = of[_X_SPEED], of[_X_ACROSS]
    told[count, YAW_AT_PEAK], told[count, HEADING] = of[_X_YAW], of[_X_HEADING]
