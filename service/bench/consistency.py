"""Whether errors are as large as the filter says: NEES and NIS with their 95 % bands, and instants within 3 sd.

Once by the settings that all boxes get, which leave room for what real receivers, sensors and cars do beyond what
is stated of them; and once by what is true of the simulated drive and stated of it, and nothing more.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from scipy.stats import chi2

from core.earth import ned_offset_m
from core.measurements import GNSS, FloatArray
from core.navigation import state
from core.navigation.records import AidRecords
from core.navigation.sensor_noise import NOTHING_ADDED, matched_tuning
from core.navigation.track import Mode
from core.rotation import matrix_from_quaternion, matrix_from_rpy, wrap_angle_rad
from core.session import Session, SessionConfig
from core.simulation.scenarios import simulate
from core.simulation.sensors import EXACT_MEMS, Device
from service.bench.simulated_outages import EXACT, SEEDS, Tell, outages_of
from service.recordings.drive_folder import Drive
from service.recordings.fusing import fuse, fuse_config, vehicle_config
from service.recordings.simulated import drive_of

BoolArray = npt.NDArray[np.bool_]

SETTLED_S: Final = 30.0
"""From then on errors are judged, s: the filter has aligned and the drive has begun."""
APART_S: Final = 40.0
"""Between instants of NEES, s: white fixes have made position and velocity nearly independent of those before."""
LEVEL: Final = 0.95
GROUPS: Final = {"position": state.POS, "velocity": state.VEL, "attitude": state.ATT}
AXES: Final = ("north", "east", "down")
INNOVATIONS: Final = {
    "GNSS position": state.A_POSITION,
    "GNSS height": state.A_HEIGHT,
    "GNSS velocity": state.A_VELOCITY,
}

TRUE_OF_IT: Final = {
    # Fixes: all of their error is new each time, and they are in time.
    "gnss_white_share": 1.0,
    "gnss_share_margin": 1.0,
    "gnss_learn_fixes": 1e4,
    "gnss_delay_sd_s": 0.0,
    # Sensors: no error of scale.
    "gyro_scale_sd": 0.0,
    # The car: rigid, goes where its wheels point, stands still, as far as the steps of a simulation say.
    "nhc_sd_mps": 0.01,
    "nhc_lever_m": 0.0,
    "heave_radps": 50.0,
    "squat_rad_per_mps2": 0.0,
    "squat_sd_rad_per_mps2": 0.0,
    "zupt_sd_mps": 0.001,
    "zaru_sd_radps": 1e-3,
    # The box: as it is said to sit. The wheel speed: of one scale, in steps of 0.01 m/s.
    "mount_angle_sd_rad": 1e-5,
    "mount_angle_walk_rad_rts": 0.0,
    "speed_scale_sd": EXACT_MEMS.wheel_scale_sd,
    "speed_scale_walk_rts": 0.0,
    "speed_sd_mps": 0.01,
}
"""What a filter has to be told of ``EXACT`` beside its sensors' noise and its fixes' sd, which the drive states."""


def measure(tell: Tell, seeds: Sequence[int] = SEEDS, duration_s: float | None = None) -> dict[str, Any]:
    """Mean NEES of three errors of three axes each (3 is expected), mean NIS an axis (1 is), by both settings.

    Beside NIS what the fixes themselves drew: the mean square of their errors over what they state, 1 in the long run.
    And by the settings of all boxes the shares of instants within 3 sd, in and out of outages.
    """
    nees: dict[str, list[FloatArray]] = {"usual": [], "stated": []}
    innovations: list[AidRecords] = []
    drawn: list[dict[str, FloatArray]] = []
    inside, outside = [], []
    for done, seed in enumerate(seeds):
        tell(done, len(seeds))
        simulated = simulate(EXACT, seed, duration_s)
        drive = drive_of(simulated)
        usual = fuse_config(vehicle_config(drive))
        stated = _as_stated(usual, simulated.device)
        nees["usual"].append(_nees(drive, usual))
        nees["stated"].append(_nees(drive, stated))
        innovations.append(_settled(drive, stated))
        drawn.append(_drawn(drive))
        within, in_outage = _within_three_sd(drive)
        inside.append(within[in_outage])
        outside.append(within[~in_outage])
    shares = {"in_outages": np.concatenate(inside), "outside": np.concatenate(outside)}
    return {
        "scenario": EXACT,
        "drives": len(seeds),
        "nees": _nees_judged(np.array(nees["usual"])),
        "nees_stated": _nees_judged(np.array(nees["stated"])),
        "nis_stated": {
            name: _nis_judged(innovations, aid) | {"drawn": float(np.concatenate([one[name] for one in drawn]).mean())}
            for name, aid in INNOVATIONS.items()
        },
        "within_3_sd": {
            where: dict(zip((*AXES, "yaw"), map(float, rows.mean(axis=0)), strict=True))
            for where, rows in shares.items()
        },
    }


def _as_stated(usual: SessionConfig, device: Device) -> SessionConfig:
    tuning = replace(usual.filter.tuning, **TRUE_OF_IT)
    tuning = matched_tuning(tuning, device.accelerometer.noise, device.gyroscope.noise, NOTHING_ADDED)
    return replace(usual, filter=replace(usual.filter, tuning=tuning))


def _nees_judged(nees: FloatArray) -> dict[str, Any]:
    """Of (drives, instants, groups); an attitude's error outlives the instants, so that only drives are independent."""
    return {
        name: _judged(nees[:, :, i], 3, len(nees) if name == "attitude" else nees[:, :, i].size)
        for i, name in enumerate(GROUPS)
    }


