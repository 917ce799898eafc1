"""What a converter that fails does to the samples and no body can: it hangs, jumps to full scale and stays, spikes."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numba import njit

from core.accident.level import A_X, A_Y, A_Z, CLIP_S, FORCE, GAP, PITCH_RATE, ROLL_RATE, YAW_RATE, Flags
from core.measurements import FloatArray, TimeArray

ACCELERATION: Final = (A_X, A_Y, A_Z)
RATE: Final = (ROLL_RATE, PITCH_RATE, YAW_RATE)

HELD: Final = 0.01
"""By less of itself the specific force's length changes from sample to sample where an axis hangs. A choice."""
BEFORE_NS: Final = 600_000_000
"""For how long before a jump is looked at how a vehicle shook and turned anyway, ns: wheels hop and bodies bounce
once at least. A choice."""
JUMPED: Final = 0.7
"""Share of the way to full scale that is made from one sample to the next: what swells makes less. A choice; blows of
simulated crashes at 2 g do, too, at 50 Hz, but shake and turn the vehicle."""
SHAKEN: Final = 3.0
TURNED: Final = 2.5
"""So many times what it did before, a vehicle shakes across the axis at full scale (rms), and turns (largest), where it
was struck. Simulated: failing converters up to 2.5 and 2.0; of blows that jump, the least were 1.6 and 5.2 or 3.6 and
1.6."""
TILTED: Final = 0.05
"""Share of a jump, of all axes at once, that the level frame lays across it as it tilts by 3 deg. A choice."""
FALLEN: Final = 0.1
FARTHER: Final = 1.2
"""By no more of the jump, and so many times the farthest before, a failing converter is off what it read before once it
lets go. A body's pulse has a flank, and what was struck rings, though no gyroscope may have felt it. Choices."""
LEAVES: Final = 0.1
"""A spike's neighbours are nearer to each other than so much of its largest sample: no box's low-pass lets through
more. A choice, as ``sharp_share``."""
LEAST_MPS2: Final = 1.0
"""A sample that is off by less is no spike, m/s2. A choice: roads shake a car by more."""
SPIKE_NS: Final = 45_000_000
SPIKE_ROWS: Final = 3
"""A spike is over within so long, ns, one sample at least and so many at most. A choice: shorter than any crash."""


@njit(cache=True, nogil=True)
def hangs(
    t_ns: TimeArray, x: FloatArray, flags: Flags, rows: tuple[int, int], jolt_radps: float, unturned_radps: float
) -> bool:
    """Whether an axis reads its full scale up to the second of two rows, got there from one sample to the next, and the
    others hardly move, as roads shake them at most: a blow would, and would turn the vehicle."""
    first, last = rows
    clipped = held = 0
    for k in range(first + 1, last + 1):
        if x[k, CLIP_S] > 0.0 and x[k - 1, CLIP_S] > 0.0:
            clipped += 1
            if abs(x[k, FORCE] - x[k - 1, FORCE]) < HELD * x[k, FORCE]:
                held += 1
    still = 2 * held >= clipped or 0.0 < jolt_radps < unturned_radps
    if x[last, CLIP_S] == 0.0 or not still:
        return False
    begin = last
    while begin > 0 and x[begin - 1, CLIP_S] > 0.0:
        begin -= 1
    return _jumped(x, begin, _mean(x, _since(t_ns, flags, begin), begin - 1, ACCELERATION))


@njit(cache=True, nogil=True)
def pinned(t_ns: TimeArray, x: FloatArray, flags: Flags, first: int, last: int) -> bool:
    """Whether, in the longest stretch at full scale between two rows, an axis got there from one sample to the next,
    nothing else shook or turned by more than it had before, and it fell back as fast as it came, as far as that is
    seen: a rough road, and a converter that fails on it."""
    begin = longest = run = 0
    for k in range(first, last + 1):
        run = run + 1 if x[k, CLIP_S] > 0.0 else 0
        if run > longest:
            longest, begin = run, k - run + 1
    since = _since(t_ns, flags, begin)
    if longest < 2 or begin - since < 4:
        return False
    mean, turning = _mean(x, since, begin - 1, ACCELERATION), _mean(x, since, begin - 1, RATE)
    if not _jumped(x, begin, mean):
        return False
    jump = np.array([x[begin, i] - x[begin - 1, i] for i in ACCELERATION])
    length = math.sqrt(jump[0] ** 2 + jump[1] ** 2 + jump[2] ** 2)
    way, let_go = jump / length, begin + longest
    shook_before, turned_before = _unrest(x, since, begin - 1, mean, way, turning)
    shook, turned = _unrest(x, begin, let_go, mean, way, turning)
    as_before = max(FALLEN * length, FARTHER * _farthest(x, since, begin - 1, mean, way))
    still = (
        shook < max(SHAKEN * shook_before, TILTED * length) and _farthest(x, let_go, last + 1, mean, way) < as_before
    )
    return still and turned_before > 0.0 and turned < TURNED * turned_before


