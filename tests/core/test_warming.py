"""How fast a box warms up, from a thermometer with steps; and that biases are the less sure the faster it does."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from core.navigation import state
from core.navigation.warming import Warming
from core.preparation import Mounting
from core.session import Session, SessionConfig
from core.simulation.scenarios import simulate

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
