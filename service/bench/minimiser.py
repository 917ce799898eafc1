"""The dog leg beside SciPy's least squares on the same problems: what they find, in how many steps, in what time."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from scipy.optimize import least_squares

from core.calibration.accelerometer import norm_residuals
from core.calibration.dogleg import StoppingRules, minimise
from core.measurements import FloatArray
from core.simulation.calibration_recording import spread_orientations
from core.simulation.sensors import MICRO_IBB, UNCALIBRATED, draw_errors
from service.bench.least_squares_problems import MGH, NIST, KnownProblem
from service.bench.simulated_outages import Tell

PEERS: Final = ("lm", "trf", "dogbox")
RULES: Final = StoppingRules(iterations=1000)
ROUNDS: Final = 9
"""Times are the median of so many."""

NEVER: Final = 1e-15
"""SciPy's other rules, so that as with the dog leg a short step ends it (or, with that, a flat gradient)."""

POSITIONS: Final = 40
NEAR: Final = 1e-5
"""A sum of squares that is by no more than this share, and its square, above the published one is the minimum."""


@dataclass(frozen=True, slots=True)
class _Found:
    sum_of_squares: float
    iterations: int
    x: FloatArray


def measure(tell: Tell) -> dict[str, Any]:
    """Per problem and minimiser: iterations, milliseconds, whether the published minimum was found."""
    problems = {"MGH": MGH, "NIST": NIST, "ours": (accelerometer_problem(),)}
    total = sum(len(group) for group in problems.values())
    rows: list[dict[str, Any]] = []
    for collection, group in problems.items():
        for known in group:
            tell(len(rows), total)
            rows.append({"collection": collection, "problem": known.name} | _compared(known))
    return {
        "problems": rows,
        "missed": {
            name: [row["problem"] for row in rows if not row["minimisers"][name]["found"]]
            for name in ("dogleg", *PEERS)
        },
        "dogleg_missed": sum(not row["minimisers"]["dogleg"]["found"] for row in rows),
        "accelerometer_ms": rows[-1]["minimisers"]["dogleg"]["ms"],
        "accelerometer_iterations": rows[-1]["minimisers"]["dogleg"]["iterations"],
    }


def accelerometer_problem() -> KnownProblem:
    """The nine parameters of a simulated unit from 40 positions of 5 s, in the fit's own variables, without a prior."""
    generator = np.random.default_rng(40)
    unit = draw_errors(UNCALIBRATED, generator).accelerometer
    g = 9.80665
    sd_mps2 = MICRO_IBB.accelerometer.random_walk / np.sqrt(5.0)
    up = -spread_orientations(POSITIONS, generator)[:, 2]
    y = (unit.apply(g * up) + sd_mps2 * generator.standard_normal(up.shape)) / g

    def problem(p: FloatArray) -> tuple[FloatArray, FloatArray]:
        residual, jacobian, _ = norm_residuals(p, y)
        return residual * (g / sd_mps2), jacobian * (g / sd_mps2)

    start = np.r_[np.ones(3), np.zeros(6)]
    best = minimise(problem, start, StoppingRules(step=1e-13, iterations=100))
    return KnownProblem("accelerometer", problem, start, 2.0 * best.cost, best.x, np.ones(9))


def _compared(known: KnownProblem) -> dict[str, Any]:
    start = known.start / known.unit

    def dogleg() -> _Found:
        found = minimise(known.scaled, start, RULES)
        return _Found(2.0 * found.cost, found.iterations, found.x)

    def peer(method: str) -> _Found:
        found = least_squares(
            lambda u: known.scaled(u)[0],
            start,
            jac=lambda u: known.scaled(u)[1],
            method=method,
            xtol=RULES.step,
            ftol=NEVER,
            gtol=NEVER,
            max_nfev=RULES.iterations,
        )
        return _Found(2.0 * float(found.cost), int(found.nfev) - 1, found.x)

    minimisers = {"dogleg": _timed(known, dogleg)}
    for method in PEERS:

        def one(method: str = method) -> _Found:
            return peer(method)

        minimisers[method] = _timed(known, one)
    return {"minimisers": minimisers}


def _timed(known: KnownProblem, run: Callable[[], _Found]) -> dict[str, Any]:
    spent_ms = []
    for _ in range(ROUNDS):
        started_s = time.perf_counter()
        found = run()
        spent_ms.append(1e3 * (time.perf_counter() - started_s))
    at_minimum = found.sum_of_squares <= known.sum_of_squares * (1.0 + NEAR) + NEAR**2
    scale = np.maximum(np.abs(known.solution), 1e-3 * float(np.abs(known.solution).max(initial=0.0)))
    off = np.abs(found.x * known.unit - known.solution) / np.where(scale > 0.0, scale, 1.0)
    return {
        "found": bool(at_minimum),
        "iterations": found.iterations,
        "ms": statistics.median(spent_ms),
        "sum_of_squares": found.sum_of_squares,
        "x_off": float(off.max()),
    }
