"""A telematics box and a filter behind it, in short: from what a body does to what a detector is given."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numba import njit
from scipy.signal import butter, sosfilt, sosfilt_zi

from core.accident.events import VehicleMotion
from core.earth import STANDARD_GRAVITY_MPS2
from core.measurements import FloatArray, TimeArray
from core.rotation import matrix_from_rpy
from core.simulation.body_motion import BodyMotion
from core.simulation.ride import FINE_HZ
from core.simulation.sensors import gauss_markov
from core.tunables import Tunables, tunable

G: Final = STANDARD_GRAVITY_MPS2
_DEG: Final = math.pi / 180.0


@dataclass(frozen=True, slots=True)
class FilterErrors(Tunables):
    """How far a filter's attitude and speed are off; measured on whole simulated drives (``telefuse bench --accidents
    --part errors``)."""

    tilt_sd_rad: float = tunable(
        0.25 * _DEG, unit="rad", low=0.0, high=0.2, source="twice the RMS of an axis measured in city, 0.13 deg"
    )
    tilt_s: float = tunable(7.0, unit="s", low=0.5, high=1000.0, source="measured: correlation time of that")
    start_tilt_sd_rad: float = tunable(
        1.5 * _DEG, unit="rad", low=0.0, high=0.5, source="choice: alignment in motion, at first"
    )
    speed_sd_mps: float = tunable(
        0.10, unit="m/s", low=0.0, high=5.0, source="measured in city: RMS 0.07 m/s; half as much again"
    )
    speed_s: float = tunable(6.0, unit="s", low=0.5, high=1000.0, source="measured: correlation time of that")
    recovery_s: float = tunable(
        1.0, unit="s", low=0.1, high=60.0, source="choice: a fix a second takes back what clipping hid from the filter"
    )


@dataclass(frozen=True, slots=True)
class Box:
    """A box: rate (Hz), full scales, the corner of its low-pass (Hz), noise densities, and how it stands in the car.

    ``mounting_rpy_rad`` is by how much it stands off what is known of its mounting.
    """

    rate_hz: float = 100.0
    full_scale_mps2: float = 16.0 * G
    gyro_full_scale_radps: float = 500.0 * _DEG
    corner_hz: float = 40.0
    accel_noise: float = 0.3e-3 * G
    gyro_noise_radps: float = 0.03 * _DEG
    accel_bias_mps2: float = 0.06
    mounting_rpy_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)
    errors: FilterErrors = FilterErrors()


def some_box(rng: np.random.Generator, full_scale_g: float | None = None, rate_hz: float | None = None) -> Box:
    """A box of the market: 2, 16 or 100 g, 50, 100 or 200 Hz, low-passed at a fifth to 0.45 of its rate.

    Noise: LSM303DLHC 220 ug/sqrt(Hz) at 2 g (seed 1), 300 at 16 g, 5 mg/sqrt(Hz) for 100 g parts (choice).
    """
    scale = float(rng.choice([2.0, 16.0, 100.0])) if full_scale_g is None else full_scale_g
    rate = float(rng.choice([50.0, 100.0, 200.0])) if rate_hz is None else rate_hz
    density = 0.22e-3 if scale <= 4.0 else 0.3e-3 if scale <= 32.0 else 5e-3
    return Box(
        rate_hz=rate,
        full_scale_mps2=scale * G,
        gyro_full_scale_radps=float(rng.choice([250.0, 500.0, 2000.0])) * _DEG,
        corner_hz=rate * float(rng.uniform(0.2, 0.45)),
        accel_noise=density * G,
        mounting_rpy_rad=tuple(np.radians(rng.normal(0.0, 1.0, 3)).tolist()),
    )


def sampled(fine: FloatArray, box: Box) -> FloatArray:
    """What is left of a signal (n, c) at ``FINE_HZ`` behind the box's low-pass (Butterworth, order 2), at its rate."""
    sos = butter(2, min(box.corner_hz, 0.45 * FINE_HZ), fs=FINE_HZ, output="sos")
    start = sosfilt_zi(sos)[:, :, None] * fine[0]
    smooth, _ = sosfilt(sos, fine, axis=0, zi=start)
    return np.asarray(smooth[:: round(FINE_HZ / box.rate_hz)])


