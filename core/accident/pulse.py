"""One crash pulse read off the level rows: change of velocity, length, peak, and what clipping hid of it."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numba import njit

from core.accident.level import A_X, A_Y, A_Z, CLIPPED, GAP, HEADING_COS, HEADING_SIN, LEVELLED, V_X, V_Y, Flags
from core.measurements import FloatArray, TimeArray


class Pulse(NamedTuple):
    """A pulse between two rows. Velocities are changes along forward and right at its start, m/s."""

    first: int
    last: int
    forward_mps: float
    right_mps: float
    vertical_mps: float
    retained: float
    peak_mps2: float
    duration_s: float
    clipped_s: float
    levelled: bool


class Whole(NamedTuple):
    """A whole pulse estimated from its unclipped flanks: change of velocity with sd, m/s, its direction as a unit
    vector forward and right, and its length, s."""

    delta_v_mps: float
    sd_mps: float
    duration_s: float
    forward: float
    right: float


PULSE_MEDIAN_S: Final = 0.11
"""Usual length of a collision's pulse, s: 95 ms against a rigid barrier (NHTSA test 10146), longer where another car
gives way. A prior for clipped pulses only; an assumption, not fitted to a set of crashes."""
PULSE_LOG_SD: Final = 0.35
"""Spread of the logarithm of that length: two thirds of pulses between 78 and 156 ms. A choice."""
MISFIT: Final = 0.3
"""How far a real pulse's flank strays from these shapes, of the level it clips at: structures ring. A choice, after
NHTSA test 10146, whose flank at 2, 4 and 16 g leads and lags them by so much."""
MISFIT_S: Final = 0.005
"""How long such a stray lasts, s: samples closer together share one. A choice, after the same test."""
FLANK_MPS2: Final = 5.0
"""Sum of the flanks' accelerations, m/s2, from which they tell a direction: well above vibration. A choice."""
DELTA_V_MEDIAN_MPS: Final = 5.6
DELTA_V_LOG_SD: Final = 0.9
"""Changes of velocity that collisions bring, m/s, as a log-normal prior: two thirds between 2.3 and 14 m/s. A choice:
about 20 km/h is usual where a car had to be towed, and few exceed 60 km/h."""
SHORTEST_S: Final = 0.02
LONGEST_S: Final = 0.4
"""Lengths that the grid spans, s: wider than the prior by four of its sds. A choice."""
STRONGEST: Final = 20.0
"""Amplitudes that the grid spans, from one to so many levels of clipping: 40 g for 2 g. A choice."""
LENGTHS: Final = 40
STARTS: Final = 16
AMPLITUDES: Final = 40
"""Nodes of the grid over length, start (within the first flank's room) and amplitude."""


@njit(cache=True, nogil=True)
def _along(x: FloatArray, row: int, ux: float, uy: float) -> float:
    """Acceleration along a horizontal direction of the level frame, times the length of (ux, uy), m/s2."""
    return float(x[row, A_X] * ux + x[row, A_Y] * uy)


