"""Samples of a span besides the inertial ones, and what they are counted as."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

import numpy as np

from core.measurements import FloatArray, TimeArray
from core.navigation import state

Series = tuple[TimeArray, FloatArray]
"""Times (n,), ns, and a value or a row for each, (n,) or (n, columns)."""

AIDS_OF_KIND: Final = {
    state.K_GNSS: (state.A_POSITION, state.A_HEIGHT, state.A_VELOCITY),
    state.K_SPEED: (state.A_SPEED,),
    state.K_MAGNETIC: (state.A_MAGNETOMETER,),
    state.K_BARO: (state.A_BAROMETER,),
}
"""What a row of each kind is counted and recorded as; the first stands for the whole."""


def no_series(columns: int | None = None) -> Series:
    """A series without samples: of single values, or of rows."""
    return np.empty(0, np.int64), np.empty(0) if columns is None else np.empty((0, columns))


@dataclass(frozen=True, slots=True, eq=False)
class Aids:
    """Each a pair of times and rows, vectors in body axes; what a vehicle has not stays empty.

    Parameters
    ----------
    gnss : rows of ``core.measurements.GNSS_COLUMNS``
    magnetic_b_ut : (n, 3), microtesla
    speed : (n,) of the wheels, m/s
    pressure_pa : (n,) of the air
    """

    gnss: Series
    magnetic_b_ut: Series = field(default_factory=lambda: no_series(3))
    speed: Series = field(default_factory=no_series)
    pressure_pa: Series = field(default_factory=no_series)
