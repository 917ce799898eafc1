"""Aids that come late are let in at their own time, to the bit; and every aid leaves a record of what it measured."""

from __future__ import annotations

import functools
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from core.navigation import state
from core.navigation.aids import Aids
from core.navigation.filter import FilterConfig, NavigationFilter
from core.navigation.recorder import Recorder
from core.navigation.tuning import Tuning
from core.preparation import Mounting
from core.session import Session, SessionConfig
from core.simulation.scenarios import simulate

S = 10**9
FROM_S, UNTIL_S, END_S = 40, 117, 120
"""Fixes are late from ``FROM_S`` on, when the filter has aligned, and end so early that the latest one still comes."""


@functools.cache
def drive():
    """A motorway with every kind of aid: fixes, wheel speed, magnetometer and barometer, at the same instants too."""
    simulated = simulate("highway", 2, 150.0, 100.0)
    start_ns = simulated.start_t_ns
    m = simulated.measurements.between(start_ns, start_ns + END_S * S)
    kept = m.gnss_t_ns < start_ns + UNTIL_S * S
    return start_ns, replace(m, gnss_t_ns=m.gnss_t_ns[kept], gnss=m.gnss[kept])


def config(**changes):
    return SessionConfig(mounting=Mounting(known=True), filter=FilterConfig(**changes))


