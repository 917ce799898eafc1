"""Cases to judge a detector by: an accident or none, as a box and a filter show it, with the truth. A seed each."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from core.accident.events import VehicleMotion
from core.accident.pulse import beyond, unexplained
from core.accident.thresholds import TriggerThresholds
from core.measurements import FloatArray
from core.simulation.accident_classes import CLASSES
from core.simulation.body_motion import BodyMotion, band_noise
from core.simulation.box_model import Box, seen, some_box
from core.simulation.class_accidents import FALLS, fall, felt_by
from core.simulation.class_disturbances import SOURCES_BY_CLASS
from core.simulation.collisions import Collision, Truth, collide
from core.simulation.disturbances import Disturbance, NonAccident
from core.simulation.ride import FINE_HZ
from core.simulation.trajectory import matrices_b_from_n, rotate
from core.simulation.vehicles import CAR, VEHICLES, Vehicle

START_T_NS: Final = 1_714_984_200_000_000_000
LEAD_S: Final = 12.0
"""Before what happens, s: a detector knows its past by then."""
TAIL_S: Final = 12.0
"""After it, s: until it would have been told, and rest or driving on was seen."""
IN_TIME_S: Final = 0.15
"""Within what an accident is to be suspected, s (issue 5)."""
IGNITION_KNOWN: Final = 0.7
"""Share of boxes that are told whether the ignition is on. A choice."""
WEAK_CLASSES: Final = (
    "frontal", "rear", "side", "oblique", "sideswipe", "low_speed", "struck_standing", "parked_hit", "hit_and_run",
)  # fmt: skip
"""Accidents of a single blow, which may be a weak one."""
WEAK_MPS: Final = (0.8, 1.8)
"""Changes of velocity of weak accidents, m/s: below those of the corpus."""
ROAD_SHAKE_MPS2: Final = (0.25, 1.6)
"""Vertical shaking by the road at 14 m/s, sd: smooth asphalt to a worn-out road, as shocks_road_anomalies_2017 has them
(medians 0.5 regular, 0.9 worn out; four fifths of it body bounce below 6 Hz)."""


@dataclass(frozen=True, slots=True, eq=False)
class AccidentCase:
    """An accident as a detector is given it. ``t_ns`` is the first blow's start, ``excess_mps`` by how much the true
    motion exceeds what tyres, pedals and steering can, ``IN_TIME_S`` after it."""

    seed: int
    motion: VehicleMotion
    box: Box
    truth: Truth
    t_ns: int
    excess_mps: float

    @property
    def clipped(self) -> bool:
        """Whether the box read its full scale during the accident."""
        return bool(self.motion.saturated.any())


@dataclass(frozen=True, slots=True, eq=False)
class QuietCase:
    """What is no accident, as a detector is given it; it happens from ``begin_ns`` to ``end_ns``."""

    seed: int
    motion: VehicleMotion
    box: Box
    kind: NonAccident
    hardness: float
    begin_ns: int
    end_ns: int


def accident_case(
    name: str, seed: int, full_scale_g: float | None = None, rate_hz: float | None = None, vehicle: str = "car"
) -> AccidentCase:
    """The ``seed``-th accident of a class that befalls a class of vehicle, in a box of its own unless one is said."""
    rng = np.random.default_rng([seed, [*CLASSES, *FALLS].index(name), *_of(vehicle)])
    chosen = VEHICLES[vehicle]
    if name in FALLS:
        return _shown(*fall(name, rng, LEAD_S, TAIL_S), rng, seed, some_box(rng, full_scale_g, rate_hz), chosen)
    collision = CLASSES[name](rng)
    if chosen is not CAR:
        collision = felt_by(collision, chosen, rng)
    return shown(collision, rng, seed, some_box(rng, full_scale_g, rate_hz), vehicle=chosen)


def weak_case(name: str, seed: int) -> AccidentCase:
    """The ``seed``-th accident of one of ``WEAK_CLASSES``, of ``WEAK_MPS``: hardly to be told from what is none."""
    rng = np.random.default_rng([seed, 500 + WEAK_CLASSES.index(name)])
    collision = CLASSES[name](rng)
    (blow,) = collision.blows
    weak = replace(blow, delta_v_mps=float(rng.uniform(*WEAK_MPS)))
    return shown(replace(collision, blows=(weak,)), rng, seed, some_box(rng))


def _of(vehicle: str) -> list[int]:
    """What sets the seeds of a class of vehicle apart from a car's."""
    return [] if vehicle == "car" else [list(VEHICLES).index(vehicle)]


def shown(
    collision: Collision,
    rng: np.random.Generator,
    seed: int,
    box: Box,
    lead_s: float = LEAD_S,
    vehicle: Vehicle = CAR,
) -> AccidentCase:
    """A collision as a box and a filter show it."""
    last_s = max(blow.after_s for blow in collision.blows)
    return _shown(*collide(collision, rng, lead_s, last_s + TAIL_S), rng, seed, box, vehicle)


def _shown(
    motion: BodyMotion, truth: Truth, rng: np.random.Generator, seed: int, box: Box, vehicle: Vehicle
) -> AccidentCase:
    excess_mps = _excess_mps(motion, round(truth.t_s * FINE_HZ), stood=truth.speed_mps == 0.0)
    motion = on_a_road(motion, rng, truth.ignition, vehicle)
    aligned_after_s = 2.0 * truth.t_s + 100.0 if rng.random() < 0.05 else 0.0
    ignition = truth.ignition if rng.random() < IGNITION_KNOWN else None
    given = seen(motion, box, rng, START_T_NS, aligned_after_s, ignition)
    t_ns = START_T_NS + round(truth.t_s * 1e9)
    return AccidentCase(seed, given, box, truth, t_ns, excess_mps)


