"""Pressure and height against the printed tables of the standard atmosphere."""

from __future__ import annotations

import math

import numpy as np
import pytest

from core.atmosphere import PRESSURE_RANGE_PA, pressure_height_m, standard_density_kgpm3, standard_pressure_pa

# ISO 2533:1975, table 5 (the same as ICAO Doc 7488/3 and US Standard Atmosphere 1976 below 11 km):
# geopotential height (m), pressure (Pa), density (kg/m3).
TABLE = [
    (-500.0, 107_478.0, 1.2849),
    (0.0, 101_325.0, 1.2250),
    (500.0, 95_460.8, 1.1673),
    (1000.0, 89_874.6, 1.1116),
    (2000.0, 79_495.2, 1.0065),
    (3000.0, 70_108.5, 0.90912),
    (5000.0, 54_019.9, 0.73612),
    (8000.0, 35_599.8, 0.52517),
    (11_000.0, 22_632.1, 0.36392),
]


@pytest.mark.parametrize(("height_m", "pressure_pa", "density_kgpm3"), TABLE)
def test_heights_and_pressures_are_those_of_the_table(
    height_m: float, pressure_pa: float, density_kgpm3: float
) -> None:
    # Half a unit of the table's sixth digit is 0.05 Pa, or 0.5 Pa of -500 m's; of a height that is 2 to 4 cm.
    assert standard_pressure_pa(np.array([height_m]))[0] == pytest.approx(pressure_pa, abs=0.5)
    assert pressure_height_m(np.array([pressure_pa]))[0] == pytest.approx(height_m, abs=0.05)
    assert standard_density_kgpm3(np.array([height_m]))[0] == pytest.approx(density_kgpm3, rel=1e-4)


def test_there_and_back() -> None:
    pressure_pa = np.linspace(*PRESSURE_RANGE_PA, 500)
    # The rounding of doubles at 1e5, through two powers.
    np.testing.assert_allclose(standard_pressure_pa(pressure_height_m(pressure_pa)), pressure_pa, rtol=1e-14 * 10)


def test_what_is_no_pressure_has_no_height() -> None:
    assert np.isnan(pressure_height_m(np.array([0.0, -1.0, math.nan]))).all()
    assert pressure_height_m(np.empty(0)).shape == (0,)


def test_a_hectopascal_near_the_sea_is_eight_metres() -> None:
    low, high = pressure_height_m(np.array([101_375.0, 101_275.0]))
    assert high - low == pytest.approx(8.32, abs=0.01)  # R T / g over p: 8434.5 m / 1013.25
