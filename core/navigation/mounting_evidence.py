"""Observations of how a box sits in the car, and what they add up to: a regression in the level plane.

The mean specific force over some seconds, carried by the gyroscopes to their middle, stands beside the acceleration
that GNSS saw over the very same seconds, laid along and across the direction of travel. In the level plane of the box
the two differ by one rotation, the yaw of the mounting, and by a constant, which is tilt and bias. Written as complex
numbers that is a line through points, whose slope has the yaw as its argument and whose residual says how sure it is.

``m`` are the axes that the samples come in: the sensor's, turned by the nominal mounting if there is one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numba import njit

from core.measurements import FloatArray, TimeArray
from core.navigation.alignment import level
from core.rotation import matrix_from_rpy
from core.tunables import Tunables, tunable

_CHOICE: Final = "choice; checked on the three drives, turned at will, and on simulated ones"


@dataclass(frozen=True, slots=True)
class MountingTuning(Tunables):
    """Tunables of the finder of the mounting."""

    slack_s: float = tunable(1.5, unit="s", low=0.1, high=10, source="choice: one missed fix at 1 Hz")
    min_speed_mps: float = tunable(
        3.0, unit="m/s", low=1, high=20, source="choice: cars reverse slower, and the course is good to 3 deg"
    )
    standing_mps: float = tunable(0.4, unit="m/s", low=0.01, high=2, source="GNSS velocity 0.1 m/s, 4 sd")
    max_accel_mps2: float = tunable(
        6.0, unit="m/s2", low=2, high=20, source="hard braking of cars is 8; a GNSS jump is more"
    )
    mismatch_mps2: float = tunable(
        1.5, unit="m/s2", low=0.1, high=10, source="3 sd of grade, GNSS and bias: else one of the two is wrong"
    )
    noise_mps2: float = tunable(
        0.35,
        unit="m/s2",
        low=0.01,
        high=5,
        source="grade, GNSS, springs, before residuals tell: 0.32-0.37 on the three drives; " + _CHOICE,
    )
    noise_weight: float = tunable(
        2.0, unit="1", low=0, high=100, source="observations that noise_mps2 is worth; " + _CHOICE
    )
    level_weight: float = tunable(
        2.0, unit="1", low=0, high=100, source="observations that rest is worth: the street it stands on slopes too"
    )
    memory_s: float = tunable(
        300.0, unit="s", low=10, high=1e5, source="choice: a box that was moved shows within minutes"
    )

    rest_memory_s: float = tunable(60.0, unit="s", low=5, high=1e4, source="choice: the slope of the street now")

    found_sd_rad: float = tunable(
        0.12, unit="rad", low=0.01, high=0.3, source="7 deg, which the filter's states refine; " + _CHOICE
    )
    patience: float = tunable(
        4.0,
        unit="1",
        low=0,
        high=100,
        source="observations awaited that could speak against the nominal mounting; a choice",
    )
    agreed_sd_rad: float = tunable(
        0.45, unit="rad", low=0.05, high=0.8, source="choice: 26 deg tell quarters apart by 3 sd"
    )
    sd_floor_rad: float = tunable(
        0.025, unit="rad", low=0.001, high=0.2, source="camber, bias, axle not at the box: 1.5 deg"
    )
    level_sd_rad: float = tunable(0.04, unit="rad", low=0.001, high=0.2, source="street of 3 %, bias of 20 mg")
    moving_level_sd_rad: float = tunable(
        0.15, unit="rad", low=0.01, high=1, source="1.5 m/s2 driven unseen, of one second"
    )
    most_tilt_rad: float = tunable(
        0.21, unit="rad", low=0.02, high=1, source="12 deg: the states of the mounting are for small angles"
    )
    most_yaw_rad: float = tunable(0.21, unit="rad", low=0.02, high=1, source="as most_tilt_rad; " + _CHOICE)
    significance: float = tunable(2.5, unit="1", low=1, high=10, source="sd beyond most_tilt_rad or most_yaw_rad")
    least_gain: float = tunable(0.3, unit="1", low=0.1, high=1, source="force over acceleration: 1, less GNSS noise")
    most_gain: float = tunable(1.6, unit="1", low=1, high=5, source="1, and pitching and rolling of the car, 10-20 %")


@dataclass(frozen=True, slots=True)
class Span:
    """How an observation is made: from velocities or from positions, ``span_s`` apart, worth ``weight`` of a free one.

    One is made each second. Slopes and manoeuvres last some seconds, and observations from positions overlap, so
    neighbours are not independent.
    """

    velocity: bool
    span_s: float
    weight: float

    @property
    def fixes(self) -> int:
        """How many it takes: two velocities, or three positions, whose chords are two velocities."""
        return 2 if self.velocity else 3


SPANS: Final = (Span(True, 1.0, 0.5), Span(False, 2.0, 0.4), Span(False, 4.0, 0.2))
"""Positions of 0.3 m are good over 2 s, which manoeuvres last; those of 1.5 m need 4 s. Each adds up on its own."""


@dataclass(frozen=True, slots=True, eq=False)
class MountingEvidence:
    """What observations say: ``C_b_from_m``, what m feels of gravity (``force_m``, m/s2), and sd of tilt and yaw, rad.

    An sd is infinite where nothing is known.
    """

    C_b_from_m: FloatArray
    force_m: FloatArray
    tilt_sd_rad: float
    yaw_sd_rad: float


# Sums of one span: weight, force in m (3), acceleration along and across (2), their products (3 x 2), products of
# force (3 x 3), squares of acceleration.
N, _F, _A, _FA, _FF, _AA, SUMS = 0, 1, 4, 6, 12, 21, 22
REST: Final = 4
"""Sums of rest: seconds, force in m (3)."""


def add_motion(sums: FloatArray, force_m: FloatArray, accel_mps2: FloatArray, weight: float, memory_s: float) -> None:
    """Add the force (3,) felt while accelerating (2,) along and across to ``sums`` (SUMS,), which fade meanwhile."""
    sums *= 1.0 - 1.0 / memory_s
    sums[N] += weight
    sums[_F : _F + 3] += weight * force_m
    sums[_A : _A + 2] += weight * accel_mps2
    sums[_FA : _FA + 6] += weight * np.outer(force_m, accel_mps2).reshape(6)
    sums[_FF : _FF + 9] += weight * np.outer(force_m, force_m).reshape(9)
    sums[_AA] += weight * float(accel_mps2[0] ** 2 + accel_mps2[1] ** 2)


def add_rest(rest: FloatArray, force_m: FloatArray, memory_s: float) -> None:
    """Add a second's force (3,) of standing to ``rest`` (REST,), which fades meanwhile."""
    rest *= 1.0 - 1.0 / memory_s
    rest[0] += 1.0
    rest[1:] += force_m


