"""Noise of a box's sensors from a recording at rest: what the command and its report tell of it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import pydantic

from core.calibration.allan_fit import AllanAnalysis, AllanFit, AllanSettings, NoiseTerm
from core.calibration.longest_rest import longest_rest
from core.calibration.recording import CalibrationRecording
from core.calibration.temperature import LEAST_RANGE_K
from core.measurements import FloatArray
from core.sensors import AXES, TriadCalibration
from schemas.calibration import Calibration
from schemas.vehicles import NoiseRecording, SensorNoise
from service.errors import RecordingError
from service.recordings.calibration_recording import ReadRecording
from service.recordings.csv_tables import Share, untold

TERMS: Final = ("random_walk", "bias_instability", "rate_random_walk")
SENSORS: Final = ("accelerometer", "gyroscope")
_COARSE_STEPS: Final = 0.5
"""Noise below half a converter's step is not passed on as noise: rounding is then no longer random (Widrow 1956)."""


@dataclass(frozen=True, slots=True, eq=False)
class NoiseOutcome:
    """Fits of each axis of each sensor, the part of the recording that they come from, and what to know of them."""

    name: str
    start_s: float
    duration_s: float
    rate_hz: float
    fits: Mapping[str, tuple[AllanFit, AllanFit, AllanFit]]
    warnings: tuple[str, ...]

    def settings(self) -> SensorNoise:
        """The block that ``fuse`` and the vehicle's settings take; raises RecordingError if no sensor is so noisy."""
        document: dict[str, Any] = {
            "recording": NoiseRecording(
                duration_s=self.duration_s, rate_hz=self.rate_hz, warnings=self.warnings
            ).model_dump()
        }
        for sensor, fits in self.fits.items():
            terms: dict[str, Any] = {name: _values(fits, name) for name in TERMS}
            intervals: dict[str, Any] = {name: [_interval(getattr(fit, name)) for fit in fits] for name in TERMS}
            if all(fit.floor is not None for fit in fits):
                terms["floor"] = [fit.floor.value for fit in fits if fit.floor is not None]
                intervals["floor"] = [_interval(fit.floor) for fit in fits if fit.floor is not None]
            document[sensor] = terms | {"interval95": intervals}
        try:
            return SensorNoise.model_validate(document)
        except pydantic.ValidationError as error:
            first = error.errors(include_url=False)[0]
            sensor, term, *axis = (str(part) for part in first["loc"])
            where = f"{term.replace('_', ' ')} of the {sensor}" + (f", axis {AXES[int(axis[0])]}" if axis else "")
            raise RecordingError(
                f"{self.name}: {where} is {first['input']:.3g} (SI): more than any box's sensor has "
                f"({first['msg'].lower()}); is the unit another, or was the box not at rest?"
            ) from error


def measure_noise(
    read: ReadRecording, calibration: Calibration | None = None, progress: Share = untold
) -> NoiseOutcome:
    """Noise of the longest stretch at rest; raises InvalidInputError or RecordingError if there is none."""
    recording = calibrated(read, calibration)
    rest = longest_rest(recording)
    rows = slice(rest.first, rest.end)
    t_s = recording.t_s[rows]
    interval_s = float(t_s[-1] - t_s[0]) / (t_s.size - 1)
    analysis = AllanAnalysis(t_s.size, interval_s)
    warnings = _cut(read, rest.moving_s, rest.gaps, float(t_s[0]), float(t_s[-1]))
    fits: dict[str, tuple[AllanFit, AllanFit, AllanFit]] = {}
    triads = {"accelerometer": recording.accelerometer, "gyroscope": recording.gyroscope}
    present = {sensor: values for sensor, values in triads.items() if values is not None}
    for number, (sensor, values) in enumerate(present.items()):
        found = []
        for axis in range(3):
            signal = np.ascontiguousarray(values[rows, axis])
            if not np.ptp(signal) > 0.0:
                raise RecordingError(
                    f"{read.name}: {sensor} {AXES[axis]} never changes: a dead axis, or too coarse a converter"
                )
            warnings += _coarse(f"{sensor} {AXES[axis]}", signal)
            found.append(analysis.fit(signal))
            progress((3 * number + axis + 1) / (3 * len(present)))
        fits[sensor] = (found[0], found[1], found[2])
        warnings += _unresolved(sensor, found, t_s.size * interval_s)
        warnings += _misfit(sensor, found)
    warnings += _warmed(None if recording.temperature_c is None else recording.temperature_c[rows])
    return NoiseOutcome(read.name, float(t_s[0]), t_s.size * interval_s, 1.0 / interval_s, fits, tuple(warnings))


