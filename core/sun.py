"""Where the sun stands: elevation by NOAA's solar equations (Meeus, *Astronomical Algorithms*, ch. 25)."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from core.measurements import FloatArray, TimeArray

SUNSET_RAD: Final = math.radians(-0.833)
"""Elevation of the sun's centre when its upper limb sets: half a disc and refraction (US Naval Observatory)."""
CIVIL_DUSK_RAD: Final = math.radians(-6.0)
"""End of civil twilight; from there on it is night."""

_J2000_NS: Final = 946_728_000_000_000_000
"""2000-01-01T12:00:00Z in UTC nanoseconds."""
_CENTURY_S: Final = 36525.0 * 86400.0
_DAY_NS: Final = 86_400_000_000_000


def solar_elevation_rad(t_ns: TimeArray, lat_rad: FloatArray, lon_rad: FloatArray) -> FloatArray:
    """Elevation of the sun's centre above the horizon, (n,) rad; without refraction.

    Good to 0.01 degree from 1950 to 2050, which is 3 s of time.

    Parameters
    ----------
    t_ns : (n,) UTC ns
    lat_rad, lon_rad : (n,) geodetic latitude and longitude
    """
    century = (t_ns - _J2000_NS) * 1e-9 / _CENTURY_S
    longitude = np.radians(280.46646 + century * (36000.76983 + century * 0.0003032))
    anomaly = np.radians(357.52911 + century * (35999.05029 - century * 0.0001537))
    eccentricity = 0.016708634 - century * (0.000042037 + century * 0.0000001267)
    centre = np.radians(
        np.sin(anomaly) * (1.914602 - century * (0.004817 + century * 0.000014))
        + np.sin(2.0 * anomaly) * (0.019993 - century * 0.000101)
        + np.sin(3.0 * anomaly) * 0.000289
    )
    node = np.radians(125.04 - 1934.136 * century)
    apparent = longitude + centre - np.radians(0.00569 + 0.00478 * np.sin(node))
    obliquity = np.radians(23.439291 - 0.0130042 * century + 0.00256 * np.cos(node))
    declination = np.arcsin(np.sin(obliquity) * np.sin(apparent))
    y = np.tan(obliquity / 2.0) ** 2
    equation_of_time = (
        y * np.sin(2.0 * longitude)
        - 2.0 * eccentricity * np.sin(anomaly)
        + 4.0 * eccentricity * y * np.sin(anomaly) * np.cos(2.0 * longitude)
        - 0.5 * y * y * np.sin(4.0 * longitude)
        - 1.25 * eccentricity**2 * np.sin(2.0 * anomaly)
    )
    of_day = (t_ns % _DAY_NS) / _DAY_NS * 2.0 * np.pi
    hour_angle = of_day - np.pi + lon_rad + equation_of_time
    sine = np.sin(lat_rad) * np.sin(declination) + np.cos(lat_rad) * np.cos(declination) * np.cos(hour_angle)
    return np.asarray(np.arcsin(np.clip(sine, -1.0, 1.0)))
