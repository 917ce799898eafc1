"""Propagation of the error covariance over one interval: structured blocks, nothing dense.

Error states as in ``state``. Left out, with their size for a car: the change of gravity with height
(3e-6 m/s2 a metre), Coriolis on a velocity error (1.5e-4 m/s2 a m/s), rotation of n on an attitude error
(7e-5 rad/s a rad): each two orders below the bias noise. Groves 2013, sec. 14.2.4.
"""

from __future__ import annotations

from numba import njit

from core.measurements import FloatArray
from core.navigation.state import ACCEL_BIAS, ATT, GYRO_BIAS, POS, VEL


@njit(cache=True, nogil=True)
def _axpy(p: FloatArray, n: int, to: int, a: float, frm: int) -> None:
    t, f = to * n, frm * n
    for j in range(n):
        p[t + j] += a * p[f + j]


@njit(cache=True, nogil=True)
def _axpy3(p: FloatArray, n: int, to: int, a: float, b: float, c: float, frm: int) -> None:
    t, f, g, h = to * n, frm * n, (frm + 1) * n, (frm + 2) * n
    for j in range(n):
        p[t + j] += a * p[f + j] + b * p[g + j] + c * p[h + j]


@njit(cache=True, nogil=True)
def _apply_transition(p: FloatArray, n: int, dt: float, dv: FloatArray, c: FloatArray) -> None:
    """P <- Phi P by rows. ``dv`` (3,) integral of f_n, ``c`` (9,) mean C_n_from_b."""
    half = 0.5 * dt
    fn, fe, fd = dv[0], dv[1], dv[2]
    # Position first, velocity next, attitude last: each row only needs the old rows below it.
    # -[f x] rows: (0, fd, -fe), (-fd, 0, fn), (fe, -fn, 0)
    for i in range(3):
        _axpy(p, n, POS + i, dt, VEL + i)
        _axpy3(p, n, POS + i, -half * dt * c[3 * i], -half * dt * c[3 * i + 1], -half * dt * c[3 * i + 2], ACCEL_BIAS)
    _axpy3(p, n, POS, 0.0, half * fd, -half * fe, ATT)
    _axpy3(p, n, POS + 1, -half * fd, 0.0, half * fn, ATT)
    _axpy3(p, n, POS + 2, half * fe, -half * fn, 0.0, ATT)
    _axpy3(p, n, VEL, 0.0, fd, -fe, ATT)
    _axpy3(p, n, VEL + 1, -fd, 0.0, fn, ATT)
    _axpy3(p, n, VEL + 2, fe, -fn, 0.0, ATT)
    for i in range(3):
        _axpy3(p, n, VEL + i, -dt * c[3 * i], -dt * c[3 * i + 1], -dt * c[3 * i + 2], ACCEL_BIAS)
    # Gyroscope bias on velocity, second order: +[f x] C dt / 2.
    for k in range(3):
        cn, ce, cd = c[k], c[3 + k], c[6 + k]
        _axpy(p, n, VEL, half * (fe * cd - fd * ce), GYRO_BIAS + k)
        _axpy(p, n, VEL + 1, half * (fd * cn - fn * cd), GYRO_BIAS + k)
        _axpy(p, n, VEL + 2, half * (fn * ce - fe * cn), GYRO_BIAS + k)
    for i in range(3):
        _axpy3(p, n, ATT + i, -dt * c[3 * i], -dt * c[3 * i + 1], -dt * c[3 * i + 2], GYRO_BIAS)


@njit(cache=True, nogil=True)
def propagate(p: FloatArray, work: FloatArray, n: int, dt: float, dv: FloatArray, c: FloatArray, q: FloatArray) -> None:
    """P <- Phi P Phi' + Q in place.

    Parameters
    ----------
    p, work : (n*n,) covariance, and scratch of the same size
    dt : s
    dv : (3,) integral of the specific force in n over the interval, m/s
    c : (9,) mean C_n_from_b over the interval, by rows
    q : (n,) variances that the interval adds
    """
    _apply_transition(p, n, dt, dv, c)
    for i in range(n):
        for j in range(n):
            work[j * n + i] = p[i * n + j]
    _apply_transition(work, n, dt, dv, c)
    for i in range(n * n):
        p[i] = work[i]
    for i in range(n):
        p[i * n + i] += q[i]