def regress(sums: FloatArray, rest_sums: FloatArray, t: MountingTuning) -> MountingEvidence:
    """The mounting that fits the observations of one span and those of rest best, and how sure it is.

    Parameters
    ----------
    sums, rest_sums : (SUMS,), (REST,)
    t : tunables
    """
    n, rest = float(sums[N]), min(float(rest_sums[0]), t.level_weight)
    total = n + rest
    if total <= 0.0:
        return MountingEvidence(np.eye(3), np.zeros(3), math.inf, math.inf)
    rest_f = rest_sums[1:] / max(float(rest_sums[0]), 1e-9)
    f = (sums[_F : _F + 3] + rest * rest_f) / total
    a = sums[_A : _A + 2] / total
    fa = sums[_FA : _FA + 6].reshape(3, 2) - total * np.outer(f, a)
    ff = sums[_FF : _FF + 9].reshape(3, 3) + rest * np.outer(rest_f, rest_f) - total * np.outer(f, f)
    aa = float(sums[_AA]) - total * float(a[0] ** 2 + a[1] ** 2)
    seen = n / t.moving_level_sd_rad**2 + (1.0 / t.level_sd_rad**2 if rest >= t.level_weight else 0.0)
    tilt_sd = math.hypot(1.0 / math.sqrt(seen), t.sd_floor_rad) if seen > 0.0 else math.inf

    force, yaw, yaw_sd = f, 0.0, math.inf
    for _ in range(3):  # level, yaw in it, and with the yaw the accelerations that the level is to be freed of
        roll, pitch = level(force)
        C_l_from_m = matrix_from_rpy(roll, pitch, 0.0)
        products = C_l_from_m @ fa
        real, imaginary = products[0, 0] + products[1, 1], products[1, 0] - products[0, 1]
        coherent = math.hypot(real, imaginary)
        if aa <= 0.0 or not t.least_gain * aa <= coherent <= t.most_gain * aa:
            yaw, yaw_sd = 0.0, math.inf
            break
        spread = C_l_from_m @ ff @ C_l_from_m.T
        residual = float(spread[0, 0] + spread[1, 1]) - 2.0 * coherent + aa
        noise = (t.noise_weight * t.noise_mps2**2 + 0.5 * max(residual, 0.0)) / (t.noise_weight + n)
        yaw, yaw_sd = math.atan2(imaginary, real), math.sqrt(noise * aa) / coherent
        if yaw_sd > t.agreed_sd_rad:
            break
        C_m_from_b = C_l_from_m.T @ matrix_from_rpy(0.0, 0.0, yaw)
        force = f - C_m_from_b[:, 0] * a[0] - C_m_from_b[:, 1] * a[1]
    C_b_from_m = matrix_from_rpy(0.0, 0.0, -yaw) @ C_l_from_m
    return MountingEvidence(C_b_from_m, force, tilt_sd, math.hypot(yaw_sd, t.sd_floor_rad))


