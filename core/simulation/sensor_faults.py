"""What goes wrong with the box itself: its clock, lost and doubled samples, clipping, warming up, stuck axes.

Each takes a stream, the span in true time and the fault's size.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

import numpy as np
import numpy.typing as npt

from core.earth import STANDARD_GRAVITY_MPS2
from core.measurements import SERIES, FloatArray
from core.simulation.gnss_faults import Span
from core.simulation.stream import Stream

BoolArray = npt.NDArray[np.bool_]

GAP_EVERY_S: Final = 5.0
"""From one hole in the samples to the next, s, 1 to 60. A choice: time to show what a hole did."""
SHAKING_HZ: Final = 15.0
"""Frequency at which a loose box rattles, Hz, 5 to 50: wheel hop, 10-15 Hz (Gillespie 1992, ch. 5)."""
WARM_UP_S: Final = 300.0
"""Time constant of a box that warms up, s, 60 to 1800. A choice: some minutes to the temperature of its electronics."""
ACCEL_MPS2_PER_K: Final = 0.5e-3 * STANDARD_GRAVITY_MPS2
"""Zero-g level against temperature, 0 to 0.02: LSM303DLHC data sheet, 0.5 mg/K typical."""
GYRO_RADPS_PER_K: Final = math.radians(0.03)
"""Zero-rate level against temperature, 0 to 0.002: L3GD20 data sheet, 0.03 deg/s/K at 250 deg/s."""

COLD_C: Final = 20.0
"""Of a box whose recording does not say, deg C, -40 to 85."""
THERMOMETER_K: Final = 1.0
"""Steps of a box's thermometer, K, 0.01 to 2: L3GD20 data sheet, 1 digit a K."""


def box_clock(stream: Stream, span: Span, step_s: float, rng: np.random.Generator) -> Stream:
    """From the span's start on all times are ``step_s`` ahead (behind where negative); the end says nothing."""
    stepped = {}
    for name, (times, *_) in SERIES.items():
        later = stream.comes_ns[name] >= span[0]
        stepped[times] = getattr(stream.measurements, times) + np.where(later, round(step_s * 1e9), 0).astype(np.int64)
    return stream.changed(**stepped)


def drops(stream: Stream, span: Span, share: float, rng: np.random.Generator) -> Stream:
    """A share of the inertial samples is missing, here and there."""
    inside = stream.during("imu", span)
    return stream.chosen("imu", np.flatnonzero(~(inside & (rng.random(inside.size) < share))))


def gaps(stream: Stream, span: Span, gap_s: float, rng: np.random.Generator) -> Stream:
    """Inertial samples are missing for ``gap_s`` at a time, every ``GAP_EVERY_S`` and at the span's start."""
    return stream.chosen("imu", np.flatnonzero(~_bursts(stream, "imu", span, gap_s)))


def duplicates(stream: Stream, span: Span, times: float, rng: np.random.Generator) -> Stream:
    """Each inertial sample and fix comes ``times`` times, with the same time."""
    for name in ("imu", "gnss"):
        inside = stream.during(name, span)
        stream = stream.chosen(name, np.repeat(np.arange(inside.size), np.where(inside, round(times), 1)))
    return stream


def saturation(stream: Stream, span: Span, size_mps2: float, rng: np.random.Generator) -> Stream:
    """A loose box rattles by ``size_mps2`` on all axes and its accelerometer clips; the car does not feel it.

    Where the recording says no full scale it is taken as 2 g, and said from here on.
    """
    m = stream.measurements
    known = math.isfinite(m.accel_full_scale_mps2)
    full_scale = m.accel_full_scale_mps2 if known else 2.0 * STANDARD_GRAVITY_MPS2
    angle = 2.0 * math.pi * SHAKING_HZ * (stream.comes_ns["imu"] - span[0]) * 1e-9
    shake = size_mps2 * np.sin(angle[:, None] + rng.uniform(0.0, 2.0 * math.pi, 3))
    inside = stream.during("imu", span)[:, None]
    f_s = np.where(inside, np.clip(m.f_s + shake, -full_scale, full_scale), m.f_s)
    return stream.changed(f_s=f_s, accel_full_scale_mps2=full_scale)


