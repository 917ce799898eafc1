"""The nine parameters of an accelerometer from static positions: the corrected norm is gravity's (seed 1, eq. 5-7).

The fit runs in dimensionless variables, so that counts (bias 33000, scale 415) and m/s2 are one problem: readings are
y = (measured - centre) / (nominal g) = K M x + b with x of length one, K the scales over the nominal one and b the
bias less the centre. Each position's residual is (1 - |x|^2) / 2 over its standard deviation: its own noise along x,
and beside it a model error that all positions share, as large as the residuals ask for.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.optimize import brentq

from core.calibration.dogleg import Minimum, StoppingRules, minimise
from core.calibration.fit import TriadFit
from core.calibration.observability import CANDIDATES, judge
from core.calibration.static_intervals import StaticPositions
from core.errors import InvalidInputError
from core.measurements import FloatArray
from core.sensors import AXES, TriadCalibration, triple
from core.tunables import Tunables, tunable

LEAST_ORIENTATIONS: Final = 6
"""Fewer leave scale or bias of an axis to the prior whatever they are."""

DIFFERENT_COS: Final = math.cos(math.radians(10.0))
"""Positions nearer to each other than that are one orientation."""

GRAVITY_MPS2: Final = (9.7, 9.9)
"""What gravity can be on the ground: 9.764 to 9.834 (Hirt et al. 2013), with some room."""

SI_NORM: Final = (0.7, 1.4)
"""Norm of readings over gravity, from and up to which they can be m/s2 of a sensor that works."""

G_NORM: Final = (0.5, 2.0)
"""Norm of readings that are likely g; a choice: by a factor of two no scale is off."""

DEAD_SD: Final = 6.0
DEAD_G: Final = 0.02
"""An axis is dead whose means all lie within so many sd of their noise and so much of gravity; choices. A box laid on
its six faces moves each axis by 2 g, and one that is turned about an axis leaves it within 1 degree."""

REWEIGHTINGS: Final = 6
"""At most; the weights settle in two or three."""

LEAST_FREEDOM: Final = 3.0
"""Degrees of freedom at which a t-distribution has a spread to speak of: 1.7 times the normal one's."""