def calibrated(read: ReadRecording, calibration: Calibration | None) -> CalibrationRecording:
    """The recording in m/s2 and rad/s; counts need a calibration, of each sensor that is there."""
    recording = read.recording
    if calibration is None:
        if read.counts:
            raise RecordingError(f"{read.name}: counts need --calibration FILE that makes m/s² and rad/s of them")
        return recording
    triads: dict[str, Any] = {"accelerometer": recording.accelerometer, "gyroscope": recording.gyroscope}
    for sensor in SENSORS:
        known = getattr(calibration, sensor)
        if triads[sensor] is None:
            continue
        if known is None:
            if read.counts:
                raise RecordingError(f"{read.name}: the calibration has no {sensor}, whose counts need one")
            continue
        triads[sensor] = TriadCalibration(known.scale, known.misalignment, known.bias).correct(triads[sensor])
    return CalibrationRecording(
        recording.t_s, triads["accelerometer"], triads["gyroscope"], recording.magnetometer, recording.temperature_c
    )


def _values(fits: Sequence[AllanFit], name: str) -> list[float] | None:
    """Strengths of the axes; null where the recording shows it on none, so that the filter keeps its own."""
    terms: list[NoiseTerm] = [getattr(fit, name) for fit in fits]
    if not any(term.resolved for term in terms):
        return None
    # A sensor with no white noise does not exist: where it is not seen, what may hide is taken.
    return [term.value if term.resolved or name != "random_walk" else term.high for term in terms]


def _interval(term: NoiseTerm) -> tuple[float, float]:
    return term.low, term.high


def _cut(read: ReadRecording, moving_s: float, gaps: int, start_s: float, end_s: float) -> list[str]:
    t_s = read.recording.t_s
    lost_s = float(t_s[-1] - t_s[0]) - (end_s - start_s)
    if lost_s * read.rate_hz < 1.5:
        return []
    reasons = [f"the box moved in {moving_s:.0f} s"] if moving_s > 0.0 else []
    reasons += [f"samples are missing in {gaps} places"] if gaps else []
    return [
        f"{' and '.join(reasons)}: only the longest rest is used, {start_s:.1f} s to {end_s:.1f} s, "
        f"{100.0 * (end_s - start_s) / float(t_s[-1] - t_s[0]):.1f} % of the recording"
    ]


def _coarse(name: str, signal: np.ndarray[Any, np.dtype[np.float64]]) -> list[str]:
    steps = np.diff(np.unique(signal))
    step = float(steps.min()) if steps.size else 0.0
    # A float's own grain is no step.
    if step < 1e-9 * float(np.abs(signal).max()) or np.std(np.diff(signal)) / math.sqrt(2.0) > _COARSE_STEPS * step:
        return []
    return [
        f"{name}: its noise is below half of its converter's step ({step:.3g}): figures may be off; "
        "record in a finer range"
    ]


def _unresolved(sensor: str, fits: Sequence[AllanFit], duration_s: float) -> list[str]:
    found = []
    for name in TERMS[1:]:
        axes = [axis for axis, fit in zip(AXES, fits, strict=True) if not getattr(fit, name).resolved]
        if not axes:
            continue
        kept = "; the filter keeps its own value" if len(axes) == len(AXES) else ""
        which = f"{sensor} {', '.join(axes)}"
        found.append(
            f"{which}: {duration_s / 3600.0:.2g} h are too short to tell {name.replace('_', ' ')} from none; the "
            f"interval's upper end is what it may be{kept}"
        )
    return found


def _warmed(temperature_c: FloatArray | None) -> list[str]:
    """Said where the slow noises hold what warmth did to the bias."""
    if temperature_c is None or not np.isfinite(temperature_c).any():
        return []
    warmed = float(np.nanmax(temperature_c) - np.nanmin(temperature_c))
    if warmed < LEAST_RANGE_K:
        return []
    return [f"the temperature changed by {warmed:.1f} K: the slow noises hold what that does to the biases"]


def _misfit(sensor: str, fits: Sequence[AllanFit]) -> list[str]:
    axes = [axis for axis, fit in zip(AXES, fits, strict=True) if fit.excess_sd > AllanSettings().excess_sd]
    if not axes:
        return []
    worst = 50.0 * max(fit.excess_sd for fit in fits)
    return [
        f"{sensor} {', '.join(axes)}: its Allan deviation is off the fit by some {worst:.0f} % of itself beyond chance "
        "(vibration, cycles or warmth); the intervals are wider for it"
    ]


def told(term: NoiseTerm | None, factor: float) -> str:
    """A noise with its interval; what it may be at most where it is not seen."""
    if term is None:
        return "not reached"
    if not term.resolved:
        return f"below {factor * term.high:.3g}"
    return f"{factor * term.value:.4g} ({factor * term.low:.3g} to {factor * term.high:.3g})"
