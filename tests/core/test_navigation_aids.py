"""Every aid takes away the errors it sees, and a refused one changes nothing."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest

from core.earth import STANDARD_GRAVITY_MPS2, radii_m
from core.measurements import GNSS, GNSS_COLUMNS
from core.navigation import kernel, state
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
    X_SQUAT,
    X_SQUAT_VAR,
)
from core.navigation.stillness import close_block
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


SECOND_ORDER = 0.02
"""Share of an error that one exact update may leave: the measurement's own spread (below 0.5 %) and, of an angle
of 4 mrad or a scale of 0.5 %, its products with itself and the other states' estimates."""


@pytest.mark.parametrize(
    ("index", "error", "sd"),
    [
        (POS, 2.0, 5.0),
        (POS + 1, -2.0, 5.0),
        (POS + 2, 3.0, 5.0),
        (ATT, 4e-3, 0.1),
        (ATT + 1, -4e-3, 0.1),
        (ATT + 2, 4e-3, 0.1),
        (GNSS_ERROR, 2.0, 5.0),
        (GNSS_ERROR + 1, -2.0, 5.0),
        (GNSS_ERROR + 2, 3.0, 5.0),
        (GNSS_DELAY, 0.1, 0.3),
    ],
)
def test_a_position_takes_away_what_it_sees(index, error, sd):
    case = Case.of(index, error, sd)
    assert case.left(index) == pytest.approx(error, rel=1e-3)
    # Of an attitude error the height row and the gate leave out what the lever arm makes: no height, and 2 mm.
    assert case.position(case.fix(alt_m=math.nan, sd_h_m=2e-3) if ATT <= index < ATT + 3 else case.fix())
    assert abs(case.left(index)) < SECOND_ORDER * abs(error)
    assert case.counts[state.A_POSITION, state.FUSED] == 1


@pytest.mark.parametrize(
    ("index", "error", "form"),
    [
        (VEL, 0.3, "velocity"),
        (VEL + 1, 0.3, "velocity"),
        (VEL + 2, 0.3, "velocity"),
        (GNSS_DELAY, 0.1, "velocity"),
        (VEL, 0.3, "course"),
        (VEL + 1, 0.3, "course"),
        (GNSS_DELAY, -0.1, "course"),
    ],
)
def test_a_velocity_takes_away_what_it_sees(index, error, form):
    case = Case.of(index, error, 1.0)
    fix = case.fix()
    if form == "course":
        north, east = fix[GNSS["vn_mps"]], fix[GNSS["ve_mps"]]
        nothing = dict.fromkeys(("vn_mps", "ve_mps", "vd_mps"), math.nan)
        fix = case.fix(speed_mps=math.hypot(north, east), course_rad=math.atan2(east, north) % math.tau, **nothing)
    case.velocity(fix)
    assert abs(case.left(index)) < SECOND_ORDER * abs(error)
    assert case.counts[state.A_VELOCITY, state.FUSED] == 1


@pytest.mark.parametrize(
    ("index", "error", "sd"),
    [
        (VEL, 0.2, 1.0),
        (VEL + 1, 0.2, 1.0),
        (VEL + 2, -0.2, 1.0),
        (ATT, 4e-3, 0.1),
        (ATT + 1, 4e-3, 0.1),
        (ATT + 2, -4e-3, 0.1),
        (MOUNT_PITCH, 4e-3, 0.1),
        (MOUNT_YAW, -4e-3, 0.1),
    ],
)
def test_going_where_the_wheels_point_takes_away_what_it_sees(index, error, sd):
    case = Case.of(index, error, sd)
    case.going_straight()
    assert abs(case.left(index)) < SECOND_ORDER * abs(error)
    assert case.counts[state.A_NHC, state.FUSED] == 2


