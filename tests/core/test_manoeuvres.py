"""Manoeuvres as timelines: given how a vehicle was driven, which episodes are told, with what, and which are not."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from core.accident.events import VehicleMotion
from core.driving.horizontal import HorizontalMotion, Levelling
from core.driving.manoeuvres import Episode, Manoeuvre, ManoeuvreThresholds, ManoeuvreTracker, explained
from core.measurements import FloatArray
from core.rotation import matrix_from_rpy
from core.sensors import Triple
from core.simulation.route import RouteBuilder
from core.simulation.trajectory import Place, drive
from core.snapshot import pack, unpack

EPOCH_NS = 1_700_000_000_000_000_000
RATE_HZ = 100.0
PLACE = Place(math.radians(60.17), math.radians(24.94), 20.0, (15.0, 2.0, 49.0))


def driven(route: RouteBuilder, *, bias_b: Triple = (0.0, 0.0, 0.0), seed: int = 1) -> VehicleMotion:
    """What a tracker is fed: a box's noisy samples with the true attitude and speed."""
    truth = drive(route.build(), PLACE, RATE_HZ)
    generator = np.random.default_rng(seed)
    down_b = np.array([matrix_from_rpy(*rpy)[2] for rpy in truth.rpy_rad])
    shape = truth.f_b.shape
    return VehicleMotion(
        t_ns=EPOCH_NS + np.round(truth.t_s * 1e9).astype(np.int64),
        # Road and engine: 0.4 m/s2 of white noise, ten times a MEMS sensor's own.
        f_b=truth.f_b + np.array(bias_b) + 0.4 * generator.standard_normal(shape),
        omega_b=truth.omega_b + 0.005 * generator.standard_normal(shape),
        down_b=down_b,
        speed_mps=truth.speed_mps,
        saturated=np.zeros(len(down_b), dtype=np.uint8),
        gravity_mps2=9.819,
    )


def cut(motion: VehicleMotion, sizes: list[int]) -> list[VehicleMotion]:
    parts, at = [], 0
    while at < len(motion.t_ns):
        size = sizes[len(parts) % len(sizes)]
        rows = slice(at, at + size)
        names = ("t_ns", "f_b", "omega_b", "down_b", "speed_mps", "saturated")
        parts.append(replace(motion, **{name: getattr(motion, name)[rows] for name in names}))
        at += size
    return parts


def told(route: RouteBuilder, **settings: object) -> list[Episode]:
    return ManoeuvreTracker().step(driven(route, **settings))  # type: ignore[arg-type]


def seconds(t_ns: int) -> float:
    return (t_ns - EPOCH_NS) * 1e-9


def under_way(speed_mps: float = 14.0) -> RouteBuilder:
    """A car that has stood and driven for longer than offsets take to be learnt."""
    return RouteBuilder().hold(10.0).to_speed(speed_mps, 1.5).hold(20.0)


def test_a_harsh_braking_is_told_with_what_happened() -> None:
    route = under_way(20.0)
    begin_s = route.t_s
    route.to_speed(4.0, 6.0)
    end_s = route.t_s
    (one,) = told(route.hold(10.0))
    assert (one.kind, one.direction, one.aggressive, one.counted) == (Manoeuvre.BRAKING, "", True, True)
    assert one.peak_mps2 == pytest.approx(6.0, rel=0.1)  # two poles at 2 Hz take some 3 % of such a pulse
    assert one.speed_before_mps == pytest.approx(20.0, abs=2.5)  # where it passes 1.6 m/s2
    assert one.speed_after_mps == pytest.approx(4.0, abs=2.5)
    assert begin_s < seconds(one.start_t_ns) < seconds(one.peak_t_ns) < seconds(one.end_t_ns) < end_s + 0.5
    assert seconds(one.start_t_ns) - begin_s < 1.5  # an eased beginning takes a while to 1.6 m/s2
    assert one.radius_m > 500.0


def test_a_harsh_acceleration_is_told_and_a_brisk_one_is_not() -> None:
    route = under_way(5.0)
    (one,) = told(route.to_speed(18.0, 4.0).hold(8.0))
    assert one.kind is Manoeuvre.ACCELERATION
    assert one.peak_mps2 == pytest.approx(4.0, rel=0.1)
    assert told(under_way(5.0).to_speed(18.0, 2.0).hold(8.0).to_speed(3.0, 2.5).hold(5.0)) == []


