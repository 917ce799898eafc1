"""Horizontal motion of a vehicle from a phone's earth axes: no GNSS, no speed, no axis that is the vehicle's.

Two things are wrong with such a recording, and mended here.

A phone tells gravity by a complementary filter (Mahony, Hamel & Pflimlin 2008): gyroscopes, drawn toward the
accelerometer with gains k_p and k_i. Under a steady acceleration its vertical leans over, so that what it shows is
the true acceleration through s^2 / (s^2 + k_p s + k_i): braking is followed by as much of the opposite. The inverse
of that, a + k_p int a + k_i int int a, drifts, and phones differ in their gains. But a lean turns the specific
force and leaves its length: f^2 = g^2 + a^2, but for what the road does vertically. So the lean is the state of an
extended Kalman filter, driven by what is shown and measured by the length; g is what the phone's own accelerometer
tells of it while nothing is shown. The length has no direction, and tells little of small accelerations: therefore
the integrals fade, and fade fast while the vehicle stands or rolls evenly.

Where the vehicle points in those axes is told by its turns and pulls. Heading relative to the start is the integral
of the yaw rate. In turns the force is across the vehicle and to the side that it turns to; straight ahead it is along
it. So the axis is that of the squares of the accelerations of straight driving, and its sense that of the
accelerations weighed by the yaw rate. Until a first turn has told the sense, what pulls in a turn is taken for
lateral, and what pulls straight ahead is not told.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Final

import numpy as np
import numpy.typing as npt
from numba import njit

from core.driving.horizontal import HorizontalMotion
from core.measurements import FloatArray, TimeArray
from core.tunables import Tunables, tunable


@dataclass(frozen=True, slots=True)
class EarthAxesTuning(Tunables):
    """How a phone's vertical follows, and how fast what is learnt of the direction is forgotten."""

    proportional_ps: float = tunable(
        1.1,
        unit="1/s",
        low=0.0,
        high=10.0,
        source="measured at stops of phone trips: what is shown decays in 1 s",
    )
    integral_ps2: float = tunable(
        0.1, unit="1/s2", low=0.0, high=10.0, source="measured there: an undershoot of a tenth that lasts for 10 s"
    )
    fade_s: float = tunable(
        60.0, unit="s", low=1.0, high=1000.0, source="choice: of the integrals; longer than any manoeuvre lasts"
    )
    quiet_fade_s: float = tunable(
        1.5, unit="s", low=0.1, high=1000.0, source="choice: of the integrals while nothing is shown"
    )
    quiet_mps2: float = tunable(
        0.2, unit="m/s2", low=0.0, high=5.0, source="choice: an engine's shaking and a road's, below low_pass_hz"
    )
    quiet_radps: float = tunable(0.1, unit="rad/s", low=0.0, high=1.0, source="choice: no turn, and any phone's bias")
    lean_share: float = tunable(
        0.5, unit="1", low=0.0, high=10.0, source="choice: of the gain: sd over 1 s; phones' filters differ"
    )
    lean_mps2: float = tunable(
        0.5, unit="m/s2", low=0.0, high=10.0, source="choice: sd by which a lean grows in 1 s without being shown"
    )
    vertical_mps2: float = tunable(
        0.08, unit="m/s2", low=0.001, high=5.0, source="measured while phone trips were quiet, 0.05-0.08: sd over 1 s"
    )
    gravity_mps2: float = tunable(
        0.2, unit="m/s2", low=0.0, high=2.0, source="choice: sd of an accelerometer until gravity is known"
    )
    gravity_s: float = tunable(
        3.0, unit="s", low=0.1, high=60.0, source="choice: quiet time from which on its mean is gravity"
    )
    even_mps2: float = tunable(
        1.5, unit="m/s2", low=0.1, high=10.0, source="choice: more of it hidden is a steady pull"
    )
    low_pass_hz: float = tunable(1.5, unit="Hz", low=0.2, high=20.0, source="choice: of what is learnt from")
    memory_s: float = tunable(
        60.0, unit="s", low=5.0, high=1e4, source="choice: some turns; the yaw rate's bias turns the axis meanwhile"
    )
    bias_s: float = tunable(
        60.0, unit="s", low=1.0, high=1e4, source="choice: quiet time that bias and gravity are means of"
    )
    straight_radps: float = tunable(
        0.1, unit="rad/s", low=0.0, high=1.0, source="choice: 1 m/s2 of lateral force at 36 km/h"
    )
    turn_radps: float = tunable(
        0.2, unit="rad/s", low=0.0, high=10.0, source="choice: 2 m/s2 of lateral force at 36 km/h"
    )
    evidence_mps: float = tunable(
        1.0, unit="m/s", low=0.0, high=100.0, source="choice: rad times m/s2 times s of turns; a quarter turn has 3"
    )
    gap_s: float = tunable(1.0, unit="s", low=0.05, high=60.0, source="choice: across longer everything is begun anew")


