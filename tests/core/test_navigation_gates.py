"""What the filter refuses of aids, believes in the end, and takes for standing."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from core.earth import STANDARD_GRAVITY_MPS2
from core.measurements import GNSS
from core.navigation import kernel, state
from core.navigation.state import (
    ATT,
    BARO_BIAS,
    POS,
    VEL,
    X_SQUAT,
    X_SQUAT_VAR,
)
from core.navigation.stillness import close_block
from core.navigation.tuning import Tuning
from core.rotation import matrix_from_quaternion, matrix_from_rpy
from tests.navigation_cases import (
    EXACT,
    FIELD_N_UT,
    FORCE_B,
    GYRO_BIAS_B,
    NOW_NS,
    RPY,
    Case,
)

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
