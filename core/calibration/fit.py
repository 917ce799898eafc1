"""What every fit of a sensor's parameters tells: the parameters, how sure they are, and what could not be told."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Final

import numpy as np

from core.measurements import FloatArray
from core.sensors import TriadCalibration, Triple

PARAMETERS: Final = ("scale_x", "scale_y", "scale_z", "Mx", "My", "Mz", "bias_x", "bias_y", "bias_z")
"""Order of a triad's nine parameters in vectors and covariances."""


class Stop(StrEnum):
    """Why an iteration ended: the three rules of Madsen, Nielsen & Tingleff (2004), alg. 3.21, or its limit."""

    SMALL_GRADIENT = "small_gradient"
    SMALL_STEP = "small_step"
    SMALL_RESIDUAL = "small_residual"
    TOO_MANY = "too_many_iterations"

    @property
    def converged(self) -> bool:
        return self is not Stop.TOO_MANY


@dataclass(frozen=True, slots=True)
class Observability:
    """What the recording could not tell, and what to record to tell it.

    Parameters
    ----------
    weak : names out of ``PARAMETERS`` that the recording tells hardly better than the prior, or to be absurd
    condition : condition number of the normalised information matrix
    add : directions of up (unit, sensor axes) of the positions that would tell most, best first
    advice : one sentence for the one who records; empty where nothing is weak
    """

    weak: tuple[str, ...] = ()
    condition: float = 1.0
    add: tuple[Triple, ...] = ()
    advice: str = ""

    @property
    def observable(self) -> bool:
        return not self.weak


def central_differences(of: Callable[[FloatArray], FloatArray], x: FloatArray, step: float = 1e-6) -> FloatArray:
    """Derivative (m, n) of a smooth function, (n,) to (m,), at an x whose values and their spread are near one."""
    moved = step * np.eye(len(x))
    return np.column_stack([(of(x + d) - of(x - d)) / (2.0 * step) for d in moved])


@dataclass(frozen=True, slots=True, eq=False)
class TriadFit:
    """A triad's calibration from a recording.

    Parameters
    ----------
    calibration : TriadCalibration
        In the unit of the recording: with counts, scale is counts per m/s2 (per rad/s) and bias is counts.
    covariance : (9, 9) of ``PARAMETERS``, the units of the calibration
    residuals : (k,) after the fit, one a position (accelerometer: norm less gravity, m/s2) or one a
        rotation between two positions (gyroscope: angle by which gravity is missed, rad)
    positions : static positions used
    iterations, stop : of the minimiser
    observability : what could not be told
    """

    calibration: TriadCalibration
    covariance: FloatArray
    residuals: FloatArray
    positions: int
    iterations: int
    stop: Stop
    observability: Observability = field(default_factory=Observability)

    @property
    def sd(self) -> FloatArray:
        """Standard deviations of ``PARAMETERS``, (9,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def correlation(self) -> FloatArray:
        """Correlations of ``PARAMETERS``, (9, 9)."""
        sd = self.sd
        return self.covariance / np.outer(sd, sd)

    @property
    def residual_rms(self) -> float:
        return float(np.sqrt(np.mean(self.residuals**2)))
