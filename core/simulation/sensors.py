"""The box: what its inertial sensors, magnetometer and wheel speed show of a true trajectory."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from scipy.signal import lfilter

from core.atmosphere import standard_density_kgpm3, standard_pressure_pa
from core.earth import STANDARD_GRAVITY_MPS2
from core.measurements import FloatArray
from core.rotation import matrix_from_rpy
from core.sensors import ALLAN_FLOOR, TriadCalibration, TriadNoise, Triple, triple
from core.simulation.trajectory import Trajectory, matrices_b_from_n, rotate
from core.tunables import Tunables, tunable

_MG: Final = 1e-3 * STANDARD_GRAVITY_MPS2
_DEG: Final = math.pi / 180.0
_LSM: Final = "LSM303DLHC (seed 1, table 1)"
_L3G: Final = "L3GD20 (seed 1, table 1)"


@dataclass(frozen=True, slots=True)
class TriadErrors(Tunables):
    """Error budget of one triad; the unit of the signal is m/s2 or rad/s. Default: the accelerometer.

    Scale, misalignment and bias are what is left after the box's own factory calibration, drawn anew
    at each turn-on; ``random_walk`` is the white noise's density as in Groves (2013) sec. 4.4.3.
    """

    full_scale: float = tunable(
        2.0 * STANDARD_GRAVITY_MPS2, unit="m/s2 or rad/s", low=0.1, high=4000.0, source=f"{_LSM}: 2 g"
    )
    random_walk: float = tunable(
        0.22 * _MG, unit="signal/sqrt(Hz)", low=0.0, high=1.0, source=f"{_LSM}: 220 ug/sqrt(Hz)"
    )
    bias_sd: float = tunable(
        6.0 * _MG, unit="signal", low=0.0, high=10.0, source="choice: turn-on change of a calibrated consumer MEMS"
    )
    scale_sd: float = tunable(0.002, unit="1", low=0.0, high=0.2, source="choice: 0.2 % after calibration")
    misalignment_sd_rad: float = tunable(0.1 * _DEG, unit="rad", low=0.0, high=0.2, source="choice: after calibration")
    instability_sd: float = tunable(
        0.15 * _MG, unit="signal", low=0.0, high=1.0, source="choice: flicker floor of consumer MEMS, 0.1-0.3 mg"
    )
    instability_s: float = tunable(
        300.0, unit="s", low=1.0, high=1e5, source="choice: correlation time of minutes, as in Allan plots of MEMS"
    )

    @property
    def step(self) -> float:
        """Least step of the 16-bit converter."""
        return self.full_scale / 32768.0

    @property
    def noise(self) -> TriadNoise:
        """What a recording at rest tells: its instability is the floor that noise and the bias' walk make together.

        The Allan variance N^2 / t + K^2 t / 3 is least at 2 N K / sqrt(3). The spread between turn-ons is the drawn
        bias and the drift that is under way.
        """
        walk = self.instability_sd * math.sqrt(2.0 / self.instability_s)
        floor = math.sqrt(2.0 * self.random_walk * walk / math.sqrt(3.0))
        return TriadNoise(self.random_walk, floor / ALLAN_FLOOR, walk, math.hypot(self.bias_sd, self.instability_sd))


ACCELEROMETER: Final = TriadErrors()
GYROSCOPE: Final = TriadErrors(
    full_scale=250.0 * _DEG,  # L3GD20, 250 deg/s
    random_walk=0.03 * _DEG,  # L3GD20, 0.03 deg/s/sqrt(Hz)
    bias_sd=0.08 * _DEG,  # choice: turn-on change of a calibrated consumer gyroscope
    scale_sd=0.002,
    instability_sd=0.006 * _DEG,  # choice: 20 deg/h floor
)


@dataclass(frozen=True, slots=True)
class FactorySpread(Tunables):
    """How far a unit is from ideal before any calibration: what an uncalibrated box shows."""

    accel_bias_sd_mps2: float = tunable(
        30.0 * _MG,
        unit="m/s2",
        low=0.0,
        high=2.0,
        source="LSM303DLHC: zero-g offset 60 mg typical, here one sigma half",
    )
    gyro_bias_sd_radps: float = tunable(1.0 * _DEG, unit="rad/s", low=0.0, high=0.2, source="L3GD20: after soldering")
    scale_sd: float = tunable(0.015, unit="1", low=0.0, high=0.2, source="choice; data sheets give up to 4 %")
    misalignment_sd_rad: float = tunable(0.8 * _DEG, unit="rad", low=0.0, high=0.2, source="choice: soldering, die")


@dataclass(frozen=True, slots=True)
class Vibration(Tunables):
    """Coloured shaking by road and engine as the box feels it, with no share at zero frequency."""

    road_hz: float = tunable(12.0, unit="Hz", low=1.0, high=100.0, source="wheel hop, 10-15 Hz (Gillespie 1992, ch. 5)")
    road_width: float = tunable(0.5, unit="1", low=0.05, high=2.0, source="choice: damping ratio of the band")
    road_sd_mps2: float = tunable(
        0.45, unit="m/s2", low=0.0, high=5.0, source="choice: vertical at 14 m/s on good asphalt, 0.3-0.6"
    )
    road_speed_mps: float = tunable(14.0, unit="m/s", low=1.0, high=50.0, source="speed that road_sd_mps2 is for")
    horizontal_share: float = tunable(0.4, unit="1", low=0.0, high=1.0, source="choice: of the vertical shaking")
    engine_hz: float = tunable(27.0, unit="Hz", low=5.0, high=200.0, source="four cylinders idling at 800 rpm")
    engine_sd_mps2: float = tunable(0.06, unit="m/s2", low=0.0, high=2.0, source="choice: idling car 0.03-0.1")
    ringing_hz: float = tunable(45.0, unit="Hz", low=5.0, high=200.0, source="choice: body structure, 30-60 Hz")
    ringing_share: float = tunable(
        0.15, unit="1", low=0.0, high=1.0, source="choice: ringing after a blow, sd over the blow's acceleration"
    )
    ringing_from_mps2: float = tunable(
        6.0, unit="m/s2", low=0.0, high=100.0, source="choice: below it springs and tyres swallow a blow"
    )
    ringing_s: float = tunable(0.08, unit="s", low=0.005, high=1.0, source="choice: decay of the ringing")
    gyro_radps_per_mps2: float = tunable(
        0.010, unit="rad/s per m/s2", low=0.0, high=0.1, source="choice: 0.25 deg/s at 14 m/s"
    )


@dataclass(frozen=True, slots=True)
class Barometer(Tunables):
    """Error budget of a barometer in a cabin: the weather, the sensor's offset, the wind of driving, and noise."""

    offset_sd_pa: float = tunable(
        800.0,
        unit="Pa",
        low=0.0,
        high=5000.0,
        source="choice: weather of middle latitudes, 1013 +- 8 hPa, and the sensor",
    )
    drift_sd_pa: float = tunable(
        25.0, unit="Pa", low=0.0, high=1000.0, source="choice: weather and height of the sun, 0.5-1 hPa an hour; fan"
    )
    drift_s: float = tunable(
        1800.0, unit="s", low=1.0, high=1e6, source="choice: correlation time of that, half an hour"
    )
    wind_share_sd: float = tunable(
        0.05, unit="1", low=0.0, high=1.0, source="choice: of the dynamic pressure of driving that a cabin sees, +-"
    )
    noise_sd_pa: float = tunable(
        1.3, unit="Pa", low=0.0, high=100.0, source="BMP280 data sheet: RMS noise 1.3 Pa without filter, 11 cm"
    )
    step_pa: float = tunable(
        0.16, unit="Pa", low=1e-3, high=100.0, source="BMP280 data sheet: 20 bit, resolution 0.16 Pa"
    )


