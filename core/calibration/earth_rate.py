"""The gyroscope by the Earth's rate, as seed 1 has it: the norm at rest is the Earth's in every position (eq. 5-7).

A MEMS triad cannot resolve 7.3e-5 rad/s: white noise of 0.03 deg/s/sqrt(Hz) leaves 2.3e-4 after five seconds. Only the
bias comes out of it; scale and misalignment stay what they were taken to be, and are told to.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from core.calibration.dogleg import minimise
from core.calibration.fit import PARAMETERS, Observability, TriadFit
from core.calibration.gyroscope_problem import GyroscopePrior
from core.calibration.observability import is_weak
from core.calibration.static_intervals import StaticPositions
from core.earth import EARTH_RATE_RADPS
from core.errors import InvalidInputError
from core.measurements import FloatArray
from core.sensors import TriadCalibration, triple

LEAST_POSITIONS: Final = 4
"""Fewer do not tell a centre."""


def fit_earth_rate(positions: StaticPositions, *, prior: GyroscopePrior | None = None) -> TriadFit:
    """Nine parameters of a gyroscope in rad/s whose norm at rest is to be the Earth's rate.

    Minimises the paper's |Omega|^2 - |X|^2, less what noise adds to the square, each position weighted by its noise;
    what the recording does not tell stays at the prior (scale 1, no misalignment), and is named as weak.

    Raises
    ------
    InvalidInputError
        If there is no gyroscope, there are fewer than four positions, or the rates at rest are no rad/s.
    """
    prior = GyroscopePrior() if prior is None else prior
    means, covariances = positions.mean_gyroscope, positions.cov_gyroscope
    if means is None or covariances is None:
        raise InvalidInputError("the recording has no gyroscope; record its three axes too")
    if len(means) < LEAST_POSITIONS:
        raise InvalidInputError(
            f"{len(means)} static positions; expected {LEAST_POSITIONS} or more for the Earth's rate: record more"
        )
    centre, unit = means.mean(axis=0), EARTH_RATE_RADPS
    noise = np.array([np.trace(covariance) for covariance in covariances]) / unit**2  # of |X|^2 over the Earth's
    sd = np.sqrt(4.0 * noise / 3.0 + 2.0 * noise**2 / 3.0)  # of a square about 1 with noise on three axes
    known = np.r_[np.full(3, prior.scale_sd), np.full(3, prior.axes_sd_rad)]

    def triad(x: FloatArray) -> TriadCalibration:
        """x is scales less 1, misalignments, and the bias off the mean in Earth rates."""
        return TriadCalibration(triple(1.0 + x[:3]), triple(x[3:6]), triple(centre + unit * x[6:]))

    def residual(x: FloatArray) -> FloatArray:
        square = np.sum(triad(x).correct(means) ** 2, axis=1) / unit**2
        return np.concatenate([(square - noise - 1.0) / sd, x[:6] / known])

    def problem(x: FloatArray) -> tuple[FloatArray, FloatArray]:
        value, inverse = residual(x), _inverse(x)
        seen = triad(x).correct(means) / unit
        rows = np.zeros((len(value), 9))
        for at in range(9):
            # d(K^-1 (y - b)) = -K^-1 (dK X + db), and K = SF M
            change = seen @ _change(x, at).T if at < 6 else np.broadcast_to(np.eye(3)[at - 6], seen.shape)
            rows[: len(means), at] = -2.0 * np.einsum("ki,ki->k", seen, change @ inverse.T) / sd
        rows[len(means) :, :6] = np.diag(1.0 / known)
        return value, rows

    minimum = minimise(problem, np.zeros(9))
    units = np.r_[np.ones(6), np.full(3, unit)]
    # Where the norm is below its noise the square is flat in the bias: the mean at rest is what is known of it.
    at_rest = np.mean(covariances, axis=0) / len(means) + prior.instability_radps**2 * np.eye(3)
    information = minimum.jacobian.T @ minimum.jacobian
    covariance = np.linalg.pinv(information, rcond=1e-12, hermitian=True) * np.outer(units, units)
    covariance[6:, 6:] = np.maximum(covariance[6:, 6:], 0.0) + at_rest
    unsure = is_weak(np.sqrt(np.diag(covariance)[:6]), known)
    weak = tuple(name for name, one in zip(PARAMETERS, unsure, strict=False) if one)
    advice = (
        "the Earth's rate is below this triad's noise: it tells the bias alone; for scale and misalignment turn the "
        "box between positions and let gravity tell"
    )
    norm = np.linalg.norm(triad(minimum.x).correct(means), axis=1)
    return TriadFit(
        calibration=triad(minimum.x),
        covariance=covariance,
        residuals=norm - unit,
        positions=len(means),
        iterations=minimum.iterations,
        stop=minimum.stop,
        observability=Observability(weak, float(np.linalg.cond(information)), (), advice if weak else ""),
    )


def _inverse(x: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.inv(np.diag(1.0 + x[:3]) @ _unit(x)))


def _unit(x: FloatArray) -> FloatArray:
    return np.array([[1.0, -x[5], x[4]], [0.0, 1.0, -x[3]], [0.0, 0.0, 1.0]])


def _change(x: FloatArray, at: int) -> FloatArray:
    """Derivative of SF M (3, 3) by a scale (0 to 2) or a misalignment (3 to 5)."""
    if at < 3:
        return np.asarray(np.diag(np.eye(3)[at]) @ _unit(x))
    row, column, sign = ((1, 2, -1.0), (0, 2, 1.0), (0, 1, -1.0))[at - 3]
    matrix = np.zeros((3, 3))
    matrix[row, column] = sign * (1.0 + x[row])
    return matrix
