"""Public calibration recordings, each against what its sensor's maker or another program found of it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Final

import numpy as np

from core.calibration.accelerometer import fit_accelerometer
from core.calibration.fit import TriadFit
from core.calibration.static_intervals import StaticPositions, find_static
from core.earth import STANDARD_GRAVITY_MPS2
from core.measurements import FloatArray
from service.bench.simulated_outages import Tell
from service.recordings.calibration_recording import ReadingOptions, read_recording

PLACE: Final = Path(__file__).resolve().parents[3] / "shared" / "data"
"""Where recordings are looked for when no place is said: beside the checkout."""

XSENS: Final = "calib_xsens_imu_tk"
XSENS_GRAVITY_MPS2: Final = 9.81744
XSENS_FACTORY_GAINS: Final = np.array([415.0, 413.0, 415.0])
"""Counts per m/s2, the maker's calibration (Tedaldi, Pretto & Menegatti 2014)."""

FERRARIS: Final = "calib_ferraris_imucal"
FERRARIS_GRAVITY_MPS2: Final = 9.81
"""What imucal takes where it is told nothing."""
FERRARIS_FACES: Final = ("x_p", "x_a", "y_p", "y_a", "z_p", "z_a")

MPU6050: Final = "calib_mpu6050_arduino"


def missing(place: Path) -> list[str]:
    """Recordings that are not there."""
    return [name for name in (XSENS, FERRARIS, MPU6050) if not (place / name).is_dir()]


def measure(place: Path, tell: Tell) -> dict[str, Any]:
    """Each recording's fit, and how far it is from the others' results."""
    found = {}
    for done, (name, part) in enumerate((("xsens", _xsens), ("ferraris", _ferraris), ("mpu6050", _mpu6050))):
        tell(done, 3)
        found[name] = part(place)
    return found


def imu_tk(file: Path) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Misalignment (3, 3), scale (3,) and bias (3,) of an IMU-TK file: x = T K (raw - b)."""
    values = np.array(file.read_text().split(), dtype=float)
    return values[:9].reshape(3, 3), np.diag(values[9:18].reshape(3, 3)), values[18:]


def _xsens(place: Path) -> dict[str, Any]:
    read = read_recording(place / XSENS / "imu_raw.csv.gz", ReadingOptions(counts=True))
    fit = fit_accelerometer(find_static(read.recording), XSENS_GRAVITY_MPS2, counts=True)
    gains = np.array(fit.calibration.scale)
    _, peer_scale, peer_bias = imu_tk(place / XSENS / "peer_imu_tk_acc.calib")
    return _told(fit) | {
        "off_factory": float(np.abs(gains / XSENS_FACTORY_GAINS - 1.0).max()),
        "off_imu_tk": float(np.abs(gains * peer_scale - 1.0).max()),
        "bias_off_imu_tk_mps2": float(np.abs((np.array(fit.calibration.bias) - peer_bias) / gains).max()),
    }


def _ferraris(place: Path) -> dict[str, Any]:
    """Its six faces alone, as imucal uses them: of the nine parameters they tell scales and biases."""
    read = read_recording(
        place / FERRARIS / "example_ferraris_session.csv.gz",
        ReadingOptions(rate_hz=102.4, accel_unit="mps2", gyro_unit="dps"),
    )
    sections = json.loads((place / FERRARIS / "sections.json").read_text())
    starts, ends = (np.array([sections[face][key] for face in FERRARIS_FACES]) for key in ("start", "end"))
    fit = fit_accelerometer(StaticPositions.of(read.recording, starts, ends), FERRARIS_GRAVITY_MPS2)
    peer = json.loads((place / FERRARIS / "peer_imucal_2.6.0.json").read_text())
    return _told(fit) | {
        "scale_off_imucal": float(np.abs(np.array(fit.calibration.scale) / np.diag(peer["K_a"]) - 1.0).max()),
        "bias_off_imucal_mps2": float(np.abs(np.array(fit.calibration.bias) - peer["b_a"]).max()),
        "positions_found": len(find_static(read.recording)),
    }


def _mpu6050(place: Path) -> dict[str, Any]:
    read = read_recording(place / MPU6050 / "calibration.csv.gz", ReadingOptions(counts=True))
    fit = fit_accelerometer(find_static(read.recording), STANDARD_GRAVITY_MPS2, counts=True)
    return _told(fit) | {"called_observable": int(fit.observability.observable)}


def _told(fit: TriadFit) -> dict[str, Any]:
    return {
        "scale": list(fit.calibration.scale),
        "misalignment": list(fit.calibration.misalignment),
        "bias": list(fit.calibration.bias),
        "sd": fit.sd.tolist(),
        "residual_rms_mps2": fit.residual_rms,
        "positions": fit.positions,
        "iterations": fit.iterations,
        "weak": list(fit.observability.weak),
        "advice": fit.observability.advice,
    }
