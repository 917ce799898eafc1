"""Acceleration in the horizontal plane, along and across the vehicle: what manoeuvres are judged by."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit

from core.accident.events import VehicleMotion
from core.measurements import FloatArray, TimeArray
from core.tunables import Tunables, tunable


@dataclass(frozen=True, slots=True, eq=False)
class HorizontalMotion:
    """Rows (n,) of a vehicle's motion in the horizontal plane.

    Parameters
    ----------
    t_ns : int64, increasing
    forward_mps2, right_mps2 : acceleration along and across the vehicle, gravity removed; NaN where unknown
    yaw_radps : rate of turn about the vertical, clockwise seen from above, as right is
    speed_mps : NaN where unknown
    """

    t_ns: TimeArray
    forward_mps2: FloatArray
    right_mps2: FloatArray
    yaw_radps: FloatArray
    speed_mps: FloatArray


@dataclass(frozen=True, slots=True)
class LevellingTuning(Tunables):
    """How what the accelerometer is off by in the horizontal plane is learnt from the fused speed."""

    memory_s: float = tunable(
        60.0, unit="s", low=5.0, high=1e4, source="choice: longer than a manoeuvre, shorter than biases take to walk"
    )
    least_s: float = tunable(
        15.0, unit="s", low=0.0, high=600.0, source="choice: of known speed before anything is told; alignment settles"
    )
    gap_s: float = tunable(1.0, unit="s", low=0.05, high=60.0, source="choice: across longer no speed is differenced")


_OFF_FORWARD, _OFF_RIGHT, _KNOWN_S, _SPEED = range(4)


class Levelling:
    """Folds fused samples into horizontal motion; the same samples give the same rows however they are cut.

    Grade and banking are in the attitude, so they leave with gravity. Forward is the body's x axis laid level. What
    the accelerometer's bias and an error of tilt leave shows over a minute, as the speed tells what the mean of the
    acceleration has to be: its change along, and the speed times the rate of turn across.
    """

    def __init__(self, tuning: LevellingTuning | None = None) -> None:
        self._tuning = tuning or LevellingTuning()
        self._last = np.zeros(1, dtype=np.int64)
        self._values = np.array([0.0, 0.0, 0.0, math.nan])

    def step(self, motion: VehicleMotion) -> HorizontalMotion:
        """Rows as many as samples; NaN while the attitude is not known, or the speed for less than ``least_s``."""
        f, down, omega = motion.f_b, motion.down_b, motion.omega_b
        d_x, d_y, d_z = down[:, 0], down[:, 1], down[:, 2]
        g = motion.gravity_mps2
        a_x, a_y, a_z = f[:, 0] + g * d_x, f[:, 1] + g * d_y, f[:, 2] + g * d_z
        # The level axes: forward = x - (x . down) down over its length, right = down x forward.
        level = np.sqrt(np.maximum(1.0 - d_x * d_x, 1e-12))
        along_down = a_x * d_x + a_y * d_y + a_z * d_z
        forward = (a_x - along_down * d_x) / level
        right = (d_z * a_y - d_y * a_z) / level
        yaw = omega[:, 0] * d_x + omega[:, 1] * d_y + omega[:, 2] * d_z
        tuning = self._tuning
        _without_offset(
            np.ascontiguousarray(motion.t_ns),
            forward,
            right,
            yaw,
            np.ascontiguousarray(motion.speed_mps),
            self._last,
            self._values,
            tuning.memory_s,
            tuning.least_s,
            tuning.gap_s,
        )
        return HorizontalMotion(motion.t_ns, forward, right, yaw, motion.speed_mps)

    def state(self) -> dict[str, npt.NDArray[np.generic]]:
        """Arrays from which ``load`` goes on, to the bit."""
        return {"levelling.last": self._last, "levelling.values": self._values}

    def load(self, arrays: Mapping[str, npt.NDArray[np.generic]]) -> None:
        """Go on from a ``state``."""
        self._last = np.array(arrays["levelling.last"], dtype=np.int64)
        self._values = np.array(arrays["levelling.values"], dtype=np.float64)


@njit(cache=True, nogil=True)
def _without_offset(
    t_ns: TimeArray,
    forward: FloatArray,
    right: FloatArray,
    yaw: FloatArray,
    speed: FloatArray,
    last: TimeArray,
    v: FloatArray,
    memory_s: float,
    least_s: float,
    gap_s: float,
) -> None:
    """Take the offsets learnt so far from the rows, in place, and learn on."""
    for row in range(t_ns.shape[0]):
        dt = (t_ns[row] - last[0]) * 1e-9
        now = speed[row]
        if dt <= 0.0:
            forward[row] = right[row] = math.nan
            continue
        a_x, a_y = forward[row], right[row]
        whole = math.isfinite(now + a_x + a_y + yaw[row])
        if last[0] != 0 and dt <= gap_s and whole and math.isfinite(v[_SPEED]):
            v[_KNOWN_S] += dt
            share = dt / min(v[_KNOWN_S], memory_s)
            v[_OFF_FORWARD] += share * (a_x - (now - v[_SPEED]) / dt - v[_OFF_FORWARD])
            v[_OFF_RIGHT] += share * (a_y - now * yaw[row] - v[_OFF_RIGHT])
        last[0], v[_SPEED] = t_ns[row], now if whole else math.nan
        if v[_KNOWN_S] < least_s:
            forward[row] = right[row] = math.nan
        else:
            forward[row], right[row] = a_x - v[_OFF_FORWARD], a_y - v[_OFF_RIGHT]