def temperature(stream: Stream, span: Span, rise_k: float, rng: np.random.Generator) -> Stream:
    """The box warms up by ``rise_k``, as 1 - exp(-t/WARM_UP_S); each axis's bias follows by its coefficient.

    Coefficients are the data sheets' typical ones with the sign by chance. What has warmed stays warm after the span.
    Packets say how warm the box is, as far as its thermometer's steps go.
    """
    m = stream.measurements
    since_s = np.clip((stream.comes_ns["imu"] - span[0]) * 1e-9, 0.0, (span[1] - span[0]) * 1e-9)
    warmth_k = -rise_k * np.expm1(-since_s / WARM_UP_S)
    signs = rng.choice([-1.0, 1.0], (2, 3))
    before_c = m.temperature_c if math.isfinite(m.temperature_c) else COLD_C
    warmed = stream.changed(
        f_s=m.f_s + np.outer(warmth_k, signs[0]) * ACCEL_MPS2_PER_K,
        omega_s=m.omega_s + np.outer(warmth_k, signs[1]) * GYRO_RADPS_PER_K,
    )
    return replace(warmed, temperature_c=np.round((before_c + warmth_k) / THERMOMETER_K) * THERMOMETER_K)


def stuck_gyroscope(stream: Stream, span: Span, axis: float, rng: np.random.Generator) -> Stream:
    """One axis of the gyroscope (0, 1 or 2) says what it said last."""
    omega_s = stream.measurements.omega_s.copy()
    _hold(omega_s[:, round(axis)], stream.during("imu", span))
    return stream.changed(omega_s=omega_s)


def stuck_accelerometer(stream: Stream, span: Span, axis: float, rng: np.random.Generator) -> Stream:
    """One axis of the accelerometer (0, 1 or 2) says what it said last."""
    f_s = stream.measurements.f_s.copy()
    _hold(f_s[:, round(axis)], stream.during("imu", span))
    return stream.changed(f_s=f_s)


def not_a_number(stream: Stream, span: Span, burst_s: float, rng: np.random.Generator) -> Stream:
    """All inertial axes are NaN for ``burst_s`` every ``GAP_EVERY_S``, and every fix within is NaN altogether."""
    m = stream.measurements
    imu, gnss = (_bursts(stream, name, span, burst_s)[:, None] for name in ("imu", "gnss"))
    return stream.changed(
        f_s=np.where(imu, np.nan, m.f_s),
        omega_s=np.where(imu, np.nan, m.omega_s),
        gnss=np.where(gnss, np.nan, m.gnss),
    )


def frozen_speed(stream: Stream, span: Span, size: float, rng: np.random.Generator) -> Stream:
    """The wheel speed stays what it was, with new times; ``size`` says nothing."""
    speed_mps = stream.measurements.speed_mps.copy()
    _hold(speed_mps, stream.during("speed", span))
    return stream.changed(speed_mps=speed_mps)


def _bursts(stream: Stream, series: str, span: Span, burst_s: float) -> BoolArray:
    """Which samples of a series (n,) come in the first ``burst_s`` of every ``GAP_EVERY_S`` of the span."""
    since_s = (stream.comes_ns[series] - span[0]) * 1e-9
    return np.asarray(stream.during(series, span) & (np.mod(since_s, GAP_EVERY_S) < burst_s))


def _hold(values: FloatArray, inside: BoolArray) -> None:
    """Where ``inside`` (n,) is true, the last value (n,) before it; in place."""
    at = np.flatnonzero(inside)
    if at.size:
        values[at] = values[max(int(at[0]) - 1, 0)]
