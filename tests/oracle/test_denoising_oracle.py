"""Denoising by windows against PyWavelets over the whole series: inside a window there is no difference."""

from __future__ import annotations

import numpy as np
import pytest
import pywt

from core.denoising import AXES, WAVELET, Denoiser, DenoisingTuning


def whole_series(rows, levels, thresholds):
    """Decomposed, shrunk and composed at once by PyWavelets alone; thresholds (levels, 6), finest first."""
    left = np.empty_like(rows)
    for axis in range(AXES):
        approximation, *details = pywt.wavedec(rows[:, axis], WAVELET, mode="symmetric", level=levels)
        shrunk = [pywt.threshold(d, thresholds[levels - 1 - k, axis], mode="garrote") for k, d in enumerate(details)]
        left[:, axis] = pywt.waverec([approximation, *shrunk], WAVELET, mode="symmetric")[: len(rows)]
    return left


@pytest.mark.parametrize(("rate_hz", "hop_margins"), [(40.0, 1), (100.0, 1), (200.0, 1), (200.0, 4), (400.0, 2)])
def test_each_window_is_the_whole_series_with_its_thresholds(rate_hz, hop_margins):
    rng = np.random.default_rng(1)
    tuning = DenoisingTuning(hop_margins=hop_margins)
    denoiser = Denoiser(rate_hz, tuning)
    n = 8 * denoiser.hop + denoiser.margin + 17
    t_ns = np.round(np.arange(n) * 1e9 / rate_hz).astype(np.int64)
    rows = np.cumsum(0.05 * rng.standard_normal((n, AXES)), axis=0) + 0.3 * rng.standard_normal((n, AXES))
    rows[n // 2 : n // 2 + 10] += 20.0
    windows = 0
    for begin in range(0, n, denoiser.hop):
        out_t, out = denoiser.step(t_ns[begin : begin + denoiser.hop], rows[begin : begin + denoiser.hop])
        if len(out_t):
            assert len(out_t) == denoiser.hop
            first = int(np.searchsorted(t_ns, out_t[0]))
            expected = whole_series(rows, denoiser.levels, tuning.threshold_sds * denoiser.noise_sd)
            # Rounding: the transforms are the same sums in the same order, but for PyWavelets' 1 - t^2/d^2.
            np.testing.assert_allclose(out, expected[first : first + len(out)], rtol=0.0, atol=1e-11)
            windows += 1
    assert windows >= 7
    out_t, out = denoiser.flush()
    expected = whole_series(rows, denoiser.levels, tuning.threshold_sds * denoiser.noise_sd)
    assert out_t[-1] == t_ns[-1]
    np.testing.assert_allclose(out, expected[n - len(out) :], rtol=0.0, atol=1e-11)


def test_the_noise_of_a_window_is_pywavelets_details_median():
    denoiser = Denoiser(100.0)
    n = denoiser.hop + denoiser.margin
    rows = np.random.default_rng(2).standard_normal((n, AXES))
    denoiser.step(np.arange(n) * 10_000_000, rows)
    _, *details = pywt.wavedec(rows, WAVELET, mode="symmetric", level=denoiser.levels, axis=0)
    for level_sd, d in zip(denoiser.noise_sd, reversed(details), strict=True):
        # np.median takes the mean of the middle two of an even number.
        ordered = np.sort(np.abs(d), axis=0)
        assert level_sd == pytest.approx(ordered[len(d) // 2] / 0.6745, rel=1e-4)
