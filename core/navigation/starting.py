"""The filter's state and covariance at the instant at which an alignment was found, and what is told until then."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from core.earth import radii_m
from core.measurements import GNSS, FloatArray, TimeArray
from core.navigation import state
from core.navigation.alignment import SECOND_NS, Aligner, InitialState
from core.navigation.fix_error import slow_share
from core.navigation.mechanization import normalised, renew_mounting, start_frame
from core.navigation.track import TRACK, TRACK_COLUMNS, Mode, Track
from core.navigation.tuning import Tuning
from core.rotation import matrix_from_quaternion

WHITE_SHARE_FIXES: Final = 10.0
"""How many fixes the share of white error assumed at the start is worth. A choice; 1 to some 60."""

USUAL_SD: Final = 2.0
"""Up to so many times its sd an error is nothing unusual: beyond, that sd is too small. 95 % of a normal error."""

KEPT: Final = {
    **{state.ACCEL_BIAS + i: state.X_BA + i for i in range(3)},
    state.SPEED_SCALE: state.X_SCALE,
    state.MOUNT_PITCH: state.X_MOUNT_PITCH,
    state.MOUNT_YAW: state.X_MOUNT_YAW,
    state.GYRO_SCALE: state.X_GYRO_SCALE,
}
"""What a gap does not change, besides the gyroscopes' biases: each error state and its place in ``x``. The delay of
fixes stays likewise, but not its spread."""

LEARNT_OF_FIXES: Final = slice(state.X_WHITE_SHARE, state.X_WHITE_FIXES + 1)
LEARNT_OF_DRIFT: Final = slice(state.X_DRIFT, state.X_DRIFTS + 1)
LEARNT_OF_SPRINGS: Final = slice(state.X_SQUAT, state.X_SQUAT_VAR + 1)
LEARNT_OF_AXES: Final = slice(state.X_AXES_VAR, state.X_AXES_VAR + 1)
PLACES: Final = np.arange(state.POS, state.POS + 3)
ERRORS: Final = np.arange(state.GNSS_ERROR, state.GNSS_ERROR + 3)


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
    since_s = (found.t_ns - int(ti[state.T_DECAY])) * 1e-9
    x[state.X_GNSS_ERROR : state.NX] = 0.0
    x[list(KEPT.values())] = 0.0
    x[state.X_WHITE_SHARE], x[state.X_WHITE_FIXES] = tuning.gnss_white_share, WHITE_SHARE_FIXES
    x[state.X_MOVING], x[state.X_WORSE] = 1.0, 1.0
    x[state.X_SQUAT], x[state.X_SQUAT_VAR] = tuning.squat_rad_per_mps2, tuning.squat_sd_rad_per_mps2**2
    if kept is not None:
        x[LEARNT_OF_FIXES] = before[LEARNT_OF_FIXES]
        x[LEARNT_OF_DRIFT] = before[LEARNT_OF_DRIFT]
        x[LEARNT_OF_SPRINGS] = before[LEARNT_OF_SPRINGS]
        x[state.X_WARMING] = before[state.X_WARMING]  # of the box, not of its way
        x[LEARNT_OF_AXES] = before[LEARNT_OF_AXES]
    slow = slow_share(x, tuning.as_array())
    x[state.X_SLOW_VAR : state.X_SLOW_VAR + 2] = slow * np.square(found.position_sd_m)

    ti[: state.I_COUNTS] = 0
    ti[[state.T_NOW, state.T_COV, state.T_GNSS, state.T_DECAY]] = found.t_ns - 1
    # The first sample at or after the second opens every grid.
    ti[[state.T_NEXT_BLOCK, state.T_NEXT_COVARIANCE, state.T_NEXT_CONSTRAINT, state.T_NEXT_OUTPUT]] = found.t_ns
    start_frame(x, ti)
    x[state.X_C0 : state.X_C0 + 9] = matrix_from_quaternion(x[state.X_Q : state.X_Q + 4]).reshape(9)

    p = _covariance(found, tuning, mount_angle_sd_rad, given_offset)
    fix_sd_m = np.array([found.position_sd_m[0], found.position_sd_m[0], found.position_sd_m[1]])
    slow_m2 = slow * fix_sd_m**2
    if kept is not None:
        slow_m2 = _carry_fix_error(x, before, kept, slow_m2, since_s / tuning.gnss_correlation_s)
    # The position is a fix: what of that fix is slow error is the position's as well, with its sign turned.
    p[PLACES, PLACES] = (1.0 - slow) * fix_sd_m**2 + slow_m2
    p[ERRORS, ERRORS] = slow_m2
    p[PLACES, ERRORS] = p[ERRORS, PLACES] = -slow_m2
    if kept is not None:
        for error_state, place in KEPT.items():
            x[place] = before[place]
            p[error_state, error_state] = kept[error_state, error_state]
        # As unsure as at first: a receiver that was away may have begun anew.
        x[state.X_GNSS_DELAY] = before[state.X_GNSS_DELAY]
        biases = np.arange(state.GYRO_BIAS, state.GYRO_BIAS + 3)
        variance = kept[biases, biases]
        if variance.max() < found.gyro_bias_sd_radps**2:
            x[state.X_BG : state.X_BG + 3] = before[state.X_BG : state.X_BG + 3]
            p[biases, biases] = variance
    renew_mounting(x)
    return p


def fix_row(aligner: Aligner, boundary_ns: int) -> Track:
    """Where GNSS alone puts the vehicle, for those who watch while the filter aligns: a row, or none without a fix in
    the second before a time."""
    gnss_t, gnss = aligner.gnss_t_ns, aligner.gnss
    recent = gnss_t >= boundary_ns - SECOND_NS
    if not recent.any():
        return Track.joined([])
    fix = gnss[recent][-1]
    row = np.full((1, len(TRACK_COLUMNS)), np.nan)
    for name in ("lat_rad", "lon_rad", "alt_m", "vn_mps", "ve_mps", "vd_mps"):
        row[0, TRACK[name]] = fix[GNSS[name]]
    sd_h_m, sd_v_m = aligner.fix_sd_m(fix)
    row[0, TRACK["sd_n_m"]] = row[0, TRACK["sd_e_m"]] = sd_h_m
    row[0, TRACK["sd_d_m"]] = sd_v_m
    row[0, TRACK["cov_ne_m2"]] = 0.0
    row[0, TRACK["gnss_used"]] = 1.0
    row[0, TRACK["mode"]] = Mode.ALIGNING
    return Track(gnss_t[recent][-1:], row)


def _carry_fix_error(
    x: FloatArray, before: FloatArray, kept: FloatArray, stated_m2: FloatArray, ages: float
) -> FloatArray:
    """Move the position by what the fixes were off before and still are, ``ages`` correlation times later.

    A receiver that was off by more than is usual for what it states may be so again. Returns the variance (3,) of its
    error.
    """
    share = math.exp(-ages)
    error_n_m = before[state.X_GNSS_ERROR : state.X_GNSS_ERROR + 3]
    left_n_m = share * error_n_m
    meridian_m, transverse_m = radii_m(float(x[state.X_LAT]))
    x[state.X_GNSS_ERROR : state.X_GNSS_ERROR + 3] = left_n_m
    x[state.X_LAT] -= left_n_m[0] / (meridian_m + x[state.X_ALT])
    x[state.X_LON] -= left_n_m[1] / ((transverse_m + x[state.X_ALT]) * math.cos(x[state.X_LAT]))
    x[state.X_ALT] += left_n_m[2]
    lasting_m2 = np.maximum(stated_m2, (error_n_m / USUAL_SD) ** 2)
    return np.asarray(share**2 * kept[ERRORS, ERRORS] + (1.0 - share**2) * lasting_m2)


def _covariance(found: InitialState, tuning: Tuning, mount_angle_sd_rad: float, given_offset: bool) -> FloatArray:
    """Of a state of which nothing was known before, without what fixes are off by."""
    sd = np.zeros(state.N_STATES)
    sd[state.VEL : state.VEL + 3] = found.velocity_sd_mps
    sd[state.ATT : state.ATT + 2], sd[state.ATT + 2] = found.tilt_sd_rad, found.yaw_sd_rad
    sd[state.GYRO_BIAS : state.GYRO_BIAS + 3] = found.gyro_bias_sd_radps
    sd[state.ACCEL_BIAS : state.ACCEL_BIAS + 3] = tuning.accel_bias_sd_mps2
    sd[state.SPEED_SCALE] = tuning.speed_scale_sd
    sd[state.MOUNT_PITCH] = sd[state.MOUNT_YAW] = mount_angle_sd_rad
    sd[state.GNSS_DELAY] = tuning.gnss_delay_given_sd_s if given_offset else tuning.gnss_delay_sd_s
    sd[state.BARO_BIAS] = tuning.baro_bias_sd_m
    sd[state.GYRO_SCALE] = tuning.gyro_scale_sd
    return np.diag(sd * sd)
