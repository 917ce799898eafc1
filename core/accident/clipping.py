"""What clipping hid of a crash pulse: a posterior over pulse shapes, on both horizontal axes at once."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numba import njit

from core.accident.level import A_X, A_Y, CLIPPED, HEADING_COS, HEADING_SIN, Flags
from core.measurements import FloatArray, TimeArray


class Whole(NamedTuple):
    """A whole pulse estimated from what was not clipped, along forward and right at its start.

    Change of velocity (m/s) with sd and 95 % interval, its length (s), its direction as a unit vector with spread
    (rad), and mean (2,) and covariance (2, 2) of its parts, m/s.
    """

    delta_v_mps: float
    sd_mps: float
    low_mps: float
    high_mps: float
    duration_s: float
    direction: FloatArray
    direction_sd_rad: float
    mean_mps: FloatArray
    covariance: FloatArray


PULSE_MEDIAN_S: Final = 0.11
"""Usual length of a collision's pulse, s: 95 ms against a rigid barrier (NHTSA test 10146), longer where another car
gives way. A prior for clipped pulses only; an assumption, not fitted to a set of crashes."""
PULSE_LOG_SD: Final = 0.35
"""Spread of the logarithm of that length: two thirds of pulses between 78 and 156 ms. A choice."""
MISFIT: Final = 0.4
"""How far a real pulse's flank strays from these shapes, of the level it clips at: structures ring. A choice, after
NHTSA test 10146, whose flank at 2, 4 and 16 g leads and lags them by so much."""
MISFIT_S: Final = 0.005
"""How long such a stray lasts, s: samples closer together share one. A choice, after the same test."""
DELTA_V_MEDIAN_MPS: Final = 5.6
DELTA_V_LOG_SD: Final = 1.0
"""Changes of velocity that collisions bring, m/s, as a log-normal prior: two thirds between 2.1 and 15 m/s. A choice:
about 20 km/h is usual where a car had to be towed, and few exceed 60 km/h."""
SHORTEST_S: Final = 0.02
LONGEST_S: Final = 0.4
"""Lengths that the grid spans, s: wider than the prior by four of its sds. A choice."""
STRONGEST_MPS2: Final = 70.0 * 9.80665
"""Amplitudes that the grid spans, from what was read to this, m/s2: compartments of cars see 40 to 50 g against a rigid
barrier at 56 km/h (NHTSA test 10146). A choice."""
AT_SCALE: Final = 0.93
"""An axis read its full scale where it read so much of the most that was read. A choice: offsets and tilt are less."""
ROBUST: Final = 4.0
"""A sample's misfit costs no more than so many times its variance: what rings late strays by any amount. A choice."""
LENGTHS: Final = 32
STARTS: Final = 12
AMPLITUDES: Final = 41
"""Nodes of the grid over length, start (within the first flank's room) and each axis' amplitude."""
BINS: Final = 160
LOG_LEAST: Final = math.log(0.1)
LOG_MOST: Final = math.log(100.0)
"""Bins of the posterior for its quantiles: equal ones of the logarithm, 0.1 to 100 m/s."""
FAR: Final = 40.0
"""A cost so far above the least counts as nothing: e^-20."""


