"""Magnetometer in a vehicle: what circles on level ground tell of hard and soft iron.

The field's level part runs through an ellipse while the vehicle turns. How the iron bends it out of the level, and what
adds to its vertical part, cannot be told without tilting: hard iron is that which adds on level ground.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import numpy.typing as npt

from core.calibration.dogleg import minimise
from core.calibration.fit import Observability, central_differences
from core.calibration.magnetometer import (
    MagnetometerFit,
    MagnetometerPrior,
    check_strength,
    matrix_rows,
    usable,
)
from core.errors import InvalidInputError
from core.measurements import FloatArray
from core.rotation import matrix_from_rotation_vector
from core.sensors import AXES, MagnetometerCalibration, Triple, triple

IntArray = npt.NDArray[np.int64]

SECTORS: Final = 36
"""Headings that are told apart, 10 degrees each: an observation each, however long it was driven."""
LEAST_SECTORS: Final = 6
WHOLE_CIRCLE: Final = 0.9
"""Share of the sectors from which on the ellipse is closed."""


def fit_level_magnetometer(
    shown: FloatArray,
    up: Triple,
    turned_rad: FloatArray | None = None,
    *,
    counts: bool = False,
    field_ut: tuple[float, float] | None = None,
    prior: MagnetometerPrior | None = None,
) -> MagnetometerFit:
    """Fit the level part of hard and soft iron to a drive in circles.

    Parameters
    ----------
    shown : (n, 3) microtesla, or counts
    up : unit, in the magnetometer's axes: opposite to what the accelerometers feel as gravity, on the average
    turned_rad : (n,) heading turned since the start, clockwise from above, as ``heading_turned`` integrates it; a
        bias of it is found too. With it an arc is enough; without it the circle must be closed
    counts : the unit is counts; field strength is not checked then
    field_ut : horizontal and downward strength at the place; with it scale and vertical hard iron are told too

    Raises
    ------
    InvalidInputError
        If there are too few samples or headings, an axis is dead, or the strength is none of the Earth's.
    """
    prior = MagnetometerPrior() if prior is None else prior
    finite = np.isfinite(shown).all(axis=1)
    shown = usable(shown)
    C_l_from_s = level_from(np.array(up, dtype=float))
    level = shown @ C_l_from_s.T
    vertical = float(level[:, 2].mean())
    low, high = level[:, :2].min(axis=0), level[:, :2].max(axis=0)
    centre, radius = 0.5 * (low + high), 0.5 * float(np.max(high - low))
    y = (level[:, :2] - centre) / radius
    if turned_rad is None:
        sector = _sectors(np.arctan2(y[:, 1], y[:, 0]))
        problem: _Closed | _Turned = _Closed(y, sector)
    else:
        sector = _sectors(turned_rad[finite])
        problem = _Turned(y, turned_rad[finite], sector)
    coverage = len(np.unique(sector)) / SECTORS
    if coverage * SECTORS < LEAST_SECTORS:
        raise InvalidInputError(
            f"the vehicle turned through {coverage * 360.0:.0f} degrees; record again while driving two full circles "
            "on level ground, away from other vehicles"
        )
    if turned_rad is None and coverage < WHOLE_CIRCLE:
        raise InvalidInputError(
            f"the field was seen over {coverage:.0%} of a circle: an arc does not tell where its centre is; record "
            "again while driving two full circles on level ground, or with the gyroscope"
        )
    minimum = minimise(problem, problem.start)
    shape, offset = problem.shape(minimum.x), problem.offset(minimum.x)
    horizontal = radius * math.sqrt(abs(float(np.linalg.det(shape)))) if field_ut is None else field_ut[0]
    down = vertical if field_ut is None else field_ut[1]
    if not counts:
        check_strength(math.hypot(radius * math.sqrt(abs(float(np.linalg.det(shape)))), vertical))

    def parameters(x: FloatArray) -> FloatArray:
        """(12,) in sensor axes."""
        strength = radius * math.sqrt(abs(float(np.linalg.det(problem.shape(x))))) if field_ut is None else field_ut[0]
        soft = np.eye(3)
        soft[:2, :2] = radius / strength * problem.shape(x)
        hard = np.r_[centre + radius * problem.offset(x), vertical - down]
        return np.concatenate([C_l_from_s.T @ hard, (C_l_from_s.T @ soft @ C_l_from_s).ravel()])

    found = parameters(minimum.x)
    by_x = central_differences(parameters, minimum.x)
    covariance = problem.spread(minimum.x) ** 2 * by_x @ np.linalg.pinv(minimum.jacobian.T @ minimum.jacobian) @ by_x.T
    strength = math.hypot(horizontal, down)
    vertical_sd = prior.soft_sd * abs(down) if field_ut is not None else prior.hard_share * strength
    covariance += _unseen(C_l_from_s, prior.soft_sd, vertical_sd)
    inner = np.linalg.solve(shape, (y - offset).T).T
    corrected = np.linalg.norm(inner, axis=1)
    return MagnetometerFit(
        calibration=MagnetometerCalibration(triple(found[:3]), matrix_rows(found[3:].reshape(3, 3))),
        field_strength=strength,
        covariance=covariance,
        residuals=horizontal * (corrected - 1.0),
        coverage=coverage,
        iterations=minimum.iterations,
        stop=minimum.stop,
        observability=_observability(np.array(up), field_ut is not None),
    )


def heading_turned(t_s: FloatArray, rates: FloatArray, up: Triple) -> FloatArray:
    """Heading turned since the first sample, rad clockwise from above, (n,), of rates (n, 3) rad/s."""
    down = -rates @ np.array(up)
    return np.asarray(np.r_[0.0, np.cumsum(0.5 * (down[1:] + down[:-1]) * np.diff(t_s))])


class _Closed:
    """Residual |A^-1 (y - h)| - 1 of an ellipse; x is A - I (xx, yy, xy; symmetric) and h (2)."""

    def __init__(self, y: FloatArray, sector: IntArray) -> None:
        self.y, self.sector = y, sector
        self.share = 1.0 / np.sqrt(np.bincount(sector, minlength=SECTORS)[sector])
        self.start = np.zeros(5)

    def shape(self, x: FloatArray) -> FloatArray:
        return np.array([[1.0 + x[0], x[2]], [x[2], 1.0 + x[1]]])

    def offset(self, x: FloatArray) -> FloatArray:
        return x[3:5]

    def __call__(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        inverse = np.linalg.inv(self.shape(x))
        inner = (self.y - self.offset(x)) @ inverse
        length = np.linalg.norm(inner, axis=1)
        back = (inner / length[:, None]) @ inverse  # d|inner| = -back . (dA inner + dh)
        by_shape = np.column_stack(
            [back[:, 0] * inner[:, 0], back[:, 1] * inner[:, 1], back[:, 0] * inner[:, 1] + back[:, 1] * inner[:, 0]]
        )
        return self.share * (length - 1.0), -self.share[:, None] * np.hstack([by_shape, back])

    def spread(self, x: FloatArray) -> float:
        """Scatter of the sectors' mean residuals."""
        return _scatter(self(x)[0] / self.share, self.sector, len(x))