def _settled(drive: Drive, config: SessionConfig) -> AidRecords:
    """The records of a drive's aids from the first instant of NEES on."""
    records = fuse(drive, config, keep=True).records
    if records is None:
        raise ValueError("records were asked for")
    late = drive.t_s(records.t_ns) > SETTLED_S + APART_S
    return AidRecords(records.t_ns[late], records.values[late])


def _drawn(drive: Drive) -> dict[str, FloatArray]:
    """Squares of the fixes' own errors over what they state, axis by axis, as long as innovations are judged."""
    m, reference = drive.measurements, drive.reference
    if reference is None:
        raise ValueError("a simulated drive has a reference")
    judged = (drive.t_s(m.gnss_t_ns) > SETTLED_S + APART_S) & np.isfinite(m.gnss[:, GNSS["lat_rad"]])
    t_ns, fixes = m.gnss_t_ns[judged], m.gnss[judged]

    def true(series: FloatArray) -> FloatArray:
        return np.asarray(np.interp(t_ns, reference.t_ns, series))

    origin = (float(reference.lat_rad[0]), float(reference.lon_rad[0]), float(reference.alt_m[0]))
    lat_rad, lon_rad, alt_m = (fixes[:, GNSS[name]] for name in ("lat_rad", "lon_rad", "alt_m"))
    off = ned_offset_m(lat_rad, lon_rad, alt_m, origin)
    off = off - ned_offset_m(true(reference.lat_rad), true(reference.lon_rad), true(reference.alt_m), origin)
    v_n = np.column_stack([true(reference.v_n_mps[:, i]) for i in range(3)])
    wrong_v = fixes[:, [GNSS[name] for name in ("vn_mps", "ve_mps", "vd_mps")]] - v_n
    sd_h, sd_v, sd_vel = (fixes[:, GNSS[name]] for name in ("sd_h_m", "sd_v_m", "sd_v_mps"))
    # As the filter takes it, a velocity is worse upwards by the sky's geometry, that of the positions.
    sd_v_n = sd_vel[:, None] * np.column_stack([np.ones_like(sd_h), np.ones_like(sd_h), sd_v / sd_h])
    return {
        "GNSS position": np.square(off[:, :2] / sd_h[:, None]).ravel(),
        "GNSS height": np.square(off[:, 2] / sd_v),
        "GNSS velocity": np.square(wrong_v / sd_v_n).ravel(),
    }


