"""Speeding as timelines: shares, excess, duration and the limits' certainty, with what is not known told apart."""

from __future__ import annotations

import math

import numpy as np
import pytest

from core.driving.speeding import Speeding, speeding
from core.errors import InvalidInputError

KMH = 1.0 / 3.6


def rows(*parts, step_s=0.5):
    """(seconds, km/h, limit in km/h or None[, certainty]) one after the other."""
    speed, limit, certainty = [], [], []
    for seconds, kmh, limit_kmh, *sure in parts:
        count = round(seconds / step_s)
        speed += [kmh * KMH] * count
        limit += [math.nan if limit_kmh is None else limit_kmh * KMH] * count
        certainty += [sure[0] if sure else 1.0] * count
    # The last row stands for nothing after it: one more ends the last part.
    speed, limit, certainty = ([*values, values[-1]] for values in (speed, limit, certainty))
    t_ns = 1_700_000_000_000_000_000 + np.arange(len(speed)) * round(1e9 * step_s)
    return t_ns, np.array(speed), np.array(limit), np.array(certainty)


def test_shares_excess_and_episodes():
    found = speeding(*rows((60, 50, 50), (30, 70, 50), (30, 45, 50), (20, 60, 50, 0.4), (60, 80, None), (40, 0, 50)))
    assert found.known_s == pytest.approx(140.0)
    assert found.unknown_s == pytest.approx(60.0)
    assert found.share == pytest.approx(50.0 / 140.0)
    assert found.unknown_share == pytest.approx(60.0 / 200.0)
    assert found.certain_share == pytest.approx((30.0 + 8.0) / (120.0 + 8.0))
    assert found.mean_excess_mps == pytest.approx((30 * 20 + 20 * 10) / 50 * KMH)
    assert found.max_excess_mps == pytest.approx(20 * KMH)
    first, second = found.episodes
    assert (first.duration_s, first.certainty) == (pytest.approx(30.0), pytest.approx(1.0))
    assert first.distance_m == pytest.approx(30 * 70 * KMH)
    assert first.limit_mps == pytest.approx(50 * KMH)
    assert second.certainty == pytest.approx(0.4)
    assert second.mean_excess_mps == pytest.approx(10 * KMH)


def test_a_little_above_is_no_speeding():
    assert speeding(*rows((60, 54, 50))).over_s == 0.0
    assert speeding(*rows((60, 56, 50))).share == pytest.approx(1.0)


@pytest.mark.parametrize("limit_kmh", [0.0, -50.0, 301.0, 999.0, math.inf])
def test_a_limit_that_cannot_be_is_unknown(limit_kmh):
    found = speeding(*rows((60, 130, limit_kmh)))
    assert (found.known_s, found.over_s, found.episodes) == (0.0, 0.0, ())
    assert found.unknown_share == 1.0
    assert math.isnan(found.share)


def test_short_dips_join_and_short_peaks_are_dropped():
    joined = speeding(*rows((10, 70, 50), (2, 52, 50), (10, 70, 50))).episodes
    assert [one.duration_s for one in joined] == [pytest.approx(22.0)]
    assert len(speeding(*rows((10, 70, 50), (5, 52, 50), (10, 70, 50))).episodes) == 2
    assert len(speeding(*rows((10, 70, 50), (2, 70, None), (10, 70, 50))).episodes) == 2  # unknown joins nothing
    assert speeding(*rows((30, 50, 50), (2, 70, 50), (30, 50, 50))).episodes == ()


def test_rows_far_apart_stand_for_no_time_between():
    t_ns, speed, limit, certainty = rows((20, 70, 50))
    apart = t_ns + (np.arange(t_ns.size) >= 20) * 60_000_000_000
    found = speeding(apart, speed, limit, certainty)
    assert found.over_s == pytest.approx(20.0 - 0.5)
    assert [one.duration_s for one in found.episodes] == [pytest.approx(9.5), pytest.approx(10.0)]


def test_drives_add_up():
    drives = [speeding(*rows((60, 50, 50), (k * 10 + 10, 70, 50), (20, 40, None))) for k in range(3)]
    whole = drives[0] + drives[1] + drives[2]
    assert whole.over_s == pytest.approx(10 + 20 + 30)
    assert whole.share == pytest.approx(60.0 / 240.0)
    assert len(whole.episodes) == 3
    assert Speeding() + drives[0] == drives[0]


def test_nothing_driven_is_nothing():
    empty = np.empty(0)
    found = speeding(np.empty(0, dtype=np.int64), empty, empty, empty)
    assert found == Speeding()
    assert math.isnan(found.unknown_share)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t, v, limit, sure: (t[:-1], v, limit, sure), "expected as many of each"),
        (lambda t, v, limit, sure: (t[::-1], v, limit, sure), "times do not increase"),
        (lambda t, v, limit, sure: (t, v, limit, sure + 1.0), "not from 0 to 1"),
    ],
)
def test_bad_rows_are_refused(change, message):
    with pytest.raises(InvalidInputError, match=message):
        speeding(*change(*rows((10, 50, 50))))
