"""What shakes a car or its box and is no accident: the common form, and what roads do."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Final

import numpy as np
from scipy.signal import lfilter

from core.measurements import FloatArray
from core.simulation.body_motion import resonator
from core.simulation.ride import FINE_HZ, GRID_M, Car, ride
from core.simulation.vehicles import CAR, Vehicle


class NonAccident(StrEnum):
    """What a detector has to tell from an accident."""

    POTHOLE = "pothole"
    SPEED_BUMP = "speed_bump"
    KERB = "kerb"
    RAILWAY_CROSSING = "railway_crossing"
    VIBRATION = "vibration"
    PARKING_BUMP = "parking_bump"
    DOOR_SLAM = "door_slam"
    BOOT_SLAM = "boot_slam"
    EMERGENCY_BRAKING = "emergency_braking"
    HARD_CORNERING = "hard_cornering"
    SWERVE = "swerve"
    TOW = "tow"
    BOX_KNOCKED = "box_knocked"
    BOX_DROPPED = "box_dropped"
    SENSOR_GLITCH = "sensor_glitch"
    FERRY = "ferry"
    CAR_WASH = "car_wash"
    TRAILER_COUPLING = "trailer_coupling"
    TIPPING_BODY = "tipping_body"
    KNEELING = "kneeling"
    WHEELIE = "wheelie"
    STOPPIE = "stoppie"
    FALL_AT_REST = "fall_at_rest"
    SIDE_STAND = "side_stand"


@dataclass(frozen=True, slots=True, eq=False)
class Disturbance:
    """A disturbance as it adds to whatever else the car does, at ``FINE_HZ``.

    Parameters
    ----------
    kind : NonAccident
    accel_b : (n, 3) acceleration, gravity left out, in the box's axes, m/s2
    rpy_rad : (n, 3) roll, pitch and yaw that are added; what they are at the end, they stay
    speed_mps : (n,) the car's speed meanwhile
    ignition : bool
    hardness : float
        0 to 1: how near the hard end of what is drawn.
    """

    kind: NonAccident
    accel_b: FloatArray
    rpy_rad: FloatArray
    speed_mps: FloatArray
    ignition: bool = True
    hardness: float = 0.5

    @property
    def duration_s(self) -> float:
        """Its length, s."""
        return self.speed_mps.size / FINE_HZ


BOX_M: Final = CAR.box_m
"""A box under a car's dashboard, forward, right and down of the centre of gravity, m."""


def times_s(duration_s: float) -> FloatArray:
    """Times at ``FINE_HZ`` from 0 on, (n,), s."""
    return np.arange(round(duration_s * FINE_HZ)) / FINE_HZ


def hardness(rng: np.random.Generator) -> float:
    """How hard one is: a quarter of them near the hardest published, the others mostly mild."""
    return float(rng.uniform(0.8, 1.0) if rng.random() < 0.25 else rng.beta(1.2, 1.6))


def between(low: float, high: float, share: float) -> float:
    """Value so far between two, even in the logarithm."""
    return float(low * (high / low) ** share)


def some_body(rng: np.random.Generator, vehicle: Vehicle) -> Car:
    """One of a class, of some mass, with springs, dampers and tyres of its own."""
    size, body = rng.uniform(0.8, 1.6), vehicle.body
    return replace(
        body,
        sprung_kg=body.sprung_kg * size,
        pitch_kgm2=body.pitch_kgm2 * size**1.3,
        roll_kgm2=body.roll_kgm2 * size**1.3,
        spring_npm=body.spring_npm * size * rng.uniform(0.8, 1.4),
        damping_nspm=body.damping_nspm * size * rng.uniform(0.7, 1.3),
        tyre_npm=body.tyre_npm * rng.uniform(0.9, 1.3),
        travel_m=rng.uniform(0.05, 0.09) * (body.travel_m / CAR.body.travel_m),
        wheel_radius_m=rng.uniform(0.28, 0.36) * (body.wheel_radius_m / CAR.body.wheel_radius_m),
    )


