"""Accidents as motion: what is hit from where and how hard, how the car slides, spins or tips, and how it ends."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any, Final

import numpy as np
from numba import njit

from core.earth import STANDARD_GRAVITY_MPS2
from core.measurements import FloatArray
from core.simulation.body_motion import BodyMotion, band_noise, rate_b
from core.simulation.disturbances import BOX_M, times_s
from core.simulation.pulses import ringing, shaped_pulse
from core.simulation.ride import FINE_HZ
from core.simulation.shapes import Shape
from core.simulation.trajectory import matrices_b_from_n, rotate

SPIN_DECAY_RADPS2: Final = 2.5
"""How fast tyres stop a spin, rad/s2: half of what would be on the spot (mu g a / k^2). A choice."""
GRIP: Final = 0.7
"""Of tyres that slide; dry asphalt 0.7 to 0.8 (Gillespie 1992)."""


class After(StrEnum):
    """How an accident goes on."""

    REST = "rest"
    DRIVE_ON = "drive_on"
    OFF_ROAD = "off_road"


@dataclass(frozen=True, slots=True, eq=False)
class Blow:
    """One pulse: ``after_s`` the first one's start, ``pdof_deg`` in the car's axes as it begins.

    ``pulse`` is of unit area at ``FINE_HZ``, 1/s. ``yaw_rate_radps`` is what it adds to the car's rate of turn.
    """

    delta_v_mps: float
    pdof_deg: float
    pulse: FloatArray
    yaw_rate_radps: float = 0.0
    after_s: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Collision:
    """What happens, for ``collide``.

    Parameters
    ----------
    name : str
        Class, as in ``accidents.CLASSES``.
    blows : tuple of Blow
        The first begins the accident.
    speed_mps : float
        As it begins; before, the car brakes by ``braking_mps2`` for ``braking_s``.
    roll_deg : float
        The car tips over by so much (90, 180, 270 …; negative to the left), and lies.
    decel_mps2 : float
        At which it comes to rest when it does not drive on.
    ringing_share : float
        Of the pulse.
    grip : float
        Of tyres against sliding across; hardly any where the wheels leave the ground.
    """

    name: str
    blows: tuple[Blow, ...]
    speed_mps: float
    braking_mps2: float = 0.0
    braking_s: float = 0.0
    roll_deg: float = 0.0
    roll_s: float = 1.5
    decel_mps2: float = 4.0
    after: After = After.REST
    ignition: bool = True
    ringing_share: float = 0.3
    grip: float = GRIP
    box_m: tuple[float, float, float] = (float(BOX_M[0]), float(BOX_M[1]), float(BOX_M[2]))


@dataclass(frozen=True, slots=True)
class Truth:
    """What a detector should say: ``delta_v_n_mps`` is the change of velocity of the box's place, forward and right
    of the car as the blow began, while the blow lasted; ``t_s`` since the motion's start."""

    name: str
    kind: str
    t_s: float
    delta_v_mps: float
    pdof_deg: float
    duration_s: float
    speed_mps: float
    peak_mps2: float
    impacts: tuple[dict[str, float], ...]
    ignition: bool
    roll_deg: float

    def json(self) -> dict[str, Any]:
        """As one object of truth.json."""
        return {name: getattr(self, name) for name in self.__slots__}


