"""Disturbances that drivers, doors, hands, ships and sensors cause: hard manoeuvres, slams, tows, a dropped box."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final, Protocol

import numpy as np

from core.earth import STANDARD_GRAVITY_MPS2
from core.measurements import FloatArray
from core.simulation import disturbances as road
from core.simulation.body_motion import band_noise
from core.simulation.disturbances import Disturbance, NonAccident, between, hardness, structure, times_s
from core.simulation.ride import FINE_HZ
from core.simulation.vehicles import CAR, Vehicle

G: Final = STANDARD_GRAVITY_MPS2


def emergency_braking(rng: np.random.Generator, speed_mps: float, vehicle: Vehicle = CAR) -> Disturbance:
    """Full braking to a stop, a car's 6 to 10.8 m/s2 within 0.1 to 0.4 s, with ABS, dive, and the jerk back at the end.

    Dry asphalt allows 7 to 10 m/s2, sports tyres 1.1 g (Gillespie 1992, ch. 3; the hard end is a choice).
    """
    hard = hardness(rng)
    limit = between(vehicle.braking_least_mps2, vehicle.braking_most_mps2, hard)
    rise_s = rng.uniform(vehicle.brakes_least_s, vehicle.brakes_most_s)
    braking_s = speed_mps / limit + rise_s / 2.0
    stop_s = 1.0 + braking_s
    t = times_s(stop_s + 3.0)
    since = t - 1.0
    ramp = np.clip(since / rise_s, 0.0, 1.0)
    wave = 1.0 + rng.uniform(0.02, 0.12) * np.sin(2 * np.pi * rng.uniform(6.0, 14.0) * since)  # ABS
    along = np.where(since < braking_s, -limit * 0.5 * (1 - np.cos(np.pi * ramp)) * wave, 0.0)
    lost = np.cumsum(along) / FINE_HZ
    along *= speed_mps / max(-lost[-1], 1e-6)
    speed = np.maximum(speed_mps + np.cumsum(along) / FINE_HZ, 0.0)
    # Brakes hold when the wheels stop: the force ends at once, and the body swings back on its springs.
    after = np.maximum(t - stop_s, 0.0)
    settle_hz, damping = rng.uniform(1.5, 4.0), rng.uniform(0.15, 0.4)
    swing = np.exp(-2 * np.pi * settle_hz * damping * after) * np.cos(2 * np.pi * settle_hz * after)
    swing = np.where(t > stop_s, swing, 0.0)
    jerk = rng.uniform(0.15, 0.5) * limit * swing
    dive = math.radians(rng.uniform(1.0, 3.0)) * limit / G
    pitch = -dive * np.where(t <= stop_s, -along / max(limit, 1e-6), swing)
    pitch = np.convolve(np.pad(pitch, 60, mode="edge"), np.full(121, 1 / 121), mode="valid")
    rpy = np.zeros((t.size, 3))
    rpy[:, 1] = pitch
    accel = np.column_stack([along + jerk, 0.05 * along * rng.standard_normal(), 0.2 * np.abs(jerk)])
    return Disturbance(NonAccident.EMERGENCY_BRAKING, accel, rpy, speed, hardness=hard)


def hard_cornering(rng: np.random.Generator, speed_mps: float, vehicle: Vehicle = CAR) -> Disturbance:
    """A bend at 5 to 10 m/s2 for 1 to 5 s, entered within 0.3 to 1 s; the body rolls 3 to 7 degrees a g (Gillespie)."""
    hard = hardness(rng)
    limit = between(vehicle.side_least_mps2, vehicle.side_most_mps2, hard)
    hold_s, rise_s = rng.uniform(1.0, 5.0), rng.uniform(0.3, 1.0)
    t = times_s(hold_s + 2 * rise_s + 1.0)
    edge = np.clip(np.minimum(t / rise_s, (hold_s + 2 * rise_s - t) / rise_s), 0.0, 1.0)
    side = rng.choice([-1.0, 1.0]) * limit * 0.5 * (1 - np.cos(np.pi * edge))
    return _turning(NonAccident.HARD_CORNERING, side, speed_mps, rng, hard, vehicle)


def swerve(rng: np.random.Generator, speed_mps: float, vehicle: Vehicle = CAR) -> Disturbance:
    """To one side and back at 4 to 9.5 m/s2, 0.4 to 0.9 Hz: an evasive manoeuvre, an elk test at its hard end."""
    hard = hardness(rng)
    limit = between(0.8 * vehicle.side_least_mps2, 0.95 * vehicle.side_most_mps2, hard)
    period_s = 1.0 / rng.uniform(0.4, 0.9)
    t = times_s(1.5 * period_s + 1.0)
    phase = np.clip(t / (1.5 * period_s), 0.0, 1.0)
    side = rng.choice([-1.0, 1.0]) * limit * np.sin(3 * np.pi * phase) * np.sin(np.pi * phase) ** 0.5
    return _turning(NonAccident.SWERVE, side, speed_mps, rng, hard, vehicle)


def in_box(rpy_rad: FloatArray, accel_level: FloatArray) -> FloatArray:
    """Accelerations (n, 3) along the heading, right of it and down, in the axes of a box that rolls and pitches."""
    roll, pitch = rpy_rad[:, 0], rpy_rad[:, 1]
    forward, right, down = accel_level.T
    along, lower = forward * np.cos(pitch) - down * np.sin(pitch), forward * np.sin(pitch) + down * np.cos(pitch)
    cos, sin = np.cos(roll), np.sin(roll)
    return np.column_stack([along, right * cos + lower * sin, lower * cos - right * sin])


def _turning(
    kind: NonAccident, side: FloatArray, speed_mps: float, rng: np.random.Generator, hard: float, vehicle: Vehicle
) -> Disturbance:
    speed = np.full(side.size, max(speed_mps, 3.0))
    rpy = np.zeros((side.size, 3))
    rpy[:, 0] = -math.radians(rng.uniform(3.0, 7.0)) / G * side
    rpy[:, 2] = np.cumsum(side / speed) / FINE_HZ
    accel = np.column_stack([-rng.uniform(0.0, 0.2) * np.abs(side), side, np.zeros(side.size)])
    if vehicle.leans:
        rpy[:, 0] = np.arctan(side / G)
        accel = in_box(rpy, accel)
    return Disturbance(kind, accel, rpy, speed, hardness=hard)


def _slam(kind: NonAccident, axis: FloatArray, rng: np.random.Generator) -> Disturbance:
    """A latch closes: ringing of 20 to 60 ms, 0.05 to 5 g where the box sits, and the body rocks on its springs.

    Recorders under dashboards show up to several g (SOURCES: Azuga's class of standing shocks); numbers are choices.
    """
    hard = hardness(rng)
    peak, ring_s = G * between(0.05, 5.0, hard), rng.uniform(0.02, 0.06)
    t = times_s(2.5)
    since = np.maximum(t - 0.5, 0.0)
    ring = np.where(t > 0.5, np.exp(-since / (0.5 * ring_s)) * np.sin(2 * np.pi * rng.uniform(15, 60) * since), 0.0)
    rock = np.where(t > 0.5, np.exp(-3.0 * since) * np.sin(2 * np.pi * rng.uniform(1.2, 2.2) * since), 0.0)
    aim = axis + 0.35 * rng.standard_normal(3)
    aim /= np.linalg.norm(aim)
    accel = np.outer(peak * ring + 0.15 * G * hard * rock, aim)
    rpy = np.zeros((t.size, 3))
    rpy[:, 0] = math.radians(0.4 * hard) * rock
    return Disturbance(kind, accel, rpy, np.zeros(t.size), ignition=bool(rng.random() < 0.5), hardness=hard)


def door_slam(rng: np.random.Generator, _speed_mps: float = 0.0, _vehicle: Vehicle = CAR) -> Disturbance:
    """A door slammed while standing: mostly sideways."""
    return _slam(NonAccident.DOOR_SLAM, np.array([0.2, rng.choice([-1.0, 1.0]), 0.3]), rng)


def boot_slam(rng: np.random.Generator, _speed_mps: float = 0.0, _vehicle: Vehicle = CAR) -> Disturbance:
    """A boot lid slammed while standing: downwards and ahead."""
    return _slam(NonAccident.BOOT_SLAM, np.array([0.6, 0.0, 1.0]), rng)


def tow(rng: np.random.Generator, _speed_mps: float = 0.0, vehicle: Vehicle = CAR) -> Disturbance:
    """Ignition off: jerks of a winch to 0.5 g, the car tilts by 5 to 22 degrees within a minute, comes level."""
    hard = hardness(rng)
    tilt, tilt_s, stand_s = math.radians(between(5.0, 22.0, hard)), rng.uniform(15.0, 60.0), rng.uniform(5.0, 30.0)
    t = times_s(2 * tilt_s + stand_s + 4.0)
    up = 0.5 * (1 - np.cos(np.pi * np.clip((t - 2.0) / tilt_s, 0.0, 1.0)))
    down = 0.5 * (1 - np.cos(np.pi * np.clip((t - 2.0 - tilt_s - stand_s) / tilt_s, 0.0, 1.0)))
    rpy = np.zeros((t.size, 3))
    rpy[:, 1] = rng.choice([-1.0, 1.0]) * tilt * (up - down)
    accel = np.zeros((t.size, 3))
    for _ in range(int(rng.integers(3, 12))):
        at_s, length_s = rng.uniform(1.0, t[-1] - 2.0), rng.uniform(0.04, 0.25)
        peak = G * between(0.03, 0.5, hardness(rng))
        begin = round(at_s * FINE_HZ)
        pulse = peak * np.sin(np.pi * times_s(length_s) / length_s)
        aim = np.array([1.0, 0.2 * rng.standard_normal(), 0.3 * rng.standard_normal()])
        accel[begin : begin + pulse.size] += np.outer(pulse, aim)
        back_s = rng.uniform(1.0, 4.0) * length_s  # friction takes back what the jerk gave
        back = -peak * length_s / back_s * np.sin(np.pi * times_s(back_s) / back_s)
        end = min(begin + pulse.size + back.size, t.size)
        accel[begin + pulse.size : end] += np.outer(back[: end - begin - pulse.size], aim)
    accel += 0.05 * band_noise(t.size, 8.0, 0.5, rng)
    return Disturbance(
        NonAccident.TOW, structure(accel, rng, vehicle), rpy, np.zeros(t.size), ignition=False, hardness=hard
    )


def box_knocked(rng: np.random.Generator, speed_mps: float = 0.0, _vehicle: Vehicle = CAR) -> Disturbance:
    """A knee, a hand or a shopping bag against the box: one to four blows of 2 to 15 ms, 1 to 30 g, that swing back."""
    hard = hardness(rng)
    t = times_s(3.0)
    accel, rpy = np.zeros((t.size, 3)), np.zeros((t.size, 3))
    at_s = 0.5
    for _ in range(int(rng.integers(1, 5))):
        length_s, peak = rng.uniform(0.002, 0.015), G * between(1.0, 30.0, hard)
        aim = rng.standard_normal(3)
        aim *= peak / np.linalg.norm(aim)
        since = t - at_s
        hz = 0.5 / length_s
        ring = np.where(since > 0, np.exp(-np.maximum(since, 0) * hz * 0.8) * np.sin(2 * np.pi * hz * since), 0.0)
        accel += np.outer(ring, aim)
        swing = np.where(since > 0, np.exp(-np.maximum(since, 0) * 12.0) * np.sin(2 * np.pi * 8.0 * since), 0.0)
        rpy += np.outer(swing, np.radians(hard * rng.uniform(-3.0, 3.0, 3)))
        at_s += rng.uniform(0.1, 0.5)
    return Disturbance(NonAccident.BOX_KNOCKED, accel, rpy, np.full(t.size, speed_mps), hardness=hard)


def box_dropped(rng: np.random.Generator, speed_mps: float = 0.0, _vehicle: Vehicle = CAR) -> Disturbance:
    """The box comes off: a fall of 0.1 to 0.4 s, blows of 20 to 300 g and 3 to 12 ms, then it lies elsewhere."""
    hard = hardness(rng)
    fall_s = between(0.1, 0.4, hard)
    t = times_s(3.0)
    falling = (t > 1.0) & (t < 1.0 + fall_s)
    turned = np.radians(rng.uniform(-170.0, 170.0, 3) * np.array([1.0, 0.45, 1.0]))
    tumbling_s = fall_s + rng.uniform(0.15, 0.4)
    share = 0.5 * (1 - np.cos(np.pi * np.clip((t - 1.0) / tumbling_s, 0.0, 1.0)))
    rpy = np.outer(share, turned)
    roll, pitch = rpy[:, 0], rpy[:, 1]
    down_b = np.column_stack([-np.sin(pitch), np.sin(roll) * np.cos(pitch), np.cos(roll) * np.cos(pitch)])
    accel = G * down_b * falling[:, None]
    at_s, left_mps = 1.0 + fall_s, G * fall_s
    while left_mps > 0.15:  # bounces: each blow stops it and throws it back by a third
        length_s, bounce = rng.uniform(0.003, 0.012), rng.uniform(0.1, 0.4)
        blow = (t >= at_s) & (t < at_s + length_s)
        share_of_blow = np.sin(np.pi * (t[blow] - at_s) / length_s)
        scale = left_mps * (1 + bounce) / max(share_of_blow.sum() / FINE_HZ, 1e-4)
        aim = -down_b[blow] + 0.3 * rng.standard_normal(3)
        accel[blow] += scale * share_of_blow[:, None] * aim
        left_mps *= bounce
        flight_s = 2 * left_mps / G
        flying = (t >= at_s + length_s) & (t < at_s + length_s + flight_s)
        accel[flying] += G * down_b[flying]
        at_s += length_s + flight_s
    return Disturbance(NonAccident.BOX_DROPPED, accel, rpy, np.full(t.size, speed_mps), hardness=hard)


def ferry(rng: np.random.Generator, _speed_mps: float = 0.0, _vehicle: Vehicle = CAR) -> Disturbance:
    """Minutes on a ship, ignition off: roll of 1 to 8 degrees and pitch at 0.07 to 0.15 Hz, heave to 0.15 g."""
    hard = hardness(rng)
    t = times_s(rng.uniform(120.0, 300.0))
    fade = np.clip(np.minimum(t, t[-1] - t) / 10.0, 0.0, 1.0)
    waves = [np.sin(2 * np.pi * rng.uniform(0.07, 0.15) * t + rng.uniform(0, 6)) for _ in range(4)]
    roll, pitch = math.radians(between(1.0, 8.0, hard)), math.radians(between(0.5, 3.0, hard))
    rpy = np.column_stack([roll * waves[0] * fade, pitch * waves[1] * fade, np.zeros(t.size)])
    heave = G * between(0.01, 0.15, hard)
    accel = np.column_stack([0.3 * heave * waves[1], 0.3 * heave * waves[0], heave * waves[2]]) * fade[:, None]
    accel += 0.08 * band_noise(t.size, 12.0, 0.1, rng)
    return Disturbance(NonAccident.FERRY, accel, rpy, np.zeros(t.size), ignition=False, hardness=hard)


def car_wash(rng: np.random.Generator, _speed_mps: float = 0.0, _vehicle: Vehicle = CAR) -> Disturbance:
    """A minute or two between brushes: bursts of shaking at 1 to 10 Hz, to 0.3 g, and a conveyor."""
    hard = hardness(rng)
    t = times_s(rng.uniform(60.0, 120.0))
    burst = np.clip(3.0 * np.sin(2 * np.pi * t / rng.uniform(6.0, 15.0)), 0.0, 1.0)
    sd = G * between(0.02, 0.15, hard)
    accel = sd * burst[:, None] * (band_noise(t.size, 3.0, 0.5, rng) + 0.5 * band_noise(t.size, 10.0, 0.3, rng))
    for sign, at_s in ((1.0, 3.0), (-1.0, t[-1] - 4.0)):
        pulse = times_s(0.3)
        begin = round(at_s * FINE_HZ)
        accel[begin : begin + pulse.size, 0] += sign * 0.2 * np.pi / 0.6 * np.sin(np.pi * pulse / 0.3)
    rpy = np.zeros((t.size, 3))
    rpy[:, 0] = math.radians(0.5 * hard) * burst * np.sin(2 * np.pi * 1.2 * t)
    return Disturbance(NonAccident.CAR_WASH, accel, rpy, np.full(t.size, 0.2), bool(rng.random() < 0.5), hard)


def trailer_coupling(rng: np.random.Generator, _speed_mps: float = 0.0, vehicle: Vehicle = CAR) -> Disturbance:
    """A trailer set on the hook or pushed against it: 0.05 to 0.5 m/s within 40 to 120 ms, a load drops, it rocks."""
    hard = hardness(rng)
    t = times_s(4.0)
    since = t - 1.0
    length_s, delta = rng.uniform(0.04, 0.12), between(0.05, 0.5, hard)
    pulse = np.where((since > 0) & (since < length_s), np.sin(np.pi * np.clip(since / length_s, 0, 1)), 0.0)
    along = rng.choice([-1.0, 1.0]) * delta * np.pi / (2 * length_s) * pulse
    rock = np.where(since > 0, np.exp(-3 * np.maximum(since, 0)) * np.sin(2 * np.pi * 1.5 * since), 0.0)
    along -= np.sign(np.sum(along)) * np.where((since > length_s) & (since < length_s + 0.5), delta / 0.5, 0.0)
    accel = np.column_stack([along + 0.4 * hard * rock, 0.1 * along * rng.standard_normal(), 1.5 * hard * rock])
    rpy = np.zeros((t.size, 3))
    rpy[:, 1] = math.radians(0.8 * hard) * rock
    return Disturbance(
        NonAccident.TRAILER_COUPLING, structure(accel, rng, vehicle), rpy, np.zeros(t.size), hardness=hard
    )


def sensor_glitch(rng: np.random.Generator, speed_mps: float = 0.0, _vehicle: Vehicle = CAR) -> Disturbance:
    """Nothing moves: what goes wrong is in the converter (``core.simulation.box_model.spoilt``)."""
    n = round(2.0 * FINE_HZ)
    return Disturbance(
        NonAccident.SENSOR_GLITCH, np.zeros((n, 3)), np.zeros((n, 3)), np.full(n, speed_mps), hardness=hardness(rng)
    )


class Draw(Protocol):
    """Draws a disturbance met at a speed, m/s, by one of a class of vehicles."""

    def __call__(self, rng: np.random.Generator, speed_mps: float, vehicle: Vehicle = CAR, /) -> Disturbance: ...


@dataclass(frozen=True, slots=True)
class Source:
    """How a kind of disturbance is drawn, and at which speeds, m/s, it happens; up to 0 it happens standing."""

    draw: Draw
    low_mps: float
    high_mps: float


SOURCES: Final[Mapping[NonAccident, Source]] = MappingProxyType(
    {
        NonAccident.POTHOLE: Source(road.pothole, 3.0, 36.0),
        NonAccident.SPEED_BUMP: Source(road.speed_bump, 2.5, 14.0),
        NonAccident.KERB: Source(road.kerb, 0.8, 7.0),
        NonAccident.RAILWAY_CROSSING: Source(road.railway_crossing, 4.0, 25.0),
        NonAccident.VIBRATION: Source(road.vibration, 3.0, 33.0),
        NonAccident.PARKING_BUMP: Source(road.parking_bump, 0.0, 0.0),
        NonAccident.DOOR_SLAM: Source(door_slam, 0.0, 0.0),
        NonAccident.BOOT_SLAM: Source(boot_slam, 0.0, 0.0),
        NonAccident.EMERGENCY_BRAKING: Source(emergency_braking, 4.0, 36.0),
        NonAccident.HARD_CORNERING: Source(hard_cornering, 6.0, 30.0),
        NonAccident.SWERVE: Source(swerve, 8.0, 33.0),
        NonAccident.TOW: Source(tow, 0.0, 0.0),
        NonAccident.BOX_KNOCKED: Source(box_knocked, 0.0, 36.0),
        NonAccident.BOX_DROPPED: Source(box_dropped, 0.0, 36.0),
        NonAccident.SENSOR_GLITCH: Source(sensor_glitch, 0.0, 36.0),
        NonAccident.FERRY: Source(ferry, 0.0, 0.0),
        NonAccident.CAR_WASH: Source(car_wash, 0.0, 0.0),
        NonAccident.TRAILER_COUPLING: Source(trailer_coupling, 0.0, 0.0),
    }
)
