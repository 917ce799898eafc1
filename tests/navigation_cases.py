"""A vehicle in a state that is known to the last bit, for tests of what aids make of it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from core.earth import radii_m
from core.measurements import GNSS, GNSS_COLUMNS
from core.navigation import state
from core.navigation.constraints import fuse_non_holonomic, fuse_speed, fuse_standstill
from core.navigation.correction import correct
from core.navigation.field_aiding import fuse_barometer, fuse_magnetic
from core.navigation.gnss_aiding import fuse_position, fuse_velocity
from core.navigation.mechanization import fold_position, start_frame
from core.navigation.records import RECORD_COLUMNS, AidRecords
from core.navigation.state import (
    ATT,
    BARO_BIAS,
    GNSS_DELAY,
    GNSS_ERROR,
    GYRO_BIAS,
    MOUNT_PITCH,
    MOUNT_YAW,
    POS,
    SPEED_SCALE,
    VEL,
)
from core.navigation.tuning import Tuning
from core.rotation import matrix_from_quaternion, matrix_from_rpy, quaternion_from_matrix

NOW_NS = 1_700_000_000_000_000_000
EXACT = replace(
    Tuning(),
    gnss_sd_floor_m=1e-3,
    gnss_sd_v_floor_mps=1e-3,
    nhc_sd_mps=0.01,
    nhc_lever_m=0.0,
    speed_sd_mps=0.01,
    zupt_sd_mps=1e-3,
    zaru_sd_radps=1e-6,
    magnetic_sd_rad=0.01,
    magnetic_correlation_s=0.0,
    baro_sd_m=0.05,
)
"""Measurements as exact as the tunables allow."""
LEVER_B = np.array([1.2, -0.6, -0.9])
LAT, LON, ALT = 0.8, 0.3, 200.0
RPY = (0.04, 0.05, 2.2)
MOUNT_PITCH_RAD, MOUNT_YAW_RAD, SCALE = 0.03, -0.05, 0.02
OMEGA_B, GYRO_BIAS_B = np.array([0.05, -0.1, 0.4]), np.array([0.01, -0.02, 0.005])
FORCE_B = np.array([3.0, 4.0, -9.0])
GNSS_ERROR_N, GNSS_DELAY_S, BARO_BIAS_M = np.array([1.1, -0.8, 1.6]), 0.05, 30.0
FIELD_N_UT = np.array([25.0, 0.0, 40.0])


def vehicle_axes(x):
    """C_n_from_v of a state: the body's attitude and the box's pitch and yaw in the car."""
    C_b_from_v = matrix_from_rpy(0.0, x[state.X_MOUNT_PITCH], x[state.X_MOUNT_YAW])
    return matrix_from_quaternion(x[:4]) @ C_b_from_v


@dataclass
class Case:
    """An estimate with an error along one state, the truth behind it, and P that knows of that error alone."""

    x: np.ndarray
    truth: np.ndarray
    p: np.ndarray
    ti: np.ndarray
    par: np.ndarray
    log: tuple[np.ndarray, np.ndarray]

    @classmethod
    def of(cls, index, error, sd, v_vehicle=(15.0, 0.0, 0.0), tuning=EXACT):
        truth, ti = np.zeros(state.NX), np.zeros(state.NT, np.int64)
        truth[:4] = quaternion_from_matrix(matrix_from_rpy(*RPY))
        truth[state.X_LAT], truth[state.X_LON], truth[state.X_ALT] = LAT, LON, ALT
        truth[state.X_BG : state.X_BG + 3] = GYRO_BIAS_B
        truth[state.X_W : state.X_W + 3] = OMEGA_B + GYRO_BIAS_B
        truth[state.X_SCALE] = SCALE
        truth[state.X_GNSS_ERROR : state.X_GNSS_ERROR + 3] = GNSS_ERROR_N
        truth[state.X_GNSS_DELAY], truth[state.X_BARO_BIAS] = GNSS_DELAY_S, BARO_BIAS_M
        truth[state.X_WHITE_SHARE] = 1.0
        truth[state.X_RING : state.X_RING + 6] = *FORCE_B, *GYRO_BIAS_B
        truth[state.X_NEWEST : state.X_NEWEST + 3], truth[state.X_RISING_N] = FORCE_B, 10.0
        truth[state.X_MOUNT_PITCH], truth[state.X_MOUNT_YAW] = MOUNT_PITCH_RAD, MOUNT_YAW_RAD
        truth[state.X_V : state.X_V + 3] = vehicle_axes(truth) @ np.array(v_vehicle)
        ti[state.T_NOW] = ti[state.T_COV] = ti[state.T_GNSS] = ti[state.T_DECAY] = NOW_NS
        ti[state.I_BLOCKS] = 1
        start_frame(truth, ti)
        x, minus = truth.copy(), np.zeros(state.N_STATES)
        minus[index] = -error
        correct(x, minus)
        fold_position(x, ti)
        p = np.zeros(state.N_STATES**2)
        p[index * (state.N_STATES + 1)] = sd**2
        log = np.empty(20, np.int64), np.empty((20, len(RECORD_COLUMNS)))
        return cls(x, truth, p, ti, tuning.as_array(), log)

    @property
    def counts(self):
        return self.ti[state.I_COUNTS :].reshape(len(state.AIDS), len(state.OUTCOMES))

    @property
    def records(self):
        n = self.ti[state.I_RECORDS]
        return AidRecords(self.log[0][:n], self.log[1][:n])

    @property
    def work(self):
        n = state.N_STATES
        return n, np.zeros(n), np.empty(n), np.empty(n), *self.log

    @property
    def acceleration_n(self):
        return matrix_from_quaternion(self.truth[:4]) @ FORCE_B + self.truth[state.X_G : state.X_G + 3]

    def fix(self, **more):
        """What a receiver without white errors says of the truth at its antenna, late and off as that is."""
        C, y = matrix_from_quaternion(self.truth[:4]), self.truth
        v_n = y[state.X_V : state.X_V + 3]
        arm_n = C @ LEVER_B + GNSS_ERROR_N - GNSS_DELAY_S * v_n
        v_n = v_n + C @ np.cross(OMEGA_B, LEVER_B) - GNSS_DELAY_S * self.acceleration_n
        meridian, transverse = radii_m(y[state.X_LAT])
        values = {
            "lat_rad": y[state.X_LAT] + (y[state.X_DR] + arm_n[0]) / (meridian + ALT),
            "lon_rad": y[state.X_LON] + (y[state.X_DR + 1] + arm_n[1]) / ((transverse + ALT) * math.cos(LAT)),
            "alt_m": y[state.X_ALT] - y[state.X_DR + 2] - arm_n[2],
            "vn_mps": v_n[0],
            "ve_mps": v_n[1],
            "vd_mps": v_n[2],
            "sd_h_m": 1e-3,
            "sd_v_m": 1e-3,
            "sd_v_mps": 1e-3,
            "satellites": 9.0,
            "fix": 3.0,
        } | more
        return row(**values)

    def position(self, fix, t_ns=NOW_NS):
        return fuse_position(self.x, self.ti, self.p, t_ns, fix, LEVER_B, self.par, self.work)

    def velocity(self, fix, t_ns=NOW_NS):
        fuse_velocity(self.x, self.ti, self.p, t_ns, fix, LEVER_B, self.par, self.work)

    def speed(self, reading_mps):
        fuse_speed(self.x, self.ti, self.p, NOW_NS, reading_mps, self.par, self.work)

    def going_straight(self):
        fuse_non_holonomic(self.x, self.ti, self.p, self.par, self.work)

    def standing(self):
        fuse_standstill(self.x, self.ti, self.p, self.par, self.work)

    def magnetic(self, field_n_ut=FIELD_N_UT):
        field_b_ut = matrix_from_quaternion(self.truth[:4]).T @ np.array(field_n_ut)
        fuse_magnetic(self.x, self.ti, self.p, NOW_NS, tuple(field_b_ut), self.par, self.work)

    def barometer(self, more_m=0.0):
        height_m = self.truth[state.X_ALT] + BARO_BIAS_M + more_m
        fuse_barometer(self.x, self.ti, self.p, NOW_NS, height_m, self.par, self.work)

    def left(self, index):
        """The error that is left along a state."""
        x, y = self.x, self.truth
        if index < POS + 3:
            meridian, transverse = radii_m(LAT)
            metres = (meridian + ALT, (transverse + ALT) * math.cos(LAT), -1.0)[index]
            at = state.X_LAT + index
            return (y[at] - x[at]) * metres + y[state.X_DR + index] - x[state.X_DR + index]
        if ATT <= index < ATT + 3:
            turn = matrix_from_quaternion(y[:4]) @ matrix_from_quaternion(x[:4]).T
            return 0.5 * (turn - turn.T)[(2, 0, 1)[index - ATT], (1, 2, 0)[index - ATT]]
        groups = {VEL: state.X_V, GYRO_BIAS: state.X_BG, GNSS_ERROR: state.X_GNSS_ERROR}
        singles = {
            SPEED_SCALE: state.X_SCALE,
            MOUNT_PITCH: state.X_MOUNT_PITCH,
            MOUNT_YAW: state.X_MOUNT_YAW,
            GNSS_DELAY: state.X_GNSS_DELAY,
            BARO_BIAS: state.X_BARO_BIAS,
        }
        places = singles | {first + i: at + i for first, at in groups.items() for i in range(3)}
        return y[places[index]] - x[places[index]]


def row(**values):
    fix = np.full(len(GNSS_COLUMNS), np.nan)
    for name, value in values.items():
        fix[GNSS[name]] = value
    return fix
