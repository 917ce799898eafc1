"""The script of a long drive: how fast and how it turns, where it stops, and which non-accidents it meets when."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from types import MappingProxyType
from typing import Final, NamedTuple

import numpy as np

from core.measurements import FloatArray
from core.simulation.class_disturbances import SOURCES_BY_CLASS
from core.simulation.disturbances import Disturbance, NonAccident
from core.simulation.ride import FINE_HZ
from core.simulation.shapes import Shape, peak_rate, step
from core.simulation.vehicles import CAR, VEHICLES
from core.tunables import Tunables, tunable

RATE_HZ: Final = 100.0
STRIDE: Final = round(FINE_HZ / RATE_HZ)

_DENSE: Final = "choice: many times what roads and owners give, so that a rare mistake shows"
_NO_CAR: Final = "cars do not; see DENSITIES"


@dataclass(frozen=True, slots=True)
class Density(Tunables):
    """How many of each kind of non-accident 100 km hold, on average."""

    pothole: float = tunable(40.0, unit="1/100 km", low=0.0, high=1000.0, source=_DENSE)
    speed_bump: float = tunable(8.0, unit="1/100 km", low=0.0, high=1000.0, source=_DENSE)
    kerb: float = tunable(5.0, unit="1/100 km", low=0.0, high=1000.0, source=_DENSE)
    railway_crossing: float = tunable(4.0, unit="1/100 km", low=0.0, high=1000.0, source=_DENSE)
    vibration: float = tunable(6.0, unit="1/100 km", low=0.0, high=1000.0, source=_DENSE)
    parking_bump: float = tunable(3.0, unit="1/100 km", low=0.0, high=1000.0, source=_DENSE)
    door_slam: float = tunable(8.0, unit="1/100 km", low=0.0, high=1000.0, source=_DENSE)
    boot_slam: float = tunable(2.0, unit="1/100 km", low=0.0, high=1000.0, source=_DENSE)
    emergency_braking: float = tunable(3.0, unit="1/100 km", low=0.0, high=1000.0, source=_DENSE)
    hard_cornering: float = tunable(4.0, unit="1/100 km", low=0.0, high=1000.0, source=_DENSE)
    swerve: float = tunable(2.0, unit="1/100 km", low=0.0, high=1000.0, source=_DENSE)
    tow: float = tunable(0.3, unit="1/100 km", low=0.0, high=1000.0, source=_DENSE)
    box_knocked: float = tunable(1.5, unit="1/100 km", low=0.0, high=1000.0, source=_DENSE)
    box_dropped: float = tunable(0.15, unit="1/100 km", low=0.0, high=1000.0, source=_DENSE)
    sensor_glitch: float = tunable(1.0, unit="1/100 km", low=0.0, high=1000.0, source=_DENSE)
    ferry: float = tunable(0.1, unit="1/100 km", low=0.0, high=1000.0, source=_DENSE)
    car_wash: float = tunable(0.3, unit="1/100 km", low=0.0, high=1000.0, source=_DENSE)
    trailer_coupling: float = tunable(0.3, unit="1/100 km", low=0.0, high=1000.0, source=_DENSE)
    tipping_body: float = tunable(0.0, unit="1/100 km", low=0.0, high=1000.0, source=_NO_CAR)
    kneeling: float = tunable(0.0, unit="1/100 km", low=0.0, high=1000.0, source=_NO_CAR)
    wheelie: float = tunable(0.0, unit="1/100 km", low=0.0, high=1000.0, source=_NO_CAR)
    stoppie: float = tunable(0.0, unit="1/100 km", low=0.0, high=1000.0, source=_NO_CAR)
    fall_at_rest: float = tunable(0.0, unit="1/100 km", low=0.0, high=1000.0, source=_NO_CAR)
    side_stand: float = tunable(0.0, unit="1/100 km", low=0.0, high=1000.0, source=_NO_CAR)


DENSITIES: Final[Mapping[str, Density]] = MappingProxyType(
    {
        "car": Density(),
        "van": Density(door_slam=20.0),
        "truck": Density(trailer_coupling=4.0, tipping_body=4.0, kerb=8.0, boot_slam=0.0, parking_bump=6.0),
        "bus": Density(kneeling=10.0, kerb=15.0, door_slam=20.0, boot_slam=0.0, trailer_coupling=0.0),
        "motorcycle": Density(
            door_slam=0.0, boot_slam=0.0, tow=0.0, car_wash=0.0, trailer_coupling=0.0, swerve=4.0, hard_cornering=12.0,
            wheelie=4.0, stoppie=3.0, fall_at_rest=2.0, side_stand=2.0,
        ),
    }
)  # fmt: skip
"""By class of vehicle."""


class Land(NamedTuple):
    """Where one drives: usual speeds (m/s), stops and bends a km, share of all kilometres, roughness classes' odds."""

    speed_mps: tuple[float, float]
    stops_per_km: float
    bends_per_km: float
    share: float
    classes: tuple[float, float, float, float]


