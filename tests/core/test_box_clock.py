"""A box's clock that steps back is told from samples that come late or again, and time goes on."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from core.box_clock import ANEW, LET_GO, REMEMBERED_S, STEPPED, BoxClock
from core.measurements import GNSS_COLUMNS, Measurements
from core.navigation.track import TRACK, Mode
from core.preparation import Mounting
from core.session import Session, SessionConfig
from core.simulation.scenarios import simulate

S = 10**9
PERIOD_NS = S // 50
START_NS = 1_700_000_000 * S + 123_000_000


def sampled(duration_s, seed=1):
    """Noise at 50 Hz, with a fix every half second."""
    rng = np.random.default_rng(seed)
    n = round(duration_s * 50)
    m = n // 25
    return Measurements(
        imu_t_ns=START_NS + PERIOD_NS * np.arange(n),
        f_s=rng.normal(size=(n, 3)),
        omega_s=rng.normal(size=(n, 3)),
        gnss_t_ns=START_NS + 25 * PERIOD_NS * np.arange(m) + 1,
        gnss=np.zeros((m, len(GNSS_COLUMNS))),
    )


def between(m, from_s, until_s):
    return m.between(START_NS + round(from_s * S), START_NS + round(until_s * S))


def moved(m, by_ns):
    names = ("imu_t_ns", "gnss_t_ns", "magnetometer_t_ns", "speed_t_ns", "barometer_t_ns")
    return replace(m, **{name: getattr(m, name) + by_ns for name in names})


def packets(m, packet_s=1.0):
    edges = range(int(m.imu_t_ns[0]), int(m.imu_t_ns[-1]), round(packet_s * S))
    return [m.between(low, high) for low, high in pairwise([*edges, 1 << 62])]


def folded(clock, parts):
    """Times that a clock gives the samples and the fixes of parts, and what happened."""
    given = [clock.step(part) for part in parts]
    imu = np.concatenate([m.imu_t_ns for m, _ in given])
    gnss = np.concatenate([m.gnss_t_ns for m, _ in given])
    return imu, gnss, [happened for _, happened in given if happened]


@pytest.mark.parametrize("packet_s", [0.02, 0.33, 1.0, 7.0])
@pytest.mark.parametrize("back_s", [2.1, 3.0, 30.0, 250.0])
def test_time_goes_on_where_the_clock_steps_back(back_s, packet_s):
    m = sampled(320.0)
    parts = [
        *packets(between(m, 0, 300), packet_s),
        *packets(moved(between(m, 300, 320), -round(back_s * S)), packet_s),
    ]
    imu, gnss, happened = folded(BoxClock(), parts)
    assert happened == [STEPPED]
    # All but a second of the run from which it was seen, with the fixes in the packets of that second.
    kept = np.flatnonzero(imu == m.imu_t_ns)
    assert np.array_equal(np.flatnonzero(imu != m.imu_t_ns), 300 * 50 + np.arange(50))
    assert kept[-1] == len(imu) - 1
    wrong = np.flatnonzero(gnss != m.gnss_t_ns)
    assert len(wrong) <= 2
    assert (wrong >= 600).all()


def test_it_steps_again_and_its_state_can_be_kept():
    m = sampled(60.0)
    parts = [
        *packets(between(m, 0, 20)),
        *packets(moved(between(m, 20, 40), -5 * S)),
        *packets(moved(between(m, 40, 60), -12 * S)),
    ]
    whole, pieces = BoxClock(), BoxClock()
    given = []
    for part in parts:
        kept = BoxClock()
        kept.load({name: value.copy() for name, value in pieces.arrays().items()})
        pieces = kept
        given.append(pieces.step(part)[0].imu_t_ns)
    imu, _, happened = folded(whole, parts)
    assert happened == [STEPPED, STEPPED]
    assert whole.offset_ns == 12 * S
    assert np.array_equal(np.concatenate(given), imu)
    assert (imu != m.imu_t_ns).sum() == 100


@pytest.mark.parametrize("again", [(3.0, 10.0), (0.0, 30.0), (4.4, 9.9), (25.0, 27.0)])
def test_what_comes_again_is_no_step(again):
    m = sampled(60.0)
    clock = BoxClock()
    parts = [
        *packets(between(m, 0, 40)),
        between(m, *again),
        *packets(between(m, *again), 0.1),
        *packets(between(m, 40, 60)),
    ]
    _, _, happened = folded(clock, parts)
    assert happened == []
    assert clock.offset_ns == 0


def test_samples_that_come_late_are_no_step():
    m = sampled(60.0)
    order = np.arange(len(m.imu_t_ns))
    rng = np.random.default_rng(3)
    for late in rng.choice(len(order) - 400, 300, replace=False):  # up to 8 s late, here and there
        order = np.insert(np.delete(order, late), late + rng.integers(1, 400), order[late])
    shuffled = replace(m, imu_t_ns=m.imu_t_ns[order], f_s=m.f_s[order], omega_s=m.omega_s[order])
    clock = BoxClock()
    given, happened = clock.step(shuffled)
    assert happened == 0
    assert given is shuffled


def test_a_step_shorter_than_fixes_may_be_late_is_waited_for():
    m = sampled(60.0)
    clock = BoxClock()
    _, _, happened = folded(clock, [*packets(between(m, 0, 40)), *packets(moved(between(m, 40, 60), -3 * S // 2))])
    assert happened == []
    assert clock.offset_ns == 0


def test_every_sample_may_come_twice():
    m = sampled(60.0)
    twice = [
        replace(p, imu_t_ns=p.imu_t_ns.repeat(2), f_s=p.f_s.repeat(2, 0), omega_s=p.omega_s.repeat(2, 0))
        for p in [*packets(between(m, 0, 40)), *packets(moved(between(m, 40, 60), -10 * S))]
    ]
    clock = BoxClock()
    _, _, happened = folded(clock, twice)
    assert happened == [STEPPED]
    assert clock.offset_ns == 10 * S


@pytest.mark.parametrize(("pause_s", "let_go"), [(10.0, False), (33.0, False), (40.0, True)])
def test_a_pause_longer_than_the_step_brings_the_box_s_own_times_back(pause_s, let_go):
    m = sampled(60.0)
    parts = [
        *packets(between(m, 0, 20)),
        *packets(moved(between(m, 20, 40), -30 * S)),
        *packets(moved(between(m, 40, 60), round(pause_s * S) - 30 * S)),
    ]
    clock = BoxClock()
    imu, gnss, happened = folded(clock, parts)
    assert happened == ([STEPPED, LET_GO] if let_go else [STEPPED])
    assert clock.offset_ns == (0 if let_go else 30 * S)
    later_ns = round(pause_s * S) - (30 * S if let_go else 0)
    assert np.array_equal(imu[-1000:], m.imu_t_ns[-1000:] + later_ns)
    assert np.array_equal(gnss[-40:], m.gnss_t_ns[-40:] + later_ns)
    assert (np.diff(imu[imu >= m.imu_t_ns]) > 0).all()


def test_too_far_back_to_carry_on_it_begins_anew_in_the_box_s_own_times():
    m = sampled(200.0)
    back_ns = (REMEMBERED_S + 10) * S
    clock = BoxClock()
    _, _, happened = folded(clock, [*packets(between(m, 0, 100)), *packets(moved(between(m, 100, 155), -back_ns))])
    assert happened == []  # it might come again, of a time that is not remembered
    later = moved(between(m, 155, 200), -back_ns)
    given, what = clock.step(later)
    assert what == ANEW
    assert np.array_equal(given.imu_t_ns, later.imu_t_ns[5 * 50 :])
    assert clock.offset_ns == 0


def test_a_session_begins_anew_and_ends_its_trip():
    drive = simulate("highway", 2, 300.0, 50.0)
    m = drive.measurements
    zero_ns, back_ns = int(m.imu_t_ns[0]), 3600 * S
    session = Session(SessionConfig(mounting=Mounting(known=True)))
    told, trips, counts = [], [], {}
    for k in range(300):
        part = m.between(zero_ns + k * S, zero_ns + (k + 1) * S)
        outputs = session.step(part if k < 100 else moved(part, -back_ns))
        if k == 200:
            session = Session.restore(session.config, session.snapshot())
        told.append(outputs.track)
        trips += outputs.trips
        counts = {name: counts.get(name, 0) + outputs.counts.get(name, 0) for name in {*counts, *outputs.counts}}
    assert counts["clock.begun_anew"] == 1
    before, after = trips[0], trips[-1]
    assert [trip.start_t_ns for trip in trips if trip.ended] == [before.start_t_ns]
    assert after.start_t_ns < before.start_t_ns - back_ns // 2
    assert told[-1].t_ns[-1] == m.imu_t_ns[-1] - back_ns or told[-1].t_ns[-1] > m.imu_t_ns[-1] - back_ns - S // 5
    assert (told[-1].column("mode") == Mode.AIDED).all()
    assert told[-1].values[-1, TRACK["sd_n_m"]] < 5.0