@pytest.mark.parametrize(
    ("index", "error", "sd"),
    [
        (VEL, 0.2, 1.0),
        (VEL + 1, 0.2, 1.0),
        (VEL + 2, -0.2, 10.0),
        (ATT, 4e-3, 0.3),
        (ATT + 1, 4e-3, 0.3),
        (ATT + 2, -4e-3, 0.3),
        (SPEED_SCALE, 5e-3, 0.1),
        (MOUNT_PITCH, 4e-3, 0.3),
        (MOUNT_YAW, -4e-3, 0.3),
    ],
)
@pytest.mark.parametrize("way", [1.0, -1.0])
def test_a_wheel_speed_takes_away_what_it_sees(index, error, sd, way):
    # Sliding sideways and lifting, so that attitude and mounting are seen along the forward axis too.
    case = Case.of(index, error, sd, v_vehicle=(way * 12.0, 4.0, -3.0))
    case.speed((1.0 + SCALE) * 12.0)  # the same when it reverses
    assert abs(case.left(index)) < SECOND_ORDER * abs(error)
    assert case.counts[state.A_SPEED, state.FUSED] == 1


@pytest.mark.parametrize(
    ("index", "error", "sd"),
    [*((VEL + i, 0.05, 1.0) for i in range(3)), *((GYRO_BIAS + i, 1e-3, 1e-2) for i in range(3))],
)
def test_standing_takes_away_what_it_sees(index, error, sd):
    case = Case.of(index, error, sd, v_vehicle=(0.0, 0.0, 0.0))
    case.standing()
    assert abs(case.left(index)) < SECOND_ORDER * abs(error)
    assert case.counts[state.A_ZUPT, state.FUSED] == case.counts[state.A_ZARU, state.FUSED] == 1


@pytest.mark.parametrize(("index", "error", "sd"), [(ATT, 4e-3, 0.1), (ATT + 2, -0.05, 0.3)])
def test_a_magnetic_field_takes_away_what_it_sees(index, error, sd):
    # A tilt about east moves no field that points north, so it is not seen.
    case = Case.of(index, error, sd)
    case.magnetic()
    assert abs(case.left(index)) < SECOND_ORDER * abs(error)
    assert case.counts[state.A_MAGNETOMETER, state.FUSED] == 1


@pytest.mark.parametrize(("index", "error", "sd"), [(POS + 2, -3.0, 5.0), (BARO_BIAS, 40.0, 100.0)])
def test_an_air_pressure_takes_away_what_it_sees(index, error, sd):
    case = Case.of(index, error, sd)
    case.barometer()
    assert abs(case.left(index)) < SECOND_ORDER * abs(error)
    assert case.counts[state.A_BAROMETER, state.FUSED] == 1


def test_an_aid_leaves_one_record_an_axis_of_what_it_measured():
    case = Case.of(POS, 2.0, 5.0)
    case.position(case.fix())
    axes = (state.A_POSITION, 0), (state.A_POSITION, 1), (state.A_HEIGHT, 0)
    north, east, height = (case.records.of(aid, axis) for aid, axis in axes)
    assert len(case.records.t_ns) == len(north.t_ns) + len(east.t_ns) + len(height.t_ns) == 3
    innovation = [float(one.column("innovation")[0]) for one in (north, east, height)]
    assert innovation == pytest.approx([2.0, 0.0, 0.0], abs=1e-4)
    variance = [float(one.column("variance")[0]) for one in (north, east, height)]
    assert variance == pytest.approx([25.0 + 1e-6, 1e-6, 1e-6], rel=1e-6)
    assert north.column("ratio")[0] == pytest.approx(2.0**2 / 25.0 / Tuning().gate_position, rel=1e-3)
    assert (case.records.column("outcome") == state.FUSED).all()


@pytest.mark.parametrize("heading", [0.1, 2.2, -1.6])
def test_a_position_moves_with_the_vehicle_between_its_time_and_now(heading):
    case = Case.of(POS, 0.0, 5.0)
    lag_s, fix = 0.4, case.fix()
    v_n = case.truth[state.X_V : state.X_V + 3]
    meridian, transverse = radii_m(LAT)
    fix[GNSS["lat_rad"]] -= lag_s * v_n[0] / (meridian + ALT)
    fix[GNSS["lon_rad"]] -= lag_s * v_n[1] / ((transverse + ALT) * math.cos(LAT))
    before_ns = NOW_NS - round(lag_s * 1e9)
    case.position(fix, before_ns)
    assert abs(case.left(POS)) < 1e-3