@dataclass(frozen=True, slots=True)
class AccelerometerPrior(Tunables):
    """What is known of any accelerometer before it is recorded: one standard deviation of each kind of parameter.

    With counts, scales and biases have these spreads about what they have in common, and that is nearly free: how
    many counts make a g, and which count is zero, the recording has to say.
    """

    scale_sd: float = tunable(
        0.05, unit="1", low=1e-6, high=10.0, source="LSM303DLHC, MPU-6050: sensitivity within 3 to 4 %, and room"
    )
    misalignment_sd_rad: float = tunable(
        0.03, unit="rad", low=1e-6, high=10.0, source="MPU-6050: cross-axis 2 %; soldering 1 degree"
    )
    bias_sd_mps2: float = tunable(
        1.0, unit="m/s2", low=1e-6, high=100.0, source="LSM303DLHC, MPU-6050: zero-g offset 50 to 80 mg, and room"
    )
    common_scale_sd: float = tunable(
        0.5, unit="1", low=1e-6, high=10.0, source="choice: of what a sphere through the counts gives"
    )
    common_bias_sd_g: float = tunable(
        1.0, unit="g", low=1e-6, high=10.0, source="choice: about the centre of a sphere through the counts"
    )
    bias_instability_mps2: float = tunable(
        1.5e-3,
        unit="m/s2",
        low=0.0,
        high=1.0,
        source="choice: 0.15 mg, floor of consumer MEMS 0.1-0.3 mg; by so much the bias of a later hour differs",
    )
    model_error_mps2: float = tunable(
        1e-3,
        unit="m/s2",
        low=1e-6,
        high=1.0,
        source="calib_xsens_imu_tk leaves 0.9 mm/s2 over its noise; counts as one position's residual",
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Readings:
    """Dimensionless readings y (k, 3) and their covariances (k, 3, 3), and what leads back to the recording's unit."""

    y: FloatArray
    covariance: FloatArray
    centre: FloatArray
    unit: float
    """Of one g."""


def fit_accelerometer(
    positions: StaticPositions,
    gravity_mps2: float,
    *,
    counts: bool = False,
    prior: AccelerometerPrior | None = None,
    rules: StoppingRules | None = None,
) -> TriadFit:
    """Fit scale, misalignment and bias so that the corrected norm is gravity in every position.

    Parameters
    ----------
    positions : in m/s2, or counts
    gravity_mps2 : at the place, as by ``core.earth.gravity_mps2``
    counts : readings are raw converter counts; the fit finds their size and zero itself
    prior : what is known beforehand
    rules : of the minimiser

    Raises
    ------
    InvalidInputError
        If gravity is none of the Earth's, there are too few different orientations, an axis is dead, or readings
        have another unit; the message says what to record.
    """
    prior = AccelerometerPrior() if prior is None else prior
    low, high = GRAVITY_MPS2
    if not low <= gravity_mps2 <= high:
        raise InvalidInputError(f"gravity is {gravity_mps2:g} m/s2; expected {low:g} to {high:g} m/s2")
    readings = _readings(positions, gravity_mps2, counts=counts)
    _check(readings, positions)
    own = np.array([prior.scale_sd] * 3 + [prior.misalignment_sd_rad] * 3 + [prior.bias_sd_mps2 / gravity_mps2] * 3)
    expected = np.r_[np.ones(3), np.zeros(6)]
    before = np.diag(own**2)
    if counts:
        before[:3, :3] += prior.common_scale_sd**2
        before[6:, 6:] += prior.common_bias_sd_g**2
    whitened = np.linalg.inv(np.linalg.cholesky(before))  # rows of the prior's residual

    def solve(start: FloatArray, sds: FloatArray) -> Minimum:
        def problem(p: FloatArray) -> tuple[FloatArray, FloatArray]:
            residual, jacobian, _ = norm_residuals(p, readings.y)
            rows = np.vstack([jacobian / sds[:, None], whitened])
            return np.concatenate([residual / sds, whitened @ (p - expected)]), rows

        return minimise(problem, start, rules)

    found, sds, freedom, iterations = _reweighted(solve, expected, readings, prior.model_error_mps2 / gravity_mps2)
    _, jacobian, x = norm_residuals(found.x, readings.y)
    # The residuals tell their own variance with so many degrees of freedom: Student's t, whose spread is wider.
    sds = sds * math.sqrt(freedom / (freedom - 2.0))
    rows = jacobian / sds[:, None]
    posterior = np.asarray(np.linalg.inv(rows.T @ rows + whitened.T @ whitened), dtype=np.float64)
    deviation = found.x - expected
    if counts:
        deviation[:3] -= deviation[:3].mean()
        deviation[6:] -= deviation[6:].mean()
    candidate_rows = norm_residuals(found.x, _apply(found.x, CANDIDATES))[1] / float(np.median(sds))
    to_units = np.r_[np.full(3, readings.unit / gravity_mps2), np.ones(3), np.full(3, readings.unit)]
    values = found.x * to_units
    values[6:] += readings.centre
    covariance = posterior * np.outer(to_units, to_units)
    # However well the recording tells its bias, that of the drives to come is another.
    covariance[6:, 6:] += np.eye(3) * (prior.bias_instability_mps2 * readings.unit / gravity_mps2) ** 2
    return TriadFit(
        calibration=TriadCalibration(triple(values[:3]), triple(values[3:6]), triple(values[6:])),
        covariance=covariance,
        residuals=gravity_mps2 * (np.linalg.norm(x, axis=1) - 1.0),
        positions=len(positions),
        iterations=iterations,
        stop=found.stop,
        observability=judge(own, deviation, rows.T @ rows, posterior, candidate_rows),
    )


def _readings(positions: StaticPositions, gravity_mps2: float, *, counts: bool) -> _Readings:
    means = positions.mean_accelerometer
    centre, unit = _sphere(means) if counts else (np.zeros(3), gravity_mps2)
    if not unit > 0.0:
        raise InvalidInputError("all static positions read the same: lay the box on each of its six faces")
    return _Readings((means - centre) / unit, positions.cov_accelerometer / unit**2, centre, unit)


def _sphere(points: FloatArray) -> tuple[FloatArray, float]:
    """Centre and radius of a sphere through points, linear in the centre; where they leave it open, the nearest."""
    middle = points.mean(axis=0)
    off = points - middle
    size = math.sqrt(float(np.mean(np.sum(off**2, axis=1))))
    if size == 0.0:
        return middle, 0.0
    square = np.sum((off / size) ** 2, axis=1)
    rows = np.column_stack([2.0 * off / size, np.ones(len(off))])
    # Below a thousandth of the largest singular value noise would place the centre.
    solution = np.linalg.lstsq(rows, square, rcond=1e-3)[0]
    centre = middle + size * solution[:3]
    return centre, math.sqrt(float(np.mean(np.sum((points - centre) ** 2, axis=1))))


def _check(readings: _Readings, positions: StaticPositions) -> None:
    norms = np.linalg.norm(readings.y, axis=1)
    typical = float(np.median(norms))
    if not SI_NORM[0] <= typical <= SI_NORM[1]:
        shown = float(np.median(np.linalg.norm(positions.mean_accelerometer, axis=1)))
        in_g = G_NORM[0] < shown < G_NORM[1]
        guess = "these look like g: multiply by 9.80665" if in_g else "raw counts need --counts"
        raise InvalidInputError(f"the accelerometer reads {shown:g} at rest; expected about 9.8 m/s2; {guess}")
    different = _different(readings.y)
    if different < LEAST_ORIENTATIONS:
        raise InvalidInputError(
            f"{len(norms)} static positions in {different} different orientations; expected at least"
            f" {LEAST_ORIENTATIONS}: lay the box on each of its six faces, better on its edges and corners too"
        )
    spread = np.ptp(readings.y, axis=0)
    noise = np.sqrt(np.diagonal(readings.covariance, axis1=1, axis2=2).max(axis=0))
    dead = (spread <= DEAD_SD * noise) & (spread < DEAD_G)
    if dead.any() and not dead.all():
        axis = AXES[int(np.argmax(dead))]
        raise InvalidInputError(
            f"the accelerometer's {axis} axis reads the same in all {len(norms)} positions: it is dead, or the box was"
            f" only turned about it; record again with the {axis} axis up and with it down"
        )


def _different(y: FloatArray) -> int:
    """How many of the readings point elsewhere than those before them."""
    kept: list[FloatArray] = []
    for direction in y / np.linalg.norm(y, axis=1)[:, None]:
        if all(float(direction @ other) < DIFFERENT_COS for other in kept):
            kept.append(direction)
    return len(kept)


def _apply(p: FloatArray, x: FloatArray) -> FloatArray:
    return TriadCalibration(triple(p[:3]), triple(p[3:6]), triple(p[6:])).apply(x)


def norm_residuals(p: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(1 - |x|^2) / 2 (k,), its derivatives by the parameters (k, 9), and x (k, 3), of readings y (k, 3)."""
    scale, (mx, my, mz), bias = p[:3], p[3:6], p[6:]
    z = (y - bias) / scale
    x3 = z[:, 2]
    x2 = z[:, 1] + mx * x3
    x1 = z[:, 0] + mz * x2 - my * x3
    # Half the derivative of |x|^2 by z.
    g2 = x2 + mz * x1
    g = np.column_stack([x1, g2, x3 + mx * g2 - my * x1])
    jacobian = np.column_stack([g * z / scale, -x3 * g2, x1 * x3, -x1 * x2, g / scale])
    return 0.5 * (1.0 - x1 * x1 - x2 * x2 - x3 * x3), jacobian, np.column_stack([x1, x2, x3])


def _reweighted(
    solve: Callable[[FloatArray, FloatArray], Minimum], start: FloatArray, readings: _Readings, typical: float
) -> tuple[Minimum, FloatArray, float, int]:
    """The minimum; the standard deviations (k,) that it settled with, of how many degrees of freedom; iterations."""
    sds = np.sqrt(_along(start, norm_residuals(start, readings.y)[2], readings.covariance) + typical**2)
    found = solve(start, sds)
    iterations = found.iterations
    for _ in range(REWEIGHTINGS):
        residual, jacobian, x = norm_residuals(found.x, readings.y)
        noise = _along(found.x, x, readings.covariance)
        used = jacobian @ np.linalg.inv(found.jacobian.T @ found.jacobian) @ jacobian.T
        freedom = max(len(residual) - float(np.sum(np.diagonal(used) / sds**2)), 1.0)
        before, sds = sds, np.sqrt(noise + _model_variance(residual, noise, freedom, typical))
        if np.allclose(sds, before, rtol=0.05, atol=0.0):
            break
        found = solve(found.x, sds)
        iterations += found.iterations
    return found, sds, max(freedom, LEAST_FREEDOM), iterations


def _along(p: FloatArray, x: FloatArray, covariance: FloatArray) -> FloatArray:
    """Variance of each corrected norm (k,) by the noise of its readings (k, 3, 3)."""
    inverse = np.linalg.inv(_apply(p, np.eye(3)).T - p[6:, None])
    direction = x / np.linalg.norm(x, axis=1)[:, None] @ inverse
    return np.asarray(np.einsum("ki,kij,kj->k", direction, covariance, direction))


def _model_variance(residual: FloatArray, noise: FloatArray, freedom: float, typical: float) -> float:
    """Variance that the model's error adds in every position: Paule & Mandel (1982), free of bias in the median.

    It is the one for which the weighted squares sum to the median of their chi-square. A residual of ``typical`` size
    and no noise is added to them: with hardly more positions than parameters there is no other.
    """
    squares, noises = np.r_[residual**2, typical**2], np.r_[noise, 0.0]
    median = freedom * (1.0 - 2.0 / (9.0 * freedom)) ** 3  # Wilson & Hilferty (1931)

    def excess(log_variance: float) -> float:
        return float(np.sum(squares / (noises + math.exp(log_variance)))) - median

    low, high = math.log(1e-3 * typical**2 / median), math.log(float(squares.sum()) / median)
    return math.exp(brentq(excess, low, high, rtol=1e-4))
