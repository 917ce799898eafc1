"""Accidents by class of vehicle: a car's collisions as heavier or lighter ones feel them, and how motorcycles fall."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Final

import numpy as np
from numba import njit

from core.measurements import FloatArray
from core.simulation.accident_classes import CLASSES, LEAST_MPS
from core.simulation.body_motion import BodyMotion, band_noise
from core.simulation.class_disturbances import UPRIGHT_M, eased, toppling, turned_about
from core.simulation.collisions import After, Blow, Collision, Truth
from core.simulation.disturbances import structure, times_s
from core.simulation.handling import G
from core.simulation.ride import FINE_HZ
from core.simulation.vehicles import Vehicle

FALLS: Final = ("lowside", "highside")
"""How motorcycles go down without striking anything."""
WINDOW_S: Final = 1.0
"""A fall's change of velocity is the largest within it, s (seed 1, 3.3)."""
_HEAVY: Final = tuple(name for name in CLASSES if name != "spin")

CLASSES_BY_VEHICLE: Final[Mapping[str, tuple[str, ...]]] = MappingProxyType(
    {
        "car": tuple(CLASSES),
        "van": tuple(CLASSES),
        "truck": _HEAVY,
        "bus": tuple(name for name in _HEAVY if name != "rollover"),
        "motorcycle": (
            "frontal", "rear", "side", "oblique", "sideswipe", "low_speed", "struck_standing", "parked_hit",
            "hit_and_run", *FALLS,
        ),
    }
)  # fmt: skip
"""Classes of accidents that befall each class of vehicles."""


def felt_by(collision: Collision, vehicle: Vehicle, rng: np.random.Generator) -> Collision:
    """A car's collision as one of another class has it: another change of velocity, another length, another end.

    A motorcycle falls over after it, unless it is driven on; a heavy vehicle is turned less and tips over more slowly.
    """
    share = rng.uniform(vehicle.share_least, vehicle.share_most)
    stretch = rng.uniform(vehicle.stretch_least, vehicle.stretch_most)
    blows = []
    for blow in collision.blows:
        n = max(round(blow.pulse.size * stretch), 10)
        at = (np.arange(n) + 0.5) * (blow.pulse.size / n) - 0.5
        pulse = np.interp(at, np.arange(blow.pulse.size), blow.pulse)
        delta_v_mps = max(share * blow.delta_v_mps, LEAST_MPS * stretch)  # its tyres hold against it for longer
        turn = blow.yaw_rate_radps * min(1.0, share)
        blows.append(Blow(delta_v_mps, blow.pdof_deg, pulse * (FINE_HZ / pulse.sum()), turn, blow.after_s))
    found = replace(
        collision,
        blows=tuple(blows),
        speed_mps=min(collision.speed_mps, vehicle.top_mps),
        braking_mps2=min(collision.braking_mps2, 0.95 * vehicle.braking_most_mps2),
        decel_mps2=min(collision.decel_mps2, 0.9 * vehicle.braking_most_mps2),
        roll_s=collision.roll_s * (1.6 if vehicle.body.height_m > 1.0 else 1.0),
    )
    if vehicle.leans and found.after is not After.DRIVE_ON and rng.random() < 0.9:
        side = float(rng.choice([-1.0, 1.0]))
        box_m = float(rng.uniform(-0.4, 0.3)), 0.0, -UPRIGHT_M
        return replace(found, roll_deg=side * rng.uniform(70.0, 88.0), roll_s=rng.uniform(0.7, 1.5), box_m=box_m)
    return found


