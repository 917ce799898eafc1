"""Units in which data sheets give a sensor's noise."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

_DEG: Final = math.degrees(1.0)

CUSTOMARY: Final[Mapping[str, Mapping[str, tuple[str, float]]]] = {
    "accelerometer": {
        "random_walk": ("m/s/√h", 60.0),
        "bias_instability": ("mm/s²", 1e3),
        "rate_random_walk": ("mm/s²/√h", 6e4),
        "floor": ("mm/s²", 1e3),
    },
    "gyroscope": {
        "random_walk": ("°/√h", 60.0 * _DEG),
        "bias_instability": ("°/h", 3600.0 * _DEG),
        "rate_random_walk": ("°/h/√h", 3600.0 * 60.0 * _DEG),
        "floor": ("°/h", 3600.0 * _DEG),
    },
}
"""For each noise its unit, and how many of it are one SI unit."""
