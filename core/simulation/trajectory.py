"""Exact truth of a drive on the rotating ellipsoid: where the car was and what a perfect box feels there.

Velocity and attitude are smooth functions of time with known derivatives, so that specific force and
angular rate at a sample are exact values of that motion, not differences of positions.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numba import njit

from core.earth import EARTH_RATE_RADPS, gravity_mps2, radii_m
from core.errors import InvalidInputError
from core.measurements import FloatArray
from core.rotation import wrap_angle_rad
from core.simulation.route import Route
from core.tunables import Tunables, tunable

_MAX_STEP_S = 0.0025
"""Longest step of the integration, s: 1/80 of the shortest period of the suspension."""

_BUMP_WINDOW_S = 60.0
"""A car that stands on a bump for longer is taken to have left it, s."""

_BLOCK = 20_000
"""Samples worked on at a time, so that a drive of hours needs little memory."""

_LAT, _LON, _ALT, _HEAVE, _HEAVE_RATE, _ROLL, _ROLL_RATE, _PITCH, _PITCH_RATE = range(9)


@dataclass(frozen=True, slots=True)
class Suspension(Tunables):
    """How the body moves on its springs: heave, roll and pitch as damped second-order systems."""

    heave_hz: float = tunable(
        1.3, unit="Hz", low=0.5, high=5.0, source="passenger cars 1-1.5 Hz (Gillespie 1992, ch. 5)"
    )
    tilt_hz: float = tunable(1.6, unit="Hz", low=0.5, high=5.0, source="choice: roll and pitch a little above heave")
    damping_ratio: float = tunable(0.35, unit="1", low=0.1, high=1.0, source="0.2-0.4 (Gillespie 1992, ch. 5)")
    roll_rad_per_mps2: float = tunable(
        0.0089, unit="rad/(m/s2)", low=0.0, high=0.03, source="5 deg/g; cars 3-7 deg/g (Gillespie 1992, ch. 6)"
    )
    pitch_rad_per_mps2: float = tunable(
        0.0036, unit="rad/(m/s2)", low=0.0, high=0.03, source="2 deg/g: choice, a firm car's dive under braking"
    )
    wheelbase_m: float = tunable(2.6, unit="m", low=1.5, high=5.0, source="compact car")


RIGID: Final = Suspension(roll_rad_per_mps2=0.0, pitch_rad_per_mps2=0.0)
"""No springs: on a smooth road the body points along its path."""


@dataclass(frozen=True, slots=True)
class Place:
    """Where a drive begins (rad, ellipsoidal m) and the magnetic field there (NED, microtesla)."""

    lat_rad: float
    lon_rad: float
    alt_m: float
    field_n_ut: tuple[float, float, float]


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """Truth at each sample: ``t_s``, ``lat_rad``, ``lon_rad``, ``alt_m`` (n,); the rest (n, 3).

    ``rpy_rad`` is roll, pitch, yaw; ``f_b`` (m/s2) and ``omega_b`` (rad/s) are instantaneous values
    of specific force and of the rate against inertial space.
    """

    t_s: FloatArray
    lat_rad: FloatArray
    lon_rad: FloatArray
    alt_m: FloatArray
    v_n: FloatArray
    rpy_rad: FloatArray
    f_b: FloatArray
    omega_b: FloatArray

    @property
    def speed_mps(self) -> FloatArray:
        """Horizontal speed, (n,), m/s."""
        return np.hypot(self.v_n[:, 0], self.v_n[:, 1])


def drive(route: Route, place: Place, rate_hz: float, suspension: Suspension | None = None) -> Trajectory:
    """Drive a route from a place and note the truth ``rate_hz`` times a second, from 0 s on.

    The navigation equations are Groves (2013) eq. 5.44-5.54 solved for the inertial measurements.

    Raises
    ------
    InvalidInputError
        If the rate is outside 10 to 1000 Hz or the route shorter than a second.
    """
    if not 10.0 <= rate_hz <= 1000.0:
        raise InvalidInputError(f"rate_hz is {rate_hz}: expected 10 to 1000 Hz")
    if not route.duration_s >= 1.0:
        raise InvalidInputError(f"a drive of {route.duration_s} s: expected at least 1 s")
    springs = suspension or Suspension()
    per_sample = math.ceil(1.0 / (rate_hz * _MAX_STEP_S))
    samples = math.floor(route.duration_s * rate_hz) + 1
    step_s = 1.0 / (rate_hz * per_sample)
    parts: list[Trajectory] = []
    state = np.zeros(9)
    state[:3] = place.lat_rad, place.lon_rad, place.alt_m
    for first in range(0, samples, _BLOCK):
        count = min(_BLOCK, samples - first)
        # RK4 looks at the ends and the middle of each step; the last step leads to the next block.
        half_steps = np.arange(2 * per_sample * first, 2 * per_sample * (first + count) + 1) * np.float64(step_s / 2)
        motion = _Motion.of(route, half_steps, springs)
        states, heave_accel = _integrate(
            state,
            motion.v_road_n,
            motion.heave_drive,
            motion.tilt_drive,
            step_s,
            per_sample,
            np.array([springs.heave_hz, springs.tilt_hz]) * 2 * np.pi,
            springs.damping_ratio,
        )
        state = states[-1]
        t_s = (first + np.arange(count)) / rate_hz
        parts.append(_truth(t_s, motion.at_samples(2 * per_sample), states[:-1], heave_accel))
    names = Trajectory.__slots__
    return Trajectory(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in names})


@dataclass(frozen=True, slots=True, eq=False)
class _Motion:
    """The route's functions at given times: what needs no integration."""

    heading: FloatArray
    heading_rate: FloatArray
    grade: FloatArray
    grade_rate: FloatArray
    v_road_n: FloatArray
    v_road_n_dot: FloatArray
    heave_drive: FloatArray
    tilt_drive: FloatArray

    @classmethod
    def of(cls, route: Route, t_s: FloatArray, springs: Suspension) -> _Motion:
        heading, heading_rate = route.heading_rad.at(t_s)
        grade, grade_rate = route.grade_rad.at(t_s)
        tyres, tyres_rate = route.forward_by_tyres.at(t_s)
        slide, slide_rate = route.right_by_tyres.at(t_s)
        impact, impact_rate = route.forward_by_impacts.at(t_s)
        push, push_rate = route.right_by_impacts.at(t_s)
        u, u_dot = tyres + impact, tyres_rate + impact_rate
        w, w_dot = slide + push, slide_rate + push_rate
        cg, sg, ch, sh = np.cos(grade), np.sin(grade), np.cos(heading), np.sin(heading)
        zero = np.zeros_like(u)
        along = np.column_stack([cg * ch, cg * sh, -sg])
        along_dot = np.column_stack(
            [
                -sg * grade_rate * ch - cg * sh * heading_rate,
                -sg * grade_rate * sh + cg * ch * heading_rate,
                -cg * grade_rate,
            ]
        )
        right = np.column_stack([-sh, ch, zero])
        right_dot = np.column_stack([-ch * heading_rate, -sh * heading_rate, zero])
        front, front_rate = _road_height(route, t_s, u, 0.0)
        rear, rear_rate = _road_height(route, t_s, u, springs.wheelbase_m)
        lateral = u * heading_rate + slide_rate
        roll_wanted = -springs.roll_rad_per_mps2 * lateral
        pitch_wanted = springs.pitch_rad_per_mps2 * tyres_rate + (front - rear) / springs.wheelbase_m
        return cls(
            heading=heading,
            heading_rate=heading_rate,
            grade=grade,
            grade_rate=grade_rate,
            v_road_n=u[:, None] * along + w[:, None] * right,
            v_road_n_dot=u_dot[:, None] * along
            + u[:, None] * along_dot
            + w_dot[:, None] * right
            + w[:, None] * right_dot,
            heave_drive=np.column_stack([(front + rear) / 2, (front_rate + rear_rate) / 2]),
            tilt_drive=np.column_stack([roll_wanted, pitch_wanted]),
        )

    def at_samples(self, stride: int) -> _Motion:
        """The same at every ``stride``-th time but the last, which belongs to the next block."""
        return _Motion(*(getattr(self, name)[:-1:stride] for name in self.__slots__))


