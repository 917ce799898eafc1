"""Hazards that were detected and explain a braking: an accident on the way ahead, a pothole that was struck.

Speed bumps, kerbs and railway crossings are felt, too, and explain none: they are where they always were, and signed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from core.earth import ned_offset_m
from core.tunables import Tunables, tunable


@dataclass(frozen=True, slots=True)
class HazardTuning(Tunables):
    """How near a hazard has to be, in place and in time."""

    ahead_m: float = tunable(
        500.0,
        unit="m",
        low=0.0,
        high=5000.0,
        source="choice: 285 m to stop from 130 km/h (AASHTO Green Book, stopping sight distance), and a queue's length",
    )
    beside_m: float = tunable(
        50.0, unit="m", low=0.0, high=500.0, source="choice: so near is the scene itself, in whatever direction"
    )
    cone_rad: float = tunable(
        0.8, unit="rad", low=0.0, high=3.2, source="choice: 45 deg off the course is ahead still, as roads bend"
    )
    lasts_s: float = tunable(
        3600.0, unit="s", low=0.0, high=86_400.0, source="choice: most scenes are cleared, and queues gone, in an hour"
    )
    after_s: float = tunable(
        2.0, unit="s", low=0.0, high=30.0, source="choice: who brakes for a hole strikes it before speeding up again"
    )


@dataclass(frozen=True, slots=True)
class Braking:
    """A braking, with the place and the course of its beginning; NaN where these are not known."""

    start_t_ns: int
    end_t_ns: int
    lat_rad: float = math.nan
    lon_rad: float = math.nan
    course_rad: float = math.nan


def accident_explains(
    braking: Braking, t_ns: int, lat_rad: float, lon_rad: float, tuning: HazardTuning | None = None
) -> bool:
    """Whether somebody else's accident at a time and place explains a braking.

    It has to have happened before the braking was over, at most ``lasts_s`` before it began, and to lie within
    ``ahead_m`` and ``cone_rad`` of the way that was driven, or within ``beside_m``. What is not known explains nothing.
    """
    tuning = tuning or HazardTuning()
    if not braking.start_t_ns - round(1e9 * tuning.lasts_s) <= t_ns <= braking.end_t_ns:
        return False
    if not math.isfinite(braking.lat_rad + braking.lon_rad + lat_rad + lon_rad):
        return False
    origin = (braking.lat_rad, braking.lon_rad, 0.0)
    at = np.array([lat_rad]), np.array([lon_rad]), np.zeros(1)
    north_m, east_m, _ = ned_offset_m(*at, origin)[0].tolist()
    distance_m = math.hypot(north_m, east_m)
    if distance_m <= tuning.beside_m:
        return True
    off_rad = abs(math.remainder(math.atan2(east_m, north_m) - braking.course_rad, math.tau))
    return distance_m <= tuning.ahead_m and off_rad <= tuning.cone_rad  # never where the course is NaN


def pothole_explains(braking: Braking, t_ns: int, tuning: HazardTuning | None = None) -> bool:
    """Whether a pothole that the vehicle itself struck explains a braking: while it lasted, or ``after_s`` later."""
    tuning = tuning or HazardTuning()
    return braking.start_t_ns <= t_ns <= braking.end_t_ns + round(1e9 * tuning.after_s)