(
    _KP, _KI, _FADE, _QUIET_FADE, _QUIET, _QUIET_W, _LEAN_SHARE, _LEAN_SD, _VERTICAL_SD, _GRAVITY_SD, _GRAVITY_S, _EVEN,
    _LOW_PASS, _MEMORY, _BIAS_S, _STRAIGHT, _TURN, _EVIDENCE, _GAP,
) = range(19)  # fmt: skip
(
    _LEAN, _RATE, _SHOWN, _UP, _P, _TRUE, _W, _PSI, _BIAS, _GRAVITY, _QUIET_T, _TURNS, _AXIS, _KNOWN,
) = (0, 2, 4, 6, 7, 10, 12, 13, 14, 15, 16, 17, 19, 21)  # fmt: skip
"""Registers: pairs east, north: the vertical's lean as acceleration and the part of it that is integrated, what is
shown below ``low_pass_hz``; the specific force upward, below it too; the lean's covariance (ee, en, nn); the true
acceleration below ``low_pass_hz``; yaw rate, heading since the start (counter-clockwise), the rate's bias, gravity as
this phone tells it, and the time that both are means of; pairs: evidence of turns and of the axis; how much the turns
told."""
_REGISTERS: Final = 22
_STANDARD_GRAVITY_MPS2: Final = 9.80665
"""What a phone takes off its vertical axis."""


class EarthAxes:
    """Folds earth-axis accelerations into horizontal motion; the same samples give the same rows however cut."""

    def __init__(self, tuning: EarthAxesTuning | None = None) -> None:
        tuning = tuning or EarthAxesTuning()
        self._tuning = np.array([float(getattr(tuning, field.name)) for field in fields(EarthAxesTuning)])
        self._last = np.zeros(1, dtype=np.int64)
        self._values = np.zeros(_REGISTERS)

    def step(
        self,
        t_ns: TimeArray,
        east_mps2: FloatArray,
        north_mps2: FloatArray,
        up_mps2: FloatArray,
        yaw_up_radps: FloatArray,
    ) -> HorizontalMotion:
        """Rows (n,) of acceleration, less standard gravity, and of the rate about up, counter-clockwise.

        Forward and right are NaN while the direction of travel is not known and nothing turns; speed is NaN.
        """
        count = t_ns.shape[0]
        forward, right, yaw = np.empty(count), np.empty(count), np.empty(count)
        _follow(
            np.ascontiguousarray(t_ns),
            np.ascontiguousarray(east_mps2, dtype=np.float64),
            np.ascontiguousarray(north_mps2, dtype=np.float64),
            np.ascontiguousarray(up_mps2, dtype=np.float64),
            np.ascontiguousarray(yaw_up_radps, dtype=np.float64),
            self._last,
            self._values,
            self._tuning,
            forward,
            right,
            yaw,
        )
        return HorizontalMotion(t_ns, forward, right, yaw, np.full(count, np.nan))

    def state(self) -> dict[str, npt.NDArray[np.generic]]:
        """Arrays from which ``load`` goes on, to the bit."""
        return {"earth_axes.last": self._last, "earth_axes.values": self._values}

    def load(self, arrays: Mapping[str, npt.NDArray[np.generic]]) -> None:
        """Go on from a ``state``."""
        self._last = np.array(arrays["earth_axes.last"], dtype=np.int64)
        self._values = np.array(arrays["earth_axes.values"], dtype=np.float64)