def _excess_mps(motion: BodyMotion, row: int, *, stood: bool) -> float:
    """By how much a motion exceeds tyres' reach, in any window within ``IN_TIME_S`` from a row on, free of noise."""
    limits, count, step = TriggerThresholds(), round(IN_TIME_S * FINE_HZ), round(FINE_HZ / 200.0)
    rows = slice(row, row + count + 1)
    turn = np.swapaxes(matrices_b_from_n(motion.rpy_rad[rows]), 1, 2)
    accel = (motion.accel_n[rows] + rotate(turn, motion.shake_b[rows]))[:, :2]
    slow = motion.accel_n[row - round(0.3 * FINE_HZ) : row, :2].mean(axis=0)
    v = np.vstack([np.zeros(2), np.cumsum(accel, axis=0)])[::step] / FINE_HZ
    most = 0.0
    for i in range(len(v)):
        for j in range(i + 1, len(v)):
            w, (x, y) = (j - i) * step / FINE_HZ, v[j] - v[i]
            if w < limits.shortest_s:
                continue
            own = unexplained(x, y, slow[0] * w, slow[1] * w)
            reach = limits.tyre_mps2, limits.standing_mps2, limits.jerk_mps3
            most = max(most, beyond(math.hypot(x, y), own, w, stood, *reach))
    return float(most)


def quiet_case(
    kind: NonAccident, seed: int, full_scale_g: float | None = None, rate_hz: float | None = None, vehicle: str = "car"
) -> QuietCase:
    """The ``seed``-th disturbance of a kind that a class of vehicle meets, in a box of its own unless one is said."""
    rng = np.random.default_rng([seed, 1000 + list(NonAccident).index(kind), *_of(vehicle)])
    source, chosen = SOURCES_BY_CLASS[vehicle][kind], VEHICLES[vehicle]
    speed_mps = rng.uniform(source.low_mps, source.high_mps)
    if source.low_mps == 0.0 and rng.random() < 0.5:
        speed_mps = 0.0
    disturbance = source.draw(rng, speed_mps, chosen)
    box = some_box(rng, full_scale_g, rate_hz)
    motion = on_a_road(disturbed(disturbance), rng, disturbance.ignition, chosen)
    spoilt_at_s = LEAD_S + 0.5 if kind is NonAccident.SENSOR_GLITCH else None
    aligned_after_s = 1e9 if rng.random() < 0.05 else 0.0
    ignition = disturbance.ignition if rng.random() < IGNITION_KNOWN else None
    given = seen(motion, box, rng, START_T_NS, aligned_after_s, ignition, spoilt_at_s)
    begin = START_T_NS + round(LEAD_S * 1e9)
    end = begin + round(disturbance.duration_s * 1e9)
    return QuietCase(seed, given, box, kind, disturbance.hardness, begin, end)


def disturbed(disturbance: Disturbance, lead_s: float = LEAD_S, tail_s: float = TAIL_S) -> BodyMotion:
    """A car that goes evenly but for the disturbance."""
    lead, tail = round(lead_s * FINE_HZ), round(tail_s * FINE_HZ)
    pad = ((lead, tail), (0, 0))
    rpy = np.pad(disturbance.rpy_rad, pad, mode="edge")
    rpy[:lead] = 0.0
    speed = np.pad(disturbance.speed_mps, (lead, tail), mode="edge")
    return BodyMotion(
        accel_n=np.zeros((speed.size, 3)),
        shake_b=np.pad(disturbance.accel_b, pad),
        rpy_rad=rpy,
        v_n=np.column_stack([speed, np.zeros(speed.size)]),
    )


def on_a_road(motion: BodyMotion, rng: np.random.Generator, engine_on: bool, vehicle: Vehicle = CAR) -> BodyMotion:
    """With the shaking of road and engine: a level drawn for the road, more of it the faster the car goes."""
    low, high = ROAD_SHAKE_MPS2
    level = vehicle.road_share * low * (high / low) ** rng.random()
    return replace(motion, shake_b=motion.shake_b + road_shake(motion.speed_mps, level, engine_on, rng, vehicle))


def road_shake(
    speed_mps: FloatArray, level_mps2: float, engine_on: bool, rng: np.random.Generator, vehicle: Vehicle = CAR
) -> FloatArray:
    """Shaking of road (wheel hop and body bounce) and engine, (n, 3), m/s2; ``level_mps2`` is the sd at 14 m/s."""
    n = speed_mps.size
    bounce, hop = band_noise(n, 2.0, 0.5, rng), band_noise(n, 12.0, 0.5, rng)
    road = (0.85 * bounce * np.array([0.35, 0.35, 1.0]) + 0.5 * hop * np.array([0.5, 0.5, 1.0])) * (
        level_mps2 * np.sqrt(speed_mps / 14.0)
    )[:, None]
    engine = vehicle.engine_mps2 * band_noise(n, vehicle.engine_hz, 0.02, rng) if engine_on else 0.0
    return np.asarray(road + engine)
