"""The error model of a triad: measured = SF M C X + B + w, its inverse (seed 1, eq. 1-4), and the noise w."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from core.errors import InvalidInputError
from core.measurements import FloatArray
from core.rotation import matrix_from_rotation_vector

Triple = tuple[float, float, float]

AXES: Final = ("x", "y", "z")
"""Names of a triad's axes."""

ALLAN_FLOOR: Final = math.sqrt(2.0 * math.log(2.0) / math.pi)
"""Floor of the Allan deviation over the bias instability that it stands for, 0.664 (IEEE Std 952-1997, C.1.3)."""


def triple(values: FloatArray) -> Triple:
    """Three values (3,) as plain numbers."""
    return float(values[0]), float(values[1]), float(values[2])


@dataclass(frozen=True, slots=True)
class TriadCalibration:
    """The nine parameters of a triad of accelerometers or gyroscopes, and the axes that it is mounted in.

    SF is diagonal with ``scale``; M is unit upper triangular with rows (1, -Mz, My), (0, 1, -Mx),
    (0, 0, 1); C turns the box's axes, which are the accelerometer's, into the triad's. The default is a perfect triad.

    Parameters
    ----------
    scale : three floats
        Diagonal of SF: measured over true, dimensionless, not zero.
    misalignment : three floats
        Mx, My, Mz, rad.
    bias : three floats
        B, in the unit of the triad (m/s2 or rad/s).
    alignment : three floats
        Rotation vector of C, rad; that of a gyroscope is found beside its nine. None is the default, and an
        accelerometer's.

    Raises
    ------
    InvalidInputError
        If a value is not finite or a scale is zero.
    """

    scale: Triple = (1.0, 1.0, 1.0)
    misalignment: Triple = (0.0, 0.0, 0.0)
    bias: Triple = (0.0, 0.0, 0.0)
    alignment: Triple = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        for name in ("scale", "misalignment", "bias", "alignment"):
            values = getattr(self, name)
            if len(values) != 3 or not all(math.isfinite(value) for value in values):
                raise InvalidInputError(f"calibration {name} is {values}; expected three finite numbers")
        if 0.0 in self.scale:
            raise InvalidInputError(f"calibration scale is {self.scale}; expected no zero, 1 is a perfect axis")

    def apply(self, true: FloatArray) -> FloatArray:
        """What the triad shows, without noise, of true values (n, 3), each row by itself."""
        if any(self.alignment):
            true = _turned(true, matrix_from_rotation_vector(np.array(self.alignment)))
        x, y, z = true[:, 0], true[:, 1], true[:, 2]
        mx, my, mz = self.misalignment
        measured = np.empty((true.shape[0], 3))
        measured[:, 0] = self.scale[0] * (x - mz * y + my * z) + self.bias[0]
        measured[:, 1] = self.scale[1] * (y - mx * z) + self.bias[1]
        measured[:, 2] = self.scale[2] * z + self.bias[2]
        return measured

    def correct(self, measured: FloatArray) -> FloatArray:
        """The values that the triad saw, in the box's axes: (SF M C)^-1 (measured - B), (n, 3)."""
        mx, my, mz = self.misalignment
        true = np.empty((measured.shape[0], 3))
        true[:, 2] = (measured[:, 2] - self.bias[2]) / self.scale[2]
        true[:, 1] = (measured[:, 1] - self.bias[1]) / self.scale[1] + mx * true[:, 2]
        true[:, 0] = (measured[:, 0] - self.bias[0]) / self.scale[0] + mz * true[:, 1] - my * true[:, 2]
        if any(self.alignment):
            true = _turned(true, matrix_from_rotation_vector(-np.array(self.alignment)))
        return true


@dataclass(frozen=True, slots=True)
class MagnetometerCalibration:
    """Hard and soft iron: measured = soft_iron @ field + hard_iron. The default is a perfect magnetometer.

    Parameters
    ----------
    hard_iron : three floats, microtesla, or counts where the magnetometer shows counts
    soft_iron : three rows; dimensionless, or counts per microtesla; leads from the box's axes to the sensor's

    Raises
    ------
    InvalidInputError
        If a value is not finite or the soft iron has no inverse.
    """

    hard_iron: Triple = (0.0, 0.0, 0.0)
    soft_iron: tuple[Triple, Triple, Triple] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))

    def __post_init__(self) -> None:
        matrix, offset = np.array(self.soft_iron, dtype=float), np.array(self.hard_iron, dtype=float)
        if matrix.shape != (3, 3) or offset.shape != (3,) or not np.isfinite([*matrix.flat, *offset]).all():
            raise InvalidInputError(
                f"iron is {self.soft_iron} and {self.hard_iron}; expected finite numbers, 3 x 3 and 3"
            )
        if not np.linalg.cond(matrix) < 1e6:
            raise InvalidInputError(f"soft iron {self.soft_iron} has no inverse; expected near the identity")

    def apply(self, field: FloatArray) -> FloatArray:
        """What the magnetometer shows, without noise, of fields (n, 3), each row by itself."""
        return np.asarray(_turned(field, np.array(self.soft_iron)) + np.array(self.hard_iron))

    def correct(self, measured: FloatArray) -> FloatArray:
        """The fields (n, 3) that the magnetometer saw."""
        return _turned(measured - np.array(self.hard_iron), np.linalg.inv(np.array(self.soft_iron)))


def _turned(rows: FloatArray, matrix: FloatArray) -> FloatArray:
    """matrix @ row of each row (n, 3), with the same operations for each however many there are."""
    x, y, z = rows[:, 0], rows[:, 1], rows[:, 2]
    return np.column_stack([m[0] * x + m[1] * y + m[2] * z for m in matrix])


@dataclass(frozen=True, slots=True)
class TriadNoise:
    """Noise of a triad at rest, its worst axis; None where nothing is stated. The signal is m/s2 or rad/s.

    Parameters
    ----------
    random_walk : white noise, signal/sqrt(Hz)
    bias_instability : flicker, signal
    rate_random_walk : walk of the bias, signal/sqrt(s)
    turn_on_bias_sd : spread of the bias between turn-ons, signal
    """

    random_walk: float | None = None
    bias_instability: float | None = None
    rate_random_walk: float | None = None
    turn_on_bias_sd: float | None = None
