"""What one packet measured, in SI units and sensor axes: the input of a session."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Final

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
TimeArray = npt.NDArray[np.int64]

GNSS_COLUMNS: Final = (
    "lat_rad",
    "lon_rad",
    "alt_m",
    "vn_mps",
    "ve_mps",
    "vd_mps",
    "speed_mps",
    "course_rad",
    "sd_h_m",
    "sd_v_m",
    "sd_v_mps",
    "hdop",
    "vdop",
    "satellites",
    "fix",
)
"""Columns of a GNSS row; NaN where the receiver does not say. ``fix`` is 0 none, 2 2-D, 3 3-D."""

GNSS: Final = {name: index for index, name in enumerate(GNSS_COLUMNS)}

FLAG_AIRBAG: Final = 1
FLAG_POWER_LOSS: Final = 2
FLAG_TOW: Final = 4


def _no_times() -> TimeArray:
    return np.empty(0, dtype=np.int64)


def _no_rows(columns: int) -> FloatArray:
    return np.empty((0, columns))


@dataclass(frozen=True, slots=True, eq=False)
class Measurements:
    """Samples of one vehicle over one span of time, each series in increasing time.

    Parameters
    ----------
    imu_t_ns : (n,) int64
        Time of each inertial sample, UTC nanoseconds.
    f_s : (n, 3) float64
        Specific force in sensor axes, m/s2.
    omega_s : (n, 3) float64
        Angular rate in sensor axes, rad/s.
    gnss_t_ns, gnss : (m,) int64, (m, len(GNSS_COLUMNS)) float64
        Fixes; see ``GNSS_COLUMNS``.
    magnetometer_t_ns, magnetic_s_ut : (k,) int64, (k, 3) float64
        Magnetic field in sensor axes, microtesla.
    speed_t_ns, speed_mps : (l,) int64, (l,) float64
        Wheel or CAN speed, m/s.
    barometer_t_ns, pressure_pa : (b,) int64, (b,) float64
        Air pressure at the box, Pa.
    temperature_c : float
        Temperature of the box, NaN if unknown.
    ignition : bool or None
        None if unknown.
    accel_full_scale_mps2 : float
        Where the accelerometer clips, NaN if unknown.
    flags : int
        Bits ``FLAG_AIRBAG``, ``FLAG_POWER_LOSS``, ``FLAG_TOW``.
    """

    imu_t_ns: TimeArray = field(default_factory=_no_times)
    f_s: FloatArray = field(default_factory=lambda: _no_rows(3))
    omega_s: FloatArray = field(default_factory=lambda: _no_rows(3))
    gnss_t_ns: TimeArray = field(default_factory=_no_times)
    gnss: FloatArray = field(default_factory=lambda: _no_rows(len(GNSS_COLUMNS)))
    magnetometer_t_ns: TimeArray = field(default_factory=_no_times)
    magnetic_s_ut: FloatArray = field(default_factory=lambda: _no_rows(3))
    speed_t_ns: TimeArray = field(default_factory=_no_times)
    speed_mps: FloatArray = field(default_factory=lambda: np.empty(0))
    barometer_t_ns: TimeArray = field(default_factory=_no_times)
    pressure_pa: FloatArray = field(default_factory=lambda: np.empty(0))
    temperature_c: float = float("nan")
    accel_full_scale_mps2: float = float("nan")
    ignition: bool | None = None
    flags: int = 0

    def between(self, low_ns: int, high_ns: int) -> Measurements:
        """What was measured from ``low_ns`` up to but without ``high_ns``; the arrays are views."""

        def cut(t_ns: TimeArray) -> slice:
            return slice(*(int(i) for i in np.searchsorted(t_ns, [low_ns, high_ns])))

        imu, gnss = cut(self.imu_t_ns), cut(self.gnss_t_ns)
        magnetic, speed, barometer = cut(self.magnetometer_t_ns), cut(self.speed_t_ns), cut(self.barometer_t_ns)
        return replace(
            self,
            imu_t_ns=self.imu_t_ns[imu],
            f_s=self.f_s[imu],
            omega_s=self.omega_s[imu],
            gnss_t_ns=self.gnss_t_ns[gnss],
            gnss=self.gnss[gnss],
            magnetometer_t_ns=self.magnetometer_t_ns[magnetic],
            magnetic_s_ut=self.magnetic_s_ut[magnetic],
            speed_t_ns=self.speed_t_ns[speed],
            speed_mps=self.speed_mps[speed],
            barometer_t_ns=self.barometer_t_ns[barometer],
            pressure_pa=self.pressure_pa[barometer],
        )


SERIES: Final[Mapping[str, tuple[str, ...]]] = MappingProxyType(
    {
        "imu": ("imu_t_ns", "f_s", "omega_s"),
        "gnss": ("gnss_t_ns", "gnss"),
        "magnetometer": ("magnetometer_t_ns", "magnetic_s_ut"),
        "speed": ("speed_t_ns", "speed_mps"),
        "barometer": ("barometer_t_ns", "pressure_pa"),
    }
)
"""Fields of ``Measurements`` that go together: the times of a series, then its rows."""
