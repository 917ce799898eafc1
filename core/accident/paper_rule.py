"""Seed 1's accident rule as the paper has it: acceleration and curvature, each beyond a threshold."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

import numpy as np
import numpy.typing as npt
from numba import njit

from core.accident.events import Findings, Impact, Status, VehicleMotion
from core.accident.level import (
    A_X,
    A_Y,
    A_Z,
    CLIPPED,
    GAP,
    HEADING_COS,
    HEADING_SIN,
    SPEED,
    YAW_RATE,
    Flags,
    LevelMotion,
)
from core.accident.severity import classify, force_direction_deg
from core.accident.thresholds import PaperThresholds
from core.measurements import FloatArray, TimeArray

NAME: Final = "paper"

_NEVER: Final = -(1 << 61)
_PENDING, _START, _GROUP_END = range(3)
"""Registers, int64: whether the rule held and its change of velocity is awaited, since when, and until when
further samples belong to the accident told last."""


class PaperRule:
    """An accident is where norm(a) > ``acceleration_mps2`` and |yaw rate| / speed > ``curvature`` at one sample.

    The rule itself is instantaneous; its classes need the change of velocity within a second, so an impact is
    told half of ``window_s`` after the first such sample. At a standstill curvature is undefined: below
    ``speed_floor_mps`` it is taken at that speed, so that noise of the gyroscope on a parked car is not an infinite
    curvature. While the speed is unknown the rule does not hold. Confidence is 1: the paper knows none.
    """

    def __init__(self, thresholds: PaperThresholds | None = None) -> None:
        self._thresholds = thresholds or PaperThresholds()
        self._level = LevelMotion(self._thresholds.level)
        self._registers = np.array([0, 0, _NEVER], dtype=np.int64)

    def step(self, motion: VehicleMotion) -> Findings:
        """Take the next samples, in time order; return the impacts decided in them."""
        limits, level = self._thresholds, self._level
        row = level.extend(motion)
        found = Findings([], [])
        while True:
            row = _scan(
                level.t_ns,
                level.x,
                row,
                self._registers,
                limits.acceleration_mps2,
                _curvature_radpm(limits),
                limits.speed_floor_mps,
                round(0.5e9 * limits.window_s),
                round(1e9 * limits.grouping_s),
            )
            if row == level.t_ns.shape[0]:
                return found
            found.impacts.append(self._impact(row))
            row += 1

    def turn(self, C_new_from_old: FloatArray) -> None:
        """Take samples in other body axes from now on."""
        self._level.turn(C_new_from_old)

    def state(self) -> dict[str, npt.NDArray[np.generic]]:
        """Arrays from which ``load`` goes on, to the bit."""
        return {**self._level.state(), "paper.registers": self._registers}

    def load(self, arrays: Mapping[str, npt.NDArray[np.generic]]) -> None:
        """Go on from a ``state``."""
        self._level.load(arrays)
        self._registers = np.array(arrays["paper.registers"], dtype=np.int64)

    def _impact(self, row: int) -> Impact:
        limits, level = self._thresholds, self._level
        start_ns = int(self._registers[_START])
        held = int(np.searchsorted(level.t_ns, start_ns))
        first = int(np.searchsorted(level.t_ns, start_ns - round(0.5e9 * limits.window_s)))
        dvx, dvy, begin, end, peak, clipped = _largest_change(level.t_ns, level.x, level.flags, first, row)
        cos, sin = float(level.x[begin, HEADING_COS]), float(level.x[begin, HEADING_SIN])
        forward, right = dvx * cos + dvy * sin, -dvx * sin + dvy * cos
        delta_v, duration_s = math.hypot(forward, right), float(level.t_ns[end] - level.t_ns[begin]) * 1e-9
        return Impact(
            t_ns=start_ns,
            decided_t_ns=int(level.t_ns[row]),
            detector=NAME,
            severity=classify(delta_v, duration_s, limits.severity),
            confidence=1.0,
            delta_v_mps=delta_v,
            delta_v_sd_mps=math.nan,
            delta_v_b_mps=(forward, right),
            pdof_deg=force_direction_deg(forward, right),
            peak_mps2=peak,
            duration_s=duration_s,
            clipped=clipped,
            speed_before_mps=float(level.x[held, SPEED]),
            paper_agrees=True,
            status=Status.CONFIRMED,
        )


def holds_within(x: FloatArray, first: int, last: int, thresholds: PaperThresholds) -> bool:
    """Whether the rule holds at any of the level rows ``first`` to ``last``, both included."""
    curvature_radpm = _curvature_radpm(thresholds)
    return any(
        _holds(x, row, thresholds.acceleration_mps2, curvature_radpm, thresholds.speed_floor_mps)
        for row in range(first, last + 1)
    )


def _curvature_radpm(thresholds: PaperThresholds) -> float:
    return math.radians(thresholds.curvature * thresholds.curvature_unit_deg)


@njit(cache=True, nogil=True)
def _holds(x: FloatArray, row: int, acceleration_mps2: float, curvature_radpm: float, floor_mps: float) -> bool:
    a2 = x[row, A_X] ** 2 + x[row, A_Y] ** 2 + x[row, A_Z] ** 2
    speed = x[row, SPEED]
    if not a2 > acceleration_mps2 * acceleration_mps2 or math.isnan(speed):
        return False
    return bool(abs(x[row, YAW_RATE]) > curvature_radpm * max(speed, floor_mps))


@njit(cache=True, nogil=True)
def _scan(
    t_ns: TimeArray,
    x: FloatArray,
    row: int,
    registers: TimeArray,
    acceleration_mps2: float,
    curvature_radpm: float,
    floor_mps: float,
    wait_ns: int,
    grouping_ns: int,
) -> int:
    """Go on from ``row`` to where an impact is to be told; return that row, or the number of rows."""
    while row < t_ns.shape[0]:
        now = t_ns[row]
        if _holds(x, row, acceleration_mps2, curvature_radpm, floor_mps):
            if not registers[_PENDING] and now > registers[_GROUP_END]:
                registers[_PENDING], registers[_START] = 1, now
            registers[_GROUP_END] = now + grouping_ns
        if registers[_PENDING] and now - registers[_START] >= wait_ns:
            registers[_PENDING] = 0
            return row
        row += 1
    return row


@njit(cache=True, nogil=True)
def _largest_change(
    t_ns: TimeArray, x: FloatArray, flags: Flags, first: int, last: int
) -> tuple[float, float, int, int, float, bool]:
    """Change of horizontal velocity between two of the rows ``first`` to ``last``, not across a gap.

    Of all pairs of rows, the closest in time whose change comes to 99 % of the largest. Returns it along x and y of the
    level frame (m/s) with its rows, the peak (m/s2) and whether a sample clipped.
    """
    best_x = best_y = peak = most = 0.0
    begin = end = first
    clipped = False
    for stage in range(2):
        shortest = t_ns[last] - t_ns[first] + 1
        for i in range(first, last + 1):
            peak = max(peak, math.hypot(x[i, A_X], x[i, A_Y]))
            clipped = clipped or bool(flags[i] & CLIPPED)
            dvx = dvy = 0.0
            for j in range(i + 1, last + 1):
                if flags[j] & GAP:
                    break
                half = 0.5 * (t_ns[j] - t_ns[j - 1]) * 1e-9
                dvx += half * (x[j, A_X] + x[j - 1, A_X])
                dvy += half * (x[j, A_Y] + x[j - 1, A_Y])
                change = math.hypot(dvx, dvy)
                if stage == 0:
                    most = max(most, change)
                elif change >= 0.99 * most and t_ns[j] - t_ns[i] < shortest:
                    shortest = t_ns[j] - t_ns[i]
                    best_x, best_y, begin, end = dvx, dvy, i, j
    return best_x, best_y, begin, end, peak, clipped