def test_spreads_come_from_the_receiver_then_from_dilution_then_from_the_default():
    def spread_after(**said):
        case = Case.of(POS, 0.0, 1e3, tuning=Tuning())
        unsaid = dict.fromkeys(("sd_h_m", "sd_v_m"), math.nan)
        case.position(case.fix(**(unsaid | said)))
        return math.sqrt(case.p[0])

    t = Tuning()
    assert spread_after(sd_h_m=4.0, hdop=1.0) == pytest.approx(4.0, rel=1e-4)  # P before is 1000 m: a share of 1e-5
    assert spread_after(sd_h_m=0.01) == pytest.approx(t.gnss_sd_floor_m, rel=1e-4)
    assert spread_after(hdop=1.5) == pytest.approx(1.5 * t.gnss_uere_m, rel=1e-4)
    assert spread_after() == pytest.approx(t.gnss_sd_h_m, rel=1e-4)


def test_the_air_adds_to_what_the_geometry_of_the_sky_does_to_heights():
    case = Case.of(POS + 2, 0.0, 1e3, tuning=Tuning())
    case.position(case.fix(hdop=1.2, vdop=2.0, sd_h_m=math.nan, sd_v_m=math.nan))
    t = Tuning()
    expected_m = 2.0 * t.gnss_uere_m * t.gnss_height_factor
    assert math.sqrt(case.p[(POS + 2) * (state.N_STATES + 1)]) == pytest.approx(expected_m, rel=1e-4)


# What is refused


def nominal(x):
    """The part of the state that says where the vehicle is and what its sensors are like."""
    return np.concatenate([x[: state.X_F], x[state.X_DR : state.X_DR + 3]])


def test_a_refused_position_or_velocity_moves_nothing():
    case = Case.of(POS, 0.0, 1.0)
    x, p = nominal(case.x).copy(), case.p.copy()
    far = case.fix()
    far[GNSS["lat_rad"]] += 200.0 / 6.37e6
    assert not case.position(far)
    assert case.p.tobytes() == p.tobytes()
    case.velocity(case.fix(vn_mps=80.0))
    assert nominal(case.x).tobytes() == x.tobytes()
    # A velocity that stays wrong must not stay refused: its spread alone grows, by no more than a quarter of the error.
    grown = (case.p - p).reshape(state.N_STATES, state.N_STATES)
    assert np.count_nonzero(grown) <= 2
    assert (grown[VEL, VEL] > 0.0) & (grown[VEL, VEL] < 0.25 * 80.0**2)
    assert case.counts[state.A_POSITION, state.REJECTED_GATE] == case.counts[state.A_VELOCITY, state.REJECTED_GATE] == 1
    assert case.ti[state.T_GNSS] == NOW_NS
    assert case.ti[state.I_GNSS_USED] == 0


def test_a_refused_height_lets_its_own_spread_grow_until_it_is_believed():
    case = Case.of(POS + 2, 300.0, 1.0)
    for _ in range(20):
        case.position(case.fix())
        if case.counts[state.A_HEIGHT, state.FUSED]:
            break
    assert 1 <= case.counts[state.A_HEIGHT, state.REJECTED_GATE] <= 10
    assert abs(case.left(POS + 2)) < 3.0


def test_squatting_under_acceleration_is_no_slope():
    squat_rad_per_mps2, speed_mps = 0.004, 15.0
    force_mps2 = float(FORCE_B[0] + STANDARD_GRAVITY_MPS2 * matrix_from_rpy(*RPY)[2, 0])
    rising_mps = squat_rad_per_mps2 * force_mps2 * speed_mps
    assert abs(rising_mps) > 0.1
    case = Case.of(ATT + 1, 0.0, 0.1, v_vehicle=(speed_mps, 0.0, rising_mps))
    case.x[X_SQUAT] = squat_rad_per_mps2
    case.going_straight()
    # Of the 7 mrad that the speed along the body's down axis would else be taken for: its own change with the attitude.
    assert abs(case.left(ATT + 1)) < 0.02 * abs(rising_mps) / speed_mps


