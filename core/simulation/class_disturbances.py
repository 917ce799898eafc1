"""Non-accidents by class of vehicle: what trucks, buses and motorcycles do beside what cars do, and what each meets."""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

import numpy as np

from core.measurements import FloatArray
from core.simulation.body_motion import band_noise, rate_b
from core.simulation.disturbances import Disturbance, NonAccident, between, hardness, structure, times_s
from core.simulation.handling import SOURCES, Source, in_box
from core.simulation.ride import FINE_HZ
from core.simulation.vehicles import CAR, Vehicle

UPRIGHT_M: Final = 0.6
"""A motorcycle's box above the ground, m. A choice."""
DROP_RADPS2: Final = 6.7
"""How fast a lifted wheel falls: g 0.65 m / (0.95 m2), its centre of gravity from the other axle and its inertia."""
FORK_S: Final = (0.03, 0.08)
"""Within what its springs take up the wheel's fall, s. A choice."""


def eased(share: FloatArray) -> FloatArray:
    """From 0 to 1 with no jerk at either end, where ``share`` does."""
    return np.asarray(0.5 * (1.0 - np.cos(np.pi * np.clip(share, 0.0, 1.0))))


def toppling(
    t: FloatArray,
    at_s: float,
    fall_s: float,
    rng: np.random.Generator,
    yields_s: tuple[float, float] = (0.012, 0.03),
) -> FloatArray:
    """Share of its way that what falls over has fallen, (n,): faster and faster, then it strikes the ground, yields
    twice within ``yields_s``, and lies."""
    share = np.clip((t - at_s) / fall_s, 0.0, 1.0) ** 2.2
    back = np.where(t > at_s + fall_s, np.exp(-np.maximum(t - at_s - fall_s, 0.0) / 0.12), 0.0)
    share = share - rng.uniform(0.0, 0.06) * back * np.abs(np.sin(np.pi * np.maximum(t - at_s - fall_s, 0.0) / 0.25))
    yielding = np.full(round(rng.uniform(*yields_s) * FINE_HZ), 1.0)
    yielding /= yielding.size
    for _ in range(2):
        padded = np.pad(share, yielding.size, mode="edge")
        share = np.convolve(padded, yielding, mode="same")[yielding.size : -yielding.size]
    return share


def turned_about(rpy_rad: FloatArray, arm_m: FloatArray) -> FloatArray:
    """Acceleration of a box at an arm (3,) from what its vehicle turns about, (n, 3), in its own axes."""
    omega = rate_b(rpy_rad)
    arm = np.broadcast_to(arm_m, omega.shape)
    return np.asarray(np.cross(omega, np.cross(omega, arm)) + np.cross(np.gradient(omega, axis=0) * FINE_HZ, arm))


def fall_at_rest(rng: np.random.Generator, _speed_mps: float = 0.0, _vehicle: Vehicle = CAR) -> Disturbance:
    """A motorcycle falls from its stand, or out of its rider's hands, to 68 to 88 degrees, and is lifted up again."""
    hard, side = hardness(rng), float(rng.choice([-1.0, 1.0]))
    at_s, fall_s, lies_s = 1.0, rng.uniform(0.7, 1.3), rng.uniform(6.0, 25.0)
    lift_s = rng.uniform(1.5, 4.0)
    t = times_s(at_s + fall_s + lies_s + lift_s + 2.0)
    rpy = np.zeros((t.size, 3))
    rpy[:, 0] = toppling(t, at_s, fall_s, rng) * (1.0 - eased((t - at_s - fall_s - lies_s) / lift_s))
    rpy[:, 0] *= side * math.radians(rng.uniform(68.0, 88.0))
    rpy[:, 2] = math.radians(rng.uniform(-15.0, 15.0)) * eased((t - at_s) / fall_s)
    accel = turned_about(rpy, np.array([rng.uniform(-0.3, 0.3), 0.0, -UPRIGHT_M]))
    accel = structure(accel, rng)
    on = bool(rng.random() < 0.4)
    return Disturbance(NonAccident.FALL_AT_REST, accel, rpy, np.zeros(t.size), ignition=on, hardness=hard)


def side_stand(rng: np.random.Generator, _speed_mps: float = 0.0, _vehicle: Vehicle = CAR) -> Disturbance:
    """Let down onto its stand, 8 to 15 degrees to the left, for a minute or more, and up again."""
    stands_s, down_s = rng.uniform(70.0, 150.0), rng.uniform(0.5, 1.5)
    t = times_s(stands_s + 8.0)
    rpy = np.zeros((t.size, 3))
    rpy[:, 0] = eased((t - 2.0) / down_s) * (1.0 - eased((t - stands_s - 4.0) / down_s))
    rpy[:, 0] *= -math.radians(rng.uniform(8.0, 15.0))
    accel = turned_about(rpy, np.array([0.0, 0.0, -UPRIGHT_M]))
    return Disturbance(NonAccident.SIDE_STAND, accel, rpy, np.zeros(t.size), ignition=False)


