"""Height from air pressure by the standard atmosphere, and back (ICAO Doc 7488/3; ISO 2533:1975)."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numba import njit

from core.earth import STANDARD_GRAVITY_MPS2
from core.measurements import FloatArray

SEA_LEVEL_PRESSURE_PA: Final = 101_325.0
"""Of the standard atmosphere (ISO 2533:1975, table 1), Pa."""
SEA_LEVEL_TEMPERATURE_K: Final = 288.15
LAPSE_RATE_KPM: Final = 0.0065
"""Fall of temperature with height in the troposphere, up to 11 km, K/m."""
AIR_GAS_CONSTANT_JPKGK: Final = 287.05287
"""Specific gas constant of dry air (ISO 2533:1975), J/(kg K)."""

PRESSURE_RANGE_PA: Final = (30_000.0, 110_000.0)
"""What barometers of boxes measure (BMP280 data sheet, 300 to 1100 hPa): 9.2 km down to 0.7 km below the sea."""

_EXPONENT: Final = STANDARD_GRAVITY_MPS2 / (AIR_GAS_CONSTANT_JPKGK * LAPSE_RATE_KPM)


@njit(cache=True, nogil=True)
def pressure_height_m(pressure_pa: FloatArray) -> FloatArray:
    """Heights (n,) at which the standard atmosphere has the pressures (n,) in Pa, geopotential m.

    It is the height above the sea only on a standard day: 1 hPa of weather shifts it by 8.4 m, and each 2.9 K
    that the air is warmer than standard makes height differences 1 % too small. It is neither ellipsoidal nor
    geometric; the difference is nearly constant over a drive. So a filter carries a bias beside it.
    NaN where a pressure is not above 0. Valid below 11 km (22 632 Pa).
    """
    height_m = np.empty(pressure_pa.shape[0])
    for k in range(pressure_pa.shape[0]):
        height_m[k] = math.nan
        if pressure_pa[k] > 0.0:
            ratio = (pressure_pa[k] / SEA_LEVEL_PRESSURE_PA) ** (1.0 / _EXPONENT)
            height_m[k] = SEA_LEVEL_TEMPERATURE_K / LAPSE_RATE_KPM * (1.0 - ratio)
    return height_m


def standard_pressure_pa(height_m: FloatArray) -> FloatArray:
    """Pressure of the standard atmosphere at geopotential heights (n,), Pa: the inverse of ``pressure_height_m``."""
    ratio = 1.0 - LAPSE_RATE_KPM * np.asarray(height_m, dtype=float) / SEA_LEVEL_TEMPERATURE_K
    return np.asarray(SEA_LEVEL_PRESSURE_PA * ratio**_EXPONENT)


def standard_density_kgpm3(height_m: FloatArray) -> FloatArray:
    """Density of the standard atmosphere at geopotential heights (n,), kg/m3."""
    temperature_k = SEA_LEVEL_TEMPERATURE_K - LAPSE_RATE_KPM * np.asarray(height_m, dtype=float)
    return standard_pressure_pa(height_m) / (AIR_GAS_CONSTANT_JPKGK * temperature_k)
