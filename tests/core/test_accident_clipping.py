"""Accidents that clipped, of one impact and of several: what the rest afterwards says of them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from core.accident.detector import ImpactDetector
from core.simulation.corpus import accident_case
from tests.crash_timelines import EPOCH_NS, IMPACT_S, G, drive, take, told


def clipped_crash(delta_v_b, speed_mps, decel_mps2=5.0, length_s=0.12):
    """A crash of which 2 g clip both axes, then braking to rest; the filter's speed is right before and at rest."""
    left = math.hypot(speed_mps + delta_v_b[0], delta_v_b[1])
    stops_s, seconds = IMPACT_S + length_s + left / decel_mps2, 16.0
    motion = drive((IMPACT_S, *delta_v_b, 0.0, length_s), seconds=seconds)
    t_s = (motion.t_ns - EPOCH_NS) * 1e-9
    sliding = (t_s >= IMPACT_S + length_s) & (t_s < stops_s)
    heading = np.array([speed_mps + delta_v_b[0], delta_v_b[1]]) / left
    motion.f_b[sliding, :2] -= decel_mps2 * heading
    motion.speed_mps[:] = np.where(t_s < IMPACT_S + length_s, speed_mps, np.where(t_s < stops_s, 5.0, 0.0))
    limit = 2.0 * G
    motion.saturated[:] = (np.abs(motion.f_b) >= limit).any(axis=1)
    np.clip(motion.f_b, -limit, limit, out=motion.f_b)
    return motion


@pytest.mark.parametrize("delta_v_b", [(-9.4, -3.4), (-7.0, -7.0), (-3.0, 8.0), (-12.0, 1.0)])
def test_rest_tells_what_clipping_hid_of_a_crash_and_where_it_came_from(delta_v_b):
    (revisions,) = told(clipped_crash(delta_v_b, speed_mps=14.0))
    early, last = revisions[1], revisions[-1]
    size, from_deg = math.hypot(*delta_v_b), math.degrees(math.atan2(-delta_v_b[1], -delta_v_b[0]))
    assert last.clipped
    # Speed off by 0.15 m/s and an accelerometer by 0.08 m/s2 for some 3 s: 0.3 m/s, twice.
    assert last.delta_v_mps == pytest.approx(size, abs=0.6)
    assert abs(math.remainder(last.pdof_deg - from_deg, 360.0)) < 5.0
    assert last.pdof_sd_deg < early.pdof_sd_deg
    assert last.delta_v_interval_mps[0] < size < last.delta_v_interval_mps[1]
    assert np.ptp(last.delta_v_interval_mps) < 0.5 * np.ptp(early.delta_v_interval_mps)


def test_an_accident_that_goes_on_after_a_checkpoint_is_refined_all_the_same():
    motion = clipped_crash((-7.0, -7.0), speed_mps=14.0)
    before, after = np.array_split(np.arange(len(motion.t_ns)), [800])
    whole, first = ImpactDetector(), ImpactDetector()
    expected = whole.step(motion).impacts
    found = first.step(take(motion, before)).impacts
    second = ImpactDetector()
    second.load(first.state())
    assert found + second.step(take(motion, after)).impacts == expected


def worst_of(case):
    """The one accident told of a case: its last revision, and by how much its direction is off, deg."""
    (revisions,) = told(case.motion)
    return revisions[-1], abs(math.remainder(revisions[-1].pdof_deg - case.truth.pdof_deg, 360.0))


@pytest.mark.parametrize(("name", "seed"), [("multi_impact", 1052), ("multi_impact", 1057), ("multi_impact", 1066)])
def test_which_of_several_clipped_impacts_was_the_worst_is_told_once_the_car_has_come_to_rest(name, seed):
    case = accident_case(name, seed, full_scale_g=2.0)
    last, off_deg = worst_of(case)
    assert last.clipped
    assert off_deg < 15.0  # issue 5
    assert last.delta_v_interval_mps[0] <= case.truth.delta_v_mps <= last.delta_v_interval_mps[1]


def test_an_accident_of_several_clipped_impacts_goes_on_after_a_checkpoint_to_the_bit():
    motion = accident_case("multi_impact", 1066, full_scale_g=2.0).motion
    whole = ImpactDetector().step(motion).impacts
    assert whole[-1].impacts == 3
    begin = int(np.searchsorted(motion.t_ns, whole[-1].t_ns))
    for after_s in (0.1, 0.5, 1.5, 5.0):
        cut = begin + round(after_s * 200.0)
        first, second = ImpactDetector(), ImpactDetector()
        found = first.step(take(motion, np.arange(cut))).impacts
        second.load(first.state())
        assert found + second.step(take(motion, np.arange(cut, len(motion.t_ns)))).impacts == whole


@pytest.mark.parametrize(("seed", "full_scale_g"), [(31, 2.0), (1008, 16.0), (1068, 100.0)])
def test_a_spin_after_a_blow_is_not_told_in_its_place(seed, full_scale_g):
    last, off_deg = worst_of(accident_case("spin", seed, full_scale_g=full_scale_g, rate_hz=100.0))
    assert off_deg < 15.0  # issue 5
    assert last.impacts == 1
