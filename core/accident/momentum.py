"""What became of an accident's velocity: a car at rest, or rolling again, tells what clipping hid of its impacts."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from core.accident import trigger
from core.accident.clipping import Whole
from core.accident.events import Impact, impact_of
from core.accident.level import CLIPPED, GAP, HEADING_COS, HEADING_SIN, REST_S, SPEED, V_X, V_Y, YAW_RATE, Flags
from core.accident.thresholds import AftermathThresholds
from core.measurements import FloatArray, TimeArray

MOST_BLOWS: Final = 16
"""Of so many impacts no sum over them says anything of one. A choice, so that an accident's state stays small."""

Pair = tuple[float, float]
"""A horizontal vector in the level frame."""
Spread = tuple[float, float, float]
"""Its covariance: xx, xy, yy."""


@dataclass(frozen=True, slots=True)
class Blow:
    """One impact of an accident: as it was told, and its change of velocity in the level frame, SI units.

    Parameters
    ----------
    impact : as it was told, or would have been if it were the worst
    end_ns : when it was over
    heading : cosine and sine of the vehicle's as it began
    read : change of velocity as it was read
    mean, spread : as estimated; where it did not clip, what was read, and zeros
    """

    impact: Impact
    end_ns: int
    heading: Pair
    read: Pair
    mean: Pair
    spread: Spread = (0.0, 0.0, 0.0)

    @staticmethod
    def of(kept: Mapping[str, Any]) -> Blow:
        """Of what ``asdict`` and JSON made of one."""
        pairs = {name: tuple(kept[name]) for name in ("heading", "read", "mean", "spread")}
        return Blow(**(dict(kept) | pairs | {"impact": impact_of(kept["impact"])}))


@dataclass(frozen=True, slots=True)
class Check:
    """What the velocity had changed by at a time, m/s, level frame, beyond what was read, after so many impacts."""

    after: int
    hidden: Pair
    sd_mps: float


@dataclass(frozen=True, slots=True)
class Momentum:
    """Velocity as an accident's first impact began, and the impacts that share what became of it; SI units.

    Parameters
    ----------
    t_ns, integral, velocity : the time, the integrated acceleration then, and the velocity by the filter, level frame
    clipped_ns, gaps : registers of ``trigger`` then
    blows : the impacts so far
    checks : what the velocity said between them
    within_ns : for how long samples clipped within them
    """

    t_ns: int
    integral: Pair
    velocity: Pair
    clipped_ns: int
    gaps: int
    blows: tuple[Blow, ...] = ()
    checks: tuple[Check, ...] = ()
    within_ns: int = 0

    @staticmethod
    def of(kept: Mapping[str, Any]) -> Momentum:
        """Of what ``asdict`` and JSON made of one."""
        pairs = {name: tuple(kept[name]) for name in ("integral", "velocity")}
        checks = tuple(Check(one["after"], tuple(one["hidden"]), one["sd_mps"]) for one in kept["checks"])
        blows = tuple(Blow.of(blow) for blow in kept["blows"])
        return Momentum(**(dict(kept) | pairs | {"blows": blows, "checks": checks}))


def begun(t_ns: TimeArray, x: FloatArray, flags: Flags, first: int, row: int, registers: TimeArray) -> Momentum:
    """As the first impact began at row ``first``, with ``registers`` of ``row``."""
    cos, sin, speed = (float(x[first, column]) for column in (HEADING_COS, HEADING_SIN, SPEED))
    return Momentum(
        t_ns=int(t_ns[first]),
        integral=(float(x[first, V_X]), float(x[first, V_Y])),
        velocity=(speed * cos, speed * sin),
        clipped_ns=int(registers[trigger.CLIPPED_NS]) - _clipped_ns(t_ns, flags, first, row),
        gaps=int(registers[trigger.GAPS]) - int(np.count_nonzero(flags[first + 1 : row + 1] & GAP)),
    )