def seen(
    motion: BodyMotion,
    box: Box,
    rng: np.random.Generator,
    start_t_ns: int,
    aligned_after_s: float = 0.0,
    ignition: bool | None = None,
    spoilt_at_s: float | None = None,
) -> VehicleMotion:
    """What a detector is given of a motion: calibrated samples of the box with the filter's attitude and speed.

    Until ``aligned_after_s`` the filter knows neither. At ``spoilt_at_s`` the converter fails (``spoilt``).
    """
    stride = round(FINE_HZ / box.rate_hz)
    C_m_from_b = matrix_from_rpy(*box.mounting_rpy_rad).T
    f_b, omega_b, down_b = (part @ C_m_from_b.T for part in motion.felt())
    f_m, omega_m, down_m = sampled(f_b, box), sampled(omega_b, box), down_b[::stride]
    f, saturated = converted(f_m, box.full_scale_mps2, box.accel_noise, box.rate_hz, rng)
    f += np.clip(rng.normal(0.0, box.accel_bias_mps2, 3), -0.15, 0.15)
    if spoilt_at_s is not None:
        spoilt(f, saturated, round(spoilt_at_s * box.rate_hz), box.full_scale_mps2, rng)
    omega, _ = converted(omega_m, box.gyro_full_scale_radps, box.gyro_noise_radps, box.rate_hz, rng)
    down = estimated_down(down_m, omega, box, rng)
    speed = estimated_speed(motion.v_n[::stride], f - f_m, motion.rpy_rad[::stride, 2], box, rng)
    unknown = np.arange(len(f)) < aligned_after_s * box.rate_hz
    down[unknown], speed[unknown] = np.nan, np.nan
    return VehicleMotion(
        t_ns=sample_times_ns(len(f), box.rate_hz, start_t_ns),
        f_b=f,
        omega_b=omega,
        down_b=down,
        speed_mps=speed,
        saturated=saturated,
        gravity_mps2=G,
        ignition=ignition,
    )


def sample_times_ns(n: int, rate_hz: float, start_t_ns: int) -> TimeArray:
    """Times of ``n`` samples, UTC nanoseconds."""
    return np.asarray(start_t_ns + np.rint(np.arange(n) * (1e9 / rate_hz)).astype(np.int64))


