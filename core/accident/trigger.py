"""When something is looked at: one pass over the level rows that stops where there is something to judge."""

from __future__ import annotations

import math
from enum import IntEnum
from typing import Final

import numpy as np
from numba import njit

from core.accident.level import (
    A_X,
    A_Y,
    A_Z,
    CLIPPED,
    FORCE,
    GAP,
    HEADING_COS,
    HEADING_SIN,
    REST_S,
    ROUGH,
    SLOW_X,
    SLOW_Y,
    SPEED,
    UPRIGHT,
    V_X,
    V_Y,
    YAW_RATE,
    Flags,
)
from core.accident.pulse import beyond, unexplained
from core.accident.thresholds import AftermathThresholds, TriggerThresholds
from core.measurements import FloatArray, TimeArray


class Stop(IntEnum):
    """Why a scan stopped at a row."""

    END = 0
    """All rows were seen."""
    EARLY = 1
    """A suspected pulse has lasted ``tell_s`` and goes on: it may be told already."""
    WHOLE = 2
    """A suspected pulse is over, or as much of it as is waited for."""
    SHOCKS = 3
    """A shock, or a train of them, is over that was no suspected pulse."""
    MANOEUVRE = 4
    """Braking or cornering beyond ``hard_mps2`` is over."""
    TILTED = 5
    """The vehicle, or the box, has lain on its side for ``tilt_s``."""
    FOLLOWED = 6
    """What followed the open accident has been seen."""
    LEANT = 7
    """A parked vehicle has leant for a while: it is being towed, or carried by a ship."""


NEVER: Final = -(1 << 61)

(PULSE, START, SUSPECTED, HOT, FLOOR, SEEN_EARLY, RESTED, SHOCK_START, SHOCK_LAST, SHOCKS) = range(10)
(HARD_SINCE, HARD_UNTIL, TILTED, TILT_SEEN, FALL_SINCE, FELL, OPEN, OPEN_FROM, OPEN_UNTIL, MOVED) = range(10, 20)
(LEAN_SINCE, LEAN_LAST, LEANS, UPRIGHT_AGAIN, LEAN_TOLD, CLIPPED_NS, GAPS, SETTLED, MOVED_BEFORE) = range(20, 29)
REGISTERS: Final = 29
"""Registers, int64. Of a suspected pulse: whether there is one, its start and when it was suspected, the last sample
beyond reach, the time windows may not begin before, how often it was looked at. When the vehicle stood last.
Of shocks: the first, the last, how many. Since and until when driving was hard. Since when it lies on its side, and
whether that was seen. Since when the box falls, and when it last had fallen for ``fall_s``. Of the open accident:
whether there is one, from and until when it is followed; and when the vehicle moved last. Since and until when a parked
vehicle leans, how often, whether it was upright since, and whether that was told. For how long samples were clipped
in the horizontal plane, and how often the series broke off, since it began.
When a told pulse settled; the end of its flank is then waited for.
When the vehicle had moved last before it stood last."""

(LEAST_SPEED, MOST_ROUGH, TURNED, LONGEST_REST, HARD_X, HARD_Y) = range(6)
MARKS: Final = 6
"""Marks, float64. Of what followed the open accident: the least fused speed (NaN while unknown), the largest
mean square of vertical acceleration, the heading's change, rad, the longest rest. The hardest driving, forward and
right, m/s2."""


SHAKEN_NS: Final = 2_500_000_000
"""How long an accident's own shaking lasts in the mean of a second, ns; what shakes later is the ground. A choice."""
TOLD: Final = 99
"""In place of the looks where one of them told it."""
LOOKS: Final = 7
LOOK_NS: Final = 10_000_000
"""How often a pulse that goes on is looked at before it is over, and how far apart, ns: up to 145 ms from its start.
A choice."""


def fresh_registers() -> TimeArray:
    """Registers of a vehicle of which nothing is known."""
    registers = np.full(REGISTERS, NEVER, dtype=np.int64)
    registers[[PULSE, SEEN_EARLY, SHOCKS, TILT_SEEN, OPEN, LEANS, UPRIGHT_AGAIN, LEAN_TOLD, CLIPPED_NS, GAPS]] = 0
    return registers


def times_ns(trigger: TriggerThresholds, aftermath: AftermathThresholds) -> TimeArray:
    """The spans that ``scan`` needs, ns, in its order."""
    spans_s = (
        trigger.shortest_s, trigger.longest_s, trigger.settled_s, trigger.tell_s, trigger.decide_s,
        trigger.slow_decide_s, trigger.rest_s, trigger.shock_apart_s, trigger.shock_quiet_s, trigger.shock_longest_s,
        trigger.hard_s, trigger.fall_s, trigger.tilt_s, aftermath.rest_s, trigger.lean_parked_s, trigger.lean_quiet_s,
        trigger.lean_longest_s, trigger.told_settled_s,
    )  # fmt: skip
    return np.array([round(span_s * 1e9) for span_s in spans_s], dtype=np.int64)


