"""Instants asked for, as a table, and the poses of the vehicle at them."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations_with_replacement
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from core.measurements import TimeArray
from core.navigation.poses import Poses, PoseStatus
from service.errors import UsageError
from service.recordings.csv_tables import format_table, gzip_bytes, read_table, time_column, times_ns
from service.recordings.files import write_whole

_ERRORS: Final = (("n", "m"), ("e", "m"), ("d", "m"), ("rot_n", "rad"), ("rot_e", "rad"), ("rot_d", "rad"))
"""Axes of the covariance with their units: position, and the attitude's rotation vector, both in n."""


def read_instants(path: Path, start_t_ns: int) -> TimeArray:
    """The column ``t_s``, seconds of the drive, of a table; raises RecordingError."""
    return times_ns(read_table(path, ("t_s",))["t_s"], start_t_ns)


def poses_path(times: Path, out: Path | None) -> Path:
    """Where poses go: as asked for, else beside the instants with _poses in the name; raises UsageError."""
    if out is None:
        return times.with_name(times.name.removesuffix(".gz").removesuffix(".csv") + "_poses.csv")
    if not out.name.lower().endswith((".csv", ".csv.gz")):
        raise UsageError(f"{out}: unknown file ending; expected .csv or .csv.gz")
    return out


def write_poses(path: Path, poses: Poses, start_t_ns: int) -> None:
    """A row an instant; where there is no pose its cells are empty and ``status`` says why."""
    columns: dict[str, tuple[npt.ArrayLike, str]] = {
        "t_s": time_column(poses.t_ns, start_t_ns),
        "lat_deg": (np.degrees(poses.lat_rad), "%.10f"),
        "lon_deg": (np.degrees(poses.lon_rad), "%.10f"),
        "alt_ellipsoid_m": (poses.alt_m, "%.4f"),
    }
    columns |= {name: (poses.q_n_from_b[:, i], "%.9f") for i, name in enumerate(("qw", "qx", "qy", "qz"))}
    rpy_deg = np.degrees(poses.rpy_rad)
    columns |= {name: (rpy_deg[:, i], "%.5f") for i, name in enumerate(("roll_deg", "pitch_deg", "yaw_deg"))}
    columns |= _covariance_columns(poses)
    columns["status"] = ([PoseStatus(int(value)).name.lower() for value in poses.status], "%s")
    text = format_table(columns)
    write_whole(path, gzip_bytes(text) if path.name.lower().endswith(".gz") else text.encode())


def _covariance_columns(poses: Poses) -> Mapping[str, tuple[npt.ArrayLike, str]]:
    """The upper triangle, row by row; the unit is in the name: m2, m_rad, rad2."""
    columns = {}
    for (i, (a, unit_a)), (j, (b, unit_b)) in combinations_with_replacement(enumerate(_ERRORS), 2):
        unit = f"{unit_a}2" if unit_a == unit_b else f"{unit_a}_{unit_b}"
        columns[f"cov_{a}_{b}_{unit}"] = (poses.covariance[:, i, j], "%.6e")
    return columns
