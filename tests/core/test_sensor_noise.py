"""Stated noise of a box's sensors as the filter's, and what the simulated box states of itself."""

from __future__ import annotations

import math
from dataclasses import fields, replace

import numpy as np
import pytest

from core.errors import InvalidInputError
from core.measurements import FloatArray
from core.navigation.sensor_noise import NoiseAllowance, matched_tuning
from core.navigation.tuning import Tuning
from core.sensors import ALLAN_FLOOR, TriadNoise
from core.simulation.route import RouteBuilder
from core.simulation.scenarios import MADRID
from core.simulation.sensors import LOW_COST_MEMS, Vibration, draw_errors, measure_inertial
from core.simulation.trajectory import drive

NONE = NoiseAllowance(
    stated_factor=1.0,
    gyro_noise_radps_rts=0.0,
    accel_noise_mps2_rts=0.0,
    gyro_bias_walk_radps2_rts=0.0,
    accel_bias_walk_mps3_rts=0.0,
    gyro_bias_sd_radps=0.0,
    accel_bias_sd_mps2=0.0,
)
NOISES = ("gyro_noise_radps_rts", "gyro_bias_walk_radps2_rts", "gyro_bias_sd_radps",
          "accel_noise_mps2_rts", "accel_bias_walk_mps3_rts", "accel_bias_sd_mps2")  # fmt: skip


def test_what_is_not_stated_stays_as_it_was() -> None:
    tuning = Tuning(nhc_sd_mps=0.4, gyro_noise_radps_rts=2e-3)
    assert matched_tuning(tuning, TriadNoise(), TriadNoise()) == tuning
    changed = matched_tuning(tuning, TriadNoise(random_walk=1e-3), TriadNoise())
    assert [f.name for f in fields(Tuning) if getattr(changed, f.name) != getattr(tuning, f.name)] == [
        "accel_noise_mps2_rts"
    ]


def test_without_allowance_the_stated_figures_are_the_filters() -> None:
    accelerometer, gyroscope = TriadNoise(2e-3, None, 3e-4, 0.05), TriadNoise(1e-4, None, 5e-6, 1e-3)
    tuning = matched_tuning(Tuning(), accelerometer, gyroscope, NONE)
    assert [getattr(tuning, name) for name in NOISES] == [1e-4, 5e-6, 1e-3, 2e-3, 3e-4, 0.05]


def test_a_flicker_becomes_the_walk_that_has_its_allan_variance_after_the_horizon() -> None:
    flicker, horizon_s = 5e-5, NONE.instability_s
    tuning = matched_tuning(Tuning(), TriadNoise(), TriadNoise(bias_instability=flicker), NONE)
    walk = tuning.gyro_bias_walk_radps2_rts
    assert walk**2 * horizon_s / 3.0 == pytest.approx((0.664 * flicker) ** 2, rel=1e-3)  # 0.664 has three digits
    larger = TriadNoise(bias_instability=flicker, rate_random_walk=2 * walk)
    assert matched_tuning(Tuning(), TriadNoise(), larger, NONE).gyro_bias_walk_radps2_rts == 2 * walk
    smaller = TriadNoise(bias_instability=flicker, rate_random_walk=0.0)
    assert matched_tuning(Tuning(), TriadNoise(), smaller, NONE).gyro_bias_walk_radps2_rts == walk


def test_a_perfect_laboratory_does_not_make_the_filter_sure_of_itself_in_a_car() -> None:
    perfect = TriadNoise(1e-9, 0.0, 0.0, 1e-9)
    tuning, allowance = matched_tuning(Tuning(), perfect, perfect), NoiseAllowance()
    for name in NOISES:
        assert getattr(tuning, name) >= getattr(allowance, name) > 0.0, name


def test_a_sensor_worse_than_the_usual_is_taken_at_its_word() -> None:
    poor = TriadNoise(random_walk=3e-3, turn_on_bias_sd=0.1)
    tuning = matched_tuning(Tuning(), TriadNoise(), poor)
    assert tuning.gyro_noise_radps_rts == pytest.approx(
        math.hypot(NoiseAllowance().stated_factor * 3e-3, NoiseAllowance().gyro_noise_radps_rts)
    )
    assert tuning.gyro_bias_sd_radps > 0.1
    with pytest.raises(InvalidInputError, match="gyro_noise_radps_rts"):
        matched_tuning(Tuning(), TriadNoise(), replace(poor, random_walk=1.0))


def _allan_deviation(signal: FloatArray, dt_s: float, cluster_s: float) -> FloatArray:
    """Of each column, clusters beside each other."""
    size = round(cluster_s / dt_s)
    means = signal[: len(signal) // size * size].reshape(-1, size, signal.shape[1]).mean(axis=1)
    return np.asarray(np.sqrt(0.5 * np.mean(np.diff(means, axis=0) ** 2, axis=0)))


def test_a_simulated_box_states_what_its_allan_deviation_shows() -> None:
    rate_hz = 20.0
    quiet = replace(LOW_COST_MEMS, vibration=Vibration(road_sd_mps2=0.0, engine_sd_mps2=0.0, ringing_share=0.0))
    standing = drive(RouteBuilder().hold(12_000.0).build(), MADRID, rate_hz)
    rng = np.random.default_rng(1)
    f_s, omega_s = measure_inertial(standing, quiet, draw_errors(quiet, rng), rng)
    for signal, triad in ((f_s, quiet.accelerometer), (omega_s, quiet.gyroscope)):
        stated = triad.noise
        assert stated.random_walk is not None
        assert stated.bias_instability is not None
        assert stated.rate_random_walk is not None
        # 12 000 pairs: 0.8 % sd of the estimate, and the converter's step adds a little.
        assert _allan_deviation(signal, 1 / rate_hz, 1.0) == pytest.approx(np.full(3, stated.random_walk), rel=0.05)
        floor_s = math.sqrt(3.0) * stated.random_walk / stated.rate_random_walk
        floor = _allan_deviation(signal, 1 / rate_hz, floor_s)
        # Some hundred and more clusters: 8 % sd; the correlation time of 300 s bends the walk by a few percent.
        assert floor == pytest.approx(np.full(3, ALLAN_FLOOR * stated.bias_instability), rel=0.25)