def _road_height(route: Route, t_s: FloatArray, u: FloatArray, behind_m: float) -> tuple[FloatArray, FloatArray]:
    """Height of the road under an axle and its rate as the car goes over it, (n,) each."""
    height, rate = np.zeros_like(u), np.zeros_like(u)
    for bump in route.bumps:
        if bump.start_s > t_s[-1] or bump.start_s + _BUMP_WINDOW_S < t_s[0]:
            continue
        near_s = bump.start_s + np.arange(0.0, _BUMP_WINDOW_S, 0.001)
        speed = route.forward_by_tyres.at(near_s)[0] + route.forward_by_impacts.at(near_s)[0]
        distance = np.concatenate([[0.0], np.cumsum((speed[1:] + speed[:-1]) / 2 * 0.001)])
        along = np.interp(t_s, near_s, distance, left=0.0) - behind_m
        inside = (along > 0.0) & (along < bump.length_m)
        phase = 2 * np.pi * along[inside] / bump.length_m
        height[inside] += bump.height_m / 2 * (1.0 - np.cos(phase))
        rate[inside] += bump.height_m * np.pi / bump.length_m * np.sin(phase) * u[inside]
    return height, rate


@njit(cache=True, nogil=True)
def _rates(
    state: FloatArray, v_road: FloatArray, heave: FloatArray, tilt: FloatArray, omega: FloatArray, zeta: float
) -> FloatArray:
    d = np.empty(9)
    meridian, transverse = radii_m(state[_LAT])
    d[_LAT] = v_road[0] / (meridian + state[_ALT])
    d[_LON] = v_road[1] / ((transverse + state[_ALT]) * math.cos(state[_LAT]))
    d[_ALT] = -v_road[2] + state[_HEAVE_RATE]
    d[_HEAVE] = state[_HEAVE_RATE]
    d[_HEAVE_RATE] = omega[0] ** 2 * (heave[0] - state[_HEAVE]) + 2 * zeta * omega[0] * (heave[1] - state[_HEAVE_RATE])
    d[_ROLL] = state[_ROLL_RATE]
    d[_ROLL_RATE] = omega[1] ** 2 * (tilt[0] - state[_ROLL]) - 2 * zeta * omega[1] * state[_ROLL_RATE]
    d[_PITCH] = state[_PITCH_RATE]
    d[_PITCH_RATE] = omega[1] ** 2 * (tilt[1] - state[_PITCH]) - 2 * zeta * omega[1] * state[_PITCH_RATE]
    return d


