"""Detectors on what was recorded: a barrier test must be found, road shocks and real drives must stay silent."""

from __future__ import annotations

import csv
import gzip
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from core.accident.events import VehicleMotion
from core.earth import STANDARD_GRAVITY_MPS2
from core.measurements import FloatArray, Measurements
from core.simulation.corpus import START_T_NS
from core.simulation.crashes import Crash
from core.simulation.disturbances import Disturbance, NonAccident
from core.simulation.pulses import recorded_pulse, shaped_pulse
from core.simulation.route import Route, RouteBuilder
from core.simulation.scenarios import Scenario, perform
from core.simulation.sensors import MICRO_IBB
from core.simulation.shapes import Shape
from service.bench.accident_scoring import DETECTORS, OURS, Story, listen, stories
from service.bench.simulated_outages import Tell
from service.recordings.drive_folder import is_drive_folder, read_drive
from service.recordings.fusing import fuse, fuse_config, vehicle_config
from service.recordings.simulated import drive_of

G: Final = STANDARD_GRAVITY_MPS2
BARRIER: Final = "crash_nhtsa_10146_frontal_barrier"
SHOCKS: Final = "shocks_road_anomalies_2017"
EVENTS: Final = "events_driver_behavior"
TRIPS: Final = (17, 20)

BARRIER_KMH: Final = (64.6, 66.2)
"""Change of velocity at 150 ms by the compartment's sensors (the recording's README); contact is at 57.09 km/h."""
BARRIER_SPEED_MPS: Final = 57.09 / 3.6
BARRIER_SENSORS: Final = ("FLLR_XG_93", "FLRR_XG_94")
FULL_SCALES_G: Final = (2.0, 16.0, 100.0)
BARRIER_RATES_HZ: Final = (50.0, 100.0, 200.0)


@dataclass(frozen=True, slots=True)
class Placement:
    """How the barrier test's pulse enters a drive.

    Parameters
    ----------
    name : for people
    share : of the recorded accelerations; a struck car changes its velocity by less than one that meets a wall
    pdof_deg : where the force comes from; 0 is ahead
    speed_mps : just before
    turns : whether the gyroscopes feel the blow; without, as who lays a recorded crash over a recorded drive has it
    lifts : whether the recorded vertical is laid on as well
    sensors : the recording's
    """

    name: str
    share: float = 1.0
    pdof_deg: float = 0.0
    speed_mps: float = BARRIER_SPEED_MPS
    turns: bool = True
    lifts: bool = True
    sensors: tuple[str, ...] = BARRIER_SENSORS


INTO_BARRIER: Final = Placement("into the barrier")
PLACEMENTS: Final = (
    INTO_BARRIER,
    Placement("into it, felt along the car alone", turns=False, lifts=False, sensors=BARRIER_SENSORS[:1]),
    Placement("at rest, from behind", 0.45, 180.0, 0.0, sensors=BARRIER_SENSORS[:1]),
    Placement("so, felt along the car alone", 0.45, 180.0, 0.0, turns=False, lifts=False, sensors=BARRIER_SENSORS[:1]),
)
SILENT_S: Final = 0.6
"""For how long after contact a silent gyroscope says what it said before."""


def missing(data: Path) -> list[str]:
    """Recordings that are not there."""
    return [name for name in (BARRIER, SHOCKS, EVENTS) if not (data / name).is_dir()]


def measure(data: Path, drives: Path, tell: Tell) -> dict[str, Any]:
    """The barrier test in a simulated drive; road shocks, harsh trips and real drives, that hold no accident."""
    tries = [
        (sensor, full_scale_g, rate_hz, placement)
        for placement in PLACEMENTS
        for sensor in placement.sensors
        for full_scale_g in FULL_SCALES_G
        for rate_hz in BARRIER_RATES_HZ
    ]
    steps = len(tries) + 3
    tests: list[dict[str, Any]] = []
    for one in tries:
        tell(len(tests), steps)
        tests.append(barrier(data, *one))
    tell(steps - 3, steps)
    found: dict[str, Any] = {
        "barrier": tests,
        "barrier_missed": sum(not one["found"] for one in tests),
        "barrier_not_covered": sum(not one["covered"] for one in tests),
        "shocks": _silent(shocks(data)),
    }
    tell(steps - 2, steps)
    found["trips"] = _silent(trips(data))
    tell(steps - 1, steps)
    found["drives"] = _real(drives)
    return found


