"""The sessions that the engine runs: ``core.session`` with the settings that a vehicle has."""

from __future__ import annotations

import math

from core.navigation.filter import FilterConfig
from core.preparation import Mounting
from core.sensors import TriadCalibration
from core.session import Session, SessionConfig
from schemas.vehicles import SensorCalibration, VehicleConfig


def session_config(config: VehicleConfig) -> SessionConfig:
    """A vehicle's settings in the units of the core."""
    calibration = config.calibration
    full_scale_mps2 = config.accel_full_scale_mps2
    return SessionConfig(
        accelerometer=_triad(None if calibration is None else calibration.accelerometer),
        gyroscope=_triad(None if calibration is None else calibration.gyroscope),
        mounting=_mounting(config.mounting_rpy_deg),
        accel_full_scale_mps2=math.nan if full_scale_mps2 is None else full_scale_mps2,
        gnss_time_offset_s=config.gnss_time_offset_s,
        filter=FilterConfig(imu_lever_b_m=config.imu_lever_arm_m, antenna_lever_b_m=config.gnss_lever_arm_m),
        detector=config.detector,
    )


def open_session(config: VehicleConfig, snapshot: bytes | None) -> Session:
    """A new session, or one that goes on from a snapshot; raises SnapshotError."""
    settings = session_config(config)
    return Session(settings) if snapshot is None else Session.restore(settings, snapshot)


def _triad(calibration: SensorCalibration | None) -> TriadCalibration:
    if calibration is None:
        return TriadCalibration()
    return TriadCalibration(calibration.scale, calibration.misalignment, calibration.bias)


def _mounting(rpy_deg: tuple[float, float, float] | None) -> Mounting:
    if rpy_deg is None:
        return Mounting()
    roll_deg, pitch_deg, yaw_deg = rpy_deg
    return Mounting((math.radians(roll_deg), math.radians(pitch_deg), math.radians(yaw_deg)), known=True)