@pytest.mark.parametrize("squat_rad_per_mps2", [0.0, 0.002, 0.007])
def test_how_much_a_car_squats_is_learnt(squat_rad_per_mps2):
    speed_mps = 15.0
    force_mps2 = float(FORCE_B[0] + STANDARD_GRAVITY_MPS2 * matrix_from_rpy(*RPY)[2, 0])
    rising_mps = squat_rad_per_mps2 * force_mps2 * speed_mps
    case = Case.of(ATT + 1, 0.0, 0.0, v_vehicle=(speed_mps, 0.0, rising_mps), tuning=replace(EXACT, squat_share=0.1))
    case.x[X_SQUAT], case.x[X_SQUAT_VAR] = 0.004, 0.002**2
    for _ in range(100):
        case.going_straight()
    sd = math.sqrt(case.x[X_SQUAT_VAR])
    assert sd < 0.0005
    assert case.x[X_SQUAT] == pytest.approx(squat_rad_per_mps2, abs=2 * sd)


def test_a_skid_is_refused_and_slow_driving_is_not_constrained():
    skid = Case.of(VEL, 0.0, 0.0, v_vehicle=(15.0, 12.0, 0.0), tuning=Tuning())
    x = nominal(skid.x).copy()
    skid.going_straight()
    assert skid.counts[state.A_NHC, state.REJECTED_GATE] == 1
    slow = Case.of(VEL, 0.0, 0.0, v_vehicle=(0.3, 0.1, 0.0))
    slow.going_straight()
    assert slow.counts[state.A_NHC, state.REJECTED_RANGE] == 1
    assert nominal(skid.x) == pytest.approx(x, abs=1e-12)


def test_wheels_that_spin_are_refused():
    case = Case.of(VEL, 0.0, 0.1)
    x = nominal(case.x).copy()
    case.speed(40.0)
    assert case.counts[state.A_SPEED, state.REJECTED_GATE] == 1
    assert nominal(case.x).tobytes() == x.tobytes()


# Fields and air


@pytest.mark.parametrize("factor", [0.6, 1.4])
def test_a_field_that_iron_disturbs_is_refused(factor):
    case = Case.of(ATT + 2, 0.05, 0.3)
    case.magnetic()
    x, p = nominal(case.x).copy(), case.p.copy()
    case.magnetic(factor * FIELD_N_UT)
    assert case.counts[state.A_MAGNETOMETER].tolist() == [1, 0, 0, 1, 0]
    assert nominal(case.x).tobytes() == x.tobytes()
    assert case.p.tobytes() == p.tobytes()


def test_many_samples_of_one_field_say_as_much_as_it_errs_independently():
    # The iron's error lasts for minutes: a hundred samples of it are worth one, and a heading's spread stays above.
    case = Case.of(ATT + 2, 0.0, 1.0, tuning=Tuning())
    t = Tuning()
    for _ in range(round(t.magnetic_correlation_s / t.magnetic_interval_s)):
        case.magnetic()
    yaw_sd = math.sqrt(case.p[(ATT + 2) * (state.N_STATES + 1)])
    assert yaw_sd == pytest.approx(t.magnetic_sd_rad / math.hypot(1.0, t.magnetic_sd_rad), rel=1e-2)


def test_a_wrong_heading_is_brought_back_as_far_as_one_independent_sample_can():
    case, t = Case.of(ATT + 2, 0.3, 0.5, tuning=Tuning()), Tuning()
    for _ in range(round(t.magnetic_correlation_s / t.magnetic_interval_s)):
        case.magnetic()
    variance = t.magnetic_sd_rad**2
    assert case.left(ATT + 2) == pytest.approx(0.3 * variance / (0.5**2 + variance), rel=0.02)


