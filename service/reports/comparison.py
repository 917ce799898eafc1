"""A track held against the reference, or against the fixes where there is none, with the spread that it stated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from core.measurements import GNSS, FloatArray, TimeArray
from core.navigation.admission import position_sd_m
from core.navigation.track import Track
from core.navigation.tuning import Tuning
from service.recordings.drive_folder import Drive
from service.recordings.fusing import Outage, track_errors
from service.reports.plots import TimeAxis

SD_COLUMNS: Final = ("sd_n_m", "sd_e_m", "sd_d_m")


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """Errors (track minus what is taken as true) at ``t_ns`` (n,), with one sd of each.

    ``error_ned_m`` is freed of ``offset_ned_m``, the median outside the outages, as a reference may sit elsewhere on
    the vehicle. Against fixes no offset is taken away, and the sd holds the receiver's own as well.
    """

    against: str
    t_ns: TimeArray
    error_ned_m: FloatArray
    sd_ned_m: FloatArray
    offset_ned_m: FloatArray
    yaw_error_rad: FloatArray | None
    sd_yaw_rad: FloatArray


def compare(drive: Drive, track: Track, outages: Sequence[Outage], tuning: Tuning) -> Comparison | None:
    """Errors while navigating; None where there is nothing to compare."""
    against, errors = track_errors(drive, track, outages)
    if errors is None:
        return None
    t_ns = errors.t_ns
    sd_ned, sd_yaw = np.column_stack([_at(t_ns, track, name) for name in SD_COLUMNS]), _at(t_ns, track, "sd_yaw_rad")
    if errors.offset_n_m is not None:
        error, offset = errors.ned_m - errors.offset_n_m, errors.offset_n_m
        return Comparison(f"the {against}", t_ns, error, sd_ned, offset, errors.yaw_rad, sd_yaw)
    m = drive.measurements
    fixes = m.gnss[np.searchsorted(m.gnss_t_ns, t_ns)]
    own = np.array([position_sd_m(fix, tuning.as_array()) for fix in fixes])
    error = errors.ned_m.copy()
    error[~np.isfinite(fixes[:, GNSS["alt_m"]]), 2] = np.nan
    return Comparison("GNSS fixes", t_ns, error, np.hypot(sd_ned, own[:, [0, 0, 1]]), np.zeros(3), None, sd_yaw)


def time_axis(drive: Drive, outages: Sequence[Outage]) -> TimeAxis:
    """The span of the drive with what of the outages lies in it."""
    first, last = (float(t) for t in drive.t_s(drive.measurements.imu_t_ns[[0, -1]]))
    clipped = [(max(outage.start_s, first), min(outage.end_s, last)) for outage in outages]
    return TimeAxis((first, last), [(low, high) for low, high in clipped if low < high])


def inside(t_s: FloatArray, outages: Sequence[Outage]) -> npt.NDArray[np.bool_]:
    """Which seconds of the drive lie in an outage."""
    found = np.zeros(len(t_s), np.bool_)
    for outage in outages:
        found |= (t_s >= outage.start_s) & (t_s < outage.end_s)
    return found


def share_inside(error: FloatArray, sd: FloatArray, sds: float = 3.0) -> float:
    """Share of known errors within so many sd; NaN if none is known."""
    known = np.isfinite(error) & np.isfinite(sd)
    return float(np.mean(np.abs(error[known]) <= sds * sd[known])) if known.any() else float("nan")


def _at(t_ns: TimeArray, track: Track, name: str) -> FloatArray:
    """A column of the track at other instants, linear between the rows that have it."""
    known = np.isfinite(track.column(name))
    base = int(track.t_ns[0])
    rows_s, values = (track.t_ns[known] - base) * 1e-9, track.column(name)[known]
    return np.interp((t_ns - base) * 1e-9, rows_s, values) if known.any() else np.full(len(t_ns), np.nan)