def struck(
    was: Momentum,
    impact: Impact,
    t_ns: TimeArray,
    x: FloatArray,
    flags: Flags,
    rows: tuple[int, int],
    whole: Whole | None,
) -> Momentum:
    """With a further impact between two rows, ``whole`` what it was where it clipped."""
    first, last = rows
    heading = float(x[first, HEADING_COS]), float(x[first, HEADING_SIN])
    read = _pair(x[last, [V_X, V_Y]] - x[first, [V_X, V_Y]])
    if whole is None:
        return replace(was, blows=(*was.blows, Blow(impact, int(t_ns[last]), heading, read, read)))
    turn = np.array([[heading[0], -heading[1]], [heading[1], heading[0]]])
    mean, spread = turn @ whole.mean_mps, turn @ whole.covariance @ turn.T
    return replace(
        was,
        blows=(*was.blows, Blow(impact, int(t_ns[last]), heading, read, _pair(mean), _spread(spread))),
        within_ns=was.within_ns + _clipped_ns(t_ns, flags, first, last),
    )


def checked(
    was: Momentum,
    t_ns: TimeArray,
    x: FloatArray,
    flags: Flags,
    rows: tuple[int, int],
    registers: TimeArray,
    limits: AftermathThresholds,
) -> Momentum:
    """With what the velocity says at the first of ``rows``, where tyres hold the car to its heading again.

    The second row is that of ``registers``. The filter's speed lacks what clipping hid until fixes take that back.
    """
    row = rows[0]
    spread = sum((_matrix(blow.spread) for blow in was.blows), start=np.zeros((2, 2)))
    since_last_s = (t_ns[row] - was.blows[-1].end_ns) * 1e-9 if was.blows else 0.0
    slides = since_last_s < limits.sliding_s or abs(float(x[row, YAW_RATE])) > limits.sliding_radps
    if slides or math.isnan(float(x[row, SPEED])):
        return was
    hidden_mps = math.sqrt(0.5 * float(np.trace(spread))) * math.exp(-since_last_s / limits.recovery_s)
    clipped_ns = int(registers[trigger.CLIPPED_NS]) - _clipped_ns(t_ns, flags, *rows) - was.clipped_ns
    outside_mps = limits.outside_mps2 * max(clipped_ns - was.within_ns, 0) * 1e-9
    error_mps = limits.error_mps2 * (t_ns[row] - was.t_ns) * 1e-9
    after, speed_sd_mps = _velocity(x, row, limits)
    sd = math.hypot(error_mps, speed_sd_mps, hidden_mps, outside_mps)
    change = after - np.array(was.velocity) - (x[row, [V_X, V_Y]] - np.array(was.integral))
    return replace(was, checks=(*was.checks, Check(len(was.blows), _pair(change), sd)))