def barrier(
    data: Path,
    sensor: str,
    full_scale_g: float,
    rate_hz: float,
    placement: Placement = INTO_BARRIER,
    detector: str = OURS,
) -> dict[str, Any]:
    """The barrier test's pulse at the end of a simulated drive, by a sensor of this range, through a whole session."""
    accelerometer = replace(MICRO_IBB.accelerometer, full_scale=full_scale_g * G)
    scenario = Scenario(
        "a drive into NHTSA's barrier",
        partial(_struck, _barrier_pulse(data, sensor), placement),
        120.0,
        device=replace(MICRO_IBB, name=f"micro_ibb_{full_scale_g:.0f}_g", accelerometer=accelerometer),
    )
    drive = drive_of(perform("barrier", scenario, 1, scenario.duration_s, rate_hz))
    truth = (drive.truth or {})["accidents"][0]
    contact_ns = drive.start_t_ns + round(truth["t_s"] * 1e9)
    if not placement.turns:
        drive = replace(drive, measurements=_unturned(drive.measurements, contact_ns))
    config = replace(fuse_config(vehicle_config(drive), every_s=0.1), detector=detector)  # type: ignore[arg-type]
    told = stories(one.impact for one in fuse(drive, config).told)
    mine = [one for one in told if one.stands and abs(one.first.t_ns - contact_ns) < 1_000_000_000]
    result: dict[str, Any] = {
        "placement": placement.name,
        "sensor": sensor,
        "full_scale_g": full_scale_g,
        "rate_hz": rate_hz,
        "found": bool(mine),
        "false_alarms": sum(one.stands for one in told) - len(mine),
        "covered": False,
    }
    if mine:
        last = mine[0].last
        low, high = (3.6 * bound for bound in last.delta_v_interval_mps)
        least, most = (placement.share * bound for bound in BARRIER_KMH)
        result |= {
            "delta_v_kmh": 3.6 * last.delta_v_mps,
            "interval_kmh": [low, high] if math.isfinite(low) else None,
            "covered": low <= least and high >= most,
            "pdof_deg": last.pdof_deg,
            "clipped": last.clipped,
            "confidence": last.confidence,
            "severity": last.severity.value,
            "delay_s": 1e-9 * (mine[0].first.decided_t_ns - contact_ns),
        }
    return result


_CONTACT_S: Final = 0.05
"""The recording begins so long before contact, s."""
_SMOOTH: Final = Crash(delta_v_mps=65.4 / 3.6, pdof_deg=0.0, duration_s=0.11, shape=Shape.HAVERSINE)


def _barrier_pulse(data: Path, sensor: str) -> FloatArray:
    """Acceleration forward and down since contact, (n, 2), m/s2, a thousand times a second."""
    table = _table(data / BARRIER / "v10146_vehicle1_accel.csv.gz")
    columns = np.column_stack([table[sensor], table["FLLR_ZG_97"]]) * G
    columns -= columns[table["t_s"] < -0.005].mean(axis=0)
    return recorded_pulse(table["t_s"], columns)


def _struck(pulse: FloatArray, placement: Placement, rng: np.random.Generator, duration_s: float) -> Route:
    """Streets, then the blow: the car goes as after a haversine of the same change of velocity, and is shaken by what
    the recording differs from that."""
    b = RouteBuilder(heading_deg=40.0).hold(15.0).to_speed(9.0).hold(6.0).to_speed(6.0, 2.0).turn(90.0, 12.0)
    b.to_speed(12.0, 2.0).hold(8.0).turn(-60.0, 40.0).to_speed(placement.speed_mps, 2.0).hold(12.0)
    contact_s, lead = b.t_s, round(_CONTACT_S * 1000.0)
    smooth = replace(_SMOOTH, delta_v_mps=placement.share * _SMOOTH.delta_v_mps, pdof_deg=placement.pdof_deg)
    b.crash(smooth).roll_out(3.0)
    route = b.hold(max(0.0, duration_s - b.t_s)).build(duration_s)
    away = np.array([math.cos(math.radians(placement.pdof_deg)), math.sin(math.radians(placement.pdof_deg))])
    accel_b = np.zeros((len(pulse), 3))
    accel_b[:, :2] = placement.share * pulse[:, :1] * away
    if placement.lifts:
        accel_b[:, 2] = placement.share * pulse[:, 1]
    felt = shaped_pulse(smooth.shape, smooth.duration_s)
    accel_b[lead : lead + felt.size, :2] -= felt[:, None] * smooth.delta_v_b_mps
    difference = Disturbance(
        NonAccident.VIBRATION, accel_b, np.zeros_like(accel_b), np.full(len(accel_b), placement.speed_mps)
    )
    return replace(route, disturbances=((contact_s - _CONTACT_S, difference),))


