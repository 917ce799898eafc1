"""What an airbag's flag says of an accident, with a pulse and without one."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from core.accident.detector import ImpactDetector
from core.accident.events import Status
from core.measurements import FLAG_AIRBAG
from tests.crash_timelines import EPOCH_NS, IMPACT_S, drive, take, told


def test_an_airbag_makes_an_accident_certain_and_is_told_at_once():
    motion = drive((IMPACT_S, -6.0, 0.0, 0.0, 0.12), seconds=5.0)
    (revisions,) = told(dataclasses.replace(motion, flags=FLAG_AIRBAG))
    assert "airbag deployed" in revisions[-1].reasons
    assert revisions[-1].confidence > 0.99


@pytest.mark.parametrize("rises_s", [IMPACT_S - 0.5, IMPACT_S + 0.02, IMPACT_S + 1.0])
def test_an_airbag_flag_counts_wherever_packets_are_cut(rises_s):
    motion = drive((IMPACT_S, -6.0, 0.0, 0.0, 0.12), seconds=8.0)
    t_s = (motion.t_ns - EPOCH_NS) * 1e-9
    detector = ImpactDetector()
    before, after = (take(motion, np.flatnonzero(part)) for part in (t_s < rises_s, t_s >= rises_s))
    impacts = detector.step(dataclasses.replace(before, flags=0)).impacts
    for part in np.array_split(np.arange(len(after.t_ns)), 5):
        impacts += detector.step(dataclasses.replace(take(after, part), flags=FLAG_AIRBAG)).impacts
    told = ["airbag deployed" in one.reasons for one in impacts]
    assert any(told)
    assert told == sorted(told)  # once it is known every later revision says so
    assert len({one.t_ns for one in impacts}) == 1


def test_an_airbag_without_a_pulse_is_suspected_and_what_it_struck_belongs_to_it():
    motion = drive((IMPACT_S, -6.0, 0.0, 0.0, 0.12), seconds=8.0)
    t_s = (motion.t_ns - EPOCH_NS) * 1e-9
    detector, impacts = ImpactDetector(), []
    for part, flags in ((t_s < 2.0, 0), ((t_s >= 2.0) & (t_s < 2.5), FLAG_AIRBAG), (t_s >= 2.5, FLAG_AIRBAG)):
        impacts += detector.step(dataclasses.replace(take(motion, np.flatnonzero(part)), flags=flags)).impacts
    first, last = impacts[0], impacts[-1]
    assert first.status is Status.SUSPECTED
    assert first.impacts == 0
    assert 0.9 < first.confidence < 0.99
    assert first.delta_v_interval_mps[0] == 0.0  # nothing was felt yet
    assert last.t_ns == first.t_ns
    assert last.impacts == 1
    assert last.delta_v_mps == pytest.approx(6.0, abs=0.3)


def test_an_airbag_flag_that_was_set_from_the_start_tells_nothing_by_itself():
    assert ImpactDetector().step(dataclasses.replace(drive(), flags=FLAG_AIRBAG)).impacts == []


def test_an_airbag_flag_of_a_car_that_drives_on_unmoved_is_retracted():
    motion = drive(seconds=20.0)
    detector = ImpactDetector()
    impacts = [
        one
        for second, part in enumerate(np.array_split(np.arange(len(motion.t_ns)), 20))
        for one in detector.step(dataclasses.replace(take(motion, part), flags=FLAG_AIRBAG * (second > 3))).impacts
    ]
    assert [one.status for one in impacts] == [Status.SUSPECTED, Status.RETRACTED]


def test_an_airbag_flag_of_long_ago_says_nothing_of_a_later_accident():
    motion = drive((20.0, -6.0, 0.0, 0.0, 0.12), seconds=24.0)
    detector = ImpactDetector()
    halves = np.array_split(np.arange(len(motion.t_ns)), [200])
    impacts = [
        one
        for half in halves
        for one in detector.step(dataclasses.replace(take(motion, half), flags=FLAG_AIRBAG)).impacts
    ]
    assert impacts
    assert not any("airbag deployed" in one.reasons for one in impacts)
