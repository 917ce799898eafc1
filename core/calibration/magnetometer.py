"""Magnetometer: hard and soft iron by the ellipsoid that turning makes of the field's sphere.

Vasconcelos et al. (2011), "Geometric approach to strapdown magnetometer calibration in sensor frame". Where up is known
in some attitudes the constant angle between it and the field tells how the magnetometer lies to the accelerometer,
which no ellipsoid does (Kok & Schon 2016, sec. II).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Final

import numpy as np
import numpy.typing as npt

from core.calibration.dogleg import Minimum, minimise
from core.calibration.fit import Observability, Stop, central_differences
from core.calibration.gyroscope_axes import BETTER, axes_orders
from core.calibration.observability import is_weak
from core.calibration.recording import check_alive
from core.calibration.sphere import directions
from core.errors import InvalidInputError
from core.measurements import FloatArray
from core.sensors import AXES, MagnetometerCalibration, Triple, triple
from core.tunables import Tunables, tunable

BoolArray = npt.NDArray[np.bool_]
IntArray = npt.NDArray[np.int64]

MAGNETOMETER_PARAMETERS: Final = (
    *(f"hard_{axis}" for axis in AXES),
    *(f"soft_{row}{column}" for row in AXES for column in AXES),
)
"""Order of a magnetometer's twelve parameters in vectors and covariances."""

FIELD_UT: Final = (20.0, 70.0)
"""Strength of the Earth's field anywhere, microtesla: 22 to 67 (IGRF-13; Alken et al. 2021)."""
OTHER_UNITS: Final = {"gauss": 100.0, "milligauss": 0.1, "nanotesla": 1e-3, "tesla": 1e6}
LEAST_SAMPLES: Final = 30
"""A choice: fewer cannot be all attitudes."""
CELLS: Final = 100
"""Directions of the sphere that are told apart, 20 degrees wide: an observation each, however long it was held."""
MOST_IN_CELL: Final = 30
"""Samples of a direction that are fitted, evenly taken: more tell nothing of it that these do not."""
LEAST_CELLS: Final = 12
"""An observation for each of twelve numbers."""
FIRST_SD: Final = 0.01
"""Spread of a direction over the strength, for the first of the two fits; the second takes what that left."""
STILL_NOISE: Final = 0.25
"""Change from one sample to the next, over half the range of all, that says that the range is but noise."""
ROUNDEST: Final = 5.0
"""Ratio of axes beyond which a linear fit has found no sensible ellipsoid."""

LEAST_COVERAGE: Final = 0.3
"""Share of the directions: of a smaller cap of the sphere neither size nor centre can be told."""
NOT_TURNED: Final = (
    "the magnetometer was hardly turned; record again while turning the box slowly through all attitudes "
    "(in a vehicle, drive two full circles on level ground and calibrate it as level)"
)


@dataclass(frozen=True, slots=True)
class MagnetometerPrior(Tunables):
    """What is known of iron in a box before it is calibrated, standard deviations."""

    soft_sd: float = tunable(
        0.3, unit="1", low=1e-3, high=2.0, source="choice: soft iron and gains; boxes in cars show 0.05-0.3"
    )
    hard_share: float = tunable(
        5.0, unit="1", low=0.1, high=100.0, source="choice: hard iron over the field; loudspeakers make 5"
    )


