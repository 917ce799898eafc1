"""Gyroscope: scale, misalignment, bias and axes by turning from one static position to the next, as gravity tells.

Tedaldi, Pretto & Menegatti (2014), "A robust and easy to implement method for IMU calibration without external
equipments", sec. III-D, with each turn weighted by what its noise allows.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Final

import numpy as np

from core.calibration.dogleg import Minimum, StoppingRules, minimise
from core.calibration.fit import PARAMETERS, Observability, TriadFit, central_differences
from core.calibration.gyroscope_axes import axes_of, first_guess
from core.calibration.gyroscope_problem import GyroscopePrior, Spans, TurnProblem, Ups, across
from core.calibration.observability import describe_up, is_weak
from core.calibration.recording import CalibrationRecording, check_alive
from core.calibration.rest import Rest, g_sensitivity
from core.calibration.static_intervals import StaticPositions
from core.calibration.turns import integrate
from core.earth import EARTH_RATE_RADPS
from core.errors import InvalidInputError
from core.measurements import FloatArray
from core.rotation import skew
from core.sensors import AXES, Triple, triple

GYROSCOPE_PARAMETERS: Final = (*PARAMETERS, "alignment_x", "alignment_y", "alignment_z")
"""Order of a gyroscope's twelve parameters: the nine of any triad, and the axes it is mounted in."""

ROUNDS: Final = 3
"""Times that the weights, which hang on the parameters, are set: they change the third round by less than 1 %."""
RULES: Final = StoppingRules(step=1e-6)
"""x is of hundredths and known to 1e-4: steps of 1e-8 say nothing, and their gain is lost in rounding."""
MISSES_RAD: Final = 0.15
"""RMS by which gravity may be missed: beyond, turns were clipped or lost, or the accelerometer's fit is wrong."""


@dataclass(frozen=True, slots=True, eq=False)
class GyroscopeFit(TriadFit):
    """A gyroscope's calibration: shown = SF M C_g_from_a rate_a + B, with the rate in the accelerometer's axes.

    Parameters
    ----------
    alignment_rad : rotation vector of C_g_from_a; also in ``calibration.alignment``
    joint_covariance : (12, 12) of ``GYROSCOPE_PARAMETERS``
    noise : (3,) density of the white noise at rest, the recording's unit/sqrt(Hz)
    g_sensitivity : (3, 3) what the bias gains by specific force, the recording's unit per m/s2, and its sd; zero
        where none is seen. ``calibration.bias`` is that without force
    left_out : turns not used: clipped, with a gap, or far from what the others say
    """

    alignment_rad: Triple = field(kw_only=True)
    joint_covariance: FloatArray = field(kw_only=True)
    noise: FloatArray = field(kw_only=True)
    g_sensitivity: FloatArray = field(kw_only=True, default_factory=lambda: np.zeros((3, 3)))
    g_sensitivity_sd: FloatArray = field(kw_only=True, default_factory=lambda: np.zeros((3, 3)))
    left_out: int = field(kw_only=True, default=0)

    @property
    def alignment_sd(self) -> FloatArray:
        """Standard deviations of ``alignment_rad``, (3,)."""
        return np.sqrt(np.diag(self.joint_covariance)[9:])


