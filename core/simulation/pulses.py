"""Crash pulses as accelerations over time: of analytic shapes, recorded ones resampled, and the ringing on them."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from scipy.signal import butter, sosfiltfilt

from core.errors import InvalidInputError
from core.measurements import FloatArray
from core.simulation.body_motion import band_noise
from core.simulation.ride import FINE_HZ
from core.simulation.shapes import Shape, step

CRASH_SHAPES: Final = (Shape.HAVERSINE, Shape.HALF_SINE, Shape.TRIANGLE)


def shaped_pulse(shape: Shape, duration_s: float) -> FloatArray:
    """A pulse of unit area at ``FINE_HZ``, (n,), 1/s; its samples sum to ``FINE_HZ``, however short it is."""
    n = max(round(duration_s * FINE_HZ), 2)
    _, rate = step(shape, (np.arange(n) + 0.5) / n)
    return np.asarray(rate * (FINE_HZ / rate.sum()))


def recorded_pulse(t_s: FloatArray, accel_mps2: FloatArray, cut_hz: float = 300.0) -> FloatArray:
    """A recorded pulse at ``FINE_HZ``, low-passed before it is resampled.

    Parameters
    ----------
    t_s : (k,) even times of the recording, s
    accel_mps2 : (k,) or (k, c) acceleration, m/s2, offset removed
    cut_hz : float
        Of a Butterworth filter of order 2 run both ways, as SAE J211's channel classes are (CFC 180: 300 Hz).

    Returns
    -------
    (n,) or (n, c), from the first of ``t_s`` on

    Raises
    ------
    InvalidInputError
        If times do not increase evenly, or the recording is too slow for ``cut_hz``.
    """
    steps = np.diff(t_s)
    if t_s.size < 32 or not steps.min() > 0.0 or steps.max() - steps.min() > 0.1 * steps.mean():
        raise InvalidInputError("a recorded pulse: expected at least 32 times that increase evenly")
    rate_hz = 1.0 / float(steps.mean())
    if not 0.0 < cut_hz < 0.45 * min(rate_hz, FINE_HZ):
        raise InvalidInputError(
            f"a pulse recorded at {rate_hz:.0f} Hz: expected cut_hz below {0.45 * min(rate_hz, FINE_HZ):.0f} Hz"
        )
    smooth = sosfiltfilt(butter(2, cut_hz, fs=rate_hz, output="sos"), accel_mps2, axis=0)
    at_s = np.arange(math.floor((t_s[-1] - t_s[0]) * FINE_HZ) + 1) / FINE_HZ + t_s[0]
    columns = smooth.reshape(t_s.size, -1)
    found = np.column_stack([np.interp(at_s, t_s, column) for column in columns.T])
    return np.asarray(found[:, 0] if accel_mps2.ndim == 1 else found)


def ringing(strength_mps2: FloatArray, share: float, rng: np.random.Generator) -> FloatArray:
    """What the structure adds to a pulse, (n, 3), m/s2: noise of 30 to 150 Hz as strong as a share of it.

    Real pulses are not smooth: in NHTSA test 10146 what stands above 25 Hz has a third of the pulse's RMS.
    It has no share at 0 Hz, and rings on for some 30 ms.
    """
    n = strength_mps2.size
    fade = np.exp(-np.arange(round(0.15 * FINE_HZ)) / (0.03 * FINE_HZ))
    envelope = np.convolve(np.abs(strength_mps2), fade / fade.sum(), mode="full")[:n]
    noise = 0.7 * band_noise(n, rng.uniform(30.0, 60.0), 0.2, rng) + 0.7 * band_noise(
        n, rng.uniform(60.0, 150.0), 0.2, rng
    )
    return share * envelope[:, None] * noise