def test_a_step_of_air_pressure_is_refused_and_then_believed_as_its_bias():
    case = Case.of(BARO_BIAS, 0.0, 0.5, tuning=Tuning())
    height = case.left(POS + 2)
    for _ in range(30):
        case.barometer(25.0)
        if case.counts[state.A_BAROMETER, state.FUSED]:
            break
    assert 1 <= case.counts[state.A_BAROMETER, state.REJECTED_GATE] <= 10
    assert case.left(BARO_BIAS) == pytest.approx(-25.0, abs=1.0)  # what one sample is good to
    assert case.left(POS + 2) == height


# Standing


def put_block(case, mean):
    """A block of ten samples that are alike."""
    case.ti[state.I_BLOCK] = 10
    case.x[state.X_BLOCK : state.X_BLOCK + 6] = 10 * mean
    case.x[state.X_BLOCK_SUMS : state.X_BLOCK_SUMS + 6] = sum(range(1, 11)) * mean


@pytest.mark.parametrize(("speed_sd_mps", "stands"), [(0.02, False), (1.0, True)])
def test_a_quiet_second_is_a_standstill_only_where_the_filter_may_be_wrong_of_its_speed(speed_sd_mps, stands):
    # Rolling at 0.4 m/s on a smooth road feels as standing does, for a while.
    case = Case.of(VEL, 0.0, 0.0, v_vehicle=(0.4, 0.0, 0.0), tuning=Tuning())
    for i in range(3):
        case.p[(VEL + i) * (state.N_STATES + 1)] = speed_sd_mps**2
    C, gravity_n = matrix_from_quaternion(case.x[:4]), case.x[state.X_G : state.X_G + 3]
    for _ in range(100):  # ten seconds of blocks
        case.ti[state.T_NOW] += kernel.BLOCK_NS
        put_block(case, np.concatenate([-C.T @ gravity_n, GYRO_BIAS_B]))
        close_block(case.x, case.ti, case.p, case.par)
    assert bool(case.ti[state.I_STATIONARY]) is stands


@pytest.mark.parametrize(("speed_sd_mps", "stands"), [(0.05, False), (0.15, True)])
def test_a_long_quiet_is_a_standstill_where_the_filter_would_not_wonder(speed_sd_mps, stands):
    # 0.35 m/s are 7 and 2.3 sd: the second is patient for 10 s by its odds alone, longer than any creep.
    case = Case.of(VEL, 0.0, 0.0, v_vehicle=(0.35, 0.0, 0.0), tuning=Tuning())
    for i in range(3):
        case.p[(VEL + i) * (state.N_STATES + 1)] = speed_sd_mps**2
    case.x[state.X_STILL_F], case.x[state.X_STILL_W] = 0.015, 1e-3
    C, gravity_n = matrix_from_quaternion(case.x[:4]), case.x[state.X_G : state.X_G + 3]
    for _ in range(round((1.0 + Tuning().still_longest_patience_s) * 10) + 1):
        case.ti[state.T_NOW] += kernel.BLOCK_NS
        put_block(case, np.concatenate([-C.T @ gravity_n, GYRO_BIAS_B]))
        close_block(case.x, case.ti, case.p, case.par)
    assert bool(case.ti[state.I_STATIONARY]) is stands


@pytest.mark.parametrize(("force_mps2", "stands"), [(0.02, True), (0.06, False)])
def test_a_gentle_pull_away_ends_a_standstill_with_its_first_tenth_of_a_second(force_mps2, stands):
    case = Case.of(VEL, 0.0, 0.02, v_vehicle=(0.0, 0.0, 0.0), tuning=Tuning())
    C, gravity_n = matrix_from_quaternion(case.x[:4]), case.x[state.X_G : state.X_G + 3]
    for forward_mps2 in [*[0.0] * 20, force_mps2]:
        case.ti[state.T_NOW] += kernel.BLOCK_NS
        force_b = -C.T @ gravity_n + [forward_mps2, 0.0, 0.0]
        put_block(case, np.concatenate([force_b, GYRO_BIAS_B]))
        # What was learnt of standing is of a real engine, kth_stockholm's; these blocks are quieter.
        case.x[state.X_STILL_F], case.x[state.X_STILL_W] = 0.008, 1e-3
        close_block(case.x, case.ti, case.p, case.par)
    assert bool(case.ti[state.I_STATIONARY]) is stands