@njit(cache=True, nogil=True)
def carried_force(t_ns: TimeArray, imu: FloatArray, knots_ns: TimeArray) -> tuple[FloatArray, float, float]:
    """Mean specific force (3,) in the box's axes at the middle of two or three instants, carried by the gyroscopes.

    Of two instants all between weighs the same, as in a change of velocity; of three the weight rises to the second
    and falls to the third, as in the change between two mean velocities. A constant gyroscope bias cancels, since it
    turns what lies before and after the middle against each other.

    Parameters
    ----------
    t_ns, imu : (n,), (n, 6) specific force (m/s2) and rate (rad/s)
    knots_ns : (2,) or (3,)

    Returns
    -------
    the force, the integral of the weight (s), and the longest span without samples (s)
    """
    first, last = knots_ns[0], knots_ns[-1]
    middle = knots_ns[1] if len(knots_ns) == 3 else (first + last) // 2
    rise = (middle - first) * 1e-9 if len(knots_ns) == 3 else 0.0
    fall = (last - middle) * 1e-9 if len(knots_ns) == 3 else 0.0
    total, area, hole = np.zeros(3), 0.0, 0.0
    if len(t_ns) < 2:
        return total, area, np.inf
    hole = max((t_ns[0] - first) * 1e-9, (last - t_ns[-1]) * 1e-9)
    c, at_middle, f = np.eye(3), np.eye(3), np.empty(3)
    passed = False
    for k in range(1, len(t_ns)):
        low, high = max(t_ns[k - 1], first), min(t_ns[k], last)
        if high <= low:
            continue
        dt = (high - low) * 1e-9
        hole = max(hole, (t_ns[k] - t_ns[k - 1]) * 1e-9)
        centre = (low + high) // 2
        if not passed and centre >= middle:
            at_middle[:] = c
            passed = True
        ax = 0.5 * (imu[k - 1, 3] + imu[k, 3]) * dt
        ay = 0.5 * (imu[k - 1, 4] + imu[k, 4]) * dt
        az = 0.5 * (imu[k - 1, 5] + imu[k, 5]) * dt
        weight = dt
        if rise > 0.0:
            weight *= (centre - first) * 1e-9 / rise if centre < middle else (last - centre) * 1e-9 / fall
        fx = 0.5 * (imu[k - 1, 0] + imu[k, 0])
        fy = 0.5 * (imu[k - 1, 1] + imu[k, 1])
        fz = 0.5 * (imu[k - 1, 2] + imu[k, 2])
        # The force turned by half the step: f + a x f / 2. Arrays are made once: this runs over every sample.
        f[0] = fx + 0.5 * (ay * fz - az * fy)
        f[1] = fy + 0.5 * (az * fx - ax * fz)
        f[2] = fz + 0.5 * (ax * fy - ay * fx)
        area += weight
        for i in range(3):
            x, y, z = c[i, 0], c[i, 1], c[i, 2]
            total[i] += weight * (x * f[0] + y * f[1] + z * f[2])
            # c (1 + S + S S / 2) with S = [a x]: a row times S is its cross product with a.
            u, v, w = y * az - z * ay, z * ax - x * az, x * ay - y * ax
            c[i, 0] = x + u + 0.5 * (v * az - w * ay)
            c[i, 1] = y + v + 0.5 * (w * ax - u * az)
            c[i, 2] = z + w + 0.5 * (u * ay - v * ax)
    if area <= 0.0:
        return total, area, np.inf
    return at_middle.T @ total / area, area, hole
