"""Calibrates a box's sensors from a recording: what ``telefuse calibrate`` and the calibration runs tell of it."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, Literal, TypeVar

import numpy as np
import numpy.typing as npt
import pydantic

from core.calibration.accelerometer import AccelerometerPrior, fit_accelerometer
from core.calibration.earth_rate import fit_earth_rate
from core.calibration.fit import TriadFit
from core.calibration.gyroscope import GyroscopeFit, fit_gyroscope
from core.calibration.gyroscope_problem import GyroscopePrior
from core.calibration.magnetometer import MagnetometerFit, MagnetometerPrior, fit_magnetometer
from core.calibration.magnetometer_level import fit_level_magnetometer, heading_turned
from core.calibration.recording import CalibrationRecording, check_alive
from core.calibration.static_intervals import StaticPositions, find_static
from core.calibration.temperature import BiasTemperature, accelerometer_temperature, gyroscope_temperature
from core.earth import STANDARD_GRAVITY_MPS2, gravity_mps2
from core.errors import CoreError, InvalidInputError
from core.measurements import FloatArray
from core.sensors import AXES, triple
from schemas.calibration import Calibration
from service.errors import RecordingError
from service.recordings.calibration_recording import ReadRecording
from service.recordings.csv_tables import Share, untold

Sensor = Literal["accelerometer", "gyroscope", "magnetometer"]
SENSORS: Final[tuple[Sensor, ...]] = ("accelerometer", "gyroscope", "magnetometer")
Choice = Literal["accelerometer", "gyroscope", "magnetometer", "all"]

_Fit = TypeVar("_Fit", TriadFit, GyroscopeFit, MagnetometerFit)

RESIDUAL_MPS2: Final = 0.02
"""Choice: 2 mg; MEMS accelerometers obey their nine parameters to 0.1-1 mg, so beyond it something was wrong."""
SURE_SD: Final = 3.0
"""Standard deviations of a slope from which it is said."""
RESIDUAL_RAD: Final = math.radians(1.5)
"""Choice: integrated turns of some seconds miss gravity by 0.1-0.5 deg with MEMS gyroscopes."""

ASIDE_RAD: Final = math.radians(20.0)
"""Choice: chips on one board lie within 5 deg of each other; further, they are mounted or wired another way."""


@dataclass(frozen=True, slots=True)
class CalibrationOptions:
    """What is to be calibrated and what is known beforehand.

    ``sections_s`` are the static positions, (start, end) in the recording's seconds; without them they are found.
    ``level`` takes the magnetometer's recording to be of a vehicle that drove in circles. ``earth_rate`` fits the
    gyroscope at rest to the Earth's rate, as seed 1 has it, instead of by its turns.
    """

    sensor: Choice = "all"
    gravity_mps2: float | None = None
    place: tuple[float, float] | None = None
    """Latitude, rad, and height above the ellipsoid, m."""
    field_ut: float | None = None
    sections_s: tuple[tuple[float, float], ...] | None = None
    level: bool = False
    earth_rate: bool = False
    accelerometer_prior: AccelerometerPrior = field(default_factory=AccelerometerPrior)
    gyroscope_prior: GyroscopePrior = field(default_factory=GyroscopePrior)
    magnetometer_prior: MagnetometerPrior = field(default_factory=MagnetometerPrior)


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationOutcome:
    """The fits of the sensors that were asked for, in the order of ``SENSORS``, and all that they came from."""

    name: str
    recording: CalibrationRecording
    counts: bool
    gravity_mps2: float
    positions: StaticPositions | None
    accelerometer: TriadFit | None
    """Also where only the gyroscope was asked for: it tells where up is."""
    fits: Mapping[Sensor, TriadFit | GyroscopeFit | MagnetometerFit]
    warnings: tuple[str, ...]
    sensor_warnings: Mapping[Sensor, tuple[str, ...]]
    temperature: Mapping[Sensor, BiasTemperature]
    """How biases followed it, where the recording has it and it changed."""

    def calibration(self) -> Calibration:
        """As ``fuse --calibration`` and the vehicle's settings take it; raises RecordingError if they would not."""
        document: dict[str, Any] = {"warnings": self.warnings}
        for sensor, fit in self.fits.items():
            common = {
                "residual_rms": fit.residual_rms,
                "iterations": fit.iterations,
                "stop": str(fit.stop),
                "observability": {
                    "weak": fit.observability.weak,
                    "condition": fit.observability.condition if math.isfinite(fit.observability.condition) else None,
                    "add": fit.observability.add,
                    "advice": fit.observability.advice,
                },
                "gravity": self.gravity_mps2 if self.positions is not None else None,
                "warnings": self.sensor_warnings.get(sensor, ()),
            }
            if sensor in self.temperature:
                common["temperature"] = dataclasses.asdict(self.temperature[sensor])
            document[sensor] = common | (_iron(fit) if isinstance(fit, MagnetometerFit) else _triad(fit))
        try:
            return Calibration.model_validate(document)
        except pydantic.ValidationError as error:
            first = error.errors(include_url=False)[0]
            where = " ".join(str(part) for part in first["loc"][:2])
            raise RecordingError(
                f"{self.name}: {where} came out as {first['input']!r:.60}, which no sensor has "
                f"({first['msg'].lower()}): are the axes right-handed, the unit as said, and both sensors of one box?"
            ) from error

    @property
    def advice(self) -> tuple[str, ...]:
        """What to record again, by sensor; empty where the recording tells everything."""
        return tuple(f"{sensor}: {fit.observability.advice}" for sensor, fit in self.fits.items() if _weak(fit))


