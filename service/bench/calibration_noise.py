"""A sensor that lay still for hours: its noise as ``telefuse noise`` tells it, against what was found of it before."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np

from core.calibration.allan_fit import NoiseTerm
from core.calibration.recording import CalibrationRecording
from core.earth import STANDARD_GRAVITY_MPS2
from core.measurements import FloatArray
from core.sensors import AXES
from service.bench.simulated_outages import Tell
from service.noise import measure_noise
from service.recordings.calibration_recording import ReadRecording
from service.reports.customary import CUSTOMARY

ADIS: Final = "static_adis16405_2h8"
RANDOM_WALK: Final = (2.3, 2.6)
"""Degrees a root hour, of its three axes (issue 4; the recording's own page has 2.34 to 2.61, at 1 s)."""
FLOOR: Final = (26.0, 29.0)
"""Degrees an hour (issue 4): the page's smallest non-overlapping deviations between 10 s and 400 s."""
FLOOR_TAUS_S: Final = (10.0, 20.0, 50.0, 100.0, 200.0, 400.0)


def missing(place: Path) -> list[str]:
    """Recordings that are not there."""
    return [name for name in (ADIS,) if not (place / name).is_dir()]


def measure(place: Path, tell: Tell) -> dict[str, Any]:
    """The gyroscope's random walk and floor by axis, and how far they are outside of what was found before."""
    read = adis16405(place)
    outcome = measure_noise(read, progress=lambda share: tell(100.0 * share, 100.0))
    assert read.recording.gyroscope is not None
    factors = {name: factor for name, (_, factor) in CUSTOMARY["gyroscope"].items()}
    interval_s = 1.0 / read.rate_hz
    axes: dict[str, dict[str, Any]] = {}
    for axis, fit, signal in zip(AXES, outcome.fits["gyroscope"], read.recording.gyroscope.T, strict=True):
        side_by_side = min(non_overlapping(signal, round(tau_s / interval_s)) for tau_s in FLOOR_TAUS_S)
        axes[axis] = {
            "random_walk": _told(fit.random_walk, factors["random_walk"]),
            "floor": None if fit.floor is None else _told(fit.floor, factors["floor"]),
            "floor_tau_s": fit.floor_tau_s,
            "floor_non_overlapping": factors["floor"] * side_by_side,
        }
    walks = [one["random_walk"]["value"] for one in axes.values()]
    floors = [one["floor"] for one in axes.values() if one["floor"] is not None]
    rms = float(np.sqrt(np.mean([one["value"] ** 2 for one in floors]))) if len(floors) == len(axes) else None
    return {
        "duration_s": outcome.duration_s,
        "axes": axes,
        "random_walk_rms": float(np.sqrt(np.mean(np.square(walks)))),
        "random_walk_outside": _outside(walks, RANDOM_WALK),
        "floor_rms": rms,
        "floors_outside": sum(_outside([one["value"]], FLOOR) > 0.0 for one in floors),
        "floors_non_overlapping_outside": sum(
            _outside([one["floor_non_overlapping"]], FLOOR) > 0.0 for one in axes.values()
        ),
        "floor_intervals_outside": len(axes)
        - sum(one["low"] <= FLOOR[1] and one["high"] >= FLOOR[0] for one in floors),
    }


def adis16405(place: Path) -> ReadRecording:
    """The recording, from counts into SI."""
    with np.load(place / ADIS / "adis_16405_imu1.npz") as data:
        rate_hz = float(data["fs_hz"])
        force = data["acc_counts"] * (float(data["acc_g_per_count"]) * STANDARD_GRAVITY_MPS2)
        rate = np.deg2rad(data["gyro_counts"] * float(data["gyro_dps_per_count"]))
    return ReadRecording(ADIS, CalibrationRecording(np.arange(len(rate)) / rate_hz, force, rate), False, rate_hz)


def non_overlapping(signal: FloatArray, count: int) -> float:
    """Allan deviation from averages of ``count`` samples side by side: fewer differences than the overlapping has."""
    averages = signal[: signal.size // count * count].reshape(-1, count).mean(axis=1)
    return float(np.sqrt(0.5 * np.mean(np.square(np.diff(averages)))))


def _told(term: NoiseTerm, factor: float) -> dict[str, float]:
    return {"value": factor * term.value, "low": factor * term.low, "high": factor * term.high}


def _outside(values: list[float], band: tuple[float, float]) -> float:
    """By how much the value farthest outside is so; 0 where none is."""
    return max(0.0, *(max(band[0] - value, value - band[1]) for value in values))