def wheelie(rng: np.random.Generator, speed_mps: float, _vehicle: Vehicle = CAR) -> Disturbance:
    """The front wheel lifts by 8 to 50 degrees at 4 to 8 m/s2 for half a second to three, and drops."""
    hard = hardness(rng)
    angle, at_s = math.radians(between(8.0, 50.0, hard)), 0.5
    up_s, hold_s, drop_s = rng.uniform(0.4, 0.9), rng.uniform(0.3, 2.5), _drop_s(angle, rng)
    t = times_s(at_s + up_s + hold_s + drop_s + 2.5)
    pitch = eased((t - at_s) / up_s) * (1.0 - toppling(t, at_s + up_s + hold_s, drop_s, rng, FORK_S))
    along = rng.uniform(3.0, 7.0) * _while(t, at_s - 0.2, at_s + up_s + hold_s)
    return _lifted(NonAccident.WHEELIE, t, angle * pitch, (0.7, -0.55), along, speed_mps, rng, hard)


def stoppie(rng: np.random.Generator, speed_mps: float, _vehicle: Vehicle = CAR) -> Disturbance:
    """Braked at 7 to 9.5 m/s2 until the rear wheel lifts by 4 to 35 degrees; it stops, or nearly, and drops."""
    hard = hardness(rng)
    angle, at_s = math.radians(between(4.0, 35.0, hard)), 0.5
    brake_mps2, drop_s = rng.uniform(7.0, 9.5), _drop_s(angle, rng)
    braking_s = min(max(speed_mps, 4.0) / brake_mps2, rng.uniform(1.0, 2.5))
    t = times_s(at_s + braking_s + drop_s + 2.5)
    up = eased((t - at_s - 0.3 * braking_s) / (0.6 * braking_s))
    pitch = -angle * up * (1.0 - toppling(t, at_s + braking_s, drop_s, rng, FORK_S))
    along = -brake_mps2 * _while(t, at_s, at_s + braking_s)
    return _lifted(NonAccident.STOPPIE, t, pitch, (-0.7, -0.55), along, max(speed_mps, 4.0), rng, hard)


def _drop_s(angle_rad: float, rng: np.random.Generator) -> float:
    return math.sqrt(2.0 * angle_rad / DROP_RADPS2) * float(rng.uniform(0.9, 1.2))


def _while(t: FloatArray, from_s: float, to_s: float) -> FloatArray:
    return eased((t - from_s) / 0.25) * (1.0 - eased((t - to_s) / 0.15))


def _lifted(
    kind: NonAccident,
    t: FloatArray,
    pitch: FloatArray,
    arm_m: tuple[float, float],
    along: FloatArray,
    speed_mps: float,
    rng: np.random.Generator,
    hard: float,
) -> Disturbance:
    """One wheel in the air: the machine turns about the other, ``arm_m`` from which (forward, down) the box is."""
    rpy = np.zeros((t.size, 3))
    rpy[:, 1] = pitch
    level = np.column_stack([along, np.zeros(t.size), np.zeros(t.size)])
    accel = in_box(rpy, level) + turned_about(rpy, np.array([arm_m[0], 0.0, arm_m[1]]))
    speed = np.maximum(speed_mps + np.cumsum(along) / FINE_HZ, 0.0)
    return Disturbance(kind, structure(accel, rng), rpy, speed, hardness=hard)


def tipping_body(rng: np.random.Generator, _speed_mps: float = 0.0, vehicle: Vehicle = CAR) -> Disturbance:
    """A truck raises its body: the frame tips by up to 2 degrees, the load slides in jolts, the tailgate bangs, and the
    driver shakes the last out of it; the body comes down on its rest. Jolts of 0.05 to 0.4 m/s; choices."""
    hard = hardness(rng)
    up_s, down_s = rng.uniform(12.0, 25.0), rng.uniform(8.0, 18.0)
    t = times_s(up_s + down_s + 12.0)
    rpy = np.zeros((t.size, 3))
    rpy[:, 1] = math.radians(between(0.3, 2.0, hard)) * (eased((t - 1.0) / up_s) - eased((t - up_s - 8.0) / down_s))
    accel = np.zeros((t.size, 3))
    for k in range(int(rng.integers(3, 9))):
        at_s, length_s = rng.uniform(0.4 * up_s, up_s + 7.0), rng.uniform(0.05, 0.3)
        if k == 0:  # the body comes down
            at_s = up_s + down_s + 8.0
        jolt = between(0.05, 0.4, hardness(rng)) * rng.choice([-1.0, 1.0])
        _jolt(
            accel, t, at_s, length_s, jolt * np.array([1.0, 0.15 * rng.standard_normal(), rng.uniform(0.3, 1.2)]), rng
        )
    accel += 0.06 * band_noise(t.size, 6.0, 0.4, rng)
    return Disturbance(
        NonAccident.TIPPING_BODY, structure(accel, rng, vehicle), rpy, np.zeros(t.size), hardness=hard
    )  # fmt: skip


