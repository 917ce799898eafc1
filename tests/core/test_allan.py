"""Allan deviation against allantools and closed forms, and the fits against noises of known strength."""

from __future__ import annotations

import math
from dataclasses import replace

import allantools
import numpy as np
import pytest
from allantools.ci import edf_greenhall, edf_simple

from core.calibration.allan import (
    TERMS,
    AllanMoments,
    allan_variance,
    averaging_counts,
    in_seconds,
    term_variances,
)
from core.calibration.allan_fit import AllanAnalysis, AllanSettings
from core.calibration.longest_rest import longest_rest
from core.calibration.recording import CalibrationRecording
from core.errors import InvalidInputError
from tests.recordings import recording


def noises(rng, samples, interval_s, random_walk=0.0, instability=0.0, walk=0.0, quantisation=0.0):
    """A signal of known noises: white, flicker by its spectrum, a walk of the bias, and a rounded integral."""
    signal = random_walk / math.sqrt(interval_s) * rng.standard_normal(samples)
    steps = walk * math.sqrt(interval_s / 8.0) * rng.standard_normal(8 * samples)
    signal += np.cumsum(steps).reshape(samples, 8).mean(axis=1)
    signal += quantisation / interval_s * np.diff(rng.standard_normal(samples + 1))
    if instability:
        # Eight times as long and four times as fine, so that flicker goes on beyond what the recording can see.
        length = 32 * samples
        f = np.fft.rfftfreq(length)[1:]
        drawn = rng.standard_normal(f.size) + 1j * rng.standard_normal(f.size)
        fine = np.fft.irfft(np.concatenate([[0.0], instability * np.sqrt(length / (4.0 * np.pi * f)) * drawn]), length)
        signal += fine[: 4 * samples].reshape(samples, 4).mean(axis=1)
    return signal


def test_the_deviation_is_that_of_allantools():
    signal = noises(np.random.default_rng(1), 3000, 0.01, 1.0, 0.1, 0.02)
    counts = averaging_counts(signal.size)
    _, theirs, _, _ = allantools.oadev(signal, rate=100.0, data_type="freq", taus=counts / 100.0)
    # They sum in another order: rounding.
    np.testing.assert_allclose(np.sqrt(allan_variance(signal, counts)), theirs, rtol=1e-9)


def test_averaging_times_are_octaves_up_to_a_fifth_of_the_recording():
    assert averaging_counts(1000).tolist() == [1, 2, 4, 8, 16, 32, 64, 128]
    assert averaging_counts(1000, per_octave=2).tolist() == [1, 2, 3, 4, 6, 8, 11, 16, 23, 32, 45, 64, 91, 128, 181]


@pytest.mark.parametrize(("term", "alpha"), [("random_walk", 0), ("bias_instability", -1), ("rate_random_walk", -2)])
def test_degrees_of_freedom_are_those_of_greenhall_and_riley(term, alpha):
    counts = averaging_counts(4096)
    strengths = np.array([float(name == term) for name in TERMS])
    ours = AllanMoments(4096, counts, pairs=False).freedom(strengths)
    # Theirs take the limit of long averaging times, from some 32 samples on to 3 %.
    theirs = [edf_greenhall(alpha=alpha, d=2, m=int(m), N=4097, overlapping=True) for m in counts]
    np.testing.assert_allclose(ours[counts >= 32], np.array(theirs)[counts >= 32], rtol=0.03)
    if term == "random_walk":
        # NIST SP 1065, table 5, which is close for white noise at all averaging times.
        np.testing.assert_allclose(ours, [edf_simple(4097, int(m), alpha) for m in counts], rtol=0.04)


