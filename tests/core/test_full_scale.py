"""An accelerometer's end is found where nothing is stated, and a statement that is exceeded is not believed."""

from __future__ import annotations

import math

import numpy as np
import pytest

from core.earth import STANDARD_GRAVITY_MPS2 as G
from core.full_scale import FullScale

RATE_HZ = 100


def shaken(duration_s=20.0, sd_mps2=2.0, seed=1):
    """A box on a rough road, gravity along its third axis."""
    rng = np.random.default_rng(seed)
    return rng.normal(0.0, sd_mps2, (round(duration_s * RATE_HZ), 3)) - [0.0, 0.0, G]


def blow(forces, row, peak_mps2, axis=0, rows=12):
    forces = forces.copy()
    forces[row : row + rows, axis] += peak_mps2 * np.sin(np.pi * (np.arange(rows) + 0.5) / rows)
    return forces


@pytest.mark.parametrize("end_mps2", [2 * G, 16 * G, 2 * 9.8, 2 * G * 32767 / 32768, 27.0, 41.3])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_flat_top_is_an_end_though_none_is_stated(end_mps2, sign):
    forces = np.clip(blow(shaken(), 1000, sign * 4.0 * end_mps2), -end_mps2, end_mps2)
    truth = np.flatnonzero(np.abs(forces[:, 0]) >= end_mps2)
    found = np.flatnonzero(FullScale().step(forces, math.nan))
    # The first two of the first blow may be behind, until the end is known; nothing else is taken for one.
    assert set(found) <= set(truth)
    assert set(truth[2:]) <= set(found)


def test_an_end_once_found_is_known_from_the_next_blow_s_first_sample_on():
    forces = np.clip(blow(blow(shaken(), 500, 200.0), 1500, 200.0), -27.0, 27.0)
    found = FullScale().step(forces, math.nan) > 0.0
    assert np.array_equal(found[1400:], np.abs(forces[1400:, 0]) >= 27.0)


def test_what_does_not_clip_is_not_taken_for_it():
    assert not FullScale().step(shaken(600.0), math.nan).any()
    assert not FullScale().step(blow(shaken(), 1000, 90.0), math.nan).any()
    parked = np.tile([0.0, 0.0, -G], (1000, 1))  # no noise at all
    assert not FullScale().step(parked, math.nan).any()


def test_a_reading_beyond_a_peak_that_repeated_itself_shows_that_it_was_none():
    forces = shaken()
    forces[500:503, 0] = 24.0
    forces[900, 0], forces[1200, 0] = 60.0, 25.0
    found = FullScale().step(forces, math.nan)
    assert found[502] == 1.0
    assert not found[900:].any()


def test_what_is_stated_counts_until_it_is_exceeded():
    forces = blow(shaken(), 1000, 2 * G)
    clipped = np.clip(forces, -1.7 * G, 1.7 * G)
    assert np.array_equal(FullScale().step(clipped, 1.7 * G) > 0.0, (np.abs(clipped) >= 0.995 * 1.7 * G).any(axis=1))
    wide = blow(shaken(), 1000, 90.0)
    found = FullScale().step(wide, 2 * G)
    beyond = int(np.flatnonzero(np.abs(wide).max(axis=1) > 1.02 * 2 * G)[0])
    assert not found[beyond:].any()
    assert found[:beyond].sum() <= 1


@pytest.mark.parametrize("stated", [math.nan, 2 * G])
def test_cuts_and_snapshots_change_nothing(stated):
    forces = np.clip(blow(blow(shaken(), 500, 300.0), 1500, 300.0), -16 * G, 16 * G)
    whole = FullScale().step(forces, stated)
    parts, one = [], FullScale()
    for begin in range(0, len(forces), 7):
        parts.append(one.step(forces[begin : begin + 7], stated))
        kept, one = one.arrays(), FullScale()
        one.load(kept)
    assert np.array_equal(np.concatenate(parts), whole)
