"""A gyroscope that hangs is told from one that is coarse, and the heading is sure of itself no longer."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from core.held_axes import HeldAxes
from core.navigation.filter import FilterConfig
from core.navigation.track import TRACK
from core.preparation import Mounting
from core.session import Session, SessionConfig
from core.simulation.scenarios import simulate

RATE_HZ = 100
STEP_RADPS = math.radians(0.07)
"""A count of 16 bits over 2000 deg/s."""


def noise(duration_s, sd_radps, seed=1):
    return np.random.default_rng(seed).normal(0.0, sd_radps, (round(duration_s * RATE_HZ), 3))


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_an_axis_that_repeats_itself_as_it_never_did_hangs(axis):
    rates = noise(30.0, 2e-3)
    rates[2000:2500, axis] = rates[1999, axis]
    held = HeldAxes().step(rates)
    assert np.array_equal(np.flatnonzero(held), np.arange(2007, 2500))


@pytest.mark.parametrize("coarseness", [0.2, 1.0, 3.0, 10.0])
def test_a_coarse_sensor_does_not_hang(coarseness):
    # Ten steps to an sd: nearly always the same reading.
    rates = np.round(noise(600.0, STEP_RADPS / coarseness) / STEP_RADPS) * STEP_RADPS
    assert not HeldAxes().step(rates).any()
    assert not HeldAxes().step(np.zeros((1000, 3))).any()


def test_it_is_told_the_same_however_samples_come_and_after_a_restart():
    rates = noise(30.0, 2e-3)
    rates[2000:2500, 1] = rates[1999, 1]
    whole, axes, told = HeldAxes(), HeldAxes(), []
    expected = whole.step(rates)
    for first in range(0, len(rates), 37):
        again = HeldAxes()
        again.load(axes.arrays())
        axes = again
        told.append(axes.step(rates[first : first + 37]))
    assert np.array_equal(np.concatenate(told), expected)
    assert np.array_equal(axes.axes, whole.axes)


def test_the_heading_is_less_sure_while_the_turn_is_not_seen():
    drive = simulate("highway", 1, 120.0, RATE_HZ)
    m = drive.measurements
    first = int(np.searchsorted(m.imu_t_ns, drive.start_t_ns + 100 * 10**9))
    omega_s = m.omega_s.copy()
    omega_s[first : first + 3 * RATE_HZ] = omega_s[first - 1]
    # Where the vehicle may slide, nothing else says how it turns between two fixes.
    config = SessionConfig(mounting=Mounting(known=True), filter=FilterConfig(non_holonomic=False))
    yaw_sd = []
    for rates in (m.omega_s, omega_s):
        track = Session(config).step(replace(m, omega_s=rates)).track
        at = int(np.searchsorted(track.t_ns, m.imu_t_ns[first] + 8 * 10**8))  # the fix of the next second is to come
        yaw_sd.append(track.values[at, TRACK["sd_yaw_rad"]])
    assert yaw_sd[0] < 0.02
    assert yaw_sd[1] == pytest.approx(0.2 * 0.7, rel=0.2)  # rad/s, s since it was seen
