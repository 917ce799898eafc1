"""What an impact means: its class, how sure it is, and where the force came from."""

from __future__ import annotations

import math

from core.accident.events import Severity
from core.accident.thresholds import SeverityThresholds


def classify(delta_v_mps: float, duration_s: float, thresholds: SeverityThresholds) -> Severity:
    """Class of a change of velocity that took ``duration_s`` (Seed 1, section 3.3).

    Airbags fire from ``airbag_mps`` on when it comes as fast as a collision; the same change spread over up to
    a second is severe, and so is what exceeds ``severe_mps``.
    """
    fast_mps = delta_v_mps * min(1.0, thresholds.airbag_s / max(duration_s, 1e-3))
    if fast_mps >= thresholds.airbag_mps:
        return Severity.AIRBAG
    return Severity.SEVERE if delta_v_mps >= thresholds.severe_mps else Severity.LOW_SPEED


def confidence(excess_mps: float, margin_mps: float, sd_mps: float) -> float:
    """Confidence in 0..1 that a change of velocity ``excess_mps`` beyond what tyres can do was an impact.

    e2 / (1 + e2) of the excess e in units of the margin and of its own sd together: one half where the
    excess just equals them; it grows with the excess and falls with its sd. A choice, not yet calibrated on crashes.
    """
    evidence2 = max(excess_mps, 0.0) ** 2 / (margin_mps**2 + sd_mps**2)
    return evidence2 / (1.0 + evidence2)


def force_direction_deg(forward_mps: float, right_mps: float) -> float:
    """Principal direction of force in [0, 360): opposite to the change of velocity; 0 front, 90 right."""
    angle = math.degrees(math.atan2(-right_mps, -forward_mps)) % 360.0
    return 0.0 if angle == 360.0 else angle
