"""A phone's earth axes: a vertical that follows, an unknown direction of travel, and what is found all the same."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from core.driving.earth_axes import EarthAxes, EarthAxesTuning
from core.driving.manoeuvres import PHONE, Manoeuvre, ManoeuvreTracker
from core.simulation.route import RouteBuilder
from core.simulation.trajectory import Place, drive
from core.snapshot import pack, unpack

RATE_HZ = 50.0
PLACE = Place(math.radians(60.17), math.radians(24.94), 20.0, (15.0, 2.0, 49.0))
TUNING = EarthAxesTuning()


GRAVITY_MPS2 = 9.80665


def shown(route, *, heading_error_deg=0.0, yaw_bias_radps=0.0, gain=1.0, up_bias_mps2=0.0, seed=1):
    """What a phone tells of a drive: east, north, up, yaw, through its complementary filter, with axes of its own."""
    truth = drive(route.build(), PLACE, RATE_HZ)
    generator = np.random.default_rng(seed)
    true = np.gradient(truth.v_n[:, :2], 1.0 / RATE_HZ, axis=0)
    yaw = -np.gradient(np.unwrap(truth.rpy_rad[:, 2]), 1.0 / RATE_HZ) + yaw_bias_radps
    lean, rate, told = np.zeros(2), np.zeros(2), np.empty_like(true)
    for k, a in enumerate(true):
        told[k] = a - lean
        rate += gain * TUNING.integral_ps2 * told[k] / RATE_HZ
        lean += (gain * TUNING.proportional_ps * told[k] + rate) / RATE_HZ
    # A lean turns the specific force: what leaves the plane goes into the vertical.
    up = np.sqrt(GRAVITY_MPS2**2 + (true**2).sum(axis=1) - (told**2).sum(axis=1)) - GRAVITY_MPS2 + up_bias_mps2
    angle = math.radians(heading_error_deg)
    east, north = told[:, 1], told[:, 0]
    east, north = math.cos(angle) * east - math.sin(angle) * north, math.sin(angle) * east + math.cos(angle) * north
    noise = 0.2 * generator.standard_normal((3, yaw.size))
    t_ns = 1_700_000_000_000_000_000 + np.round(truth.t_s * 1e9).astype(np.int64)
    return t_ns, east + noise[0], north + noise[1], up + noise[2], yaw + 0.01 * generator.standard_normal(yaw.size)


def town() -> RouteBuilder:
    """A drive that shows its direction: turns to both sides, gently, before it gets rough."""
    route = RouteBuilder(heading_deg=70.0).hold(5.0).to_speed(10.0, 1.5).hold(5.0)
    for angle_deg in (80.0, -85.0, 90.0):
        route.turn(angle_deg, 40.0).hold(8.0)
    return route


def told(route, **settings):
    motion = EarthAxes().step(*shown(route, **settings))
    found = ManoeuvreTracker(PHONE).step_horizontal(motion)
    return [(one.kind, one.direction) for one in found if not one.recovery]


@pytest.mark.parametrize("heading_error_deg", [0.0, 60.0, 175.0])
@pytest.mark.parametrize("yaw_bias_radps", [0.0, 0.008])
def test_braking_and_corners_are_found_whatever_the_phone_takes_for_north(heading_error_deg, yaw_bias_radps):
    route = town().to_speed(16.0, 1.5).hold(6.0).to_speed(5.0, 6.5).hold(12.0)
    route.to_speed(12.0, 1.5).hold(8.0).turn(-80.0, 22.0).hold(12.0).turn(80.0, 22.0).hold(12.0)
    found = told(route, heading_error_deg=heading_error_deg, yaw_bias_radps=yaw_bias_radps)
    assert found == [
        (Manoeuvre.BRAKING, ""),
        (Manoeuvre.CORNERING, "left"),
        (Manoeuvre.CORNERING, "right"),
    ]


def test_a_harsh_acceleration_is_not_taken_for_braking():
    assert told(town().to_speed(26.0, 4.2).hold(12.0)) == [(Manoeuvre.ACCELERATION, "")]


def test_a_brisk_start_in_first_gear_is_no_harsh_acceleration():
    # 20 km/h of 3.5 m/s2, then on at 1.2: harsh to the threshold, but not kept up.
    start = town().to_speed(0.0, 2.0).hold(5.0).to_speed(5.5, 3.5).to_speed(14.0, 1.2).hold(8.0)
    assert told(start) == []
    columns = shown(start)
    found = ManoeuvreTracker(replace(PHONE, kept_s=0.0)).step_horizontal(EarthAxes().step(*columns))
    assert [one.kind for one in found] == [Manoeuvre.ACCELERATION]


def smooth(values):
    return np.convolve(values, np.ones(25) / 25.0, "valid")


@pytest.mark.parametrize("gain", [0.6, 1.0, 1.5])
def test_what_follows_a_braking_in_a_leaning_vertical_is_taken_out(gain):
    # Without it the end of a braking shows as much acceleration as there was braking.
    route = town().to_speed(16.0, 1.5).hold(6.0).to_speed(5.0, 6.5).hold(12.0)
    t_ns, east, north, up, yaw = shown(route, gain=gain)
    rows = EarthAxes().step(t_ns, east, north, up, yaw)
    end = round((route.t_s - 12.0) * RATE_HZ)
    after = slice(end + 10, end + round(4.0 * RATE_HZ))
    assert np.hypot(smooth(east[after]), smooth(north[after])).max() > 1.5
    # Near nothing the length tells little: 1 m/s2 adds 0.05 to 9.8.
    assert np.abs(smooth(rows.forward_mps2[after])).max() < 1.0


@pytest.mark.parametrize("gain", [0.6, 1.0, 1.5])
@pytest.mark.parametrize("up_bias_mps2", [-0.2, 0.2])
def test_a_pull_that_a_phone_hides_is_read_off_the_length_of_the_specific_force(gain, up_bias_mps2):
    route = town().to_speed(0.0, 2.0).hold(8.0).to_speed(22.0, 3.2).hold(8.0)
    columns = shown(route, gain=gain, up_bias_mps2=up_bias_mps2)
    late = slice(round((route.t_s - 12.5) * RATE_HZ), round((route.t_s - 11.0) * RATE_HZ))
    assert np.hypot(columns[1][late].mean(), columns[2][late].mean()) < 1.0
    # 0.05 m/s2 that the pull itself adds to gravity as it is learnt make 0.15 of 3.2; so much again for the axis.
    assert EarthAxes().step(*columns).forward_mps2[late].mean() == pytest.approx(3.2, abs=0.3)
    # By the gains alone nothing so good can be had, unless they are the phone's.
    deaf = EarthAxes(EarthAxesTuning(vertical_mps2=5.0, lean_mps2=0.0, lean_share=0.0)).step(*columns)
    if gain != 1.0:
        assert abs(deaf.forward_mps2[late].mean() - 3.2) > 0.7


def test_a_road_that_shakes_and_rises_pulls_nothing():
    route = town().to_speed(14.0, 1.5).hold(20.0).grade(8.0, 3.0).hold(10.0).grade(-8.0, 3.0).hold(10.0).grade(0.0, 3.0)
    t_ns, *accelerations, yaw = shown(route.bump(0.06, 0.8, 5.0).hold(10.0))
    shaken = np.array(accelerations) + np.random.default_rng(3).standard_normal((3, yaw.size))
    assert ManoeuvreTracker(PHONE).step_horizontal(EarthAxes().step(t_ns, *shaken, yaw)) == []


def test_before_a_turn_has_told_the_direction_only_turns_are_told():
    columns = shown(RouteBuilder().hold(3.0).to_speed(14.0, 3.5).hold(10.0).to_speed(3.0, 6.0).hold(5.0))
    assert np.isnan(EarthAxes().step(*columns).forward_mps2).all()
    route = RouteBuilder().hold(3.0).to_speed(12.0, 1.5).hold(5.0).turn(80.0, 22.0).hold(8.0)
    assert told(route) == [(Manoeuvre.CORNERING, "right")]


@pytest.mark.parametrize("size", [1, 37, 5000])
def test_the_same_samples_give_the_same_rows_however_cut_and_restored(size):
    columns = shown(town().to_speed(5.0, 6.0).hold(5.0))
    whole = EarthAxes().step(*columns)
    stage, parts = EarthAxes(), []
    for at in range(0, len(columns[0]), size):
        parts.append(stage.step(*(column[at : at + size] for column in columns)))
        again = EarthAxes()
        again.load(unpack(pack(stage.state(), 1), 1))
        stage = again
    for name in ("forward_mps2", "right_mps2", "yaw_radps"):
        assert np.array_equal(
            np.concatenate([getattr(part, name) for part in parts]), getattr(whole, name), equal_nan=True
        )
