"""Hard and soft iron: recovered as surely as stated, and a real car's circles straightened."""

from __future__ import annotations

import numpy as np
import pytest

from core.calibration.magnetometer import MagnetometerFit, fit_magnetometer
from core.calibration.magnetometer_level import fit_level_magnetometer, heading_turned, level_from
from core.errors import InvalidInputError
from core.measurements import FloatArray
from core.rotation import matrix_from_rotation_vector, matrix_from_rpy
from core.sensors import MagnetometerCalibration, TriadCalibration
from core.simulation.calibration_recording import Iron, SimulatedRecording, simulate_recording
from tests.recordings import recording

HARD = (25.0, -40.0, 12.0)
SOFT = np.array([[1.08, 0.03, -0.05], [0.03, 0.93, 0.02], [-0.05, 0.02, 1.01]])
SOFT /= np.cbrt(np.linalg.det(SOFT))
FIELD_UT = float(np.linalg.norm(Iron().field_n_ut))
PERFECT = TriadCalibration()


def rows_of(matrix: FloatArray) -> tuple[tuple[float, float, float], ...]:
    return tuple((float(row[0]), float(row[1]), float(row[2])) for row in matrix)


def turned_by_hand(seed: int, soft: FloatArray = SOFT) -> SimulatedRecording:
    iron = Iron(hard_iron_ut=HARD, soft_iron=rows_of(soft))  # type: ignore[arg-type]
    return simulate_recording(
        np.random.default_rng(seed),
        accelerometer=PERFECT,
        gyroscope=PERFECT,
        magnetometer=iron,
        rate_hz=50.0,
        hold_s=2.0,
        initial_rest_s=2.0,
    )


def shown(made: SimulatedRecording) -> FloatArray:
    assert made.recording.magnetometer is not None
    return made.recording.magnetometer


def ups(made: SimulatedRecording) -> tuple[FloatArray, FloatArray]:
    means = np.array([np.nanmean(shown(made)[a:b], axis=0) for a, b in zip(made.starts, made.ends, strict=True)])
    return means, -made.C_n_from_a[:, 2]


def errors_in_sd(fit: MagnetometerFit, soft: FloatArray) -> FloatArray:
    found = np.r_[fit.calibration.hard_iron, np.ravel(fit.calibration.soft_iron)]
    return np.asarray((found - np.r_[HARD, soft.ravel()]) / fit.sd)


def test_truth_lies_within_the_stated_spread() -> None:
    fits = [fit_magnetometer(shown(turned_by_hand(seed))) for seed in range(6)]
    errors = np.array([errors_in_sd(fit, SOFT) for fit in fits])
    assert np.abs(errors).max() < 3.5
    assert 0.6 < np.sqrt(np.mean(errors**2)) < 1.3
    for fit in fits:
        assert fit.field_strength == pytest.approx(FIELD_UT, abs=0.1)
        # The LSM303DLHC's noise is 0.4 uT.
        assert fit.residual_rms == pytest.approx(0.4, rel=0.05)
        assert fit.observability.observable


@pytest.mark.parametrize("turn_rad", [(0.05, -0.04, 0.08), (0.02, 0.01, np.pi / 2 + 0.03)])
def test_gravity_tells_how_the_magnetometer_lies_in_the_box(turn_rad: tuple[float, float, float]) -> None:
    soft = SOFT @ matrix_from_rotation_vector(np.array(turn_rad))
    made = turned_by_hand(11, soft)
    fit = fit_magnetometer(shown(made), ups(made))
    assert np.abs(errors_in_sd(fit, soft)).max() < 3.5
    # Two thousandths of a radian, against nothing at all without gravity.
    assert np.abs(np.ravel(fit.calibration.soft_iron) - soft.ravel()).max() < 0.01


def test_corrected_fields_all_have_the_strength_of_the_place() -> None:
    raw = shown(turned_by_hand(3))
    raw = raw[np.isfinite(raw[:, 0])]
    fit = fit_magnetometer(raw, field_ut=50.0)
    assert np.linalg.norm(fit.calibration.correct(raw), axis=1).mean() == pytest.approx(50.0, abs=0.05)
    assert fit.calibration.apply(fit.calibration.correct(raw)) == pytest.approx(raw, abs=1e-9)


def test_counts_have_no_strength_to_check() -> None:
    raw = shown(turned_by_hand(4)) * 11.0
    assert fit_magnetometer(raw, counts=True).field_strength == pytest.approx(11.0 * FIELD_UT, rel=0.01)
    scaled = fit_magnetometer(raw, counts=True, field_ut=FIELD_UT)
    assert np.cbrt(np.linalg.det(scaled.calibration.soft_iron)) == pytest.approx(11.0, rel=0.01)


