"""What was no accident, as it is kept for a reviewer: shocks, hard manoeuvres and leaning, read off the rows."""

from __future__ import annotations

import math

import numpy as np

from core.accident import paper_rule, trigger
from core.accident.events import Candidate, Impact, NoAccident
from core.accident.judgement import confidence
from core.accident.level import SPEED, LevelMotion
from core.accident.naming import lean, manoeuvre, name
from core.accident.open_accident import Weak
from core.accident.shocks import read_shock
from core.accident.thresholds import DetectorThresholds
from core.measurements import FloatArray, TimeArray


def of_shocks(
    level: LevelMotion, registers: TimeArray, row: int, weak: Weak | None, limits: DetectorThresholds, *, towed: bool
) -> Candidate:
    """A shock, or a train of them, that is over at ``row``; ``weak`` the suspected pulse in it."""
    start_ns, last_ns = int(registers[trigger.SHOCK_START]), int(registers[trigger.SHOCK_LAST])
    shock, swing_mps, delta_v_mps, duration_s = read_shock(
        level.t_ns, level.x, level.flags, start_ns, last_ns,
        shocks=int(registers[trigger.SHOCKS]),
        fell=trigger.lately(registers, trigger.FELL, start_ns, limits.trigger.fell_before_s),
        moved=trigger.lately(registers, trigger.MOVED, start_ns, limits.aftermath.parked_s),
        towed=towed,
    )  # fmt: skip
    return Candidate(
        t_ns=start_ns if weak is None else weak.t_ns,
        decided_t_ns=int(level.t_ns[row]),
        reason=name(shock, limits.naming),
        probability=0.0 if weak is None else confidence(weak.odds, limits.judgement),
        delta_v_mps=delta_v_mps if weak is None else weak.delta_v_mps,
        vertical_mps=swing_mps,
        peak_mps2=max(shock.vertical_mps2, shock.horizontal_mps2),
        duration_s=duration_s if weak is None else weak.duration_s,
        speed_before_mps=shock.speed_mps,
        paper_agrees=False if weak is None else weak.paper_agrees,
    )


def of_manoeuvre(
    level: LevelMotion, registers: TimeArray, marks: FloatArray, row: int, limits: DetectorThresholds
) -> Candidate | None:
    """Emergency braking or hard cornering that is over at ``row``; None where it was neither."""
    since_ns, until_ns = int(registers[trigger.HARD_SINCE]), int(registers[trigger.HARD_UNTIL])
    forward, right = float(marks[trigger.HARD_X]), float(marks[trigger.HARD_Y])
    reason = manoeuvre(forward, right, limits.naming)
    if reason is NoAccident.UNEXPLAINED:
        return None
    first = min(int(np.searchsorted(level.t_ns, since_ns)), row)
    peak, duration_s = math.hypot(forward, right), (until_ns - since_ns) * 1e-9
    return Candidate(
        t_ns=since_ns,
        decided_t_ns=int(level.t_ns[row]),
        reason=reason,
        probability=0.0,
        delta_v_mps=peak * duration_s,
        vertical_mps=0.0,
        peak_mps2=peak,
        duration_s=duration_s,
        speed_before_mps=float(level.x[first, SPEED]),
        paper_agrees=paper_rule.holds_within(level.x, first, row, limits.paper),
    )


def of_lean(level: LevelMotion, registers: TimeArray, row: int, limits: DetectorThresholds) -> Candidate:
    """What has leant a parked vehicle."""
    since_ns, now = int(registers[trigger.LEAN_LAST]), int(level.t_ns[row])
    return Candidate(
        t_ns=since_ns,
        decided_t_ns=now,
        reason=lean(int(registers[trigger.LEANS]), limits.naming),
        probability=0.0,
        delta_v_mps=0.0,
        vertical_mps=0.0,
        peak_mps2=0.0,
        duration_s=(now - since_ns) * 1e-9,
        speed_before_mps=float(level.x[row, SPEED]),
        paper_agrees=False,
    )


def of_retracted(impact: Impact) -> Candidate:
    """An accident that was taken back for what followed it, with no shock around it that has a name."""
    return Candidate(
        t_ns=impact.t_ns,
        decided_t_ns=impact.decided_t_ns,
        reason=NoAccident.UNEXPLAINED,
        probability=impact.confidence,
        delta_v_mps=impact.delta_v_mps,
        vertical_mps=0.0,
        peak_mps2=impact.peak_mps2,
        duration_s=impact.duration_s,
        speed_before_mps=impact.speed_before_mps,
        paper_agrees=impact.paper_agrees,
    )
