"""A phone's earth axes: a vertical that follows, an unknown direction of travel, and what is found all the same."""

from __future__ import annotations

import math

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


def shown(route, *, heading_error_deg=0.0, yaw_bias_radps=0.0, follows=True, seed=1):
    """What a phone tells of a drive: east, north, yaw, through its complementary filter, with axes of its own."""
    truth = drive(route.build(), PLACE, RATE_HZ)
    generator = np.random.default_rng(seed)
    true = np.gradient(truth.v_n[:, :2], 1.0 / RATE_HZ, axis=0)
    yaw = -np.gradient(np.unwrap(truth.rpy_rad[:, 2]), 1.0 / RATE_HZ) + yaw_bias_radps
    lean, rate, told = np.zeros(2), np.zeros(2), np.empty_like(true)
    for k, a in enumerate(true):
        told[k] = a - lean if follows else a
        rate += TUNING.integral_ps2 * told[k] / RATE_HZ
        lean += (TUNING.proportional_ps * told[k] + rate) / RATE_HZ
    angle = math.radians(heading_error_deg)
    east, north = told[:, 1], told[:, 0]
    east, north = math.cos(angle) * east - math.sin(angle) * north, math.sin(angle) * east + math.cos(angle) * north
    noise = 0.2 * generator.standard_normal((2, yaw.size))
    t_ns = 1_700_000_000_000_000_000 + np.round(truth.t_s * 1e9).astype(np.int64)
    return t_ns, east + noise[0], north + noise[1], yaw + 0.01 * generator.standard_normal(yaw.size)


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
    assert told(town().to_speed(22.0, 4.2).hold(12.0)) == [(Manoeuvre.ACCELERATION, "")]


def test_what_follows_a_braking_in_a_leaning_vertical_is_taken_out():
    # Without it the end of a braking shows as much acceleration as there was braking.
    route = town().to_speed(16.0, 1.5).hold(6.0).to_speed(5.0, 6.5).hold(12.0)
    t_ns, east, north, yaw = shown(route)
    rows = EarthAxes().step(t_ns, east, north, yaw)
    end = round((route.t_s - 12.0) * RATE_HZ)
    after = slice(end, end + round(2.0 * RATE_HZ))
    smooth = np.ones(25) / 25.0
    told_plainly = np.hypot(np.convolve(east[after], smooth, "valid"), np.convolve(north[after], smooth, "valid"))
    assert told_plainly.max() > 2.0
    # What is left comes of integrals that fade.
    assert np.abs(np.convolve(rows.forward_mps2[after], smooth, "valid")).max() < 0.6 * told_plainly.max()


def test_before_a_turn_has_told_the_direction_only_turns_are_told():
    t_ns, east, north, yaw = shown(RouteBuilder().hold(3.0).to_speed(14.0, 3.5).hold(10.0).to_speed(3.0, 6.0).hold(5.0))
    assert np.isnan(EarthAxes().step(t_ns, east, north, yaw).forward_mps2).all()
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