def levels(trigger: TriggerThresholds) -> FloatArray:
    """The levels that ``scan`` needs, SI units, in its order."""
    return np.array(
        [
            trigger.tyre_mps2, trigger.margin_mps, trigger.standing_mps2, trigger.standing_margin_mps,
            trigger.jerk_mps3, trigger.hot_mps2,
            trigger.shock_mps2, trigger.hard_mps2, trigger.fall_mps2, math.cos(math.radians(trigger.tilt_deg)),
            math.cos(math.radians(trigger.lean_deg)), math.cos(math.radians(0.5 * trigger.lean_deg)),
        ]
    )  # fmt: skip


def lately(registers: TimeArray, which: int, t_ns: int, within_s: float) -> bool:
    """Whether what a register is the time of (``FELL``, ``MOVED``, ...) was within a span before a time."""
    return t_ns - int(registers[which]) < round(within_s * 1e9)


@njit(cache=True, nogil=True)
def scan(
    t_ns: TimeArray,
    x: FloatArray,
    flags: Flags,
    row: int,
    registers: TimeArray,
    marks: FloatArray,
    spans_ns: TimeArray,
    limits: FloatArray,
) -> tuple[int, int, int]:
    """Go on from ``row`` to where something is to be judged.

    A window's excess can only grow at a sample beyond reach, so quiet samples need no search; only the shortest
    window is still to be filled up after one.

    Returns
    -------
    row, last row that counts as evidence, reason (``Stop``); the number of rows and END where nothing is left
    """
    shortest, longest, settled, tell, decide, slow_decide, rest = spans_ns[:7]
    apart, quiet, longest_shocks, hard_for, fall_for, tilt_for, open_rest = spans_ns[7:14]
    parked, lean_quiet, lean_longest, told_settled = spans_ns[14:]
    tyre, margin, standing, standing_margin, jerk, hot, shock, hard, fall, tilt_cos, lean_cos, upright_cos = limits
    while row < t_ns.shape[0]:
        now = t_ns[row]
        gap = flags[row] & GAP
        if gap:
            registers[GAPS] += 1
        elif flags[row] & CLIPPED:
            registers[CLIPPED_NS] += now - t_ns[row - 1]
        a2 = x[row, A_X] * x[row, A_X] + x[row, A_Y] * x[row, A_Y]
        if registers[OPEN] and not gap:
            _follow(t_ns, x, row, registers[OPEN_FROM], marks)
        if x[row, REST_S] * 1e9 >= rest:
            registers[RESTED] = now
        elif not x[row, SPEED] < 0.5:
            if registers[RESTED] > registers[MOVED]:
                registers[MOVED_BEFORE] = registers[MOVED]
            registers[MOVED] = now
        _watch(x, row, now, gap, a2, registers, marks, apart, shock, hard, fall, fall_for, tilt_cos)

        if a2 > tyre * tyre or unexplained(x[row, A_X], x[row, A_Y], x[row, SLOW_X], x[row, SLOW_Y]) > hot:
            registers[HOT] = now
        if registers[PULSE]:
            if gap:  # what came after the silence says nothing about the pulse
                return row, row - 1, 2
            latest = max(registers[START] + decide, registers[SUSPECTED] + slow_decide)
            if registers[SETTLED] == NEVER and (now - registers[HOT] >= settled or now >= latest):
                if registers[SEEN_EARLY] != TOLD:
                    return row, row, 2
                registers[SETTLED] = now  # nobody waits for it any more
            if registers[SETTLED] != NEVER and (registers[HOT] == now or now - registers[SETTLED] >= told_settled):
                evidence = row
                while t_ns[evidence] > registers[SETTLED]:
                    evidence -= 1
                return row, evidence, 2
            if registers[SEEN_EARLY] < LOOKS and now - registers[START] >= tell + registers[SEEN_EARLY] * LOOK_NS:
                registers[SEEN_EARLY] += 1
                return row, row, 1
        elif now - registers[HOT] <= shortest and not gap:
            most = 0.0
            back = row - 1
            while back >= 0:
                window = now - t_ns[back]
                if window > longest or t_ns[back] < registers[FLOOR]:
                    break
                if window >= shortest:
                    stood = x[back, REST_S] * 1e9 >= rest
                    w = window * 1e-9
                    vx, vy = x[row, V_X] - x[back, V_X], x[row, V_Y] - x[back, V_Y]
                    own = unexplained(vx, vy, x[back, SLOW_X] * w, x[back, SLOW_Y] * w)
                    excess = beyond(math.hypot(vx, vy), own, w, stood, tyre, standing, jerk)
                    excess -= standing_margin if stood else margin
                    if excess > most:
                        most = excess
                        registers[PULSE], registers[SUSPECTED], registers[START] = 1, now, t_ns[back]
                        registers[SEEN_EARLY], registers[SETTLED] = 0, NEVER
                if flags[back] & GAP:
                    break
                back -= 1

        if now - registers[MOVED] > parked:
            _lean(x[row, UPRIGHT], now, registers, lean_cos, upright_cos)
        over = now - registers[LEAN_LAST] >= lean_quiet
        if registers[LEAN_SINCE] != NEVER and (over or now - registers[LEAN_SINCE] >= lean_longest):
            if over:
                registers[LEAN_SINCE] = NEVER
            if not registers[LEAN_TOLD]:
                registers[LEAN_TOLD] = 1
                return row, row, 7
        if registers[TILTED] != NEVER and not registers[TILT_SEEN] and now - registers[TILTED] >= tilt_for:
            registers[TILT_SEEN] = 1
            return row, row, 5
        if not registers[PULSE]:
            seen = now >= registers[OPEN_UNTIL] or marks[LONGEST_REST] * 1e9 >= open_rest
            if registers[OPEN] and seen:
                return row, row, 6
            over = gap or now - registers[SHOCK_LAST] >= quiet or now - registers[SHOCK_START] >= longest_shocks
            if registers[SHOCK_START] != NEVER and over:
                return row, row, 3
        if registers[HARD_UNTIL] != NEVER and now > registers[HARD_UNTIL]:
            if registers[HARD_UNTIL] - registers[HARD_SINCE] >= hard_for:
                return row, row, 4
            registers[HARD_SINCE] = registers[HARD_UNTIL] = NEVER
        row += 1
    return row, row, 0