def collide(
    collision: Collision, rng: np.random.Generator, before_s: float = 15.0, after_s: float = 20.0
) -> tuple[BodyMotion, Truth]:
    """The motion of the box's place from ``before_s`` before the first blow to ``after_s`` after it."""
    t = times_s(before_s + after_s)
    n, start = t.size, round(before_s * FINE_HZ)
    blow_rows = np.array([start + round(blow.after_s * FINE_HZ) for blow in collision.blows])
    pushes, turns = np.zeros((len(blow_rows), n, 2)), np.zeros(n)
    for push, row, blow in zip(pushes, blow_rows, collision.blows, strict=True):
        angle = math.radians(blow.pdof_deg)
        end = min(row + blow.pulse.size, n)
        pulse = blow.pulse[: end - row]
        push[row:end] = -blow.delta_v_mps * np.outer(pulse, [math.cos(angle), math.sin(angle)])
        turns[row:end] += blow.yaw_rate_radps * pulse
    strength = np.hypot(pushes[:, :, 0], pushes[:, :, 1]).sum(axis=0)
    braking = np.where((t >= before_s - collision.braking_s) & (t < before_s), collision.braking_mps2, 0.0)
    braking = np.convolve(braking, np.full(200, 1 / 200), mode="full")[:n] * (t < before_s + 0.2)
    after_mps2 = 0.8 if collision.after is After.DRIVE_ON else collision.decel_mps2
    standing = collision.speed_mps < 0.05
    accel, v_n, yaw, tilt = _slide(
        collision.speed_mps + collision.braking_mps2 * collision.braking_s,
        pushes,
        turns,
        blow_rows,
        braking,
        after_mps2,
        standing,
        collision.grip * STANDARD_GRAVITY_MPS2,
    )
    rpy = np.column_stack([tilt[:, 0], tilt[:, 1], yaw])
    accel_n = np.column_stack([accel, np.zeros(n)])
    shake_b = ringing(strength, collision.ringing_share, rng)
    if collision.roll_deg:
        _tip(collision, t - before_s - 0.1, rpy, accel_n, shake_b, rng)
    if collision.after is After.OFF_ROAD:
        _go_off_road(t - before_s, np.hypot(v_n[:, 0], v_n[:, 1]), rpy, shake_b, rng)
    omega = rate_b(rpy)
    omega_d = np.gradient(omega, axis=0) * FINE_HZ
    arm = np.broadcast_to(np.array(collision.box_m), omega.shape)
    shake_b = shake_b + np.cross(omega, np.cross(omega, arm)) + np.cross(omega_d, arm)
    motion = BodyMotion(accel_n, shake_b, rpy, v_n)
    return motion, _truth(collision, motion, yaw, blow_rows, before_s)