def test_part_of_the_sphere_is_told_as_less_sure_and_a_cap_refused() -> None:
    raw = shown(turned_by_hand(5))
    raw = raw[np.isfinite(raw[:, 0])]
    upper = fit_magnetometer(raw[raw[:, 2] > HARD[2] + 5.0])
    assert np.abs(errors_in_sd(upper, SOFT)).max() < 3.5
    assert upper.coverage < 0.6
    assert upper.sd[2] > 2.0 * fit_magnetometer(raw).sd[2]
    with pytest.raises(InvalidInputError, match="through all attitudes"):
        fit_magnetometer(raw[raw[:, 2] > HARD[2] + 30.0])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda raw: raw / 100.0, "looks like gauss, multiply by 100"),
        (lambda raw: raw * 1000.0, "looks like nanotesla"),
        (lambda raw: raw * 2.0, "record again away from iron"),
        (lambda raw: raw * [1.0, 1.0, 0.0], "z axis shows 0 throughout"),
        (lambda raw: raw[:100:10], "magnetometer samples; expected 30"),
        (lambda raw: raw[:100], "hardly turned"),
    ],
)
def test_what_cannot_be_calibrated_is_refused_with_what_to_do(change: object, message: str) -> None:
    with pytest.raises(InvalidInputError, match=message):
        fit_magnetometer(change(shown(turned_by_hand(6))))  # type: ignore[operator]


def circles(turned_rad: FloatArray, seed: int = 7) -> tuple[FloatArray, tuple[float, float, float]]:
    """What a tilted box in a car shows on level circles, and up in its axes."""
    C_s_from_l = matrix_from_rpy(0.05, -0.3, 0.0).T
    north, down = 20.0, 44.0
    level = np.column_stack([north * np.cos(turned_rad), -north * np.sin(turned_rad), np.full(turned_rad.size, down)])
    iron = np.diag([1.1, 0.92, 1.0])
    field = (level @ iron.T + np.array([18.0, -12.0, 0.0])) @ C_s_from_l.T
    up = -C_s_from_l[:, 2]
    noise = 0.4 * np.random.default_rng(seed).standard_normal(field.shape)
    return field + noise, (float(up[0]), float(up[1]), float(up[2]))


@pytest.mark.parametrize(("degrees", "with_gyroscope"), [(720.0, False), (720.0, True), (150.0, True)])
def test_level_circles_tell_the_heading(degrees: float, with_gyroscope: bool) -> None:
    turned = np.radians(np.linspace(0.0, degrees, 1500))
    raw, up = circles(turned)
    # The gyroscope's bias turns on by 2 degrees beside the vehicle.
    seen = turned + np.radians(np.linspace(0.0, 2.0, turned.size)) if with_gyroscope else None
    fit = fit_level_magnetometer(raw, up, seen, field_ut=(20.0, 44.0))
    level = fit.calibration.correct(raw) @ matrix_from_rpy(0.05, -0.3, 0.0).T
    heading = np.unwrap(np.arctan2(-level[:, 1], level[:, 0]))
    # Noise of 0.4 over 20 uT is 1.1 degrees; an arc leaves some of the ellipse to be guessed.
    off = np.degrees(heading - turned - np.mean(heading - turned))
    assert np.sqrt(np.mean(off**2)) < 1.5
    assert {"soft_zz", "soft_xz"} <= set(fit.observability.weak)
    assert "all attitudes" in fit.observability.advice


def test_an_arc_without_a_gyroscope_is_refused() -> None:
    raw, up = circles(np.radians(np.linspace(0.0, 120.0, 500)))
    with pytest.raises(InvalidInputError, match="two full circles"):
        fit_level_magnetometer(raw, up)


def test_a_cars_circles_are_straightened() -> None:
    folder = recording("data", "drive_boston_vn100")
    rows = np.genfromtxt(folder / "circles_imu.csv.gz", delimiter=",", names=True)
    t_s = rows["t_s"]
    raw = 100.0 * np.column_stack([rows[f"m{axis}_gauss"] for axis in "xyz"])
    force = np.mean([rows["ax"], rows["ay"], rows["az"]], axis=1)
    up = force / np.linalg.norm(force)
    at = (float(up[0]), float(up[1]), float(up[2]))
    turned = heading_turned(t_s, np.column_stack([rows["gx"], rows["gy"], rows["gz"]]), at)
    fit = fit_level_magnetometer(raw, at, turned)

    def off_deg(field: FloatArray) -> float:
        level = field @ level_from(up).T
        heading = np.unwrap(np.arctan2(-level[:, 1], level[:, 0])) - turned
        design = np.column_stack([np.ones(t_s.size), t_s])
        return float(np.degrees(np.std(heading - design @ np.linalg.lstsq(design, heading, rcond=None)[0])))

    # Four circles: the magnetic heading follows the gyroscope's within 2 degrees instead of 33.
    assert off_deg(raw) > 30.0
    assert off_deg(fit.calibration.correct(raw)) < 2.0
    assert fit.coverage == 1.0
    with pytest.raises(InvalidInputError, match="gauss"):
        fit_level_magnetometer(raw / 100.0, at, turned)


def test_iron_without_an_inverse_is_refused() -> None:
    with pytest.raises(InvalidInputError, match="no inverse"):
        MagnetometerCalibration(soft_iron=((1.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)))