def structure(accel_b: FloatArray, rng: np.random.Generator, vehicle: Vehicle = CAR) -> FloatArray:
    """Acceleration with what panels and brackets add on the way to the box: (n, 3).

    Two modes a box, 12 to 25 and 25 to 70 Hz (choice: body bending, a bracket under the dashboard), each adding
    0.2 to 0.9 of what drives it, with a fifth or so from one axis to another.
    """
    crossed = accel_b + 0.2 * rng.standard_normal((1, 3)) * np.roll(accel_b, 1, axis=1)
    found = crossed.copy()
    for low_hz, high_hz in ((12.0, 25.0), (25.0, 70.0)):
        share = rng.uniform(0.2, 0.9, (1, 3))
        found += share * resonator(crossed, rng.uniform(low_hz, high_hz), rng.uniform(0.05, 0.15))
    if vehicle.cab_share > 0.0:
        found += vehicle.cab_share * resonator(crossed, rng.uniform(1.5, 4.0), rng.uniform(0.2, 0.35))
    return found


def over(
    kind: NonAccident,
    left_m: FloatArray,
    right_m: FloatArray,
    speed_mps: float,
    rng: np.random.Generator,
    hard: float,
    vehicle: Vehicle,
    settle_s: float = 1.5,
) -> Disturbance:
    """Drive over a profile that ends level; ``settle_s`` more until the springs are quiet. One track takes the left."""
    runout = np.full(math.ceil(settle_s * speed_mps / GRID_M), 1.0)
    left, right = (np.concatenate([profile, profile[-1] * runout]) for profile in (left_m, right_m))
    found = ride(left, left if vehicle.leans else right, speed_mps, some_body(rng, vehicle), vehicle.box_m)
    accel_b = structure(found[:, :3], rng, vehicle)
    rpy = np.column_stack([found[:, 3], found[:, 4], np.zeros(len(found))])
    fade = np.clip((len(found) - np.arange(len(found))) / (0.3 * FINE_HZ), 0.0, 1.0)[:, None]
    return Disturbance(kind, accel_b * fade, rpy * fade, np.full(len(found), speed_mps), hardness=hard)


def pothole(rng: np.random.Generator, speed_mps: float, vehicle: Vehicle = CAR) -> Disturbance:
    """One hole or two, 2 to 15 cm deep, 0.3 to 3 m long, under one side or both, in a road that has sunk about them.

    Depth: FHWA's Distress Identification Manual calls 5 cm high severity; 15 cm is a choice for the worst. Real ones
    (shocks_road_anomalies_2017) shake as much at 1 to 3 Hz as at 10: the surface about them is no plane either.
    """
    hard = hardness(rng)
    depth_m, length_m = between(0.02, 0.15, hard), between(0.3, 3.0, rng.random())
    profile = np.zeros(round(0.6 / GRID_M))
    for _ in range(1 + (rng.random() < 0.2)):
        k = max(round(length_m / GRID_M), 4)
        edge = max(round(k * rng.uniform(0.05, 0.3)), 1)
        hole = np.minimum(1.0, np.minimum(np.arange(k) + 1, k - np.arange(k)) / edge)
        profile = np.concatenate([profile, -depth_m * hole, np.zeros(round(rng.uniform(0.6, 3.0) / GRID_M))])
    x = np.arange(profile.size) / profile.size
    sunk = -rng.uniform(0.0, 0.06) * np.sin(np.pi * x) ** 2
    sides = rng.integers(3)
    left, right = ((profile if sides in both else 0.0) + sunk for both in ((0, 1), (0, 2)))
    return over(NonAccident.POTHOLE, left, right, speed_mps, rng, hard, vehicle)


