"""WGS-84: radii of curvature, normal gravity, Earth rate and conversions (Groves 2013, ch. 2)."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numba import njit

from core.measurements import FloatArray

SEMI_MAJOR_M: Final = 6378137.0
"""Equatorial radius, m (NIMA TR8350.2)."""
FLATTENING: Final = 1.0 / 298.257223563
ECCENTRICITY_SQ: Final = FLATTENING * (2.0 - FLATTENING)
EARTH_RATE_RADPS: Final = 7.292115e-5
"""Rotation rate of the Earth, rad/s (NIMA TR8350.2)."""
GM_M3PS2: Final = 3.986004418e14
STANDARD_GRAVITY_MPS2: Final = 9.80665


@njit(cache=True, nogil=True)
def radii_m(lat_rad: float) -> tuple[float, float]:
    """Meridian and transverse radii of curvature at a latitude, m (Groves eq. 2.105, 2.106)."""
    s = math.sin(lat_rad)
    w = 1.0 - ECCENTRICITY_SQ * s * s
    root = math.sqrt(w)
    return SEMI_MAJOR_M * (1.0 - ECCENTRICITY_SQ) / (w * root), SEMI_MAJOR_M / root


@njit(cache=True, nogil=True)
def gravity_mps2(lat_rad: float, alt_m: float) -> float:
    """Normal gravity at geodetic latitude and ellipsoidal height, m/s2 (Somigliana; Groves eq. 2.134, 2.139)."""
    s2 = math.sin(lat_rad) ** 2
    at_ellipsoid = 9.7803253359 * (1.0 + 0.001931853 * s2) / math.sqrt(1.0 - ECCENTRICITY_SQ * s2)
    polar_m = SEMI_MAJOR_M * (1.0 - FLATTENING)
    m = EARTH_RATE_RADPS**2 * SEMI_MAJOR_M**2 * polar_m / GM_M3PS2
    linear = 2.0 / SEMI_MAJOR_M * (1.0 + FLATTENING * (1.0 - 2.0 * s2) + m)
    return float(at_ellipsoid * (1.0 - linear * alt_m + 3.0 * alt_m * alt_m / SEMI_MAJOR_M**2))


def ned_offset_m(
    lat_rad: FloatArray, lon_rad: FloatArray, alt_m: FloatArray, origin: tuple[float, float, float]
) -> FloatArray:
    """North, east, down of points against an origin, along the curvature at the origin.

    Differs from a tangent plane by about d^2 / R, times tan(latitude) where meridians meet: a millimetre over
    60 m, 0.2 m over a kilometre. So it compares estimates of one position; it maps no whole drives.

    Parameters
    ----------
    lat_rad, lon_rad, alt_m : (n,) arrays
    origin : latitude (rad), longitude (rad), ellipsoidal height (m)

    Returns
    -------
    (n, 3) array, m
    """
    lat0, lon0, alt0 = origin
    meridian, transverse = radii_m(lat0)
    d_lon = np.mod(np.asarray(lon_rad) - lon0 + np.pi, 2 * np.pi) - np.pi
    return np.stack(
        [
            (np.asarray(lat_rad) - lat0) * (meridian + alt0),
            d_lon * (transverse + alt0) * math.cos(lat0),
            alt0 - np.asarray(alt_m),
        ],
        axis=-1,
    )


def horizontal_distance_m(
    lat_a_rad: FloatArray, lon_a_rad: FloatArray, lat_b_rad: FloatArray, lon_b_rad: FloatArray
) -> FloatArray:
    """Distance between pairs of near points (under some 10 km), m, at the ellipsoid's surface."""
    lat_a, lat_b = np.asarray(lat_a_rad, dtype=float), np.asarray(lat_b_rad, dtype=float)
    mid = 0.5 * (lat_a + lat_b)
    w = 1.0 - ECCENTRICITY_SQ * np.sin(mid) ** 2
    meridian = SEMI_MAJOR_M * (1.0 - ECCENTRICITY_SQ) / w**1.5
    transverse = SEMI_MAJOR_M / np.sqrt(w)
    d_lon = np.mod(np.asarray(lon_b_rad) - np.asarray(lon_a_rad) + np.pi, 2 * np.pi) - np.pi
    return np.asarray(np.hypot((lat_b - lat_a) * meridian, d_lon * transverse * np.cos(mid)))


@njit(cache=True, nogil=True)
def ecef_from_geodetic(lat_rad: float, lon_rad: float, alt_m: float) -> tuple[float, float, float]:
    """Earth-centred Earth-fixed x, y, z of a point, m (Groves eq. 2.112)."""
    transverse = radii_m(lat_rad)[1]
    from_axis = (transverse + alt_m) * math.cos(lat_rad)
    z = ((1.0 - ECCENTRICITY_SQ) * transverse + alt_m) * math.sin(lat_rad)
    return from_axis * math.cos(lon_rad), from_axis * math.sin(lon_rad), z


@njit(cache=True, nogil=True)
def geodetic_from_ecef(x_m: float, y_m: float, z_m: float) -> tuple[float, float, float]:
    """Latitude (rad), longitude (rad), ellipsoidal height (m) of a point, not at the poles.

    By iteration of the parametric latitude (Bowring 1976): within 10 km of the surface the second one is exact
    to below a nanometre.
    """
    from_axis = math.hypot(x_m, y_m)
    polar_m = SEMI_MAJOR_M * (1.0 - FLATTENING)
    tan_parametric = z_m * SEMI_MAJOR_M / (from_axis * polar_m)
    tan_lat = 0.0
    for _ in range(2):
        cos = 1.0 / math.sqrt(1.0 + tan_parametric * tan_parametric)
        sin = tan_parametric * cos
        tan_lat = (z_m + ECCENTRICITY_SQ / (1.0 - ECCENTRICITY_SQ) * polar_m * sin**3) / (
            from_axis - ECCENTRICITY_SQ * SEMI_MAJOR_M * cos**3
        )
        tan_parametric = (1.0 - FLATTENING) * tan_lat
    lat = math.atan(tan_lat)
    alt = from_axis * math.cos(lat) + z_m * math.sin(lat) - SEMI_MAJOR_M**2 / radii_m(lat)[1]
    return lat, math.atan2(y_m, x_m), alt


@njit(cache=True, nogil=True)
def matrix_e_from_n(lat_rad: float, lon_rad: float) -> FloatArray:
    """Rotation (3, 3) from north-east-down at a point to the Earth-centred frame (Groves eq. 2.150, transposed)."""
    sin_lat, cos_lat = math.sin(lat_rad), math.cos(lat_rad)
    sin_lon, cos_lon = math.sin(lon_rad), math.cos(lon_rad)
    c = np.empty((3, 3))
    c[0, 0], c[0, 1], c[0, 2] = -sin_lat * cos_lon, -sin_lon, -cos_lat * cos_lon
    c[1, 0], c[1, 1], c[1, 2] = -sin_lat * sin_lon, cos_lon, -cos_lat * sin_lon
    c[2, 0], c[2, 1], c[2, 2] = cos_lat, 0.0, -sin_lat
    return c
