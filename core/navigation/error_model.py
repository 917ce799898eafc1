"""Propagation of the error covariance over one interval: structured blocks, nothing dense.

Error states as in ``state``. Left out, with their size for a car: the change of gravity with height
(3e-6 m/s2 a metre), Coriolis on a velocity error (1.5e-4 m/s2 a m/s), rotation of n on an attitude error
(7e-5 rad/s a rad): each two orders below the bias noise. Groves 2013, sec. 14.2.4.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numba import njit

from core.measurements import FloatArray
from core.navigation.kalman import Nine
from core.navigation.state import ACCEL_BIAS, ATT, GYRO_BIAS, GYRO_SCALE, N_STATES, POS, VEL
from core.rotation import skew

N_MOVING: Final = 9
"""Position, velocity and attitude: the errors that change with time by themselves."""

TransitionRow = tuple[float, float, float, float, float, float]
BiasRow = tuple[float, float, float]


@njit(cache=True, nogil=True)
def _position_row(p: FloatArray, m: FloatArray, n: int, i: int, dt: float, k: TransitionRow) -> None:
    """Row i of Phi P for a position error: velocity by dt, attitude and accelerometer bias by dt^2 / 2."""
    a0, a1, a2, b0, b1, b2 = k
    r, v, at, ba = (POS + i) * n, (VEL + i) * n, ATT * n, ACCEL_BIAS * n
    for j in range(n):
        m[r + j] = (
            p[r + j]
            + dt * p[v + j]
            + (a0 * p[at + j] + a1 * p[at + n + j] + a2 * p[at + 2 * n + j])
            + (b0 * p[ba + j] + b1 * p[ba + n + j] + b2 * p[ba + 2 * n + j])
        )


@njit(cache=True, nogil=True)
def _velocity_row(p: FloatArray, m: FloatArray, n: int, i: int, k: TransitionRow, g: BiasRow, s: float) -> None:
    """Row i of Phi P for a velocity error: attitude, accelerometer bias; gyroscope bias and scale by dt^2 / 2."""
    a0, a1, a2, b0, b1, b2 = k
    g0, g1, g2 = g
    v, at, ba, bg, gs = (VEL + i) * n, ATT * n, ACCEL_BIAS * n, GYRO_BIAS * n, GYRO_SCALE * n
    for j in range(n):
        m[v + j] = (
            p[v + j]
            + (a0 * p[at + j] + a1 * p[at + n + j] + a2 * p[at + 2 * n + j])
            + (b0 * p[ba + j] + b1 * p[ba + n + j] + b2 * p[ba + 2 * n + j])
            + (g0 * p[bg + j] + g1 * p[bg + n + j] + g2 * p[bg + 2 * n + j] + s * p[gs + j])
        )


@njit(cache=True, nogil=True)
def _attitude_row(p: FloatArray, m: FloatArray, n: int, i: int, g: BiasRow, s: float) -> None:
    """Row i of Phi P for an attitude error: gyroscope bias by dt, gyroscope scale by the turn."""
    g0, g1, g2 = g
    at, bg, gs = (ATT + i) * n, GYRO_BIAS * n, GYRO_SCALE * n
    for j in range(n):
        m[at + j] = p[at + j] + (g0 * p[bg + j] + g1 * p[bg + n + j] + g2 * p[bg + 2 * n + j] + s * p[gs + j])


@njit(cache=True, nogil=True)
def propagate(
    p: FloatArray, m: FloatArray, n: int, dt: float, dv: BiasRow, c: Nine, turn: float, q: FloatArray
) -> None:
    """P <- Phi P Phi' + Q in place.

    Phi touches the nine rows of position, velocity and attitude only, so the blocks of the slow states
    are M = Phi P as it is, and only the nine by nine block needs the second product.

    Parameters
    ----------
    p, m : (n*n,) covariance, and scratch of the same size
    dt : s
    dv : integral of the specific force in n over the interval, m/s
    c : mean C_n_from_b over the interval, by rows
    turn : integral of the rate about b's z axis over the interval, rad
    q : (n,) variances that the interval adds
    """
    half = 0.5 * dt
    fn, fe, fd = dv
    # -[f x], by rows, and -C dt: attitude and accelerometer bias into velocity.
    bn, be, bd = (-dt * c[0], -dt * c[1], -dt * c[2]), (-dt * c[3], -dt * c[4], -dt * c[5]), (
        -dt * c[6], -dt * c[7], -dt * c[8])  # fmt: skip
    # +[f x] C dt / 2: gyroscope bias into velocity, by rows.
    gn = (half * (fe * c[6] - fd * c[3]), half * (fe * c[7] - fd * c[4]), half * (fe * c[8] - fd * c[5]))
    ge = (half * (fd * c[0] - fn * c[6]), half * (fd * c[1] - fn * c[7]), half * (fd * c[2] - fn * c[8]))
    gd = (half * (fn * c[3] - fe * c[0]), half * (fn * c[4] - fe * c[1]), half * (fn * c[5] - fe * c[2]))
    # Gyroscope scale: C e_z turn into attitude, and -[f x] C e_z turn dt / 2 into velocity.
    tn, te, td = turn * c[2], turn * c[5], turn * c[8]
    sn, se, sd = -0.5 * (fe * td - fd * te), -0.5 * (fd * tn - fn * td), -0.5 * (fn * te - fe * tn)
    vn = (0.0, fd, -fe, bn[0], bn[1], bn[2])
    ve = (-fd, 0.0, fn, be[0], be[1], be[2])
    vd = (fe, -fn, 0.0, bd[0], bd[1], bd[2])
    rn = (0.0, half * fd, -half * fe, half * bn[0], half * bn[1], half * bn[2])
    re = (-half * fd, 0.0, half * fn, half * be[0], half * be[1], half * be[2])
    rd = (half * fe, -half * fn, 0.0, half * bd[0], half * bd[1], half * bd[2])

    _position_row(p, m, n, 0, dt, rn)
    _position_row(p, m, n, 1, dt, re)
    _position_row(p, m, n, 2, dt, rd)
    _velocity_row(p, m, n, 0, vn, gn, sn)
    _velocity_row(p, m, n, 1, ve, ge, se)
    _velocity_row(p, m, n, 2, vd, gd, sd)
    _attitude_row(p, m, n, 0, bn, tn)
    _attitude_row(p, m, n, 1, be, te)
    _attitude_row(p, m, n, 2, bd, td)

    for i in range(N_MOVING):
        row = i * n
        v0, v1, v2 = m[row + VEL], m[row + VEL + 1], m[row + VEL + 2]
        t0, t1, t2 = m[row + ATT], m[row + ATT + 1], m[row + ATT + 2]
        w0, w1, w2 = m[row + GYRO_BIAS], m[row + GYRO_BIAS + 1], m[row + GYRO_BIAS + 2]
        a0, a1, a2 = m[row + ACCEL_BIAS], m[row + ACCEL_BIAS + 1], m[row + ACCEL_BIAS + 2]
        s = m[row + GYRO_SCALE]
        p[row] = m[row] + dt * v0 + (rn[1] * t1 + rn[2] * t2) + (rn[3] * a0 + rn[4] * a1 + rn[5] * a2)
        p[row + 1] = m[row + 1] + dt * v1 + (re[0] * t0 + re[2] * t2) + (re[3] * a0 + re[4] * a1 + re[5] * a2)
        p[row + 2] = m[row + 2] + dt * v2 + (rd[0] * t0 + rd[1] * t1) + (rd[3] * a0 + rd[4] * a1 + rd[5] * a2)
        p[row + 3] = (
            v0
            + (vn[1] * t1 + vn[2] * t2)
            + (vn[3] * a0 + vn[4] * a1 + vn[5] * a2)
            + (gn[0] * w0 + gn[1] * w1 + gn[2] * w2 + sn * s)
        )
        p[row + 4] = (
            v1
            + (ve[0] * t0 + ve[2] * t2)
            + (ve[3] * a0 + ve[4] * a1 + ve[5] * a2)
            + (ge[0] * w0 + ge[1] * w1 + ge[2] * w2 + se * s)
        )
        p[row + 5] = (
            v2
            + (vd[0] * t0 + vd[1] * t1)
            + (vd[3] * a0 + vd[4] * a1 + vd[5] * a2)
            + (gd[0] * w0 + gd[1] * w1 + gd[2] * w2 + sd * s)
        )
        p[row + 6] = t0 + (bn[0] * w0 + bn[1] * w1 + bn[2] * w2 + tn * s)
        p[row + 7] = t1 + (be[0] * w0 + be[1] * w1 + be[2] * w2 + te * s)
        p[row + 8] = t2 + (bd[0] * w0 + bd[1] * w1 + bd[2] * w2 + td * s)
        for j in range(N_MOVING, n):
            p[row + j] = m[row + j]
            p[j * n + i] = m[row + j]
    for i in range(n):
        p[i * n + i] += q[i]


def transition_matrix(dt: float, dv_n: FloatArray, C_n_from_b: FloatArray, turn_rad: float) -> FloatArray:
    """Phi (N_STATES, N_STATES) of one interval, as ``propagate`` applies it; parameters as there."""
    phi = np.eye(N_STATES)
    force = skew(dv_n)
    pos, vel, att, bg, ba = (slice(i, i + 3) for i in (POS, VEL, ATT, GYRO_BIAS, ACCEL_BIAS))
    turned_n = turn_rad * C_n_from_b[:, 2]
    phi[pos, vel] = dt * np.eye(3)
    phi[pos, att] = -0.5 * dt * force
    phi[pos, ba] = -0.5 * dt * dt * C_n_from_b
    phi[vel, att] = -force
    phi[vel, ba] = -dt * C_n_from_b
    phi[vel, bg] = 0.5 * dt * force @ C_n_from_b
    phi[vel, GYRO_SCALE] = -0.5 * force @ turned_n
    phi[att, bg] = -dt * C_n_from_b
    phi[att, GYRO_SCALE] = turned_n
    return phi