@dataclass(frozen=True, slots=True)
class Device:
    """A black box. Default: the Micro-iBB (seed 1, table 1), calibrated at the factory.

    ``uncalibrated`` records the unit as it was soldered; the truth then carries its calibration.
    ``mounting_sd_rad`` is by how much the box stands off the stated mounting, each axis.
    """

    name: str = "micro_ibb"
    accelerometer: TriadErrors = ACCELEROMETER
    gyroscope: TriadErrors = GYROSCOPE
    vibration: Vibration = field(default_factory=Vibration)
    factory: FactorySpread = field(default_factory=FactorySpread)
    uncalibrated: bool = False
    mounting_rpy_rad: Triple = (0.0, 0.0, 0.0)
    mounting_sd_rad: float = 0.3 * _DEG  # choice: fitted with care; 0 to 0.1
    magnetometer_hz: float = 10.0  # choice; LSM303DLHC offers 0.75 to 220 Hz
    magnetometer_sd_ut: float = 0.4  # LSM303DLHC: 2 to 5 mG RMS; 0 to 10
    hard_iron_sd_ut: float = 0.8  # choice: left over after a calibration in the car; 0 to 50
    wheel_speed_hz: float = 0.0  # 0: no wheel speed; a CAN bus gives 4 to 100 Hz
    wheel_scale_sd: float = 0.015  # choice: tyre wear and pressure, 1-2 %; 0 to 0.1
    barometer_hz: float = 0.0  # 0: no barometer; a BMP280 gives up to 157 Hz
    barometer: Barometer = field(default_factory=Barometer)


