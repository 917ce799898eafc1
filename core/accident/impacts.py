"""Impacts as they are told: of a pulse, by a tilt or an airbag without one, remade by what rest says of clipping."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Final

import numpy as np

from core.accident import paper_rule
from core.accident.clipping import Whole, unclip
from core.accident.events import FeltImpact, Impact, Kind, Severity
from core.accident.judgement import AIRBAG_DEPLOYED, Aftermath, Evidence, confidence, log_odds, reasons
from core.accident.level import CLIPPED, SPEED, LevelMotion
from core.accident.pulse import Pulse
from core.accident.severity import UNIFORM_DEG, classify, force_direction_deg, force_direction_sd_deg, injury_risk
from core.accident.thresholds import DetectorThresholds
from core.accident.weights import JudgementThresholds
from core.earth import STANDARD_GRAVITY_MPS2
from core.measurements import FloatArray

_NOTHING_YET: Final = Aftermath(math.nan, math.nan, 0.0, 0.0, 0.0, airbag=False, power_loss=False)


def weighed(level: LevelMotion, pulse: Pulse, limits: DetectorThresholds, *, fell: bool) -> float:
    """Log-odds that a pulse was an accident, by what was read: what clipping hides is not needed, which is dear."""
    return log_odds(
        Evidence(
            delta_v_mps=pulse.felt_mps,
            beyond_mps=pulse.beyond_mps,
            duration_s=pulse.felt_s,
            swing_mps=pulse.swing_mps,
            retained=pulse.retained,
            rate_radps=pulse.rate_radps,
            jolt_radps=pulse.jolt_radps,
            tip_radps=pulse.tip_radps,
            aside=abs(pulse.right_mps) / max(math.hypot(pulse.forward_mps, pulse.right_mps), 1e-9),
            clipping_s=pulse.clipping_s,
            pinned=pulse.pinned,
            sound=pulse.sound,
            abrupt=pulse.abrupt,
            speed_mps=float(level.x[pulse.first, SPEED]),
            stood=pulse.stood,
            fell=fell and pulse.rate_radps > limits.naming.fallen_radps,
        ),
        limits.judgement,
    )


def may_be_braking(pulse: Pulse, limits: JudgementThresholds) -> bool:
    """Whether a pulse so far is along the way of a vehicle that rolls, and against it, as where brakes grip."""
    aside = abs(pulse.right_mps) > limits.braking_aside * math.hypot(pulse.forward_mps, pulse.right_mps)
    return pulse.forward_mps < 0.0 and not aside and not pulse.stood


def felt(
    level: LevelMotion, pulse: Pulse, row: int, odds: float, name: str, limits: DetectorThresholds, *, parked: bool
) -> tuple[Impact, Whole | None]:
    """The accident that a pulse of such log-odds is, decided at ``row``, and what it was where it clipped."""
    t_ns, x = level.t_ns, level.x
    delta_v, duration_s = math.hypot(pulse.forward_mps, pulse.right_mps), pulse.duration_s
    direction = (pulse.forward_mps / max(delta_v, 1e-9), pulse.right_mps / max(delta_v, 1e-9))
    tilt_sd = limits.pulse.blind_tilt_sd_rad if pulse.levelled else limits.pulse.tilt_sd_rad
    across_sd = math.hypot(tilt_sd * STANDARD_GRAVITY_MPS2 * duration_s, limits.pulse.noise_sd_mps)
    sd = math.hypot(limits.pulse.scale_sd * delta_v, across_sd)
    interval = (max(delta_v - 1.96 * sd, 0.0), delta_v + 1.96 * sd)
    whole, hidden_rad = None, 0.0
    # What clipped may lie behind where the pulse has ended, in a burst of garbage: then nothing of it is hidden.
    if pulse.clipped_s > 0.0 and (level.flags[pulse.first : pulse.last + 1] & CLIPPED).any():
        whole = unclip(t_ns, x, level.flags, pulse.first, pulse.last)
        delta_v, duration_s, hidden_rad = whole.delta_v_mps, whole.duration_s, whole.direction_sd_rad
        low, high = whole.low_mps - delta_v, whole.high_mps - delta_v
        direction = (float(whole.direction[0]), float(whole.direction[1]))
        interval = (max(delta_v - math.hypot(low, 1.96 * sd), 0.0), delta_v + math.hypot(high, 1.96 * sd))
        sd = math.hypot(sd, whole.sd_mps)
    pdof_deg = force_direction_deg(*direction)
    impact = Impact(
        t_ns=int(t_ns[pulse.first]),
        decided_t_ns=int(t_ns[row]),
        detector=name,
        severity=classify(delta_v, duration_s, limits.severity),
        confidence=confidence(odds, limits.judgement),
        delta_v_mps=delta_v,
        delta_v_sd_mps=sd,
        delta_v_b_mps=(direction[0] * delta_v, direction[1] * delta_v),
        pdof_deg=pdof_deg,
        peak_mps2=pulse.peak_mps2,
        duration_s=duration_s,
        clipped=whole is not None,
        speed_before_mps=float(x[pulse.first, SPEED]),
        paper_agrees=paper_rule.holds_within(x, pulse.first, row, limits.paper),
        kind=Kind.PARKED_HIT if parked else Kind.COLLISION,
        delta_v_interval_mps=interval,
        pdof_sd_deg=force_direction_sd_deg(delta_v, across_sd, limits.pulse, hidden_rad),
        injury=injury_risk(interval, pdof_deg),
        reasons=reasons(_NOTHING_YET, limits.aftermath, clipped=whole is not None, rollover=False),
    )
    return impact, whole


def refined(impact: Impact, mean_mps: FloatArray, covariance: FloatArray, limits: DetectorThresholds) -> Impact:
    """With another change of velocity, (2,) forward and right, and its covariance."""
    delta_v = float(np.hypot(mean_mps[0], mean_mps[1]))
    unit = mean_mps / max(delta_v, 1e-9)
    across = np.array([-unit[1], unit[0]])
    sd = math.hypot(math.sqrt(float(unit @ covariance @ unit)), limits.pulse.scale_sd * delta_v)
    interval = (max(delta_v - 1.96 * sd, 0.0), delta_v + 1.96 * sd)
    pdof_deg = force_direction_deg(float(unit[0]), float(unit[1]))
    return replace(
        impact,
        delta_v_mps=delta_v,
        delta_v_sd_mps=sd,
        delta_v_b_mps=(float(mean_mps[0]), float(mean_mps[1])),
        pdof_deg=pdof_deg,
        severity=classify(delta_v, impact.duration_s, limits.severity),
        delta_v_interval_mps=interval,
        pdof_sd_deg=force_direction_sd_deg(delta_v, math.sqrt(float(across @ covariance @ across)), limits.pulse),
        injury=injury_risk(interval, pdof_deg),
    )


def each_of(impacts: Sequence[Impact]) -> tuple[FeltImpact, ...]:
    """The figures of an accident's impacts, each as it would be told were it the worst."""
    names = [field.name for field in fields(FeltImpact)]
    return tuple(FeltImpact(**{name: getattr(impact, name) for name in names}) for impact in impacts)


