"""Impacts made and remade where no pulse tells them: by a tilt, by an airbag, by what rest says of clipping."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from core.accident import paper_rule
from core.accident.events import Impact, Kind, Severity
from core.accident.judgement import AIRBAG_DEPLOYED, confidence
from core.accident.level import CLIPPED, SPEED, LevelMotion
from core.accident.severity import classify, force_direction_deg, force_direction_sd_deg, injury_risk
from core.accident.thresholds import DetectorThresholds
from core.measurements import FloatArray


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