@pytest.mark.parametrize("term", range(4), ids=TERMS)
def test_each_noise_has_the_variance_and_the_covariance_that_is_said_of_it(term):
    rng, strength = np.random.default_rng(2), np.eye(4)[term]
    samples, interval_s, runs = 400, 0.5, 800
    counts = averaging_counts(samples)
    values = strength * np.sqrt(1.0 / in_seconds(1.0)) * np.sqrt(in_seconds(interval_s))
    drawn = np.array(
        [allan_variance(noises(rng, samples, interval_s, *values[1:], values[0]), counts) for _ in range(runs)]
    )
    expected = term_variances(counts) @ strength
    covariance = AllanMoments(samples, counts).covariance(strength)
    spread = np.sqrt(np.diag(covariance))
    # Four standard errors of the mean; 2 % for the flicker drawn, which has a lowest and a highest frequency.
    off = np.abs(drawn.mean(axis=0) / expected - 1.0)
    assert (off < 4.0 * spread / expected / math.sqrt(runs) + 0.02).all()
    ratio = drawn.std(axis=0) / spread
    # The standard error of an sd is 1/sqrt(2 runs) = 2.5 %, more where few degrees of freedom make it skewed.
    np.testing.assert_allclose(ratio, 1.0, atol=0.15)
    correlation = covariance / np.outer(spread, spread)
    np.testing.assert_allclose(np.corrcoef(drawn.T), correlation, atol=0.15)
    assert np.linalg.eigvalsh(correlation).min() > 0.0


# Noises as (N, B, K): white alone, a floor, both walks, all three, and little white.
MIXTURES = [(1.0, 0.0, 0.0), (1.0, 0.1, 0.0), (1.0, 0.0, 0.002), (1.0, 0.05, 0.001), (1.0, 0.3, 0.01)]


@pytest.mark.parametrize("mixture", MIXTURES, ids=str)
def test_the_intervals_hold_the_truth_in_95_percent(mixture):
    rng, analysis, runs = np.random.default_rng(3), AllanAnalysis(8000, 1.0), 100
    held, invented = np.zeros(3), np.zeros(3)
    for _ in range(runs):
        fit = analysis.fit(noises(rng, 8000, 1.0, *mixture))
        terms = (fit.random_walk, fit.bias_instability, fit.rate_random_walk)
        held += [term.low <= true <= term.high for term, true in zip(terms, mixture, strict=True)]
        invented += [term.resolved and true == 0.0 for term, true in zip(terms, mixture, strict=True)]
        assert all(term.low <= term.value <= term.high or not term.resolved for term in terms)
    # Of 100 intervals of 95 %, 88 or fewer hold with a probability of 0.4 %. Where the truth is 0, all may.
    assert (held / runs >= 0.89).all(), held
    assert (invented / runs <= 0.15).all(), invented


def test_a_quantised_integral_is_told_from_white_noise():
    signal = noises(np.random.default_rng(4), 20000, 0.01, 1e-3, 0.0, 0.0, quantisation=1e-4)
    fit = AllanAnalysis(20000, 0.01).fit(signal)
    assert fit.quantisation.low <= 1e-4 <= fit.quantisation.high
    assert fit.quantisation.resolved
    assert fit.random_walk.low <= 1e-3 <= fit.random_walk.high


def test_a_rounded_rate_is_white_noise_of_its_step():
    step, interval_s = 1.0, 0.01
    signal = np.rint(np.random.default_rng(5).normal(0.3, 0.5, 50_000) / step) * step
    fit = AllanAnalysis(50_000, interval_s).fit(signal)
    # Sheppard: the step's variance/12 is added; with a sd of half a step that holds to 1 %.
    assert fit.random_walk.value == pytest.approx(math.sqrt((0.25 + 1.0 / 12.0) * interval_s), rel=0.02)
    assert not fit.quantisation.resolved


def test_a_short_recording_tells_bounds_instead_of_inventing():
    fit = AllanAnalysis(2000, 0.01).fit(noises(np.random.default_rng(6), 2000, 0.01, 1e-3))
    assert fit.random_walk.resolved
    assert not fit.bias_instability.resolved
    assert fit.bias_instability.value == fit.bias_instability.low == 0.0 < fit.bias_instability.high
    assert fit.floor is None


def test_the_sensors_own_filter_at_short_times_does_not_bend_the_fit():
    rng = np.random.default_rng(7)
    white = rng.standard_normal(100_003)
    signal = np.convolve(white, np.ones(4) / 4.0, mode="valid")
    fit = AllanAnalysis(100_000, 0.01).fit(signal)
    assert fit.fitted_tau_s[0] > 0.02
    assert fit.random_walk.value == pytest.approx(0.1, rel=0.03)
    assert not fit.bias_instability.resolved


