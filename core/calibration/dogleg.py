"""Powell's dog leg for non-linear least squares: Madsen, Nielsen & Tingleff (2004), algorithm 3.21."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from typing import Final, TypeAlias

import numpy as np

from core.calibration.fit import Stop
from core.errors import InvalidInputError
from core.measurements import FloatArray
from core.tunables import Tunables, tunable

Problem: TypeAlias = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
"""From x (n,) to the residual f (m,) and its Jacobian df/dx (m, n)."""

_BOOK: Final = "Madsen, Nielsen & Tingleff (2004), alg. 3.21"

GOOD_GAIN: Final = 0.75
"""Gain ratio above which the model is trusted further out (the book's alg. 3.21)."""

POOR_GAIN: Final = 0.25
"""Gain ratio below which the radius is halved (the book's alg. 3.21)."""

GROWTH: Final = 3.0
"""The radius grows to this many lengths of a good step (the book's alg. 3.21)."""


@dataclass(frozen=True, slots=True)
class StoppingRules(Tunables):
    """When to stop, and how far to trust the first step. All are in the units of the caller's x and f."""

    gradient: float = tunable(
        1e-10, unit="f2/x", low=0.0, high=1e6, source=f"{_BOOK}: eps1, on the largest component of J'f"
    )
    step: float = tunable(
        1e-8,
        unit="1",
        low=0.0,
        high=1.0,
        source=f"{_BOOK}: eps2, of the length of x; shorter steps change a cost by less than its rounding",
    )
    residual: float = tunable(
        1e-14, unit="f", low=0.0, high=1e6, source=f"{_BOOK}: eps3, on the largest component of f"
    )
    iterations: int = tunable(200, unit="1", low=0, high=100_000, source=f"{_BOOK}: kmax; 100 to 200 in its examples")
    radius: float = tunable(1.0, unit="x", low=1e-12, high=1e12, source=f"{_BOOK}: Delta0; 1 in its examples")


class StepKind(StrEnum):
    """Which leg of eq. 3.20 a step took."""

    GAUSS_NEWTON = "gauss-newton"
    CAUCHY = "cauchy"
    DOG_LEG = "dog leg"


@dataclass(frozen=True, slots=True)
class Step:
    """One iteration.

    Parameters
    ----------
    cost : half the sum of squares before the step
    gradient : largest component of J'f before the step
    radius : of the trust region within which the step was chosen
    kind : StepKind
    length : Euclidean, of the step
    gain_ratio : decrease of the cost over what the linear model promised; the step was taken if it is positive.
        None for the last step of all where it was too short to be tried.
    """

    cost: float
    gradient: float
    radius: float
    kind: StepKind
    length: float
    gain_ratio: float | None


@dataclass(frozen=True, slots=True, eq=False)
class Minimum:
    """Where the iteration ended: x (n,), the residual (m,) and Jacobian (m, n) there, why, and how it came there."""

    x: FloatArray
    residual: FloatArray
    jacobian: FloatArray
    iterations: int
    stop: Stop
    path: tuple[Step, ...]

    @property
    def cost(self) -> float:
        """Half the sum of squares."""
        return 0.5 * float(self.residual @ self.residual)


def minimise(problem: Problem, start: FloatArray, rules: StoppingRules | None = None) -> Minimum:
    """Minimise half the sum of squares of a residual.

    The trust region is a ball in the units of x: variables of very different size are to be scaled by the caller's
    parametrisation. Where the Jacobian has not full rank, the shortest Gauss-Newton step is taken. A trial point with
    a residual that is not finite counts as one with no gain.

    Parameters
    ----------
    problem : Problem
    start : (n,)
    rules : StoppingRules

    Raises
    ------
    InvalidInputError
        If the residual or Jacobian at the start is not finite, or has another shape than the start asks for.
    """
    rules = StoppingRules() if rules is None else rules
    x = np.array(start, dtype=float)
    f, jacobian = problem(x)
    if jacobian.shape != (f.size, x.size):
        raise InvalidInputError(f"Jacobian has shape {jacobian.shape}; expected {(f.size, x.size)}")
    if not (np.isfinite(f).all() and np.isfinite(jacobian).all()):
        raise InvalidInputError("the residual or its Jacobian is not finite at the start; expected a start inside")
    radius, path = rules.radius, list[Step]()
    cost, gradient = 0.5 * float(f @ f), jacobian.T @ f
    stop = _flat(f, gradient, rules)
    while stop is None and len(path) < rules.iterations:
        step, kind, promised = _dog_leg(f, jacobian, gradient, radius)
        length, size = float(np.linalg.norm(step)), float(np.linalg.norm(x))
        facts = (cost, float(np.abs(gradient).max()), radius, kind, length)
        if length <= rules.step * (size + rules.step):
            path.append(Step(*facts, None))
            stop = Stop.SMALL_STEP
            break
        tried = x + step
        f_tried, jacobian_tried = problem(tried)
        cost_tried = 0.5 * float(f_tried @ f_tried)
        finite = math.isfinite(cost_tried) and bool(np.isfinite(jacobian_tried).all())
        gain_ratio = (cost - cost_tried) / promised if finite and promised > 0.0 else -math.inf
        path.append(Step(*facts, gain_ratio))
        if gain_ratio > 0.0:
            x, f, jacobian, cost = tried, f_tried, jacobian_tried, cost_tried
            gradient = jacobian.T @ f
            stop = _flat(f, gradient, rules)
        if gain_ratio > GOOD_GAIN:
            radius = max(radius, GROWTH * length)
        elif gain_ratio < POOR_GAIN:
            radius *= 0.5
            if stop is None and radius <= rules.step * (float(np.linalg.norm(x)) + rules.step):
                stop = Stop.SMALL_STEP
    return Minimum(x, f, jacobian, len(path), Stop.TOO_MANY if stop is None else stop, tuple(path))


def _flat(f: FloatArray, gradient: FloatArray, rules: StoppingRules) -> Stop | None:
    """The rules on the residual and the gradient, or None."""
    if float(np.abs(f).max()) <= rules.residual:
        return Stop.SMALL_RESIDUAL
    if float(np.abs(gradient).max()) <= rules.gradient:
        return Stop.SMALL_GRADIENT
    return None


def _dog_leg(
    f: FloatArray, jacobian: FloatArray, gradient: FloatArray, radius: float
) -> tuple[FloatArray, StepKind, float]:
    """The step of eq. 3.20, its kind, and the decrease of the cost that the linear model promises for it."""
    newton = np.asarray(np.linalg.lstsq(jacobian, -f, rcond=None)[0], dtype=np.float64)
    if float(np.linalg.norm(newton)) <= radius:
        return newton, StepKind.GAUSS_NEWTON, _promised(f, jacobian, newton)
    slope = float(gradient @ gradient)
    cauchy = -gradient * (slope / float(np.sum((jacobian @ gradient) ** 2)))
    to_cauchy = float(np.linalg.norm(cauchy))
    if to_cauchy >= radius:
        step = cauchy * (radius / to_cauchy)
        return step, StepKind.CAUCHY, _promised(f, jacobian, step)
    leg = newton - cauchy
    along, leg_sq, room = float(cauchy @ leg), float(leg @ leg), radius**2 - to_cauchy**2
    root = math.sqrt(along**2 + leg_sq * room)
    # Two forms of one root, each free of cancellation where it is used (the book's text below eq. 3.20).
    share = (root - along) / leg_sq if along <= 0.0 else room / (along + root)
    step = cauchy + share * leg
    return step, StepKind.DOG_LEG, _promised(f, jacobian, step)


def _promised(f: FloatArray, jacobian: FloatArray, step: FloatArray) -> float:
    """L(0) - L(h), written so that near the minimum it is not a difference of two large numbers."""
    change = jacobian @ step
    return -float(change @ f) - 0.5 * float(change @ change)
