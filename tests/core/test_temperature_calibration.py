"""Biases against temperature: slopes recovered as surely as stated; the Earth's rate that tells a bias alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from core.calibration.accelerometer import fit_accelerometer
from core.calibration.earth_rate import fit_earth_rate
from core.calibration.static_intervals import StaticPositions
from core.calibration.temperature import accelerometer_temperature, gyroscope_temperature
from core.earth import STANDARD_GRAVITY_MPS2
from core.errors import InvalidInputError
from core.sensors import TriadCalibration
from core.simulation.calibration_recording import SimulatedRecording, Warming, simulate_recording

GYRO = TriadCalibration(bias=(0.012, -0.02, 0.006))
WARMING = Warming(20.0, 40.0, 90.0, 25.0, (0.0049, -0.003, 0.002), (5e-4, -4e-4, 2e-4))


def warmed(seed: int, warming: Warming | None = WARMING) -> tuple[SimulatedRecording, StaticPositions]:
    made = simulate_recording(
        np.random.default_rng(seed),
        accelerometer=TriadCalibration(),
        gyroscope=GYRO,
        warming=warming,
        rate_hz=50.0,
    )
    return made, StaticPositions.of(made.recording, made.starts, made.ends)


def test_slopes_lie_within_their_stated_spread() -> None:
    errors, found = [], []
    for seed in range(6):
        made, positions = warmed(seed)
        accelerometer = fit_accelerometer(positions, STANDARD_GRAVITY_MPS2)
        gyro = gyroscope_temperature(made.recording, positions)
        accel = accelerometer_temperature(made.recording, positions, accelerometer)
        assert gyro is not None
        assert accel is not None
        found.append((gyro, accel))
        errors += [
            (np.array(gyro.slope_per_k) - WARMING.gyroscope_per_k) / gyro.sd,
            (np.array(accel.slope_per_k) - WARMING.accelerometer_per_k) / accel.sd,
        ]
    assert np.abs(errors).max() < 3.5
    # A tenth of the gyroscope's slope, and a twelfth of the accelerometer's, are known.
    assert max(max(gyro.sd) for gyro, _ in found) < 5e-5
    assert max(max(accel.sd) for _, accel in found) < 4e-4
    gyro, _ = found[0]
    # 20 to 40 C with 0.1 K of noise; the bias of the calibration holds at the mean.
    assert gyro.low_c == pytest.approx(20.0, abs=0.5)
    assert gyro.bias(np.zeros(3), gyro.reference_c + 2.0) == pytest.approx(2.0 * np.array(gyro.slope_per_k))


def test_without_a_thermometer_there_is_no_slope_and_without_warmth_a_reason() -> None:
    made, positions = warmed(1, None)
    assert gyroscope_temperature(made.recording, positions) is None
    accelerometer = fit_accelerometer(positions, STANDARD_GRAVITY_MPS2)
    assert accelerometer_temperature(made.recording, positions, accelerometer) is None
    steady = replace(made.recording, temperature_c=np.full(len(made.recording.t_s), 25.0))
    with pytest.raises(InvalidInputError, match="while the box warms up from cold"):
        gyroscope_temperature(steady, positions)


def test_the_earths_rate_tells_a_mems_gyroscopes_bias_and_nothing_else() -> None:
    _, positions = warmed(2, None)
    fit = fit_earth_rate(positions)
    assert np.abs((np.array(fit.calibration.bias) - GYRO.bias) / fit.sd[6:]).max() < 3.5
    assert set(fit.observability.weak) == {"scale_x", "scale_y", "scale_z", "Mx", "My", "Mz"}
    assert "below this triad's noise" in fit.observability.advice


def test_the_earths_rate_tells_the_scale_of_a_gyroscope_that_feels_it() -> None:
    # A navigation-grade triad: 24 positions of 1e-8 rad/s.
    _, positions = warmed(3, None)
    triad = TriadCalibration((1.01, 0.98, 1.005), (0.01, -0.02, 0.015), (1e-3, -2e-3, 5e-4))
    axes = positions.mean_accelerometer / np.linalg.norm(positions.mean_accelerometer, axis=1)[:, None]
    shown = triad.apply(7.292115e-5 * axes)
    exact = replace(positions, mean_gyroscope=shown, cov_gyroscope=np.tile(1e-16 * np.eye(3), (len(axes), 1, 1)))
    fit = fit_earth_rate(exact)
    assert fit.calibration.scale == pytest.approx(triad.scale, abs=3e-4)
    assert fit.calibration.misalignment == pytest.approx(triad.misalignment, abs=3e-4)
    assert not fit.observability.weak


def test_the_earths_rate_needs_positions() -> None:
    made, _ = warmed(4, None)
    few = StaticPositions.of(made.recording, made.starts[:3], made.ends[:3])
    with pytest.raises(InvalidInputError, match="3 static positions; expected 4"):
        fit_earth_rate(few)
