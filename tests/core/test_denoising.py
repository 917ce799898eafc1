"""Wavelet denoising: noise goes, drift and crash pulses stay, and the noise is followed as it should be."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.signal import welch

from core.denoising import AXES, Denoiser, DenoisingTuning, denoise_batch
from core.errors import InvalidInputError
from core.simulation.sensors import gauss_markov
from core.simulation.shapes import Shape, step
from core.snapshot import pack, unpack

START_NS = 1_714_984_200_000_000_000
NOISE_SD = np.array([0.05, 0.2, 1.0, 0.001, 0.01, 0.1])


def times_ns(n, rate_hz):
    return START_NS + np.round(np.arange(n) * 1e9 / rate_hz).astype(np.int64)


def whole(rows, rate_hz, tuning=None):
    """All of a series, denoised."""
    denoiser = Denoiser(rate_hz, tuning)
    t_ns = times_ns(len(rows), rate_hz)
    parts = [denoiser.step(t_ns, rows), denoiser.flush()]
    assert np.concatenate([t for t, _ in parts]).tolist() == t_ns.tolist()
    return np.concatenate([r for _, r in parts])


def white(seed, n):
    return NOISE_SD * np.random.default_rng(seed).standard_normal((n, AXES))


def haversine(t_s, start_s, duration_s, delta_v_mps):
    share = (t_s - start_s) / duration_s
    rate = step(Shape.HAVERSINE, np.clip(share, 0.0, 1.0))[1]
    return np.where((share > 0.0) & (share < 1.0), rate * delta_v_mps / duration_s, 0.0)


def shaken(seed, n, rate_hz, road_sd, engine_hz=27.0):
    """Broadband road noise and an engine's tone on six axes."""
    rng = np.random.default_rng(seed)
    t_s = np.arange(n) / rate_hz
    tone = np.sin(2.0 * np.pi * engine_hz * t_s[:, None] + rng.uniform(0.0, 6.28, AXES))
    return road_sd * rng.standard_normal((n, AXES)) + road_sd * tone


@pytest.mark.parametrize(("rate_hz", "levels"), [(20.0, 1), (40.0, 2), (100.0, 3), (104.0, 3), (200.0, 4), (1000.0, 6)])
def test_levels_reach_down_to_what_is_kept(rate_hz, levels):
    denoiser = Denoiser(rate_hz)
    assert denoiser.levels == levels
    assert 5.0 <= denoiser.lowest_detail_hz < 10.0


@pytest.mark.parametrize("rate_hz", [40.0, 100.0, 200.0])
def test_white_noise_falls_to_what_the_approximation_holds(rate_hz):
    rows = white(1, int(120 * rate_hz))
    left = whole(rows, rate_hz)
    # The approximation keeps 1 / 2**levels of the variance; at 3 sd 0.3 % of the details stay, shrunk: 3 dB is room.
    kept_db = 10.0 * math.log10(0.5 ** Denoiser(rate_hz).levels)
    reduction_db = 20.0 * np.log10(left.std(axis=0) / NOISE_SD)
    assert reduction_db == pytest.approx(np.full(AXES, kept_db), abs=3.0)
    assert (reduction_db < -3.0).all()


def test_the_noise_of_each_level_is_known_by_its_sd():
    denoiser = Denoiser(200.0)
    denoiser.step(times_ns(60_000, 200.0), white(2, 60_000))
    # An orthonormal transform leaves white noise its sd on each level. The coarsest level's estimate is off by 25 % a
    # window of 21 details and averaged over some 36 windows; a few per cent of the sd's bias on top.
    for level_sd in denoiser.noise_sd:
        assert level_sd == pytest.approx(NOISE_SD, rel=0.2)


def test_a_tone_of_the_engine_is_removed():
    t_s = np.arange(20_000) / 200.0
    left = whole(np.outer(np.sin(2 * np.pi * 27.0 * t_s), np.ones(AXES)), 200.0)
    assert left[2000:-2000].std() < 0.05 / math.sqrt(2.0)  # 26 dB: the windows before and after end the tone


def test_drift_is_kept():
    rate_hz, n = 200.0, 40_000
    rng = np.random.default_rng(3)
    drift = np.column_stack([gauss_markov(n, 1.0, 20.0, 1.0 / rate_hz, rng) for _ in range(AXES)])
    left = whole(drift + 0.5 * rng.standard_normal((n, AXES)), rate_hz)
    hz, density = welch(drift, rate_hz, nperseg=8192, axis=0)
    _, of_error = welch(left - drift, rate_hz, nperseg=8192, axis=0)
    _, of_noise = welch(0.5 * rng.standard_normal((n, AXES)), rate_hz, nperseg=8192, axis=0)
    slow = (hz > 0.0) & (hz < 2.0)
    # Up to 2 Hz what is wrong is the noise that was there, no more: the drift passes as it is.
    assert of_error[slow].mean() == pytest.approx(of_noise[slow].mean(), rel=0.25)
    assert of_error[slow].mean() < 0.05 * density[slow].mean()


