"""A box's clock that steps back: told from samples that come late or again, and carried on from where it was.

Everything behind a session holds that time increases. So a step back is made good by an offset on the box's times,
until a pause in the samples is longer than it; from then on the box's own times hold again.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from numba import njit

from core.measurements import FloatArray, Measurements, TimeArray

SECOND_NS: Final = 1_000_000_000

LATE_NS: Final = 2 * SECOND_NS
"""A sample that lies less than this before the newest is late and no more, ns, 0 to 10 s: what ``late_s`` allows a
fix. After a step back no further, samples are left out until the clock has caught up."""

RUN_NS: Final = SECOND_NS
"""Time for which samples have to go on, one after the other, before the newest, for their clock to have stepped, ns,
above 1 s less a sample's period (a second begins within). A choice: what is lost by a step."""

RUN_GAP_NS: Final = SECOND_NS // 5
"""No longer may samples of such a run lie apart, ns, 0.05 to 1 s: a few late ones that meet are none. A choice."""

REMEMBERED_S: Final = 300
"""Seconds of which one sample each is remembered, to know what comes again, 10 to 3600. A choice: farther back time
is not carried on, so that what is told of an accident is never off by more."""

ANEW_NS: Final = 60 * SECOND_NS
"""A run that lies too far back to know whether it comes again has to be as long as this, ns: the longest packet."""

LATEST_NS: Final = 1 << 62
"""The year 2116: a later time is damage, and could not be reckoned on from."""

GAP_NS: Final = 5 * SECOND_NS
"""A pause has to be longer than the offset by this to let go of it, ns: so long that the filter begins anew."""

_OFFSET, _NEWEST, _PERIOD, _RUN_FIRST, _RUN_LAST, _AGAIN = range(6)
"""Registers, int64, ns: the offset; the newest of the box's times, 0 before the first, and what lies between it and
the one before; first and last of a run before it, 0 if there is none; whether that run came before."""

STEPPED: Final = 1
LET_GO: Final = 2
ANEW: Final = 3
"""What happened: the clock stepped back and time goes on; it was let go of that; or it stepped too far back."""


@njit(cache=True, nogil=True)
def _mark(force: TimeArray, rate: TimeArray, k: int) -> int:
    """A number that another sample hardly has, of the bits of one."""
    mark = np.int64(0)
    for i in range(3):
        mark = (mark * 1_000_003 ^ force[k, i]) * 1_000_003 ^ rate[k, i]
    return int(mark)


@njit(cache=True, nogil=True)
def _fold(
    t_ns: TimeArray, force: TimeArray, rate: TimeArray, now: TimeArray, known: TimeArray, offset_ns: TimeArray
) -> tuple[int, int]:
    """Go through samples, their values as bits (n, 3); ``offset_ns`` (n,) is written.

    Returns what happened, and at which sample.
    """
    happened, where = 0, 0
    for k in range(t_ns.shape[0]):
        t = t_ns[k]
        offset_ns[k] = now[_OFFSET]
        if t > LATEST_NS:
            continue
        slot = (t // SECOND_NS) % known.shape[0]
        if now[_NEWEST] == 0 or t > now[_NEWEST]:
            if now[_NEWEST] == 0 or t // SECOND_NS != now[_NEWEST] // SECOND_NS:
                known[slot, 0], known[slot, 1] = t, _mark(force, rate, k)
            if now[_OFFSET] != 0 and t > now[_NEWEST] + now[_OFFSET] + GAP_NS:
                now[_OFFSET] = 0
                happened, where = LET_GO, k
            now[_PERIOD] = t - now[_NEWEST]
            now[_NEWEST], now[_RUN_FIRST] = t, 0
        elif now[_RUN_FIRST] != 0 and 0 <= t - now[_RUN_LAST] <= RUN_GAP_NS:
            crossed = t // SECOND_NS != now[_RUN_LAST] // SECOND_NS
            if crossed and known[slot, 0] == t and known[slot, 1] == _mark(force, rate, k):
                now[_AGAIN] = 1
            now[_RUN_LAST] = t
            far = now[_NEWEST] - now[_RUN_FIRST] > (known.shape[0] - 1) * SECOND_NS
            if now[_AGAIN] == 0 and t - now[_RUN_FIRST] >= (ANEW_NS if far else RUN_NS):
                if far:
                    now[_OFFSET] = 0
                    happened, where = ANEW, k
                else:
                    # The run began one period after the newest.
                    now[_OFFSET] += now[_NEWEST] + now[_PERIOD] - now[_RUN_FIRST]
                    happened, where = STEPPED, k
                now[_NEWEST], now[_RUN_FIRST] = t, 0
        elif t < now[_NEWEST] - LATE_NS:
            now[_RUN_FIRST], now[_RUN_LAST], now[_AGAIN] = t, t, 0
        else:
            now[_RUN_FIRST] = 0
        offset_ns[k] = now[_OFFSET]
    return happened, where


class BoxClock:
    """Gives measurements times that go on where the box's own step back; the same however they come in packets.

    A run of samples that follow each other while all lie long before the newest one is a step of the clock, unless
    they came before to the bit. It takes ``RUN_NS`` to see that; until then they keep their times, and are late. A
    step back beyond ``REMEMBERED_S`` is not made good: what follows has to begin anew, in the box's own times.
    """

    def __init__(self) -> None:
        self._now: TimeArray = np.zeros(6, np.int64)
        self._known: TimeArray = np.zeros((REMEMBERED_S, 2), np.int64)

    @property
    def offset_ns(self) -> int:
        """What is added to the box's times."""
        return int(self._now[_OFFSET])

    def step(self, m: Measurements) -> tuple[Measurements, int]:
        """Measurements with times that can be gone by, and what happened: ``STEPPED``, ``LET_GO``, ``ANEW`` or 0.

        Where it is ``ANEW``, only what is to begin with. All series of a call are by the same clock.
        """
        before_ns = self.offset_ns
        offset_ns = np.empty(len(m.imu_t_ns), np.int64)
        happened, k = _fold(m.imu_t_ns, _bits(m.f_s), _bits(m.omega_s), self._now, self._known, offset_ns)
        if happened == ANEW:
            return m.between(int(m.imu_t_ns[k]), LATEST_NS), ANEW
        after_ns = self.offset_ns
        if before_ns == after_ns == 0:
            return m, 0
        shifted: dict[str, Any] = {"imu_t_ns": m.imu_t_ns + offset_ns}
        for name in ("gnss_t_ns", "magnetometer_t_ns", "speed_t_ns", "barometer_t_ns"):
            t_ns: TimeArray = getattr(m, name)
            shifted[name] = t_ns + after_ns
            if happened == LET_GO:
                of_old = t_ns < m.imu_t_ns[k] - LATE_NS
                shifted[name][of_old] = t_ns[of_old] + before_ns
        return replace(m, **shifted), happened

    def arrays(self) -> dict[str, npt.NDArray[np.generic]]:
        """State by name, for snapshots."""
        return {"now": self._now, "known": self._known}

    def load(self, arrays: dict[str, npt.NDArray[np.generic]]) -> None:
        """Take over what ``arrays`` gave."""
        self._now = np.array(arrays["now"], np.int64)
        self._known = np.array(arrays["known"], np.int64)


def _bits(rows: FloatArray) -> TimeArray:
    return np.ascontiguousarray(rows).view(np.int64)