@pytest.mark.parametrize(("angle_deg", "direction"), [(80.0, "right"), (-80.0, "left")])
def test_a_corner_is_told_with_side_radius_and_speed(angle_deg: float, direction: str) -> None:
    (one,) = told(under_way(12.0).turn(angle_deg, 25.0).hold(8.0))
    assert (one.kind, one.direction) == (Manoeuvre.CORNERING, direction)
    assert one.peak_mps2 == pytest.approx(12.0**2 / 25.0, rel=0.1)
    assert one.radius_m == pytest.approx(25.0, rel=0.1)
    assert math.degrees(one.heading_change_rad) == pytest.approx(angle_deg, abs=5.0)
    assert one.speed_at_peak_mps == pytest.approx(12.0, abs=0.1)
    assert told(under_way(12.0).turn(angle_deg, 60.0).hold(8.0)) == []


@pytest.mark.parametrize(
    ("offset_m", "duration_s", "direction", "aggressive"),
    [(3.5, 5.0, "right", False), (-3.5, 5.0, "left", False), (3.5, 2.2, "right", True), (-3.5, 2.2, "left", True)],
)
def test_lanes_changed_at_ease_and_in_haste_are_told_apart(
    offset_m: float, duration_s: float, direction: str, aggressive: bool
) -> None:
    (one,) = told(under_way(22.0).change_lane(offset_m, duration_s).hold(8.0))
    assert (one.kind, one.direction, one.aggressive) == (Manoeuvre.LANE_CHANGE, direction, aggressive)
    assert abs(math.degrees(one.heading_change_rad)) < 3.0
    assert one.duration_s == pytest.approx(duration_s, abs=1.0)


def test_bends_to_both_sides_are_no_lanes() -> None:
    # Each bend turns by 20 degrees: together they lead 40 m aside.
    assert told(under_way(15.0).turn(20.0, 120.0).turn(-20.0, 120.0).hold(8.0)) == []


def test_hills_bumps_and_a_turned_accelerometer_are_no_manoeuvres() -> None:
    route = under_way(12.0).grade(12.0, 3.0).hold(15.0).grade(-12.0, 3.0).hold(15.0).grade(0.0, 3.0)
    route.bump(0.08, 0.6, 2.0).bump(-0.06, 0.8, 5.0).hold(10.0)
    assert told(route, bias_b=(0.5, -0.6, 0.3)) == []


def test_an_offset_of_the_accelerometer_shifts_no_peak() -> None:
    route = under_way(20.0).to_speed(4.0, 6.0).hold(10.0)
    (plain,), (off,) = told(route), told(route, bias_b=(0.6, 0.6, 0.0))
    # 45 s of 60 s' memory.
    assert off.peak_mps2 == pytest.approx(plain.peak_mps2, abs=0.1)


def test_repeats_within_a_minute_count_once_but_are_kept() -> None:
    route = under_way(20.0)
    for _ in range(3):
        route.to_speed(8.0, 6.0).hold(1.0).to_speed(20.0, 2.0).hold(10.0)
    route.hold(60.0).to_speed(8.0, 6.0).hold(5.0)
    found = told(route)
    assert [one.kind for one in found] == [Manoeuvre.BRAKING] * 4
    # The third begins more than a minute after the first one's end only if the drive between took longer.
    gaps = [seconds(one.start_t_ns) - seconds(found[0].end_t_ns) for one in found]
    assert [one.counted for one in found] == [True, False, False, True]
    assert gaps[2] < 60.0 < gaps[3]


def test_taking_up_speed_at_once_after_braking_is_a_recovery() -> None:
    found = told(under_way(20.0).to_speed(5.0, 6.0).to_speed(15.0, 4.0).hold(8.0))
    assert [(one.kind, one.recovery, one.counted) for one in found] == [
        (Manoeuvre.BRAKING, False, True),
        (Manoeuvre.ACCELERATION, True, False),
    ]


def test_manoeuvring_in_a_yard_is_below_the_gates() -> None:
    route = RouteBuilder().hold(20.0)
    for _ in range(3):
        route.to_speed(2.0, 1.5).turn(90.0, 1.2).to_speed(0.0, 4.5).hold(3.0)
    assert told(route) == []


def test_braking_for_a_hazard_is_defensive() -> None:
    found = told(under_way(20.0).to_speed(4.0, 6.0).hold(20.0).to_speed(14.0, 4.0).hold(5.0))
    braking, pulling = found
    marked = explained(found, [braking.start_t_ns + 500_000_000, pulling.start_t_ns])
    assert [one.defensive for one in marked] == [True, False]  # nobody accelerates in defence
    assert explained(found, [braking.end_t_ns + 10_000_000_000]) == found
    for pothole_t_ns, defensive in ((braking.end_t_ns + 1_000_000_000, True), (braking.start_t_ns - 1, False)):
        marked = explained(found, [], [pothole_t_ns, pulling.start_t_ns + 1])
        assert [one.defensive for one in marked] == [defensive, False]