@njit(cache=True, nogil=True)
def _follow(
    t_ns: TimeArray,
    east: FloatArray,
    north: FloatArray,
    up: FloatArray,
    yaw_up: FloatArray,
    last: TimeArray,
    v: FloatArray,
    tuning: FloatArray,
    forward: FloatArray,
    right: FloatArray,
    yaw: FloatArray,
) -> None:
    for row in range(t_ns.shape[0]):
        forward[row], right[row], yaw[row] = math.nan, math.nan, math.nan
        a_e, a_n, a_u, w = east[row], north[row], up[row], yaw_up[row]
        if not math.isfinite(a_e + a_n + a_u + w) or t_ns[row] <= last[0]:
            continue
        dt = (t_ns[row] - last[0]) * 1e-9
        if last[0] == 0 or dt > tuning[_GAP]:
            v[:] = 0.0
            v[_UP], v[_GRAVITY] = a_u + _STANDARD_GRAVITY_MPS2, _STANDARD_GRAVITY_MPS2
            dt = 0.0
        last[0] = t_ns[row]
        share = 1.0 - math.exp(-2.0 * math.pi * tuning[_LOW_PASS] * dt)
        v[_SHOWN] += share * (a_e - v[_SHOWN])
        v[_SHOWN + 1] += share * (a_n - v[_SHOWN + 1])
        v[_UP] += share * (a_u + _STANDARD_GRAVITY_MPS2 - v[_UP])
        v[_W] += share * (w - v[_W])
        quiet = _learn_from_quiet(v, dt, tuning)
        fade = math.exp(-dt / (tuning[_QUIET_FADE] if quiet else tuning[_FADE]))
        _lean(v, 0, a_e, dt, fade, tuning)
        _lean(v, 1, a_n, dt, fade, tuning)
        _measure(v, dt, fade, tuning)
        true_e, true_n = a_e + v[_LEAN], a_n + v[_LEAN + 1]
        v[_TRUE] += share * (true_e - v[_TRUE])
        v[_TRUE + 1] += share * (true_n - v[_TRUE + 1])

        turn = v[_W] - v[_BIAS]
        v[_PSI] += (w - v[_BIAS]) * dt
        cosine, sine = math.cos(v[_PSI]), math.sin(v[_PSI])
        # In axes that turn with the vehicle, at a fixed angle to it.
        x, y = cosine * v[_TRUE] + sine * v[_TRUE + 1], cosine * v[_TRUE + 1] - sine * v[_TRUE]
        kept = math.exp(-dt / tuning[_MEMORY])
        # A turn to the left pulls to the left: a quarter turn back is forward.
        v[_TURNS] = kept * v[_TURNS] + turn * y * dt
        v[_TURNS + 1] = kept * v[_TURNS + 1] - turn * x * dt
        if abs(turn) < tuning[_STRAIGHT]:
            v[_AXIS] = kept * v[_AXIS] + (x * x - y * y) * dt
            v[_AXIS + 1] = kept * v[_AXIS + 1] + 2.0 * x * y * dt
        v[_KNOWN] = max(v[_KNOWN], math.hypot(v[_TURNS], v[_TURNS + 1]))

        yaw[row] = -(w - v[_BIAS])
        x, y = cosine * true_e + sine * true_n, cosine * true_n - sine * true_e
        if abs(turn) >= tuning[_TURN]:
            forward[row], right[row] = 0.0, -math.copysign(math.hypot(x, y), turn)
            continue
        if v[_KNOWN] < tuning[_EVIDENCE]:
            continue
        angle = 0.5 * math.atan2(v[_AXIS + 1], v[_AXIS])
        along_x, along_y = math.cos(angle), math.sin(angle)
        if along_x * v[_TURNS] + along_y * v[_TURNS + 1] < 0.0:
            along_x, along_y = -along_x, -along_y
        forward[row], right[row] = along_x * x + along_y * y, along_y * x - along_x * y