@njit(cache=True, nogil=True)
def _slide(
    speed_mps: float,
    pushes: FloatArray,
    turns: FloatArray,
    blow_rows: FloatArray,
    braking: FloatArray,
    after_mps2: float,
    standing: bool,
    grip_mps2: float,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Planar motion under pushes, tyres and spin, and the body's tilt on its springs: level acceleration, velocity,
    yaw, and roll and pitch."""
    n = turns.shape[0]
    accel, velocity, yaw, tilt = np.empty((n, 2)), np.empty((n, 2)), np.empty(n), np.empty((n, 2))
    dt = 1.0 / FINE_HZ
    vx, vy, psi, rate = speed_mps, 0.0, 0.0, 0.0
    roll = pitch = roll_d = pitch_d = 0.0
    headings = np.zeros(blow_rows.size)
    w2, damp = (2.0 * math.pi * 1.6) ** 2, 2.0 * 0.35 * 2.0 * math.pi * 1.6
    for k in range(n):
        ax = ay = 0.0
        for b in range(blow_rows.size):
            if k == blow_rows[b]:
                headings[b] = psi
            if k >= blow_rows[b]:
                c, s = math.cos(headings[b]), math.sin(headings[b])
                ax += pushes[b, k, 0] * c - pushes[b, k, 1] * s
                ay += pushes[b, k, 0] * s + pushes[b, k, 1] * c
        c, s = math.cos(psi), math.sin(psi)
        along, across = vx * c + vy * s, -vx * s + vy * c
        hold = (0.0 if standing else braking[k]) if k < blow_rows[0] else max(after_mps2, braking[k])
        tyre_x, tyre_y = -hold * math.tanh(along / 0.1), -grip_mps2 * math.tanh(across / 0.3)
        ax += tyre_x * c - tyre_y * s
        ay += tyre_x * s + tyre_y * c
        rate += turns[k] * dt
        loss = SPIN_DECAY_RADPS2 * dt
        rate = rate - loss * math.tanh(rate / 0.05)
        psi += rate * dt
        accel[k, 0], accel[k, 1] = ax, ay
        velocity[k, 0], velocity[k, 1] = vx, vy
        yaw[k] = psi
        vx += ax * dt
        vy += ay * dt
        body_x, body_y = min(max(ax * c + ay * s, -8.0), 8.0), min(max(-ax * s + ay * c, -8.0), 8.0)
        roll_d += dt * (w2 * (-0.0089 * body_y - roll) - damp * roll_d)
        pitch_d += dt * (w2 * (0.0036 * body_x - pitch) - damp * pitch_d)
        roll += dt * roll_d
        pitch += dt * pitch_d
        tilt[k, 0], tilt[k, 1] = roll, pitch
    return accel, velocity, yaw, tilt


def _tip(
    collision: Collision,
    since_s: FloatArray,
    rpy: FloatArray,
    accel_n: FloatArray,
    shake_b: FloatArray,
    rng: np.random.Generator,
) -> None:
    """Tip the car over: it turns about its long axis, falls at each quarter onto a side, and lies."""
    share = np.clip(since_s / collision.roll_s, 0.0, 1.0)
    angle = math.radians(collision.roll_deg)
    rpy[:, 0] += angle * (share - np.sin(2 * np.pi * share) / (2 * np.pi))
    quarters = abs(collision.roll_deg) / 90.0
    for quarter in range(1, max(round(quarters), 1) + 1):
        # When the roll passes there: the same smooth step, inverted by search.
        passed = int(np.searchsorted(np.abs(rpy[:, 0]), math.radians(90.0 * quarter) * 0.97))
        fall_s, length_s = rng.uniform(0.1, 0.3), rng.uniform(0.03, 0.09)
        fall_mps2 = rng.uniform(0.3, 0.9) * STANDARD_GRAVITY_MPS2
        begin, length = passed - round(fall_s * FINE_HZ), round(length_s * FINE_HZ)
        if begin < 0 or passed + length >= rpy.shape[0]:
            continue
        accel_n[begin:passed, 2] += fall_mps2
        blow = shaped_pulse(Shape.HALF_SINE, length_s)
        length = blow.size
        accel_n[passed : passed + length, 2] -= fall_mps2 * fall_s * blow
        strength = np.zeros(rpy.shape[0])
        strength[passed : passed + length] = fall_mps2 * fall_s * blow
        shake_b += ringing(strength, 0.4, rng)


def _go_off_road(
    since_s: FloatArray, speed_mps: FloatArray, rpy: FloatArray, shake_b: FloatArray, rng: np.random.Generator
) -> None:
    """Rough ground until the car stands: 1 to 5 m/s2 of shaking at 10 m/s, a few degrees of roll and pitch."""
    strength = (np.clip((since_s - 0.3) / 0.3, 0.0, 1.0) * np.sqrt(speed_mps / 10.0))[:, None]
    n = since_s.size
    hard = rng.uniform(1.0, 5.0)
    noise = band_noise(n, 2.5, 0.4, rng) + band_noise(n, 12.0, 0.4, rng)
    shake_b += hard * strength * noise * np.array([0.4, 0.4, 1.0])
    tilt = np.minimum(strength, 1.0) * np.radians(0.6 * hard) * band_noise(n, 1.2, 0.5, rng, 2)
    box = np.full(151, 1.0 / 151.0)  # twice, so that its second derivative is a car's and no noise's
    for axis in range(2):
        rpy[:, axis] += np.convolve(np.convolve(tilt[:, axis], box, mode="same"), box, mode="same")


def _truth(collision: Collision, motion: BodyMotion, yaw: FloatArray, blow_rows: FloatArray, before_s: float) -> Truth:
    """Changes of velocity of the box's place, ringing included as it has no share at 0 Hz."""
    accel_n = motion.accel_n + rotate(np.swapaxes(matrices_b_from_n(motion.rpy_rad), 1, 2), motion.shake_b)
    impacts = []
    for row, blow in zip(blow_rows, collision.blows, strict=True):
        end = min(row + blow.pulse.size, len(yaw))
        dvx, dvy = accel_n[row:end, :2].sum(axis=0) / FINE_HZ
        c, s = math.cos(yaw[row]), math.sin(yaw[row])
        forward, right = dvx * c + dvy * s, -dvx * s + dvy * c
        impacts.append(
            {
                "t_s": before_s + blow.after_s,
                "delta_v_mps": math.hypot(forward, right),
                "forward_mps": forward,
                "right_mps": right,
                "pdof_deg": math.degrees(math.atan2(-right, -forward)) % 360.0,
                "duration_s": blow.pulse.size / FINE_HZ,
                "peak_mps2": float(np.hypot(*accel_n[row:end, :2].T).max()),
            }
        )
    worst = max(impacts, key=lambda one: one["delta_v_mps"])
    kind = "rollover" if abs(collision.roll_deg) >= 60.0 else "collision" if collision.ignition else "parked_hit"
    return Truth(
        name=collision.name,
        kind=kind,
        t_s=before_s,
        delta_v_mps=worst["delta_v_mps"],
        pdof_deg=worst["pdof_deg"],
        duration_s=worst["duration_s"],
        speed_mps=float(motion.speed_mps[max(int(blow_rows[0]) - 1, 0)]),
        peak_mps2=worst["peak_mps2"],
        impacts=tuple(impacts),
        ignition=collision.ignition,
        roll_deg=collision.roll_deg,
    )


def mirrored(collision: Collision) -> Collision:
    """The same from the other side."""
    blows = tuple(
        replace(blow, pdof_deg=-blow.pdof_deg % 360.0, yaw_rate_radps=-blow.yaw_rate_radps) for blow in collision.blows
    )
    return replace(collision, blows=blows, roll_deg=-collision.roll_deg)
