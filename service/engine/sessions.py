"""The sessions that the engine runs: ``core.session`` with the settings that a vehicle has."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import product
from typing import Final, Literal

import numpy as np

from core.accident.profiles import for_vehicle
from core.calibration.drift import Biases, DriftThresholds
from core.calibration.in_force import NO_SPREAD, BoxCalibration
from core.measurements import GNSS, GNSS_COLUMNS, Measurements
from core.navigation.filter import FilterConfig
from core.navigation.sensor_noise import matched_tuning
from core.navigation.tuning import Tuning
from core.preparation import Mounting
from core.sensors import MagnetometerCalibration, TriadCalibration, TriadNoise, Triple
from core.session import Session, SessionConfig
from schemas.calibration import Calibration, GyroscopeCalibration, SensorCalibration, TriadSd
from schemas.calibration import MagnetometerCalibration as MagnetometerForm
from schemas.vehicles import AccelerometerNoise, GyroscopeNoise, SensorNoise, VehicleConfig
from service.storage.calibrations import GivenCalibration

DETECTORS: Final[tuple[Literal["telefuse", "paper"], ...]] = ("telefuse", "paper")
EARTH_RADIUS_M: Final = 6.37e6
NO_ALIGNMENT: Final[Triple] = (0.0, 0.0, 0.0)
"""The accelerometers' axes are the box's."""
FULL_SCALE_MPS2: Final = 2 * 9.8
"""Close enough for the made-up drive of ``warm_up``."""


def session_config(config: VehicleConfig, calibrations: Sequence[GivenCalibration] = ()) -> SessionConfig:
    """A vehicle's settings and calibrations in the units of the core."""
    full_scale_mps2 = config.accel_full_scale_mps2
    return SessionConfig(
        calibrations=tuple(box_calibration(one) for one in calibrations),
        mounting=_mounting(config.mounting_rpy_deg),
        accel_full_scale_mps2=math.nan if full_scale_mps2 is None else full_scale_mps2,
        filter=FilterConfig(
            tuning=_tuning(config.noise),
            imu_lever_b_m=config.imu_lever_arm_m,
            antenna_lever_b_m=config.gnss_lever_arm_m,
            gnss_time_offset_s=config.gnss_time_offset_s,
        ),
        detector=config.detector,
        impact=for_vehicle(config.vehicle_class),
    )


def open_session(config: VehicleConfig, calibrations: Sequence[GivenCalibration], snapshot: bytes | None) -> Session:
    """A new session, or one that goes on from a snapshot; raises SnapshotError."""
    settings = session_config(config, calibrations)
    return Session(settings) if snapshot is None else Session.restore(settings, snapshot)


def warm_up() -> None:
    """Run sessions over some seconds of made-up driving and a crash, so that no packet waits for the compiler."""
    rate_hz, duration_s, speed_mps = 100, 12, 10.0
    t_s = np.arange(rate_hz * duration_s) / rate_hz
    fix_s = np.arange(duration_s)
    gnss = np.full((duration_s, len(GNSS_COLUMNS)), np.nan)
    gnss[:, [GNSS["lat_rad"], GNSS["lon_rad"], GNSS["alt_m"]]] = 0.7, 0.0, 100.0
    gnss[:, GNSS["lat_rad"]] += fix_s * speed_mps / EARTH_RADIUS_M
    gnss[:, [GNSS["vn_mps"], GNSS["ve_mps"], GNSS["vd_mps"]]] = speed_mps, 0.0, 0.0
    gnss[:, GNSS["fix"]] = 3.0
    f_s = np.tile([0.0, 0.0, -9.8], (len(t_s), 1))
    # It swells, or it would be a converter's that fails; and clips, so that what was hidden is looked for as well.
    f_s[:, 0] = -np.minimum(40.0 * np.sin(np.pi * np.clip((t_s - 10.0) / 0.12, 0.0, 1.0)) ** 2, FULL_SCALE_MPS2)
    measurements = Measurements(
        imu_t_ns=np.rint(t_s * 1e9).astype(np.int64),
        f_s=f_s,
        omega_s=np.zeros((len(t_s), 3)),
        gnss_t_ns=np.rint(fix_s * 1e9).astype(np.int64),
        gnss=gnss,
        magnetometer_t_ns=np.rint(fix_s * 1e9).astype(np.int64),
        magnetic_s_ut=np.tile([25.0, 0.0, 40.0], (duration_s, 1)),
        speed_t_ns=np.rint(fix_s * 1e9).astype(np.int64),
        speed_mps=np.full(duration_s, speed_mps),
        barometer_t_ns=np.rint(fix_s * 1e9).astype(np.int64),
        pressure_pa=np.full(duration_s, 100_000.0),
    )
    for detector, known in product(DETECTORS, (True, False)):
        mounting = Mounting(known=known)
        config = SessionConfig(mounting=mounting, accel_full_scale_mps2=FULL_SCALE_MPS2, detector=detector)
        session = Session(config)
        session.step(measurements)
        Session.restore(config, session.snapshot())


