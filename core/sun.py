"""Where the sun stands: what makes night."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from core.measurements import FloatArray, TimeArray

SUNSET_RAD: Final = math.radians(-0.833)
"""Elevation of the sun's centre when its upper limb sets: half a disc and refraction (US Naval Observatory)."""
CIVIL_DUSK_RAD: Final = math.radians(-6.0)
"""End of civil twilight; from there on it is night."""

_J2000_NS: Final = 946_728_000_000_000_000  # 2000-01-01 12:00 UTC
_DAY_NS: Final = 86_400_000_000_000


def sun_elevation_rad(t_ns: TimeArray, lat_rad: FloatArray, lon_rad: FloatArray) -> FloatArray:
    """Elevation of the sun's centre above the horizon, without refraction, rad.

    Parameters
    ----------
    t_ns : (n,) UTC, ns
    lat_rad, lon_rad : (n,) geodetic

    Notes
    -----
    The Astronomical Almanac's low-precision formulas, 0.01 degrees from 1950 to 2050 (Michalsky 1988, *The
    Astronomical Almanac's algorithm for approximate solar position*, Solar Energy 40).
    """
    days = (t_ns - _J2000_NS) / _DAY_NS
    mean_longitude = np.radians((280.460 + 0.9856474 * days) % 360.0)
    anomaly = np.radians((357.528 + 0.9856003 * days) % 360.0)
    longitude = mean_longitude + np.radians(1.915) * np.sin(anomaly) + np.radians(0.020) * np.sin(2.0 * anomaly)
    obliquity = np.radians(23.439 - 4e-7 * days)
    right_ascension = np.arctan2(np.cos(obliquity) * np.sin(longitude), np.cos(longitude))
    declination = np.arcsin(np.sin(obliquity) * np.sin(longitude))
    hours = ((t_ns - _J2000_NS + _DAY_NS // 2) % _DAY_NS) / (_DAY_NS / 24)
    sidereal_rad = np.radians(15.0 * ((6.697375 + 0.0657098242 * days + hours) % 24.0))
    hour_angle = sidereal_rad + lon_rad - right_ascension
    sine = np.sin(declination) * np.sin(lat_rad) + np.cos(declination) * np.cos(lat_rad) * np.cos(hour_angle)
    return np.asarray(np.arcsin(np.clip(sine, -1.0, 1.0)))
