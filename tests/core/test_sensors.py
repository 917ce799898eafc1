"""The nine-parameter triad of seed 1, eq. 1-4, and its inverse."""

from __future__ import annotations

import numpy as np
import pytest

from core.errors import InvalidInputError
from core.sensors import TriadCalibration

SKEWED = TriadCalibration(scale=(1.02, 0.97, 1.01), misalignment=(0.01, -0.02, 0.03), bias=(0.3, -0.2, 0.1))


def test_measured_is_scale_times_misalignment_times_true_plus_bias() -> None:
    mx, my, mz = SKEWED.misalignment
    M = np.array([[1.0, -mz, my], [0.0, 1.0, -mx], [0.0, 0.0, 1.0]])
    true = np.array([[1.0, 2.0, -9.81], [0.0, 0.0, 0.0]])
    expected = true @ (np.diag(SKEWED.scale) @ M).T + np.array(SKEWED.bias)
    assert SKEWED.apply(true) == pytest.approx(expected, abs=1e-14)


def test_correcting_gives_back_what_was_measured() -> None:
    true = np.random.default_rng(3).normal(0.0, 10.0, (200, 3))
    assert SKEWED.correct(SKEWED.apply(true)) == pytest.approx(true, abs=1e-12)


def test_the_default_changes_nothing() -> None:
    values = np.random.default_rng(4).normal(0.0, 10.0, (50, 3))
    assert np.array_equal(TriadCalibration().apply(values), values)
    assert np.array_equal(TriadCalibration().correct(values), values)


@pytest.mark.parametrize("cut", [1, 7, 64, 333])
def test_the_bits_do_not_depend_on_how_samples_are_cut(cut: int) -> None:
    values = np.random.default_rng(5).normal(0.0, 10.0, (1000, 3))
    whole = SKEWED.correct(values)
    parts = np.vstack([SKEWED.correct(values[i : i + cut]) for i in range(0, 1000, cut)])
    assert np.array_equal(whole, parts)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"scale": (1.0, 0.0, 1.0)}, "no zero"),
        ({"bias": (0.0, float("nan"), 0.0)}, "bias"),
        ({"misalignment": (0.0, 0.0)}, "three finite numbers"),
    ],
)
def test_a_triad_that_cannot_be_is_refused(arguments: dict, message: str) -> None:
    with pytest.raises(InvalidInputError, match=message):
        TriadCalibration(**arguments)
