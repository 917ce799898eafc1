"""The filter's state and covariance at the instant at which an alignment was found."""

from __future__ import annotations

from typing import Final

import numpy as np

from core.measurements import FloatArray, TimeArray
from core.navigation import state
from core.navigation.alignment import InitialState
from core.navigation.mechanization import normalised, renew_mounting, start_frame
from core.navigation.tuning import Tuning
from core.rotation import matrix_from_quaternion

WHITE_SHARE_FIXES: Final = 10.0
"""How many fixes the share of white error assumed at the start is worth. A choice; 1 to some 60."""

KEPT: Final = {
    **{state.ACCEL_BIAS + i: state.X_BA + i for i in range(3)},
    state.SPEED_SCALE: state.X_SCALE,
    state.MOUNT_PITCH: state.X_MOUNT_PITCH,
    state.MOUNT_YAW: state.X_MOUNT_YAW,
    state.GNSS_DELAY: state.X_GNSS_DELAY,
    state.GYRO_SCALE: state.X_GYRO_SCALE,
}
"""What a gap does not change, besides the gyroscopes' biases: each error state and its place in ``x``."""


def begin(
    x: FloatArray,
    ti: TimeArray,
    found: InitialState,
    kept: FloatArray | None,
    tuning: Tuning,
    mount_angle_sd_rad: float,
    given_offset: bool,
) -> FloatArray:
    """Set the state to what an alignment found.

    Parameters
    ----------
    x, ti : (NX,), (NT,) changed in place; the counters stay
    found : position, velocity, attitude and gyroscope bias with their spread
    kept : (N_STATES, N_STATES) covariance before, where what was learnt of the box still holds, else None
    mount_angle_sd_rad : of the mounting's pitch and yaw
    given_offset : whether the time offset of fixes was measured

    Returns
    -------
    (N_STATES, N_STATES) covariance
    """
    before = x.copy()
    x[state.X_Q : state.X_Q + 4] = normalised(found.q_n_from_b)
    x[state.X_V : state.X_V + 3] = found.v_n
    x[state.X_LAT], x[state.X_LON], x[state.X_ALT] = found.lat_rad, found.lon_rad, found.alt_m
    x[state.X_BG : state.X_BG + 3] = found.gyro_bias_radps
    x[state.X_DV : state.X_DV + 3] = 0.0
    x[state.X_BLOCK : state.X_STILL_F] = 0.0
    x[state.X_GNSS_ERROR : state.NX] = 0.0
    x[list(KEPT.values())] = 0.0
    x[state.X_WHITE_SHARE], x[state.X_WHITE_FIXES] = tuning.gnss_white_share, WHITE_SHARE_FIXES
    # The position is a fix: what of that fix is slow error is the position's as well, with its sign turned.
    slow = max(0.0, 1.0 - tuning.gnss_white_share - tuning.gnss_share_margin)
    x[state.X_SLOW_VAR : state.X_SLOW_VAR + 2] = slow * np.square(found.position_sd_m)

    ti[: state.I_COUNTS] = 0
    ti[[state.T_NOW, state.T_COV, state.T_GNSS, state.T_DECAY]] = found.t_ns - 1
    # The first sample at or after the second opens every grid.
    ti[[state.T_NEXT_BLOCK, state.T_NEXT_COVARIANCE, state.T_NEXT_CONSTRAINT, state.T_NEXT_OUTPUT]] = found.t_ns
    start_frame(x, ti)
    x[state.X_C0 : state.X_C0 + 9] = matrix_from_quaternion(x[state.X_Q : state.X_Q + 4]).reshape(9)

    p = _covariance(found, slow, tuning, mount_angle_sd_rad, given_offset)
    if kept is not None:
        for error_state, place in KEPT.items():
            x[place] = before[place]
            p[error_state, error_state] = kept[error_state, error_state]
        biases = np.arange(state.GYRO_BIAS, state.GYRO_BIAS + 3)
        variance = kept[biases, biases]
        if variance.max() < found.gyro_bias_sd_radps**2:
            x[state.X_BG : state.X_BG + 3] = before[state.X_BG : state.X_BG + 3]
            p[biases, biases] = variance
    renew_mounting(x)
    return p


def _covariance(
    found: InitialState, slow: float, tuning: Tuning, mount_angle_sd_rad: float, given_offset: bool
) -> FloatArray:
    """Of a state of which nothing was known before; ``slow`` is the share of a fix's variance that hangs together."""
    sd = np.empty(state.N_STATES)
    sd[state.POS : state.POS + 2], sd[state.POS + 2] = found.position_sd_m
    sd[state.VEL : state.VEL + 3] = found.velocity_sd_mps
    sd[state.ATT : state.ATT + 2], sd[state.ATT + 2] = found.tilt_sd_rad, found.yaw_sd_rad
    sd[state.GYRO_BIAS : state.GYRO_BIAS + 3] = found.gyro_bias_sd_radps
    sd[state.ACCEL_BIAS : state.ACCEL_BIAS + 3] = tuning.accel_bias_sd_mps2
    sd[state.SPEED_SCALE] = tuning.speed_scale_sd
    sd[state.MOUNT_PITCH] = sd[state.MOUNT_YAW] = mount_angle_sd_rad
    sd[state.GNSS_DELAY] = tuning.gnss_delay_given_sd_s if given_offset else tuning.gnss_delay_sd_s
    sd[state.BARO_BIAS] = tuning.baro_bias_sd_m
    sd[state.GYRO_SCALE] = tuning.gyro_scale_sd
    sd[state.GNSS_ERROR : state.GNSS_ERROR + 3] = np.sqrt(slow) * sd[state.POS : state.POS + 3]
    p = np.diag(sd * sd)
    places, errors = np.arange(state.POS, state.POS + 3), np.arange(state.GNSS_ERROR, state.GNSS_ERROR + 3)
    p[places, errors] = p[errors, places] = -(sd[errors] ** 2)
    return np.asarray(p)
