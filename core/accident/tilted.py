"""What lies on its side: a vehicle that rolled over, or a box that came off."""

from __future__ import annotations

import math

import numpy as np

from core.accident import paper_rule, trigger
from core.accident.events import Candidate, Impact, NoAccident
from core.accident.impacts import overturned
from core.accident.judgement import confidence
from core.accident.level import SPEED, UPRIGHT, LevelMotion
from core.accident.naming import Shock
from core.accident.shocks import read_shock
from core.accident.thresholds import DetectorThresholds, RolloverThresholds
from core.measurements import TimeArray


def lying(
    level: LevelMotion, registers: TimeArray, row: int, detector: str, limits: DetectorThresholds, *, towed: bool
) -> Impact | Candidate:
    """The rollover of a vehicle that has lain on its side up to ``row``; or what the box did, which had stood, fell,
    crept there or tumbled as no car does."""
    since_ns, now, rollover = int(registers[trigger.TILTED]), int(level.t_ns[row]), limits.rollover
    before_ns = since_ns - round(rollover.before_s * 1e9)
    first = int(np.searchsorted(level.t_ns, before_ns))
    shock, swing_mps, delta_v_mps, _ = read_shock(
        level.t_ns, level.x, level.flags, before_ns, since_ns,
        shocks=0,
        fell=trigger.lately(registers, trigger.FELL, since_ns, rollover.fell_before_s),
        moved=trigger.lately(registers, trigger.MOVED, since_ns, limits.aftermath.parked_s),
        towed=towed,
    )  # fmt: skip
    rate = math.sqrt(shock.sway_radps**2 + shock.nod_radps**2 + shock.turn_radps**2)
    # Cars tip over within a second; what crept there, from half as far, was a box that had come to lie so. Motorcycles
    # lean as far in bends.
    half_way = math.cos(math.radians(0.5 * limits.trigger.tilt_deg))
    lay = level.x[np.searchsorted(level.t_ns, since_ns - round(rollover.tipped_s * 1e9)), UPRIGHT] < half_way
    crept = lay and rollover.tracks > 1
    across = shock.nod_radps > max(rollover.tumbles_radps, shock.sway_radps)
    tumbles = across or rate > limits.judgement.rotation_radps
    if shock.stood or shock.fell or crept or tumbles:
        return Candidate(
            t_ns=since_ns,
            decided_t_ns=now,
            reason=_reason(shock, rollover),
            probability=confidence(rollover.loose_odds, limits.judgement),
            delta_v_mps=delta_v_mps,
            vertical_mps=swing_mps,
            peak_mps2=shock.horizontal_mps2,
            duration_s=(now - since_ns) * 1e-9,
            speed_before_mps=float(level.x[first, SPEED]),
            paper_agrees=paper_rule.holds_within(level.x, first, row, limits.paper),
        )
    felt = delta_v_mps, shock.horizontal_mps2
    tilted = int(np.searchsorted(level.t_ns, since_ns))
    return overturned(level, tilted, row, detector, rollover.odds, felt, limits)


def _reason(shock: Shock, rollover: RolloverThresholds) -> NoAccident:
    """What lies there and is no accident."""
    if shock.fell:
        return NoAccident.BOX_DROPPED
    return NoAccident.FELL_OVER if shock.stood and rollover.tracks == 1 else NoAccident.BOX_KNOCKED
