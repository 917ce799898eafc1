"""Disturbances laid over a drive's exact truth: what shakes the car is added, where it goes is not changed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.signal import butter, sosfiltfilt

from core.earth import STANDARD_GRAVITY_MPS2
from core.measurements import FloatArray
from core.simulation.body_motion import rate_b
from core.simulation.disturbances import Disturbance
from core.simulation.ride import FINE_HZ
from core.simulation.trajectory import Trajectory, matrices_b_from_n


def laid_over(truth: Trajectory, disturbances: Sequence[tuple[float, Disturbance]]) -> Trajectory:
    """The trajectory with each disturbance from its time (s) on, low-passed for the trajectory's rate.

    A disturbance must leave the car as it found it: what it would change of the horizontal velocity is taken back
    evenly while it lasts, so that specific force and path belong together to some centimetres.
    """
    if not disturbances:
        return truth
    f_b, omega_b, rpy = truth.f_b.copy(), truth.omega_b.copy(), truth.rpy_rad.copy()
    rate_hz = 1.0 / float(truth.t_s[1] - truth.t_s[0])
    smooth = butter(2, min(0.4 * rate_hz, 0.45 * FINE_HZ), fs=FINE_HZ, output="sos")
    for start_s, one in disturbances:
        begin, end = np.searchsorted(truth.t_s, [start_s, start_s + one.duration_s])
        since_s = truth.t_s[begin:end] - start_s
        fine_s = np.arange(one.speed_mps.size) / FINE_HZ
        accel = sosfiltfilt(smooth, _balanced(one.accel_b), axis=0)
        turned_rpy = rpy[begin:end] + _at(since_s, fine_s, one.rpy_rad)
        before, after = (matrices_b_from_n(angles)[:, :, 2] for angles in (rpy[begin:end], turned_rpy))
        f_b[begin:end] += _at(since_s, fine_s, accel) - STANDARD_GRAVITY_MPS2 * (after - before)
        omega_b[begin:end] += _at(since_s, fine_s, rate_b(one.rpy_rad))
        rpy[begin:end] = turned_rpy
    return replace(truth, f_b=f_b, omega_b=omega_b, rpy_rad=rpy)


def _balanced(accel_b: FloatArray) -> FloatArray:
    """Without change of velocity over the whole."""
    return np.asarray(accel_b - accel_b.mean(axis=0))


def _at(since_s: FloatArray, fine_s: FloatArray, rows: FloatArray) -> FloatArray:
    return np.column_stack([np.interp(since_s, fine_s, column) for column in rows.T])
