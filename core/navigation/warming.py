"""How fast the box's temperature changes, where packets state it: the biases of its sensors walk with it.

Where they do not, the biases tell (``found_warming``).
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import numpy.typing as npt

STEP_K: Final = 1.0
"""A change of temperature below this is not told from a thermometer's own steps, K, 0.1 to 5. Of those in MEMS
sensors, 1 K is a usual step."""

_T, _TEMPERATURE, _RATE = range(3)


class Warming:
    """Folds readings of the box's temperature into a rate; ``state`` is time (s), temperature (deg C), rate (K/s)."""

    def __init__(self) -> None:
        self.state: npt.NDArray[np.float64] = np.array([0.0, math.nan, 0.0])

    @property
    def rate_kps(self) -> float:
        """Size of the rate, K/s; 0 where nothing is known of it."""
        return float(self.state[_RATE])

    def step(self, t_ns: int, temperature_c: float) -> None:
        """A reading at a time later than those before; NaN for none.

        The rate is that of the last whole step, and no more than one step since.
        """
        if not math.isfinite(temperature_c):
            return
        since_s = t_ns * 1e-9 - self.state[_T]
        change_k = abs(temperature_c - self.state[_TEMPERATURE])
        if math.isnan(change_k) or since_s <= 0.0:
            self.state[:] = t_ns * 1e-9, temperature_c, 0.0
        elif change_k >= STEP_K:
            self.state[:] = t_ns * 1e-9, temperature_c, change_k / since_s
        else:
            self.state[_RATE] = min(self.state[_RATE], STEP_K / since_s)

    def arrays(self) -> dict[str, npt.NDArray[np.generic]]:
        """State by name, for snapshots."""
        return {"state": self.state}

    def load(self, arrays: dict[str, npt.NDArray[np.generic]]) -> None:
        """Take over what ``arrays`` gave."""
        self.state = np.array(arrays["state"], dtype=float)