MICRO_IBB: Final = Device()
WIDE_RANGE: Final = Device(
    name="micro_ibb_wide",
    accelerometer=TriadErrors(full_scale=16.0 * STANDARD_GRAVITY_MPS2, random_walk=0.3 * _MG),
    gyroscope=TriadErrors(
        full_scale=2000.0 * _DEG, random_walk=0.03 * _DEG, bias_sd=0.08 * _DEG, instability_sd=0.006 * _DEG
    ),
)
UNCALIBRATED: Final = Device(name="micro_ibb_uncalibrated", uncalibrated=True)
LOW_COST_MEMS: Final = Device(
    name="low_cost_mems",
    # 3 mg, 200 deg/h turn-on and 0.3 deg/sqrt(h): the unit of the measured facts on outages (DESIGN).
    accelerometer=TriadErrors(
        full_scale=4.0 * STANDARD_GRAVITY_MPS2, random_walk=0.1 * _MG, bias_sd=3.0 * _MG, scale_sd=0.001
    ),
    gyroscope=TriadErrors(
        full_scale=250.0 * _DEG,
        random_walk=0.3 / 60.0 * _DEG,
        bias_sd=200.0 / 3600.0 * _DEG,
        scale_sd=0.001,
        instability_sd=10.0 / 3600.0 * _DEG,
    ),
    mounting_sd_rad=0.0,
)
# On a bracket or panel beside the engine instead of under the dashboard: 1.5 m/s2 is a choice, 25 times the latter's.
SHAKEN: Final = replace(LOW_COST_MEMS, name="low_cost_mems_shaken", vibration=Vibration(engine_sd_mps2=1.5))

EXACT_MEMS: Final = replace(
    LOW_COST_MEMS,
    accelerometer=replace(LOW_COST_MEMS.accelerometer, scale_sd=0.0, misalignment_sd_rad=0.0, instability_sd=0.0),
    gyroscope=replace(LOW_COST_MEMS.gyroscope, scale_sd=0.0, misalignment_sd_rad=0.0, instability_sd=0.0),
    vibration=Vibration(road_sd_mps2=0.0, engine_sd_mps2=0.0, ringing_share=0.0),
    wheel_speed_hz=4.0,
    wheel_scale_sd=0.005,
)
"""The same unit with white noise and turn-on biases alone, in a car that does not shake, and with a wheel speed
whose scale is off by some 0.5 %."""


@dataclass(frozen=True, slots=True)
class DeviceErrors:
    """What was drawn for one unit at one turn-on: the truth behind its measurements."""

    accelerometer: TriadCalibration
    gyroscope: TriadCalibration
    known_accelerometer: TriadCalibration
    known_gyroscope: TriadCalibration
    C_s_from_b: tuple[Triple, Triple, Triple]
    mounting_error_rpy_rad: Triple
    hard_iron_ut: Triple
    wheel_scale: float
    pressure_offset_pa: float
    wind_share: float