def speed_bump(rng: np.random.Generator, speed_mps: float, vehicle: Vehicle = CAR) -> Disturbance:
    """A hump 5 to 12 cm high, 0.3 to 3.7 m long (UK Highways (Road Hump) Regulations 1999: 25-100 mm, 0.9 m and more;
    shorter ones in car parks)."""
    hard = hardness(rng)
    height_m, length_m = between(0.05, 0.12, hard), rng.choice([0.35, 0.5, 0.9, 1.5, 3.7])
    k = round(length_m / GRID_M)
    across = (np.arange(k) + 0.5) / k
    form = rng.choice(["sine", "round", "flat"])
    hump = np.sin(np.pi * across) if form == "sine" else np.sqrt(np.maximum(0.0, 1.0 - (2.0 * across - 1.0) ** 2))
    if form == "flat":
        hump = np.minimum(1.0, 5.0 * np.minimum(across, 1.0 - across))
    gap = np.zeros(round(0.6 / GRID_M))
    profile = np.concatenate([gap, height_m * hump, gap])
    return over(NonAccident.SPEED_BUMP, profile, profile, speed_mps, rng, hard, vehicle)


def kerb(rng: np.random.Generator, speed_mps: float, vehicle: Vehicle = CAR) -> Disturbance:
    """A kerb mounted and dropped off again, 4 to 16 cm, by one side or both (kerbs stand 10 to 15 cm; choice)."""
    hard = hardness(rng)
    height_m = between(0.04, 0.16, hard)
    rise = np.linspace(0.0, height_m, max(round(rng.uniform(0.01, 0.08) / GRID_M), 2))
    flat = np.full(round(rng.uniform(0.5, 4.0) * max(speed_mps, 1.0) / GRID_M), height_m)
    gap = np.zeros(round(0.6 / GRID_M))
    profile = np.concatenate([gap, rise, flat, rise[::-1], gap])
    lag = np.zeros(round(rng.uniform(0.0, 1.5) / GRID_M))
    left, right = np.concatenate([profile, lag]), np.concatenate([lag, profile])
    if rng.random() < 0.5:  # one side stays on the road
        right = np.zeros_like(left)
    return over(NonAccident.KERB, left, right, speed_mps, rng, hard, vehicle)


def railway_crossing(rng: np.random.Generator, speed_mps: float, vehicle: Vehicle = CAR) -> Disturbance:
    """Four rails or eight, each a gap of 7 to 10 cm beside a step of 0.5 to 4 cm, humped by up to 10 cm."""
    hard = hardness(rng)
    step_m = between(0.005, 0.04, hard)
    tracks = int(rng.integers(1, 3))
    length = round((2.0 + 4.0 * tracks) / GRID_M)
    x = np.arange(length) * GRID_M
    base = rng.uniform(0.0, 0.1) * np.sin(np.pi * x / x[-1]) ** 2
    profile = base.copy()
    for track in range(tracks):
        for rail in (0.0, 1.435):
            at = round((1.5 + 4.0 * track + rail) / GRID_M)
            profile[at : at + 7] += step_m * rng.uniform(0.4, 1.0)
            profile[at + 7 : at + 16] -= step_m * rng.uniform(0.0, 1.5)
    return over(NonAccident.RAILWAY_CROSSING, profile, profile, speed_mps, rng, hard, vehicle)