@njit(cache=True, nogil=True)
def _watch(
    x: FloatArray,
    row: int,
    now: int,
    gap: int,
    a2: float,
    registers: TimeArray,
    marks: FloatArray,
    apart: int,
    shock: float,
    hard: float,
    fall: float,
    fall_for: int,
    tilt_cos: float,
) -> None:
    """Note shocks, hard driving, falls and tilts."""
    if abs(x[row, A_Z]) > shock or a2 > shock * shock:
        if registers[SHOCK_START] == NEVER:
            registers[SHOCK_START], registers[SHOCKS] = now, 1
        elif now - registers[SHOCK_LAST] > apart:
            registers[SHOCKS] += 1
        registers[SHOCK_LAST] = now

    slow2 = x[row, SLOW_X] * x[row, SLOW_X] + x[row, SLOW_Y] * x[row, SLOW_Y]
    if slow2 > hard * hard and not gap:
        cos, sin = x[row, HEADING_COS], x[row, HEADING_SIN]
        forward = x[row, SLOW_X] * cos + x[row, SLOW_Y] * sin
        right = -x[row, SLOW_X] * sin + x[row, SLOW_Y] * cos
        if registers[HARD_SINCE] == NEVER:
            registers[HARD_SINCE] = now
            marks[HARD_X], marks[HARD_Y] = 0.0, 0.0
        registers[HARD_UNTIL] = now
        if slow2 > marks[HARD_X] * marks[HARD_X] + marks[HARD_Y] * marks[HARD_Y]:
            marks[HARD_X], marks[HARD_Y] = forward, right

    if x[row, FORCE] < fall and not gap:
        if registers[FALL_SINCE] == NEVER:
            registers[FALL_SINCE] = now
        if now - registers[FALL_SINCE] >= fall_for:
            registers[FELL] = now
    else:
        registers[FALL_SINCE] = NEVER

    if x[row, UPRIGHT] < tilt_cos:
        if registers[TILTED] == NEVER:
            registers[TILTED] = now
    elif x[row, UPRIGHT] > tilt_cos + 0.15:  # ten degrees nearer upright: it is not lying any more
        registers[TILTED], registers[TILT_SEEN] = NEVER, 0


@njit(cache=True, nogil=True)
def _lean(upright: float, now: int, registers: TimeArray, lean_cos: float, upright_cos: float) -> None:
    """Note how a parked vehicle leans, and how often it comes back upright."""
    if upright < lean_cos:
        if registers[LEAN_SINCE] == NEVER:
            registers[LEAN_SINCE], registers[LEANS], registers[LEAN_TOLD], registers[UPRIGHT_AGAIN] = now, 1, 0, 0
        elif registers[UPRIGHT_AGAIN]:
            registers[LEANS] += 1
            registers[UPRIGHT_AGAIN] = 0
        registers[LEAN_LAST] = now
    elif upright > upright_cos:
        registers[UPRIGHT_AGAIN] = 1


@njit(cache=True, nogil=True)
def _follow(t_ns: TimeArray, x: FloatArray, row: int, from_ns: int, marks: FloatArray) -> None:
    """What followed an accident, up to a row."""
    speed = x[row, SPEED]
    if not math.isnan(speed):
        marks[LEAST_SPEED] = speed if math.isnan(marks[LEAST_SPEED]) else min(marks[LEAST_SPEED], speed)
    if t_ns[row] - from_ns >= SHAKEN_NS:
        marks[MOST_ROUGH] = max(marks[MOST_ROUGH], x[row, ROUGH])
    rest_s = min(x[row, REST_S], (t_ns[row] - from_ns) * 1e-9)
    marks[LONGEST_REST] = max(marks[LONGEST_REST], rest_s)
    if row > 0:
        marks[TURNED] += x[row, YAW_RATE] * (t_ns[row] - t_ns[row - 1]) * 1e-9
