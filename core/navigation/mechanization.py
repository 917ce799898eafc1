"""Strapdown mechanisation of one epoch in n, on plain scalars so that it compiles to straight code.

Groves 2013, sec. 5.4, with the Earth's and the frame's slow terms held over 0.1 s (at 40 m/s they change
by 1e-9 rad/s in that time).
"""

from __future__ import annotations

import math

import numpy as np

from core.compiled import compiled
from core.earth import EARTH_RATE_RADPS, gravity_mps2, radii_m
from core.measurements import FloatArray, TimeArray
from core.navigation.state import (
    T_FOLD,
    T_NOW,
    X_ALT,
    X_DR,
    X_G,
    X_LAT,
    X_LON,
    X_M_PER_RAD,
    X_MOUNT_PITCH,
    X_MOUNT_SC,
    X_MOUNT_YAW,
    X_Q,
    X_V,
    X_WIN,
)


@compiled(inline="always")
def matrix_of(w, x, y, z):  # type: ignore[no-untyped-def]
    """The nine elements of C_n_from_b, row by row, of a unit quaternion."""
    return (
        1.0 - 2.0 * (y * y + z * z),
        2.0 * (x * y - w * z),
        2.0 * (x * z + w * y),
        2.0 * (x * y + w * z),
        1.0 - 2.0 * (x * x + z * z),
        2.0 * (y * z - w * x),
        2.0 * (x * z - w * y),
        2.0 * (y * z + w * x),
        1.0 - 2.0 * (x * x + y * y),
    )


@compiled(inline="always")
def turned(w, x, y, z, ax, ay, az):  # type: ignore[no-untyped-def]
    """Quaternion (w, x, y, z) followed by the body rotation vector (ax, ay, az), rad.

    Fifth-order series of the half angle: exact to 1e-12 for a tenth of a radian. ``fold_position``
    brings the norm back to one ten times a second.
    """
    hx, hy, hz = 0.5 * ax, 0.5 * ay, 0.5 * az
    m = hx * hx + hy * hy + hz * hz
    c = 1.0 - m * (0.5 - m * (1.0 / 24.0))
    s = 1.0 - m * (1.0 / 6.0 - m * (1.0 / 120.0))
    hx, hy, hz = hx * s, hy * s, hz * s
    return (
        w * c - x * hx - y * hy - z * hz,
        w * hx + x * c + y * hz - z * hy,
        w * hy - x * hz + y * c + z * hx,
        w * hz + x * hy - y * hx + z * c,
    )


@compiled()
def fold_position(x: FloatArray, ti: TimeArray) -> None:
    """Bring latitude, longitude, height and the frame's slow terms up to ``ti[T_NOW]``.

    Moves the metres of ``x[X_DR]`` into the geodetic position, turns the attitude back by the rotation
    of n against i since the last fold, and renews gravity, Coriolis and that rotation's rate.
    """
    x[X_LAT] += x[X_DR] / x[X_M_PER_RAD]
    lon = x[X_LON] + x[X_DR + 1] / x[X_M_PER_RAD + 1]
    if lon >= math.pi:
        lon -= 2.0 * math.pi
    elif lon < -math.pi:
        lon += 2.0 * math.pi
    x[X_LON] = lon
    x[X_ALT] -= x[X_DR + 2]
    x[X_DR], x[X_DR + 1], x[X_DR + 2] = 0.0, 0.0, 0.0

    dt = (ti[T_NOW] - ti[T_FOLD]) * 1e-9
    ti[T_FOLD] = ti[T_NOW]
    # q_n_from_b <- exp(-omega_in dt / 2) q, to first order: the angle is below 1e-5 rad.
    hx, hy, hz = -0.5 * x[X_WIN] * dt, -0.5 * x[X_WIN + 1] * dt, -0.5 * x[X_WIN + 2] * dt
    w, qx, qy, qz = x[X_Q], x[X_Q + 1], x[X_Q + 2], x[X_Q + 3]
    nw = w - hx * qx - hy * qy - hz * qz
    nx = qx + hx * w + hy * qz - hz * qy
    ny = qy - hx * qz + hy * w + hz * qx
    nz = qz + hx * qy - hy * qx + hz * w
    k = 1.0 / math.sqrt(nw * nw + nx * nx + ny * ny + nz * nz)
    x[X_Q], x[X_Q + 1], x[X_Q + 2], x[X_Q + 3] = nw * k, nx * k, ny * k, nz * k

    s, c = math.sin(x[X_LAT]), math.cos(x[X_LAT])
    meridian, transverse = radii_m(x[X_LAT])
    x[X_M_PER_RAD], x[X_M_PER_RAD + 1] = meridian + x[X_ALT], (transverse + x[X_ALT]) * c
    vn, ve, vd = x[X_V], x[X_V + 1], x[X_V + 2]
    ie_n, ie_d = EARTH_RATE_RADPS * c, -EARTH_RATE_RADPS * s
    en_n = ve / (transverse + x[X_ALT])
    en_e = -vn / (meridian + x[X_ALT])
    en_d = -en_n * s / max(c, 1e-6)
    x[X_WIN], x[X_WIN + 1], x[X_WIN + 2] = ie_n + en_n, en_e, ie_d + en_d
    an, ae, ad = 2.0 * ie_n + en_n, en_e, 2.0 * ie_d + en_d
    x[X_G] = -(ae * vd - ad * ve)
    x[X_G + 1] = -(ad * vn - an * vd)
    x[X_G + 2] = gravity_mps2(x[X_LAT], x[X_ALT]) - (an * ve - ae * vn)


def start_frame(x: FloatArray, ti: TimeArray) -> None:
    """Fill the slow terms of a freshly set state."""
    x[X_DR : X_DR + 3] = 0.0
    x[X_WIN : X_WIN + 3] = 0.0
    x[X_M_PER_RAD : X_M_PER_RAD + 2] = 1.0
    ti[T_FOLD] = ti[T_NOW]
    fold_position(x, ti)
    renew_mounting(x)


@compiled()
def renew_mounting(x: FloatArray) -> None:
    """Sines and cosines of the mounting's angles, which ``turn_mounting`` carries on in between."""
    x[X_MOUNT_SC], x[X_MOUNT_SC + 1] = math.sin(x[X_MOUNT_PITCH]), math.cos(x[X_MOUNT_PITCH])
    x[X_MOUNT_SC + 2], x[X_MOUNT_SC + 3] = math.sin(x[X_MOUNT_YAW]), math.cos(x[X_MOUNT_YAW])


@compiled()
def turn_mounting(x: FloatArray, pitch_rad: float, yaw_rad: float) -> None:
    """Add small angles to the mounting, to second order in its sines and cosines."""
    x[X_MOUNT_PITCH] += pitch_rad
    x[X_MOUNT_YAW] += yaw_rad
    s, c = x[X_MOUNT_SC], x[X_MOUNT_SC + 1]
    x[X_MOUNT_SC] = s + pitch_rad * (c - 0.5 * pitch_rad * s)
    x[X_MOUNT_SC + 1] = c - pitch_rad * (s + 0.5 * pitch_rad * c)
    s, c = x[X_MOUNT_SC + 2], x[X_MOUNT_SC + 3]
    x[X_MOUNT_SC + 2] = s + yaw_rad * (c - 0.5 * yaw_rad * s)
    x[X_MOUNT_SC + 3] = c - yaw_rad * (s + 0.5 * yaw_rad * c)


def normalised(q: FloatArray) -> FloatArray:
    """Quaternion (4,) of unit length with w >= 0."""
    q = q / np.sqrt(np.sum(q * q))
    return q if q[0] >= 0 else -q
