"""Gyroscope axes that hang: noise never reads the same to the last bit for long, unless its steps are coarse."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt
from numba import njit

from core.measurements import FloatArray

LONGER: Final = 3.0
"""So many times the longest run of equal readings that was seen before has to be exceeded, 2 to 10. A choice: of
independent readings the longest run grows with the logarithm of their number."""

AT_LEAST: Final = 8.0
"""And this is added, 3 to 100: where hardly two readings are equal, as in kth_stockholm."""

LEARNT_SAMPLES: Final = 1000.0
"""After so many readings runs are known, 100 to 1e5. A choice: 10 s at 100 Hz."""

_LAST, _RUN, _LONGEST, _SAMPLES = range(4)
"""Of each axis: its last reading, how often that has come again, the longest such run before, and how many readings
there were before that run."""


@njit(cache=True, nogil=True)
def _fold(rates: FloatArray, axes: FloatArray, held: FloatArray) -> None:
    """Go through the readings (n, 3) of axes that are (3, 4); ``held`` (n,) is written."""
    for k in range(rates.shape[0]):
        held[k] = 0.0
        for i in range(3):
            axis = axes[i]
            most = LONGER * axis[_LONGEST] + AT_LEAST
            known = axis[_SAMPLES] > LEARNT_SAMPLES
            if rates[k, i] == axis[_LAST]:
                axis[_RUN] += 1.0
                if known and axis[_RUN] >= most:
                    held[k] = 1.0
                continue
            if not known or axis[_RUN] < most:
                axis[_LONGEST] = max(axis[_LONGEST], axis[_RUN])
            axis[_SAMPLES] += axis[_RUN] + 1.0
            axis[_LAST], axis[_RUN] = rates[k, i], 0.0


class HeldAxes:
    """Tells samples in which an axis hangs, from how long it repeated itself before; state is its array."""

    def __init__(self) -> None:
        self.axes: FloatArray = np.zeros((3, 4))
        self.axes[:, _LAST] = np.nan

    def step(self, rates: FloatArray) -> FloatArray:
        """1 where any axis of (n, 3) readings hangs, (n,)."""
        held = np.empty(rates.shape[0])
        _fold(np.ascontiguousarray(rates), self.axes, held)
        return held

    def arrays(self) -> dict[str, npt.NDArray[np.generic]]:
        """State by name, for snapshots."""
        return {"axes": self.axes}

    def load(self, arrays: dict[str, npt.NDArray[np.generic]]) -> None:
        """Take over what ``arrays`` gave."""
        self.axes = np.array(arrays["axes"], dtype=float)