def calibrate(
    read: ReadRecording, options: CalibrationOptions | None = None, progress: Share = untold
) -> CalibrationOutcome:
    """Fit what the options ask for.

    Raises RecordingError or InvalidInputError where a sensor cannot be calibrated; the message says what to record.
    """
    options = CalibrationOptions() if options is None else options
    recording = read.recording
    _check_alive(read)
    asked = _asked(read, options)
    gravity, warnings = _gravity(read, options, asked)
    if read.counts:
        warnings.append("this calibration is of raw counts; a drive in m/s² and rad/s needs one of such a recording")
    fits: dict[Sensor, TriadFit | GyroscopeFit | MagnetometerFit] = {}
    slopes: dict[Sensor, BiasTemperature | None] = {}
    said: dict[Sensor, tuple[str, ...]] = {}
    positions = None if options.level else _positions(read, options)
    progress(0.3)
    triad = None
    if positions is not None and not (options.earth_rate and tuple(asked) == ("gyroscope",)):
        triad = _fit_accelerometer(read, options, positions, gravity)
        progress(0.5)
        if "accelerometer" in asked:
            fits["accelerometer"] = triad
            slopes["accelerometer"] = _slope(lambda: accelerometer_temperature(recording, positions, triad))
            said["accelerometer"] = (*_accelerometer_warnings(triad), *_warmed(slopes["accelerometer"], triad))
    if "gyroscope" in asked and positions is not None:
        turns = _fit_gyroscope(read, options, positions, triad, gravity)
        fits["gyroscope"] = turns
        slopes["gyroscope"] = _slope(lambda: gyroscope_temperature(recording, positions))
        said["gyroscope"] = (*_gyroscope_warnings(turns, triad), *_warmed(slopes["gyroscope"], turns))
        progress(0.8)
    if "magnetometer" in asked and recording.magnetometer is not None:
        field_fit = _naming("magnetometer", options, lambda: _magnetometer(read, options, positions, triad))
        fits["magnetometer"] = field_fit
        said["magnetometer"] = _stopped(field_fit.stop.converged)
    progress(1.0)
    return CalibrationOutcome(
        name=read.name,
        recording=recording,
        counts=read.counts,
        gravity_mps2=gravity,
        positions=positions,
        accelerometer=triad,
        fits=fits,
        warnings=tuple(warnings),
        sensor_warnings=said,
        temperature={sensor: slope for sensor, slope in slopes.items() if slope is not None},
    )


def _check_alive(read: ReadRecording) -> None:
    try:
        check_alive("accelerometer", read.recording.accelerometer)
    except InvalidInputError as error:
        raise RecordingError(f"{read.name}: {error}") from error


def _asked(read: ReadRecording, options: CalibrationOptions) -> tuple[Sensor, ...]:
    present: dict[Sensor, bool] = {
        "accelerometer": True,
        "gyroscope": read.recording.gyroscope is not None,
        "magnetometer": read.recording.magnetometer is not None,
    }
    if options.level:
        if options.sensor not in ("magnetometer", "all") or not present["magnetometer"]:
            raise RecordingError(f"{read.name}: circles on level ground calibrate a magnetometer; expected mx_ut …")
        return ("magnetometer",)
    if options.sensor == "all":
        return tuple(sensor for sensor in SENSORS if present[sensor])
    if not present[options.sensor]:
        raise RecordingError(f"{read.name}: has no {options.sensor}; expected its three columns")
    return (options.sensor,)


