"""What a new start takes from the alignment, and what it keeps of what was learnt before."""

from __future__ import annotations

import numpy as np
import pytest

from core.navigation import state
from core.navigation.alignment import InitialState
from core.navigation.starting import KEPT, begin
from core.navigation.tuning import Tuning

FOUND = InitialState(
    t_ns=1_700_000_000_000_000_000,
    lat_rad=0.8,
    lon_rad=0.3,
    alt_m=200.0,
    position_sd_m=(3.0, 5.0),
    v_n=np.array([10.0, 1.0, 0.0]),
    velocity_sd_mps=0.5,
    q_n_from_b=np.array([1.0, 0.0, 0.0, 0.0]),
    tilt_sd_rad=0.02,
    yaw_sd_rad=0.1,
    gyro_bias_radps=np.zeros(3),
    gyro_bias_sd_radps=1e-3,
)


def started(kept):
    x, ti = np.zeros(state.NX), np.zeros(state.NT, np.int64)
    x[list(KEPT.values())] = learnt = 0.01 * np.arange(1, len(KEPT) + 1)
    ti[state.I_COUNTS :] = 7
    p = begin(x, ti, FOUND, kept, Tuning(), 0.09, given_offset=False)
    return x, ti, p, learnt


def test_after_a_gap_what_was_learnt_stays_with_its_spread():
    spread = np.diag(np.full(state.N_STATES, 1e-8))
    x, _, p, learnt = started(spread)
    assert (x[list(KEPT.values())] == learnt).all()
    assert (p[list(KEPT), list(KEPT)] == 1e-8).all()


def test_where_nothing_holds_any_more_all_begins_at_nothing():
    x, ti, p, _ = started(None)
    assert (x[list(KEPT.values())] == 0.0).all()
    assert p[state.GYRO_SCALE, state.GYRO_SCALE] == pytest.approx(Tuning().gyro_scale_sd ** 2)
    assert (ti[state.I_COUNTS :] == 7).all()


def test_the_start_is_a_spread_that_can_be():
    _, _, p, _ = started(None)
    assert (p == p.T).all()
    assert np.linalg.eigvalsh(p).min() > 0.0
