"""The report on a calibration: what each sensor's parameters are, how sure, and how well the recording tells them."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from core.calibration.fit import PARAMETERS, TriadFit
from core.calibration.gyroscope import GYROSCOPE_PARAMETERS, GyroscopeFit
from core.calibration.magnetometer import MAGNETOMETER_PARAMETERS, MagnetometerFit
from core.calibration.static_intervals import StaticPositions
from core.measurements import FloatArray
from service.calibrating import CalibrationOutcome, Sensor
from service.reports.calibration_plots import (
    bias_and_warmth,
    correlations,
    gravity_norms,
    magnetic_spheres,
    orientations,
    position_residuals,
    static_intervals,
    turn_residuals,
)
from service.reports.page import Section, Table, page
from service.reports.plots import Plot
from service.reports.texts import number


def calibration_report(outcome: CalibrationOutcome) -> str:
    """The whole page."""
    sections = [_summary(outcome)]
    if outcome.positions is not None and outcome.accelerometer is not None:
        sections.append(_positions(outcome, outcome.positions, outcome.accelerometer))
    for sensor, fit in outcome.fits.items():
        if isinstance(fit, MagnetometerFit):
            sections.append(_magnetometer(outcome, fit))
        elif isinstance(fit, GyroscopeFit):
            sections.append(_gyroscope(outcome, fit))
        elif sensor == "gyroscope":
            sections.append(_earth_rate(outcome, fit))
        elif outcome.positions is not None:
            sections.append(_accelerometer(outcome, outcome.positions, fit, sensor))
    return page(f"Calibration report: {outcome.name}", sections)


def _summary(outcome: CalibrationOutcome) -> Section:
    t_s = outcome.recording.t_s
    unit = "raw counts" if outcome.counts else "m/s², rad/s, µT"
    facts = [
        ("recording", outcome.name),
        ("length", f"{t_s[-1] - t_s[0]:.1f} s, {t_s.size} samples"),
        ("unit", unit),
    ]
    if outcome.positions is not None:
        facts += [
            ("static positions", str(len(outcome.positions))),
            ("gravity", number(outcome.gravity_mps2, "m/s²", 5)),
        ]
    rows = []
    for sensor, fit in outcome.fits.items():
        weak = ", ".join(fit.observability.weak) or "none"
        rows.append([sensor, _missed(outcome, sensor, fit), str(fit.iterations), str(fit.stop).replace("_", " "), weak])
    header = ["sensor", "residual, RMS", "iterations", "stopped by", "not told by the recording"]
    parts = [Table("Recording", [], facts, prose=True), Table("Fits", header, rows, prose=True)]
    return Section("Summary", [*outcome.warnings, *outcome.advice], parts)


def _missed(outcome: CalibrationOutcome, sensor: Sensor, fit: TriadFit | MagnetometerFit) -> str:
    if isinstance(fit, MagnetometerFit):
        return number(fit.residual_rms, _field_unit(outcome, fit), 3)
    if isinstance(fit, GyroscopeFit):
        return number(math.degrees(fit.residual_rms), "°", 3)
    if sensor == "gyroscope":
        return number(math.degrees(fit.residual_rms), "°/s", 4)
    return number(1e3 * fit.residual_rms, "mm/s²", 3)


def _positions(outcome: CalibrationOutcome, positions: StaticPositions, fit: TriadFit) -> Section:
    up = fit.calibration.correct(positions.mean_accelerometer)
    up = up / np.linalg.norm(up, axis=1)[:, None]
    return Section(
        "Static positions",
        [],
        [
            static_intervals(outcome.recording, positions, "counts" if outcome.counts else "m/s²"),
            orientations(up, np.array(fit.observability.add).reshape(-1, 3)),
        ],
    )


def _accelerometer(outcome: CalibrationOutcome, positions: StaticPositions, fit: TriadFit, sensor: Sensor) -> Section:
    unit = "counts" if outcome.counts else "m/s²"
    scale_unit = "counts per m/s²" if outcome.counts else ""
    mean, gravity = positions.mean_accelerometer, outcome.gravity_mps2
    # Counts are made m/s2 by one scale and zero for all axes: what a box would show that is not calibrated.
    nominal = float(np.mean(fit.calibration.scale)) if outcome.counts else 1.0
    zero = float(np.mean(fit.calibration.bias)) if outcome.counts else 0.0
    before = np.linalg.norm((mean - zero) / nominal, axis=1)
    after = np.linalg.norm(fit.calibration.correct(mean), axis=1)
    parts: list[Table | Plot] = [
        gravity_norms(before, after, gravity, outcome.counts),
        position_residuals(fit.residuals),
        _parameters("Parameters", PARAMETERS, _values(fit), fit.sd, (scale_unit, "rad", unit), fit.observability.weak),
        correlations(fit.correlation, PARAMETERS),
        *_warmth(outcome, "accelerometer", unit),
    ]
    return Section("Accelerometer", outcome.sensor_warnings.get(sensor, ()), parts)


def _gyroscope(outcome: CalibrationOutcome, fit: GyroscopeFit) -> Section:
    unit, scale_unit = ("counts", "counts per rad/s") if outcome.counts else ("rad/s", "")
    sd = np.sqrt(np.diag(fit.joint_covariance))
    values = np.r_[_values(fit), fit.alignment_rad]
    correlation = fit.joint_covariance / np.outer(sd, sd)
    units = (scale_unit, "rad", unit, "rad")
    parts: list[Table | Plot] = [
        turn_residuals(fit.residuals),
        _parameters("Parameters", GYROSCOPE_PARAMETERS, values, sd, units, fit.observability.weak),
        correlations(correlation, GYROSCOPE_PARAMETERS),
    ]
    parts += _warmth(outcome, "gyroscope", unit)
    if fit.g_sensitivity.any():
        parts.append(_sensitivity(fit, unit))
    return Section("Gyroscope", outcome.sensor_warnings.get("gyroscope", ()), parts)


def _magnetometer(outcome: CalibrationOutcome, fit: MagnetometerFit) -> Section:
    assert outcome.recording.magnetometer is not None
    shown = outcome.recording.magnetometer
    shown = shown[np.isfinite(shown).all(axis=1)]
    unit = "counts" if outcome.counts else "µT"
    sd = np.sqrt(np.diag(fit.covariance))
    values = np.r_[fit.calibration.hard_iron, np.array(fit.calibration.soft_iron).ravel()]
    units = (unit, *[f"{unit} per {_field_unit(outcome, fit)}" if outcome.counts else ""] * 3)
    parts: list[Table | Plot] = [
        magnetic_spheres(shown, fit.calibration.correct(shown), fit.field_strength, _field_unit(outcome, fit)),
        _parameters("Parameters", MAGNETOMETER_PARAMETERS, values, sd, units, fit.observability.weak),
    ]
    text = f"The field was seen in {100.0 * fit.coverage:.0f} % of all directions."
    return Section("Magnetometer", [text, *outcome.sensor_warnings.get("magnetometer", ())], parts)


def _field_unit(outcome: CalibrationOutcome, fit: MagnetometerFit) -> str:
    """Counts have no scale unless the field's strength was given."""
    scaled = abs(float(np.linalg.det(np.array(fit.calibration.soft_iron))) - 1.0) > 1e-6
    return "counts" if outcome.counts and not scaled else "µT"


