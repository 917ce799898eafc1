"""A simulated drive as a drive of the drive-folder form."""

from __future__ import annotations

import math
from dataclasses import asdict

from core.simulation.scenarios import SimulatedDrive, absolute_ns
from core.simulation.sensors import Device
from schemas.vehicles import SensorNoise
from service.recordings.drive_folder import Drive, Reference
from service.recordings.drive_toml import Driver, GnssSetup, ImuSetup


def drive_of(simulated: SimulatedDrive) -> Drive:
    """The recording with its reference at the IMU's rate and its truth."""
    truth = simulated.trajectory
    roll, pitch, yaw = (math.degrees(angle) for angle in simulated.mounting_rpy_rad)
    return Drive(
        name=f"simulated {simulated.scenario}, seed {simulated.truth['seed']}",
        start_t_ns=simulated.start_t_ns,
        vehicle_id=f"sim-{simulated.scenario.replace('_', '-')}-{simulated.truth['seed']}",
        measurements=simulated.measurements,
        imu=ImuSetup(
            rate_hz=simulated.rate_hz,
            mounting_rpy_deg=(roll, pitch, yaw),
            accel_full_scale_mps2=simulated.measurements.accel_full_scale_mps2,
            noise=_noise(simulated.device),
        ),
        gnss=GnssSetup(lever_arm_m=simulated.gnss_lever_arm_b_m),
        driver=Driver(age=32, sex="M"),
        reference=Reference(
            t_ns=absolute_ns(truth.t_s),
            lat_rad=truth.lat_rad,
            lon_rad=truth.lon_rad,
            alt_m=truth.alt_m,
            v_n_mps=truth.v_n,
            rpy_rad=truth.rpy_rad,
        ),
        truth=simulated.truth,
    )


def _noise(device: Device) -> SensorNoise:
    """The device's own figures; how far its bias may be off is said only of a calibrated one."""
    triads = {}
    for name, triad in (("accelerometer", device.accelerometer), ("gyroscope", device.gyroscope)):
        triads[name] = {figure: [float(f"{value:.4g}")] * 3 for figure, value in asdict(triad.noise).items()}
        if device.uncalibrated:
            del triads[name]["turn_on_bias_sd"]
    return SensorNoise.model_validate(triads)
