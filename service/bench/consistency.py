"""Whether errors are as large as the filter says: NEES with its 95 % band, and instants within 3 sd."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from scipy.stats import chi2

from core.earth import ned_offset_m
from core.measurements import FloatArray
from core.navigation import state
from core.navigation.track import Mode
from core.rotation import matrix_from_quaternion, matrix_from_rpy, wrap_angle_rad
from core.session import Session
from core.simulation.scenarios import simulate
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


def measure(tell: Tell, seeds: Sequence[int] = SEEDS, duration_s: float | None = None) -> dict[str, Any]:
    """Mean NEES of three errors of three axes each (3 is expected), and shares within 3 sd, in and out of outages."""
    normalised, inside, outside = [], [], []
    for done, seed in enumerate(seeds):
        tell(done, len(seeds))
        drive = drive_of(simulate(EXACT, seed, duration_s))
        normalised.append(_nees(drive))
        within, in_outage = _within_three_sd(drive)
        inside.append(within[in_outage])
        outside.append(within[~in_outage])
    nees = np.array(normalised)
    shares = {"in_outages": np.concatenate(inside), "outside": np.concatenate(outside)}
    return {
        "scenario": EXACT,
        "drives": len(seeds),
        "nees": {
            name: _judged(nees[:, :, i], len(seeds) if name == "attitude" else nees[:, :, i].size)
            for i, name in enumerate(GROUPS)
        },
        "within_3_sd": {
            where: dict(zip((*AXES, "yaw"), map(float, rows.mean(axis=0)), strict=True))
            for where, rows in shares.items()
        },
    }


def _judged(nees: FloatArray, independent: int) -> dict[str, Any]:
    """A mean against its band; an attitude's error outlives the instants, so that only drives are independent."""
    low, high = chi2.ppf([(1 - LEVEL) / 2, (1 + LEVEL) / 2], 3 * independent) / independent
    mean = float(nees.mean())
    return {"mean": mean, "expected": 3.0, "band": [float(low), float(high)], "inside": bool(low < mean < high)}


def _nees(drive: Drive) -> FloatArray:
    """Of position, velocity and attitude at instants outside the outages, (instants, 3)."""
    m, reference = drive.measurements, drive.reference
    if reference is None:
        raise ValueError("a simulated drive has a reference")
    session = Session(fuse_config(vehicle_config(drive)))
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
