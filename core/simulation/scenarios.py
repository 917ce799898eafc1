"""Named drives with truth: streets, tunnels, motorways, parking, and crashes that must be found."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any, Final

import numpy as np

from core.atmosphere import pressure_height_m, standard_pressure_pa
from core.errors import InvalidInputError
from core.measurements import Measurements, TimeArray
from core.sensors import TriadCalibration
from core.simulation import low_speed_series, roads
from core.simulation.gnss import Receiver, measure_gnss
from core.simulation.overlay import laid_over
from core.simulation.route import Route, Sky
from core.simulation.sensors import (
    EXACT_MEMS,
    LOW_COST_MEMS,
    MICRO_IBB,
    SHAKEN,
    UNCALIBRATED,
    WIDE_RANGE,
    Device,
    DeviceErrors,
    draw_errors,
    measure_inertial,
    measure_magnetic,
    measure_pressure,
    measure_wheel_speed,
)
from core.simulation.trajectory import RIGID, Place, Suspension, Trajectory, drive

START_T_NS: Final = 1_714_984_200_000_000_000
"""2024-05-06T08:30:00Z, a Monday in May: past for any clock, since a service refuses packets from the future."""

SHORTEST_S: Final = 30.0
"""Shortest drive, s: standing, going and stopping again."""
LONGEST_S: Final = 4 * 3600.0
"""Longest drive simulated at once, s: some 2 GB of memory at 200 Hz."""

MADRID: Final = Place(math.radians(40.4105), math.radians(-3.7140), 640.0, (25.6, 0.15, 37.3))
"""Beside the Calle 30, a ring road with 6 km of tunnel. The field is the epoch's there (45.2 uT, inclination
55.5 deg, declination 0.3 deg), rounded: so magnetic and true north are one for a box that knows no declination."""

WHITE_GNSS: Final = Receiver(drift_sd_m=0.0, white_sd_m=1.5, velocity_sd_mps=0.1, stated_sd_m=1.5)
"""Errors without memory, 1.5 m an axis: those of the measured facts that a filter is compared by."""
EXACT_GNSS: Final = replace(WHITE_GNSS, stated_velocity_factor=1.0, stated_velocity_floor_mps=0.0)
"""The same, and stated as they are."""


@dataclass(frozen=True, slots=True)
class Scenario:
    """What a named drive is made of; ``duration_s`` is its length when none is asked for."""

    text: str
    route: Callable[[np.random.Generator, float], Route]
    duration_s: float
    device: Device = MICRO_IBB
    receiver: Receiver = field(default_factory=Receiver)
    gnss_lever_arm_b_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    suspension: Suspension = field(default_factory=Suspension)
    place: Place = MADRID


SCENARIOS: Final[Mapping[str, Scenario]] = MappingProxyType(
    {
        "tunnel_crash": Scenario(
            "streets, a low-speed crash, and a severe one 20 s into a tunnel", roads.tunnel_crash, 430.0
        ),
        "city": Scenario("streets between houses, lights, potholes, a tunnel; no crash", roads.city, 900.0),
        "highway": Scenario(
            "motorway with bridges overhead, hard braking, wheel speed and barometer; no crash",
            roads.highway,
            600.0,
            device=replace(MICRO_IBB, wheel_speed_hz=4.0, barometer_hz=10.0),
        ),
        "outages": Scenario(
            "a GNSS outage of 60 s every 150 s; low-cost MEMS and white GNSS errors",
            roads.outages,
            600.0,
            device=LOW_COST_MEMS,
            receiver=WHITE_GNSS,
        ),
        "exact_outages": Scenario(
            "as outages, but the body goes unshaken where its wheels point, and sensors err by noise and bias alone",
            roads.smooth_outages,
            600.0,
            device=EXACT_MEMS,
            receiver=EXACT_GNSS,
            suspension=RIGID,
        ),
        "uncalibrated_outages": Scenario(
            "as outages, recorded as soldered; the calibration is in the truth",
            roads.outages,
            600.0,
            device=UNCALIBRATED,
            receiver=WHITE_GNSS,
        ),
        "engine_shaken": Scenario(
            "as outages, in a box that the engine shakes by 1.5 m/s2", roads.outages, 600.0, SHAKEN, WHITE_GNSS
        ),
        "parking": Scenario("manoeuvring with kerbs and reversing; struck from behind at rest", roads.parking, 300.0),
        "wide_sensor": Scenario(
            "as tunnel_crash, recorded by a 16 g sensor that does not clip",
            roads.tunnel_crash,
            430.0,
            device=WIDE_RANGE,
        ),
        "uncalibrated": Scenario(
            "as tunnel_crash, recorded as soldered; the calibration is in the truth",
            roads.tunnel_crash,
            430.0,
            device=UNCALIBRATED,
        ),
        "seed1": Scenario(
            "3.5 h below 20 m/s: 21 low-speed accidents, a third in outages, among potholes, kerbs and hard braking",
            low_speed_series.seed1,
            12600.0,
        ),
        "crash_series": Scenario("an accident of any kind every two to three minutes", roads.crash_series, 3600.0),
    }
)


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedDrive:
    """What a box recorded, and the truth behind it."""

    scenario: str
    start_t_ns: int
    rate_hz: float
    mounting_rpy_rad: tuple[float, float, float]
    gnss_lever_arm_b_m: tuple[float, float, float]
    device: Device
    measurements: Measurements
    trajectory: Trajectory
    truth: Mapping[str, Any]


def simulate(
    scenario: str = "city",
    seed: int = 1,
    duration_s: float | None = None,
    rate_hz: float = 200.0,
    draw: int = 0,
) -> SimulatedDrive:
    """Simulate a named drive; the same arguments give the same bits.

    Parameters
    ----------
    scenario : str
        A name in ``SCENARIOS``.
    seed : int
        Of the route's random parts and of all sensor errors, from 0.
    duration_s : float, optional
        Length, s; the scenario's own if not given.
    rate_hz : float
        Rate of the inertial samples, 10 to 1000 Hz.
    draw : int
        Which draw of the noise, from 0: another one is the same box on the same drive on another day.

    Raises
    ------
    InvalidInputError
        If the name is unknown, a value out of range, or the drive too short for what happens in it.
    """
    if scenario not in SCENARIOS:
        raise InvalidInputError(f"unknown scenario '{scenario}': expected one of {', '.join(SCENARIOS)}")
    chosen = SCENARIOS[scenario]
    length_s = chosen.duration_s if duration_s is None else duration_s
    check_asked(seed, draw, length_s)
    return perform(scenario, chosen, seed, length_s, rate_hz, draw)


def check_asked(seed: int, draw: int, duration_s: float) -> None:
    """Raise InvalidInputError for what no drive can be drawn from."""
    for name, value in (("seed", seed), ("draw", draw)):
        if value < 0:
            raise InvalidInputError(f"{name} is {value}: expected 0 or more")
    if not SHORTEST_S <= duration_s <= LONGEST_S:
        raise InvalidInputError(f"a drive of {duration_s:g} s: expected {SHORTEST_S:g} s to {LONGEST_S / 3600:g} h")


def perform(
    name: str, chosen: Scenario, seed: int, length_s: float, rate_hz: float = 200.0, draw: int = 0
) -> SimulatedDrive:
    """Simulate a scenario that need not be in ``SCENARIOS``; the rest as ``simulate``."""
    route_rng, unit_rng, *noise_rngs = np.random.default_rng(seed).spawn(5)
    if draw > 0:
        noise_rngs = np.random.default_rng([seed, draw]).spawn(3)
    inertial_rng, slow_rng, air_rng = noise_rngs
    route = chosen.route(route_rng, length_s)
    errors = draw_errors(chosen.device, unit_rng)
    trajectory = laid_over(drive(route, chosen.place, rate_hz, chosen.suspension), route.disturbances)
    f_s, omega_s = measure_inertial(trajectory, chosen.device, errors, inertial_rng)
    gnss_t_s, gnss = measure_gnss(trajectory, route.sky, chosen.receiver, chosen.gnss_lever_arm_b_m, slow_rng)
    magnetic_t_s, magnetic = measure_magnetic(trajectory, chosen.place.field_n_ut, chosen.device, errors, slow_rng)
    speed_t_s, speed = measure_wheel_speed(trajectory, chosen.device, errors)
    barometer_t_s, pressure_pa = measure_pressure(trajectory, chosen.device, errors, air_rng)
    return SimulatedDrive(
        scenario=name,
        start_t_ns=START_T_NS,
        rate_hz=rate_hz,
        mounting_rpy_rad=chosen.device.mounting_rpy_rad,
        gnss_lever_arm_b_m=chosen.gnss_lever_arm_b_m,
        device=chosen.device,
        measurements=Measurements(
            imu_t_ns=absolute_ns(trajectory.t_s),
            f_s=f_s,
            omega_s=omega_s,
            gnss_t_ns=absolute_ns(gnss_t_s),
            gnss=gnss,
            magnetometer_t_ns=absolute_ns(magnetic_t_s),
            magnetic_s_ut=magnetic,
            speed_t_ns=absolute_ns(speed_t_s),
            speed_mps=speed,
            barometer_t_ns=absolute_ns(barometer_t_s),
            pressure_pa=pressure_pa,
            accel_full_scale_mps2=chosen.device.accelerometer.full_scale,
        ),
        trajectory=trajectory,
        truth=_truth(name, seed, chosen.device, errors, route, trajectory),
    )


def absolute_ns(t_s: np.ndarray[Any, np.dtype[np.float64]]) -> TimeArray:
    """Times of a simulated drive, s, as UTC nanoseconds."""
    return np.asarray(START_T_NS + np.rint(t_s * 1e9).astype(np.int64))


def _truth(
    scenario: str, seed: int, device: Device, errors: DeviceErrors, route: Route, trajectory: Trajectory
) -> dict[str, Any]:
    def spans(*kinds: Sky) -> list[dict[str, float]]:
        return [
            {"start_s": round(span.start_s, 3), "duration_s": round(span.end_s - span.start_s, 3)}
            for span in sorted(route.sky, key=lambda one: one.start_s)
            if span.kind in kinds
        ]

    accidents = []
    for t_s, crash in route.crashes:
        accidents.append(
            {
                "t_s": round(t_s, 4),
                "lat_deg": round(math.degrees(np.interp(t_s, trajectory.t_s, trajectory.lat_rad)), 9),
                "lon_deg": round(math.degrees(np.interp(t_s, trajectory.t_s, trajectory.lon_rad)), 9),
                "alt_ellipsoid_m": round(float(np.interp(t_s, trajectory.t_s, trajectory.alt_m)), 3),
                "speed_before_mps": round(float(np.interp(t_s, trajectory.t_s, trajectory.speed_mps)), 3),
                "delta_v_mps": crash.delta_v_mps,
                "pdof_deg": round(crash.pdof_deg % 360.0, 3),
                "duration_s": crash.duration_s,
                "peak_mps2": round(crash.peak_mps2, 2),
                "clipped": crash.clips(device.accelerometer.full_scale),
                "severity": crash.severity,
                "in_outage": any(s.kind is not Sky.CANYON and s.start_s <= t_s < s.end_s for s in route.sky),
            }
        )
    truth: dict[str, Any] = {
        "scenario": scenario,
        "seed": seed,
        "device": device.name,
        "accidents": accidents,
        "outages": spans(Sky.TUNNEL, Sky.OUTAGE),
        "canyons": spans(Sky.CANYON),
        "bumps": [{"t_s": round(one.start_s, 3), "height_m": one.height_m} for one in route.bumps],
        "non_accidents": [
            {
                "t_s": round(t_s, 3),
                "duration_s": round(one.duration_s, 3),
                "kind": one.kind.value,
                "hardness": round(one.hardness, 3),
            }
            for t_s, one in route.disturbances
        ],
        "sensor_errors": {
            "accelerometer": _calibration_json(errors.accelerometer),
            "gyroscope": _calibration_json(errors.gyroscope),
            "mounting_error_rpy_deg": [math.degrees(x) for x in errors.mounting_error_rpy_rad],
            "hard_iron_ut": list(errors.hard_iron_ut),
            "wheel_scale": errors.wheel_scale,
        },
    }
    if device.barometer_hz > 0.0:
        truth["sensor_errors"]["barometer"] = _barometer_json(errors, float(trajectory.alt_m[0]))
    if device.uncalibrated:
        truth["calibration"] = {
            "accelerometer": _calibration_json(errors.known_accelerometer),
            "gyroscope": _calibration_json(errors.known_gyroscope),
        }
    return truth


def _barometer_json(errors: DeviceErrors, alt_m: float) -> dict[str, float]:
    """What the unit and the weather add, and by how much the height from pressure is off for it, standing at first."""
    shown_pa = standard_pressure_pa(np.array([alt_m])) + errors.pressure_offset_pa
    return {
        "pressure_offset_pa": errors.pressure_offset_pa,
        "wind_share": errors.wind_share,
        "height_bias_m": float(pressure_height_m(shown_pa)[0]) - alt_m,
    }


def _calibration_json(calibration: TriadCalibration) -> dict[str, list[float]]:
    return {
        "scale": list(calibration.scale),
        "misalignment": list(calibration.misalignment),
        "bias": list(calibration.bias),
    }
