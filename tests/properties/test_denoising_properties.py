"""However samples come in packets, and whenever a snapshot is taken, the denoised ones are the same bits."""

from __future__ import annotations

import functools
from itertools import pairwise

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from core.denoising import AXES, Denoiser, DenoisingTuning
from core.snapshot import pack, unpack

N = 1500
RATE_HZ = 100.0
GAPS = (0, 1, 40, 400, 423, 900, N - 1)
"""Samples after which a silence comes: some series are shorter than a window, or than one sample's reach."""


@functools.cache
def stream(silent):
    rng = np.random.default_rng(1)
    spacing_ns = rng.integers(4_000_000, 16_000_000, N)  # jitter as of a host that is busy
    if silent:
        spacing_ns[list(GAPS)] += 10**9
    rows = np.cumsum(0.01 * rng.standard_normal((N, AXES)), axis=0) + rng.standard_normal((N, AXES))
    rows[700:710] += 100.0
    return 1_700_000_000_000_000_000 + np.cumsum(spacing_ns), rows


def fold(silent, hop_margins, bounds, restored_at=()):
    tuning = DenoisingTuning(hop_margins=hop_margins)
    denoiser = Denoiser(RATE_HZ, tuning)
    t_ns, rows = stream(silent)
    out = []
    for index, (low, high) in enumerate(pairwise(bounds)):
        out.append(denoiser.step(t_ns[low:high], rows[low:high]))
        if index in restored_at:
            state = unpack(pack(denoiser.arrays(), 1), 1)
            denoiser = Denoiser(RATE_HZ, tuning)
            denoiser.load(state)
    state = pack(denoiser.arrays(), 1)
    out.append(denoiser.flush())
    return np.concatenate([t for t, _ in out]), np.concatenate([r for _, r in out]).tobytes(), state


@functools.cache
def at_once(silent, hop_margins):
    return fold(silent, hop_margins, [0, N])


@settings(deadline=None, max_examples=60)
@given(
    silent=st.booleans(),
    hop_margins=st.sampled_from([1, 2, 5]),
    cuts=st.lists(st.integers(0, N), max_size=60),
    restored_at=st.sets(st.integers(0, 60), max_size=5),
)
def test_any_cutting_and_any_restart_give_the_same_bits_and_each_sample_once(silent, hop_margins, cuts, restored_at):
    told = fold(silent, hop_margins, [0, *sorted(cuts), N], restored_at)
    expected = at_once(silent, hop_margins)
    assert told[0].tolist() == stream(silent)[0].tolist()
    assert told[1:] == expected[1:]


def test_one_sample_at_a_time_gives_the_same_bits():
    told = fold(True, 1, range(N + 1))
    assert told[1:] == at_once(True, 1)[1:]


@settings(deadline=None, max_examples=60)
@given(
    scale=st.sampled_from([0.0, 1e-300, 1e-12, 1.0, 1e4]),
    held=st.integers(1, 400),
    seed=st.integers(0, 2**32 - 1),
)
def test_whatever_is_finite_stays_finite(scale, held, seed):
    rng = np.random.default_rng(seed)
    values = scale * rng.standard_cauchy((N // held + 1, AXES)).clip(-1e3, 1e3)
    rows = np.repeat(values, held, axis=0)[:N]  # held values: what a frozen sensor or a coarse converter shows
    denoiser = Denoiser(RATE_HZ)
    t_ns = np.arange(N, dtype=np.int64) * 10_000_000
    left = np.concatenate([denoiser.step(t_ns, rows)[1], denoiser.flush()[1]])
    assert np.isfinite(left).all()
    assert np.abs(left).max() <= 3.0 * np.abs(rows).max()  # a filter bank of eight taps may overshoot a step
    assert np.isfinite(denoiser.noise_sd).all()
