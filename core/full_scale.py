"""Where an accelerometer's range ends: as stated, or found where nothing is stated or the statement is exceeded.

What clipped lies between two equal ends; taken for what was felt, a blow would be told many times too weak and sure.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import numpy.typing as npt
from numba import njit

from core.earth import STANDARD_GRAVITY_MPS2
from core.measurements import FloatArray

SATURATION_SHARE: Final = 0.995
"""A sample at or above this share of the full scale is taken as clipped: scale errors stay below 0.5 %."""

EXCEEDED_SHARE: Final = 1.02
"""A reading beyond this share of a stated full scale, 1.005 to 1.2, shows that it is none. A choice."""

RANGES_G: Final = (2.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0, 30.0, 32.0, 48.0, 64.0, 100.0, 200.0, 400.0)
"""Ranges that accelerometers are sold with."""

NOMINAL_SHARE: Final = 1e-4
"""A reading so near a range's end is its end, 3e-5 (a count of 16 bits) to 1e-3; one by chance matters little."""

FLAT_MPS2: Final = 1.5 * STANDARD_GRAVITY_MPS2
"""Below this nothing is an end, 1.1 to 1.9 g. A choice: under the least range sold, above a box at rest."""

FLAT_NEAR, FLAT_ANY = 2, 3
"""So many equal readings on end are an end near a range's, and anywhere. A choice: coarse sensors repeat a peak's."""

_END_POSITIVE, _END_NEGATIVE, _LAST, _RUN = range(4)
"""Of each axis: the ends found, infinite until then, its last reading, and how often that has come on end."""


@njit(cache=True, nogil=True)
def _nominal(size: float, share: float) -> bool:
    off_mps2 = math.inf
    for range_g in RANGES_G:
        off_mps2 = min(off_mps2, abs(size - range_g * STANDARD_GRAVITY_MPS2))
    return off_mps2 <= share * size


@njit(cache=True, nogil=True)
def _found(forces: FloatArray, axes: FloatArray, clipped: FloatArray) -> None:
    """Go through the readings (n, 3) of axes that are (3, 4); ``clipped`` (n,) is set where one is at its end."""
    for k in range(forces.shape[0]):
        for i in range(3):
            value, axis = forces[k, i], axes[i]
            size, side = abs(value), _END_POSITIVE if value > 0.0 else _END_NEGATIVE
            axis[_RUN] = axis[_RUN] + 1.0 if value == axis[_LAST] else 1.0
            axis[_LAST] = value
            if size * SATURATION_SHARE > axis[side]:
                axis[side] = math.inf
            if size < FLAT_MPS2:
                continue
            if axis[_RUN] >= (FLAT_NEAR if _nominal(size, 1.0 - SATURATION_SHARE) else FLAT_ANY):
                axis[side] = size
            if size >= SATURATION_SHARE * axis[side] or _nominal(size, NOMINAL_SHARE):
                clipped[k] = 1.0


@njit(cache=True, nogil=True)
def _first_beyond(forces: FloatArray, limit: float) -> int:
    count: int = forces.shape[0]
    for k in range(count):
        if abs(forces[k, 0]) > limit or abs(forces[k, 1]) > limit or abs(forces[k, 2]) > limit:
            return k
    return count


@njit(cache=True, nogil=True)
def _at_end(forces: FloatArray, limit: float, clipped: FloatArray) -> None:
    for k in range(forces.shape[0]):
        if abs(forces[k, 0]) >= limit or abs(forces[k, 1]) >= limit or abs(forces[k, 2]) >= limit:
            clipped[k] = 1.0


class FullScale:
    """Tells the samples that clipped; state is its arrays."""

    def __init__(self) -> None:
        self.axes: FloatArray = np.zeros((3, 4))
        self.axes[:, : _END_NEGATIVE + 1] = math.inf
        self.exceeded = np.zeros(1)
        """The greatest statement that was exceeded, m/s2: it and less is believed no longer."""

    def step(self, forces: FloatArray, stated_mps2: float) -> FloatArray:
        """1 where any axis of (n, 3) readings, m/s2 in sensor axes, is at its end, (n,); NaN states no full scale."""
        forces, clipped = np.ascontiguousarray(forces), np.zeros(forces.shape[0])
        believed = 0
        if stated_mps2 > self.exceeded[0]:
            believed = _first_beyond(forces, EXCEEDED_SHARE * stated_mps2)
            _at_end(forces[:believed], SATURATION_SHARE * stated_mps2, clipped)
            if believed < forces.shape[0]:
                self.exceeded[0] = stated_mps2
        _found(forces[believed:], self.axes, clipped[believed:])
        return clipped

    def arrays(self) -> dict[str, npt.NDArray[np.generic]]:
        """State by name, for snapshots."""
        return {"axes": self.axes, "exceeded": self.exceeded}

    def load(self, arrays: dict[str, npt.NDArray[np.generic]]) -> None:
        """Take over what ``arrays`` gave."""
        self.axes = np.array(arrays["axes"], dtype=float)
        self.exceeded = np.array(arrays["exceeded"], dtype=float)