def _values(fit: TriadFit) -> FloatArray:
    return np.array([*fit.calibration.scale, *fit.calibration.misalignment, *fit.calibration.bias])


def _parameters(
    caption: str,
    names: Sequence[str],
    values: FloatArray,
    sds: FloatArray,
    units: Sequence[str],
    weak: Sequence[str],
) -> Table:
    rows = [
        [name, f"{value:.6g}", f"{sd:.2g}", f"{sd**2:.2g}", units[i // 3], "no" if name in weak else "yes"]
        for i, (name, value, sd) in enumerate(zip(names, values, sds, strict=True))
    ]
    return Table(caption, ["parameter", "value", "sd", "variance", "unit", "told by the recording"], rows)


def _earth_rate(outcome: CalibrationOutcome, fit: TriadFit) -> Section:
    text = f"At rest, by the Earth's rate; it is missed by {math.degrees(fit.residual_rms):.3g}°/s RMS."
    units = ("", "rad", "rad/s")
    parts: list[Table | Plot] = [
        _parameters("Parameters", PARAMETERS, _values(fit), fit.sd, units, fit.observability.weak),
        *_warmth(outcome, "gyroscope", "rad/s"),
    ]
    return Section("Gyroscope", [text, *outcome.sensor_warnings.get("gyroscope", ())], parts)


def _warmth(outcome: CalibrationOutcome, sensor: Sensor, unit: str) -> list[Table | Plot]:
    """How the bias followed temperature; the gyroscope's is seen in each position, the accelerometer's only fitted."""
    slope, recording, positions = outcome.temperature.get(sensor), outcome.recording, outcome.positions
    if slope is None or recording.temperature_c is None or positions is None:
        return []
    rows = [[axis, f"{v:.3g}", f"{sd:.2g}"] for axis, v, sd in zip("xyz", slope.slope_per_k, slope.sd, strict=True)]
    table = Table(f"Bias by temperature, {unit} per K", ["bias of", "slope", "sd"], rows)
    if sensor != "gyroscope" or positions.mean_gyroscope is None:
        return [table]
    spans = zip(positions.start, positions.end, strict=True)
    at = np.array([float(np.mean(recording.temperature_c[start:end])) for start, end in spans])
    return [bias_and_warmth(at, positions.mean_gyroscope, slope, unit), table]


def _sensitivity(fit: GyroscopeFit, unit: str) -> Table:
    rows = [
        [f"{axis}", *(f"{v:.3g} ± {sd:.1g}" for v, sd in zip(values, sds, strict=True))]
        for axis, values, sds in zip("xyz", fit.g_sensitivity, fit.g_sensitivity_sd, strict=True)
    ]
    caption = f"What specific force along x, y, z adds to the bias, {unit} per m/s²"
    return Table(caption, ["bias of", "x", "y", "z"], rows)
