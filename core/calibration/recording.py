"""A recording of a box for calibration: samples in its sensors' axes, in whatever unit its converters give."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from core.errors import InvalidInputError
from core.measurements import FloatArray
from core.sensors import AXES


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationRecording:
    """Samples of a box that is held in one position after another, or left at rest; sensor axes.

    Parameters
    ----------
    t_s : (n,) increasing
    accelerometer : (n, 3) m/s2, or counts
    gyroscope : (n, 3) rad/s, or counts; None where there is none
    magnetometer : (n, 3) microtesla, or counts; rows of NaN between its samples; None where there is none
    temperature_c : (n,) degrees Celsius; None where there is none

    Raises
    ------
    InvalidInputError
        If shapes do not agree, a time or an inertial value is not finite, or time does not increase;
        the message names the row.
    """

    t_s: FloatArray
    accelerometer: FloatArray
    gyroscope: FloatArray | None = None
    magnetometer: FloatArray | None = None
    temperature_c: FloatArray | None = None

    def __post_init__(self) -> None:
        rows = self.t_s.shape[0]
        for name, values in (
            ("accelerometer", self.accelerometer),
            ("gyroscope", self.gyroscope),
            ("magnetometer", self.magnetometer),
        ):
            if values is not None and values.shape != (rows, 3):
                raise InvalidInputError(f"{name} has shape {values.shape}; expected {(rows, 3)}, a row a time")
        if self.temperature_c is not None and self.temperature_c.shape != (rows,):
            raise InvalidInputError(f"temperature has shape {self.temperature_c.shape}; expected {(rows,)}")
        for name, values in (
            ("time", self.t_s),
            ("accelerometer", self.accelerometer),
            ("gyroscope", self.gyroscope),
        ):
            if values is None:
                continue
            broken = ~np.isfinite(values.reshape(rows, -1)).all(axis=1)
            if broken.any():
                row = int(np.argmax(broken))
                raise InvalidInputError(f"{name} in row {row + 1} of {rows} is not a number; record it again or cut it")
        back = np.diff(self.t_s) <= 0.0
        if back.any():
            row = int(np.argmax(back)) + 1
            raise InvalidInputError(
                f"time runs backwards or stands still in row {row + 1}: {self.t_s[row]:g} s after "
                f"{self.t_s[row - 1]:g} s; record again with a clock that only goes on"
            )


def check_alive(sensor: str, shown: FloatArray) -> None:
    """Raise InvalidInputError if an axis of a triad (n, 3) never changes."""
    for axis, name in enumerate(AXES):
        if np.ptp(shown[:, axis]) == 0.0:
            raise InvalidInputError(
                f"the {sensor}'s {name} axis shows {shown[0, axis] + 0.0:g} throughout: it is dead or not connected; "
                "record again when all three axes answer"
            )
