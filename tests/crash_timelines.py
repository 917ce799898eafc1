"""What a box feels on a level road with pulses, and what the detector tells of it."""

from __future__ import annotations

import math

import numpy as np

from core.accident.detector import ImpactDetector
from core.accident.events import Status, VehicleMotion

G = 9.80665
EPOCH_NS = 1_700_000_000_000_000_000
RATE_HZ = 200.0
IMPACT_S = 3.0


def drive(
    *pulses, seconds=8.0, speed_mps=12.0, full_scale_g=math.inf, attitude=True, noise=0.1, rate_hz=RATE_HZ, falls=()
):
    """Motion on a level road with pulses (start_s, dv_forward, dv_right, dv_down, length_s), each a haversine.

    Each nods the car on its springs by 0.1 rad/s a m/s. ``falls`` are (start_s, end_s) of free fall.
    """
    rng = np.random.default_rng(3)
    t_s = np.arange(0.0, seconds, 1.0 / rate_hz)
    f_b = np.array([0.0, 0.0, -G]) + rng.normal(0.0, noise, (len(t_s), 3))
    omega_b = rng.normal(0.0, 0.003, (len(t_s), 3))
    for start_s, *delta_v, length_s in pulses:
        f_b += np.outer(haversine(t_s - start_s, length_s), delta_v)
        since = np.maximum(t_s - start_s, 0.0)
        omega_b[:, 1] += 0.1 * math.hypot(*delta_v[:2]) * np.sin(9.0 * since) * np.exp(-3.0 * since)
    for start_s, end_s in falls:
        f_b[(t_s >= start_s) & (t_s < end_s), 2] += G
    limit = full_scale_g * G
    saturated = (np.abs(f_b) >= limit).any(axis=1).astype(np.uint8)
    level = np.tile([0.0, 0.0, 1.0], (len(t_s), 1))
    return VehicleMotion(
        t_ns=EPOCH_NS + np.round(t_s * 1e9).astype(np.int64),
        f_b=np.clip(f_b, -limit, limit),
        omega_b=omega_b,
        down_b=level if attitude else np.full_like(level, np.nan),
        speed_mps=np.full(len(t_s), speed_mps),
        saturated=saturated,
        gravity_mps2=G,
    )


def haversine(since_s, length_s):
    """Pulse of unit area, 1/s."""
    phase = since_s / length_s
    return np.where((phase > 0) & (phase < 1), 2.0 / length_s * np.sin(np.pi * phase) ** 2, 0.0)


def told(motion, thresholds=None):
    """Every accident in its order, each with all that was told of it."""
    accidents = {}
    for impact in ImpactDetector(thresholds).step(motion).impacts:
        accidents.setdefault(impact.t_ns, []).append(impact)
    return list(accidents.values())


def find(motion, thresholds=None):
    """The accidents that were not retracted, each as it was told last."""
    return [revisions[-1] for revisions in told(motion, thresholds) if revisions[-1].status is not Status.RETRACTED]


def named(motion):
    return [candidate.reason for candidate in ImpactDetector().step(motion).candidates]


def take(motion, index):
    return VehicleMotion(
        motion.t_ns[index],
        motion.f_b[index],
        motion.omega_b[index],
        motion.down_b[index],
        motion.speed_mps[index],
        motion.saturated[index],
        motion.gravity_mps2,
    )
