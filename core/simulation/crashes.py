"""Crashes: how much velocity is lost, from where, how fast, and how the car is spun."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from core.accident.severity import classify
from core.accident.thresholds import SeverityThresholds
from core.errors import InvalidInputError
from core.simulation.shapes import Shape, peak_rate


@dataclass(frozen=True, slots=True)
class Crash:
    """One collision as the vehicle's structure passes it on.

    Parameters
    ----------
    delta_v_mps : float
        Length of the change of horizontal velocity, m/s, 0.5 to 25.
    pdof_deg : float
        Where the force comes from, clockwise seen from above: 0 front, 90 right, 180 rear, 270 left.
    duration_s : float
        Length of the pulse, s, 0.02 to 1. Barrier and car-to-car crashes take 0.08 to 0.15 s, a glancing
        blow along a yielding side up to 0.3 s.
    shape : Shape
        HAVERSINE, HALF_SINE or TRIANGLE.
    yaw_deg : float
        Change of heading by the crash, deg, clockwise.

    Raises
    ------
    InvalidInputError
        If a value lies outside its range.
    """

    delta_v_mps: float
    pdof_deg: float = 0.0
    duration_s: float = 0.12
    shape: Shape = Shape.HAVERSINE
    yaw_deg: float = 0.0

    def __post_init__(self) -> None:
        if not 0.5 <= self.delta_v_mps <= 25.0:
            raise InvalidInputError(f"crash delta_v_mps is {self.delta_v_mps}: expected 0.5 to 25 m/s")
        if not 0.02 <= self.duration_s <= 1.0:
            raise InvalidInputError(f"crash duration_s is {self.duration_s}: expected 0.02 to 1 s")
        if not math.isfinite(self.pdof_deg) or not abs(self.yaw_deg) <= 180.0:
            raise InvalidInputError("crash pdof_deg must be finite and yaw_deg within 180 degrees")

    @property
    def delta_v_b_mps(self) -> tuple[float, float]:
        """Change of velocity forward and right, m/s: away from where the force comes from."""
        angle = math.radians(self.pdof_deg)
        return -self.delta_v_mps * math.cos(angle), -self.delta_v_mps * math.sin(angle)

    @property
    def peak_mps2(self) -> float:
        """Largest acceleration of the pulse, m/s2."""
        return peak_rate(self.shape) * self.delta_v_mps / self.duration_s

    def clips(self, full_scale_mps2: float) -> bool:
        """Whether the pulse alone exceeds an accelerometer's range on the forward or right axis."""
        angle = math.radians(self.pdof_deg)
        return self.peak_mps2 * max(abs(math.cos(angle)), abs(math.sin(angle))) > full_scale_mps2

    @property
    def severity(self) -> str:
        """Class of the seed, by the very rule that detectors use."""
        return classify(self.delta_v_mps, self.duration_s, SeverityThresholds()).value


GLANCING: Final = Crash(delta_v_mps=3.6, pdof_deg=35.0, duration_s=0.3, shape=Shape.HALF_SINE, yaw_deg=-9.0)
"""Low-speed, against a parked car's corner at the front right: peak 1.9 g, so that a 2 g sensor does not clip."""

FRONT_BUMP: Final = Crash(delta_v_mps=4.2, pdof_deg=0.0, duration_s=0.13, shape=Shape.HAVERSINE, yaw_deg=2.0)
"""Low-speed, into the car ahead: peak 6.6 g."""

STRUCK_AT_REST: Final = Crash(delta_v_mps=3.2, pdof_deg=180.0, duration_s=0.11, shape=Shape.HAVERSINE)
"""Low-speed, from behind while standing: peak 5.9 g."""

SEVERE_FRONTAL: Final = Crash(delta_v_mps=10.2, pdof_deg=352.0, duration_s=0.14, shape=Shape.HAVERSINE, yaw_deg=14.0)
"""Severe, and fast enough for airbags: frontal, slightly left; peak 15 g clips a 2 g sensor, not a 16 g one."""

SEVERE_SIDE: Final = Crash(delta_v_mps=8.0, pdof_deg=78.0, duration_s=0.14, shape=Shape.TRIANGLE, yaw_deg=-55.0)
"""Severe, from the right in a crossing: peak 11.7 g."""
