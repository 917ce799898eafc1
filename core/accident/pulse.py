"""One crash pulse read off the level rows: change of velocity, length, peak."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numba import njit

from core.accident.converters import pinned, sound_share
from core.accident.level import (
    A_X,
    A_Y,
    A_Z,
    CLIP_S,
    CLIPPED,
    FORCE,
    GAP,
    HEADING_COS,
    HEADING_SIN,
    LEVELLED,
    PITCH_RATE,
    REST_S,
    ROLL_RATE,
    SLOW_X,
    SLOW_Y,
    V_X,
    V_Y,
    V_Z,
    YAW_RATE,
    Flags,
)
from core.accident.thresholds import PulseThresholds, TriggerThresholds
from core.measurements import FloatArray, TimeArray


class Pulse(NamedTuple):
    """A pulse between two rows. Velocities are changes along forward and right at its start, m/s.

    ``felt_mps`` and ``felt_s`` are change and length of what stands out of braking, by which it is judged.
    ``beyond_mps`` is by how much the change exceeds what tyres, pedals and steering can. ``swing_mps`` is the range of
    the vertical change of velocity around it, ``retained`` the share of the largest change that was kept, ``clipped_s``
    how much of it clipped and ``clipping_s`` for how long an axis read its full scale at a stretch, ``abrupt`` the
    acceleration right before and after as a share of its peak, ``rate_radps`` the fastest rotation and ``jolt_radps``
    the largest change of it, ``tip_radps`` that of roll and pitch alone, ``stood`` whether the vehicle had stood.
    ``pinned`` and ``sound`` say how far it is a converter's doing: see ``converters``.
    """

    first: int
    last: int
    forward_mps: float
    right_mps: float
    felt_mps: float
    felt_s: float
    beyond_mps: float
    swing_mps: float
    retained: float
    peak_mps2: float
    duration_s: float
    clipped_s: float
    clipping_s: float
    abrupt: float
    rate_radps: float
    jolt_radps: float
    tip_radps: float
    levelled: bool
    stood: bool
    pinned: bool
    sound: float


LASTS: Final = 0.1
"""Abruptness that what goes on over more than three samples has at least: no spike, if edged. A choice."""
SHAKEN_MPS: Final = 0.15
SHAKEN: Final = 0.04
"""Vertical change of velocity, m/s and as a share of the horizontal one, that a blow leaves and a horizontal axis
that fails does not, but for what tilt lays into the vertical. A choice, after NHTSA test 10146 (0.07 and more)."""


RING_NS: Final = 80_000_000
"""For how long after its end a blow is looked at for ringing, ns: a period and more of what a body rings by, 15 to
40 Hz. A choice, after NHTSA test 10146."""
RING: Final = 0.1
RING_ROWS: Final = 3
RING_LEAST_NS: Final = 35_000_000
"""Ringing has three samples on end above this share of the peak, or two of so long, and three times what there was
before: a converter that lets go is back in one. A choice."""

PLATEAU_NS: Final = 25_000_000
"""Over what a falling flank is told from what brakes and tyres do, ns: twice that holds three samples at 50 Hz."""
ANY: Final = (0.0, 0.0, 1 << 60)
"""Nothing was told of a pulse yet."""


@njit(cache=True, nogil=True)
def _along(x: FloatArray, row: int, ux: float, uy: float) -> float:
    """Acceleration along a horizontal direction of the level frame, times the length of (ux, uy), m/s2."""
    return float(x[row, A_X] * ux + x[row, A_Y] * uy)


@njit(cache=True, nogil=True)
def unexplained(x: float, y: float, slow_x: float, slow_y: float) -> float:
    """Length of what of (x, y) is neither (slow_x, slow_y) nor a part of it: the distance from the line to zero."""
    slow2 = slow_x * slow_x + slow_y * slow_y
    share = min(1.0, max(0.0, (x * slow_x + y * slow_y) / slow2)) if slow2 > 1e-12 else 0.0
    return math.hypot(x - share * slow_x, y - share * slow_y)


@njit(cache=True, nogil=True)
def beyond(
    change_mps: float,
    own_mps: float,
    window_s: float,
    stood: bool,
    tyre_mps2: float,
    standing_mps2: float,
    jerk_mps3: float,
) -> float:
    """By how much a change of velocity exceeds what tyres, pedals and steering can within a window, m/s.

    ``own_mps`` is what of it is not explained by the acceleration that there was. See ``TriggerThresholds``.
    """
    moved = 0.5 * jerk_mps3 * window_s * window_s
    if stood:
        return own_mps - min(standing_mps2 * window_s, moved)
    return max(change_mps - tyre_mps2 * window_s, own_mps - moved)


@njit(cache=True, nogil=True)
def core_rows(
    t_ns: TimeArray,
    x: FloatArray,
    start: int,
    end: int,
    rest_s: float,
    reach: tuple[float, float, float],
    told: tuple[float, float, int],
) -> tuple[int, int, float]:
    """The two rows of ``start`` to ``end`` between which the velocity changed most beyond reach, and by how much.

    What was told of it already is a direction, in the level frame, that it is not against, and by when it had begun.
    """
    tyre, standing, jerk = reach
    ux, uy, begun = told
    first, last, most = start, start, -math.inf
    for i in range(start, min(end, begun)):
        stood = x[i, REST_S] >= rest_s
        for j in range(i + 1, end + 1):
            w = (t_ns[j] - t_ns[i]) * 1e-9
            vx, vy = x[j, V_X] - x[i, V_X], x[j, V_Y] - x[i, V_Y]
            own = unexplained(vx, vy, x[i, SLOW_X] * w, x[i, SLOW_Y] * w)
            value = beyond(math.hypot(vx, vy), own, w, stood, tyre, standing, jerk)
            if value > most and vx * ux + vy * uy >= 0.0:
                first, last, most = i, j, value
    return first, last, most


@njit(cache=True, nogil=True)
def widened(
    t_ns: TimeArray,
    x: FloatArray,
    flags: Flags,
    first: int,
    last: int,
    ends: tuple[int, int],
    onset_mps2: float,
    onset_s: float,
    tail_s: float,
    after_ns: int,
    plateau_mps2: float,
) -> tuple[int, int, int]:
    """The rows of a pulse around its core, by the acceleration along its direction: since and while it exceeds what
    there was before by ``onset_mps2``, by at most ``onset_s`` on either side and up to the first of ``ends``; and,
    third, until it has fallen to half of that above what there is afterwards, in the last ``after_ns`` up to the second
    of ``ends``, by at most ``tail_s``, and up to where it falls by less than ``plateau_mps2`` from one 25 ms to the
    next: brakes and tyres go on where the pulse does not."""
    since = (t_ns[last] - t_ns[first]) * 1e-9
    slow_x, slow_y = x[first, SLOW_X], x[first, SLOW_Y]
    ux, uy = x[last, V_X] - x[first, V_X] - slow_x * since, x[last, V_Y] - x[first, V_Y] - slow_y * since
    norm = max(math.hypot(ux, uy), 1e-9)
    ux, uy = ux / norm, uy / norm
    slow = slow_x * ux + slow_y * uy
    begin, stop, over = first, last, last
    while (
        begin > 0
        and not flags[begin] & GAP
        and (t_ns[first] - t_ns[begin - 1]) * 1e-9 <= onset_s
        and _along(x, begin, ux, uy) - slow > onset_mps2
    ):
        begin -= 1
    while (
        stop < ends[0]
        and (t_ns[stop + 1] - t_ns[last]) * 1e-9 <= onset_s
        and _along(x, stop, ux, uy) - slow > onset_mps2
    ):
        stop += 1
    after, rows, k = 0.0, 0, ends[1]
    while k > last and t_ns[ends[1]] - t_ns[k] < after_ns:
        after += _along(x, k, ux, uy)
        rows += 1
        k -= 1
    after = max(after / rows, 0.0) if rows > 0 else slow
    while (
        over < ends[1]
        and (t_ns[over + 1] - t_ns[last]) * 1e-9 <= tail_s
        and _along(x, over, ux, uy) - after > 0.5 * onset_mps2
        and (over < stop or _falls(t_ns, x, over, ends[1], ux, uy) >= plateau_mps2)
    ):
        over += 1
    return begin, stop, over


@njit(cache=True, nogil=True)
def _falls(t_ns: TimeArray, x: FloatArray, row: int, end: int, ux: float, uy: float) -> float:
    """By how much the mean acceleration along a direction falls from one ``PLATEAU_NS`` from a row on to the next,
    m/s2; endlessly where that is not known yet."""
    if t_ns[end] - t_ns[row] < 2 * PLATEAU_NS:
        return math.inf
    means = [0.0, 0.0]
    counts = [0, 0]
    k = row
    while k <= end and t_ns[k] - t_ns[row] <= 2 * PLATEAU_NS:
        late = 1 if t_ns[k] - t_ns[row] > PLATEAU_NS else 0
        means[late] += _along(x, k, ux, uy)
        counts[late] += 1
        k += 1
    return means[0] / counts[0] - means[1] / counts[1] if counts[1] > 0 else math.inf


@njit(cache=True, nogil=True)
def measure(
    t_ns: TimeArray,
    x: FloatArray,
    flags: Flags,
    first: int,
    last: int,
    end: int,
    stood: bool,
    friction_mps2: float,
    around_ns: int,
) -> tuple[float, float, float, float, float, float, float, float, float, float, bool]:
    """Read a pulse between two rows, with rows up to ``end`` (inclusive) to see what became of it.

    Returns
    -------
    dv_x, dv_y (level frame), range of the vertical change within ``around_ns`` of it, share of the largest change that
    was kept (what friction can take back is no loss), peak, clipped time (s), abruptness, fastest rotation,
    largest change of it and of roll and pitch alone (rad/s), levelled
    """
    slow_x, slow_y = x[first, SLOW_X], x[first, SLOW_Y]
    dvx = dvy = clipped_s = largest = peak = rate = jolt = tip = 0.0
    levelled = False
    for k in range(first + 1, end + 1):
        since = (t_ns[k] - t_ns[first]) * 1e-9
        vx, vy = x[k, V_X] - x[first, V_X] - slow_x * since, x[k, V_Y] - x[first, V_Y] - slow_y * since
        largest = max(largest, math.hypot(vx, vy))
        if k <= last:
            dt = (t_ns[k] - t_ns[k - 1]) * 1e-9
            dvx += 0.5 * dt * (x[k, A_X] + x[k - 1, A_X])
            dvy += 0.5 * dt * (x[k, A_Y] + x[k - 1, A_Y])
            peak = max(peak, math.hypot(x[k, A_X], x[k, A_Y]))
            if flags[k] & LEVELLED:
                levelled = True
        p, q, r = x[k, ROLL_RATE], x[k, PITCH_RATE], x[k, YAW_RATE]
        rate = max(rate, math.sqrt(p * p + q * q + r * r))
        p, q, r = p - x[first, ROLL_RATE], q - x[first, PITCH_RATE], r - x[first, YAW_RATE]
        jolt = max(jolt, math.sqrt(p * p + q * q + r * r))
        tip = max(tip, math.sqrt(p * p + q * q))
    for k in range(first + 1, last + 1):
        if flags[k] & CLIPPED and _along(x, k, dvx, dvy) > 0.0:
            clipped_s += (t_ns[k] - t_ns[k - 1]) * 1e-9
    # Brakes hold a car that was pushed from rest; and of a clipped pulse tyres take back much of what was read.
    friction = friction_mps2 if stood else 0.5 * friction_mps2 if clipped_s > 0.0 else 0.0
    left = largest
    for k in range(last, end + 1):  # shaking swings back and forth again: the least that was left counts
        since = (t_ns[k] - t_ns[first]) * 1e-9
        vx, vy = x[k, V_X] - x[first, V_X] - slow_x * since, x[k, V_Y] - x[first, V_Y] - slow_y * since
        left = min(left, math.hypot(vx, vy) + friction * (t_ns[k] - t_ns[last]) * 1e-9)
    kept = left / max(largest, 1e-9)
    begin = first
    while begin > 0 and not flags[begin] & GAP and t_ns[first] - t_ns[begin - 1] <= around_ns:
        begin -= 1
    low = high = 0.0
    for k in range(begin, end + 1):
        low, high = min(low, x[k, V_Z] - x[first, V_Z]), max(high, x[k, V_Z] - x[first, V_Z])
    abrupt = _abruptness(t_ns, x, first, last, end, slow_x, slow_y, high - low, math.hypot(dvx, dvy))
    return dvx, dvy, high - low, kept, peak, clipped_s, abrupt, rate, jolt, tip, levelled


@njit(cache=True, nogil=True)
def _abruptness(
    t_ns: TimeArray,
    x: FloatArray,
    first: int,
    last: int,
    end: int,
    slow_x: float,
    slow_y: float,
    swing_mps: float,
    change_mps: float,
) -> float:
    """Larger acceleration, without the slow one, of the samples just before and after a pulse, over its peak.

    A converter that fails does so from one sample to the next; a body swells and rings, and shakes on all axes: what
    varies without falling back between counts as 1, and so does what rings on. While the pulse goes on, that it shakes
    the vertical speaks for a body, and that all axes are frozen against it.
    """
    peak, frozen = 0.0, 0
    for k in range(first, last + 1):
        peak = max(peak, math.hypot(x[k, A_X] - slow_x, x[k, A_Y] - slow_y))
        if k > 0 and x[k, FORCE] == x[k - 1, FORCE]:
            frozen += 1
    enter, leave = first, last
    while enter < last and math.hypot(x[enter, A_X] - slow_x, x[enter, A_Y] - slow_y) < 0.3 * peak:
        enter += 1
    while leave > enter and math.hypot(x[leave, A_X] - slow_x, x[leave, A_Y] - slow_y) < 0.3 * peak:
        leave -= 1
    lowest, varied, clipped, loud = math.inf, False, False, 0
    for k in range(enter, leave + 1):
        clipped = clipped or x[k, CLIP_S] > 0.0
        a = math.hypot(x[k, A_X] - slow_x, x[k, A_Y] - slow_y)
        loud += 1 if a >= 0.3 * peak else 0
        lowest, varied = min(lowest, a), varied or a < 0.8 * peak
    if varied and lowest > 0.12 * peak and leave >= enter + 2:  # two samples may fail side by side
        return 1.0
    if leave + 1 >= end:
        if frozen > 1 and 2 * frozen > last - first:
            return 0.0
        if swing_mps > max(SHAKEN_MPS, SHAKEN * change_mps):
            return 1.0
    if _rings(t_ns, x, enter, leave, end, slow_x, slow_y, peak):
        return 1.0
    beside = 0.0
    for way, edge in ((-1, enter), (1, leave)):
        # The quieter of two: a converter that fails may do so in two steps, a body rings on. A blow beyond the full
        # scale has but one sample of flank.
        near = math.inf
        for k in (edge + way, edge + 2 * way):
            if 0 <= k <= end and (k == edge + way or not clipped):
                # With what there was or without: spikes before make a mean that nothing moved by.
                level = min(math.hypot(x[k, A_X] - slow_x, x[k, A_Y] - slow_y), math.hypot(x[k, A_X], x[k, A_Y]))
                near = min(near, math.hypot(level, x[k, A_Z]))
        if near < math.inf:
            beside = max(beside, near)
    lasts = loud > 3 and 2 * loud > leave - enter
    return max(beside / max(peak, 1e-9), LASTS if lasts else 0.0)


@njit(cache=True, nogil=True)
def _rings(
    t_ns: TimeArray, x: FloatArray, enter: int, leave: int, end: int, slow_x: float, slow_y: float, peak: float
) -> bool:
    """Whether a body rings on after its pulse, as nothing did before."""
    before = 0.0
    k = enter - 3  # beyond the flank
    while k >= 0 and t_ns[enter] - t_ns[k] <= RING_NS:
        before = max(before, math.hypot(x[k, A_X] - slow_x, x[k, A_Y] - slow_y))
        k -= 1
    k, on_end = leave + 1, 0
    while k <= end and t_ns[k] - t_ns[leave] <= RING_NS:
        a = math.hypot(x[k, A_X] - slow_x, x[k, A_Y] - slow_y)
        on_end = on_end + 1 if a > max(RING * peak, 3.0 * before) else 0
        if on_end >= RING_ROWS or (on_end > 1 and t_ns[k] - t_ns[k - on_end] >= RING_LEAST_NS):
            return True
        k += 1
    return False


def spin_from(x: FloatArray, start: int, first: int, spin_radps: float) -> int | None:
    """Where rows from ``start`` on are of a car that spins as row ``first`` begins, the row by which a blow had turned
    it so fast; None where it does not."""
    if abs(x[first, YAW_RATE]) < spin_radps or first <= start:
        return None
    fastest = start + int(np.argmax(np.abs(x[start : first + 1, YAW_RATE])))
    return fastest if fastest > start else None


def read_pulse(
    t_ns: TimeArray,
    x: FloatArray,
    flags: Flags,
    start: int,
    ends: tuple[int, int],
    trigger: TriggerThresholds,
    limits: PulseThresholds,
    told: tuple[float, float, int] = ANY,
) -> Pulse:
    """A suspected pulse from row ``start``, turned into forward and right at its start. What speaks for and against it
    is looked for up to the first of ``ends``, its end up to the second. Of ``told`` see ``core_rows``: what follows a
    blow, as a spin, may change the velocity by more than was read of it."""
    reach = (trigger.tyre_mps2, trigger.standing_mps2, trigger.jerk_mps3)
    core_first, core_last, most = core_rows(t_ns, x, start, ends[0], trigger.rest_s, reach, told)
    first, last, over = widened(
        t_ns, x, flags, core_first, core_last, ends, limits.onset_mps2, limits.onset_s, limits.tail_s,
        round(trigger.settled_s * 1e9), limits.plateau_mps2,
    )  # fmt: skip
    stood = bool(x[core_first, REST_S] >= trigger.rest_s)
    dvx, dvy, swing, kept, peak, clipped_s, abrupt, rate, jolt, tip, levelled = measure(
        t_ns, x, flags, first, last, ends[0], stood, limits.friction_mps2, round(limits.around_s * 1e9)
    )
    cos, sin = float(x[first, HEADING_COS]), float(x[first, HEADING_SIN])
    vx, vy = float(x[over, V_X] - x[first, V_X]), float(x[over, V_Y] - x[first, V_Y])
    return Pulse(
        first=first,
        last=over,
        forward_mps=vx * cos + vy * sin,
        right_mps=-vx * sin + vy * cos,
        felt_mps=math.hypot(dvx, dvy),
        felt_s=float(t_ns[last] - t_ns[first]) * 1e-9,
        beyond_mps=most,
        swing_mps=swing,
        retained=kept,
        peak_mps2=peak,
        duration_s=float(t_ns[over] - t_ns[first]) * 1e-9,
        clipped_s=clipped_s,
        clipping_s=float(x[first : ends[0] + 1, CLIP_S].max()),
        abrupt=abrupt,
        rate_radps=rate,
        jolt_radps=jolt,
        tip_radps=tip,
        levelled=levelled,
        stood=stood,
        pinned=pinned(t_ns, x, flags, first, ends[0]),
        sound=sound_share(t_ns, x, first, last, ends[0]),
    )