def unclip(t_ns: TimeArray, x: FloatArray, flags: Flags, first: int, last: int) -> Whole:
    """The whole pulse behind a clipped one between two rows, of which one at least is clipped."""
    # Axes as they stand at the middle of what clipped: a car that spins turns little while it clips.
    clipped = first + np.flatnonzero(flags[first : last + 1] & CLIPPED)
    middle = int(clipped[len(clipped) // 2])
    cos, sin = float(x[middle, HEADING_COS]), float(x[middle, HEADING_SIN])
    rows = slice(first, last + 1)
    read = np.column_stack([x[rows, A_X] * cos + x[rows, A_Y] * sin, -x[rows, A_X] * sin + x[rows, A_Y] * cos])
    at_scale = np.zeros(read.shape, dtype=np.bool_)
    # What shakes the vertical lays a part of itself into the plane where the box is tilted: the median is the scale.
    scale = float(np.median(np.max(np.abs(read[clipped - first]), axis=1)))
    at_scale[clipped - first] = np.abs(read[clipped - first]) >= AT_SCALE * scale
    found = _fit((t_ns[rows] - t_ns[first]) * 1e-9, read, at_scale.astype(np.float64), scale)
    size, sd, low, high, duration_s, mean, covariance, unit = found
    start_cos, start_sin = float(x[first, HEADING_COS]), float(x[first, HEADING_SIN])
    c, s = cos * start_cos + sin * start_sin, sin * start_cos - cos * start_sin
    turn = np.array([[c, -s], [s, c]])
    length = max(float(np.hypot(*unit)), 1e-9)
    return Whole(
        delta_v_mps=size,
        sd_mps=sd,
        low_mps=low,
        high_mps=high,
        duration_s=duration_s,
        direction=turn @ (unit / length),
        # Of a spread about a mean direction, the length of the mean unit vector is exp(-sd^2 / 2).
        direction_sd_rad=math.sqrt(max(-2.0 * math.log(min(length, 1.0)), 0.0)),
        mean_mps=turn @ mean,
        covariance=turn @ covariance @ turn.T,
    )


@njit(cache=True, nogil=True)
def _fit(
    time: FloatArray, read: FloatArray, at_scale: FloatArray, scale: float
) -> tuple[float, float, float, float, float, FloatArray, FloatArray, FloatArray]:
    """Mean, sd, 2.5 and 97.5 % quantiles of the change of velocity (m/s), mean length (s), mean and covariance of its
    parts along the two axes, and the mean of its unit vector.

    Posterior over half-sines and haversines a(t) = A sin(pi (t - t0) / T)^k with k = 1 or 2, the two shapes between
    which crash pulses lie, the same one on both axes: samples are compared with it, those at full scale only say that
    it was at least so much. Given start, length and shape the axes' amplitudes are independent but for the prior, so
    that a table for each suffices. The change of velocity |A| T / 2 and T have the priors above, |A| is uniform in its
    logarithm, and the direction lies between uniform and along an axis, where most crashes are: density |A|^-1.5.
    """
    n, rows = time.shape[0], np.flatnonzero(at_scale[:, 0] + at_scale[:, 1])
    # The longest run at full scale, then the flanks, as long as they fall away from it.
    first = last = begin = rows[0]
    for i in range(1, rows.shape[0]):
        if rows[i] != rows[i - 1] + 1:
            begin = rows[i]
        if rows[i] - begin > last - first:
            first, last = begin, rows[i]
    length = np.hypot(read[:, 0], read[:, 1])
    low_row, high_row = first, last
    while low_row > 0 and length[low_row - 1] < length[low_row]:
        low_row -= 1
    while high_row < n - 1 and length[high_row + 1] < length[high_row]:
        high_row += 1
    clipped_s = time[last] - time[first]
    n = high_row - low_row + 1
    value, clip = read[low_row : high_row + 1], at_scale[low_row : high_row + 1]
    since = time[low_row : high_row + 1] - time[first]
    hidden_s = 0.0
    for k in range(1, n):
        if clip[k, 0] > 0.0 or clip[k, 1] > 0.0:
            hidden_s += since[k] - since[k - 1]
    spacing_s = (time[-1] - time[0]) / max(time.shape[0] - 1, 1)
    weight_of_one = min(1.0, spacing_s / MISFIT_S)
    room = max(-since[0], 1e-3) + 0.5 * spacing_s
    longest = max(LONGEST_S, 2.0 * clipped_s)
    strongest = max(STRONGEST_MPS2 / scale, 1.5)

    # Nodes even in asinh: about evenly below the full scale, evenly in the logarithm above it. With each its share.
    reach = math.asinh(2.0 * strongest)
    node, share = np.empty(AMPLITUDES), np.empty(AMPLITUDES)
    for m in range(AMPLITUDES):
        at = reach * (2.0 * m / (AMPLITUDES - 1) - 1.0)
        node[m] = 0.5 * scale * math.sinh(at)
        share[m] = 0.5 * scale * math.cosh(at)
    log_share = np.empty((AMPLITUDES, AMPLITUDES))
    log_size = np.empty((AMPLITUDES, AMPLITUDES))
    for i in range(AMPLITUDES):
        for j in range(AMPLITUDES):
            size = math.hypot(node[i], node[j])
            log_size[i, j] = math.log(max(size, 1e-6))
            log_share[i, j] = math.log(share[i] * share[j] / max(size, 1e-6) ** 1.5)
    cost = np.empty((2, AMPLITUDES))
    shape = np.empty(n)
    bins = np.zeros(BINS)
    best = math.inf
    mean, unit, second = np.zeros(2), np.zeros(2), np.zeros((2, 2))
    total = sum_v = sum_vv = sum_t = 0.0
    for stage in range(2):  # first the least cost, then the sums, so that exp() never overflows
        for i_length in range(LENGTHS):
            pulse_s = SHORTEST_S * (longest / SHORTEST_S) ** (i_length / (LENGTHS - 1))
            if pulse_s < clipped_s:
                continue
            prior = (math.log(pulse_s / PULSE_MEDIAN_S) / PULSE_LOG_SD) ** 2
            for i_start in range(STARTS):
                start = -room * (i_start + 0.5) / STARTS
                for power in range(1, 3):
                    for k in range(n):
                        phase = (since[k] - start) / pulse_s
                        shape[k] = math.sin(math.pi * phase) ** power if 0.0 < phase < 1.0 else 0.0
                    for axis in range(2):
                        for m in range(AMPLITUDES):
                            sum_of_squares = 0.0
                            for k in range(n):
                                off = (value[k, axis] - node[m] * shape[k]) / (MISFIT * scale)
                                if clip[k, axis] == 0.0 or (off > 0.0) == (value[k, axis] > 0.0):
                                    sum_of_squares += off * off / (1.0 + off * off / ROBUST)
                            cost[axis, m] = prior * 0.5 + weight_of_one * sum_of_squares
                    area_s = pulse_s * (2.0 / math.pi if power == 1 else 0.5)
                    log_area = math.log(area_s / DELTA_V_MEDIAN_MPS)
                    least = np.min(cost[1])
                    for i in range(AMPLITUDES):
                        if cost[0, i] + least > best + FAR:
                            continue
                        for j in range(AMPLITUDES):
                            both = cost[0, i] + cost[1, j] + ((log_size[i, j] + log_area) / DELTA_V_LOG_SD) ** 2
                            both -= 2.0 * log_share[i, j]
                            if stage == 0:
                                best = min(best, both)
                                continue
                            if both > best + FAR:
                                continue
                            weight = math.exp(-0.5 * (both - best))
                            x, y = area_s * node[i], area_s * node[j]
                            size = math.hypot(x, y)
                            total += weight
                            sum_v += weight * size
                            sum_vv += weight * size * size
                            sum_t += weight * pulse_s
                            mean[0] += weight * x
                            mean[1] += weight * y
                            second[0, 0] += weight * x * x
                            second[0, 1] += weight * x * y
                            second[1, 1] += weight * y * y
                            unit[0] += weight * x / max(size, 1e-9)
                            unit[1] += weight * y / max(size, 1e-9)
                            place = (math.log(max(size, 1e-3)) - LOG_LEAST) / (LOG_MOST - LOG_LEAST) * BINS
                            bins[min(max(int(place), 0), BINS - 1)] += weight
    delta_v, mean, unit = sum_v / total, mean / total, unit / total
    misfit = MISFIT * scale * hidden_s  # the flanks' misfit again, over what no flank shows
    covariance = second / total
    covariance[1, 0] = covariance[0, 1]
    for i in range(2):
        for j in range(2):
            covariance[i, j] -= mean[i] * mean[j]
        covariance[i, i] += misfit * misfit
    sd = math.sqrt(max(sum_vv / total - delta_v * delta_v, 0.0) + misfit * misfit)
    low = delta_v - math.hypot(delta_v - _quantile(bins, 0.025 * total), 1.96 * misfit)
    high = delta_v + math.hypot(_quantile(bins, 0.975 * total) - delta_v, 1.96 * misfit)
    return delta_v, sd, low, high, sum_t / total, mean, covariance, unit


@njit(cache=True, nogil=True)
def _quantile(weights: FloatArray, share: float) -> float:
    """Change of velocity, m/s, up to which the weights of the bins sum to ``share``."""
    below = 0.0
    for k in range(BINS):
        if below + weights[k] >= share:
            inside = (share - below) / max(weights[k], 1e-300)
            return math.exp(LOG_LEAST + (LOG_MOST - LOG_LEAST) * (k + inside) / BINS)
        below += weights[k]
    return math.exp(LOG_MOST)