LANDS: Final = (
    Land((7.0, 15.0), 1.2, 2.0, 0.45, (0.15, 0.45, 0.3, 0.1)),
    Land((14.0, 27.0), 0.15, 1.0, 0.35, (0.25, 0.45, 0.25, 0.05)),
    Land((24.0, 37.0), 0.01, 0.3, 0.2, (0.55, 0.4, 0.05, 0.0)),
)
"""Town, country, motorway. Choices that come to about 50 km/h on average over time."""


class Script:
    """Speed, forward and sideways acceleration, one segment after the other."""

    def __init__(self, rng: np.random.Generator, vehicle: str = "car") -> None:
        self.rng = rng
        self.vehicle = VEHICLES[vehicle]
        self.sources = SOURCES_BY_CLASS[vehicle]
        self.speed_mps = 0.0
        self.parts: list[tuple[FloatArray, FloatArray, FloatArray]] = []
        self.rows = 0
        self.distance_m = 0.0
        self.disturbed: list[tuple[int, Disturbance]] = []
        self.ignition_off: list[tuple[int, int]] = []

    def add(self, speed: FloatArray, along: FloatArray, across: FloatArray) -> None:
        self.parts.append((speed, along, across))
        self.rows += speed.size
        self.distance_m += float(speed.sum()) / RATE_HZ
        if speed.size:
            self.speed_mps = float(speed[-1])

    def hold(self, seconds: float) -> None:
        n = max(round(seconds * RATE_HZ), 1)
        self.add(np.full(n, self.speed_mps), np.zeros(n), np.zeros(n))

    def to_speed(self, speed_mps: float, accel_mps2: float) -> None:
        """As drivers do: eased in; a stop is held to its end and lets the body swing back."""
        delta = speed_mps - self.speed_mps
        if abs(delta) < 0.05:
            return
        if speed_mps > 0.0:
            n = max(round(peak_rate(Shape.EASE) * abs(delta) / accel_mps2 * RATE_HZ), 2)
            value, rate = step(Shape.EASE, (np.arange(n) + 1.0) / n)
            self.add(self.speed_mps + delta * value, delta * rate * (RATE_HZ / n), np.zeros(n))
            return
        rise = max(round(self.rng.uniform(0.2, 0.8) * RATE_HZ), 2)
        n = round(-delta / accel_mps2 * RATE_HZ) + rise // 2
        along = np.full(max(n, rise + 1), -accel_mps2)
        along[:rise] *= 0.5 * (1.0 - np.cos(np.pi * np.arange(rise) / rise))
        along *= delta * RATE_HZ / along.sum()
        self.add(np.maximum(self.speed_mps + np.cumsum(along) / RATE_HZ, 0.0), along, np.zeros(along.size))
        t = np.arange(round(1.5 * RATE_HZ)) / RATE_HZ
        hz, damping = self.rng.uniform(1.5, 4.0), self.rng.uniform(0.15, 0.4)
        swing = np.exp(-2 * np.pi * hz * damping * t) * np.cos(2 * np.pi * hz * t)
        self.add(np.zeros(t.size), self.rng.uniform(0.15, 0.5) * accel_mps2 * swing, np.zeros(t.size))
        self.speed_mps = 0.0

    def bend(self, side_mps2: float, seconds: float) -> None:
        n = max(round(seconds * RATE_HZ), 2)
        _, rate = step(Shape.EASE, np.arange(n) / n)
        self.add(np.full(n, self.speed_mps), np.zeros(n), side_mps2 * rate / peak_rate(Shape.EASE))

    def change_lane(self, side_mps2: float, seconds: float) -> None:
        n = max(round(seconds * RATE_HZ), 2)
        self.add(np.full(n, self.speed_mps), np.zeros(n), side_mps2 * np.sin(2 * np.pi * np.arange(n) / n))

    def disturb(self, disturbance: Disturbance) -> None:
        """Its own speed holds while it lasts."""
        speed = disturbance.speed_mps[::STRIDE].copy()
        self.disturbed.append((self.rows, disturbance))
        if not disturbance.ignition:
            self.ignition_off.append((max(self.rows - round(15.0 * RATE_HZ), 0), self.rows + speed.size))
        self.add(speed, np.zeros(speed.size), np.zeros(speed.size))


