"""Powell's dog leg: published problems to their published minima, the rules that end it, the path that it tells."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares

from core.calibration.dogleg import Minimum, StepKind, StoppingRules, minimise
from core.calibration.fit import Stop
from core.errors import InvalidInputError
from core.measurements import FloatArray
from service.bench.least_squares_problems import MGH, NIST, KnownProblem

RULES = StoppingRules(step=1e-11, gradient=1e-12, iterations=600)
"""Tight, so that what is compared with a published value is the minimum and not the rule that stopped before it."""

NOT_STRICT = ("Powell singular (13)",)
"""Its Jacobian is singular at the solution: convergence is linear and x is the fourth root of the cost."""


def _solve(known: KnownProblem, rules: StoppingRules = RULES) -> tuple[Minimum, FloatArray]:
    found = minimise(known.scaled, known.start / known.unit, rules)
    return found, found.x * known.unit


@pytest.mark.parametrize("known", MGH + NIST, ids=lambda known: known.name)
def test_analytic_jacobians_of_the_problems_are_those_of_their_residuals(known: KnownProblem) -> None:
    x = known.start + 1e-3 * np.maximum(np.abs(known.start), 0.1)
    jacobian = known.problem(x)[1]
    steps = 1e-6 * np.maximum(np.abs(x), 1e-3)
    numeric = np.column_stack(
        [(known.problem(x + h)[0] - known.problem(x - h)[0]) / (2 * h.sum()) for h in np.diag(steps)]
    )
    # Central differences lose half of sixteen digits; columns of very different size are compared with their own.
    assert np.abs(jacobian - numeric).max(axis=0) == pytest.approx(0.0, abs=1e-5 * np.abs(jacobian).max())


@pytest.mark.parametrize("known", MGH, ids=lambda known: known.name)
def test_problems_of_more_garbow_and_hillstrom(known: KnownProblem) -> None:
    found, x = _solve(known)
    # The collection states six digits of the sum of squares.
    assert 2 * found.cost == pytest.approx(known.sum_of_squares, rel=1e-6, abs=1e-12)
    if known.name not in NOT_STRICT:
        assert x == pytest.approx(known.solution, rel=1e-4, abs=1e-4 * np.abs(known.solution).max())
        assert found.stop.converged
    else:
        assert x == pytest.approx(known.solution, abs=1e-3)


@pytest.mark.parametrize("known", NIST, ids=lambda known: known.name)
def test_certified_values_of_nist(known: KnownProblem) -> None:
    found, x = _solve(known)
    # Certified to eleven digits; the cost is flat at its minimum, so x is known to half the digits of a double.
    assert 2 * found.cost == pytest.approx(known.sum_of_squares, rel=1e-9)
    assert x == pytest.approx(known.solution, rel=2e-7)
    assert found.stop.converged


@pytest.mark.parametrize("known", [one for one in MGH + NIST if one.name not in NOT_STRICT], ids=lambda one: one.name)
@pytest.mark.parametrize("method", ["lm", "trf", "dogbox"])
def test_it_finds_what_scipy_finds(known: KnownProblem, method: str) -> None:
    _, x = _solve(known)
    peer = least_squares(
        lambda u: known.scaled(u)[0],
        known.start / known.unit,
        jac=lambda u: known.scaled(u)[1],
        method=method,
        xtol=1e-13,
        ftol=1e-13,
        gtol=1e-13,
        max_nfev=5000,
    )
    # Near a minimum with residual the linear convergence of Gauss-Newton leaves both some 1e-5 short (Brown-Dennis).
    assert x == pytest.approx(peer.x * known.unit, rel=2e-4, abs=1e-4 * np.abs(x).max())


def _linear(x: FloatArray) -> tuple[FloatArray, FloatArray]:
    jacobian = np.array([[2.0, 0.0], [0.0, 3.0], [1.0, 1.0]])
    return jacobian @ x - np.array([2.0, 3.0, 2.5]), jacobian


def test_a_linear_problem_takes_one_gauss_newton_step_where_the_radius_allows_it() -> None:
    found = minimise(_linear, np.zeros(2), StoppingRules(radius=10.0))
    expected = np.linalg.lstsq(_linear(np.zeros(2))[1], np.array([2.0, 3.0, 2.5]), rcond=None)[0]
    assert found.x == pytest.approx(expected, abs=1e-14)
    assert found.stop is Stop.SMALL_GRADIENT
    assert [step.kind for step in found.path] == [StepKind.GAUSS_NEWTON]
    assert found.path[0].gain_ratio == pytest.approx(1.0, abs=1e-12)  # the model is the problem


def test_the_radius_follows_the_book() -> None:
    found = minimise(MGH[0].problem, MGH[0].start, StoppingRules(radius=0.05))
    for step, following in zip(found.path, found.path[1:], strict=False):
        assert step.length <= step.radius * (1 + 1e-12)
        assert step.gain_ratio is not None
        if step.gain_ratio > 0.75:
            assert following.radius == max(step.radius, 3 * step.length)
        elif step.gain_ratio < 0.25:
            assert following.radius == step.radius / 2
        else:
            assert following.radius == step.radius
        assert following.cost < step.cost if step.gain_ratio > 0 else following.cost == step.cost
    assert {step.kind for step in found.path} == set(StepKind)


def test_a_step_out_to_the_radius_ends_on_it() -> None:
    found = minimise(MGH[0].problem, MGH[0].start, StoppingRules(radius=0.05))
    bound = [step for step in found.path if step.kind is not StepKind.GAUSS_NEWTON]
    assert bound
    # Both legs are cut where they leave the ball: eq. 3.20.
    assert [step.length for step in bound] == pytest.approx([step.radius for step in bound], rel=1e-12)


@pytest.mark.parametrize(
    ("rules", "stop"),
    [
        (StoppingRules(residual=1.0), Stop.SMALL_RESIDUAL),
        (StoppingRules(gradient=100.0), Stop.SMALL_GRADIENT),
        (StoppingRules(step=0.9, radius=0.5), Stop.SMALL_STEP),
        (StoppingRules(iterations=3), Stop.TOO_MANY),
    ],
)
def test_each_rule_stops_it_and_is_told(rules: StoppingRules, stop: Stop) -> None:
    found = minimise(MGH[0].problem, MGH[0].start, rules)
    assert found.stop is stop
    assert found.stop.converged is (stop is not Stop.TOO_MANY)
    assert found.iterations == len(found.path)


def test_without_full_rank_it_takes_the_shortest_step() -> None:
    def only_the_sum(x: FloatArray) -> tuple[FloatArray, FloatArray]:
        return np.array([x[0] + x[1] - 2.0]), np.array([[1.0, 1.0]])

    assert minimise(only_the_sum, np.zeros(2), StoppingRules(radius=5.0)).x == pytest.approx([1.0, 1.0], abs=1e-14)


def test_a_trial_outside_the_domain_is_stepped_back_from() -> None:
    def logarithm(x: FloatArray) -> tuple[FloatArray, FloatArray]:
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.log(x), np.diag(1.0 / x)

    # From 5 the Gauss-Newton step leads to 5 - 5 log 5 < 0, where there is no logarithm.
    found = minimise(logarithm, np.array([5.0]), StoppingRules(radius=100.0))
    assert found.x == pytest.approx([1.0], abs=1e-9)
    assert any(step.gain_ratio == -np.inf for step in found.path)


def test_what_cannot_be_minimised_is_refused() -> None:
    with pytest.raises(InvalidInputError, match="not finite at the start"):
        minimise(lambda x: (np.array([np.nan]), np.ones((1, 1))), np.zeros(1))
    with pytest.raises(InvalidInputError, match=r"\(1, 2\); expected \(1, 1\)"):
        minimise(lambda x: (x, np.ones((1, 2))), np.zeros(1))
