"""Gyroscope axes that are not square: what a turn leaves of tilt, doubted once fixes contradict what came of a turn.

An axis that leans by a degree towards the vertical reads a share of every turn as roll or pitch: after a right angle
the tilt is off by as much. Few boxes are so bad, and to allow for it in all would cost every outage of a good one; so
it is allowed for from the first turn on after which fixes are refused.
"""

from __future__ import annotations

from core.compiled import compiled
from core.measurements import FloatArray
from core.navigation.state import (
    ATT,
    N_STATES,
    X_AXES_VAR,
    X_BRIDGED_S,
    X_HELD_S,
    X_OPENED_TILT,
    X_SATURATED_S,
    X_TURNED,
)
from core.navigation.tuning import PARAMETER

_P_AXES = PARAMETER["gyro_axes_sd_rad"]
_P_FADING = PARAMETER["gyro_axes_fading_s"]

LEAST_TURN_RAD = 0.3
"""A bend by less says nothing of the axes: a degree of lean is 0.3 deg of tilt in it. A choice."""
MOST_TURN_RAD = 2.0
"""However far a car turns, a leaning axis puts the tilt off by twice the lean at most: half a circle."""

UNSOUND_RAD = 30.0
"""Set against turns once samples were unsound: fades away in two minutes, as long as an outage may hide what came of
them. A choice."""


@compiled()
def note_turn(x: FloatArray, dt: float, turn: float, par: FloatArray) -> float:
    """Note an interval's turn (rad) that tilt may be left of; the variance (rad2, each axis) allowed for it so far.

    What clipped, is missing or hangs explains what fixes contradict: turns then say nothing of the axes for a while.
    """
    if x[X_SATURATED_S] + x[X_BRIDGED_S] + x[X_HELD_S] > 0.0:
        x[X_TURNED] = -UNSOUND_RAD
    x[X_TURNED] += abs(turn) - x[X_TURNED] * min(1.0, dt / par[_P_FADING])
    return float(x[X_AXES_VAR] * abs(turn))


@compiled()
def doubt_axes(x: FloatArray, p: FloatArray, par: FloatArray) -> None:
    """Fixes in a row were refused: where that follows a turn, open the tilt, and allow for it in all turns to come."""
    if x[X_TURNED] < LEAST_TURN_RAD:
        return
    lean = par[_P_AXES] * par[_P_AXES]
    opened = lean * min(x[X_TURNED], MOST_TURN_RAD)
    p[ATT * (N_STATES + 1)] += opened
    p[(ATT + 1) * (N_STATES + 1)] += opened
    x[X_OPENED_TILT] += opened
    x[X_AXES_VAR] = lean
    x[X_TURNED] = 0.0
