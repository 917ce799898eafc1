"""Failing converters are no accidents, and are not even suspected; blows that look like them for a while are."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from core.accident.converters import pinned
from core.accident.events import NoAccident
from core.accident.level import LevelMotion
from core.accident.thresholds import LevelThresholds
from tests.crash_timelines import EPOCH_NS, IMPACT_S, G, drive, find, haversine, named, told


@pytest.mark.parametrize("stuck_s", [0.005, 0.02, 0.06, 0.2])
def test_a_converter_that_fails_is_no_accident(stuck_s):
    motion = drive()
    t_s = (motion.t_ns - EPOCH_NS) * 1e-9
    motion.f_b[(t_s >= 3.0) & (t_s < 3.0 + stuck_s), 0] = -16 * G
    assert find(motion) == []
    assert NoAccident.SENSOR_GLITCH in named(motion)


def test_spikes_of_a_failing_converter_on_a_rough_road_are_none_though_earlier_ones_left_a_mean():
    motion = drive(noise=0.5)
    motion.omega_b[:, 0] += 0.2 * np.sin(11.0 * (motion.t_ns - EPOCH_NS) * 1e-9)
    for row, value in ((580, -490.0), (598, -980.0), (616, 123.0), (630, 245.0), (631, 490.0)):
        motion.f_b[row, 0] += value
    assert find(motion) == []


def test_an_axis_that_hangs_at_full_scale_is_not_even_suspected_while_it_hangs():
    motion = drive(noise=0.3)
    t_s = (motion.t_ns - EPOCH_NS) * 1e-9
    hangs = (t_s >= 3.0) & (t_s < 3.4)
    motion.f_b[hangs, 1], motion.saturated[hangs] = 16 * G, 1
    assert told(motion) == []


def rough(full_scale_g, **options):
    """A road that shakes and turns a car as a weak blow would, all the time."""
    motion = drive(noise=0.3, rate_hz=100.0, full_scale_g=full_scale_g, **options)
    t_s = (motion.t_ns - EPOCH_NS) * 1e-9
    motion.f_b[:, 2] += 3.0 * np.sin(75.0 * t_s) + 5.0 * np.sin(14.0 * t_s)
    motion.f_b[:, 0] += 1.5 * np.sin(61.0 * t_s)
    motion.omega_b[:, 0] += 0.2 * np.sin(11.0 * t_s)
    return motion, t_s


@pytest.mark.parametrize("length_s", [0.09, 0.14, 0.4])
@pytest.mark.parametrize("axis", [0, 1])
def test_an_axis_that_jumps_to_full_scale_while_a_rough_road_moves_the_others_is_not_even_suspected(axis, length_s):
    motion, t_s = rough(2.0)
    pinned = (t_s >= 3.0) & (t_s < 3.0 + length_s)
    motion.f_b[pinned, axis], motion.saturated[pinned] = 2.0 * G, 1
    assert told(motion) == []


@pytest.mark.parametrize("delta_v", [(-9.0, 0.0), (0.0, 9.0), (-3.0, -3.0)])
def test_a_blow_that_clips_on_such_a_road_is_told_in_time_all_the_same(delta_v):
    motion, _ = rough(2.0, seconds=15.0)
    blow = drive((IMPACT_S, *delta_v, 0.0, 0.11), noise=0.0, rate_hz=100.0, seconds=15.0)
    f_b = motion.f_b + blow.f_b + np.array([0.0, 0.0, G])
    motion.saturated[:] = (np.abs(f_b) >= 2.0 * G).any(axis=1)
    np.clip(f_b, -2.0 * G, 2.0 * G, out=motion.f_b)
    motion.omega_b[:] += blow.omega_b
    ((first, *_),) = told(motion)
    assert first.decided_t_ns - EPOCH_NS <= (IMPACT_S + 0.15) * 1e9  # issue 5


@pytest.mark.parametrize("phase", [0.0, 0.25, 0.5, 0.75])
def test_an_axis_at_full_scale_counts_as_pinned_no_longer_once_it_let_go_by_a_flank_or_rings(phase):
    motion = drive(full_scale_g=2.0, rate_hz=100.0, noise=0.05)
    since_s = (motion.t_ns - EPOCH_NS) * 1e-9 - IMPACT_S - phase / 100.0
    # Nothing else felt it; a tenth of the pulse rings at 25 Hz, as structures do.
    rings = 0.1 * 145.0 * np.exp(-25.0 * np.maximum(since_s, 0.0)) * np.sin(157.0 * since_s) * (since_s > 0.0)
    f_b = motion.f_b[:, 0] + 8.0 * haversine(since_s, 0.11) + rings
    motion.f_b[:, 0], motion.saturated[:] = np.clip(f_b, -2.0 * G, 2.0 * G), np.abs(f_b) >= 2.0 * G
    level = LevelMotion(LevelThresholds())
    level.extend(motion)
    first, released = 300, 300 + int(np.flatnonzero(motion.saturated[300:])[-1]) + 1
    assert not pinned(level.t_ns, level.x, level.flags, first, released + 5)
    jumped = np.where(motion.saturated[:, None] > 0, motion.f_b, drive(rate_hz=100.0, noise=0.05).f_b)
    level = LevelMotion(LevelThresholds())
    level.extend(dataclasses.replace(motion, f_b=jumped))  # the same samples at full scale, the road's around them
    assert pinned(level.t_ns, level.x, level.flags, first, released + 5)


@pytest.mark.parametrize(
    "values", [(-245.0, 0.0, 0.0, -490.0), (-250.0, 0.0, -775.0, -560.0), (370.0, 0.0, 0.0, 760.0)]
)
def test_spikes_that_add_up_to_a_change_of_velocity_are_not_even_suspected(values):
    motion, _ = rough(100.0)
    motion.f_b[300 : 300 + len(values), 1] += values
    assert told(motion) == []


@pytest.mark.parametrize("full_scale_g", [2.0, 16.0])
@pytest.mark.parametrize("rate_hz", [50.0, 100.0, 200.0])
@pytest.mark.parametrize(("delta_v", "length_s"), [(4.0, 0.08), (7.0, 0.1), (14.0, 0.07)])
def test_a_standing_car_that_is_struck_is_found_by_a_box_without_a_gyroscope(full_scale_g, rate_hz, delta_v, length_s):
    motion = drive(
        (IMPACT_S, delta_v, 0.0, 0.0, length_s),
        speed_mps=0.0, full_scale_g=full_scale_g, rate_hz=rate_hz, noise=0.02, seconds=15.0,
    )  # fmt: skip
    motion.omega_b[:] = 0.0
    (impact,) = find(motion)
    assert abs(math.remainder(impact.pdof_deg - 180.0, 360.0)) < 5.0
    low_mps, high_mps = impact.delta_v_interval_mps
    assert low_mps < delta_v < high_mps
