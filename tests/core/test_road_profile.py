"""The road from simulated drives with known grades: twice round a block, there and back, and with holes."""

from __future__ import annotations

import functools
import math
from dataclasses import replace

import numpy as np
import pytest

from core.earth import ned_offset_m
from core.errors import InvalidInputError
from core.measurements import Measurements
from core.navigation.road_profile import profile_of
from core.navigation.solution import Solution
from core.navigation.track import TRACK, Mode, Track
from core.simulation.gnss import measure_gnss
from core.simulation.route import RouteBuilder
from core.simulation.scenarios import MADRID, START_T_NS, WHITE_GNSS, absolute_ns
from core.simulation.sensors import LOW_COST_MEMS, draw_errors, measure_inertial
from core.simulation.trajectory import drive
from service.recordings.drive_folder import Drive
from service.recordings.drive_toml import ImuSetup
from service.recordings.fusing import fuse, fuse_config, vehicle_config

GRADE_PERCENT = 5.0
MOUNT_SD_RAD = 0.01


def driven(route, seed):
    """A low-cost box with white fixes, and the truth."""
    unit, inertial, fixes = np.random.default_rng(seed).spawn(3)
    truth = drive(route, MADRID, 50.0)
    f_s, omega_s = measure_inertial(truth, LOW_COST_MEMS, draw_errors(LOW_COST_MEMS, unit), inertial)
    gnss_t_s, gnss = measure_gnss(truth, route.sky, WHITE_GNSS, (0.0, 0.0, 0.0), fixes)
    m = Measurements(
        imu_t_ns=absolute_ns(truth.t_s), f_s=f_s, omega_s=omega_s, gnss_t_ns=absolute_ns(gnss_t_s), gnss=gnss
    )
    recorded = Drive("road", START_T_NS, "car", m, imu=ImuSetup(rate_hz=50.0, mounting_rpy_deg=(0.0, 0.0, 0.0)))
    return fuse(recorded, fuse_config(vehicle_config(recorded)), keep=True).solution, truth


@functools.cache
def block(rounds, seed=1):
    """Round a block, each time up by 5 % on one side and down on the opposite one; standing before and after."""
    b = RouteBuilder(heading_deg=30.0).hold(15.0).to_speed(12.5).hold(4.0)
    for _ in range(rounds):
        for percent in (0.0, GRADE_PERCENT, 0.0, -GRADE_PERCENT):
            b.grade(percent, 6.0).hold(20.0).turn(90.0, 25.0)
    return driven(b.grade(0.0).hold(3.0).to_speed(0.0, 1.6).hold(10.0).build(), seed)


@functools.cache
def there_and_back(seed=1):
    """Up a hill, round to the left, and down the hill on the other lane."""
    b = RouteBuilder(heading_deg=80.0).hold(15.0).to_speed(12.5).hold(6.0).grade(GRADE_PERCENT, 6.0).hold(30.0)
    b.grade(0.0, 6.0).hold(8.0).to_speed(5.0).turn(-180.0, 5.0).change_lane(-6.0, 5.0).to_speed(12.5).hold(6.0)
    return driven(
        b.grade(-GRADE_PERCENT, 6.0).hold(30.0).grade(0.0, 6.0).hold(3.0).to_speed(0.0).hold(5.0).build(), seed
    )


def places(lat_rad, lon_rad, alt_m):
    return ned_offset_m(lat_rad, lon_rad, alt_m, (MADRID.lat_rad, MADRID.lon_rad, 0.0))


def beside(line, truth):
    """Of each point: how far off the nearest true place is across and in height, and the grade there."""
    moving = np.flatnonzero(truth.speed_mps > 1.0)
    true, found = (places(one.lat_rad, one.lon_rad, one.alt_m) for one in (truth, line))
    apart = found[:, None, :2] - true[None, moving, :2]
    at = moving[np.argmin(np.hypot(apart[..., 0], apart[..., 1]), axis=1)]
    course = np.arctan2(truth.v_n[at, 1], truth.v_n[at, 0])
    off = found - true[at]
    across = np.cos(course) * off[:, 1] - np.sin(course) * off[:, 0]
    grade = np.arctan2(-truth.v_n[at, 2], truth.speed_mps[at])
    return across, -off[:, 2], grade


def test_errors_are_as_stated():
    solution, truth = block(2)
    (line,) = profile_of(solution, 5.0, MOUNT_SD_RAD)
    across, height, _ = beside(line, truth)
    # Not all of one line errs at once: its points' errors hang together, a handful of independent ones.
    assert np.sqrt(np.mean((height / line.sd_alt_m) ** 2)) < 2.0
    assert np.sqrt(np.mean((across / np.hypot(line.sd_n_m, line.sd_e_m)) ** 2)) < 2.0
    assert np.mean(np.abs(height) < 3 * line.sd_alt_m) > 0.99
    # No road is banked here, and the car leans by what is taken off: what is left is in the spread.
    assert np.mean(np.abs(line.bank_rad) < 3 * line.sd_bank_rad) == 1.0
    assert np.sqrt(np.mean(line.bank_rad**2)) < math.radians(0.4)


def test_grades_of_the_sides():
    (line,) = profile_of(block(2)[0], 5.0, MOUNT_SD_RAD)
    along = 100.0 * np.tan(line.grade_rad)
    truth = block(2)[1]
    grade = beside(line, truth)[2]
    settled = (np.abs(np.abs(grade) - math.atan(GRADE_PERCENT / 100)) < 1e-3) | (np.abs(grade) < 1e-3)
    error = line.grade_rad - grade
    assert np.mean(np.abs(error[settled]) < 3 * line.sd_grade_rad[settled]) > 0.97  # at the feet of slopes it is a mean
    assert np.sqrt(np.mean(error[settled] ** 2)) < 0.012
    assert along.max() == pytest.approx(GRADE_PERCENT, abs=1.5)
    assert along.min() == pytest.approx(-GRADE_PERCENT, abs=1.5)


