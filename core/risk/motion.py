"""How a vehicle moves at each instant, from its velocity alone: so it is the same measure for every source of one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from core.measurements import FloatArray, TimeArray

WINDOW_S: Final = 1.0
"""Accelerations are means over this time around an instant, s: what receivers of 1 Hz can tell; a choice."""
LONGEST_GAP_S: Final = 2.0
"""Between velocities farther apart than this none is known, s; a choice: two fixes of a receiver of 1 Hz."""
_GAP_IN_PERIODS: Final = 2.0
"""The same for slower receivers, in their own periods."""


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """At n instants; NaN where it is not known.

    Parameters
    ----------
    speed_mps : (n,) horizontal
    forward_mps2, right_mps2 : (n,) horizontal acceleration along and to the right of the course
    speed_sd_mps, acceleration_sd_mps2 : (n,) of one axis; 0 where it is known exactly
    """

    speed_mps: FloatArray
    forward_mps2: FloatArray
    right_mps2: FloatArray
    speed_sd_mps: FloatArray
    acceleration_sd_mps2: FloatArray

    @property
    def known(self) -> npt.NDArray[np.bool_]:
        """Where there is a velocity, (n,)."""
        return np.isfinite(self.speed_mps)


def motion_at(
    t_ns: TimeArray,
    series_t_ns: TimeArray,
    v_n_mps: FloatArray,
    speed_sd_mps: FloatArray,
    acceleration_sd_mps2: FloatArray,
) -> Motion:
    """Motion at instants from a series of velocities.

    Velocity is linear between neighbours. Acceleration is its change over ``WINDOW_S`` around the instant, or over as
    much of that as the series reaches without a gap. In a gap it is known only within half a window of a sample.

    Parameters
    ----------
    t_ns : (n,)
    series_t_ns, v_n_mps : (m,) increasing, and (m, 2) or (m, 3) north, east(, down); rows of NaN count as missing
    speed_sd_mps, acceleration_sd_mps2 : (n,)
    """
    there = np.isfinite(v_n_mps[:, :2]).all(axis=1)
    base = int(t_ns[0]) if len(t_ns) else 0
    at, v = (series_t_ns[there] - base) * 1e-9, v_n_mps[there, :2]
    t = (t_ns - base) * 1e-9
    unknown = np.full(len(t), np.nan)
    if len(at) < 2:
        return Motion(unknown, unknown, unknown, speed_sd_mps, acceleration_sd_mps2)
    longest_s = max(LONGEST_GAP_S, _GAP_IN_PERIODS * float(np.median(np.diff(at))))
    # Runs of samples without a gap: an instant belongs to the run of its nearest sample.
    starts = np.concatenate([[0], np.flatnonzero(np.diff(at) > longest_s) + 1])
    ends = np.concatenate([starts[1:] - 1, [len(at) - 1]])
    after = np.clip(np.searchsorted(at, t), 1, len(at) - 1)
    nearest = np.where(t - at[after - 1] <= at[after] - t, after - 1, after)
    run = np.searchsorted(starts, nearest, side="right") - 1
    first, last = at[starts[run]], at[ends[run]]
    half = WINDOW_S / 2.0
    known = (t >= first - half) & (t <= last + half) & (last > first)
    low, high = np.clip(t - half, first, last), np.clip(t + half, first, last)
    now, before, later = _at(np.clip(t, first, last), at, v), _at(low, at, v), _at(high, at, v)
    span = np.where(high > low, high - low, np.nan)
    change = (later - before) / span[:, None]
    course = before + later
    length = np.hypot(course[:, 0], course[:, 1])
    along = np.divide(course, length[:, None], out=np.zeros_like(course), where=length[:, None] > 0.0)
    forward = change[:, 0] * along[:, 0] + change[:, 1] * along[:, 1]
    right = change[:, 1] * along[:, 0] - change[:, 0] * along[:, 1]
    told = known & np.isfinite(span)
    return Motion(
        np.where(told, np.hypot(now[:, 0], now[:, 1]), np.nan),
        np.where(told, forward, np.nan),
        np.where(told, right, np.nan),
        speed_sd_mps,
        acceleration_sd_mps2,
    )


def _at(t: npt.NDArray[np.floating[Any]], at: FloatArray, v: FloatArray) -> FloatArray:
    return np.column_stack([np.interp(t, at, v[:, axis]) for axis in range(2)])