@njit(cache=True, nogil=True)
def _integrate(
    start: FloatArray,
    v_road: FloatArray,
    heave: FloatArray,
    tilt: FloatArray,
    step_s: float,
    per_sample: int,
    omega: FloatArray,
    zeta: float,
) -> tuple[FloatArray, FloatArray]:
    """Runge-Kutta 4 over the half steps: (samples + 1, 9) states, heave acceleration at all but the last."""
    samples = (v_road.shape[0] - 1) // (2 * per_sample)
    states = np.empty((samples + 1, 9))
    heave_accel = np.empty(samples)
    y = start.copy()
    i = 0
    for sample in range(samples):
        states[sample] = y
        heave_accel[sample] = _rates(y, v_road[i], heave[i], tilt[i], omega, zeta)[_HEAVE_RATE]
        for _ in range(per_sample):
            k1 = _rates(y, v_road[i], heave[i], tilt[i], omega, zeta)
            k2 = _rates(y + step_s / 2 * k1, v_road[i + 1], heave[i + 1], tilt[i + 1], omega, zeta)
            k3 = _rates(y + step_s / 2 * k2, v_road[i + 1], heave[i + 1], tilt[i + 1], omega, zeta)
            k4 = _rates(y + step_s * k3, v_road[i + 2], heave[i + 2], tilt[i + 2], omega, zeta)
            y = y + step_s / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
            i += 2
    states[samples] = y
    return states, heave_accel