def unsure_direction_sd_deg(impacts: Sequence[Impact], at: int) -> float:
    """Spread of the direction of the worst of an accident's impacts, the one ``at``, where another may as well be it.

    Each other weighs by the probability that its change of velocity is no less (normal, independent of the worst's).
    """
    worst, weights, squares = impacts[at], 1.0, impacts[at].pdof_sd_deg ** 2
    for other in (*impacts[:at], *impacts[at + 1 :]):
        sd = max(math.hypot(worst.delta_v_sd_mps, other.delta_v_sd_mps), 1e-6)
        weight = 0.5 * math.erfc((worst.delta_v_mps - other.delta_v_mps) / (math.sqrt(2.0) * sd))
        off_deg = math.remainder(other.pdof_deg - worst.pdof_deg, 360.0)
        weights, squares = weights + weight, squares + weight * (off_deg**2 + other.pdof_sd_deg**2)
    return min(math.sqrt(squares / weights), UNIFORM_DEG)


def belonging(impact: Impact, accident: Impact) -> Impact:
    """An impact as an accident's worst, that was told before with another one's figures."""
    return replace(
        impact,
        t_ns=accident.t_ns,
        revision=accident.revision,
        impacts=accident.impacts,
        each=accident.each,
        kind=accident.kind,
        rollover=accident.rollover or impact.rollover,
        speed_before_mps=accident.speed_before_mps,
        paper_agrees=accident.paper_agrees or impact.paper_agrees,
    )


def overturned(
    level: LevelMotion,
    first: int,
    row: int,
    name: str,
    odds: float,
    felt: tuple[float, float],
    limits: DetectorThresholds,
) -> Impact:
    """A rollover from row ``first`` on without a pulse; ``felt`` the change of velocity and the peak around it."""
    impact = _unfelt(level, first, row, name, odds, limits)
    return replace(
        impact,
        delta_v_mps=felt[0],
        delta_v_sd_mps=felt[0],
        delta_v_interval_mps=(0.0, 3.0 * felt[0]),
        peak_mps2=felt[1],
        severity=Severity.SEVERE,
        kind=Kind.ROLLOVER,
        rollover=True,
        impacts=1,
    )


def deployed(level: LevelMotion, row: int, name: str, odds: float, limits: DetectorThresholds) -> Impact:
    """An airbag that fired, with no impact felt so far: its change of velocity is not known."""
    impact = _unfelt(level, row, row, name, odds, limits)
    return replace(impact, severity=Severity.AIRBAG, reasons=(AIRBAG_DEPLOYED,))


def _unfelt(level: LevelMotion, first: int, row: int, name: str, odds: float, limits: DetectorThresholds) -> Impact:
    return Impact(
        t_ns=int(level.t_ns[first]),
        decided_t_ns=int(level.t_ns[row]),
        detector=name,
        severity=Severity.LOW_SPEED,
        confidence=confidence(odds, limits.judgement),
        delta_v_mps=0.0,
        delta_v_sd_mps=limits.severity.severe_mps,
        delta_v_b_mps=(0.0, 0.0),
        pdof_deg=0.0,
        peak_mps2=0.0,
        duration_s=(int(level.t_ns[row]) - int(level.t_ns[first])) * 1e-9,
        clipped=bool((level.flags[first : row + 1] & CLIPPED).any()),
        speed_before_mps=float(level.x[first, SPEED]),
        paper_agrees=paper_rule.holds_within(level.x, first, row, limits.paper),
        delta_v_interval_mps=(0.0, 2.0 * limits.severity.severe_mps),
        pdof_sd_deg=math.nan,
        impacts=0,
    )
