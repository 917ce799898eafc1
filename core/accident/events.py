"""What an accident detector says: an impact in the vehicle's own frame, without a place."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from core.measurements import FloatArray, TimeArray


class Severity(StrEnum):
    """Seed 1's classes: low-speed, severe (7-12 m/s within 1 s), airbag (25-40 km/h and above)."""

    LOW_SPEED = "low_speed"
    SEVERE = "severe"
    AIRBAG = "airbag"


@dataclass(frozen=True, slots=True, eq=False)
class VehicleMotion:
    """Calibrated samples with what the filter knows at each of them: a detector's input.

    Parameters
    ----------
    t_ns : (n,) int64
    f_b : (n, 3) specific force, m/s2, body axes, calibrated, not denoised
    omega_b : (n, 3) angular rate, rad/s
    down_b : (n, 3) unit vector of the local vertical (down) in body axes, from the fused attitude;
        NaN rows while the filter has no attitude
    speed_mps : (n,) fused horizontal speed; NaN while unknown
    gravity_mps2 : local gravity
    saturated : (n,) uint8, 1 where an axis of the accelerometer read its full scale
    """

    t_ns: TimeArray
    f_b: FloatArray
    omega_b: FloatArray
    down_b: FloatArray
    speed_mps: FloatArray
    saturated: FloatArray
    gravity_mps2: float


@dataclass(frozen=True, slots=True)
class Impact:
    """One accident as felt by the vehicle.

    ``t_ns`` is the impact's start, ``decided_t_ns`` the sample at which it was decided.
    ``delta_v_b_mps`` is forward and right change of velocity; ``delta_v_mps`` its length with
    ``delta_v_sd_mps``. ``pdof_deg`` is where the force came from, clockwise seen from above:
    0 front, 90 right, 180 rear, 270 left. ``confidence`` is in 0..1. An accident whose later impact is worse
    than what was told is told again: the same ``t_ns``, the next ``revision``.
    """

    t_ns: int
    decided_t_ns: int
    detector: str
    severity: Severity
    confidence: float
    delta_v_mps: float
    delta_v_sd_mps: float
    delta_v_b_mps: tuple[float, float]
    pdof_deg: float
    peak_mps2: float
    duration_s: float
    clipped: bool
    speed_before_mps: float
    paper_agrees: bool
    revision: int = 0
