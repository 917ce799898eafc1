"""The nine-parameter triad of seed 1, eq. 1-4, and its inverse."""

from __future__ import annotations

import numpy as np
import pytest

from core.errors import InvalidInputError
from core.preparation import Mounting, Preparation
from core.rotation import matrix_from_rotation_vector, matrix_from_rpy
from core.sensors import MagnetometerCalibration, TriadCalibration

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


def test_a_triad_that_is_turned_in_the_box_is_told_in_the_boxs_axes() -> None:
    turned = TriadCalibration(SKEWED.scale, SKEWED.misalignment, SKEWED.bias, alignment=(0.02, -0.5, 0.1))
    true = np.random.default_rng(6).normal(0.0, 1.0, (50, 3))
    in_triad = true @ matrix_from_rotation_vector(np.array(turned.alignment)).T
    assert turned.apply(true) == pytest.approx(SKEWED.apply(in_triad), abs=1e-14)
    assert turned.correct(turned.apply(true)) == pytest.approx(true, abs=1e-13)


def test_a_magnetometer_in_a_mounted_box_is_freed_of_its_iron() -> None:
    iron = MagnetometerCalibration((25.0, -40.0, 12.0), ((1.1, 0.02, 0.0), (0.03, 0.9, -0.04), (0.0, 0.01, 1.0)))
    mounting = Mounting((0.1, -0.2, 2.0), known=True)
    field_b = np.random.default_rng(7).normal(0.0, 30.0, (40, 3))
    shown = iron.apply(field_b @ matrix_from_rpy(*mounting.rpy_rad))
    prepared = Preparation(TriadCalibration(), TriadCalibration(), mounting, float("nan"), iron)
    assert prepared.magnetic_b_ut(shown) == pytest.approx(field_b, abs=1e-11)
    assert iron.correct(iron.apply(field_b)) == pytest.approx(field_b, abs=1e-11)
