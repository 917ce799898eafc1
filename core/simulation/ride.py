"""A car on its four wheels over a road's profile: what its body feels of kerbs, holes and rails, to the bump stops."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from core.earth import STANDARD_GRAVITY_MPS2
from core.measurements import FloatArray
from core.tunables import Tunables, tunable

FINE_HZ = 1000.0
"""Rate at which bodies move in this package before a box samples them, Hz."""
GRID_M = 0.01
"""Spacing of road profiles, m."""
_SUBSTEPS = 4
"""Steps of integration a millisecond: the stiffest mode, a wheel on its rim, has some 45 Hz."""


@dataclass(frozen=True, slots=True)
class Car(Tunables):
    """Seven degrees of freedom: heave, pitch, roll, four wheels. Orders of magnitude of Gillespie (1992), ch. 5."""

    sprung_kg: float = tunable(1250.0, unit="kg", low=100.0, high=20000.0, source="choice: compact car, two aboard")
    unsprung_kg: float = tunable(38.0, unit="kg", low=5.0, high=600.0, source="choice: a wheel, hub and brake")
    pitch_kgm2: float = tunable(1900.0, unit="kg m2", low=10.0, high=200000.0, source="choice: about m a b")
    roll_kgm2: float = tunable(480.0, unit="kg m2", low=5.0, high=50000.0, source="choice: compact car, 400-600")
    front_m: float = tunable(1.15, unit="m", low=0.3, high=5.0, source="choice: centre of gravity to front axle")
    rear_m: float = tunable(1.45, unit="m", low=0.3, high=5.0, source="choice: wheelbase 2.6 m")
    half_track_m: float = tunable(0.75, unit="m", low=0.05, high=1.5, source="choice: track 1.5 m")
    height_m: float = tunable(0.55, unit="m", low=0.2, high=2.0, source="choice: centre of gravity above the road")
    spring_npm: float = tunable(
        22000.0, unit="N/m", low=5000.0, high=1e6, source="choice: a wheel; 1.3 Hz body bounce (Gillespie, ch. 5)"
    )
    damping_nspm: float = tunable(
        1700.0, unit="N s/m", low=200.0, high=50000.0, source="choice: damping ratio 0.3 (Gillespie 1992, ch. 5)"
    )
    travel_m: float = tunable(
        0.07, unit="m", low=0.02, high=0.3, source="choice: from where the springs stand to the stops, either way"
    )
    stop_npm: float = tunable(
        250000.0, unit="N/m", low=0.0, high=5e6, source="choice: rubber stops, ten springs strong"
    )
    tyre_npm: float = tunable(
        200000.0, unit="N/m", low=50000.0, high=2e6, source="wheel hop 10-12 Hz (Gillespie 1992, ch. 5)"
    )
    tyre_nspm: float = tunable(150.0, unit="N s/m", low=0.0, high=5000.0, source="choice: tyres damp little")
    rim_m: float = tunable(
        0.075, unit="m", low=0.02, high=0.3, source="choice: tyre pressed so far, the rim strikes the road"
    )
    rim_npm: float = tunable(1.5e6, unit="N/m", low=0.0, high=2e7, source="choice: rim on the edge of a hole")
    wheel_radius_m: float = tunable(0.31, unit="m", low=0.2, high=0.6, source="choice: 195/65 R15")


def tracked(profile_m: FloatArray, radius_m: float) -> FloatArray:
    """Height of a wheel's hub over its level-road height as it rolls along a profile on ``GRID_M``, (n,).

    A rigid circle rolls on its highest contact, so that it bridges short holes and begins to climb a step before it.
    """
    reach = int(radius_m / GRID_M)
    padded = np.pad(profile_m, reach, mode="edge")
    hub = np.full(profile_m.shape, -np.inf)
    for offset in range(-reach, reach + 1):
        drop = radius_m - math.sqrt(radius_m**2 - (offset * GRID_M) ** 2)
        np.maximum(hub, padded[reach + offset : reach + offset + profile_m.size] - drop, out=hub)
    return hub


def ride(left_m: FloatArray, right_m: FloatArray, speed_mps: float, car: Car, box_m: FloatArray) -> FloatArray:
    """Drive straight over a profile at a speed, from its first point with the front wheels to its last with the rear.

    Parameters
    ----------
    left_m, right_m : (k,) heights of the road in each wheel's path, m up, every ``GRID_M``
    speed_mps : float
    box_m : (3,) the box forward, right and down of the centre of gravity, m

    Returns
    -------
    (n, 5) at ``FINE_HZ``: acceleration of the box's place forward, right and down (m/s2), and roll and pitch (rad)
    """
    wheelbase_m = car.front_m + car.rear_m
    length_m = GRID_M * (left_m.size - 1)
    n = int((length_m + wheelbase_m) / speed_mps * FINE_HZ)
    at_m = np.arange(n) * (speed_mps / FINE_HZ)
    grid_m = np.arange(left_m.size) * GRID_M
    height, slope = np.empty((n, 4)), np.empty((n, 4))
    for side, profile in enumerate((left_m, right_m)):
        hub = tracked(profile, car.wheel_radius_m)
        hub_slope = np.gradient(hub, GRID_M)
        for axle, behind_m in enumerate((0.0, wheelbase_m)):
            wheel = 2 * axle + side
            height[:, wheel] = np.interp(at_m - behind_m, grid_m, hub)
            slope[:, wheel] = np.interp(at_m - behind_m, grid_m, hub_slope)
    parameters = np.array(
        [
            car.sprung_kg,
            car.unsprung_kg,
            car.pitch_kgm2,
            car.roll_kgm2,
            car.front_m,
            car.rear_m,
            car.half_track_m,
            car.height_m,
            car.spring_npm,
            car.damping_nspm,
            car.travel_m,
            car.stop_npm,
            car.tyre_npm,
            car.tyre_nspm,
            car.rim_m,
            car.rim_npm,
        ]
    )
    return _integrate(height, slope, parameters, np.asarray(box_m, dtype=np.float64))


@njit(cache=True, nogil=True)
def _integrate(height: FloatArray, slope: FloatArray, par: FloatArray, box: FloatArray) -> FloatArray:
    """Semi-implicit Euler; heights up are positive inside, as are nose-up pitch and right-down roll."""
    mass, wheel_kg, pitch_kgm2, roll_kgm2 = par[0], par[1], par[2], par[3]
    front, rear, half_track, cg = par[4], par[5], par[6], par[7]
    spring, damping, travel, stop = par[8], par[9], par[10], par[11]
    tyre, tyre_damping, rim, rim_spring = par[12], par[13], par[14], par[15]
    x = np.array([front, front, -rear, -rear])
    y = np.array([-half_track, half_track, -half_track, half_track])
    load = np.empty(4)
    for w in range(4):
        share = rear if x[w] > 0.0 else front
        load[w] = STANDARD_GRAVITY_MPS2 * (mass * share / (front + rear) / 2.0 + wheel_kg)
    total = mass + 4.0 * wheel_kg
    z = zd = pitch = pitch_d = roll = roll_d = 0.0
    u, ud = np.zeros(4), np.zeros(4)
    first = height[0].copy()
    n = height.shape[0]
    out = np.empty((n, 5))
    dt = 1.0 / (FINE_HZ * _SUBSTEPS)
    for k in range(n):
        sum_z = sum_pitch = sum_roll = sum_x = 0.0
        following = min(k + 1, n - 1)
        for sub in range(_SUBSTEPS):
            share = sub / _SUBSTEPS
            heave_n = pitch_nm = roll_nm = along_n = 0.0
            for w in range(4):
                road = height[k, w] + share * (height[following, w] - height[k, w]) - first[w]
                road_d = (height[following, w] - height[k, w]) * FINE_HZ
                pressed = road - u[w]
                contact = load[w] + tyre * pressed + tyre_damping * (road_d - ud[w])
                if pressed > rim - load[w] / tyre:
                    contact += rim_spring * (pressed - rim + load[w] / tyre)
                if contact < 0.0:
                    contact = 0.0
                squeezed = u[w] - (z + x[w] * pitch - y[w] * roll)
                rate = ud[w] - (zd + x[w] * pitch_d - y[w] * roll_d)
                strut = spring * squeezed + damping * rate
                if squeezed > travel:
                    strut += stop * (squeezed - travel)
                elif squeezed < -travel:
                    strut += stop * (squeezed + travel)
                along = -contact * slope[k, w]
                heave_n += strut
                pitch_nm += strut * x[w]
                roll_nm -= strut * y[w]
                along_n += along
                ud[w] += dt * (contact - load[w] - strut) / wheel_kg
                u[w] += dt * ud[w]
            pitch_nm += along_n * cg
            zdd, pitch_dd, roll_dd = heave_n / mass, pitch_nm / pitch_kgm2, roll_nm / roll_kgm2
            zd += dt * zdd
            z += dt * zd
            pitch_d += dt * pitch_dd
            pitch += dt * pitch_d
            roll_d += dt * roll_dd
            roll += dt * roll_d
            sum_x += along_n / total + box[2] * pitch_dd
            sum_pitch += pitch_dd
            sum_roll += roll_dd
            sum_z += zdd
        out[k, 0] = sum_x / _SUBSTEPS
        out[k, 1] = -box[2] * sum_roll / _SUBSTEPS
        out[k, 2] = -(sum_z + box[0] * sum_pitch - box[1] * sum_roll) / _SUBSTEPS
        out[k, 3] = roll
        out[k, 4] = pitch
    return out