def draw_errors(device: Device, rng: np.random.Generator) -> DeviceErrors:
    """Draw a unit: its triads, what its calibration knows of them, and how it really stands in the car."""
    known: list[TriadCalibration] = []
    actual: list[TriadCalibration] = []
    bias_sds = (device.factory.accel_bias_sd_mps2, device.factory.gyro_bias_sd_radps)
    for triad, factory_bias_sd in zip((device.accelerometer, device.gyroscope), bias_sds, strict=True):
        spread = rng.standard_normal((3, 3)) if device.uncalibrated else np.zeros((3, 3))
        rest = rng.standard_normal((3, 3))
        scale = 1.0 + device.factory.scale_sd * spread[0]
        tilt = device.factory.misalignment_sd_rad * spread[1]
        bias = factory_bias_sd * spread[2]
        known.append(TriadCalibration(triple(scale), triple(tilt), triple(bias)))
        actual.append(
            TriadCalibration(
                triple(scale * (1.0 + triad.scale_sd * rest[0])),
                triple(tilt + triad.misalignment_sd_rad * rest[1]),
                triple(bias + triad.bias_sd * rest[2]),
            )
        )
    off = device.mounting_sd_rad * rng.standard_normal(3)
    C_b_from_s = matrix_from_rpy(*device.mounting_rpy_rad) @ matrix_from_rpy(*off)
    return DeviceErrors(
        accelerometer=actual[0],
        gyroscope=actual[1],
        known_accelerometer=known[0],
        known_gyroscope=known[1],
        C_s_from_b=(triple(C_b_from_s[:, 0]), triple(C_b_from_s[:, 1]), triple(C_b_from_s[:, 2])),
        mounting_error_rpy_rad=triple(off),
        hard_iron_ut=triple(device.hard_iron_sd_ut * rng.standard_normal(3)),
        wheel_scale=1.0 + device.wheel_scale_sd * float(rng.standard_normal()),
        pressure_offset_pa=device.barometer.offset_sd_pa * float(rng.standard_normal()),
        wind_share=device.barometer.wind_share_sd * float(rng.standard_normal()),
    )


