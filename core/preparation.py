"""The first stages of a session: raw samples into calibrated body axes, and what is invalid left out.

Where the mounting is not given, ``FoundMounting`` turns the samples on into the axes that it has found by then.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt
from numba import njit

from core.box_clock import LATEST_NS
from core.full_scale import FullScale
from core.held_axes import HeldAxes
from core.measurements import FloatArray, Measurements, TimeArray
from core.navigation.admission import usable_fixes
from core.navigation.aids import Aids, Series
from core.navigation.alignment import Start
from core.navigation.mounting import MountingFinder
from core.past import BodySamples, Past
from core.rotation import matrix_from_rpy
from core.sensors import MagnetometerCalibration, TriadCalibration

BoolArray = npt.NDArray[np.bool_]

MAX_FORCE_MPS2: Final = 10_000.0
"""Beyond the end of high-g crash sensors, 2000 to 4000 m/s2."""
MAX_RATE_RADPS: Final = 100.0
"""Beyond the end of MEMS gyroscopes, 70 rad/s."""


@dataclass(frozen=True, slots=True)
class Mounting:
    """How the box sits: C_b_from_s = Rz(yaw) Ry(pitch) Rx(roll), rad; ``known`` is False for a nominal guess."""

    rpy_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)
    known: bool = False


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


def with_valid_samples(raw: Measurements, last_ns: int, counts: dict[str, int]) -> Measurements:
    """Without inertial samples that are not later than ``last_ns`` or no sensor's; they are added to ``counts``."""
    keep, late, broken = valid_samples(raw.imu_t_ns, raw.f_s, raw.omega_s, last_ns)
    if not (late or broken):
        return raw
    for outcome, count in (("rejected_time", late), ("rejected_range", broken)):
        if count:
            counts[f"imu.{outcome}"] = counts.get(f"imu.{outcome}", 0) + count
    return replace(raw, imu_t_ns=raw.imu_t_ns[keep], f_s=raw.f_s[keep], omega_s=raw.omega_s[keep])