@njit(cache=True, nogil=True)
def _earth_at(lat_rad: FloatArray, alt_m: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Meridian and transverse radius and gravity at each point, (n,) each."""
    n = lat_rad.size
    meridian, transverse, gravity = np.empty(n), np.empty(n), np.empty(n)
    for i in range(n):
        meridian[i], transverse[i] = radii_m(lat_rad[i])
        gravity[i] = gravity_mps2(lat_rad[i], alt_m[i])
    return meridian, transverse, gravity


def _truth(t_s: FloatArray, motion: _Motion, states: FloatArray, heave_accel: FloatArray) -> Trajectory:
    lat, lon, alt = states[:, _LAT].copy(), states[:, _LON].copy(), states[:, _ALT].copy()
    v_n = motion.v_road_n.copy()
    v_n[:, 2] -= states[:, _HEAVE_RATE]
    v_n_dot = motion.v_road_n_dot.copy()
    v_n_dot[:, 2] -= heave_accel
    roll, pitch, yaw = states[:, _ROLL], states[:, _PITCH] + motion.grade, motion.heading
    roll_rate, pitch_rate = states[:, _ROLL_RATE], states[:, _PITCH_RATE] + motion.grade_rate
    rpy = np.column_stack([roll, pitch, wrap_angle_rad(yaw)])
    C_b_from_n = matrices_b_from_n(rpy)

    meridian, transverse, gravity = _earth_at(lat, alt)
    omega_ie_n = EARTH_RATE_RADPS * np.column_stack([np.cos(lat), np.zeros_like(lat), -np.sin(lat)])
    east_rate = v_n[:, 1] / (transverse + alt)
    omega_en_n = np.column_stack([east_rate, -v_n[:, 0] / (meridian + alt), -east_rate * np.tan(lat)])
    gravity_n = np.zeros_like(v_n)
    gravity_n[:, 2] = gravity
    f_n = v_n_dot + np.cross(2 * omega_ie_n + omega_en_n, v_n) - gravity_n
    omega_nb_b = np.column_stack(
        [
            roll_rate - motion.heading_rate * np.sin(pitch),
            pitch_rate * np.cos(roll) + motion.heading_rate * np.sin(roll) * np.cos(pitch),
            -pitch_rate * np.sin(roll) + motion.heading_rate * np.cos(roll) * np.cos(pitch),
        ]
    )
    return Trajectory(
        t_s=t_s,
        lat_rad=lat,
        lon_rad=lon,
        alt_m=alt,
        v_n=v_n,
        rpy_rad=rpy,
        f_b=rotate(C_b_from_n, f_n),
        omega_b=omega_nb_b + rotate(C_b_from_n, omega_ie_n + omega_en_n),
    )


def matrices_b_from_n(rpy_rad: FloatArray) -> FloatArray:
    """Rotations from navigation to body axes, (n, 3, 3), of roll, pitch and yaw (n, 3)."""
    cr, cp, cy = np.cos(rpy_rad).T
    sr, sp, sy = np.sin(rpy_rad).T
    rows = [
        [cp * cy, cp * sy, -sp],
        [sr * sp * cy - cr * sy, sr * sp * sy + cr * cy, sr * cp],
        [cr * sp * cy + sr * sy, cr * sp * sy - sr * cy, cr * cp],
    ]
    return np.moveaxis(np.array(rows), -1, 0)


def rotate(matrices: FloatArray, vectors: FloatArray) -> FloatArray:
    """Each matrix (n, 3, 3) times its vector (n, 3)."""
    return np.asarray(np.einsum("nij,nj->ni", matrices, vectors))