class Run:
    """A session over the drive in packets of 0.1 s, its fixes handed over ``late_s`` after their time."""

    def __init__(self, late_s=0.0, which=slice(None)):
        start_ns, m = drive()
        comes_ns = m.gnss_t_ns.copy()
        late = np.zeros(len(comes_ns), np.bool_)
        late[which] = True
        comes_ns[late & (m.gnss_t_ns >= start_ns + FROM_S * S)] += round(late_s * S)
        self.session, self.counts, rows = Session(config()), {}, []
        self.session.filter.recorder = self.recorder = Recorder()
        for low in range(start_ns, start_ns + END_S * S, S // 10):
            now = (comes_ns >= low) & (comes_ns < low + S // 10)
            packet = replace(m.between(low, low + S // 10), gnss_t_ns=m.gnss_t_ns[now], gnss=m.gnss[now])
            outputs = self.session.step(packet)
            rows.append(outputs.track)
            for name, count in outputs.counts.items():
                self.counts[name] = self.counts.get(name, 0) + count
        self.told_t_ns = np.concatenate([track.t_ns for track in rows])
        self.told = np.concatenate([track.values for track in rows])

    def arrays(self):
        return {name: value.tobytes() for name, value in self.session.filter.arrays().items()}


@functools.cache
def in_time():
    return Run()


@pytest.mark.parametrize("late_s", [0.4, 1.0, 1.9])
def test_however_late_fixes_come_the_state_is_the_same_in_the_end(late_s):
    late, prompt = Run(late_s), in_time()
    assert late.arrays() == prompt.arrays()
    # What was told before a fix had come stands, and was told as often and of the same instants.
    assert late.told_t_ns.tobytes() == prompt.told_t_ns.tobytes()
    assert late.told.tobytes() != prompt.told.tobytes()
    assert late.counts.get("gnss_position.rejected_time", 0) == 0


def test_a_single_fix_that_comes_after_its_successors_is_refused():
    start_ns, m = drive()
    at = int(np.searchsorted(m.gnss_t_ns, start_ns + 60 * S))
    late = Run(1.5, at)
    assert late.counts["gnss_position.rejected_time"] == 1


def test_a_fix_that_is_too_late_is_refused_and_changes_nothing():
    late_s = Tuning().late_s + 0.2
    late = Run(late_s)
    start_ns, m = drive()
    too_late = int((m.gnss_t_ns >= start_ns + FROM_S * S).sum())
    assert late.counts["gnss_position.rejected_time"] == too_late
    before = late.told_t_ns < start_ns + FROM_S * S
    assert late.told[before].tobytes() == in_time().told[before].tobytes()


@pytest.mark.parametrize("late_s", [0.4, 1.9])
def test_what_is_recorded_is_the_drive_as_it_was_in_the_end(late_s):
    late, prompt = Run(late_s).recorder, in_time().recorder
    assert late.track().t_ns.tobytes() == prompt.track().t_ns.tobytes()
    assert late.track().values.tobytes() == in_time().told.tobytes()
    assert late.aid_records().t_ns.tobytes() == prompt.aid_records().t_ns.tobytes()
    assert late.aid_records().values.tobytes() == prompt.aid_records().values.tobytes()
    for late_table, prompt_table in zip(late.node_table(), prompt.node_table(), strict=True):
        assert late_table.tobytes() == prompt_table.tobytes()
    assert late.starts_ns == prompt.starts_ns


@pytest.mark.parametrize("offset_s", [-0.37, 0.2])
def test_a_set_time_offset_tells_the_same_bits_however_the_stream_is_cut(offset_s):
    start_ns, m = drive()
    rng = np.random.default_rng(7)
    cuttings = (
        [],
        list(range(start_ns, start_ns + END_S * S, S)),
        sorted(int(t) for t in start_ns + rng.integers(0, END_S * S, 300)),
        [int(t) for t in m.imu_t_ns[::3] + 1],
    )
    told = []
    for cuts in cuttings:
        session, rows, counts = Session(config(gnss_time_offset_s=offset_s)), [], {}
        for low, high in pairwise([-(1 << 62), *cuts, 1 << 62]):
            outputs = session.step(m.between(low, high))
            rows.append(outputs.track.values)
            if len(rows) % 40 == 0:
                session = Session.restore(session.config, session.snapshot())
        counts = session.filter.counts
        assert counts[state.A_POSITION, state.FUSED] > 100
        told.append((np.concatenate(rows).tobytes(), counts.tobytes(), session.snapshot()))
    assert all(one == told[0] for one in told[1:])


def test_a_set_time_offset_is_as_if_the_times_had_been_right():
    _, m = drive()
    told = []
    for offset_s in (0.0, -0.25):
        stamped_ns = m.gnss_t_ns - round(offset_s * S)
        session = Session(config(gnss_time_offset_s=offset_s, tuning=Tuning(gnss_delay_given_sd_s=0.05)))
        session.step(replace(m, gnss_t_ns=stamped_ns))
        told.append(session.filter.x[: state.X_F].copy())
    # Not to the bit: the alignment waits for what comes after its second.
    assert told[0] == pytest.approx(told[1], rel=1e-6, abs=1e-3)


# Records


def test_every_aid_that_was_compared_has_a_record_an_axis():
    run = in_time()
    records, counts = run.recorder.aid_records(), run.session.filter.counts
    compared = counts[:, state.FUSED] + counts[:, state.REJECTED_GATE]
    for aid, axes in (
        (state.A_POSITION, 2), (state.A_HEIGHT, 1), (state.A_VELOCITY, 3), (state.A_SPEED, 1),
        (state.A_MAGNETOMETER, 1), (state.A_BAROMETER, 1), (state.A_ZUPT, 3), (state.A_ZARU, 3),
    ):  # fmt: skip
        assert compared[aid] > 0, state.AIDS[aid]
        for axis in range(axes):
            own = records.of(aid, axis)
            assert len(own.t_ns) == compared[aid], (state.AIDS[aid], axis)
            assert (own.column("variance") > 0.0).all()
            if (aid, axis) != (state.A_VELOCITY, 2):  # which has a gate of its own and counts with the others
                assert (own.column("outcome") == state.FUSED).sum() == counts[aid, state.FUSED]
    # The constraint counts each of its two axes, an aid as one.
    assert sum(len(records.of(state.A_NHC, axis).t_ns) for axis in (0, 1)) == compared[state.A_NHC]
    expected = records.column("innovation") ** 2 / records.column("variance")
    scalar = np.isin(records.column("aid"), [state.A_HEIGHT, state.A_SPEED, state.A_NHC, state.A_BAROMETER])
    assert records.column("ratio")[scalar] == pytest.approx(expected[scalar] / Tuning().gate_scalar, rel=1e-12)


def test_a_step_tells_its_records_and_of_an_aid_that_came_late_that_alone():
    start_ns, m = drive()
    late_ns = start_ns + 60 * S
    fused = NavigationFilter(FilterConfig())

    def step(low_ns, high_ns, gnss):
        part = m.between(low_ns, high_ns)
        return fused.step(part.imu_t_ns, part.f_s, part.omega_s, np.zeros(len(part.imu_t_ns)), Aids(gnss)).records

    until = m.gnss_t_ns < late_ns
    before = step(start_ns, late_ns + S, (m.gnss_t_ns[until], m.gnss[until]))
    at = np.flatnonzero(m.gnss_t_ns == late_ns)
    after = step(late_ns + S, late_ns + S + S // 10, (m.gnss_t_ns[at], m.gnss[at]))
    assert len(before.of(state.A_POSITION).t_ns) == fused.counts[state.A_POSITION, state.FUSED] - 1
    own = after.t_ns == late_ns
    assert sorted(set(after.column("aid")[own])) == [state.A_POSITION, state.A_HEIGHT, state.A_VELOCITY]
    assert own.sum() == 2 + 1 + 3
    assert (after.t_ns[~own] >= late_ns + S).all()


def test_records_of_a_drive_folded_at_once_are_those_of_its_packets():
    session = Session(config())
    recorder = session.filter.recorder = Recorder()
    session.step(drive()[1])
    assert recorder.aid_records().values.tobytes() == in_time().recorder.aid_records().values.tobytes()
    assert recorder.node_table()[1].tobytes() == in_time().recorder.node_table()[1].tobytes()
    assert (np.diff(recorder.aid_records().t_ns) >= 0).all()
