"""Rows that the filter puts out: where the vehicle was, how it stood, and how sure that is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Final

import numpy as np

from core.measurements import FloatArray, TimeArray

Table = tuple[TimeArray, FloatArray]
"""Times (n,) and a row of figures for each, (n, columns)."""


def empty_table(rows: int, columns: int) -> Table:
    """Room for rows that are to be written."""
    return np.empty(rows, np.int64), np.empty((rows, columns))


def joined_tables(parts: Sequence[Table], columns: int) -> Table:
    """All rows of some tables, one after the other."""
    if not parts:
        return empty_table(0, columns)
    if len(parts) == 1:
        return parts[0]
    return np.concatenate([t_ns for t_ns, _ in parts]), np.concatenate([rows for _, rows in parts])


TRACK_COLUMNS: Final = (
    "lat_rad",
    "lon_rad",
    "alt_m",
    "vn_mps",
    "ve_mps",
    "vd_mps",
    "roll_rad",
    "pitch_rad",
    "yaw_rad",
    "sd_n_m",
    "sd_e_m",
    "sd_d_m",
    "cov_ne_m2",
    "sd_yaw_rad",
    "gnss_used",
    "mode",
    "sd_v_h_mps",
    "sd_tilt_rad",
    "sd_accel_bias_mps2",
)
"""Columns of a track row, of the vehicle's body frame; ``gnss_used`` is 1 if a fix entered since the
row before; ``mode`` is a ``Mode``. ``sd_v_h_mps``, ``sd_tilt_rad`` and ``sd_accel_bias_mps2`` are of one of the two
horizontal axes, in the mean: of the velocity, of the box's attitude, of its accelerometers' bias. While aligning, what
is not known yet is NaN."""

TRACK: Final = {name: index for index, name in enumerate(TRACK_COLUMNS)}


class Mode(IntEnum):
    """State of the navigation at an instant."""

    ALIGNING = 0
    AIDED = 1
    COASTING = 2


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """Rows of the fused trajectory: ``t_ns`` (n,) int64 and ``values`` (n, len(TRACK_COLUMNS))."""

    t_ns: TimeArray
    values: FloatArray

    def column(self, name: str) -> FloatArray:
        """One column by its name in ``TRACK_COLUMNS``, (n,)."""
        return self.values[:, TRACK[name]]

    @classmethod
    def joined(cls, parts: Sequence[Track]) -> Track:
        """All rows of some tracks, one after the other."""
        return cls(*joined_tables([(one.t_ns, one.values) for one in parts], len(TRACK_COLUMNS)))
