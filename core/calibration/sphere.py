"""Directions spread evenly over a sphere."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from core.measurements import FloatArray

GOLDEN_RAD: Final = math.pi * (3.0 - math.sqrt(5.0))
"""Golden angle: points of a spiral that far apart in longitude cover a sphere evenly (Gonzalez 2010)."""


def directions(count: int) -> FloatArray:
    """Unit vectors (count, 3), each of which stands for the same share of the sphere."""
    z = 1.0 - (2.0 * np.arange(count) + 1.0) / count
    longitude, level = GOLDEN_RAD * np.arange(count), np.sqrt(1.0 - z * z)
    return np.column_stack([level * np.cos(longitude), level * np.sin(longitude), z])