def written(rng: np.random.Generator, density: Density, distance_m: float, vehicle: str = "car") -> Script:
    """The script of a piece: driving, with the non-accidents at places drawn evenly over its way."""
    script = Script(rng, vehicle)
    script.hold(rng.uniform(5.0, 30.0))
    due: list[tuple[float, NonAccident]] = []
    for field in fields(density):
        kind = NonAccident(field.name)
        if kind is NonAccident.BOX_DROPPED or getattr(density, field.name) == 0.0:
            continue  # a box that drops ends the piece
        count = rng.poisson(getattr(density, field.name) * distance_m / 1e5)
        due += [(float(at), kind) for at in rng.uniform(0.0, distance_m, count)]
    due.sort()
    while script.distance_m < distance_m or due:
        land = LANDS[int(rng.choice(len(LANDS), p=[one.share for one in LANDS]))]
        end_m = script.distance_m + rng.uniform(2e3, 6e3)
        while script.distance_m < min(end_m, distance_m):
            _drive_on(script, land, rng)
            while due and due[0][0] <= script.distance_m:
                _meet(script, due.pop(0)[1], rng)
        while due and script.distance_m >= distance_m:
            _meet(script, due.pop(0)[1], rng)
    if rng.random() < -math.expm1(-density.box_dropped * distance_m / 1e5):
        script.disturb(script.sources[NonAccident.BOX_DROPPED].draw(rng, script.speed_mps, script.vehicle))
        script.to_speed(0.0, 1.5)
        script.hold(60.0)
    script.to_speed(0.0, rng.uniform(0.8, 2.5))
    script.hold(10.0)
    return script


def _drive_on(script: Script, land: Land, rng: np.random.Generator) -> None:
    """The next stretch: a speed, then some way at it with bends and lanes; now and then a stop."""
    # Everyday accelerations are log-normal about 1.3 m/s2; one in a hundred beyond 4 (choice).
    accel = float(np.clip(rng.lognormal(math.log(1.3), 0.5), 0.4, 6.5))
    vehicle = script.vehicle
    most_mps2 = vehicle.braking_most_mps2 / CAR.braking_most_mps2
    speed_mps = min(rng.uniform(*land.speed_mps), vehicle.top_mps)
    script.to_speed(speed_mps, vehicle.hurry * min(accel, 4.5))
    way_m = script.speed_mps * rng.uniform(3.0, 25.0)
    if rng.random() < -math.expm1(-land.bends_per_km * way_m / 1e3):
        side = float(np.clip(rng.lognormal(math.log(1.6), 0.5), 0.3, 6.0)) * rng.choice([-1.0, 1.0])
        side *= vehicle.side_most_mps2 / CAR.side_most_mps2
        script.bend(side, rng.uniform(2.0, 7.0))
    if rng.random() < 0.15:
        script.change_lane(rng.uniform(0.4, 2.0) * rng.choice([-1.0, 1.0]), rng.uniform(2.5, 6.0))
    script.hold(way_m / script.speed_mps)
    if rng.random() < -math.expm1(-land.stops_per_km * way_m / 1e3):
        script.to_speed(0.0, float(np.clip(rng.lognormal(math.log(1.6), 0.45), 0.5, 7.0 * most_mps2)))
        script.hold(rng.uniform(2.0, 30.0))


def _meet(script: Script, kind: NonAccident, rng: np.random.Generator) -> None:
    """Let a non-accident happen, at a speed at which it does."""
    source = script.sources[kind]
    if source.high_mps == 0.0:
        script.to_speed(0.0, rng.uniform(0.8, 3.0))
        if kind is not NonAccident.PARKING_BUMP:
            script.hold(rng.uniform(2.0, 10.0))
        disturbance = source.draw(rng, 0.0, script.vehicle)
        if not disturbance.ignition:
            script.hold(16.0)
    else:
        if not source.low_mps <= script.speed_mps <= source.high_mps or script.speed_mps < 1.0:
            speed_mps = min(rng.uniform(max(source.low_mps, 1.0), source.high_mps), script.vehicle.top_mps)
            script.to_speed(speed_mps, rng.uniform(1.0, 3.0))
            script.hold(rng.uniform(1.0, 3.0))
        disturbance = source.draw(rng, script.speed_mps, script.vehicle)
    script.disturb(disturbance)
    script.hold(rng.uniform(0.5, 6.0))