@njit(cache=True, nogil=True)
def measure(
    t_ns: TimeArray,
    x: FloatArray,
    flags: Flags,
    start: int,
    end: int,
    tyre_mps2: float,
    onset_mps2: float,
    onset_s: float,
) -> tuple[int, int, float, float, float, float, float, float, bool]:
    """Read a pulse that was suspected to begin at row ``start``, with rows up to ``end`` (inclusive) to see.

    Its direction is that of the change of velocity; from where it exceeds ``tyre_mps2`` first and last it is
    widened while the acceleration along that direction exceeds ``onset_mps2``, by at most ``onset_s``.

    Returns
    -------
    first, last, dv_x, dv_y (level frame), largest vertical change, share of the largest change that was kept,
    peak, clipped time (s), levelled
    """
    hot_first, hot_last = -1, start
    peak = 0.0
    for k in range(start, end + 1):
        a = math.hypot(x[k, A_X], x[k, A_Y])
        peak = max(peak, a)
        if a > tyre_mps2:
            hot_last = k
            if hot_first < 0:
                hot_first = k
    hot_first = max(hot_first, start)
    ux, uy = x[hot_last, V_X] - x[start, V_X], x[hot_last, V_Y] - x[start, V_Y]
    norm = max(math.hypot(ux, uy), 1e-9)
    ux, uy = ux / norm, uy / norm

    first = hot_first
    while (
        first > 0
        and not flags[first] & GAP
        and (t_ns[hot_first] - t_ns[first - 1]) * 1e-9 <= onset_s
        and x[first - 1, A_X] * ux + x[first - 1, A_Y] * uy > onset_mps2
    ):
        first -= 1
    if first > 0 and not flags[first] & GAP:
        first -= 1
    last = hot_last
    while (
        last < end
        and (t_ns[last + 1] - t_ns[hot_last]) * 1e-9 <= onset_s
        and x[last, A_X] * ux + x[last, A_Y] * uy > onset_mps2
    ):
        last += 1

    dvx = dvy = dvz = largest_z = clipped_s = largest = 0.0
    levelled = False
    for k in range(first + 1, last + 1):
        dt = (t_ns[k] - t_ns[k - 1]) * 1e-9
        dvx += 0.5 * dt * (x[k, A_X] + x[k - 1, A_X])
        dvy += 0.5 * dt * (x[k, A_Y] + x[k - 1, A_Y])
        dvz += 0.5 * dt * (x[k, A_Z] + x[k - 1, A_Z])
        largest_z = max(largest_z, abs(dvz))
        largest = max(largest, math.hypot(x[k, V_X] - x[first, V_X], x[k, V_Y] - x[first, V_Y]))
        if flags[k] & LEVELLED:
            levelled = True
    for k in range(first + 1, last + 1):
        if flags[k] & CLIPPED and _along(x, k, dvx, dvy) > 0.0:
            clipped_s += (t_ns[k] - t_ns[k - 1]) * 1e-9
    for k in range(last + 1, end + 1):  # what was given back after, by a shock's swing
        largest = max(largest, math.hypot(x[k, V_X] - x[first, V_X], x[k, V_Y] - x[first, V_Y]))
    kept = math.hypot(x[end, V_X] - x[first, V_X], x[end, V_Y] - x[first, V_Y]) / max(largest, 1e-9)
    return first, last, dvx, dvy, largest_z, kept, peak, clipped_s, levelled