def settled(
    was: Momentum, t_ns: TimeArray, x: FloatArray, row: int, registers: TimeArray, limits: AftermathThresholds
) -> tuple[int, FloatArray, FloatArray] | None:
    """Which impact was the worst, and of each the change of velocity along forward and right at its start, (n, 2), with
    covariance, (n, 2, 2), SI units.

    At rest the velocity is zero, and what the accelerometer then reads is its error; a car that rolls goes where it
    heads as fast as the filter says. What the velocity changed by more than was read was hidden by clipping: a
    measurement of the sum over the impacts before, by which each is corrected as a Kalman filter does. Which was the
    worst is seen only then.

    None where no impact clipped, or nothing is known: no speed before, a gap, a velocity that no pulse of any shape
    could bring about, or less than was read, which clipping cannot have made too large.
    """
    clipped = any(any(blow.spread) for blow in was.blows)
    if not clipped or not math.isfinite(was.velocity[0]) or int(registers[trigger.GAPS]) != was.gaps:
        return None
    last = _last_check(was, t_ns, x, row, registers, limits)
    checks = was.checks if last is None else (*was.checks, last)
    if not checks:
        return None
    n = 2 * len(was.blows)
    prior, means = np.zeros((n, n)), np.array([blow.mean for blow in was.blows]).ravel()
    hidden = means - np.array([blow.read for blow in was.blows]).ravel()
    for k, blow in enumerate(was.blows):
        prior[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = _matrix(blow.spread)
    sums = np.vstack([np.tile(np.eye(2), (1, n // 2)) * (np.arange(n) < 2 * check.after) for check in checks])
    known = np.diag(np.repeat([check.sd_mps**2 for check in checks], 2))
    innovation = np.array([check.hidden for check in checks]).ravel() - sums @ hidden
    # Pulses that no assumed shape is like: as the measurements contradict them, the shapes say that much less.
    surprise = float(innovation @ np.linalg.solve(sums @ prior @ sums.T + known, innovation))
    if surprise > limits.refuted * len(checks):
        return None
    prior = prior * max(surprise / (limits.contradiction * len(checks)), 1.0)
    gain = prior @ sums.T @ np.linalg.inv(sums @ prior @ sums.T + known)
    means, spread = means + gain @ innovation, prior - gain @ sums @ prior
    blows = [slice(2 * k, 2 * k + 2) for k in range(len(was.blows))]
    at = max(range(len(blows)), key=lambda k: math.hypot(*means[blows[k]]))
    read = np.array(was.blows[at].read)
    if float(means[blows[at]] @ read) < limits.read_share * float(read @ read):
        return None
    turns = [np.array([[cos, sin], [-sin, cos]]) for cos, sin in (blow.heading for blow in was.blows)]
    return (
        at,
        np.array([turn @ means[its] for turn, its in zip(turns, blows, strict=True)]),
        np.array([turn @ spread[its, its] @ turn.T for turn, its in zip(turns, blows, strict=True)]),
    )


def _last_check(
    was: Momentum, t_ns: TimeArray, x: FloatArray, row: int, registers: TimeArray, limits: AftermathThresholds
) -> Check | None:
    """What the velocity says in the end, at rest or rolling on."""
    integral = x[row, [V_X, V_Y]] - np.array(was.integral)
    since_s = (t_ns[row] - was.t_ns) * 1e-9
    rest_s = min(float(x[row, REST_S]), limits.bias_s)
    if rest_s > 0.5 * limits.bias_s:
        begin = int(np.searchsorted(t_ns, t_ns[row] - round(rest_s * 1e9)))
        error = (x[row, [V_X, V_Y]] - x[begin, [V_X, V_Y]]) / max((t_ns[row] - t_ns[begin]) * 1e-9, 1e-3)
        after, integral = np.zeros(2), integral - error * since_s
        sd = math.hypot(limits.rest_error_mps2 * since_s, limits.speed_sd_mps)
    elif math.isnan(float(x[row, SPEED])):
        return None
    else:
        after, speed_sd_mps = _velocity(x, row, limits)
        sd = math.hypot(limits.error_mps2 * since_s, speed_sd_mps)
    # What clipped outside of the impacts hides a change of velocity too, of the order of what it read.
    outside_s = max(int(registers[trigger.CLIPPED_NS]) - was.clipped_ns - was.within_ns, 0) * 1e-9
    sd = math.hypot(sd, limits.outside_mps2 * outside_s)
    return Check(len(was.blows), _pair(after - np.array(was.velocity) - integral), sd)


def _velocity(x: FloatArray, row: int, limits: AftermathThresholds) -> tuple[FloatArray, float]:
    """Of a car that goes where it heads as fast as the filter says, level frame, and its sd, m/s; a slow one may as
    well be pushed backwards."""
    speed = float(x[row, SPEED])
    unknown = speed if speed < limits.rolling_mps else 0.0
    return speed * x[row, [HEADING_COS, HEADING_SIN]], math.hypot(limits.speed_sd_mps, unknown)


def _clipped_ns(t_ns: TimeArray, flags: Flags, first: int, last: int) -> int:
    """For how long samples clipped after ``first`` up to ``last``."""
    steps = np.diff(t_ns[first : last + 1])
    return int(np.sum(steps[(flags[first + 1 : last + 1] & (CLIPPED | GAP)) == CLIPPED]))


def _pair(vector: FloatArray) -> Pair:
    return float(vector[0]), float(vector[1])


def _spread(matrix: FloatArray) -> Spread:
    return float(matrix[0, 0]), float(matrix[0, 1]), float(matrix[1, 1])


def _matrix(spread: Spread) -> FloatArray:
    xx, xy, yy = spread
    return np.array([[xx, xy], [xy, yy]])
