"""How a vehicle moves at each instant, from its velocity alone: so it is the same measure for every source of one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

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
    corrected: npt.NDArray[np.bool_] | None = None,
) -> Motion:
    """Motion at instants from a series of velocities.

    Velocity is linear between neighbours. Acceleration is its change over ``WINDOW_S`` around the instant, or over as
    much of that as the series reaches without a gap. In a gap it is known only within half a window of a sample.

    Parameters
    ----------
    t_ns : (n,)
    series_t_ns, v_n_mps : (m,) increasing, and (m, 2) or (m, 3) north, east(, down); rows of NaN count as missing
    speed_sd_mps, acceleration_sd_mps2 : (n,)
    corrected : (m,) velocities that a filter corrected since the one before: that step is no acceleration
    """
    there = np.isfinite(v_n_mps[:, :2]).all(axis=1)
    base = int(t_ns[0]) if len(t_ns) else 0
    at, v = _seconds(series_t_ns[there], base), v_n_mps[there, :2]
    t = _seconds(t_ns, base)
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
    middle, low, high = (np.minimum(np.maximum(t + by, first), last) for by in (0.0, -half, half))
    now, before, later = _at(middle, at, v), _at(low, at, v), _at(high, at, v)
    driven = v if corrected is None else _without_corrections(at, v, corrected[there])
    span = np.where(high > low, high - low, np.nan)
    change = (_at(high, at, driven) - _at(low, at, driven)) / span[:, None]
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


def _seconds(t_ns: TimeArray, base: int) -> FloatArray:
    return np.asarray((t_ns - base) * 1e-9, np.float64)


def _without_corrections(at: FloatArray, v: FloatArray, corrected: npt.NDArray[np.bool_]) -> FloatArray:
    """Velocity as if it had never been corrected: over a correction it changes as it did before and after."""
    step_s = np.diff(at)
    rate = np.diff(v, axis=0) / step_s[:, None]
    good = np.flatnonzero(~corrected[1:])
    if not good.size:
        return v
    bad = np.flatnonzero(corrected[1:])
    for axis in range(rate.shape[1]):
        rate[bad, axis] = np.interp(bad, good, rate[good, axis])
    return np.vstack([v[:1], v[0] + np.cumsum(rate * step_s[:, None], axis=0)])


def _at(t: FloatArray, at: FloatArray, v: FloatArray) -> FloatArray:
    return np.column_stack([np.interp(t, at, v[:, axis]) for axis in range(2)])