@dataclass(frozen=True, slots=True, eq=False)
class MagnetometerFit:
    """A magnetometer's calibration from a recording.

    Parameters
    ----------
    calibration : hard and soft iron
    field_strength : of the field, microtesla; where counts were given and no field, in counts
    covariance : (12, 12) of ``MAGNETOMETER_PARAMETERS``
    residuals : (n,) corrected strength less ``field_strength``, in its unit
    coverage : share of the directions (of the level circle in a vehicle) in which the field was seen
    iterations, stop : of the minimiser
    observability : what could not be told
    """

    calibration: MagnetometerCalibration
    field_strength: float
    covariance: FloatArray
    residuals: FloatArray
    coverage: float
    iterations: int
    stop: Stop
    observability: Observability = field(default_factory=Observability)

    @property
    def sd(self) -> FloatArray:
        """Standard deviations of ``MAGNETOMETER_PARAMETERS``, (12,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def residual_rms(self) -> float:
        return float(np.sqrt(np.mean(self.residuals**2)))


def fit_magnetometer(
    shown: FloatArray,
    ups: tuple[FloatArray, FloatArray] | None = None,
    *,
    counts: bool = False,
    field_ut: float | None = None,
    prior: MagnetometerPrior | None = None,
) -> MagnetometerFit:
    """Fit hard and soft iron to a magnetometer that was turned through all attitudes.

    Parameters
    ----------
    shown : (n, 3) microtesla, or counts; rows of NaN are left out
    ups : what the magnetometer shows in k static attitudes (k, 3), and unit up there in the box's axes (k, 3).
        Without them the soft iron is the symmetric matrix: how the magnetometer is turned in the box stays unknown
    counts : the unit is counts; then ``field_ut`` gives them a scale
    field_ut : strength where it was recorded; without it the soft iron has determinant 1

    Raises
    ------
    InvalidInputError
        If there are too few samples or directions, an axis is dead, or the strength is none of the Earth's.
    """
    prior = MagnetometerPrior() if prior is None else prior
    shown = usable(shown)
    centre, radius, start = _start(shown)
    scaled = (shown - centre) / radius
    cells = cells_of(scaled @ start.T)
    noise = float(np.median(np.abs(np.diff(scaled, axis=0)).max(axis=1)))
    if noise > STILL_NOISE or np.count_nonzero(np.bincount(cells, minlength=CELLS)) < LEAST_CELLS:
        raise InvalidInputError(NOT_TURNED)
    kept = _thinned(cells)
    problem = _Ellipsoid(scaled[kept], start, cells[kept], _aligned(ups, centre, radius, start), prior)
    minimum = minimise(problem, np.zeros(problem.size))
    problem.weigh(minimum.x)
    minimum = minimise(problem, minimum.x)
    return _told(problem, minimum, scaled, (centre, radius), counts, field_ut)


class _Ellipsoid:
    """Whitened residuals |W (y - h)| - 1, then up . W (y - h) - sine of the dip; W = (I + E) start, y dimensionless.

    x is E (6 of a symmetric one; 9 where up is known), h (3), and the sine where up is known.
    """

    def __init__(
        self,
        scaled: FloatArray,
        start: FloatArray,
        cells: IntArray,
        ups: tuple[FloatArray, FloatArray, FloatArray] | None,
        prior: MagnetometerPrior,
    ) -> None:
        self.scaled, self.ups = scaled, None if ups is None else ups[:2]
        self.start = start if ups is None else ups[2] @ start
        entries = (
            [(i, j) for i in range(3) for j in range(3)]
            if ups is not None
            else [(i, j) for i in range(3) for j in range(i, 3)]
        )
        self.basis = np.zeros((len(entries), 3, 3))
        for at, (i, j) in enumerate(entries):
            self.basis[at, i, j] = 1.0
            if ups is None:
                self.basis[at, j, i] = 1.0
        self.size = len(entries) + 3 + (ups is not None)
        # A direction counts once, however often it was seen: what disturbs it disturbs all its samples.
        self.share = 1.0 / np.sqrt(np.bincount(cells, minlength=CELLS)[cells])
        self.cell = cells
        self.sd = FIRST_SD
        self.prior_sd = np.r_[np.full(len(entries), prior.soft_sd), np.full(3, prior.hard_share)]

    def matrix(self, x: FloatArray) -> FloatArray:
        change = np.tensordot(x[: len(self.basis)], self.basis, axes=1)
        if self.ups is None:  # symmetric about a symmetric start: W = start + E
            return np.asarray(self.start + change)
        return np.asarray((np.eye(3) + change) @ self.start)

    def offset(self, x: FloatArray) -> FloatArray:
        return x[len(self.basis) : len(self.basis) + 3]

    def _by_x(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """W (y - h), (n, 3), and its derivative by x, (n, 3, size)."""
        W, off = self.matrix(x), y - self.offset(x)
        seen = off @ W.T
        inner = off if self.ups is None else off @ self.start.T
        by = np.zeros((len(y), 3, self.size))
        by[:, :, : len(self.basis)] = np.einsum("kij,nj->nik", self.basis, inner)
        by[:, :, len(self.basis) : len(self.basis) + 3] = -W
        return seen, by

    def __call__(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        seen, by = self._by_x(x, self.scaled)
        length = np.linalg.norm(seen, axis=1)
        weight = self.share / self.sd
        known = np.hstack(
            [np.diag(1.0 / self.prior_sd), np.zeros((len(self.prior_sd), self.size - len(self.prior_sd)))]
        )
        residual = [weight * (length - 1.0), x[: len(self.prior_sd)] / self.prior_sd]
        rows = [weight[:, None] * np.einsum("ni,nij->nj", seen / length[:, None], by), known]
        if self.ups is not None:
            seen, by = self._by_x(x, self.ups[0])
            residual.insert(1, (np.einsum("ni,ni->n", self.ups[1], seen) - x[-1]) / self.sd)
            by_up = np.einsum("ni,nij->nj", self.ups[1], by)
            by_up[:, -1] -= 1.0
            rows.insert(1, by_up / self.sd)
        return np.concatenate(residual), np.vstack(rows)

    def weigh(self, x: FloatArray) -> None:
        """Take the scatter of the directions' mean residuals for the spread of one."""
        residual = self(x)[0][: -len(self.prior_sd)] * self.sd
        count = np.bincount(self.cell, minlength=CELLS)
        of_samples = residual[: len(self.cell)] / self.share
        means = np.bincount(self.cell, of_samples, CELLS)[count > 0] / count[count > 0]
        every = np.concatenate([means, residual[len(self.cell) :]])
        self.sd = max(1e-6, math.sqrt(float(every @ every) / max(1, len(every) - self.size)))


