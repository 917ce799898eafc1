"""What became of an accident's velocity: a car at rest, or rolling again, tells what clipping hid of its impacts."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from core.accident import trigger
from core.accident.clipping import Whole
from core.accident.level import CLIPPED, GAP, HEADING_COS, HEADING_SIN, REST_S, SPEED, V_X, V_Y, Flags
from core.accident.thresholds import AftermathThresholds
from core.measurements import FloatArray, TimeArray

Pair = tuple[float, float]
"""A horizontal vector in the level frame."""
Spread = tuple[float, float, float]
"""Its covariance: xx, xy, yy."""


@dataclass(frozen=True, slots=True)
class Momentum:
    """Velocity as an accident's first impact began, and what its clipped impacts hide, in the level frame, SI units.

    Parameters
    ----------
    t_ns, integral, velocity : the time, the integrated acceleration then, and the velocity by the filter
    clipped_ns, gaps : registers of ``trigger`` then
    heading : cosine and sine of the vehicle's as the worst impact began
    worst, worst_spread, worst_read : that impact's change of velocity, and as it was read; None where it did not clip
    hidden, hidden_spread : of all clipped impacts, what their changes exceed what was read, summed
    within_ns : for how long samples clipped within them
    """

    t_ns: int
    integral: Pair
    velocity: Pair
    clipped_ns: int
    gaps: int
    heading: Pair
    worst: Pair | None = None
    worst_spread: Spread = (0.0, 0.0, 0.0)
    worst_read: Pair = (0.0, 0.0)
    hidden: Pair = (0.0, 0.0)
    hidden_spread: Spread = (0.0, 0.0, 0.0)
    within_ns: int = 0

    @staticmethod
    def of(kept: Mapping[str, Any]) -> Momentum:
        """Of what ``asdict`` and JSON made of one."""
        fields: dict[str, Any] = {name: tuple(v) if isinstance(v, list) else v for name, v in kept.items()}
        return Momentum(**fields)


def begun(t_ns: TimeArray, x: FloatArray, flags: Flags, first: int, row: int, registers: TimeArray) -> Momentum:
    """As the first impact began at row ``first``, with ``registers`` of ``row``."""
    cos, sin, speed = (float(x[first, column]) for column in (HEADING_COS, HEADING_SIN, SPEED))
    return Momentum(
        t_ns=int(t_ns[first]),
        integral=(float(x[first, V_X]), float(x[first, V_Y])),
        velocity=(speed * cos, speed * sin),
        clipped_ns=int(registers[trigger.CLIPPED_NS]) - _clipped_ns(t_ns, flags, first, row),
        gaps=int(registers[trigger.GAPS]) - int(np.count_nonzero(flags[first + 1 : row + 1] & GAP)),
        heading=(cos, sin),
    )


def struck(
    was: Momentum,
    t_ns: TimeArray,
    x: FloatArray,
    flags: Flags,
    rows: tuple[int, int],
    whole: Whole | None,
    *,
    worst: bool,
) -> Momentum:
    """With a further impact between two rows, ``whole`` what it was where it clipped."""
    first, last = rows
    heading = float(x[first, HEADING_COS]), float(x[first, HEADING_SIN])
    if whole is None:
        return replace(was, worst=None, heading=heading) if worst else was
    turn = np.array([[heading[0], -heading[1]], [heading[1], heading[0]]])
    mean, spread = turn @ whole.mean_mps, turn @ whole.covariance @ turn.T
    read = x[last, [V_X, V_Y]] - x[first, [V_X, V_Y]]
    found = replace(
        was,
        hidden=_pair(np.array(was.hidden) + mean - read),
        hidden_spread=_spread(_matrix(was.hidden_spread) + spread),
        within_ns=was.within_ns + _clipped_ns(t_ns, flags, first, last),
    )
    if not worst:
        return found
    return replace(found, heading=heading, worst=_pair(mean), worst_spread=_spread(spread), worst_read=_pair(read))


def settled(
    was: Momentum, t_ns: TimeArray, x: FloatArray, row: int, registers: TimeArray, limits: AftermathThresholds
) -> tuple[FloatArray, FloatArray] | None:
    """The worst impact's change of velocity along forward and right at its start with its covariance, m/s.

    At rest the velocity is zero, and what the accelerometer then reads is its error; a car that rolls goes where it
    heads as fast as the filter says. What the velocity changed by more than was read was hidden by clipping: one
    measurement of the sum over the impacts, by which the worst one's is corrected as a Kalman filter does.

    None where no impact clipped, or nothing is known: no speed before, a gap, or less than was read, which clipping
    cannot have made too large.
    """
    if was.worst is None or not math.isfinite(was.velocity[0]) or int(registers[trigger.GAPS]) != was.gaps:
        return None
    integral, velocity = x[row, [V_X, V_Y]] - np.array(was.integral), np.array(was.velocity)
    since_s = (t_ns[row] - was.t_ns) * 1e-9
    rest_s = min(float(x[row, REST_S]), limits.bias_s)
    if rest_s > 0.5 * limits.bias_s:
        begin = int(np.searchsorted(t_ns, t_ns[row] - round(rest_s * 1e9)))
        error = (x[row, [V_X, V_Y]] - x[begin, [V_X, V_Y]]) / max((t_ns[row] - t_ns[begin]) * 1e-9, 1e-3)
        after, integral = np.zeros(2), integral - error * since_s
        sd = limits.rest_error_mps2 * since_s
    elif float(x[row, SPEED]) > limits.rolling_mps:
        after = float(x[row, SPEED]) * x[row, [HEADING_COS, HEADING_SIN]]
        sd = limits.error_mps2 * since_s
    else:
        return None
    # What clipped outside of the impacts hides a change of velocity too, of the order of what it read.
    outside_s = max(int(registers[trigger.CLIPPED_NS]) - was.clipped_ns - was.within_ns, 0) * 1e-9
    variance = sd * sd + limits.speed_sd_mps**2 + (limits.outside_mps2 * outside_s) ** 2
    innovation = after - velocity - integral - np.array(was.hidden)
    prior, spread = _matrix(was.hidden_spread), _matrix(was.worst_spread)
    known = variance * np.eye(2)
    # A pulse that no assumed shape is like: as the measurement contradicts them, the shapes say that much less.
    surprise = float(innovation @ np.linalg.solve(prior + known, innovation)) / limits.contradiction
    prior, spread = max(surprise, 1.0) * prior, max(surprise, 1.0) * spread
    gain = spread @ np.linalg.inv(prior + known)
    mean, spread = np.array(was.worst) + gain @ innovation, spread - gain @ spread
    read = np.array(was.worst_read)
    if float(mean @ read) < limits.read_share * float(read @ read):
        return None
    cos, sin = was.heading
    turn = np.array([[cos, sin], [-sin, cos]])
    return turn @ mean, turn @ spread @ turn.T


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