def _nis_judged(innovations: Sequence[AidRecords], aid: int) -> dict[str, Any]:
    ratios = []
    for records in innovations:
        own = records.column("aid") == aid
        ratios.append(records.column("innovation")[own] ** 2 / records.column("variance")[own])
    nis = np.concatenate(ratios)
    return _judged(nis, 1, nis.size)


def _judged(squares: FloatArray, dimensions: int, independent: int) -> dict[str, Any]:
    """The mean of normalised squares against its band."""
    low, high = chi2.ppf([(1 - LEVEL) / 2, (1 + LEVEL) / 2], dimensions * independent) / independent
    mean = float(squares.mean())
    return {
        "mean": mean,
        "expected": float(dimensions),
        "band": [float(low), float(high)],
        "inside": bool(low < mean < high),
    }


def _nees(drive: Drive, config: SessionConfig) -> FloatArray:
    """Of position, velocity and attitude at instants outside the outages, (instants, 3)."""
    m, reference = drive.measurements, drive.reference
    if reference is None:
        raise ValueError("a simulated drive has a reference")
    session = Session(config)
    end_s = float(drive.t_s(m.imu_t_ns[-1:])[0])
    before_ns = np.iinfo(np.int64).min
    found = []
    for instant_s in np.arange(SETTLED_S + APART_S - 0.05, end_s, APART_S):
        row = int(np.searchsorted(drive.t_s(reference.t_ns), instant_s))
        until_ns = int(reference.t_ns[row]) + 1
        session.step(m.between(before_ns, until_ns))
        before_ns = until_ns
        if any(outage.start_s <= instant_s < outage.end_s + APART_S / 2 for outage in outages_of(drive)):
            continue
        x, p = session.filter.x, session.filter.covariance()
        origin = (float(x[state.X_LAT]), float(x[state.X_LON]), float(x[state.X_ALT]))
        at = slice(row, row + 1)
        place = ned_offset_m(reference.lat_rad[at], reference.lon_rad[at], reference.alt_m[at], origin)[0]
        turn = matrix_from_rpy(*reference.rpy_rad[row]) @ matrix_from_quaternion(x[:4]).T
        errors = (
            place - x[state.X_DR : state.X_DR + 3],
            reference.v_n_mps[row] - x[state.X_V : state.X_V + 3],
            0.5 * np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]),
        )
        found.append(
            [
                float(error @ np.linalg.solve(p[first : first + 3, first : first + 3], error))
                for error, first in zip(errors, GROUPS.values(), strict=True)
            ]
        )
    return np.array(found)


def _within_three_sd(drive: Drive) -> tuple[BoolArray, BoolArray]:
    """Which errors north, east, down and in yaw are within 3 sd (rows, 4), and which rows are in an outage."""
    track = fuse(drive, fuse_config(vehicle_config(drive), every_s=0.1)).track
    reference = drive.reference
    if reference is None:
        raise ValueError("a simulated drive has a reference")
    t_s = drive.t_s(track.t_ns)
    settled = (t_s > SETTLED_S) & (track.column("mode") != Mode.ALIGNING)
    rows, t_s, t_ns = track.values[settled], t_s[settled], track.t_ns[settled]

    def at(series: FloatArray) -> FloatArray:
        return np.asarray(np.interp(t_ns, reference.t_ns, series))

    origin = (float(reference.lat_rad[0]), float(reference.lon_rad[0]), float(reference.alt_m[0]))
    true = ned_offset_m(at(reference.lat_rad), at(reference.lon_rad), at(reference.alt_m), origin)
    error = ned_offset_m(rows[:, 0], rows[:, 1], rows[:, 2], origin) - true
    yaw = wrap_angle_rad(rows[:, 8] - at(np.unwrap(reference.rpy_rad[:, 2])))
    sd = np.column_stack([rows[:, 9:12], rows[:, 13]])
    within = np.abs(np.column_stack([error, yaw])) <= 3.0 * sd
    in_outage = np.zeros(len(t_s), np.bool_)
    for outage in outages_of(drive):
        in_outage |= (t_s >= outage.start_s) & (t_s < outage.end_s)
    return within, in_outage