def _told(
    problem: _Ellipsoid,
    minimum: Minimum,
    scaled: FloatArray,
    scaling: tuple[FloatArray, float],
    counts: bool,
    field_ut: float | None,
) -> MagnetometerFit:
    centre, radius = scaling
    x, jacobian = minimum.x, minimum.jacobian

    def parameters(x: FloatArray) -> FloatArray:
        """The twelve, and the strength that the unit of the recording gives."""
        W = problem.matrix(x) / radius
        seen_strength = abs(float(np.linalg.det(W))) ** (-1.0 / 3.0)
        soft = np.linalg.inv(W) / (seen_strength if field_ut is None else field_ut)
        return np.concatenate([centre + radius * problem.offset(x), soft.ravel(), [seen_strength]])

    found, by_x = parameters(x), central_differences(parameters, x)[:12]
    seen = (scaled - problem.offset(x)) @ problem.matrix(x).T
    unseen, coverage = unseen_directions(seen)
    if coverage < LEAST_COVERAGE:
        raise InvalidInputError(NOT_TURNED)
    if not counts:
        check_strength(float(found[12]))
    strength = float(found[12]) if field_ut is None else field_ut
    covariance = by_x @ np.linalg.inv(jacobian.T @ jacobian) @ by_x.T
    before = by_x[:, : len(problem.prior_sd)] @ np.diag(problem.prior_sd**2) @ by_x[:, : len(problem.prior_sd)].T
    weak = np.flatnonzero(is_weak(np.sqrt(np.diag(covariance)), np.sqrt(np.diag(before))))
    names = tuple(MAGNETOMETER_PARAMETERS[i] for i in weak)
    advice = ""
    if names:
        advice = (
            f"the recording hardly tells {', '.join(names)}: the field was seen from {coverage:.0%} of all directions; "
            "turn the box slowly through all attitudes, upside down too"
        )
    size = 1.0 / np.linalg.norm(jacobian, axis=0)
    return MagnetometerFit(
        calibration=MagnetometerCalibration(triple(found[:3]), matrix_rows(found[3:12].reshape(3, 3))),
        field_strength=strength,
        covariance=covariance,
        residuals=strength * (np.linalg.norm(seen, axis=1) - 1.0),
        coverage=coverage,
        iterations=minimum.iterations,
        stop=minimum.stop,
        observability=Observability(
            names, float(np.linalg.cond(jacobian * size)) ** 2, unseen if names else (), advice
        ),
    )


def usable(shown: FloatArray) -> FloatArray:
    """Samples (n, 3) that are numbers; raises InvalidInputError if they are too few or an axis is dead."""
    shown = shown[np.isfinite(shown).all(axis=1)]
    if len(shown) < LEAST_SAMPLES:
        raise InvalidInputError(
            f"{len(shown)} magnetometer samples; expected {LEAST_SAMPLES} or more, from all attitudes: record again"
        )
    check_alive("magnetometer", shown)
    return np.ascontiguousarray(shown, dtype=np.float64)


