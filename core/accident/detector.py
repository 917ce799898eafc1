"""The project's accident detector: a change of velocity that no tyre can bring about was an impact."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

import numpy as np
import numpy.typing as npt
from numba import njit

from core.accident import paper_rule
from core.accident.events import Impact, Severity, VehicleMotion
from core.accident.level import A_X, A_Y, GAP, SPEED, V_X, V_Y, Flags, LevelMotion
from core.accident.pulse import read_pulse, unclip
from core.accident.severity import classify, confidence, force_direction_deg
from core.accident.thresholds import DetectorThresholds
from core.earth import STANDARD_GRAVITY_MPS2
from core.measurements import FloatArray, TimeArray

NAME: Final = "telefuse"

_PENDING, _START, _SUSPECTED, _HOT, _FLOOR, _GROUP_END, _ACCIDENT, _RANK, _REVISION = range(9)
"""Registers, int64: whether an impact is suspected, its start and when it was, the last sample beyond the
tyres' reach, the time windows may not begin before, and of the accident told last: until when impacts belong to
it, its time, the rank of its severity and how often it was told."""

_NEVER: Final = -(1 << 61)
_RANKS: Final = (Severity.LOW_SPEED, Severity.SEVERE, Severity.AIRBAG)


class ImpactDetector:
    """Folds vehicle motion into impacts; the same samples give the same impacts however they are cut.

    An impact is suspected when over some window w the horizontal velocity changed by more than
    ``tyre_mps2 * w + margin_mps``; the window with the largest excess says when it began. It is decided when the
    pulse has settled, at the latest ``decide_s`` after its start, and dropped if it was vertical or swung back.
    Impacts within ``grouping_s`` belong to one accident: it is told again, with the same ``t_ns`` and the next
    ``revision``, only if a later one is of a higher class.
    """

    def __init__(self, thresholds: DetectorThresholds | None = None) -> None:
        self._thresholds = thresholds or DetectorThresholds()
        self._level = LevelMotion(self._thresholds.level)
        self._registers = np.array([0, 0, 0, _NEVER, _NEVER, _NEVER, 0, 0, 0], dtype=np.int64)

    def step(self, motion: VehicleMotion) -> list[Impact]:
        """Take the next samples, in time order; return the impacts decided in them."""
        limits, level = self._thresholds, self._level
        row = level.extend(motion)
        impacts: list[Impact] = []
        while True:
            row, evidence_row = _scan(
                level.t_ns,
                level.x,
                level.flags,
                row,
                self._registers,
                limits.tyre_mps2,
                limits.margin_mps,
                _ns(limits.shortest_s),
                _ns(limits.longest_s),
                _ns(limits.settled_s),
                _ns(limits.decide_s),
                _ns(limits.slow_decide_s),
            )
            if row == level.t_ns.shape[0]:
                return impacts
            impact = self._decide(row, evidence_row)
            if impact is not None:
                impacts.append(impact)
            row += 1

    def turn(self, C_new_from_old: FloatArray) -> None:
        """Take samples in other body axes from now on."""
        self._level.turn(C_new_from_old)

    def state(self) -> dict[str, npt.NDArray[np.generic]]:
        """Arrays from which ``load`` goes on, to the bit."""
        return {**self._level.state(), "detector.registers": self._registers}

    def load(self, arrays: Mapping[str, npt.NDArray[np.generic]]) -> None:
        """Go on from a ``state``."""
        self._level.load(arrays)
        self._registers = np.array(arrays["detector.registers"], dtype=np.int64)

    def _decide(self, row: int, evidence_row: int) -> Impact | None:
        """Judge the suspected pulse at ``row``, with rows up to ``evidence_row`` as evidence."""
        limits, registers = self._thresholds, self._registers
        t_ns, x, flags = self._level.t_ns, self._level.x, self._level.flags
        now = int(t_ns[row])
        registers[_PENDING], registers[_FLOOR] = 0, now
        start = int(np.searchsorted(t_ns, registers[_START]))
        pulse = read_pulse(t_ns, x, flags, start, evidence_row, limits.tyre_mps2, limits.onset_mps2, limits.onset_s)
        if pulse.retained < limits.retained:
            return None
        delta_v, duration_s = math.hypot(pulse.forward_mps, pulse.right_mps), pulse.duration_s
        if not delta_v > limits.vertical_ratio * pulse.vertical_mps:
            return None
        forward, right = pulse.forward_mps / delta_v, pulse.right_mps / delta_v
        tilt_sd = limits.blind_tilt_sd_rad if pulse.levelled else limits.tilt_sd_rad
        tilt_sd_mps = tilt_sd * STANDARD_GRAVITY_MPS2 * duration_s
        sd = math.sqrt((limits.scale_sd * delta_v) ** 2 + tilt_sd_mps**2 + limits.noise_sd_mps**2)
        clipped = pulse.clipped_s > 0.0
        if clipped:
            whole = unclip(t_ns, x, flags, pulse)
            delta_v, duration_s, sd = whole.delta_v_mps, whole.duration_s, math.hypot(sd, whole.sd_mps)
            forward, right = whole.forward, whole.right
        excess = delta_v - limits.tyre_mps2 * duration_s
        if clipped and excess - limits.clipped_sds * sd < limits.margin_mps:
            return None

        severity = classify(delta_v, duration_s, limits.severity)
        rank = _RANKS.index(severity)
        same = t_ns[pulse.first] <= registers[_GROUP_END]
        registers[_GROUP_END] = now + _ns(limits.grouping_s)
        if same and rank <= registers[_RANK]:
            return None
        registers[_REVISION] = registers[_REVISION] + 1 if same else 0
        registers[_ACCIDENT] = registers[_ACCIDENT] if same else t_ns[pulse.first]
        registers[_RANK] = rank
        return Impact(
            t_ns=int(registers[_ACCIDENT]),
            decided_t_ns=now,
            detector=NAME,
            severity=severity,
            confidence=confidence(excess, limits.margin_mps, sd),
            delta_v_mps=delta_v,
            delta_v_sd_mps=sd,
            delta_v_b_mps=(forward * delta_v, right * delta_v),
            pdof_deg=force_direction_deg(forward, right),
            peak_mps2=pulse.peak_mps2,
            duration_s=duration_s,
            clipped=clipped,
            speed_before_mps=float(x[pulse.first, SPEED]),
            paper_agrees=paper_rule.holds_within(x, pulse.first, row, limits.paper),
            revision=int(registers[_REVISION]),
        )


def _ns(seconds: float) -> int:
    return round(seconds * 1e9)


@njit(cache=True, nogil=True)
def _scan(
    t_ns: TimeArray,
    x: FloatArray,
    flags: Flags,
    row: int,
    registers: TimeArray,
    tyre_mps2: float,
    margin_mps: float,
    shortest_ns: int,
    longest_ns: int,
    settled_ns: int,
    decide_ns: int,
    slow_decide_ns: int,
) -> tuple[int, int]:
    """Go on from ``row`` to where a suspected impact is to be decided.

    Returns that row and the last one that counts as evidence, or the number of rows twice.
    """
    rows = t_ns.shape[0]
    tyre2 = tyre_mps2 * tyre_mps2
    while row < rows:
        now = t_ns[row]
        hot = x[row, A_X] * x[row, A_X] + x[row, A_Y] * x[row, A_Y] > tyre2
        gap = flags[row] & GAP
        if registers[_PENDING]:
            if gap:  # what came after the silence says nothing about the pulse
                return row, row - 1
            if hot:
                registers[_HOT] = now
            latest = max(registers[_START] + decide_ns, registers[_SUSPECTED] + slow_decide_ns)
            if now - registers[_HOT] >= settled_ns or now >= latest:
                return row, row
        else:
            if hot:
                registers[_HOT] = now
            # A window's excess can only grow at a sample beyond the tyres' reach, so quiet samples need no search;
            # only the shortest window is still to be filled up after one.
            if now - registers[_HOT] <= shortest_ns and not gap:
                most = margin_mps
                back = row - 1
                while back >= 0:
                    window = now - t_ns[back]
                    if window > longest_ns or t_ns[back] < registers[_FLOOR]:
                        break
                    if window >= shortest_ns:
                        change = math.hypot(x[row, V_X] - x[back, V_X], x[row, V_Y] - x[back, V_Y])
                        excess = change - tyre_mps2 * (window * 1e-9)
                        if excess > most:
                            most = excess
                            registers[_PENDING], registers[_SUSPECTED], registers[_START] = 1, now, t_ns[back]
                    if flags[back] & GAP:
                        break
                    back -= 1
        row += 1
    return rows, rows
