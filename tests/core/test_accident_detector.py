"""The accident detector as timelines: given what the box felt, which impacts are told, how hard and from where."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from core.accident.clipping import unclip
from core.accident.detector import ImpactDetector
from core.accident.events import Kind, NoAccident, Severity, Status
from core.accident.profiles import for_vehicle
from core.accident.severity import classify, force_direction_deg
from core.accident.thresholds import SeverityThresholds, TriggerThresholds
from core.errors import InvalidInputError
from core.simulation.corpus import accident_case
from tests.crash_timelines import EPOCH_NS, IMPACT_S, G, drive, find, haversine, named, take, told


def test_a_frontal_crash_is_told_with_its_change_of_velocity_direction_and_time():
    (impact,) = find(drive((IMPACT_S, -9.0, 0.0, 0.0, 0.12)))
    assert impact.delta_v_mps == pytest.approx(9.0, abs=0.15)  # noise integrated over the pulse, and its far ends
    assert impact.delta_v_b_mps[0] == pytest.approx(-9.0, abs=0.15)
    assert impact.pdof_deg == pytest.approx(0.0, abs=2.0) or impact.pdof_deg == pytest.approx(360.0, abs=2.0)
    assert (impact.t_ns - EPOCH_NS) * 1e-9 == pytest.approx(IMPACT_S, abs=0.02)  # below 2 m/s2 for its first 10 ms
    assert impact.peak_mps2 == pytest.approx(150.0, rel=0.02)
    assert impact.duration_s == pytest.approx(0.12, abs=0.03)
    assert impact.speed_before_mps == 12.0
    assert impact.severity is Severity.AIRBAG
    assert not impact.clipped
    assert impact.confidence > 0.95
    assert impact.detector == "telefuse"


@pytest.mark.parametrize(
    ("from_deg", "dv"), [(0, (-4, 0)), (90, (0, -4)), (180, (4, 0)), (270, (0, 4)), (45, (-3, -3))]
)
def test_direction_of_force_is_where_it_came_from(from_deg, dv):
    (impact,) = find(drive((IMPACT_S, *dv, 0.0, 0.1)))
    assert math.remainder(impact.pdof_deg - from_deg, 360.0) == pytest.approx(0.0, abs=3.0)


@pytest.mark.parametrize("attitude", [True, False])
@pytest.mark.parametrize("speed_mps", [0.0, 3.5, 15.0, math.nan])
@pytest.mark.parametrize("length_s", [0.08, 0.1, 0.15])
def test_a_low_speed_crash_is_found_moving_standing_and_without_attitude(attitude, speed_mps, length_s):
    (impact,) = find(drive((IMPACT_S, 3.0, 0.5, 0.0, length_s), speed_mps=speed_mps, attitude=attitude))
    assert impact.severity is Severity.LOW_SPEED
    # Without attitude the vertical turns towards the pulse for its length, by a few degrees at most.
    assert impact.delta_v_mps == pytest.approx(math.hypot(3.0, 0.5), abs=0.15 if attitude else 0.4)


def test_a_decision_falls_within_half_a_second_of_the_impact():
    for length_s in (0.06, 0.1, 0.2, 0.3):
        (impact,) = find(drive((IMPACT_S, -10.0, 0.0, 0.0, length_s)))
        assert 0 < impact.decided_t_ns - (EPOCH_NS + IMPACT_S * 1e9) < 0.5e9


def test_a_slow_severe_change_within_a_second_is_found_and_is_no_airbag_case():
    (impact,) = find(drive((IMPACT_S, -14.0, 0.0, 0.0, 1.0), speed_mps=20.0))
    assert impact.severity is Severity.SEVERE
    assert impact.decided_t_ns - impact.t_ns < 1.0e9


@pytest.mark.parametrize("delta_v", [2.5, 4.0, 6.0, 9.0])
@pytest.mark.parametrize("length_s", [0.08, 0.12, 0.16])
def test_a_pulse_clipped_at_2_g_is_found_and_its_stated_sd_covers_the_truth(delta_v, length_s):
    (impact,) = find(drive((IMPACT_S, -delta_v, 0.0, 0.0, length_s), full_scale_g=2.0))
    assert impact.clipped
    assert abs(impact.delta_v_mps - delta_v) < 2.0 * impact.delta_v_sd_mps
    assert impact.delta_v_sd_mps < delta_v
    whole = find(drive((IMPACT_S, -delta_v, 0.0, 0.0, length_s)))[0]
    assert impact.delta_v_sd_mps > whole.delta_v_sd_mps
    low_mps, high_mps = impact.delta_v_interval_mps
    assert low_mps < delta_v < high_mps


SILENT = {
    "emergency braking, 1.05 g for 3 s": [(IMPACT_S, -31.0, 0.0, 0.0, 6.0)],
    "cornering at 0.9 g": [(IMPACT_S, 0.0, 18.0, 0.0, 4.0)],
    "pothole: hard and vertical, with a short jerk backward": [
        (3.0, -0.6, 0.0, 1.5, 0.03),
        (3.03, 0.5, 0.0, -1.5, 0.04),
    ],
    "speed bump: long and vertical": [(3.0, -0.8, 0.0, -1.5, 0.15), (3.15, 0.6, 0.0, 1.8, 0.2)],
    "kerb mounted at walking pace": [(3.0, -0.9, 0.2, -1.2, 0.06), (3.06, 0.4, 0.0, 1.2, 0.1)],
    "door slammed": [(3.0, 0.0, 0.25, 0.0, 0.01), (3.01, 0.0, -0.4, 0.0, 0.015), (3.025, 0.0, 0.15, 0.0, 0.02)],
    "box knocked, 15 g, swinging back": [(3.0, 1.0, 0.3, 0.0, 0.013), (3.013, -1.0, -0.3, 0.0, 0.02)],
    "box shaken": [(3.0 + 0.08 * k, 1.2 * (-1) ** k, 0.0, 0.0, 0.08) for k in range(12)],
}


@pytest.mark.parametrize("full_scale_g", [2.0, 16.0])
@pytest.mark.parametrize("attitude", [True, False])
@pytest.mark.parametrize("name", SILENT)
def test_what_is_no_accident_stays_silent(name, attitude, full_scale_g):
    assert find(drive(*SILENT[name], full_scale_g=full_scale_g, attitude=attitude)) == []


def test_a_box_tilted_against_its_stated_attitude_does_not_turn_bumps_into_accidents():
    motion = drive(*SILENT["speed bump: long and vertical"], noise=0.5)
    motion.down_b[:] = [math.sin(0.1), 0.0, math.cos(0.1)]  # 6 degrees: an alignment that has only begun
    assert find(motion) == []


def test_impacts_within_seconds_are_one_accident_that_counts_them():
    first, second = (3.0, -3.0, 0.0, 0.0, 0.1), (4.5, 0.0, -2.5, 0.0, 0.1)
    (revisions,) = told(drive(first, second, seconds=20.0))
    assert [one.impacts for one in revisions] == [1, 1, 2]  # suspected, its whole pulse, and what followed
    assert revisions[-1].delta_v_mps == pytest.approx(3.0, abs=0.1)


def test_a_later_impact_that_is_worse_is_told_as_soon_as_it_is_over():
    (revisions,) = told(drive((3.0, -3.0, 0.0, 0.0, 0.1), (4.5, 0.0, -9.0, 0.0, 0.1)))
    assert [one.revision for one in revisions] == list(range(len(revisions)))
    assert len({one.t_ns for one in revisions}) == 1
    worse = revisions[-1]
    assert worse.severity is Severity.AIRBAG
    assert worse.impacts == 2
    assert worse.decided_t_ns - EPOCH_NS == pytest.approx(4.65e9, abs=0.1e9)


def test_impacts_far_apart_are_two_accidents():
    first, second = told(drive((3.0, -3.0, 0.0, 0.0, 0.1), (12.0, -3.0, 0.0, 0.0, 0.1), seconds=15.0))
    assert second[0].t_ns - first[0].t_ns == pytest.approx(9e9, abs=0.02e9)
    assert first[-1].status is Status.CONFIRMED  # it is closed before the other is told
    assert second[0].revision == 0


def test_an_accident_is_suspected_within_150_ms_and_confirmed_by_the_rest_that_follows():
    motion = drive((IMPACT_S, -6.0, 0.0, 0.0, 0.12), seconds=20.0)
    t_s = (motion.t_ns - EPOCH_NS) * 1e-9
    motion.speed_mps[:] = np.clip(
        12.0 - 6.0 * (t_s > IMPACT_S) - 4.0 * np.maximum(t_s - IMPACT_S - 0.5, 0.0), 0.0, None
    )
    (revisions,) = told(motion)
    assert revisions[0].status is Status.SUSPECTED
    assert revisions[0].decided_t_ns - (EPOCH_NS + IMPACT_S * 1e9) <= 150e6
    assert revisions[-1].status is Status.CONFIRMED
    assert "came to rest" in revisions[-1].reasons
    assert revisions[-1].confidence > revisions[1].confidence


def test_a_weak_impact_after_which_the_car_drives_on_as_before_is_retracted_with_a_candidate():
    motion = drive((IMPACT_S, -1.1, 0.0, 0.0, 0.1), seconds=20.0)
    (revisions,) = told(motion)
    assert revisions[0].confidence < 0.95
    assert revisions[-1].status is Status.RETRACTED
    assert NoAccident.UNEXPLAINED in named(motion)


@pytest.mark.parametrize(("ignition", "kind"), [(False, Kind.PARKED_HIT), (True, Kind.COLLISION)])
def test_a_standing_car_that_is_struck_is_found_and_a_parked_one_is_a_class_of_its_own(ignition, kind):
    push, friction = (IMPACT_S, 1.2, 0.0, 0.0, 0.1), (IMPACT_S + 0.1, -1.2, 0.0, 0.0, 0.3)  # its brakes hold it
    motion = drive(push, friction, speed_mps=0.0, seconds=15.0)
    (impact,) = find(dataclasses.replace(motion, ignition=ignition))
    assert impact.kind is kind
    assert impact.pdof_deg == pytest.approx(180.0, abs=5.0)


def test_a_rollover_is_found_by_where_down_is():
    motion = drive((IMPACT_S, 0.0, 1.2, 0.0, 0.2), seconds=20.0)
    t_s = (motion.t_ns - EPOCH_NS) * 1e-9
    roll = np.radians(180.0) * np.clip((t_s - 3.2) / 1.2, 0.0, 1.0)
    motion.down_b[:] = np.column_stack([np.zeros_like(roll), np.sin(roll), np.cos(roll)])
    motion.f_b[:] += G * (np.array([0.0, 0.0, 1.0]) - motion.down_b)
    motion.omega_b[:, 0] += np.gradient(roll, t_s)
    motion.speed_mps[t_s > 6.0] = 0.0
    (impact,) = find(motion)
    assert impact.rollover
    assert impact.severity is not Severity.LOW_SPEED


def test_what_a_cars_tyres_can_bring_about_is_an_impact_of_a_truck():
    push = drive((IMPACT_S, -3.2, 0.0, 0.0, 0.5))
    assert find(push, for_vehicle("car")) == []
    assert len(find(push, for_vehicle("truck"))) == 1


def test_a_spinning_car_keeps_the_direction_it_had_when_it_was_hit():
    motion = drive((IMPACT_S, 0.0, 0.0, 0.0, 0.2))
    t_s = (motion.t_ns - EPOCH_NS) * 1e-9
    turned = np.clip((t_s - IMPACT_S) / 0.2, 0.0, 1.0) * 1.5  # 1.5 rad to the right in 0.2 s
    push = 8.0 * haversine(t_s - IMPACT_S, 0.2)  # on its left side, to the right as it first stood
    motion.f_b[:, 0] += push * np.sin(turned)
    motion.f_b[:, 1] += push * np.cos(turned)
    motion.omega_b[:, 2] += np.gradient(turned, t_s)
    (impact,) = find(motion)
    assert impact.delta_v_mps == pytest.approx(8.0, abs=0.15)
    # It has turned 4 degrees before the push stands out; in turning axes the sum would point 43 degrees off.
    assert impact.pdof_deg == pytest.approx(270.0, abs=6.0)


def test_a_crash_whose_data_break_off_is_decided_by_what_there_is():
    motion = drive((IMPACT_S, -9.0, 0.0, 0.0, 0.12))
    seen = np.flatnonzero(motion.t_ns < EPOCH_NS + 3.09e9)
    later = np.flatnonzero(motion.t_ns > EPOCH_NS + 5.0e9)
    (impact,) = find(take(motion, np.concatenate([seen, later])))
    assert 5.0 < impact.delta_v_mps < 9.0  # three quarters of the pulse were seen


def test_samples_that_are_no_numbers_or_come_twice_change_nothing():
    motion = drive((IMPACT_S, -4.0, 0.0, 0.0, 0.1))
    expected = find(motion)
    order = np.repeat(np.arange(len(motion.t_ns)), 2)
    assert find(take(motion, order)) == expected
    motion.f_b[100:105] = np.nan
    motion.omega_b[150] = np.inf
    assert [impact.t_ns for impact in find(motion)] == [impact.t_ns for impact in expected]


@pytest.mark.parametrize("rate_hz", [50.0, 100.0, 400.0, 1000.0])
def test_other_rates_find_the_same(rate_hz):
    (impact,) = find(drive((IMPACT_S, -6.0, 2.0, 0.0, 0.12), rate_hz=rate_hz))
    assert impact.delta_v_mps == pytest.approx(math.hypot(6, 2), rel=0.05)  # five samples a pulse at 50 Hz


def test_an_unlikely_mounting_while_it_is_unknown_still_finds_the_crash():
    motion = drive((IMPACT_S, -6.0, 0.0, 0.0, 0.12), attitude=False)
    C = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])  # the box's x axis along the vertical
    upright = dataclasses.replace(motion, f_b=motion.f_b @ C.T, omega_b=motion.omega_b @ C.T)
    (impact,) = find(upright)
    assert impact.delta_v_mps == pytest.approx(6.0, abs=0.6)


def test_classes_of_severity():
    limits = SeverityThresholds()
    assert classify(3.5, 0.1, limits) is Severity.LOW_SPEED
    assert classify(6.4, 0.1, limits) is Severity.LOW_SPEED
    assert classify(6.6, 0.1, limits) is Severity.SEVERE
    assert classify(7.0, 0.1, limits) is Severity.AIRBAG
    assert classify(12.0, 0.9, limits) is Severity.SEVERE
    assert classify(20.0, 0.3, limits) is Severity.AIRBAG


def test_confidence_of_crashes_grows_with_their_change_of_velocity():
    found = [find(drive((IMPACT_S, -dv, 0.0, 0.0, 0.1)))[0].confidence for dv in (2.5, 4.0, 8.0, 15.0)]
    assert found == sorted(found)


def test_direction_of_force_is_in_0_to_360():
    assert force_direction_deg(-1.0, 0.0) == 0.0
    assert 0.0 <= force_direction_deg(-1.0, 1e-18) < 360.0


def test_thresholds_refuse_what_makes_no_sense():
    with pytest.raises(InvalidInputError, match=r"TriggerThresholds\.tyre_mps2.*expected 5 to 20 m/s2"):
        TriggerThresholds(tyre_mps2=1.1)


def test_clipping_one_axis_does_not_turn_the_direction_of_force():
    (impact,) = find(drive((IMPACT_S, -9.4, -3.4, 0.0, 0.12), full_scale_g=2.0))
    assert impact.clipped
    # Clipped at 2 g ahead alone, the readings themselves would point 35 degrees to the right.
    off_deg = abs(impact.pdof_deg - math.degrees(math.atan2(3.4, 9.4)))
    assert off_deg < min(10.0, 2.0 * impact.pdof_sd_deg)


@pytest.mark.parametrize(("name", "seed"), [("rollover", 47), ("sideswipe", 40), ("parked_hit", 31), ("rear", 28)])
def test_what_brakes_cannot_have_begun_is_suspected_within_150_ms_however_slowly_it_swells(name, seed):
    case = accident_case(name, seed)
    assert min(one.decided_t_ns for one in ImpactDetector().step(case.motion).impacts) - case.t_ns <= 150_000_000


def test_each_impact_of_an_accident_is_told_with_its_own_figures():
    blows = ((IMPACT_S, -4.0, 0.0, 0.0, 0.12), (IMPACT_S + 1.5, 0.0, 5.0, 0.0, 0.12))
    (impact,) = find(drive(*blows, seconds=15.0))
    assert impact.impacts == len(impact.each) == 2
    for one, (start_s, forward, right, _, _) in zip(impact.each, blows, strict=True):
        assert (one.t_ns - EPOCH_NS) * 1e-9 == pytest.approx(start_s, abs=0.02)
        assert one.delta_v_b_mps == pytest.approx((forward, right), abs=0.3)  # noise, and what the first blow nodded
        assert one.delta_v_interval_mps[0] <= math.hypot(forward, right) <= one.delta_v_interval_mps[1]
    assert (impact.delta_v_mps, impact.pdof_deg) == (impact.each[1].delta_v_mps, impact.each[1].pdof_deg)


def test_where_either_of_two_impacts_may_have_been_the_worst_the_directions_spread_says_so():
    alike = find(drive((IMPACT_S, -4.0, 0.0, 0.0, 0.12), (IMPACT_S + 1.5, 0.0, 4.0, 0.0, 0.12), seconds=15.0))
    apart = find(drive((IMPACT_S, -4.0, 0.0, 0.0, 0.12), (IMPACT_S + 1.5, 0.0, 8.0, 0.0, 0.12), seconds=15.0))
    assert apart[0].pdof_sd_deg < 6.0
    assert 1.96 * alike[0].pdof_sd_deg > 85.0  # the other one came from about 90 deg beside


def test_what_clipping_hid_is_estimated_only_of_what_is_told_or_kept(monkeypatch):
    asked = []
    monkeypatch.setattr("core.accident.impacts.unclip", lambda *pulse: asked.append(pulse) or unclip(*pulse))
    rng = np.random.default_rng(5)
    motion = drive(seconds=20.0)
    shaken = motion.f_b + 60.0 * np.convolve(rng.normal(0.0, 1.0, len(motion.t_ns)), np.ones(4), "same")[:, None]
    motion.saturated[:] = (np.abs(shaken) >= 2.0 * G).any(axis=1)
    np.clip(shaken, -2.0 * G, 2.0 * G, out=motion.f_b)
    findings = ImpactDetector().step(motion)
    assert motion.saturated.mean() > 0.5
    assert findings.impacts
    # Impacts are told, and counted, once a pulse, candidates are kept once in two seconds; pulses are looked at eight
    # times each, three and more of them in each second.
    assert 0 < len(asked) <= 20


@pytest.mark.parametrize("length_s", [0.12, 0.2, 0.3])
def test_a_pulse_is_read_to_the_end_of_its_flank_and_the_braking_after_it_is_left_out(length_s):
    motion = drive((IMPACT_S, -4.5, 0.0, 0.0, length_s), seconds=15.0)
    t_s = (motion.t_ns - EPOCH_NS) * 1e-9
    motion.f_b[(t_s > IMPACT_S + length_s) & (t_s < IMPACT_S + length_s + 1.5), 0] -= 5.0
    motion.speed_mps[t_s > IMPACT_S + 1.5] = 0.0
    (impact,) = find(motion)
    assert impact.delta_v_mps == pytest.approx(4.5, abs=0.3)  # a tail of 0.06 s at 5 m/s2


def test_a_parked_car_is_known_as_parked_though_it_moves_once_it_is_struck():
    push, friction = (IMPACT_S, 2.0, 0.0, 0.0, 0.1), (IMPACT_S + 0.1, -2.0, 0.0, 0.0, 0.5)
    motion = drive(push, friction, speed_mps=0.0, seconds=15.0)
    t_s = (motion.t_ns - EPOCH_NS) * 1e-9
    motion.speed_mps[(t_s > IMPACT_S + 0.03) & (t_s < IMPACT_S + 0.5)] = 1.5
    (impact,) = find(motion)
    assert impact.kind is Kind.PARKED_HIT
