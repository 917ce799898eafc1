"""The calibration's figures: its minimiser, simulated units against their truth, recordings against other programs."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from core.calibration.accelerometer import fit_accelerometer
from core.calibration.fit import PARAMETERS, TriadFit
from core.calibration.static_intervals import find_static
from core.earth import STANDARD_GRAVITY_MPS2
from core.measurements import FloatArray
from core.sensors import TriadCalibration
from core.simulation.calibration_recording import simulate_recording
from core.simulation.sensors import UNCALIBRATED, DeviceErrors, draw_errors
from service.bench import calibration_gyroscope, calibration_noise, calibration_recordings, minimiser
from service.bench.calibration_targets import SEED1_TABLE_2, TARGETS
from service.bench.simulated_outages import Tell
from service.bench.stated_spread import over_stated
from service.bench.targets import judged
from service.errors import UsageError

UNITS: Final = 500
REPEATED_UNITS: Final = 20
RECORDINGS: Final = 5
"""As in seed 1, tables 2 and 3: five recordings of each unit, of 5 s a position."""
POSITIONS: Final = 24
TIMED_POSITIONS: Final = 40


def measure(parts: Sequence[str], folder: Path | None, tell: Callable[[str, float, float], None]) -> dict[str, Any]:
    """Figures by part. Without ``parts`` all of them, those from recordings only where these are.

    Raises UsageError where recordings are asked for, by a part or a place, and are not there.
    """
    for part in parts:
        if part not in PART_NAMES:
            raise UsageError(f"--part {part}: expected one of {', '.join(PART_NAMES)}")
    place = calibration_recordings.PLACE if folder is None else folder
    asked = [name for name in PART_NAMES if name in parts or not parts]
    left_out = {name: lacking[0] for name in asked if name in RECORDED and (lacking := RECORDED[name].missing(place))}
    for name, one in left_out.items():
        if folder is not None or name in parts:
            raise UsageError(f"{place}: no '{one}'; say by --recordings where the calibration recordings are")
    found: dict[str, Any] = {}
    for name in asked:
        if name in left_out:
            continue
        told = partial(tell, name)
        found[name] = RECORDED[name].measure(place, told) if name in RECORDED else PARTS[name](told)
    if left_out:
        found["left_out"] = left_out
    return found | {"targets": judged(found, TARGETS)}


def against_truth(tell: Tell, units: int = UNITS) -> dict[str, Any]:
    """Simulated units with the device's whole noise, each recorded once: errors over what is stated of them."""
    ratios, iterations, wrong, weak = [], [], 0, 0
    for seed in range(units):
        tell(seed, units)
        errors, fit = _recorded(seed, np.random.default_rng(seed))
        ratios.append((parameters(fit.calibration) - parameters(errors.accelerometer)) / fit.sd)
        iterations.append(fit.iterations)
        wrong += fit.positions != POSITIONS
        weak += not fit.observability.observable
    return {
        "units": units,
        "positions": POSITIONS,
        **over_stated(ratios, PARAMETERS),
        "iterations_max": max(iterations),
        "wrong_positions": wrong,
        "called_weak": weak,
        "fit_ms": _fit_ms(),
    }


def repeated(tell: Tell, units: int = REPEATED_UNITS) -> dict[str, Any]:
    """Variances of the parameters over five recordings of each unit, beside those of seed 1, table 2; biases in g."""
    variances = []
    for seed in range(units):
        tell(seed, units)
        rows = [_table_2(_recorded(seed, np.random.default_rng([seed, turn]))[1]) for turn in range(RECORDINGS)]
        variances.append(np.var(rows, axis=0, ddof=1))
    largest, mean = np.max(variances, axis=0), np.mean(variances, axis=0)
    return {
        "units": units,
        "recordings": RECORDINGS,
        "variances": {
            name: {"mean": float(mean[i]), "largest": float(largest[i]), "seed1": limit}
            for i, (name, limit) in enumerate(SEED1_TABLE_2.items())
        },
    }


def parameters(calibration: TriadCalibration) -> FloatArray:
    """The nine in the order of ``PARAMETERS``."""
    return np.array([*calibration.scale, *calibration.misalignment, *calibration.bias])


def _recorded(seed: int, generator: np.random.Generator) -> tuple[DeviceErrors, TriadFit]:
    """A unit as it was soldered, by its seed, and what a recording of it tells."""
    errors = draw_errors(UNCALIBRATED, np.random.default_rng([seed]))
    simulated = simulate_recording(
        generator,
        accelerometer=errors.accelerometer,
        gyroscope=errors.gyroscope,
        positions=POSITIONS,
        initial_rest_s=5.0,
    )
    return errors, fit_accelerometer(find_static(simulated.recording), STANDARD_GRAVITY_MPS2)


def _table_2(fit: TriadFit) -> FloatArray:
    """The columns of seed 1, table 2: products SF M, and biases in g, which its text gives in mg."""
    (sx, sy, sz), (mx, my, mz) = fit.calibration.scale, fit.calibration.misalignment
    bias_g = np.array(fit.calibration.bias) / STANDARD_GRAVITY_MPS2
    return np.array([sx, -sx * mz, sx * my, sy, -sy * mx, sz, *bias_g])


def _fit_ms() -> float:
    """Median time of a whole fit of 40 positions, weights and observability included."""
    generator = np.random.default_rng(1)
    errors = draw_errors(UNCALIBRATED, generator)
    simulated = simulate_recording(
        generator, accelerometer=errors.accelerometer, gyroscope=errors.gyroscope, positions=TIMED_POSITIONS
    )
    positions, spent_ms = find_static(simulated.recording), []
    for _ in range(21):
        started_s = time.perf_counter()
        fit_accelerometer(positions, STANDARD_GRAVITY_MPS2)
        spent_ms.append(1e3 * (time.perf_counter() - started_s))
    return float(np.median(spent_ms))


PARTS: Final[dict[str, Callable[[Tell], dict[str, Any]]]] = {
    "minimiser": minimiser.measure,
    "units": against_truth,
    "repeated": repeated,
    "gyroscope": calibration_gyroscope.measure,
}


class Recorded(NamedTuple):
    """A part that needs recordings: which of them are missing from a place, and its figures."""

    missing: Callable[[Path], list[str]]
    measure: Callable[[Path, Tell], dict[str, Any]]


RECORDED: Final[dict[str, Recorded]] = {
    "recordings": Recorded(calibration_recordings.missing, calibration_recordings.measure),
    "noise": Recorded(calibration_noise.missing, calibration_noise.measure),
}
PART_NAMES: Final = (*PARTS, *RECORDED)