def check_strength(strength_ut: float) -> None:
    """Raise InvalidInputError if a strength is none of the Earth's, with the unit that it may be in."""
    low, high = FIELD_UT
    if low <= strength_ut <= high:
        return
    for unit, factor in OTHER_UNITS.items():
        if low <= strength_ut * factor <= high:
            raise InvalidInputError(
                f"the field is {strength_ut:.3g}, expected {low:g} to {high:g} microtesla: it looks like {unit}, "
                f"multiply by {factor:g}"
            )
    raise InvalidInputError(
        f"the field is {strength_ut:.3g} microtesla; the Earth's is {low:g} to {high:g}: record again away from "
        "iron, magnets and currents, or say that these are counts"
    )


def cells_of(vectors: FloatArray) -> IntArray:
    """The nearest of ``CELLS`` directions to each vector (n, 3), (n,)."""
    return np.asarray(np.argmax(vectors @ directions(CELLS).T, axis=1))


def unseen_directions(vectors: FloatArray) -> tuple[tuple[Triple, ...], float]:
    """Axes of the box along which the field was not seen, and the share of all directions in which it was."""
    seen = np.bincount(cells_of(vectors), minlength=CELLS) > 0
    missing = [sign * np.eye(3)[axis] for axis in range(3) for sign in (1.0, -1.0)]
    unseen = tuple(triple(axis) for axis in missing if not seen[cells_of(axis[None])[0]])
    return unseen, float(np.mean(seen))


def matrix_rows(matrix: FloatArray) -> tuple[Triple, Triple, Triple]:
    return triple(matrix[0]), triple(matrix[1]), triple(matrix[2])


def _thinned(cells: IntArray) -> IntArray:
    """Indices of samples, at most so many of each direction."""
    kept = []
    for cell in np.unique(cells):
        rows = np.flatnonzero(cells == cell)
        kept.append(rows[np.linspace(0, rows.size - 1, min(rows.size, MOST_IN_CELL)).round().astype(np.int64)])
    return np.sort(np.concatenate(kept))


def _start(shown: FloatArray) -> tuple[FloatArray, float, FloatArray]:
    """Centre and radius to make samples dimensionless, and W of the ellipsoid by linear least squares, or a sphere."""
    low, high = shown.min(axis=0), shown.max(axis=0)
    centre, radius = 0.5 * (low + high), 0.5 * float(np.max(high - low))
    y = (shown - centre) / radius
    design = np.column_stack([y**2, 2.0 * y[:, 0] * y[:, 1], 2.0 * y[:, 0] * y[:, 2], 2.0 * y[:, 1] * y[:, 2], 2.0 * y])
    p = np.linalg.lstsq(design, np.ones(len(y)), rcond=None)[0]
    Q = np.array([[p[0], p[3], p[4]], [p[3], p[1], p[5]], [p[4], p[5], p[2]]])
    if np.linalg.cond(Q) < 1e8:
        middle = -np.linalg.solve(Q, p[6:])
        values, vectors = np.linalg.eigh(Q / (1.0 + middle @ Q @ middle))
        if values[0] > 0.0 and values[2] / values[0] < ROUNDEST**2:
            return centre + radius * middle, radius, vectors * np.sqrt(values) @ vectors.T
    return centre, radius, np.eye(3)


def _aligned(
    ups: tuple[FloatArray, FloatArray] | None, centre: FloatArray, radius: float, start: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """Static samples made dimensionless, up, and the order of axes (3, 3) whose dip is the most constant.

    Reversing all axes reverses the dip, which is not known: of two such orders the right-handed one is meant.
    """
    if ups is None:
        return None
    known = np.isfinite(ups[0]).all(axis=1)
    at_rest, up = (ups[0][known] - centre) / radius, ups[1][known]
    if len(up) < 4:
        return None
    seen = at_rest @ start.T
    orders = [order for order in axes_orders() if np.linalg.det(order) > 0.0]
    scatter = [float(np.std(np.einsum("ni,ni->n", up, seen @ order.T))) for order in orders]
    same = scatter[next(i for i, order in enumerate(orders) if np.array_equal(order, np.eye(3)))]
    best = int(np.argmin(scatter))
    return at_rest, up, orders[best] if scatter[best] < BETTER * same else np.eye(3)