class _Turned:
    """Residual y - h - B (cos t, -sin t), linear but for the drift of t; x is B (4, by rows), h (2), drift of t.

    B is the ellipse's symmetric matrix times a rotation, by which the heading at the start is not known.
    """

    def __init__(self, y: FloatArray, turned_rad: FloatArray, sector: IntArray) -> None:
        self.y, self.turned, self.sector = y, turned_rad, sector
        self.since = np.linspace(0.0, 1.0, len(y))
        self.share = 1.0 / np.sqrt(np.bincount(sector, minlength=SECTORS)[sector])
        design = np.column_stack([np.cos(turned_rad), -np.sin(turned_rad), np.ones(len(y))])
        linear = np.linalg.lstsq(design * self.share[:, None], y * self.share[:, None], rcond=None)[0]
        self.start = np.r_[linear[:2].T.ravel(), linear[2], 0.0]

    def shape(self, x: FloatArray) -> FloatArray:
        u, sizes, _ = np.linalg.svd(x[:4].reshape(2, 2))
        return np.asarray(u * sizes @ u.T)

    def offset(self, x: FloatArray) -> FloatArray:
        return x[4:6]

    def __call__(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        angle = self.turned + x[6] * self.since
        ahead = np.column_stack([np.cos(angle), -np.sin(angle)])
        turning = np.column_stack([-np.sin(angle), -np.cos(angle)]) * self.since[:, None]
        B = x[:4].reshape(2, 2)
        residual = (self.y - x[4:6] - ahead @ B.T) * self.share[:, None]
        jacobian = np.zeros((len(self.y), 2, 7))
        jacobian[:, 0, 0:2] = jacobian[:, 1, 2:4] = -ahead
        jacobian[:, 0, 4] = jacobian[:, 1, 5] = -1.0
        jacobian[:, :, 6] = -turning @ B.T
        return residual.ravel(), (jacobian * self.share[:, None, None]).reshape(-1, 7)

    def spread(self, x: FloatArray) -> float:
        residual = self(x)[0].reshape(-1, 2) / self.share[:, None]
        return max(_scatter(residual[:, axis], self.sector, len(x) / 2.0) for axis in range(2))


def _sectors(angle_rad: FloatArray) -> IntArray:
    return np.asarray(np.floor(np.mod(angle_rad, 2.0 * math.pi) / (2.0 * math.pi) * SECTORS), dtype=np.int64) % SECTORS


def _scatter(residual: FloatArray, sector: IntArray, taken: float) -> float:
    count = np.bincount(sector, minlength=SECTORS)
    means = np.bincount(sector, residual, SECTORS)[count > 0] / count[count > 0]
    return math.sqrt(float(means @ means) / max(1.0, len(means) - taken))


def level_from(up: FloatArray) -> FloatArray:
    """C (3, 3) from sensor axes to level ones with z down, turned as little as may be."""
    down = -up / np.linalg.norm(up)
    axis = np.cross(down, [0.0, 0.0, 1.0])
    length = float(np.linalg.norm(axis))
    if length < 1e-9:
        return np.eye(3) if down[2] > 0.0 else np.diag([1.0, -1.0, -1.0])
    return matrix_from_rotation_vector(axis / length * math.atan2(length, float(down[2])))


def _unseen(C_l_from_s: FloatArray, soft_sd: float, vertical_sd: float) -> FloatArray:
    """Covariance (12, 12) of what level circles do not tell, in sensor axes: all that has to do with the vertical."""
    level = np.zeros((12, 12))
    level[2, 2] = vertical_sd**2
    for row, column in ((0, 2), (1, 2), (2, 0), (2, 1), (2, 2)):
        level[3 + 3 * row + column, 3 + 3 * row + column] = soft_sd**2
    turn = np.zeros((12, 12))
    turn[:3, :3] = C_l_from_s.T
    turn[3:, 3:] = np.kron(C_l_from_s.T, C_l_from_s.T)
    return np.asarray(turn @ level @ turn.T)


def _observability(up: FloatArray, field_known: bool) -> Observability:
    vertical = AXES[int(np.argmax(np.abs(up)))]
    weak = [f"soft_{row}{column}" for row in AXES for column in AXES if vertical in (row, column)]
    advice = f"level circles tell nothing of the {vertical} axis: "
    advice += "turn the box through all attitudes before it is fitted"
    if not field_known:
        weak.insert(0, f"hard_{vertical}")
        advice += ", or give the field's strength at the place"
    return Observability(tuple(weak), math.inf, (), advice)