def box_calibration(given: GivenCalibration) -> BoxCalibration:
    """A version in the units of the core."""
    calibration, learnt = given.calibration, given.learnt
    accelerometer, gyroscope = calibration.accelerometer, calibration.gyroscope
    return BoxCalibration(
        version=given.version,
        valid_from_ns=given.valid_from_ns,
        accelerometer=_triad(accelerometer),
        gyroscope=_triad(gyroscope),
        accelerometer_bias_sd=_bias_sd(accelerometer, DriftThresholds().accel_unknown_sd_mps2),
        gyroscope_bias_sd=_bias_sd(gyroscope, DriftThresholds().gyro_unknown_sd_radps),
        learnt=None if learnt is None else _biases(learnt.valid_from_ns, learnt.calibration),
        magnetometer=_iron(calibration.magnetometer),
    )


def _triad(calibration: SensorCalibration | None) -> TriadCalibration:
    if calibration is None:
        return TriadCalibration()
    alignment = calibration.alignment if isinstance(calibration, GyroscopeCalibration) else NO_ALIGNMENT
    return TriadCalibration(calibration.scale, calibration.misalignment, calibration.bias, alignment)


def _iron(calibration: MagnetometerForm | None) -> MagnetometerCalibration:
    if calibration is None:
        return MagnetometerCalibration()
    return MagnetometerCalibration(calibration.hard_iron, calibration.soft_iron)


def _bias_sd(calibration: SensorCalibration | None, unstated: float) -> Triple:
    """NaN where the sensor was never calibrated."""
    if calibration is None:
        return NO_SPREAD
    stated = None if calibration.sd is None else calibration.sd.bias
    return (unstated, unstated, unstated) if stated is None else stated


def _biases(t_ns: int, calibration: Calibration) -> Biases:
    """What a trip left, as ``learnt_calibration`` wrote it."""
    both = (calibration.accelerometer, calibration.gyroscope)
    return Biases(
        t_ns,
        np.concatenate([np.array(_triad(one).bias) for one in both]),
        np.concatenate([np.array(_bias_sd(one, math.nan)) for one in both]),
    )


def learnt_calibration(base: Calibration, biases: Biases) -> Calibration:
    """``base`` with the biases that a trip left, of those sensors of which anything is known."""
    unknown = DriftThresholds().of("unknown")
    sd = np.where(np.isfinite(biases.sd), biases.sd, unknown)
    changed: dict[str, SensorCalibration] = {}
    for place, name, form in ((0, "accelerometer", SensorCalibration), (3, "gyroscope", GyroscopeCalibration)):
        axes = slice(place, place + 3)
        if np.isfinite(biases.sd[axes]).any():
            known = getattr(base, name) or form()
            spread = (known.sd or TriadSd()).model_copy(update={"bias": tuple(sd[axes].tolist())})
            changed[name] = known.model_copy(update={"bias": tuple(biases.bias[axes].tolist()), "sd": spread})
    return base.model_copy(update=changed)


def _tuning(noise: SensorNoise | None) -> Tuning:
    if noise is None:
        return Tuning()
    return matched_tuning(Tuning(), _worst_axis(noise.accelerometer), _worst_axis(noise.gyroscope))


def _worst_axis(noise: AccelerometerNoise | GyroscopeNoise | None) -> TriadNoise:
    """The filter knows one noise a triad: too much of it on two axes costs less than too little on one."""
    if noise is None:
        return TriadNoise()
    figures = (noise.random_walk, noise.bias_instability, noise.rate_random_walk, noise.turn_on_bias_sd)
    return TriadNoise(*(None if axes is None else max(axes) for axes in figures))


def _mounting(rpy_deg: tuple[float, float, float] | None) -> Mounting:
    if rpy_deg is None:
        return Mounting()
    roll_deg, pitch_deg, yaw_deg = rpy_deg
    return Mounting((math.radians(roll_deg), math.radians(pitch_deg), math.radians(yaw_deg)), known=True)
