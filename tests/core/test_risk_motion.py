"""Speed and acceleration from velocities: of a circle, a braking, and around gaps."""

from __future__ import annotations

import numpy as np
import pytest

from core.risk.motion import motion_at

SECOND = 1_000_000_000


def moved(t_s, series_s, v_n):
    exact = np.zeros(len(t_s))
    ns = [np.rint(np.asarray(x) * 1e9).astype(np.int64) + 1_700_000_000 * SECOND for x in (t_s, series_s)]
    return motion_at(ns[0], ns[1], np.asarray(v_n, float), exact, exact)


def test_a_circle_to_the_right_pulls_right_alone():
    t = np.arange(0.0, 20.0, 0.01)
    speed, rate = 12.0, 0.1
    v = speed * np.column_stack([np.cos(rate * t), np.sin(rate * t)])
    motion = moved(np.arange(2.0, 18.0), t, v)
    assert motion.speed_mps == pytest.approx(speed, abs=1e-3)
    assert motion.forward_mps2 == pytest.approx(0.0, abs=1e-9)
    # The chord of a second is shorter than the arc by (rate / 2)^2 / 6, 0.04 %.
    assert motion.right_mps2 == pytest.approx(speed * rate, rel=1e-3)


def test_braking_is_backward_whatever_the_heading():
    t = np.arange(0.0, 6.0, 0.05)
    for heading in np.radians([0.0, 77.0, 200.0, 359.0]):
        v = (20.0 - 3.0 * t)[:, None] * np.array([np.cos(heading), np.sin(heading)])
        motion = moved(np.arange(1.0, 5.0), t, v)
        assert motion.forward_mps2 == pytest.approx(-3.0)
        assert motion.right_mps2 == pytest.approx(0.0, abs=1e-9)


def test_standing_is_no_acceleration():
    motion = moved([1.0, 2.0], np.arange(0.0, 4.0, 0.1), np.zeros((40, 3)))
    assert motion.known.all()
    for column in (motion.speed_mps, motion.forward_mps2, motion.right_mps2):
        assert column.tolist() == [0.0, 0.0]


def test_a_gap_is_unknown_and_its_edges_are_not():
    """Fixes of 1 Hz, none from 10 to 19 s, speeding up by 1 m/s2: at 9 and 20 s what there is on one side counts."""
    series = np.array([*range(10), *range(20, 30)], float)
    motion = moved(np.arange(0.0, 30.0), series, np.column_stack([series, 0.0 * series]))
    assert np.flatnonzero(~motion.known).tolist() == list(range(10, 20))
    assert motion.forward_mps2[motion.known] == pytest.approx(1.0)
    assert motion.speed_mps[motion.known] == pytest.approx(series)


def test_slow_receivers_have_longer_steps():
    series = np.arange(0.0, 60.0, 5.0)
    motion = moved(np.arange(0.0, 55.0), series, np.column_stack([series, series]))
    assert motion.known.all()


def test_missing_velocities_are_no_velocities():
    v = np.column_stack([np.arange(10.0), np.zeros(10)])
    v[3:8] = np.nan
    assert np.flatnonzero(~moved(np.arange(10.0), np.arange(10.0), v).known).tolist() == [3, 4, 5, 6, 7]
    assert not moved([0.0], [0.0], [[1.0, 0.0]]).known.any()
    assert not moved([], [0.0, 1.0], [[1.0, 0.0]] * 2).known.any()


def test_a_filters_correction_is_no_acceleration():
    """A steady braking of 2 m/s2 whose velocity is set right by 3 m/s after 5 s."""
    t = np.arange(0.0, 10.0, 0.01)
    v = np.column_stack([30.0 - 2.0 * t + 3.0 * (t >= 5.0), 0.0 * t])
    ns = np.rint(t * 1e9).astype(np.int64)
    exact = np.zeros(8)
    motion = motion_at(np.arange(1, 9) * SECOND, ns, v, exact, exact, np.isclose(t, 5.0))
    assert motion.forward_mps2 == pytest.approx(-2.0)
    assert motion.speed_mps == pytest.approx(30.0 - 2.0 * np.arange(1, 9) + 3.0 * (np.arange(1, 9) >= 5))