@pytest.mark.parametrize("sizes", [[1], [7, 1, 200], [1000]])
def test_the_same_samples_give_the_same_episodes_however_cut_and_restored(sizes: list[int]) -> None:
    route = under_way(20.0).to_speed(6.0, 6.0).to_speed(14.0, 4.0).turn(80.0, 30.0).hold(2.0)
    motion = driven(route.to_speed(22.0, 2.0).change_lane(3.5, 2.2).hold(4.0))
    whole = ManoeuvreTracker().step(motion)
    assert len(whole) == 4
    tracker, found = ManoeuvreTracker(), []
    for number, part in enumerate(cut(motion, sizes)):
        found += tracker.step(part)
        if number % 500 == 3:
            again = ManoeuvreTracker()
            again.load(unpack(pack(tracker.state(), 1), 1))
            tracker = again
    assert found == whole


def test_gaps_and_missing_values_break_nothing() -> None:
    motion = driven(under_way(20.0).to_speed(4.0, 6.0).hold(10.0))
    f_b, down_b, speed = motion.f_b.copy(), motion.down_b.copy(), motion.speed_mps.copy()
    f_b[1000:1010], down_b[:300], speed[2000:2100] = np.nan, np.nan, np.nan
    rough = replace(motion, f_b=f_b, down_b=down_b, speed_mps=speed)
    shuffled = np.r_[0:500, 100:900, 900 : len(motion.t_ns)]
    names = ("t_ns", "f_b", "omega_b", "down_b", "speed_mps", "saturated")
    rough = replace(rough, **{name: getattr(rough, name)[shuffled] for name in names})
    assert [one.kind for one in ManoeuvreTracker().step(rough)] == [Manoeuvre.BRAKING]
    silent = replace(motion, t_ns=motion.t_ns + (np.arange(len(motion.t_ns)) > 3900) * 5_000_000_000)
    assert len(ManoeuvreTracker().step(silent)) <= 1


def test_level_axes_are_those_of_the_road_however_it_leans() -> None:
    motion = driven(under_way(14.0).grade(10.0).turn(60.0, 40.0).to_speed(5.0, 4.0).hold(5.0))
    rows = Levelling().step(motion)
    known = np.isfinite(rows.forward_mps2)
    assert known[2000:].all()
    settled = slice(2000, None)
    lateral = motion.speed_mps * rows.yaw_radps
    smooth = np.ones(50) / 50.0
    errors = np.convolve((rows.right_mps2 - lateral)[settled], smooth, "valid")
    # White noise of 0.4 m/s2 over half a second leaves 0.06; roll on its springs moves the box, not the road.
    assert np.sqrt(np.mean(errors**2)) < 0.25


def harsh_rows(speed_mps: float, count: int = 400) -> HorizontalMotion:
    t_ns = EPOCH_NS + np.arange(count) * 10_000_000
    forward: FloatArray = np.where((np.arange(count) > 100) & (np.arange(count) < 300), -6.0, 0.0)
    speed = np.full(count, speed_mps) if math.isnan(speed_mps) else speed_mps + np.cumsum(forward) * 0.01
    return HorizontalMotion(t_ns, forward, np.zeros(count), np.zeros(count), speed)


def test_speed_unknown_passes_the_gates_and_is_told_as_unknown() -> None:
    (one,) = ManoeuvreTracker().step_horizontal(harsh_rows(math.nan))
    assert math.isnan(one.speed_before_mps)
    assert math.isnan(one.radius_m)
    assert one.peak_mps2 == pytest.approx(6.0, rel=0.01)


def test_a_deceleration_that_the_speed_does_not_show_is_an_error_of_tilt() -> None:
    rows = harsh_rows(20.0)
    assert len(ManoeuvreTracker().step_horizontal(rows)) == 1
    steady = HorizontalMotion(rows.t_ns, rows.forward_mps2, rows.right_mps2, rows.yaw_radps, np.full(400, 20.0))
    assert ManoeuvreTracker().step_horizontal(steady) == []


def test_thresholds_decide() -> None:
    motion = driven(under_way(20.0).to_speed(8.0, 3.5).hold(8.0))
    assert ManoeuvreTracker().step(motion) == []
    assert len(ManoeuvreTracker(ManoeuvreThresholds(braking_mps2=3.13)).step(motion)) == 1