def fifth_wheel(rng: np.random.Generator, _speed_mps: float = 0.0, vehicle: Vehicle = CAR) -> Disturbance:
    """A tractor backs under its trailer: lifted by the plate, and stopped by the king pin from 0.15 to 0.7 m/s within
    60 to 150 ms; it rocks, and pulls once to try the lock. Choices."""
    hard = hardness(rng)
    speed_mps, stop_s = between(0.15, 0.7, hard), rng.uniform(0.06, 0.15)
    t = times_s(9.0)
    accel, rpy = np.zeros((t.size, 3)), np.zeros((t.size, 3))
    _jolt(accel, t, 2.0, stop_s, np.array([speed_mps, 0.0, rng.uniform(-0.2, 0.2)]), rng, swings_back=False)
    lifts = eased((t - 1.2) / 0.6)
    rock = np.where(t > 2.0, np.exp(-2.5 * np.maximum(t - 2.0, 0.0)) * np.sin(2 * np.pi * 1.5 * (t - 2.0)), 0.0)
    rpy[:, 1] = -math.radians(0.4) * lifts + math.radians(0.5 * hard) * rock
    accel[:, 0] += 0.3 * hard * rock
    _jolt(accel, t, 5.0, rng.uniform(0.1, 0.3), np.array([between(0.05, 0.3, hard), 0.0, 0.0]), rng)
    backs = eased(t / 1.2)
    accel[:, 0] -= speed_mps * np.gradient(backs) * FINE_HZ
    speed = np.maximum(speed_mps * backs * (1.0 - eased((t - 2.0) / stop_s)), 0.0)
    return Disturbance(NonAccident.TRAILER_COUPLING, structure(accel, rng, vehicle), rpy, speed, hardness=hard)


def kneeling(rng: np.random.Generator, _speed_mps: float = 0.0, vehicle: Vehicle = CAR) -> Disturbance:
    """A bus lets down its door's side by 3 to 4 degrees and rises again; people board (VDV 230: 70 mm; choice)."""
    down_s, stands_s, angle = rng.uniform(1.5, 3.0), rng.uniform(6.0, 40.0), math.radians(rng.uniform(2.0, 4.0))
    t = times_s(2.0 * down_s + stands_s + 3.0)
    rpy = np.zeros((t.size, 3))
    rpy[:, 0] = angle * (eased((t - 1.0) / down_s) - eased((t - 1.0 - down_s - stands_s) / down_s))
    accel = turned_about(rpy, np.array([0.0, -1.0, -0.5])) + 0.05 * band_noise(t.size, 2.0, 0.4, rng)
    _jolt(accel, t, 1.0 + down_s, 0.08, np.array([0.0, 0.05, 0.1]) * rng.uniform(0.3, 2.0), rng)
    return Disturbance(NonAccident.KNEELING, structure(accel, rng, vehicle), rpy, np.zeros(t.size))


def _jolt(
    accel: FloatArray,
    t: FloatArray,
    at_s: float,
    length_s: float,
    change_mps: FloatArray,
    rng: np.random.Generator,
    *,
    swings_back: bool = True,
) -> None:
    """A change of velocity within a time, (3,), m/s, in place; friction and springs take it back a little later."""
    accel += np.outer(_half_sine(t, at_s, length_s), change_mps)
    if swings_back:
        accel -= np.outer(_half_sine(t, at_s + length_s, length_s * rng.uniform(1.5, 4.0)), change_mps)


def _half_sine(t: FloatArray, at_s: float, length_s: float) -> FloatArray:
    share = np.clip((t - at_s) / length_s, 0.0, 1.0)
    return np.asarray(np.pi / (2.0 * length_s) * np.sin(np.pi * share))


_STANDING: Final = {NonAccident.DOOR_SLAM, NonAccident.BOOT_SLAM, NonAccident.TOW, NonAccident.CAR_WASH}


def _of(leave: set[NonAccident], add: Mapping[NonAccident, Source]) -> Mapping[NonAccident, Source]:
    return MappingProxyType({kind: one for kind, one in SOURCES.items() if kind not in leave} | dict(add))


SOURCES_BY_CLASS: Final[Mapping[str, Mapping[NonAccident, Source]]] = MappingProxyType(
    {
        "car": SOURCES,
        "van": SOURCES,
        "truck": _of(
            {NonAccident.BOOT_SLAM},
            {
                NonAccident.TRAILER_COUPLING: Source(fifth_wheel, 0.0, 0.0),
                NonAccident.TIPPING_BODY: Source(tipping_body, 0.0, 0.0),
            },
        ),
        "bus": _of(
            {NonAccident.BOOT_SLAM, NonAccident.TRAILER_COUPLING},
            {NonAccident.KNEELING: Source(kneeling, 0.0, 0.0)},
        ),
        "motorcycle": _of(
            {*_STANDING, NonAccident.TRAILER_COUPLING},
            {
                NonAccident.WHEELIE: Source(wheelie, 5.0, 25.0),
                NonAccident.STOPPIE: Source(stoppie, 5.0, 20.0),
                NonAccident.FALL_AT_REST: Source(fall_at_rest, 0.0, 0.0),
                NonAccident.SIDE_STAND: Source(side_stand, 0.0, 0.0),
            },
        ),
    }
)
"""What vehicles of each class meet that is no accident, and at which speeds."""