def test_a_road_driven_again_is_one_road():
    once, twice = profile_of(block(1)[0]), profile_of(block(2)[0])
    assert len(once) == len(twice) == 1
    length = twice[0].chainage_m[-1]
    assert length == pytest.approx(once[0].chainage_m[-1], abs=30.0)
    assert np.diff(twice[0].chainage_m) == pytest.approx(np.full(len(twice[0].chainage_m) - 1, 5.0))
    assert np.mean(twice[0].passes >= 2) > 0.85  # all but where it came from
    assert set(twice[0].opposite) == {0}


def test_passes_lower_the_spread_and_points_of_one_pass_do_not():
    solution = block(3)[0]
    (line,) = profile_of(solution)
    (dense,) = profile_of(solution, 1.0)
    third = line.passes == 3
    assert third.mean() > 0.7
    each = np.array_split(solution.track.column("sd_d_m")[solution.track.column("mode") != Mode.ALIGNING], 3)
    of_passes = [float(np.median(rows)) for rows in each]
    fused = float(np.median(line.sd_alt_m[third]))
    # At best the root of three better than the best pass: they share a part of their errors, and where they differ
    # by more than they state, sd grows again.
    assert 0.55 * min(of_passes) < fused < max(of_passes)
    assert np.median(dense.sd_alt_m) == pytest.approx(np.median(line.sd_alt_m), rel=0.05)


def test_the_way_back_is_the_same_road_with_its_grade_turned():
    solution, truth = there_and_back()
    line = profile_of(solution, 5.0, MOUNT_SD_RAD)[0]
    both = line.opposite == 1
    assert both.sum() * 5.0 > 250.0
    assert (line.passes[both] == 2).all()
    # Where it is driven both ways the grade is still that of the way up.
    up = both & (np.abs(line.chainage_m - np.median(line.chainage_m[both])) < 60.0)
    assert np.tan(line.grade_rad[up]).mean() == pytest.approx(GRADE_PERCENT / 100, abs=0.01)
    # The roll of the box in the car has two signs now, so half of it or less is left; one way leaves all of it.
    doubtful = profile_of(solution, 5.0, 0.1)[0].sd_bank_rad
    assert np.median(doubtful[both]) < 0.06
    assert doubtful[line.passes == 1].min() > 0.1
    # The line across stays where it was driven first, on its own lane, up to where the car turns round.
    assert np.abs(across_way_there(truth, line)[both][:-4]).max() < 3.0


def across_way_there(truth, line):
    """How far the line is across from the way there, without the way back."""
    turned = np.argmax(np.abs(np.unwrap(truth.rpy_rad[:, 2]) - truth.rpy_rad[0, 2]) > 1.0)
    there = replace(truth, **{name: getattr(truth, name)[:turned] for name in type(truth).__slots__})
    return beside(line, there)[0]


def test_standing_adds_no_points():
    solution, truth = block(1)
    (line,) = profile_of(solution)
    moved_m = float(np.sum(truth.speed_mps) / 50.0)
    assert line.chainage_m[-1] < moved_m
    assert line.chainage_m[-1] > moved_m - 160.0  # its end is its beginning again, 115 m, and before it is aligned


def without(solution, low_s, high_s):
    t_s = (solution.track.t_ns - START_T_NS) * 1e-9
    kept = (t_s < low_s) | (t_s > high_s)
    return replace(solution, track=Track(solution.track.t_ns[kept], solution.track.values[kept]))


def test_a_hole_in_the_solution_breaks_the_line():
    solution = block(1)[0]
    lines = profile_of(without(solution, 60.0, 64.0))
    assert len(lines) == 2
    (whole,) = profile_of(solution)
    parts_m = sum(line.chainage_m[-1] for line in lines)
    assert whole.chainage_m[-1] - parts_m == pytest.approx(4.0 * 12.5, abs=15.0)
    gap = places(lines[1].lat_rad[:1], lines[1].lon_rad[:1], lines[1].alt_m[:1])[0]
    gap -= places(lines[0].lat_rad[-1:], lines[0].lon_rad[-1:], lines[0].alt_m[-1:])[0]
    assert np.hypot(*gap[:2]) > 40.0


def test_reversing_shows_the_same_road():
    """The same rows with the car turned about: its pitch and roll are those of the other end."""
    solution, _ = block(1)
    values = solution.track.values.copy()
    values[:, TRACK["yaw_rad"]] += math.pi
    values[:, TRACK["roll_rad"]] *= -1.0
    backwards = replace(solution, track=Track(solution.track.t_ns, values))
    (line,), (reversed_line,) = profile_of(solution), profile_of(backwards)
    assert reversed_line.grade_rad == pytest.approx(line.grade_rad)
    assert reversed_line.bank_rad == pytest.approx(line.bank_rad)


def test_nothing_driven_gives_no_road():
    solution = block(1)[0]
    assert profile_of(without(solution, 10.0, 1e9)) == []
    none = Solution(
        Track(solution.track.t_ns[:0], solution.track.values[:0]),
        solution.t_ns[:0], solution.covariance[:0], solution.slow[:0], solution.slow_sd[:0],
    )  # fmt: skip
    assert profile_of(none) == []


@pytest.mark.parametrize("spacing_m", [0.0, -5.0, 0.5, 5000.0, math.nan])
def test_a_spacing_out_of_range_is_refused(spacing_m):
    with pytest.raises(InvalidInputError, match="spacing"):
        profile_of(block(1)[0], spacing_m)
