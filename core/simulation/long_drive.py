"""Long drives made fast: what a detector is given over 25 km of roads, manoeuvres and non-accidents. A seed a piece.

All of it is made at the box's own rate, but for the disturbances, which are sampled as a box would sample them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np
from numba import njit
from scipy.linalg import expm

from core.accident.events import VehicleMotion
from core.measurements import FloatArray
from core.rotation import matrix_from_rpy
from core.simulation.box_model import Box, G, converted, estimated_down, sample_times_ns, sampled, some_box, spoilt
from core.simulation.corpus import IGNITION_KNOWN, START_T_NS
from core.simulation.disturbances import NonAccident
from core.simulation.handling import in_box
from core.simulation.long_script import DENSITIES, LANDS, RATE_HZ, STRIDE, Density, Script, written
from core.simulation.ride import Car
from core.simulation.sensors import gauss_markov
from core.simulation.vehicles import VEHICLES

PIECE_KM: Final = 25.0


class Happening(NamedTuple):
    """A non-accident in a piece, from when to when."""

    kind: NonAccident
    begin_ns: int
    end_ns: int
    hardness: float


@dataclass(frozen=True, slots=True, eq=False)
class Piece:
    """A stretch of driving: ``motions`` follow one another in time, cut where the ignition changes."""

    seed: int
    distance_m: float
    box: Box
    motions: tuple[VehicleMotion, ...]
    happenings: tuple[Happening, ...]

    @property
    def samples(self) -> int:
        """How many samples it has."""
        return sum(len(motion.t_ns) for motion in self.motions)


_ROUGHNESS_M3: Final = (16e-6, 64e-6, 256e-6, 1024e-6)
"""ISO 8608 classes A to D: displacement's spectrum at 0.1 cycles/m."""


def drive_piece(
    seed: int, density: Density | None = None, distance_km: float = PIECE_KM, vehicle: str = "car"
) -> Piece:
    """The ``seed``-th piece of a class of vehicle, of at least ``distance_km``: the same arguments, the same bits."""
    rng = np.random.default_rng([seed, 77] if vehicle == "car" else [seed, 77, list(VEHICLES).index(vehicle)])
    script = written(rng, DENSITIES[vehicle] if density is None else density, 1e3 * distance_km, vehicle)
    speed, along, across = (np.concatenate(parts) for parts in zip(*script.parts, strict=True))
    box = some_box(rng, rate_hz=RATE_HZ)
    f_b, omega_b, down_b = _body(speed, along, across, script, box, rng)
    f, saturated = converted(f_b, box.full_scale_mps2, box.accel_noise, RATE_HZ, rng)
    f += np.clip(rng.normal(0.0, box.accel_bias_mps2, 3), -0.15, 0.15)
    t_ns = sample_times_ns(len(f), RATE_HZ, START_T_NS)
    happenings = []
    for row, disturbance in script.disturbed:
        if disturbance.kind is NonAccident.SENSOR_GLITCH:
            spoilt(f, saturated, row + round(0.5 * RATE_HZ), box.full_scale_mps2, rng)
        end = min(row + round(disturbance.duration_s * RATE_HZ), len(f) - 1)
        happenings.append(Happening(disturbance.kind, int(t_ns[row]), int(t_ns[end]), disturbance.hardness))
    omega, _ = converted(omega_b, box.gyro_full_scale_radps, box.gyro_noise_radps, RATE_HZ, rng)
    down = estimated_down(down_b, omega, box, rng)
    shown_speed = _estimated_speed(speed, box, rng)
    unknown = np.arange(len(f)) < rng.uniform(0.0, 60.0) * RATE_HZ * (rng.random() < 0.5)
    down[unknown], shown_speed[unknown] = np.nan, np.nan
    on = np.ones(len(f), dtype=np.bool_)
    for begin, end in script.ignition_off:
        on[begin:end] = False
    known = rng.random() < IGNITION_KNOWN
    cuts = [0, *(np.flatnonzero(np.diff(on)) + 1).tolist(), len(f)]
    motions = tuple(
        VehicleMotion(
            t_ns=t_ns[a:b],
            f_b=f[a:b],
            omega_b=omega[a:b],
            down_b=down[a:b],
            speed_mps=shown_speed[a:b],
            saturated=saturated[a:b],
            gravity_mps2=G,
            ignition=bool(on[a]) if known else None,
        )
        for a, b in pairwise(cuts)
    )
    return Piece(seed, script.distance_m, box, motions, tuple(happenings))


