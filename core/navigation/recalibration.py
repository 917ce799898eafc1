"""The filter's biases read, and its state changed where its samples come by another calibration."""

from __future__ import annotations

import numpy as np

from core.earth import STANDARD_GRAVITY_MPS2
from core.measurements import FloatArray, TimeArray
from core.navigation import state
from core.navigation.tuning import Tuning


def biases(x: FloatArray, p: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Biases in b, accelerometer then gyroscope (6,), m/s2 and rad/s, and their covariance (6, 6)."""
    errors = [*range(state.ACCEL_BIAS, state.ACCEL_BIAS + 3), *range(state.GYRO_BIAS, state.GYRO_BIAS + 3)]
    values = np.concatenate([x[state.X_BA : state.X_BA + 3], x[state.X_BG : state.X_BG + 3]])
    return values, p.reshape(state.N_STATES, state.N_STATES)[np.ix_(errors, errors)]


def shift_biases(x: FloatArray, ti: TimeArray, f_b: FloatArray, omega_b: FloatArray) -> None:
    """Have ``x`` as if its samples had shown this much more (m/s2, rad/s) of the same motion."""
    ti[state.T_BIAS] = 0  # no correction moved them
    for group, change in ((state.X_BA, f_b), (state.X_BG, omega_b), (state.X_F, f_b), (state.X_W, omega_b)):
        x[group : group + 3] += change
    both = np.concatenate([f_b, omega_b])
    x[state.X_NEWEST : state.X_NEWEST + 3] += f_b
    x[state.X_VERTICAL : state.X_VERTICAL + state.N_BLOCKS] += f_b[2]
    n = ti[state.I_BLOCK]
    x[state.X_BLOCK : state.X_BLOCK + 6] += both * n
    x[state.X_BLOCK_SUMS : state.X_BLOCK_SUMS + 6] += both * (0.5 * n * (n + 1))
    x[state.X_RISING : state.X_RISING + 6] += both * (0.5 * x[state.X_RISING_N])
    x[state.X_RING : state.NX].reshape(state.N_BLOCKS, 6)[: ti[state.I_BLOCKS]] += both


def loosen_biases(p: FloatArray, accel_sd_mps2: float, gyro_sd_radps: float) -> None:
    """Have the biases less sure by so much, and the tilt by what such a bias of the accelerometers made of it."""
    covariance = p.reshape(state.N_STATES, state.N_STATES)
    tilt_sd_rad = accel_sd_mps2 / STANDARD_GRAVITY_MPS2
    for first, count, sd in (
        (state.ACCEL_BIAS, 3, accel_sd_mps2),
        (state.GYRO_BIAS, 3, gyro_sd_radps),
        (state.ATT, 2, tilt_sd_rad),
    ):
        places = np.arange(first, first + count)
        covariance[places, places] += sd * sd


def forget_biases(x: FloatArray, ti: TimeArray, p: FloatArray, tuning: Tuning) -> None:
    """Have the biases as unknown as at first, and independent of everything."""
    ti[state.T_BIAS] = 0  # no correction moved them
    covariance = p.reshape(state.N_STATES, state.N_STATES)
    for place, error, sd in (
        (state.X_BA, state.ACCEL_BIAS, tuning.accel_bias_sd_mps2),
        (state.X_BG, state.GYRO_BIAS, tuning.gyro_bias_sd_radps),
    ):
        axes = np.arange(error, error + 3)
        x[place : place + 3] = 0.0
        covariance[axes, :] = 0.0
        covariance[:, axes] = 0.0
        covariance[axes, axes] = sd * sd
