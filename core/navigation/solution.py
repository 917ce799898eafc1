"""A whole drive's trajectory with its covariance, causal or smoothed: what post-processing works on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from core.measurements import FloatArray, TimeArray
from core.navigation.track import Track

SLOW_COLUMNS: Final = (
    "gyro_bias_x_radps",
    "gyro_bias_y_radps",
    "gyro_bias_z_radps",
    "accel_bias_x_mps2",
    "accel_bias_y_mps2",
    "accel_bias_z_mps2",
    "speed_scale",
    "mount_pitch_rad",
    "mount_yaw_rad",
    "gnss_error_n_m",
    "gnss_error_e_m",
    "gnss_error_d_m",
    "gnss_delay_s",
    "baro_bias_m",
    "gyro_scale_z",
)
"""The states that change slowly, in the order of the filter's error states from ``state.GYRO_BIAS`` on."""

SLOW: Final = {name: index for index, name in enumerate(SLOW_COLUMNS)}


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """Trajectory of the vehicle's body frame with the spread of everything estimated.

    Parameters
    ----------
    track : rows at the rate of the inertial samples (see ``track.TRACK_COLUMNS``); position is the vehicle's body
        origin, attitude that of the vehicle (C_n_from_vehicle from its roll, pitch, yaw)
    t_ns : (k,) nodes, some ten a second, at which the covariance is known; gaps where the filter was aligning
    covariance : (k, 9, 9) of the errors (truth minus estimate) of the vehicle's position (north, east, down; m),
        velocity (m/s) and attitude (rotation vector in n, rad: C_true = (I + [phi x]) C_estimate)
    slow, slow_sd : (k, len(SLOW_COLUMNS)) values of the slow states and their sd
    smoothed : whether all of the drive entered each row, or only what lay before it
    """

    track: Track
    t_ns: TimeArray
    covariance: FloatArray
    slow: FloatArray
    slow_sd: FloatArray
    smoothed: bool = False