def _gravity(read: ReadRecording, options: CalibrationOptions, asked: Sequence[Sensor]) -> tuple[float, list[str]]:
    """Gravity as given, of the given place, of the recording's own place; else the standard's, and a warning."""
    if options.gravity_mps2 is not None:
        return options.gravity_mps2, []
    place = options.place or read.place
    if place is not None:
        return gravity_mps2(*place), []
    if options.level or tuple(asked) == ("magnetometer",):
        return STANDARD_GRAVITY_MPS2, []
    return STANDARD_GRAVITY_MPS2, [
        f"gravity is taken as {STANDARD_GRAVITY_MPS2} m/s²; where it was recorded it may be up to 0.3 % off, and the "
        "accelerometer's scale with it: give --gravity, or --latitude and --height"
    ]


def _positions(read: ReadRecording, options: CalibrationOptions) -> StaticPositions:
    try:
        if options.sections_s is None:
            return find_static(read.recording)
        t_s = read.recording.t_s
        starts, ends = (np.searchsorted(t_s, [one[i] for one in options.sections_s]) for i in range(2))
        return StaticPositions.of(read.recording, starts.astype(np.int64), ends.astype(np.int64))
    except InvalidInputError as error:
        raise RecordingError(f"{read.name}: {error}") from error


def _naming(sensor: Sensor, options: CalibrationOptions, fit: Callable[[], _Fit]) -> _Fit:
    """The fit; where it fails, with the sensor's name, and how to do without it if others were asked for too."""
    try:
        return fit()
    except CoreError as error:
        others = " (--sensor accelerometer calibrates that alone)" if options.sensor == "all" else ""
        left = others if sensor != "accelerometer" else ""
        raise RecordingError(f"{sensor}: {error}{left}") from error


def _fit_accelerometer(
    read: ReadRecording, options: CalibrationOptions, positions: StaticPositions, gravity: float
) -> TriadFit:
    prior = options.accelerometer_prior
    return _naming(
        "accelerometer", options, lambda: fit_accelerometer(positions, gravity, counts=read.counts, prior=prior)
    )


def _fit_gyroscope(
    read: ReadRecording,
    options: CalibrationOptions,
    positions: StaticPositions,
    triad: TriadFit | None,
    gravity: float,
) -> TriadFit:
    """By its turns, or at rest by the Earth's rate as the paper does."""
    prior = options.gyroscope_prior
    if options.earth_rate:
        if read.counts:
            raise RecordingError(f"{read.name}: the Earth's rate tells no scale of counts; expected rad/s")
        return _naming("gyroscope", options, lambda: fit_earth_rate(positions, prior=prior))
    assert triad is not None
    return _naming(
        "gyroscope",
        options,
        lambda: fit_gyroscope(read.recording, positions, triad, gravity, counts=read.counts, prior=prior),
    )


def _magnetometer(
    read: ReadRecording, options: CalibrationOptions, positions: StaticPositions | None, triad: TriadFit | None
) -> MagnetometerFit:
    recording = read.recording
    assert recording.magnetometer is not None
    known = np.isfinite(recording.magnetometer).all(axis=1)
    shown: FloatArray = recording.magnetometer[known]
    prior = options.magnetometer_prior
    if options.level:
        force = recording.accelerometer.mean(axis=0)
        level_up = triple(force / np.linalg.norm(force))
        turned = None
        if recording.gyroscope is not None and not read.counts:
            turned = heading_turned(recording.t_s, recording.gyroscope, level_up)[known]
        return fit_level_magnetometer(shown, level_up, turned, counts=read.counts, prior=prior)
    ups = None
    if positions is not None and triad is not None:
        means = _means(recording.magnetometer, positions)
        up = triad.calibration.correct(positions.mean_accelerometer)
        ups = (means, up / np.linalg.norm(up, axis=1)[:, None])
    return fit_magnetometer(shown, ups, counts=read.counts, field_ut=options.field_ut, prior=prior)