class Preparation:
    """Calibration and mounting as one affine map a triad: ``accel_map`` and ``gyro_map``, matrix and offset.

    What was learnt of the raw readings is taken over from the one ``before``.
    """

    def __init__(
        self,
        accelerometer: TriadCalibration,
        gyroscope: TriadCalibration,
        mounting: Mounting,
        accel_full_scale_mps2: float,
        magnetometer: MagnetometerCalibration | None = None,
        before: Preparation | None = None,
    ) -> None:
        self.C_b_from_s = matrix_from_rpy(*mounting.rpy_rad)
        self.accel_map = self._map(accelerometer)
        self.gyro_map = self._map(gyroscope)
        self._magnetic_map = self._map(MagnetometerCalibration() if magnetometer is None else magnetometer)
        self._full_scale_mps2 = accel_full_scale_mps2
        self.held: HeldAxes = HeldAxes() if before is None else before.held
        self.full_scale: FullScale = FullScale() if before is None else before.full_scale

    def _map(self, calibration: TriadCalibration | MagnetometerCalibration) -> tuple[FloatArray, FloatArray]:
        offset = calibration.correct(np.zeros((1, 3)))[0]
        matrix = (calibration.correct(np.eye(3)) - offset).T
        return self.C_b_from_s @ matrix, self.C_b_from_s @ offset

    def step(self, raw: Measurements) -> BodySamples:
        """Calibrated samples of valid ones."""
        t_ns, f_s, omega_s = raw.imu_t_ns, raw.f_s, raw.omega_s
        stated = raw.accel_full_scale_mps2 if math.isnan(self._full_scale_mps2) else self._full_scale_mps2
        f_b, omega_b = _affine(f_s, *self.accel_map), _affine(omega_s, *self.gyro_map)
        return BodySamples(t_ns, f_b, omega_b, self.full_scale.step(f_s, stated), self.held.step(omega_s))

    def sensed(self, bias_b: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Biases left in b, accelerometer then gyroscope (6,), with those removed already: as the sensors show them,
        and their sd."""
        bias, sd = np.empty(6), np.empty(6)
        for begin, (matrix, offset) in ((0, self.accel_map), (3, self.gyro_map)):
            part, back = slice(begin, begin + 3), np.linalg.inv(matrix)
            bias[part] = back @ (bias_b[part] - offset)
            sd[part] = np.sqrt(np.maximum(np.diag(back @ covariance[part, part] @ back.T), 0.0))
        return bias, sd

    def magnetic_b_ut(self, magnetic_s_ut: FloatArray) -> FloatArray:
        """Magnetic field (n, 3) without the box's iron, turned into body axes."""
        return _affine(magnetic_s_ut, *self._magnetic_map)


@dataclass(frozen=True, slots=True, eq=False)
class Turn:
    """Other body axes from ``t_ns`` on: their rotation, and the recent past in them, for an alignment.

    Where these axes were found, ``past`` is all of the last minute in them.
    """

    C_new_from_old: FloatArray
    t_ns: int
    imu: Series
    gnss: Series
    past: tuple[BodySamples, Aids] | None


class FoundMounting:
    """Cuts samples at whole seconds, and turns them into the body axes that were found by then."""

    def __init__(self, par: FloatArray, gnss_time_offset_s: float) -> None:
        self.finder = MountingFinder()
        self._past = Past()
        self._par = par
        self._offset_ns = round(gnss_time_offset_s * 1e9)

    @property
    def start(self) -> Start:
        """When the filter may start: a wrong heading is found in motion, but a magnetic one would be believed."""
        if self.finder.agreed:
            return Start.AT_REST_TOO
        return Start.IN_MOTION if self.finder.undisputed else Start.NEVER

    def step(self, samples: BodySamples, aids: Aids) -> Iterator[tuple[Turn | None, BodySamples, Aids]]:
        """Samples and aids in nominal axes, cut at whole seconds into parts in body axes; a turn precedes its part."""
        finder, begin, turn = self.finder, 0, None
        while True:
            boundary_ns, end = 0, len(samples.t_ns)
            if begin < end:
                boundary_ns = finder.boundary_ns(int(samples.t_ns[begin]))
                end = int(np.searchsorted(samples.t_ns, boundary_ns))
            last = end == len(samples.t_ns)
            now, aids = (aids, aids) if last else _cut(aids, boundary_ns)
            part = slice(begin, end)
            t_ns, f_m, omega_m = samples.t_ns[part], samples.f_b[part], samples.omega_b[part]
            usable = usable_fixes(now.gnss[1], self._par)
            finder.add(t_ns, f_m, omega_m, (now.gnss[0][usable] + self._offset_ns, now.gnss[1][usable]))
            in_m = BodySamples(t_ns, f_m, omega_m, samples.saturated[part], samples.held[part])
            if not finder.settled:
                self._past.add(in_m, now)
            yield turn, *self._turned(in_m, now)
            if last:
                return
            begin = end
            found = finder.evaluate(int(samples.t_ns[end]))
            turn = None
            if found is not None:
                imu_t_ns, imu, gnss_t_ns, gnss = finder.recent()
                rows = np.hstack([self._turned_rows(imu[:, :3]), self._turned_rows(imu[:, 3:])])
                past = None if finder.contradicted else self._turned(*self._past.joined())
                turn = Turn(found, boundary_ns, (imu_t_ns, rows), (gnss_t_ns, gnss), past)
            if finder.settled:
                self._past.forget()
            else:
                self._past.trim(boundary_ns)

    def arrays(self) -> dict[str, npt.NDArray[np.generic]]:
        """State by name, for snapshots."""
        return self.finder.arrays() | {f"past.{name}": value for name, value in self._past.arrays().items()}

    def load(self, arrays: dict[str, npt.NDArray[np.generic]]) -> None:
        """Take over what ``arrays`` gave."""
        self.finder.load(arrays)
        self._past.load({name[5:]: value for name, value in arrays.items() if name.startswith("past.")})

    def _turned(self, samples: BodySamples, aids: Aids) -> tuple[BodySamples, Aids]:
        if not self.finder.found:
            return samples, aids
        magnetic_t_ns, magnetic_m = aids.magnetic_b_ut
        return (
            replace(samples, f_b=self._turned_rows(samples.f_b), omega_b=self._turned_rows(samples.omega_b)),
            replace(aids, magnetic_b_ut=(magnetic_t_ns, self._turned_rows(magnetic_m))),
        )

    def _turned_rows(self, rows_m: FloatArray) -> FloatArray:
        return _affine(np.ascontiguousarray(rows_m), self.finder.C_b_from_m, np.zeros(3))


def _cut(aids: Aids, t_ns: int) -> tuple[Aids, Aids]:
    """Aids before a time, and the others, each in their order."""
    parts = []
    for times, rows in (aids.gnss, aids.magnetic_b_ut, aids.speed, aids.pressure_pa):
        before = times < t_ns
        parts.append(((times[before], rows[before]), (times[~before], rows[~before])))
    return Aids(*(before for before, _ in parts)), Aids(*(after for _, after in parts))