def fit_gyroscope(
    recording: CalibrationRecording,
    positions: StaticPositions,
    accelerometer: TriadFit,
    gravity_mps2: float,
    *,
    counts: bool = False,
    prior: GyroscopePrior | None = None,
) -> GyroscopeFit:
    """Fit a gyroscope's twelve parameters to a recording of static positions with turns between.

    Parameters
    ----------
    positions : in the order of time
    accelerometer : fit of the same recording: tells where up is in each position, and how surely
    gravity_mps2 : where it was recorded
    counts : whether the gyroscope shows counts; then its scale is found, in counts per rad/s

    Raises
    ------
    InvalidInputError
        If there is no gyroscope, an axis is dead, there are too few turns, the unit is not rad/s, or gravity is
        missed after the fit; the message says what to record again.
    """
    prior = GyroscopePrior() if prior is None else prior
    if recording.gyroscope is None:
        raise InvalidInputError("the recording has no gyroscope; record its three axes too")
    shown = np.ascontiguousarray(recording.gyroscope, dtype=np.float64)
    check_alive("gyroscope", shown)
    ups = Ups.of(positions, accelerometer, gravity_mps2)
    spans = Spans.of(recording.t_s, shown, positions, prior)
    force = accelerometer.calibration.correct(recording.accelerometer)
    sensitivity, sensitivity_sd = g_sensitivity(_means(shown, positions), _means(force, positions))
    shown = shown - force @ sensitivity.T
    at_rest = Rest.of(recording.t_s, shown, positions.start, positions.end, 0.0, 0.0)
    inverse = first_guess(recording.t_s, shown, spans.begin, spans.end, at_rest.bias, ups.of_turns(spans), counts)
    unit = float(np.cbrt(abs(np.linalg.det(inverse))))  # rad/s per shown unit
    walk_radps = prior.instability_radps * math.sqrt(2.0 / prior.instability_s)
    at_rest = Rest.of(recording.t_s, shown, positions.start, positions.end, walk_radps / unit, EARTH_RATE_RADPS / unit)
    model = TurnProblem(recording.t_s, shown, spans, ups, at_rest, inverse, prior)
    x = np.zeros(12)
    iterations, scatter = 0, 1.0
    for last in range(ROUNDS, 0, -1):
        model.weigh(x, scatter)
        minimum = minimise(model, x, RULES)
        x, iterations = minimum.x, iterations + minimum.iterations
        if last > 1:  # what is told after the last one is of the turns that it used
            model.leave_out_far_ones(x)
            scatter = max(1.0, scatter * model.scatter(x))
    fit = _told(model, minimum, iterations, positions, accelerometer, prior)
    return replace(fit, g_sensitivity=sensitivity, g_sensitivity_sd=sensitivity_sd)


def _told(
    model: TurnProblem,
    minimum: Minimum,
    iterations: int,
    positions: StaticPositions,
    accelerometer: TriadFit,
    prior: GyroscopePrior,
) -> GyroscopeFit:
    x = minimum.x
    turns = model.turns(x)
    before, after = model.ups.of_turns(model.spans)
    missed = np.linalg.norm(np.einsum("kji,kj->ki", turns.C_a_from_e, before) - after, axis=1)
    missed_rms = float(np.sqrt(np.mean(missed[model.used] ** 2)))
    if missed_rms > MISSES_RAD:
        raise InvalidInputError(
            f"the turns miss gravity by {math.degrees(missed_rms):.0f} degrees RMS after the fit: rates were clipped, "
            "samples lost, or the accelerometer's fit is wrong; record again, turning slower than the full scale"
        )
    data_rows = len(minimum.residual) - 9
    scatter = max(1.0, model.scatter(x))
    rows = minimum.jacobian.copy()
    rows[: data_rows - 3] /= math.sqrt(scatter)
    covariance = np.linalg.inv(rows.T @ rows)
    gain = covariance @ minimum.jacobian.T @ np.diag(np.r_[np.full(data_rows - 3, 1.0 / scatter), np.ones(12)])
    by_accelerometer = gain @ model.by_accelerometer(x)
    covariance += by_accelerometer @ accelerometer.covariance @ by_accelerometer.T
    covariance[9:, 9:] += prior.instability_radps**2 * np.eye(3)

    inverse, bias = model.inverse(x), model.bias(x)
    triad = axes_of(np.asarray(np.linalg.inv(inverse)), bias)
    by_x = central_differences(partial(_parameters, model), x)
    joint = by_x @ covariance @ by_x.T
    before_hand = np.zeros((12, 12))
    before_hand[:9, :9] = np.diag(model.prior_sd**2)
    known_sd = np.sqrt(np.diag(by_x @ before_hand @ by_x.T))
    return GyroscopeFit(
        calibration=triad,
        covariance=joint[:9, :9],
        residuals=missed[model.used],
        positions=len(positions.start),
        iterations=iterations,
        stop=minimum.stop,
        observability=_observability(model, x, rows, by_x, joint, known_sd),
        alignment_rad=triad.alignment,
        joint_covariance=joint,
        noise=model.at_rest.noise,
        left_out=model.spans.left_out + int((~model.used).sum()),
    )