def _means(rows: FloatArray, positions: StaticPositions) -> FloatArray:
    """Means of what is known in each position, (k, 3); NaN where nothing is."""
    found = np.full((len(positions), 3), np.nan)
    for i, (start, end) in enumerate(zip(positions.start, positions.end, strict=True)):
        known: npt.NDArray[np.bool_] = np.asarray(np.isfinite(rows[start:end]).all(axis=1))
        if known.any():
            found[i] = rows[start:end][known].mean(axis=0)
    return found


def _stopped(converged: bool) -> tuple[str, ...]:
    return () if converged else ("the iteration was stopped before it settled: the values may be off",)


def _accelerometer_warnings(fit: TriadFit) -> tuple[str, ...]:
    found = list(_stopped(fit.stop.converged))
    if fit.residual_rms > RESIDUAL_MPS2:
        worst = int(np.argmax(np.abs(fit.residuals)))
        found.append(
            f"gravity is missed by {1e3 * fit.residual_rms:.0f} mm/s² RMS, most in position {worst + 1}: was the box "
            "knocked, warm, or clipped there?"
        )
    return tuple(found)


def _gyroscope_warnings(fit: TriadFit, accelerometer: TriadFit | None) -> tuple[str, ...]:
    found = list(_stopped(fit.stop.converged))
    if not isinstance(fit, GyroscopeFit):
        return tuple(found)
    if fit.left_out:
        turns = "1 turn is" if fit.left_out == 1 else f"{fit.left_out} turns are"
        found.append(f"{turns} not used: clipped, with samples missing, or far from what others say")
    if fit.residual_rms > RESIDUAL_RAD:
        found.append(
            f"turns miss gravity by {math.degrees(fit.residual_rms):.1f}° RMS: turn slower, and let go of the box after"
        )
    turned_rad = math.hypot(*fit.alignment_rad)
    if turned_rad > ASIDE_RAD:
        found.append(
            f"its axes are turned by {math.degrees(turned_rad):.0f}° against the accelerometer's: if it is not mounted "
            "so, axes are swapped or reversed in one of the two (a left-handed triad looks so, too): put them right "
            "and calibrate again"
        )
    if fit.g_sensitivity.any():
        found.append("its bias follows specific force; that is taken out of the fit, and what is written holds without")
    if accelerometer is not None and _weak(accelerometer):
        found.append("the accelerometer, which tells where up is, is not well told itself")
    return tuple(found)


def _slope(find: Callable[[], BiasTemperature | None]) -> BiasTemperature | None:
    """None also where the temperature moved too little to tell."""
    try:
        return find()
    except InvalidInputError:
        return None


def _warmed(slope: BiasTemperature | None, fit: TriadFit) -> tuple[str, ...]:
    """Said where the bias surely moved by more than it is known to."""
    if slope is None:
        return ()
    per_k, span_k = np.abs(slope.slope_per_k), slope.high_c - slope.low_c
    moved = per_k * span_k
    sure = (per_k > SURE_SD * np.array(slope.sd)) & (moved > SURE_SD * fit.sd[6:9])
    if not sure.any():
        return ()
    axes = ", ".join(axis for axis, one in zip(AXES, sure, strict=True) if one)
    return (
        f"its bias follows temperature on {axes}: over {span_k:.0f} K it moved by up to {moved[sure].max():.2g}; it "
        f"holds at {slope.reference_c:.0f} °C: record when the box is as warm as on the road",
    )


def _weak(fit: TriadFit | MagnetometerFit) -> bool:
    return not fit.observability.observable


def _triad(fit: TriadFit) -> dict[str, Any]:
    sd = fit.sd
    spread: dict[str, Any] = {"scale": sd[:3].tolist(), "misalignment": sd[3:6].tolist(), "bias": sd[6:9].tolist()}
    found: dict[str, Any] = {
        "scale": fit.calibration.scale,
        "misalignment": fit.calibration.misalignment,
        "bias": fit.calibration.bias,
        "sd": spread,
        "positions": fit.positions,
    }
    if isinstance(fit, GyroscopeFit):
        found["alignment"] = fit.alignment_rad
        spread["alignment"] = fit.alignment_sd.tolist()
    return found


def _iron(fit: MagnetometerFit) -> dict[str, Any]:
    sd = np.sqrt(np.diag(fit.covariance))
    return {
        "hard_iron": fit.calibration.hard_iron,
        "soft_iron": fit.calibration.soft_iron,
        "field_strength": fit.field_strength,
        "sd": {"hard_iron": sd[:3].tolist(), "soft_iron": sd[3:].reshape(3, 3).tolist()},
    }
