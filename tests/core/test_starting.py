"""What a new start takes from the alignment, and what it keeps of what was learnt before."""

from __future__ import annotations

import numpy as np
import pytest

from core.earth import ned_offset_m
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


GAP_S = 60.0
DELAY_S = 0.3


def started(kept, fix_error_n_m=(0.0, 0.0, 0.0)):
    x, ti = np.zeros(state.NX), np.zeros(state.NT, np.int64)
    x[state.X_GNSS_ERROR : state.X_GNSS_ERROR + 3] = fix_error_n_m
    ti[state.T_DECAY] = FOUND.t_ns - round(GAP_S * 1e9)
    x[list(KEPT.values())] = learnt = 0.01 * np.arange(1, len(KEPT) + 1)
    x[state.X_GNSS_DELAY] = DELAY_S
    ti[state.I_COUNTS :] = 7
    p = begin(x, ti, FOUND, kept, Tuning(), 0.09, given_offset=False)
    return x, ti, p, learnt


def test_after_a_gap_what_was_learnt_stays_with_its_spread():
    spread = np.diag(np.full(state.N_STATES, 1e-8))
    x, _, p, learnt = started(spread)
    assert (x[list(KEPT.values())] == learnt).all()
    assert (p[list(KEPT), list(KEPT)] == 1e-8).all()


def test_after_a_gap_a_delay_can_be_learnt_anew():
    x, _, p, _ = started(np.diag(np.full(state.N_STATES, 1e-8)))
    assert x[state.X_GNSS_DELAY] == DELAY_S
    assert p[state.GNSS_DELAY, state.GNSS_DELAY] == pytest.approx(Tuning().gnss_delay_sd_s ** 2)


def test_where_nothing_holds_any_more_all_begins_at_nothing():
    x, ti, p, _ = started(None)
    assert (x[list(KEPT.values())] == 0.0).all()
    assert p[state.GYRO_SCALE, state.GYRO_SCALE] == pytest.approx(Tuning().gyro_scale_sd ** 2)
    assert (ti[state.I_COUNTS :] == 7).all()


def test_the_start_is_a_spread_that_can_be():
    _, _, p, _ = started(None)
    assert (p == p.T).all()
    assert np.linalg.eigvalsh(p).min() > 0.0


def test_after_a_gap_the_fixes_are_off_as_before_and_the_less_so_the_longer_it_was():
    spread = np.diag(np.full(state.N_STATES, 1.0))
    x, _, p, _ = started(spread, (4.0, -2.0, 30.0))
    share = np.exp(-GAP_S / Tuning().gnss_correlation_s)
    assert x[state.X_GNSS_ERROR : state.X_GNSS_ERROR + 3] == pytest.approx(share * np.array([4.0, -2.0, 30.0]))
    # Down by 30 m: the fix lies too low, and the vehicle above it.
    offset_n_m = ned_offset_m(*x[[state.X_LAT, state.X_LON, state.X_ALT]], (FOUND.lat_rad, FOUND.lon_rad, FOUND.alt_m))
    assert offset_n_m == pytest.approx(-share * np.array([4.0, -2.0, 30.0]), abs=1e-3)
    # Three of its sd and more: off by half of that is usual from now on.
    down = state.GNSS_ERROR + 2
    assert p[down, down] == pytest.approx(share**2 + (1.0 - share**2) * 15.0**2)
    assert p[state.POS + 2, down] == -p[down, down]
    assert np.linalg.eigvalsh(p).min() > 0.0


def test_how_much_of_a_fix_is_white_and_how_fast_the_rest_drifts_stays_learnt_over_a_gap():
    x, ti = np.zeros(state.NX), np.zeros(state.NT, np.int64)
    x[state.X_WHITE_SHARE], x[state.X_WHITE_FIXES] = 0.1, 60.0
    x[state.X_DRIFT], x[state.X_DRIFTS] = 1e-3, 30.0
    for kept, share, drift in ((np.eye(state.N_STATES), 0.1, 1e-3), (None, Tuning().gnss_white_share, 0.0)):
        y = x.copy()
        begin(y, ti.copy(), FOUND, kept, Tuning(), 0.09, given_offset=False)
        assert y[state.X_WHITE_SHARE] == share
        assert y[state.X_DRIFT] == drift