def _body(
    speed: FloatArray, along: FloatArray, across: FloatArray, script: Script, box: Box, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Specific force, rate and down at the box, (n, 3) each: manoeuvres, springs, road, engine, disturbances."""
    n, vehicle = speed.size, script.vehicle
    rough = _roughness(speed, rng)
    noise = rng.standard_normal((n, 3))
    base_m = vehicle.body.front_m + vehicle.body.rear_m
    road = _road(speed, rough, noise, 2.0 * vehicle.body.half_track_m, base_m, *_quarter_car(vehicle.body))
    if vehicle.leans:  # one track meets one road
        road[:, 3] = road[:, 1] = 0.0
    # A car rolls 3 to 7 deg a g and pitches 1 to 3 (Gillespie 1992, ch. 6); its springs smooth both.
    roll = -math.radians(rng.uniform(3.0, 7.0)) / G * _smooth(across)
    pitch = math.radians(rng.uniform(1.0, 3.0)) / G * _smooth(along)
    grade = gauss_markov(n, math.radians(1.5), 30.0, 1.0 / RATE_HZ, rng)
    yaw = np.cumsum(across / np.maximum(speed, 2.0)) / RATE_HZ
    rpy = np.column_stack([roll, pitch + _smooth(grade), yaw])
    if vehicle.leans:
        rpy[:, 0] = np.arctan(_smooth(across) / G)
    rpy[:, :2] += road[:, 3:]
    accel = vehicle.engine_mps2 * rng.standard_normal((n, 3))  # engine and the rest of what shakes a box
    accel += road[:, :3]
    if vehicle.leans:
        accel += in_box(rpy, np.column_stack([along, across, np.zeros(n)]))
    else:
        accel[:, 0] += along
        accel[:, 1] += across
    for row, disturbance in script.disturbed:
        shaken = sampled(disturbance.accel_b, box)
        end = min(row + len(shaken), n)
        accel[row:end] += shaken[: end - row]
        tilt = disturbance.rpy_rad[::STRIDE]
        rpy[row:end] += tilt[: end - row]
        if tilt[-1].any():  # a box that was moved stays so
            rpy[end:] += tilt[-1]
    return _felt(accel, rpy, np.ascontiguousarray(matrix_from_rpy(*box.mounting_rpy_rad).T))


@njit(cache=True, nogil=True)
def _felt(accel: FloatArray, rpy: FloatArray, turn: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Specific force, rate and down in the box's axes; the accelerations are along the body's, as it tilts little."""
    n = rpy.shape[0]
    f, omega, down = np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 3))
    d, w, a = np.empty(3), np.empty(3), np.empty(3)
    for k in range(n):
        before, after = max(k - 1, 0), min(k + 1, n - 1)
        per_s = RATE_HZ / (after - before)
        sr, cr, sp, cp = math.sin(rpy[k, 0]), math.cos(rpy[k, 0]), math.sin(rpy[k, 1]), math.cos(rpy[k, 1])
        roll_d = per_s * (rpy[after, 0] - rpy[before, 0])
        pitch_d = per_s * (rpy[after, 1] - rpy[before, 1])
        yaw_d = per_s * (rpy[after, 2] - rpy[before, 2])
        d[0], d[1], d[2] = -sp, sr * cp, cr * cp
        w[0] = roll_d - yaw_d * sp
        w[1] = pitch_d * cr + yaw_d * sr * cp
        w[2] = -pitch_d * sr + yaw_d * cr * cp
        for i in range(3):
            a[i] = accel[k, i] - G * d[i]
        for i in range(3):
            f[k, i] = turn[i, 0] * a[0] + turn[i, 1] * a[1] + turn[i, 2] * a[2]
            omega[k, i] = turn[i, 0] * w[0] + turn[i, 1] * w[1] + turn[i, 2] * w[2]
            down[k, i] = turn[i, 0] * d[0] + turn[i, 1] * d[1] + turn[i, 2] * d[2]
    return f, omega, down


def _smooth(signal: FloatArray) -> FloatArray:
    """A quarter of a second's mean: as springs follow."""
    width = round(0.25 * RATE_HZ) | 1
    return np.convolve(signal, np.full(width, 1.0 / width), mode="same")


