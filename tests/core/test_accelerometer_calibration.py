"""An accelerometer's nine parameters: against the truth of simulated units, and what cannot be told told so."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from core.calibration.accelerometer import fit_accelerometer, norm_residuals
from core.calibration.fit import PARAMETERS, TriadFit
from core.calibration.observability import CANDIDATES, describe_up
from core.calibration.recording import CalibrationRecording
from core.calibration.static_intervals import StaticPositions
from core.earth import STANDARD_GRAVITY_MPS2 as G
from core.errors import InvalidInputError
from core.measurements import FloatArray
from core.sensors import TriadCalibration
from core.simulation.calibration_recording import spread_orientations
from core.simulation.sensors import ACCELEROMETER, UNCALIBRATED, draw_errors
from service.bench.calibration_targets import SEED1_TABLE_2

RATE_HZ = 50.0
"""The mean of 5 s is as noisy as at 200 Hz, with a quarter of the samples."""

FACES = CANDIDATES[:6]
_AROUND = np.arange(9) * 2.0 * np.pi / 9.0
_SLOPE = np.where(np.arange(9) % 2, 0.4, 0.15)
TILTED = np.column_stack([_SLOPE * np.cos(_AROUND), _SLOPE * np.sin(_AROUND), np.sqrt(1.0 - _SLOPE**2)])
"""9 and 24 degrees off level, as far as a box in a vehicle may ever come."""
SKEWED = TriadCalibration((1.02, 0.97, 1.01), (0.01, -0.02, 0.015), (0.3, -0.2, 0.1))


def _unit(seed: int) -> TriadCalibration:
    return draw_errors(UNCALIBRATED, np.random.default_rng([seed])).accelerometer


def _ups(count: int, generator: np.random.Generator) -> FloatArray:
    return -spread_orientations(count, generator)[:, 2]


def _positions(
    unit: TriadCalibration,
    up: FloatArray,
    generator: np.random.Generator,
    *,
    hold_s: float = 5.0,
    noise: float = ACCELEROMETER.random_walk,
    off_mps2: FloatArray | float = 0.0,
    scale: float = 1.0,
    zero: float = 0.0,
) -> StaticPositions:
    """Held still with the up directions (k, 3) one after the other; ``off_mps2`` (k, 3) is what no parameter tells."""
    rows = int(hold_s * RATE_HZ)
    mean = unit.apply(G * up) + off_mps2
    samples = np.repeat(mean, rows, axis=0) + noise * np.sqrt(RATE_HZ) * generator.standard_normal((len(up) * rows, 3))
    recording = CalibrationRecording(np.arange(len(samples)) / RATE_HZ, scale * samples + zero)
    edges = np.arange(len(up) + 1) * rows
    return StaticPositions.of(recording, edges[:-1], edges[1:])


def _values(calibration: TriadCalibration) -> FloatArray:
    return np.array([*calibration.scale, *calibration.misalignment, *calibration.bias])


@cache
def _units() -> tuple[tuple[TriadCalibration, TriadFit], ...]:
    """500 units with the noise of seed 1, table 1, in 24 positions of 5 s."""
    found = []
    for seed in range(500):
        generator = np.random.default_rng(seed)
        unit = _unit(seed)
        found.append((unit, fit_accelerometer(_positions(unit, _ups(24, generator), generator), G)))
    return tuple(found)


def test_the_jacobian_is_that_of_the_residual() -> None:
    generator = np.random.default_rng(1)
    y, p = _ups(12, generator), _values(SKEWED) + 0.01
    jacobian = norm_residuals(p, y)[1]
    numeric = np.column_stack(
        [(norm_residuals(p + h, y)[0] - norm_residuals(p - h, y)[0]) / 2e-6 for h in 1e-6 * np.eye(9)]
    )
    assert jacobian == pytest.approx(numeric, abs=1e-9)


def test_readings_without_noise_give_the_unit_back() -> None:
    generator = np.random.default_rng(2)
    fit = fit_accelerometer(_positions(SKEWED, _ups(24, generator), generator, noise=1e-7), G)
    # The prior pulls by the square of its share: (1e-4 / 0.03)^2 of at most 0.03.
    assert _values(fit.calibration) == pytest.approx(_values(SKEWED), abs=2e-6)
    assert fit.residual_rms < 1e-5
    assert fit.stop.converged
    assert fit.observability.observable
    assert fit.observability.advice == ""


def test_the_truth_is_within_three_sd_in_99_of_100_units_for_every_parameter() -> None:
    ratios = np.array([(_values(fit.calibration) - _values(unit)) / fit.sd for unit, fit in _units()])
    within = np.abs(ratios) <= 3.0
    assert within.mean(axis=0).min() >= 0.99
    # Nor is more stated than there is; biases carry besides what they will wander after the recording.
    assert np.sqrt(np.mean(ratios[:, :6] ** 2, axis=0)) == pytest.approx(0.85, abs=0.2)


def test_it_converges_in_15_iterations_and_calls_nothing_weak() -> None:
    for _, fit in _units():
        assert fit.iterations <= 15
        assert fit.stop.converged
        assert fit.observability.observable


def test_variances_over_five_recordings_are_below_seed_1_table_2() -> None:
    for seed in range(10):
        unit, rows = _unit(seed), []
        for turn in range(5):
            generator = np.random.default_rng([seed, turn])
            found = fit_accelerometer(_positions(unit, _ups(24, generator), generator), G).calibration
            (sx, sy, sz), (mx, my, mz) = found.scale, found.misalignment
            rows.append([sx, -sx * mz, sx * my, sy, -sy * mx, sz, *(np.array(found.bias) / G)])
        assert (np.var(rows, axis=0, ddof=1) < np.array(list(SEED1_TABLE_2.values()))).all()


def test_what_no_parameter_tells_widens_the_sd_until_it_is_honest() -> None:
    ratios, sds = [], []
    for seed in range(150):
        generator = np.random.default_rng([7, seed])
        unit = _unit(seed)
        off = 0.01 * generator.standard_normal((18, 3))  # ten times the noise: a slope of the table, a soft case
        fit = fit_accelerometer(_positions(unit, _ups(18, generator), generator, off_mps2=off), G)
        ratios.append((_values(fit.calibration) - _values(unit)) / fit.sd)
        sds.append(fit.sd[0])
    assert (np.abs(ratios) <= 3.0).mean() >= 0.99
    assert np.median(sds) > 4.0 * np.median([fit.sd[0] for _, fit in _units()])


def test_counts_are_fitted_as_well_as_metres_per_second_squared() -> None:
    generator = np.random.default_rng(3)
    up, scale, zero = _ups(24, generator), 415.0, 32768.0
    in_si, in_counts = (
        _positions(SKEWED, up, np.random.default_rng(4), scale=a, zero=b) for a, b in ((1.0, 0.0), (scale, zero))
    )
    si, counts = fit_accelerometer(in_si, G), fit_accelerometer(in_counts, G, counts=True)
    units = np.array([scale] * 3 + [1.0] * 3 + [scale] * 3)
    back = (_values(counts.calibration) - np.array([0.0] * 6 + [zero] * 3)) / units
    # The same problem, but for priors that both are nearly free of, and the stop of the iteration.
    assert np.abs(back - _values(si.calibration)).max() < 0.02 * si.sd[:6].min()
    assert counts.sd / units == pytest.approx(si.sd, rel=0.02)
    assert counts.residuals == pytest.approx(si.residuals, abs=1e-5)
    assert counts.iterations <= 15


def test_a_position_that_shook_counts_for_less() -> None:
    generator = np.random.default_rng(5)
    up = _ups(20, generator)
    calm = _positions(SKEWED, up, generator)
    means, covariances = calm.mean_accelerometer.copy(), calm.cov_accelerometer.copy()
    means[3] += 0.5 * up[3]
    covariances[3] += 0.5**2 * np.eye(3)
    shaken = StaticPositions(calm.start, calm.end, means, covariances, None, None)
    fit = fit_accelerometer(shaken, G)
    assert np.abs((_values(fit.calibration) - _values(SKEWED)) / fit.sd).max() < 3.0
    assert fit.sd[0] < 2.0 * fit_accelerometer(calm, G).sd[0]


def test_six_faces_tell_scale_and_bias_but_no_misalignment() -> None:
    generator = np.random.default_rng(6)
    fit = fit_accelerometer(_positions(SKEWED, FACES, generator), G)
    assert fit.observability.weak == ("Mx", "My", "Mz")
    assert "do not tell Mx, My and Mz" in fit.observability.advice
    told = [name not in fit.observability.weak for name in PARAMETERS]
    # An axis tilted by M reads less of g by M^2 / 2: that is in the sd too, by the prior of M.
    assert np.abs((_values(fit.calibration) - _values(SKEWED))[told] / fit.sd[told]).max() < 3.0
    # Nothing known of them but the prior.
    assert fit.sd[3:6] == pytest.approx(0.03, rel=0.05)


@pytest.mark.parametrize(
    "poor",
    [
        FACES,
        np.vstack([FACES, np.array([[0.6, 0.8, 0.0], [0.6, -0.8, 0.0], [-0.28, 0.96, 0.0]])]),
        TILTED,
    ],
    ids=["faces", "about z", "little tilted"],
)
def test_the_positions_that_are_asked_for_tell_what_was_weak(poor: FloatArray) -> None:
    generator = np.random.default_rng(8)
    before = fit_accelerometer(_positions(SKEWED, poor, generator), G).observability
    if before.observable:
        pytest.fail("the positions are not poor")
    enough = np.vstack([poor, np.array(before.add)])
    after = fit_accelerometer(_positions(SKEWED, enough, generator), G)
    assert after.observability.observable
    assert after.observability.condition < before.condition
    assert len(before.add) <= 6


def test_an_absurd_value_is_called_weak_however_small_the_residuals() -> None:
    generator = np.random.default_rng(9)
    absurd = TriadCalibration((1.0, 1.0, 1.0), (0.0, 0.0, 0.15), (0.0, 0.0, 0.0))
    fit = fit_accelerometer(_positions(absurd, _ups(24, generator), generator), G)
    assert fit.residual_rms < 2e-3
    assert fit.observability.weak == ("Mz",)
    assert "Mz came out absurd" in fit.observability.advice
    assert fit.observability.add


def test_correlations_and_sd_belong_to_the_covariance() -> None:
    fit = _units()[0][1]
    assert np.diag(fit.correlation) == pytest.approx(1.0)
    assert fit.covariance == pytest.approx(fit.correlation * np.outer(fit.sd, fit.sd))
    assert np.linalg.eigvalsh(fit.covariance).min() > 0.0


def _few(up: FloatArray, **options: float) -> StaticPositions:
    return _positions(SKEWED, up, np.random.default_rng(10), **options)


@pytest.mark.parametrize(
    ("positions", "message"),
    [
        (_few(FACES[:4]), "4 static positions in 4 different orientations; expected at least 6: lay the box on each"),
        (_few(np.repeat(FACES[:2], 6, axis=0)), "12 static positions in 2 different orientations"),
        (_few(FACES, scale=1.0 / G), "reads .* at rest; .* look like g: multiply by 9.80665"),
        (_few(FACES, scale=415.0, zero=32768.0), "reads .* at rest; .*raw counts need --counts"),
    ],
)
def test_what_cannot_be_fitted_says_what_to_record(positions: StaticPositions, message: str) -> None:
    with pytest.raises(InvalidInputError, match=message):
        fit_accelerometer(positions, G)


@pytest.mark.parametrize("counts", [False, True])
def test_a_dead_axis_is_named(counts: bool) -> None:
    generator = np.random.default_rng(11)
    dead = _positions(SKEWED, _ups(24, generator), generator)
    means = dead.mean_accelerometer.copy()
    means[:, 1] = 0.02
    broken = StaticPositions(dead.start, dead.end, means, dead.cov_accelerometer, None, None)
    with pytest.raises(InvalidInputError, match="y axis reads the same in all 24 positions: it is dead"):
        fit_accelerometer(broken, G, counts=counts)


@pytest.mark.parametrize("gravity_mps2", [0.0, 1.0, 32.17, float("nan")])
def test_gravity_must_be_the_earths(gravity_mps2: float) -> None:
    with pytest.raises(InvalidInputError, match=r"expected 9\.7 to 9\.9 m/s2"):
        fit_accelerometer(_few(FACES), gravity_mps2)


def test_positions_are_described_as_a_hand_lays_them() -> None:
    assert describe_up((0.0, -1.0, 0.0)) == "the y axis down"
    assert describe_up((0.707, 0.0, -0.707)) == "x up and z down, on the edge at 45 degrees"
    assert describe_up((-0.577, 0.577, 0.577)) == "x down, y up and z up, on the corner"
