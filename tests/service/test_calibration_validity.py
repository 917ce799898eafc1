"""A session uses the calibration that holds at each sample's time, to the bit however its stream comes."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from core.calibration.in_force import BoxCalibration
from core.preparation import Mounting
from core.sensors import TriadCalibration
from core.session import Session, SessionConfig
from service.storage.calibrations import EVER_NS, Timeline
from tests.service.fleet_drives import BETWEEN_NS, S, drive, seconds, trip, trips

FIRST = TriadCalibration(bias=(0.1, -0.05, 0.0))
SECOND = TriadCalibration(scale=(1.01, 1.0, 0.99), bias=(0.1, 0.2, -0.1))
START_NS = drive().start_t_ns
CHANGE_NS = START_NS + 61 * S + 234_567_890


def config(*versions, mounting=None):
    mounting = Mounting(drive().mounting_rpy_rad, known=True) if mounting is None else mounting
    return SessionConfig(mounting=mounting, calibrations=versions)


def two_versions():
    return BoxCalibration(1, 0, FIRST), BoxCalibration(2, CHANGE_NS, SECOND)


def told(settings, parts, restore_every=0):
    session, rows, biases = Session(settings), [], []
    for number, part in enumerate(parts, 1):
        outputs = session.step(part)
        rows.append(outputs.track.values)
        biases += [(one.version, one.biases.t_ns, one.biases.bias.tobytes(), one.drifts) for one in outputs.biases]
        if restore_every and number % restore_every == 0:
            session = Session.restore(settings, session.snapshot())
    return np.concatenate(rows).tobytes(), biases, session.snapshot()


def joined(parts):
    parts = list(parts)
    names = ("imu_t_ns", "f_s", "omega_s", "gnss_t_ns", "gnss", "magnetometer_t_ns", "magnetic_s_ut")
    return replace(parts[0], **{name: np.concatenate([getattr(part, name) for part in parts]) for name in names})


@pytest.mark.parametrize("mounting", [None, Mounting((0.0, 0.0, 0.5))])
@pytest.mark.parametrize("step_s", [1.0, 0.37, 7.0])
def test_a_change_inside_a_stream_gives_the_same_bits_for_any_packets(step_s, mounting):
    settings, whole = config(*two_versions(), mounting=mounting), drive().measurements
    expected = told(settings, [whole])
    assert told(settings, seconds(whole, step_s)) == expected
    assert told(settings, seconds(whole, step_s), restore_every=11) == expected


def test_each_sample_is_corrected_by_what_holds_at_its_time():
    whole, seen = drive().measurements, []
    session = Session(config(*two_versions()))
    collect, filter_step = seen.append, session.filter.step

    def noting(t_ns, f_b, *rest):
        collect((t_ns.copy(), f_b.copy()))
        return filter_step(t_ns, f_b, *rest)

    session.filter.step = noting
    versions = []
    for part in seconds(whole):
        session.step(part)
        versions.append(session.calibration_version)
    t_ns, f_b = (np.concatenate(rows) for rows in zip(*seen, strict=True))
    np.testing.assert_array_equal(t_ns, whole.imu_t_ns)
    for calibration, chosen in ((FIRST, t_ns < CHANGE_NS), (SECOND, t_ns >= CHANGE_NS)):
        # The mounting is level in this box: rounding of one affine map in place of two steps.
        expected = calibration.correct(whole.f_s[chosen])
        C = session._preparation.C_b_from_s
        np.testing.assert_allclose(f_b[chosen], expected @ C.T, atol=1e-12)
    assert versions == sorted(versions)
    assert set(versions) == {1, 2}


def test_before_the_first_version_the_box_counts_as_it_measures():
    late = BoxCalibration(1, START_NS + 30 * S, FIRST)
    session = Session(config(late))
    parts = list(seconds(drive().measurements))
    session.step(parts[0])
    assert session.calibration_version == 0
    for part in parts[1:40]:
        session.step(part)
    assert session.calibration_version == 1


def test_a_change_that_comes_after_the_stream_changes_nothing_in_it():
    early, late = two_versions()
    after = replace(late, valid_from_ns=START_NS + 3600 * S)
    rows, _, _ = told(config(early), seconds(drive().measurements))
    again, _, _ = told(config(early, after), seconds(drive().measurements))
    assert rows == again


def test_biases_folded_back_are_the_same_however_the_stream_is_cut():
    settings = config(BoxCalibration(1, 0, FIRST))
    whole = [joined([part]) for part in trips(2)]
    # Ignition holds for a packet: cut at its changes, and anywhere else.
    expected = told(settings, whole)
    assert len(expected[1]) >= 1, "the first trip's end was seen"
    cut = [piece for part in whole for piece in seconds(part, 1.0)]
    odd = [piece for part in whole for piece in seconds(part, 3.3)]
    assert told(settings, cut, restore_every=17) == expected
    assert told(settings, odd) == expected


def test_a_session_begun_anew_goes_on_with_what_trips_had_found():
    driving, _ = trip()
    session = Session(config(BoxCalibration(1, 0, FIRST)))
    updates = []
    for part in trips(1):
        for second in seconds(part):
            updates += session.step(second).biases
    (update,) = updates
    fresh = Session(config(BoxCalibration(1, 0, FIRST, learnt=update.biases)))
    later = replace(driving, imu_t_ns=driving.imu_t_ns + BETWEEN_NS)
    fresh.step(later.between(int(later.imu_t_ns[0]), int(later.imu_t_ns[0]) + S))
    stored = fresh._in_force.follower.stored
    np.testing.assert_array_equal(stored.bias, update.biases.bias)


def test_samples_with_damaged_times_are_cut_like_any_others():
    m = drive().measurements
    t_ns = m.imu_t_ns.copy()
    t_ns[700:] += 1 << 61
    t_ns[300:320] = t_ns[300:320][::-1]
    session = Session(config(*two_versions()))
    outputs = session.step(replace(m, imu_t_ns=t_ns))
    # 19 of the 20 reversed ones are late, as the first of them is their newest; beyond 2116 is no time.
    assert outputs.counts["imu.rejected_time"] == 19


VERSIONS = {
    "nothing": ([], {0: 0, 10**18: 0}, {0: None}),
    "one ever since": ([(1, None, EVER_NS)], {0: 1, 10**18: 1}, {0: 0, 1: None}),
    "one after the other": ([(1, None, 0), (2, None, 50)], {49: 1, 50: 2, 60: 2}, {1: 50, 2: None}),
    "one planned, then one for now": ([(1, None, 100), (2, None, 50)], {0: 0, 60: 2, 100: 1}, {0: 50, 2: 100}),
    "put again for the same time": ([(1, None, 50), (2, None, 50)], {49: 0, 50: 2}, {1: 50, 2: None}),
    "brought up to date by trips": ([(1, None, 0), (2, 1, 10), (3, 1, 20)], {5: 1, 15: 2, 25: 3}, {1: 10, 2: 20}),
    "a new one ends what trips made of the old": (
        [(1, None, 0), (2, 1, 10), (3, None, 15), (4, 1, 20), (5, 3, 30)],
        {12: 2, 15: 3, 25: 3, 30: 5},
        {2: 15, 3: 30, 4: 20, 5: None},
    ),
    "a box never calibrated": ([(1, 0, 10), (2, None, 20)], {5: 0, 10: 1, 20: 2}, {0: 10, 1: 20}),
}


@pytest.mark.parametrize("name", VERSIONS)
def test_which_version_holds_when(name):
    versions, at, ends = VERSIONS[name]
    timeline = Timeline(versions)
    assert {t_ns: timeline.version_at(t_ns) for t_ns in at} == at
    assert {version: timeline.end_ns(version) for version in ends} == ends
    known = [version for version, _, _ in versions]
    instants = sorted({0, *(from_ns for _, _, from_ns in versions)})
    for low, high in pairwise([*instants, instants[-1] + 10]):
        assert timeline.version_at(low) == timeline.version_at(high - 1), "it changes only where one begins"
    assert {timeline.version_at(t) for t in instants} <= {0, *known}
