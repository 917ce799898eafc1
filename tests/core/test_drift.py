"""Biases from trip to trip: weighed by their variances, forgotten with time, told where they have drifted."""

from __future__ import annotations

import numpy as np
import pytest

from core.calibration.drift import Biases, BiasFollower, Drift, DriftThresholds, folded_back

S = 1_000_000_000
HOUR = 3600 * S
T = DriftThresholds()
ZERO = np.zeros(6)
SURE = np.repeat([0.01, 1e-4], 3)


def test_both_are_weighed_by_their_variances():
    now = Biases(HOUR, np.full(6, 0.01) * [1, 1, 1, 0.1, 0.1, 0.1], SURE)
    found, drifts = folded_back(Biases(0, ZERO, SURE), now, T)
    prior = SURE**2 + T.of("turn_on") ** 2 + T.of("walk") ** 2 * 3600.0
    told = SURE**2 + T.of("model") ** 2
    expected_var = 1.0 / (1.0 / prior + 1.0 / told)
    np.testing.assert_allclose(found.bias, expected_var * now.bias / told, rtol=1e-12)
    np.testing.assert_allclose(found.sd, np.sqrt(expected_var), rtol=1e-12)
    assert drifts == ()
    assert found.t_ns == HOUR


def test_what_was_known_is_forgotten_with_time_but_never_beyond_what_a_box_is_at_first():
    now = Biases(0, np.repeat([0.05, 2e-3], 3), SURE)
    weights = []
    for days in (0, 1, 30, 10_000):
        seen = Biases(days * 24 * HOUR, now.bias, now.sd)
        found, _ = folded_back(Biases(0, ZERO, SURE), seen, T)
        weights.append(found.bias / seen.bias)
    assert (np.diff(weights, axis=0) > 0.0).all()
    told, unknown = SURE**2 + T.of("model") ** 2, T.of("unknown") ** 2
    np.testing.assert_allclose(weights[-1], unknown / (unknown + told), rtol=1e-9)


def test_an_axis_that_the_filter_is_not_sure_of_keeps_its_bias():
    sd = SURE.copy()
    sd[[0, 4]] = T.accel_observed_sd_mps2 * 1.01, T.gyro_observed_sd_radps * 1.01
    found, drifts = folded_back(Biases(0, ZERO, SURE), Biases(S, np.full(6, 1.0), sd), T)
    assert found.bias[0] == found.bias[4] == 0.0
    assert found.sd[0] > SURE[0]
    assert [(one.sensor, one.axis) for one in drifts] == [
        ("accelerometer", "y"),
        ("accelerometer", "z"),
        ("gyroscope", "x"),
        ("gyroscope", "z"),
    ]


@pytest.mark.parametrize(
    ("axis", "change", "told"),
    [(0, 0.09, False), (0, 0.2, True), (0, -0.2, True), (5, 4e-3, False), (5, 0.01, True)],
)
def test_a_drift_is_beyond_its_spread_and_above_what_matters(axis, change, told):
    bias = ZERO.copy()
    bias[axis] = change
    found, drifts = folded_back(Biases(0, ZERO, SURE), Biases(S, bias, SURE), T)
    spread = np.sqrt(SURE**2 + T.of("turn_on") ** 2 + T.of("walk") ** 2 + SURE**2 + T.of("model") ** 2)[axis]
    if not told:
        assert drifts == ()
        return
    (drift,) = drifts
    assert drift == Drift(("accelerometer", "gyroscope")[axis // 3], "xyz"[axis % 3], 0.0, change, drift.sd)
    assert drift.sd == pytest.approx(spread, rel=1e-12)
    assert found.bias[axis] == change, "what it was is no evidence of what it is"
    assert found.sd[axis] == drift.sd


def test_of_a_box_never_calibrated_the_filters_word_is_all_and_no_drift():
    found, drifts = folded_back(Biases(0, ZERO, np.full(6, np.nan)), Biases(S, np.full(6, 0.5), SURE), T)
    assert drifts == ()
    np.testing.assert_array_equal(found.bias, 0.5)
    np.testing.assert_allclose(found.sd, np.sqrt(SURE**2 + T.of("model") ** 2))


def test_over_many_trips_truth_lies_within_the_stated_spread():
    rng = np.random.default_rng(5)
    truth, inside = rng.normal(0.0, T.of("unknown"), (200, 6)), 0
    stored = [Biases(0, ZERO, np.full(6, np.nan)) for _ in truth]
    for trip in range(1, 21):
        truth += rng.normal(0.0, T.of("turn_on"), truth.shape)
        for k, known in enumerate(stored):
            seen = rng.normal(truth[k], np.hypot(SURE, T.of("model")))
            stored[k], _ = folded_back(known, Biases(trip * S, seen, SURE), T)
        inside += sum((np.abs(one.bias - truth[k]) < 3.0 * one.sd).sum() for k, one in enumerate(stored))
    # Normal errors: 99.73 %; the spread of the share over 24 000 (dependent) cases is some 0.1 %.
    assert inside / (20 * truth.size) > 0.993


def test_a_follower_folds_once_a_trip_and_only_what_was_seen_after_it():
    follower = BiasFollower()
    follower.begin(Biases(0, ZERO, SURE))
    assert follower.fold_back(3, 10 * S) is None, "no trip has ended"
    follower.see(Biases(50 * S, SURE, SURE))
    follower.trip_ended(60 * S)
    assert follower.fold_back(3, 100 * S) is None, "that was before its last movement"
    follower.see(Biases(70 * S, SURE, SURE))
    follower.trip_ended(60 * S)
    update = follower.fold_back(3, 100 * S)
    assert (update.version, update.biases.t_ns) == (3, 100 * S)
    np.testing.assert_array_equal(follower.stored.bias, update.biases.bias)
    assert follower.fold_back(3, 110 * S) is None

    other = BiasFollower()
    other.load({name: array.copy() for name, array in follower.arrays().items()})
    for one in (follower, other):
        one.see(Biases(200 * S, 2 * SURE, SURE))
        one.trip_ended(190 * S)
    again, restored = follower.fold_back(3, 210 * S), other.fold_back(3, 210 * S)
    assert again.biases.bias.tobytes() == restored.biases.bias.tobytes()