def _parameters(model: TurnProblem, x: FloatArray) -> FloatArray:
    triad = axes_of(np.asarray(np.linalg.inv(model.inverse(x))), model.bias(x))
    return np.concatenate([triad.scale, triad.misalignment, triad.bias, triad.alignment])


def _observability(
    model: TurnProblem, x: FloatArray, rows: FloatArray, by_x: FloatArray, joint: FloatArray, known_sd: FloatArray
) -> Observability:
    """What is weak, and of turns about an axis of the box by 90 or 180 degrees the one that would tell most of it."""
    weak_rows = np.flatnonzero(is_weak(np.sqrt(np.diag(joint)), known_sd))
    size = np.sqrt(np.diag(np.linalg.inv(rows.T @ rows)))
    condition = float(np.linalg.cond(rows * size))
    if not weak_rows.size:
        return Observability(condition=condition)
    information = rows.T @ rows
    best: tuple[float, int, float, FloatArray, FloatArray] | None = None
    for axis in range(3):
        for angle_rad in (0.5 * math.pi, math.pi):
            for up_axis in ((axis + 1) % 3, (axis + 2) % 3):
                row, up_after = _imagined(model, x, axis, angle_rad, np.eye(3)[up_axis])
                after = by_x @ np.linalg.inv(information + row.T @ row) @ by_x.T
                left = float(np.sum(np.diag(after)[weak_rows] / known_sd[weak_rows] ** 2))
                if best is None or left < best[0] * (1.0 - 1e-9):
                    best = (left, axis, angle_rad, np.eye(3)[up_axis], up_after)
    weak = tuple(GYROSCOPE_PARAMETERS[i] for i in weak_rows)
    assert best is not None  # there are twelve to choose from
    _, axis, angle_rad, up_before, up_after = best
    first, then = triple(up_before), triple(np.round(up_after, 6))
    advice = (
        f"the recording hardly tells {', '.join(weak)}: add a turn about the box's {AXES[axis]} axis by "
        f"{math.degrees(angle_rad):.0f} degrees, that axis level, from {describe_up(first)} to {describe_up(then)}"
    )
    return Observability(weak, condition, (first, then), advice)


def _imagined(
    model: TurnProblem, x: FloatArray, axis: int, angle_rad: float, up: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """The two rows (2, 12) that a turn at 1 rad/s would add, and up (3,) after it."""
    steps = 32
    t_s = np.linspace(0.0, angle_rad, steps)
    inverse, bias = model.inverse(x), model.bias(x)
    shown = np.tile(bias + np.linalg.inv(inverse)[:, axis], (steps, 1))
    turns = integrate(t_s, shown, np.array([0]), np.array([steps - 1]), inverse, bias[None], model.at_rest.noise)
    up_after = turns.C_a_from_e[0].T @ up
    lever = across(up_after).T @ skew(up_after)
    covariance = lever @ turns.covariance[0] @ lever.T
    rows = lever @ model.turning_by_x(turns, inverse)[0]
    return np.linalg.solve(np.linalg.cholesky(covariance), rows), up_after


def _means(rows: FloatArray, positions: StaticPositions) -> FloatArray:
    return np.array([rows[a:b].mean(axis=0) for a, b in zip(positions.start, positions.end, strict=True)])
