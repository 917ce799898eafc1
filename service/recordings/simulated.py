"""A simulated drive as a drive of the drive-folder form."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, replace
from typing import Final

import numpy as np

from core.simulation.faults import FAULTS, Fault, inject
from core.simulation.scenarios import SimulatedDrive, absolute_ns
from core.simulation.sensors import Device
from core.simulation.stream import Stream
from schemas.vehicles import SensorNoise
from service.errors import UsageError
from service.recordings.drive_folder import Drive, Reference
from service.recordings.drive_toml import Driver, GnssSetup, ImuSetup

FAULT_STREAM: Final = 1
"""Tells the faults' random numbers from those that the drive of the same seed was drawn with."""


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


def parse_fault(text: str, drive_s: float) -> Fault:
    """Read ``NAME[:START[:DURATION[:SIZE]]]``; raises UsageError, or InvalidInputError for what no fault can be.

    Without a start it begins after a third of the drive.
    """
    kind, *fields = text.split(":")
    try:
        numbers = [float(field) for field in fields]
    except ValueError:
        numbers = [math.nan]
    if len(numbers) > 3 or not np.isfinite(numbers).all():
        raise UsageError(
            f"fault '{text}': expected NAME[:START[:DURATION[:SIZE]]] in seconds and the fault's own unit,"
            " such as jump:100:20:60"
        )
    fault = Fault.of(kind, *(numbers or [drive_s / 3.0]))
    if not FAULTS[kind].in_folder:
        fit = ", ".join(name for name, one in FAULTS.items() if one.in_folder)
        raise UsageError(f"fault {kind}: a drive folder cannot hold it, as times increase in it; expected one of {fit}")
    if not 0.0 <= fault.start_s < drive_s:
        raise UsageError(f"fault '{text}': expected a start within the drive, 0 to {drive_s:g} s")
    return fault


def with_faults(simulated: SimulatedDrive, faults: Sequence[Fault]) -> SimulatedDrive:
    """The recording with these faults, which its truth then lists; the drive's seed gives the same bits."""
    rng = np.random.default_rng([simulated.truth["seed"], FAULT_STREAM])
    stream = inject(Stream.of(simulated.measurements), faults, rng)
    listed = [{**asdict(fault), "unit": FAULTS[fault.kind].unit} for fault in faults]
    return replace(simulated, measurements=stream.measurements, truth={**simulated.truth, "faults": listed})


def _noise(device: Device) -> SensorNoise:
    """The device's own figures; how far its bias may be off is said only of a calibrated one."""
    triads = {}
    for name, triad in (("accelerometer", device.accelerometer), ("gyroscope", device.gyroscope)):
        triads[name] = {figure: [float(f"{value:.4g}")] * 3 for figure, value in asdict(triad.noise).items()}
        if device.uncalibrated:
            del triads[name]["turn_on_bias_sd"]
    return SensorNoise.model_validate(triads)