@njit(cache=True, nogil=True)
def fit_clipped(
    t_ns: TimeArray, x: FloatArray, flags: Flags, first: int, last: int, ux: float, uy: float
) -> tuple[float, float, float, float, float]:
    """Mean and sd of the change of velocity (m/s), mean length (s) and direction of a clipped pulse along (ux, uy).

    Clipping one axis and not the other turns the readings away from the pulse's direction, so the flanks give it.

    Posterior over a grid of half-sines and haversines, a(t) = A sin(pi (t - t0) / T) to the power 1 or 2, the two
    shapes between which crash pulses lie: unclipped samples are compared with it, clipped ones only say
    that it was at least so much. A is uniform in its logarithm, T and the change of
    velocity A T / 2 have the priors above.
    """
    level, run = 1.0, first
    clip_first, clip_last = first, first  # the longest run of clipped samples that push the pulse's own way
    for k in range(first, last + 1):
        if not flags[k] & CLIPPED or _along(x, k, ux, uy) <= 0.0:
            run = k + 1
            continue
        level = max(level, _along(x, k, ux, uy))
        if t_ns[k] - t_ns[run] >= t_ns[clip_last] - t_ns[clip_first]:
            clip_first, clip_last = run, k
    clipped_s = (t_ns[clip_last] - t_ns[clip_first]) * 1e-9
    begin, end = clip_first, clip_last  # the flanks, as long as they fall away from what clipped
    while begin > first and _along(x, begin - 1, ux, uy) < _along(x, begin, ux, uy):
        begin -= 1
    while end < last and _along(x, end + 1, ux, uy) < _along(x, end, ux, uy):
        end += 1
    flank_x = flank_y = 0.0
    for k in range(begin, end + 1):
        if not flags[k] & CLIPPED:
            flank_x += x[k, A_X]
            flank_y += x[k, A_Y]
    flank = math.hypot(flank_x, flank_y)
    if flank_x * ux + flank_y * uy > 0.5 * flank and flank >= FLANK_MPS2:
        ux, uy = flank_x / flank, flank_y / flank
    n = end - begin + 1
    time, value, shape = np.empty(n), np.empty(n), np.empty(n)
    hidden_s = 0.0
    for k in range(n):
        time[k] = (t_ns[begin + k] - t_ns[clip_first]) * 1e-9
        value[k] = _along(x, begin + k, ux, uy)
        if k > 0 and flags[begin + k] & CLIPPED:
            hidden_s += time[k] - time[k - 1]
    spacing_s = (t_ns[last] - t_ns[first]) * 1e-9 / max(last - first, 1)
    weight_of_one = min(1.0, spacing_s / MISFIT_S)
    room = max(-time[0], 1e-3) + 0.5 * spacing_s
    longest = max(LONGEST_S, 2.0 * clipped_s)

    best = math.inf
    for stage in range(2):  # first the smallest cost, then the sums, so that exp() never overflows
        total = sum_v = sum_vv = sum_t = 0.0
        for i in range(LENGTHS):
            length = SHORTEST_S * (longest / SHORTEST_S) ** (i / (LENGTHS - 1))
            if length < clipped_s:
                continue
            prior = (math.log(length / PULSE_MEDIAN_S) / PULSE_LOG_SD) ** 2
            for j in range(STARTS):
                start = -room * (j + 0.5) / STARTS
                for power in range(1, 3):
                    for k in range(n):
                        phase = (time[k] - start) / length
                        shape[k] = math.sin(math.pi * phase) ** power if 0.0 < phase < 1.0 else 0.0
                    area = 2.0 / math.pi if power == 1 else 0.5
                    for m in range(AMPLITUDES):
                        amplitude = level * STRONGEST ** (m / (AMPLITUDES - 1))
                        delta_v = area * amplitude * length
                        cost = prior + (math.log(delta_v / DELTA_V_MEDIAN_MPS) / DELTA_V_LOG_SD) ** 2
                        for k in range(n):
                            off = value[k] - amplitude * shape[k]
                            if off > 0.0 or not flags[begin + k] & CLIPPED:
                                cost += weight_of_one * (off / (MISFIT * level)) ** 2
                        if stage == 0:
                            best = min(best, cost)
                        else:
                            weight = math.exp(-0.5 * (cost - best))
                            total += weight
                            sum_v += weight * delta_v
                            sum_vv += weight * delta_v * delta_v
                            sum_t += weight * length
    mean = sum_v / total
    misfit = MISFIT * level * hidden_s  # the flanks' misfit again, over what no flank shows
    return mean, math.sqrt(max(sum_vv / total - mean * mean, 0.0) + misfit * misfit), sum_t / total, ux, uy


def read_pulse(
    t_ns: TimeArray,
    x: FloatArray,
    flags: Flags,
    start: int,
    end: int,
    tyre_mps2: float,
    onset_mps2: float,
    onset_s: float,
) -> Pulse:
    """``measure`` with its change of velocity turned into forward and right at the pulse's start."""
    first, last, dvx, dvy, vertical, kept, peak, clipped_s, levelled = measure(
        t_ns, x, flags, start, end, tyre_mps2, onset_mps2, onset_s
    )
    cos, sin = float(x[first, HEADING_COS]), float(x[first, HEADING_SIN])
    return Pulse(
        first=first,
        last=last,
        forward_mps=dvx * cos + dvy * sin,
        right_mps=-dvx * sin + dvy * cos,
        vertical_mps=vertical,
        retained=kept,
        peak_mps2=peak,
        duration_s=float(t_ns[last] - t_ns[first]) * 1e-9,
        clipped_s=clipped_s,
        levelled=levelled,
    )


def unclip(t_ns: TimeArray, x: FloatArray, flags: Flags, pulse: Pulse) -> Whole:
    """The whole pulse behind a clipped one."""
    cos, sin = float(x[pulse.first, HEADING_COS]), float(x[pulse.first, HEADING_SIN])
    norm = math.hypot(pulse.forward_mps, pulse.right_mps)
    forward, right = pulse.forward_mps / norm, pulse.right_mps / norm
    ux, uy = forward * cos - right * sin, forward * sin + right * cos
    delta_v, sd, duration_s, ux, uy = fit_clipped(t_ns, x, flags, pulse.first, pulse.last, ux, uy)
    return Whole(delta_v, sd, duration_s, forward=ux * cos + uy * sin, right=-ux * sin + uy * cos)