@pytest.mark.parametrize("rate_hz", [100.0, 200.0, 400.0])
@pytest.mark.parametrize("duration_s", [0.06, 0.1, 0.15])
@pytest.mark.parametrize(("peak_mps2", "lost"), [(30.0, 0.05), (80.0, 0.02), (200.0, 0.01)])
def test_a_crash_pulse_keeps_its_peak_and_its_change_of_velocity(rate_hz, duration_s, peak_mps2, lost):
    n = int(60 * rate_hz)
    t_s = np.arange(n) / rate_hz
    delta_v_mps = 0.5 * peak_mps2 * duration_s
    start_s = 40.0 + 0.37 / rate_hz
    pulse = haversine(t_s, start_s, duration_s, delta_v_mps)
    rows = shaken(4, n, rate_hz, 0.3)
    clean = whole(rows + pulse[:, None], rate_hz)
    near = (t_s > start_s - 0.5) & (t_s < start_s + duration_s + 0.5)
    raw_peak = (rows + pulse[:, None])[near].max(axis=0)
    assert (clean[near].max(axis=0) > (1.0 - lost) * raw_peak).all()
    # What is taken from it has no mean: 0.05 m/s is a twentieth of the slowest pulse's change.
    change = (clean - rows)[near].sum(axis=0) / rate_hz
    assert change == pytest.approx(np.full(AXES, delta_v_mps), abs=0.05)


def test_a_crash_and_a_pothole_do_not_raise_the_noise():
    rate_hz, n = 200.0, 12_000
    t_s = np.arange(n) / rate_hz
    rows = shaken(5, n, rate_hz, 0.3)
    blows = haversine(t_s, 50.0, 0.12, 9.0) + haversine(t_s, 52.0, 0.03, 1.0) - haversine(t_s, 52.03, 0.03, 1.0)
    usual, hit = Denoiser(rate_hz), Denoiser(rate_hz)
    usual.step(times_ns(n, rate_hz), rows)
    hit.step(times_ns(n, rate_hz), rows + blows[:, None])
    # Ten windows ago at the most: a few details of 21 in two windows each, of which each one weighs 3 %.
    assert hit.noise_sd == pytest.approx(usual.noise_sd, rel=0.05)


def test_a_crash_that_fills_a_window_raises_it_by_no_more_than_a_bounded_step():
    rate_hz = 200.0
    denoiser = Denoiser(rate_hz)
    t_ns = times_ns(12_000, rate_hz)
    rows = white(6, 12_000)
    denoiser.step(t_ns[:11_200], rows[:11_200])
    before = denoiser.noise_sd
    rows[11_200:11_760] *= 100.0  # 2.8 s of rolling over
    denoiser.step(t_ns[11_200:11_760], rows[11_200:11_760])
    tuning = denoiser.tuning
    windows = 5
    most = (1.0 + tuning.most_rise * denoiser.hop / rate_hz / tuning.memory_s) ** windows
    assert (denoiser.noise_sd <= before * most * (1.0 + 1e-12)).all()
    assert most < 1.35


def test_a_stop_of_a_minute_does_not_lose_the_noise_and_zeros_never_do():
    rate_hz = 200.0
    denoiser = Denoiser(rate_hz)
    t_ns = times_ns(36_000, rate_hz)
    rows = white(7, 36_000)
    denoiser.step(t_ns[:12_000], rows[:12_000])
    moving = denoiser.noise_sd
    denoiser.step(t_ns[12_000:24_000], np.zeros((12_000, AXES)))
    stopped = denoiser.noise_sd
    assert (stopped > 0.2 * moving).all()  # an e-fold in 40 s
    denoiser.step(t_ns[24_000:], rows[24_000:])
    assert denoiser.noise_sd == pytest.approx(moving, rel=0.35)  # a minute later it is back, to a window's own spread


@pytest.mark.parametrize("held", [0.0, 9.80665])
def test_a_series_that_begins_with_a_frozen_reading_learns_its_noise_when_that_moves(held):
    denoiser = Denoiser(200.0)
    t_ns = times_ns(4000, 200.0)
    denoiser.step(t_ns[:2000], np.full((2000, AXES), held))
    assert (denoiser.noise_sd < 1e-10).all()  # rounding
    denoiser.step(t_ns[2000:], white(8, 2000))
    # From the first windows that move: its first holds some frozen samples, the others follow in 20 s.
    assert denoiser.noise_sd[0] == pytest.approx(NOISE_SD, rel=0.6)


def test_no_sample_waits_longer_than_the_stated_latency_and_some_as_long():
    for rate_hz, hop_margins in ((40.0, 1), (100.0, 1), (200.0, 1), (200.0, 3)):
        denoiser = Denoiser(rate_hz, DenoisingTuning(hop_margins=hop_margins))
        t_ns = times_ns(3000, rate_hz)
        rows = white(9, 3000)
        waited = []
        for k in range(3000):
            out, _ = denoiser.step(t_ns[k : k + 1], rows[k : k + 1])
            waited += ((t_ns[k] - out) * 1e-9).tolist()
        assert max(waited) == pytest.approx(denoiser.latency_s, abs=1e-6)
        assert denoiser.latency_s < 1.4 * (1 + hop_margins) / 2


