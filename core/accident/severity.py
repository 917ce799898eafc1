"""What an impact means: its class, where the force came from, and what it may have done to people."""

from __future__ import annotations

import math
from typing import Final

from core.accident.events import InjuryRisk, Severity
from core.accident.judgement import probability
from core.accident.thresholds import PulseThresholds, SeverityThresholds


def classify(delta_v_mps: float, duration_s: float, thresholds: SeverityThresholds) -> Severity:
    """Class of a change of velocity that took ``duration_s`` (Seed 1, section 3.3).

    Airbags fire from ``airbag_mps`` on when it comes as fast as a collision; the same change spread over up to
    a second is severe, and so is what exceeds ``severe_mps``.
    """
    fast_mps = delta_v_mps * min(1.0, thresholds.airbag_s / max(duration_s, 1e-3))
    if fast_mps >= thresholds.airbag_mps:
        return Severity.AIRBAG
    return Severity.SEVERE if delta_v_mps >= thresholds.severe_mps else Severity.LOW_SPEED


def force_direction_deg(forward_mps: float, right_mps: float) -> float:
    """Principal direction of force in [0, 360): opposite to the change of velocity; 0 front, 90 right."""
    angle = math.degrees(math.atan2(-right_mps, -forward_mps)) % 360.0
    return 0.0 if angle == 360.0 else angle


def force_direction_sd_deg(
    delta_v_mps: float, across_sd_mps: float, thresholds: PulseThresholds, hidden_rad: float = 0.0
) -> float:
    """Spread of the direction: what errs across the change of velocity, how the box sits, and what clipping
    hides of it; at most uniform."""
    across = math.atan2(across_sd_mps, max(delta_v_mps, 1e-3))
    return min(math.degrees(math.hypot(across, thresholds.yaw_sd_rad, hidden_rad)), UNIFORM_DEG)


UNIFORM_DEG: Final = 360.0 / math.sqrt(12.0)

KNOWN_DELTA_V_MPS: Final = 30.0 * 0.44704
KNOWN_RISK: Final = {"front": (0.389, 0.389), "side": (0.478, 0.838), "rear": (0.199, 0.199)}
"""Share of MAIS 3+ injuries at 30 mph Delta-v, of far side and near side where it was a side; PMC3217552."""
RISK_AT_REST: Final = (0.0005, 0.01)
"""Between what such a share is taken to lie as Delta-v goes to zero: an assumption, the sources give one point each."""
INJURY_SOURCE: Final = "PMC3217552 at 30 mph, interpolated by logistic curves from an assumed 0.05-1 % at rest"


def injury_risk(delta_v_interval_mps: tuple[float, float], pdof_deg: float) -> InjuryRisk:
    """Probability of a MAIS 3+ injury of a front occupant.

    A logistic curve of the change of velocity through the one published point for the direction and through the
    assumed risk at rest; the interval spans both assumptions, near and far side, and the interval of Delta-v.
    """
    off_front = abs(math.remainder(pdof_deg, 360.0))
    side = "front" if off_front <= 45.0 else "rear" if off_front >= 135.0 else "side"
    curves = [(_log_odds(at_rest), _log_odds(known)) for known in KNOWN_RISK[side] for at_rest in RISK_AT_REST]

    def odds(delta_v_mps: float) -> list[float]:
        return [rest + (known - rest) * delta_v_mps / KNOWN_DELTA_V_MPS for rest, known in curves]

    low_mps, high_mps = delta_v_interval_mps
    low, high = min(odds(low_mps)), max(odds(high_mps))
    middle = odds(0.5 * (low_mps + high_mps))
    return InjuryRisk(probability(sum(middle) / len(middle)), probability(low), probability(high), source=INJURY_SOURCE)


def _log_odds(share: float) -> float:
    return math.log(share / (1.0 - share))