def _unturned(measurements: Measurements, contact_ns: int) -> Measurements:
    """The same with gyroscopes that say what they said before contact."""
    first, last = np.searchsorted(measurements.imu_t_ns, [contact_ns - 20_000_000, contact_ns + round(SILENT_S * 1e9)])
    omega_s = measurements.omega_s.copy()
    omega_s[first:last] = omega_s[2 * first - last : first]
    return replace(measurements, omega_s=omega_s)


def shocks(data: Path) -> Iterator[tuple[str, VehicleMotion]]:
    """Each recorded shock as a box would feel it: level, tilted by 10 degrees, and before the filter knows."""
    series: dict[str, list[float]] = {}
    with gzip.open(data / SHOCKS / "road_anomalies.csv.gz", "rt") as file:
        for row in csv.DictReader(file):
            series.setdefault(row["series"], []).append(float(row["acc_z"]))
    for name, values in series.items():
        n = len(values)
        f_b = np.column_stack([np.zeros(n), np.zeros(n), -np.array(values)])
        tilted = [math.sin(math.radians(10.0)), 0.0, math.cos(math.radians(10.0))]
        for down in ([0.0, 0.0, 1.0], tilted, [math.nan] * 3):
            yield name, _motion(np.arange(n) / 50.0, f_b, np.zeros((n, 3)), np.array(down), 10.0)


def trips(data: Path) -> Iterator[tuple[str, VehicleMotion]]:
    """The two trips of harsh manoeuvres: levelled by the phone, east-north-up, as a vehicle that never turns."""
    for trip in TRIPS:
        acc, gyro = (_table(data / EVENTS / f"trip{trip}_{kind}.csv.gz") for kind in ("acc", "gyro"))
        f_b = np.column_stack([acc["y"], acc["x"], -acc["z"]])
        omega_b = np.zeros_like(f_b)
        omega_b[:, 2] = -np.interp(acc["t_s"], gyro["t_s"], gyro["z"])
        for down in ([0.0, 0.0, 1.0], [math.nan] * 3):
            # The speed was not recorded; 8 m/s is slow for its turns, which is hard on the paper's curvature.
            yield str(trip), _motion(acc["t_s"], f_b, omega_b, np.array(down), 8.0)


def _real(drives: Path) -> dict[str, Any]:
    """False accidents of every drive folder there, through the whole session."""
    found: dict[str, Any] = {"hours": 0.0, **{name: {"false_alarms": 0, "withdrawn": 0} for name in DETECTORS}}
    folders = [folder for folder in sorted(drives.iterdir()) if is_drive_folder(folder)] if drives.is_dir() else []
    found["names"] = [folder.name for folder in folders]
    for folder in folders:
        drive = read_drive(folder)
        found["hours"] += float(np.ptp(drive.measurements.imu_t_ns)) * 1e-9 / 3600.0
        config = fuse_config(vehicle_config(drive), every_s=0.1)
        for name in DETECTORS:
            fused = fuse(drive, replace(config, detector=name))  # type: ignore[arg-type]
            _count(found[name], stories(one.impact for one in fused.told))
    return found


def _silent(cases: Iterator[tuple[str, VehicleMotion]]) -> dict[str, Any]:
    """What each detector tells of cases in which nothing happens, and what it takes them for."""
    found: dict[str, Any] = {"count": 0}
    found |= {name: {"false_alarms": 0, "withdrawn": 0, "taken_for": {}} for name in DETECTORS}
    for _, motion in cases:
        found["count"] += 1
        for name in DETECTORS:
            told, candidates = listen(name, [motion])
            _count(found[name], told)
            for one in candidates:
                names = found[name]["taken_for"]
                names[one.reason.value] = names.get(one.reason.value, 0) + 1
    return found


def _count(found: dict[str, Any], told: list[Story]) -> None:
    found["false_alarms"] += sum(one.stands for one in told)
    found["withdrawn"] += sum(not one.stands for one in told)


def _motion(t_s: FloatArray, f_b: FloatArray, omega_b: FloatArray, down: FloatArray, speed: float) -> VehicleMotion:
    n = len(t_s)
    return VehicleMotion(
        t_ns=START_T_NS + np.round(t_s * 1e9).astype(np.int64),
        f_b=f_b,
        omega_b=omega_b,
        down_b=np.tile(down, (n, 1)),
        speed_mps=np.full(n, speed),
        saturated=np.zeros(n),
        gravity_mps2=G,
    )


def _table(file: Path) -> dict[str, FloatArray]:
    with gzip.open(file, "rt") as opened:
        names = opened.readline().strip().split(",")
        return dict(zip(names, np.genfromtxt(opened, delimiter=",").T, strict=True))