@njit(cache=True, nogil=True)
def _since(t_ns: TimeArray, flags: Flags, begin: int) -> int:
    """The first row that counts as before ``begin``."""
    since = max(begin - 1, 0)
    while since > 0 and not flags[since] & GAP and t_ns[begin] - t_ns[since - 1] <= BEFORE_NS:
        since -= 1
    return since


@njit(cache=True, nogil=True)
def _mean(x: FloatArray, first: int, end: int, columns: tuple[int, int, int]) -> FloatArray:
    """Means of columns, (3,), of rows from ``first`` to before ``end``; zeros of none."""
    mean = np.zeros(3)
    for k in range(first, end):
        for i in range(3):
            mean[i] += x[k, columns[i]] / (end - first)
    return mean


@njit(cache=True, nogil=True)
def _jumped(x: FloatArray, row: int, mean: FloatArray) -> bool:
    """Whether most of the way from ``mean`` to the acceleration of a row was made in the sample before it."""
    if row == 0:
        return False
    way2 = jump2 = 0.0
    for i in range(3):
        way2 += (x[row, ACCELERATION[i]] - mean[i]) ** 2
        jump2 += (x[row, ACCELERATION[i]] - x[row - 1, ACCELERATION[i]]) ** 2
    return jump2 > 0.0 and jump2 >= JUMPED * JUMPED * way2


@njit(cache=True, nogil=True)
def _farthest(x: FloatArray, first: int, end: int, mean: FloatArray, way: FloatArray) -> float:
    """How far the acceleration along a unit vector comes from ``mean`` in rows from ``first`` to before ``end``."""
    most = 0.0
    for k in range(first, end):
        along = 0.0
        for i in range(3):
            along += (x[k, ACCELERATION[i]] - mean[i]) * way[i]
        most = max(most, abs(along))
    return most


@njit(cache=True, nogil=True)
def _unrest(
    x: FloatArray, first: int, end: int, mean: FloatArray, jump: FloatArray, turning: FloatArray
) -> tuple[float, float]:
    """Rms of the acceleration across ``jump`` (m/s2), and largest rate (rad/s), off ``mean`` and ``turning``, in rows
    from ``first`` to before ``end``."""
    squares = most = 0.0
    for k in range(first, end):
        along = squared = rate2 = 0.0
        for i in range(3):
            off = x[k, ACCELERATION[i]] - mean[i]
            along += off * jump[i]
            squared += off * off
            rate2 += (x[k, RATE[i]] - turning[i]) ** 2
        squares += max(squared - along * along, 0.0)
        most = max(most, rate2)
    return math.sqrt(squares / (end - first)), math.sqrt(most)


@njit(cache=True, nogil=True)
def sound_share(t_ns: TimeArray, x: FloatArray, first: int, last: int, end: int) -> float:
    """Share of the change of horizontal velocity between two rows that is left without spikes, with rows up to ``end``
    to see whether they are: samples off what is before and after them, which are alike. What has jumped within the last
    rows may be one yet."""
    dvx = dvy = 0.0
    for k in range(first + 1, last + 1):
        dt = (t_ns[k] - t_ns[k - 1]) * 1e-9
        dvx += 0.5 * dt * (x[k, A_X] + x[k - 1, A_X])
        dvy += 0.5 * dt * (x[k, A_Y] + x[k - 1, A_Y])
    left_x, left_y, k = dvx, dvy, max(first, 1)
    while k <= last:
        rows = _spike_rows(t_ns, x, k, end)
        for j in range(k, min(k + rows, last + 1)):
            weight = (t_ns[j] - t_ns[j - 1]) * (0.5e-9 if j in (first, last) else 1e-9)  # as in the sum above
            left_x -= weight * (x[j, A_X] - x[k - 1, A_X])
            left_y -= weight * (x[j, A_Y] - x[k - 1, A_Y])
        k += rows + 1  # what follows a spike is as it was before
    return math.hypot(left_x, left_y) / max(math.hypot(dvx, dvy), 1e-9)


@njit(cache=True, nogil=True)
def _spike_rows(t_ns: TimeArray, x: FloatArray, row: int, end: int) -> int:
    """How many rows from ``row`` on are a spike; 0 where none begins."""
    least, most = math.inf, 0.0
    for j in range(row, min(row + SPIKE_ROWS, end + 1)):
        if j > row and t_ns[j + 1 if j < end else j] - t_ns[row - 1] > SPIKE_NS:
            return 0
        least, most = min(least, _apart(x, j, row - 1)), max(most, _apart(x, j, row - 1))
        if least < LEAST_MPS2:
            return 0
        if j == end or _apart(x, j + 1, row - 1) < LEAVES * most:
            return j + 1 - row
    return 0


@njit(cache=True, nogil=True)
def _apart(x: FloatArray, row: int, other: int) -> float:
    off = (x[row, A_X] - x[other, A_X], x[row, A_Y] - x[other, A_Y], x[row, A_Z] - x[other, A_Z])
    return math.sqrt(off[0] ** 2 + off[1] ** 2 + off[2] ** 2)
