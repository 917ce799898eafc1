"""How fast a box warms up, from a thermometer with steps or from its biases alone; and that these are the less sure."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from core.navigation import state
from core.navigation.warming import Warming
from core.preparation import Mounting
from core.session import Session, SessionConfig
from core.simulation.faults import Fault, inject
from core.simulation.scenarios import simulate
from core.simulation.stream import Stream

S = 10**9
START_NS = 1_700_000_000 * S


def rate(temperatures_c, every_s=1.0):
    warming = Warming()
    for k, temperature_c in enumerate(temperatures_c):
        warming.step(START_NS + round(k * every_s * S), float(temperature_c))
    return warming.rate_kps


@pytest.mark.parametrize("kps", [0.09, -0.02])
@pytest.mark.parametrize("step_k", [0.01, 1.0])
def test_a_steady_change_is_told_whatever_the_steps(kps, step_k):
    t_s = np.arange(300.0)
    # A step late by as much as a second of the reading's interval.
    assert rate(np.round((20.0 + kps * t_s) / step_k) * step_k) == pytest.approx(abs(kps), rel=0.15)


def test_it_fades_when_the_change_ends_and_noise_is_none():
    warming_up = np.concatenate([20.0 + 0.1 * np.arange(100.0), np.full(200, 30.0)])
    assert rate(warming_up) == pytest.approx(1.0 / 200.0, rel=0.1)
    assert rate(20.0 + 0.3 * np.sin(np.arange(1000.0))) <= 1.0 / 900.0
    assert rate([math.nan] * 10) == 0.0
    assert rate([20.0]) == 0.0


def test_a_session_trusts_its_biases_less_while_the_box_warms_up():
    m = simulate("city", 1, 120.0, 50.0).measurements
    sd = []
    for kps in (math.nan, 0.0, 0.1):
        session = Session(SessionConfig(mounting=Mounting(known=True)))
        for k in range(120):
            if k == 60:
                session = Session.restore(session.config, session.snapshot())
            from_ns = int(m.imu_t_ns[0]) + k * S
            session.step(replace(m.between(from_ns, from_ns + S), temperature_c=20.0 + kps * k))
        variance = np.diag(session.filter.covariance())
        sd.append(np.sqrt(variance[state.GYRO_BIAS : state.GYRO_BIAS + 3]))
    assert np.array_equal(sd[0], sd[1])
    # 0.1 K/s at 0.03 deg/s/K drift by 3e-3 deg/s in each of the seconds that a velocity takes to say so.
    assert (sd[2] > 3.0 * sd[1]).all()


def warmed_drive(rise_k, seed):
    """150 s, which a receiver sees all along, of a box without a thermometer that warms up as 1 - exp(-t / 300 s)."""
    stream = Stream.of(simulate("highway", seed, 150.0, 50.0).measurements)
    faults = [Fault.of("temperature", 0.0, 600.0, rise_k)] if rise_k else []
    return replace(inject(stream, faults, np.random.default_rng(seed)), temperature_c=None).measurements


def ridden(m, packet_s=1.0, restored_at_s=None):
    session = Session(SessionConfig(mounting=Mounting(known=True)))
    edges_ns = m.imu_t_ns[0] + np.arange(0, 150 * S + 1, round(packet_s * S))
    for from_ns, to_ns in itertools.pairwise(edges_ns):
        if restored_at_s is not None and from_ns - edges_ns[0] == restored_at_s * S:
            session = Session.restore(session.config, session.snapshot())
        session.step(m.between(int(from_ns), int(to_ns)))
    return session.filter


@pytest.mark.parametrize("rise_k", [25.0, -25.0, 60.0])
def test_biases_alone_tell_that_a_box_warms_up_or_cools_down(rise_k):
    found_kps = ridden(warmed_drive(rise_k, 3)).x[state.X_WARMING]
    true_kps = abs(rise_k) / 300.0 * math.exp(-130.0 / 300.0)
    # An order of magnitude is what a walk's variance is worth: it lags at first, then catches up.
    assert 0.5 * true_kps < found_kps < 4.0 * true_kps


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_box_at_one_temperature_is_not_taken_for_one_that_warms_up(seed):
    assert ridden(warmed_drive(0.0, seed)).x[state.X_WARMING] == 0.0


def test_what_biases_tell_is_the_same_however_the_stream_is_cut_and_restored():
    m = warmed_drive(25.0, 3)
    whole, cut = ridden(m), ridden(m, packet_s=0.3, restored_at_s=90)
    assert whole.x[state.X_WARMING] > 0.0
    assert np.array_equal(whole.x, cut.x)
    assert np.array_equal(whole.p, cut.p)