@njit(cache=True, nogil=True)
def _learn_from_quiet(v: FloatArray, dt: float, tuning: FloatArray) -> bool:
    """Whether the vehicle stands or rolls evenly; if so the yaw rate is bias, and the specific force gravity."""
    if math.hypot(v[_SHOWN], v[_SHOWN + 1]) >= tuning[_QUIET] or abs(v[_W]) >= tuning[_QUIET_W]:
        return False
    v[_QUIET_T] = min(v[_QUIET_T] + dt, tuning[_BIAS_S])
    if dt > 0.0:
        length = math.sqrt(v[_SHOWN] ** 2 + v[_SHOWN + 1] ** 2 + v[_UP] ** 2)
        v[_BIAS] += dt / v[_QUIET_T] * (v[_W] - v[_BIAS])
        v[_GRAVITY] += dt / max(v[_QUIET_T], tuning[_GRAVITY_S]) * (length - v[_GRAVITY])
    # A steady pull comes to be hidden wholly.
    return bool(math.hypot(v[_TRUE], v[_TRUE + 1]) < tuning[_EVEN])


@njit(cache=True, nogil=True)
def _lean(v: FloatArray, axis: int, shown: float, dt: float, fade: float, tuning: FloatArray) -> None:
    """Carry on what the vertical's lean hides of an axis' acceleration."""
    v[_RATE + axis] = fade * v[_RATE + axis] + tuning[_KI] * shown * dt
    v[_LEAN + axis] = fade * v[_LEAN + axis] + (tuning[_KP] * shown + v[_RATE + axis]) * dt


@njit(cache=True, nogil=True)
def _measure(v: FloatArray, dt: float, fade: float, tuning: FloatArray) -> None:
    """Mend the lean by the length of the specific force, a scalar measurement of an extended Kalman filter."""
    if dt <= 0.0:
        return
    shown_e, shown_n = v[_SHOWN], v[_SHOWN + 1]
    shown2 = shown_e * shown_e + shown_n * shown_n
    grown = ((tuning[_LEAN_SHARE] * tuning[_KP]) ** 2 * shown2 + tuning[_LEAN_SD] ** 2) * dt
    p_ee, p_en, p_nn = fade * fade * v[_P] + grown, fade * fade * v[_P + 1], fade * fade * v[_P + 2] + grown
    a_e, a_n = shown_e + v[_LEAN], shown_n + v[_LEAN + 1]
    innovation = shown2 + v[_UP] ** 2 - v[_GRAVITY] ** 2 - (a_e * a_e + a_n * a_n)
    doubt = tuning[_VERTICAL_SD] ** 2 + (tuning[_GRAVITY_SD] ** 2 if v[_QUIET_T] < tuning[_GRAVITY_S] else 0.0)
    # P H^T, with H = 2 a; what is vertical comes into f^2 with 2 g.
    h_e, h_n = 2.0 * (p_ee * a_e + p_en * a_n), 2.0 * (p_en * a_e + p_nn * a_n)
    variance = 2.0 * (a_e * h_e + a_n * h_n) + (2.0 * _STANDARD_GRAVITY_MPS2) ** 2 * doubt / dt
    v[_LEAN] += h_e / variance * innovation
    v[_LEAN + 1] += h_n / variance * innovation
    v[_P], v[_P + 1], v[_P + 2] = (
        p_ee - h_e * h_e / variance,
        p_en - h_e * h_n / variance,
        p_nn - h_n * h_n / variance,
    )
