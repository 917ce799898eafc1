"""Smooth steps from 0 to 1: how a speed, a heading or a crash pulse gets from one value to the next."""

from __future__ import annotations

from enum import Enum
from typing import Final

import numpy as np

from core.measurements import FloatArray


class Shape(Enum):
    """Form of a step's rate over its duration.

    ``EASE`` and ``ABRUPT`` rise by a half cosine, hold, and fall again: a clothoid-like turn, or an
    acceleration with bounded jerk. The others are the crash pulses in common use (haversine, half
    sine, triangle; e.g. Varat & Husher, SAE 2000-01-0850).
    """

    EASE = "ease"
    ABRUPT = "abrupt"
    HAVERSINE = "haversine"
    HALF_SINE = "half_sine"
    TRIANGLE = "triangle"


_RAMP: Final = {Shape.EASE: 0.3, Shape.ABRUPT: 0.1}
"""Share of the duration that the rate takes to rise, and again to fall; a choice."""


def peak_rate(shape: Shape) -> float:
    """Largest rate of a unit step of unit duration: peak over mean of the pulse."""
    if shape in _RAMP:
        return 1.0 / (1.0 - _RAMP[shape])
    return np.pi / 2.0 if shape is Shape.HALF_SINE else 2.0


def step(shape: Shape, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Value and rate of a unit step.

    Parameters
    ----------
    x : (n,) array
        Time as a share of the duration, within [0, 1].

    Returns
    -------
    (n,) value from 0 to 1, (n,) rate, continuous and zero at both ends
    """
    if shape is Shape.HAVERSINE:
        return x - np.sin(2 * np.pi * x) / (2 * np.pi), 1.0 - np.cos(2 * np.pi * x)
    if shape is Shape.HALF_SINE:
        return 0.5 * (1.0 - np.cos(np.pi * x)), 0.5 * np.pi * np.sin(np.pi * x)
    late = x > 0.5
    y = np.where(late, 1.0 - x, x)  # all are symmetric about the middle
    if shape is Shape.TRIANGLE:
        value, rate = 2.0 * y**2, 4.0 * y
    else:
        ramp = _RAMP[shape]
        peak = peak_rate(shape)
        rising = y < ramp
        value = peak * np.where(rising, 0.5 * y - ramp / (2 * np.pi) * np.sin(np.pi * y / ramp), y - 0.5 * ramp)
        rate = peak * np.where(rising, 0.5 * (1.0 - np.cos(np.pi * y / ramp)), 1.0)
    return np.where(late, 1.0 - value, value), rate