def _roughness(speed: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Roughness under the car, (n,), m3: a class for each kilometre or so, and a factor up to two beside it."""
    way_m = np.cumsum(speed) / RATE_HZ
    borders = np.cumsum(rng.exponential(1000.0, int(way_m[-1] / 500.0) + 10))
    land = LANDS[int(rng.choice(len(LANDS), p=[one.share for one in LANDS]))]
    classes = rng.choice(len(_ROUGHNESS_M3), size=borders.size + 1, p=land.classes)
    levels = np.array(_ROUGHNESS_M3)[classes] * 2.0 ** rng.uniform(-1.0, 1.0, classes.size)
    return np.asarray(levels[np.searchsorted(borders, way_m)])


def _quarter_car(car: Car) -> tuple[FloatArray, FloatArray, float]:
    """Exact steps of a quarter car at ``RATE_HZ``: state (strut, body speed, tyre, wheel speed), drive, mass ratio."""
    body, wheel = car.sprung_kg / 4.0, car.unsprung_kg
    k, c, tyre = car.spring_npm, car.damping_nspm, car.tyre_npm
    a = np.array(
        [
            [0.0, 1.0, 0.0, -1.0],
            [-k / body, -c / body, 0.0, c / body],
            [0.0, 0.0, 0.0, 1.0],
            [k / wheel, c / wheel, -tyre / wheel, -c / wheel],
        ]
    )
    b = np.array([[0.0], [0.0], [-1.0], [0.0]])
    both = np.zeros((5, 5))
    both[:4, :4], both[:4, 4:] = a, b
    stepped = expm(both / RATE_HZ)
    return np.ascontiguousarray(stepped[:4, :4]), np.ascontiguousarray(stepped[:4, 4]), wheel / body


@njit(cache=True, nogil=True)
def _road(
    speed: FloatArray,
    rough: FloatArray,
    noise: FloatArray,
    track_m: float,
    base_m: float,
    a: FloatArray,
    b: FloatArray,
    ratio: float,
) -> FloatArray:
    """Two quarter cars, left and right, over a random road: acceleration forward, right and down, roll and pitch."""
    n = speed.shape[0]
    out = np.empty((n, 5))
    x = np.zeros((2, 4))
    before = np.zeros(2)
    heights = np.zeros(2)
    keep = math.exp(-2.0 * math.pi * 0.3 / RATE_HZ)
    pitch = 0.0
    for k in range(n):
        # One-sided spectrum of the road's vertical speed: v (2 pi n0)^2 G(n0); white, so its variance is that times
        # half the rate.
        sd = math.sqrt(speed[k] * rough[k] * (2.0 * math.pi * 0.1) ** 2 * 0.5 * RATE_HZ)
        lift = hop = tilt = heave = 0.0
        for side in range(2):
            drive = sd * (0.8 * noise[k, 0] + 0.6 * noise[k, 1 + side])
            y0, y1, y2, y3 = x[side, 0], x[side, 1], x[side, 2], x[side, 3]
            for i in range(4):
                x[side, i] = a[i, 0] * y0 + a[i, 1] * y1 + a[i, 2] * y2 + a[i, 3] * y3 + b[i] * drive
            up = (x[side, 1] - before[side]) * RATE_HZ
            before[side] = x[side, 1]
            heights[side] = keep * heights[side] + x[side, 1] / RATE_HZ
            lift += 0.5 * up
            hop += 0.5 * (x[side, 3] - y3) * RATE_HZ * ratio
            tilt += (1.0 if side == 0 else -1.0) * up
            heave += 0.5 * x[side, 1]
        roll = (heights[0] - heights[1]) / track_m
        pitch = keep * pitch + 0.3 * heave / base_m / RATE_HZ
        # Choices, by which the spectra along and across come up to those of kth_stockholm and of phones on windshields.
        out[k, 0] = 0.35 * lift + 0.5 * hop
        out[k, 1] = 0.8 * tilt / track_m + 0.2 * hop
        out[k, 2] = -(lift + 0.3 * hop)
        out[k, 3], out[k, 4] = roll, pitch
    return out


def _estimated_speed(speed: FloatArray, box: Box, rng: np.random.Generator) -> FloatArray:
    """A filter's speed: a slow error, and ramps in outages of GNSS of 20 to 60 s, two in an hour or so."""
    errors, n = box.errors, speed.size
    off = gauss_markov(n, errors.speed_sd_mps, errors.speed_s, 1.0 / RATE_HZ, rng)
    for begin in rng.uniform(0.0, n, rng.poisson(n / RATE_HZ / 1500.0)).astype(np.int64):
        length = min(round(rng.uniform(20.0, 60.0) * RATE_HZ), n - int(begin))
        off[begin : begin + length] += rng.normal(0.0, 1.0) * np.arange(length) / (60.0 * RATE_HZ)
    return np.abs(speed + np.where(speed > 0.0, off, 0.1 * off))