def fall(name: str, rng: np.random.Generator, before_s: float, after_s: float) -> tuple[BodyMotion, Truth]:
    """A motorcycle that leans by 20 to 45 degrees goes down and slides to rest at 3.5 to 6.5 m/s2 (metal on asphalt).

    By a lowside it slips away beneath its rider; by a highside its rear wheel slides, grips again and throws it to the
    other side, which takes some tenths of a second and a metre per second or two. Numbers are choices.
    """
    t = times_s(before_s + after_s)
    side = float(rng.choice([-1.0, 1.0]))
    lean, speed_mps = math.radians(rng.uniform(20.0, 45.0)), rng.uniform(6.0, 22.0)
    entry_s, fall_s = rng.uniform(1.0, 2.5), rng.uniform(0.45, 0.8)
    leant = side * lean * eased((t - before_s + entry_s) / (0.7 * entry_s))
    lies = side * math.radians(rng.uniform(70.0, 88.0)) * (1.0 if name == "lowside" else -1.0)
    share = toppling(t, before_s, fall_s, rng)
    rpy = np.zeros((t.size, 3))
    rpy[:, 0] = leant + (lies - side * lean) * share
    grip = G * np.tan(np.abs(leant)) * (1.0 - eased((t - before_s) / 0.25))
    kick = np.zeros(t.size)
    if name == "highside":
        length_s = rng.uniform(0.12, 0.25)
        since = np.clip((t - before_s - 0.1) / length_s, 0.0, 1.0)
        kick = -rng.uniform(1.0, 2.5) * np.pi / (2.0 * length_s) * np.sin(np.pi * since)
    slides_mps2 = rng.uniform(3.5, 6.5) * eased((t - before_s) / (0.8 * fall_s))
    spin = rng.uniform(-1.5, 1.5)
    accel, v_n, yaw = _path(speed_mps, side, grip, side * kick, slides_mps2, spin, round(before_s * FINE_HZ))
    rpy[:, 2] = yaw
    shake_b = turned_about(rpy, np.array([rng.uniform(-0.4, 0.3), 0.0, -UPRIGHT_M]))
    scrapes = rng.uniform(1.5, 5.0) * np.sqrt(np.hypot(v_n[:, 0], v_n[:, 1]) / 10.0) * share
    shake_b = structure(shake_b, rng) + scrapes[:, None] * band_noise(t.size, 20.0, 0.4, rng)
    motion = BodyMotion(np.column_stack([accel, np.zeros(t.size)]), shake_b, rpy, v_n)
    return motion, _truth(name, v_n, yaw, math.degrees(lies), before_s)


@njit(cache=True, nogil=True)
def _path(
    speed_mps: float,
    side: float,
    grip: FloatArray,
    kick: FloatArray,
    slides_mps2: FloatArray,
    spin_radps: float,
    down_row: int,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Along its bend until it falls, then straight on, slower and slower: level acceleration, velocity, yaw."""
    n, dt = grip.shape[0], 1.0 / FINE_HZ
    accel, velocity, yaw = np.empty((n, 2)), np.empty((n, 2)), np.empty(n)
    vx, vy, psi = speed_mps, 0.0, 0.0
    for k in range(n):
        c, s = math.cos(psi), math.sin(psi)
        speed = math.hypot(vx, vy)
        drag = slides_mps2[k] * math.tanh(speed / 0.1) / max(speed, 1e-6)
        across = side * grip[k] + kick[k]
        ax, ay = -across * s - drag * vx, across * c - drag * vy
        accel[k, 0], accel[k, 1] = ax, ay
        velocity[k, 0], velocity[k, 1], yaw[k] = vx, vy, psi
        vx += ax * dt
        vy += ay * dt
        rate = side * grip[k] / max(speed, 1.0)
        if k >= down_row:
            since = (k - down_row) * dt
            rate += spin_radps * min(since / 0.3, 1.0) * min(speed / 3.0, 1.0)
        psi += rate * dt
    return accel, velocity, yaw


def _truth(name: str, v_n: FloatArray, yaw: FloatArray, roll_deg: float, before_s: float) -> Truth:
    begin, window = round(before_s * FINE_HZ), round(WINDOW_S * FINE_HZ)
    change = v_n[begin + window : begin + 3 * window] - v_n[begin : begin + 2 * window]
    sizes = np.hypot(change[:, 0], change[:, 1])
    worst = int(np.argmax(sizes))
    (dvx, dvy), (c, s) = change[worst], (math.cos(yaw[begin]), math.sin(yaw[begin]))
    forward, right = dvx * c + dvy * s, -dvx * s + dvy * c
    impact = {
        "t_s": before_s,
        "delta_v_mps": float(sizes[worst]),
        "forward_mps": forward,
        "right_mps": right,
        "pdof_deg": math.degrees(math.atan2(-right, -forward)) % 360.0,
        "duration_s": WINDOW_S,
        "peak_mps2": math.nan,
    }
    return Truth(
        name=name,
        kind="fall",
        t_s=before_s,
        delta_v_mps=impact["delta_v_mps"],
        pdof_deg=impact["pdof_deg"],
        duration_s=WINDOW_S,
        speed_mps=float(np.hypot(*v_n[begin])),
        peak_mps2=math.nan,
        impacts=(impact,),
        ignition=True,
        roll_deg=roll_deg,
    )