def converted(
    signal: FloatArray, full_scale: float, density: float, rate_hz: float, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """With white noise of a density (signal/sqrt(Hz)), clipped, (n, 3), and which rows are at full scale, (n,)."""
    clipped, saturated = _converted(
        signal, density * math.sqrt(rate_hz / 2.0), rng.standard_normal(signal.shape), full_scale
    )
    return clipped, saturated


@njit(cache=True, nogil=True)
def _converted(signal: FloatArray, sd: float, noise: FloatArray, full_scale: float) -> tuple[FloatArray, FloatArray]:
    clipped, saturated = np.empty_like(signal), np.zeros(signal.shape[0])
    for k in range(signal.shape[0]):
        for i in range(3):
            x = signal[k, i] + sd * noise[k, i]
            if abs(x) >= full_scale:
                saturated[k] = 1.0
                x = math.copysign(full_scale, x)
            clipped[k, i] = x
    return clipped, saturated


def spoilt(f: FloatArray, saturated: FloatArray, row: int, full_scale: float, rng: np.random.Generator) -> None:
    """A converter that fails, in place: single spikes, samples stuck at full scale, a flipped bit, or zeros."""
    form = rng.integers(4)
    axis = int(rng.integers(3))
    sign = float(rng.choice([-1.0, 1.0]))
    if form == 0:  # one sample, or a few apart
        for at in row + np.cumsum(rng.integers(1, 12, int(rng.integers(1, 5)))):
            if at < len(f):
                f[at, axis] = sign * full_scale * rng.uniform(0.3, 1.0)
    elif form == 1:  # stuck at full scale, all axes or one
        span = slice(row, row + int(rng.integers(1, max(2, round(0.01 * len(f))))))
        axes = slice(None) if rng.random() < 0.3 else axis
        f[span, axes] = sign * full_scale
        saturated[span] = 1.0
    elif form == 2:  # one of the higher bits, in single samples
        step = full_scale / 32768.0
        for at in row + np.cumsum(rng.integers(1, 20, int(rng.integers(1, 6)))):
            if at < len(f):
                counts = round(float(f[at, axis]) / step) & 0xFFFF
                counts ^= 1 << int(rng.integers(11, 16))
                f[at, axis] = (counts - 65536 if counts >= 32768 else counts) * step
    else:  # nothing but zeros: a bus that hangs
        f[row : row + int(rng.integers(1, 10))] = 0.0


def estimated_down(down_b: FloatArray, omega_b: FloatArray, box: Box, rng: np.random.Generator) -> FloatArray:
    """A filter's vertical: carried on by the gyroscopes as they read, and drawn to the truth as aids do."""
    errors, dt_s = box.errors, 1.0 / box.rate_hz
    drive = errors.tilt_sd_rad * math.sqrt(2.0 * dt_s / errors.tilt_s)
    noise = drive * rng.standard_normal(down_b.shape)
    first = down_b[0] + errors.tilt_sd_rad * rng.standard_normal(3)
    return _carried(down_b, omega_b, noise, first, dt_s, dt_s / errors.tilt_s)


@njit(cache=True, nogil=True)
def _carried(
    down_b: FloatArray, omega_b: FloatArray, noise: FloatArray, first: FloatArray, dt_s: float, pull: float
) -> FloatArray:
    out = np.empty_like(down_b)
    x, y, z = first[0], first[1], first[2]
    for k in range(down_b.shape[0]):
        if k > 0:
            p = 0.5 * dt_s * (omega_b[k, 0] + omega_b[k - 1, 0])
            q = 0.5 * dt_s * (omega_b[k, 1] + omega_b[k - 1, 1])
            r = 0.5 * dt_s * (omega_b[k, 2] + omega_b[k - 1, 2])
            a, b, c = x + y * r - z * q, y + z * p - x * r, z + x * q - y * p
            x = a + pull * (down_b[k, 0] - a) + noise[k, 0]
            y = b + pull * (down_b[k, 1] - b) + noise[k, 1]
            z = c + pull * (down_b[k, 2] - c) + noise[k, 2]
        norm = 1.0 / math.sqrt(x * x + y * y + z * z)
        x, y, z = x * norm, y * norm, z * norm
        out[k, 0], out[k, 1], out[k, 2] = x, y, z
    return out


def estimated_speed(
    v_n: FloatArray, hidden_b: FloatArray, yaw_rad: FloatArray, box: Box, rng: np.random.Generator
) -> FloatArray:
    """A filter's speed, (n,): off by a slow error, and by what clipping hid until fixes take it back."""
    errors, dt_s = box.errors, 1.0 / box.rate_hz
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    missed = np.column_stack([hidden_b[:, 0] * c - hidden_b[:, 1] * s, hidden_b[:, 0] * s + hidden_b[:, 1] * c])
    missed[np.abs(missed) < 1.0] = 0.0  # noise and bias are the slow error's
    off = _leaking(missed * dt_s, math.exp(-dt_s / errors.recovery_s))
    slow = gauss_markov(len(v_n), errors.speed_sd_mps, errors.speed_s, dt_s, rng)
    return np.abs(np.hypot(v_n[:, 0] + off[:, 0], v_n[:, 1] + off[:, 1]) + slow)


@njit(cache=True, nogil=True)
def _leaking(steps: FloatArray, keep: float) -> FloatArray:
    out = np.empty_like(steps)
    x = y = 0.0
    for k in range(steps.shape[0]):
        x = keep * x + steps[k, 0]
        y = keep * y + steps[k, 1]
        out[k, 0], out[k, 1] = x, y
    return out