def vibration(rng: np.random.Generator, speed_mps: float, vehicle: Vehicle = CAR) -> Disturbance:
    """A train of shaking 3 to 12 s long: cobbles, a rumble strip, gravel's waves, a worn road (ISO 8608, C to E)."""
    hard = hardness(rng)
    length_m = speed_mps * rng.uniform(3.0, 12.0)
    k = round(length_m / GRID_M)
    x = np.arange(k) * GRID_M
    form = rng.choice(["cobbles", "rumble", "gravel", "worn"])
    sides = []
    for _ in range(2):
        if form == "worn":  # displacement PSD G (n0 / n)^2: a random walk over distance, its mean drawn back to zero
            roughness = between(256e-6, 4096e-6, hard)
            profile = rough_road(k, roughness, rng)
        elif form == "rumble":  # milled: 13 mm deep, 18 cm long, every 30 cm (FHWA T 5040.39)
            profile = -0.013 * between(0.4, 1.5, hard) * np.maximum(0.0, np.sin(2 * np.pi * x / 0.3))
        else:
            wave_m = rng.uniform(0.12, 0.3) if form == "cobbles" else rng.uniform(0.5, 1.0)
            height_m = between(0.004, 0.02 if form == "cobbles" else 0.03, hard)
            wander = np.cumsum(rng.standard_normal(k)) * math.sqrt(GRID_M) * 0.5
            profile = 0.5 * height_m * np.sin(2 * np.pi * x / wave_m + wander) * (1 + 0.3 * rng.standard_normal(k))
            profile = np.convolve(profile, np.full(5, 0.2), mode="same")
        sides.append(profile * np.minimum(1.0, np.minimum(x, x[-1] - x) / 0.5))
    if form == "rumble" and rng.random() < 0.7:
        sides[0] = np.zeros(k)
    return over(NonAccident.VIBRATION, sides[0], sides[1], speed_mps, rng, hard, vehicle)


def rough_road(points: int, roughness_m3: float, rng: np.random.Generator) -> FloatArray:
    """Heights of a road every ``GRID_M``, (points,), m, by its class: ``roughness_m3`` is its displacement's spectrum
    at 0.1 cycles/m (ISO 8608: A 16e-6, B 64e-6, C 256e-6, D 1024e-6, E 4096e-6), falling with the square of them."""
    # A random walk of variance q a metre has q / (2 pi n)^2 two-sided; waves beyond 50 m are left out.
    q = 0.5 * roughness_m3 * (2.0 * math.pi * 0.1) ** 2
    keep = math.exp(-2.0 * math.pi * GRID_M / 50.0)
    return np.asarray(lfilter([1.0], [1.0, -keep], math.sqrt(q * GRID_M) * rng.standard_normal(points)))


def parking_bump(rng: np.random.Generator, _speed_mps: float = 0.0, vehicle: Vehicle = CAR) -> Disturbance:
    """The wheels run against a kerb stone at 0.2 to 1 m/s: the car stops within 0.1 to 0.3 s, rocks, rolls back.

    The force is that of tyres pressed at an edge: a half sine of the mass on springs of 1 to 3 Hz and more.
    """
    hard = hardness(rng)
    speed_mps, stop_s = between(0.2, 1.0, hard), rng.uniform(0.1, 0.3)
    back = rng.uniform(0.0, 0.3)
    lead_s = 1.0
    t = times_s(lead_s + 3.0)
    since = t - lead_s
    delta = speed_mps * (1.0 + back)
    pulse = np.where((since > 0) & (since < stop_s), np.sin(np.pi * np.clip(since / stop_s, 0, 1)), 0.0)
    along = -delta * pulse * np.pi / (2.0 * stop_s)
    if back > 0.0:
        along += np.where(since > stop_s, back * speed_mps / 0.4 * np.exp(-(since - stop_s) / 0.4), 0.0)
    rock = np.where(since > 0, np.exp(-np.maximum(since, 0) * 2.5) * np.sin(2 * np.pi * 1.7 * since), 0.0)
    sign = 1.0 if rng.random() < 0.7 else -1.0  # backwards into the space as well
    accel = np.column_stack([sign * (along + 0.3 * hard * rock), 0.1 * rng.standard_normal() * along, 0.5 * rock])
    rpy = np.zeros((t.size, 3))
    rpy[:, 1] = -sign * math.radians(0.5 + hard) * rock
    speed = np.abs(speed_mps + np.cumsum(along) / FINE_HZ) * np.clip((3.5 - since) / 0.5, 0.0, 1.0)
    return Disturbance(NonAccident.PARKING_BUMP, structure(accel, rng, vehicle), rpy, speed, hardness=hard)