def test_a_silence_lets_out_what_waits_and_begins_anew():
    rate_hz = 100.0
    t_ns = times_ns(2000, rate_hz)
    t_ns[1000:] += 10**9
    rows = white(10, 2000)
    denoiser = Denoiser(rate_hz)
    before, _ = denoiser.step(t_ns[:1000], rows[:1000])
    assert len(before) < 1000
    after, _ = denoiser.step(t_ns[1000:1001], rows[1000:1001])
    assert np.concatenate([before, after]).tolist() == t_ns[:1000].tolist()
    first, second = Denoiser(rate_hz), Denoiser(rate_hz)
    apart = [first.step(t_ns[:1000], rows[:1000]), first.flush()]
    second.load(first.arrays())  # the noise goes on, the series does not
    apart += [second.step(t_ns[1000:], rows[1000:]), second.flush()]
    joined = Denoiser(rate_hz)
    together = [joined.step(t_ns, rows), joined.flush()]
    assert (np.concatenate([r for _, r in together]) == np.concatenate([r for _, r in apart])).all()


@pytest.mark.parametrize("n", [0, 1, 5, 55, 56, 57, 111, 112, 113, 170])
def test_short_series_lose_nothing(n, recwarn):
    rows = white(11, n)
    left = whole(rows, 100.0)
    assert left.shape == (n, AXES)
    assert np.isfinite(left).all()
    if n < Denoiser(100.0).margin:
        assert (left == rows).all()
    assert not recwarn.list  # not even PyWavelets' about too many levels


def test_a_threshold_of_zero_gives_back_what_went_in():
    rows = white(12, 5000) + 9.8
    rows[100:200] = 0.0
    left = whole(rows, 200.0, DenoisingTuning(threshold_sds=0.0))
    # PyWavelets tabulates the taps to 1e-12: of readings of 10 and over four levels there and back.
    assert np.abs(left - rows).max() < 1e-10


def test_many_vehicles_at_once_are_the_same_bits_as_singly():
    rng = np.random.default_rng(13)
    rates = [200.0, 100.0, 200.0, 199.9, 100.0, 40.0]
    tunings = [None, None, DenoisingTuning(threshold_sds=2.0), None, None, None]
    batch = [Denoiser(rate, tuning) for rate, tuning in zip(rates, tunings, strict=True)]
    single = [Denoiser(rate, tuning) for rate, tuning in zip(rates, tunings, strict=True)]
    begun = [0] * len(rates)
    for _ in range(12):
        packets = []
        for vehicle, rate in enumerate(rates):
            n = int(rng.integers(0, 3 * rate))
            t_ns = times_ns(begun[vehicle] + n, rate)[begun[vehicle] :]
            if rng.random() < 0.3:
                t_ns = t_ns + np.where(np.arange(n) > n // 2, 10**9, 0)  # a silence within
            begun[vehicle] += n + int(3 * rate)
            packets.append((t_ns, NOISE_SD * rng.standard_normal((n, AXES))))
        together = denoise_batch(batch, packets)
        for denoiser, packet, (t_ns, rows) in zip(single, packets, together, strict=True):
            alone = denoiser.step(*packet)
            assert alone[0].tolist() == t_ns.tolist()
            assert (alone[1] == rows).all()
    for one, other in zip(batch, single, strict=True):
        assert pack(one.arrays(), 1) == pack(other.arrays(), 1)


def test_a_snapshot_goes_on_to_the_bit():
    t_ns, rows = times_ns(3000, 200.0), white(14, 3000)
    usual, restored = Denoiser(200.0), Denoiser(200.0)
    usual.step(t_ns[:1234], rows[:1234])
    restored.load(unpack(pack(usual.arrays(), 1), 1))
    assert (usual.step(t_ns[1234:], rows[1234:])[1] == restored.step(t_ns[1234:], rows[1234:])[1]).all()
    assert pack(usual.arrays(), 1) == pack(restored.arrays(), 1)


def test_nothing_of_the_callers_arrays_is_kept_or_changed():
    t_ns, rows = times_ns(700, 200.0), white(15, 700)
    denoiser, usual = Denoiser(200.0), Denoiser(200.0)
    mine = rows.copy()
    usual.step(t_ns, rows)
    denoiser.step(t_ns, mine)
    assert (mine == rows).all()
    mine[:] = np.nan
    assert (denoiser.flush()[1] == usual.flush()[1]).all()


@pytest.mark.parametrize("rate_hz", [0.0, 19.9, -100.0, math.nan, math.inf, 1e9])
def test_a_rate_that_cannot_be_denoised_is_refused(rate_hz):
    with pytest.raises(InvalidInputError, match="expected 20 Hz"):
        Denoiser(rate_hz)


def test_rows_of_another_shape_and_states_of_another_rate_are_refused():
    with pytest.raises(InvalidInputError, match=r"expected \(5, 6\)"):
        Denoiser(200.0).step(times_ns(5, 200.0), np.zeros((5, 3)))
    with pytest.raises(InvalidInputError, match="expected 4"):
        Denoiser(200.0).load(Denoiser(100.0).arrays())