def test_what_is_no_noise_widens_the_intervals():
    rng = np.random.default_rng(8)
    plain = noises(rng, 50_000, 0.01, 1e-3)
    shaken = plain + 2e-3 * np.sin(2 * np.pi * 0.8 * np.arange(50_000) * 0.01)
    analysis = AllanAnalysis(50_000, 0.01)
    one, other = analysis.fit(plain), analysis.fit(shaken)
    assert one.excess_sd == 0.0
    assert other.excess_sd > 0.1
    assert other.random_walk.high - other.random_walk.low > 3.0 * (one.random_walk.high - one.random_walk.low)


def test_bad_signals_are_refused_by_name():
    with pytest.raises(InvalidInputError, match="99 samples at rest; expected at least 100"):
        AllanAnalysis(99, 0.01)
    with pytest.raises(InvalidInputError, match="never changes"):
        AllanAnalysis(200, 0.01).fit(np.ones(200))
    with pytest.raises(InvalidInputError, match=r"shape \(100,\); expected \(200,\)"):
        AllanAnalysis(200, 0.01).fit(np.ones(100))
    with pytest.raises(InvalidInputError, match="excess_sd"):
        replace(AllanSettings(), excess_sd=2.0)


def at_rest(rng, seconds, rate_hz=50.0):
    rows = int(seconds * rate_hz)
    force = rng.normal([0.0, 0.0, -9.81], 0.02, (rows, 3))
    return np.arange(rows) / rate_hz, force, rng.normal(0.0, 1e-3, (rows, 3))


def test_the_longest_rest_leaves_out_knocks_turns_and_gaps():
    t_s, force, rate = at_rest(np.random.default_rng(9), 300.0)
    whole = longest_rest(CalibrationRecording(t_s, force, rate))
    assert (whole.first, whole.end, whole.moving_s, whole.gaps) == (0, t_s.size, 0.0, 0)
    force[2000:2010, 1] += 3.0  # a knock at 40 s
    rate[5000:5100, 2] += 0.5  # a turn about the vertical at 100 s, which gravity does not show
    force[11000:] += [0.5, 0.0, 0.0]  # laid down otherwise from 220 s
    found = longest_rest(CalibrationRecording(t_s, force, rate))
    assert 102.0 <= t_s[found.first] <= 104.0
    assert 218.0 <= t_s[found.end] <= 221.0
    kept = np.r_[0:8000, 8100:15000]  # two seconds lack from 160 s
    broken = longest_rest(CalibrationRecording(t_s[kept], force[kept], rate[kept]))
    assert broken.gaps == 1
    assert np.diff(t_s[kept][broken.first : broken.end]).max() < 0.03


def test_a_box_that_moves_all_the_time_is_refused():
    rng = np.random.default_rng(10)
    t_s, force, rate = at_rest(rng, 120.0)
    rate += np.cumsum(rng.normal(0.0, 0.02, rate.shape), axis=0)
    with pytest.raises(InvalidInputError, match=r"was not at rest.*record at least 10 s with the box lying still"):
        longest_rest(CalibrationRecording(t_s, force, rate))
    short = slice(0, 300)
    with pytest.raises(InvalidInputError, match=r"lasts 6.0 s; expected at least 10 s"):
        longest_rest(CalibrationRecording(t_s[short], force[short], rate[short]))


@pytest.mark.parametrize(("axis", "floor_deg_h"), [(0, 25.3), (1, 30.2), (2, 29.1)])
def test_a_real_gyroscope_has_the_walk_and_the_floor_of_its_data_sheet(axis, floor_deg_h):
    """ADIS16405, 2.8 h: 2.0 deg/sqrt(h) and 25 deg/h by its data sheet, which are typical values."""
    with np.load(recording("data", "static_adis16405_2h8", "adis_16405_imu1.npz")) as data:
        signal = data["gyro_counts"][:, axis] * float(data["gyro_dps_per_count"])
    fit = AllanAnalysis(signal.size, 0.01).fit(signal)
    assert 2.3 <= 60.0 * fit.random_walk.value <= 2.6
    # Every tenth of the octaves: the smallest lies flat between 50 s and 400 s.
    assert 3600.0 * fit.floor.value == pytest.approx(floor_deg_h, abs=0.3)
    # Non-overlapping, as the recording's own page has them, the floors are 26 to 29: within the stated interval.
    assert 3600.0 * fit.floor.low < 29.0
    assert 3600.0 * fit.floor.high > 26.0
    assert 0.6 * fit.floor.value < 0.664 * fit.bias_instability.high < 1.1 * fit.floor.value