def measure_inertial(
    truth: Trajectory, device: Device, errors: DeviceErrors, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Specific force and rate, (n, 3) each in sensor axes: shaken, distorted, noisy, clipped and quantised."""
    dt_s = float(truth.t_s[1] - truth.t_s[0])
    shake_b = _vibration(truth, device.vibration, dt_s, rng)
    twist_b = device.vibration.gyro_radps_per_mps2 * shake_b[:, [1, 0, 2]]
    f_s = _turn(errors.C_s_from_b, truth.f_b + shake_b)
    omega_s = _turn(errors.C_s_from_b, truth.omega_b + twist_b)
    return (
        _convert(errors.accelerometer.apply(f_s), device.accelerometer, dt_s, rng),
        _convert(errors.gyroscope.apply(omega_s), device.gyroscope, dt_s, rng),
    )


def measure_magnetic(
    truth: Trajectory, field_n_ut: Triple, device: Device, errors: DeviceErrors, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Times (k,) and the magnetic field (k, 3) in sensor axes, microtesla, with hard iron left over."""
    rows = _every(truth, device.magnetometer_hz)
    field_n = np.broadcast_to(np.array(field_n_ut), (rows.size, 3))
    field_b = rotate(matrices_b_from_n(truth.rpy_rad[rows]), field_n)
    field_s = _turn(errors.C_s_from_b, field_b) + np.array(errors.hard_iron_ut)
    return truth.t_s[rows], field_s + device.magnetometer_sd_ut * rng.standard_normal(field_s.shape)


def measure_wheel_speed(truth: Trajectory, device: Device, errors: DeviceErrors) -> tuple[FloatArray, FloatArray]:
    """Times (l,) and the speed (l,) that the wheels say, in steps of 0.01 m/s."""
    rows = _every(truth, device.wheel_speed_hz)
    yaw = truth.rpy_rad[rows, 2]
    forward = truth.v_n[rows, 0] * np.cos(yaw) + truth.v_n[rows, 1] * np.sin(yaw)
    return truth.t_s[rows], np.round(np.abs(forward) * errors.wheel_scale, 2)


def measure_pressure(
    truth: Trajectory, device: Device, errors: DeviceErrors, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Times (b,) and air pressure (b,), Pa: a standard atmosphere over the ellipsoid, and the errors on top."""
    rows = _every(truth, device.barometer_hz)
    barometer, n = device.barometer, rows.size
    if not n:
        return np.empty(0), np.empty(0)
    dt_s = 1.0 / device.barometer_hz
    dynamic_pa = 0.5 * standard_density_kgpm3(truth.alt_m[rows]) * truth.speed_mps[rows] ** 2
    pressure_pa = (
        standard_pressure_pa(truth.alt_m[rows])
        + errors.pressure_offset_pa
        + errors.wind_share * dynamic_pa
        + gauss_markov(n, barometer.drift_sd_pa, barometer.drift_s, dt_s, rng)
        + barometer.noise_sd_pa * rng.standard_normal(n)
    )
    return truth.t_s[rows], np.rint(pressure_pa / barometer.step_pa) * barometer.step_pa


def gauss_markov(n: int, sd: float, correlation_s: float, dt_s: float, rng: np.random.Generator) -> FloatArray:
    """Stationary first-order Gauss-Markov sequence, (n,) (Groves 2013, sec. 4.4.3)."""
    keep = math.exp(-dt_s / correlation_s)
    drive = sd * math.sqrt(1.0 - keep * keep) * rng.standard_normal(n)
    drive[0] = sd * rng.standard_normal()
    return np.asarray(lfilter([1.0], [1.0, -keep], drive))


def _every(truth: Trajectory, rate_hz: float) -> FloatArray:
    """Rows of the truth nearest to a slower sensor's samples."""
    if rate_hz <= 0.0:
        return np.empty(0, dtype=np.int64)
    dt_s = truth.t_s[1] - truth.t_s[0]
    count = int(truth.t_s[-1] * rate_hz) + 1
    return np.unique(np.minimum(np.rint(np.arange(count) / rate_hz / dt_s).astype(np.int64), truth.t_s.size - 1))


def _vibration(truth: Trajectory, vibration: Vibration, dt_s: float, rng: np.random.Generator) -> FloatArray:
    """Shaking by the road, the engine, and the body's ringing after a blow: (n, 3), m/s2."""
    n = truth.t_s.size
    axes = np.array([vibration.horizontal_share, vibration.horizontal_share, 1.0])
    road_sd = vibration.road_sd_mps2 * np.sqrt(truth.speed_mps / vibration.road_speed_mps)
    road = np.column_stack([_band(n, vibration.road_hz, vibration.road_width, dt_s, rng) for _ in range(3)])
    engine = np.column_stack([_band(n, vibration.engine_hz, 0.02, dt_s, rng) for _ in range(3)])
    ringing = np.column_stack([_band(n, vibration.ringing_hz, 0.15, dt_s, rng) for _ in range(3)])
    moved = np.hypot(np.hypot(truth.f_b[:, 0], truth.f_b[:, 1]), truth.f_b[:, 2] + STANDARD_GRAVITY_MPS2)
    blow = np.maximum(0.0, moved - vibration.ringing_from_mps2)
    fade = math.exp(-dt_s / vibration.ringing_s)
    ringing_sd = vibration.ringing_share * lfilter([1.0 - fade], [1.0, -fade], blow)
    return np.asarray(
        road * axes * road_sd[:, None] + engine * vibration.engine_sd_mps2 + ringing * ringing_sd[:, None]
    )


def _band(n: int, centre_hz: float, width: float, dt_s: float, rng: np.random.Generator) -> FloatArray:
    """Noise of unit sd about a frequency: a resonator with zeros at 0 Hz and at half the rate."""
    angle = 2 * math.pi * min(centre_hz, 0.35 / dt_s) * dt_s
    radius = math.exp(-width * angle)
    a1, a2 = -2.0 * radius * math.cos(angle), radius * radius
    impulse = np.zeros(4096)
    impulse[0] = 1.0
    gain = math.sqrt(float(np.sum(lfilter([1.0, 0.0, -1.0], [1.0, a1, a2], impulse) ** 2)))
    return np.asarray(lfilter([1.0, 0.0, -1.0], [1.0, a1, a2], rng.standard_normal(n)) / gain)


def with_noise(signal: FloatArray, triad: TriadErrors, dt_s: float, rng: np.random.Generator) -> FloatArray:
    """A signal (n, 3) with the drift of the triad's bias and its white noise, in the signal's unit."""
    n = signal.shape[0]
    drift = np.column_stack([gauss_markov(n, triad.instability_sd, triad.instability_s, dt_s, rng) for _ in range(3)])
    noise = triad.random_walk / math.sqrt(dt_s) * rng.standard_normal((n, 3))
    return np.asarray(signal + drift + noise)


def _convert(signal: FloatArray, triad: TriadErrors, dt_s: float, rng: np.random.Generator) -> FloatArray:
    counts = np.clip(np.rint(with_noise(signal, triad, dt_s, rng) / triad.step), -32768, 32767)
    return np.asarray(counts * triad.step)


def _turn(rows: tuple[Triple, Triple, Triple], vectors: FloatArray) -> FloatArray:
    """Matrix times each vector, (n, 3)."""
    x, y, z = vectors[:, 0], vectors[:, 1], vectors[:, 2]
    return np.column_stack([row[0] * x + row[1] * y + row[2] * z for row in rows])
