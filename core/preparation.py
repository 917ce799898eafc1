"""The first two stages of a session: raw samples into calibrated body axes, and what is invalid left out."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt
from numba import njit

from core.measurements import FloatArray, Measurements, TimeArray
from core.rotation import matrix_from_rpy
from core.sensors import TriadCalibration

BoolArray = npt.NDArray[np.bool_]

SATURATION_SHARE: Final = 0.995
"""A sample at or above this share of the full scale is taken as clipped: scale errors stay below 0.5 %."""

MAX_FORCE_MPS2: Final = 10_000.0
"""Beyond the end of high-g crash sensors, 2000 to 4000 m/s2."""
MAX_RATE_RADPS: Final = 100.0
"""Beyond the end of MEMS gyroscopes, 70 rad/s."""
LATEST_NS: Final = 1 << 62
"""The year 2116: a later time is damage, and could not be reckoned on from."""


@dataclass(frozen=True, slots=True)
class Mounting:
    """How the box sits: C_b_from_s = Rz(yaw) Ry(pitch) Rx(roll), rad; ``known`` is False for a nominal guess."""

    rpy_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)
    known: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class BodySamples:
    """Calibrated inertial samples in body axes, in increasing time; ``saturated`` (n,) is 1 where clipped."""

    t_ns: TimeArray
    f_b: FloatArray
    omega_b: FloatArray
    saturated: FloatArray


@njit(cache=True, nogil=True)
def _affine(rows: FloatArray, matrix: FloatArray, offset: FloatArray) -> FloatArray:
    """matrix @ row + offset for each row (n, 3), with the same operations for each however many there are."""
    out = np.empty((rows.shape[0], 3))
    m00, m01, m02 = matrix[0, 0], matrix[0, 1], matrix[0, 2]
    m10, m11, m12 = matrix[1, 0], matrix[1, 1], matrix[1, 2]
    m20, m21, m22 = matrix[2, 0], matrix[2, 1], matrix[2, 2]
    o0, o1, o2 = offset[0], offset[1], offset[2]
    for k in range(rows.shape[0]):
        a, b, c = rows[k, 0], rows[k, 1], rows[k, 2]
        out[k, 0] = m00 * a + m01 * b + m02 * c + o0
        out[k, 1] = m10 * a + m11 * b + m12 * c + o1
        out[k, 2] = m20 * a + m21 * b + m22 * c + o2
    return out


@njit(cache=True, nogil=True)
def _saturated(rows: FloatArray, limit: float) -> FloatArray:
    out = np.zeros(rows.shape[0])
    for k in range(rows.shape[0]):
        if abs(rows[k, 0]) >= limit or abs(rows[k, 1]) >= limit or abs(rows[k, 2]) >= limit:
            out[k] = 1.0
    return out


@njit(cache=True, nogil=True)
def valid_samples(t_ns: TimeArray, f_s: FloatArray, omega_s: FloatArray, last_ns: int) -> tuple[BoolArray, int, int]:
    """Which samples to use (n,), how many were late, how many not finite or out of any sensor's range."""
    keep = np.zeros(t_ns.shape[0], np.bool_)
    late, broken = 0, 0
    for k in range(t_ns.shape[0]):
        if t_ns[k] <= last_ns:
            late += 1
            continue
        sound = t_ns[k] <= LATEST_NS
        for i in range(3):  # False too for what is not a number
            sound &= abs(f_s[k, i]) <= MAX_FORCE_MPS2 and abs(omega_s[k, i]) <= MAX_RATE_RADPS
        if not sound:
            broken += 1
            continue
        keep[k] = True
        last_ns = t_ns[k]
    return keep, late, broken


class Preparation:
    """Calibration and mounting as one affine map a triad, then validity: in range, and later than all before."""

    def __init__(
        self,
        accelerometer: TriadCalibration,
        gyroscope: TriadCalibration,
        mounting: Mounting,
        accel_full_scale_mps2: float,
    ) -> None:
        self.C_b_from_s = matrix_from_rpy(*mounting.rpy_rad)
        self._accel = self._map(accelerometer)
        self._gyro = self._map(gyroscope)
        self._full_scale_mps2 = accel_full_scale_mps2

    def _map(self, calibration: TriadCalibration) -> tuple[FloatArray, FloatArray]:
        offset = calibration.correct(np.zeros((1, 3)))[0]
        matrix = (calibration.correct(np.eye(3)) - offset).T
        return self.C_b_from_s @ matrix, self.C_b_from_s @ offset

    def step(self, raw: Measurements, last_ns: int, counts: dict[str, int]) -> BodySamples:
        """Calibrated samples later than ``last_ns``; what is left out is added to ``counts``."""
        t_ns, f_s, omega_s = raw.imu_t_ns, raw.f_s, raw.omega_s
        keep, late, broken = valid_samples(t_ns, f_s, omega_s, last_ns)
        if late or broken:
            t_ns, f_s, omega_s = t_ns[keep], f_s[keep], omega_s[keep]
            for outcome, count in (("rejected_time", late), ("rejected_range", broken)):
                if count:
                    counts[f"imu.{outcome}"] = counts.get(f"imu.{outcome}", 0) + count
        full_scale = raw.accel_full_scale_mps2 if math.isnan(self._full_scale_mps2) else self._full_scale_mps2
        limit = math.inf if math.isnan(full_scale) else SATURATION_SHARE * full_scale
        return BodySamples(t_ns, _affine(f_s, *self._accel), _affine(omega_s, *self._gyro), _saturated(f_s, limit))

    def magnetic_b_ut(self, magnetic_s_ut: FloatArray) -> FloatArray:
        """Magnetic field (n, 3) turned into body axes."""
        return _affine(magnetic_s_ut, self.C_b_from_s, np.zeros(3))
