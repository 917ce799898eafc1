"""Propagation of the error covariance over one interval: structured blocks, nothing dense.

Error states as in ``state``. Left out, with their size for a car: the change of gravity with height
(3e-6 m/s2 a metre), Coriolis on a velocity error (1.5e-4 m/s2 a m/s), rotation of n on an attitude error
(7e-5 rad/s a rad): each two orders below the bias noise. Groves 2013, sec. 14.2.4.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from core.compiled import compiled
from core.measurements import FloatArray
from core.navigation.kalman import Nine
from core.navigation.state import ACCEL_BIAS, ATT, GYRO_BIAS, GYRO_SCALE, N_STATES, POS, VEL
from core.rotation import skew

N_MOVING: Final = 9
"""Position, velocity and attitude: the errors that change with time by themselves."""

# Where the rows of these states begin in the flat covariance.
_POS, _VEL, _ATT = POS * N_STATES, VEL * N_STATES, ATT * N_STATES
_GYRO_BIAS, _ACCEL_BIAS, _GYRO_SCALE = GYRO_BIAS * N_STATES, ACCEL_BIAS * N_STATES, GYRO_SCALE * N_STATES

_Vector = tuple[float, float, float]


@compiled(fastmath={"contract"})
def _transform(p: FloatArray, columns: int, dt: float, dv: _Vector, c: Nine, turn: float) -> None:
    """P <- Phi P in place, of the first ``columns`` columns: one does not touch the other.

    All rows in one loop, at places that the compiler knows: else it makes no vector code of it.
    """
    fn, fe, fd = dv
    half = 0.5 * dt
    # What a bias in b brings over the interval in n, -C dt, and a gyroscope scale, C e_z turn.
    b0, b1, b2 = -dt * c[0], -dt * c[1], -dt * c[2]
    b3, b4, b5 = -dt * c[3], -dt * c[4], -dt * c[5]
    b6, b7, b8 = -dt * c[6], -dt * c[7], -dt * c[8]
    tn, te, td = turn * c[2], turn * c[5], turn * c[8]
    for j in range(columns):
        wx, wy, wz = p[_GYRO_BIAS + j], p[_GYRO_BIAS + N_STATES + j], p[_GYRO_BIAS + 2 * N_STATES + j]
        scale = p[_GYRO_SCALE + j]
        turned_n = b0 * wx + b1 * wy + b2 * wz + tn * scale
        turned_e = b3 * wx + b4 * wy + b5 * wz + te * scale
        turned_d = b6 * wx + b7 * wy + b8 * wz + td * scale
        ax, ay, az = p[_ACCEL_BIAS + j], p[_ACCEL_BIAS + N_STATES + j], p[_ACCEL_BIAS + 2 * N_STATES + j]
        sped_n = b0 * ax + b1 * ay + b2 * az
        sped_e = b3 * ax + b4 * ay + b5 * az
        sped_d = b6 * ax + b7 * ay + b8 * az
        # The force that the attitude error turns, phi x f: with phi as at first for the position, halfway for the
        # velocity.
        an, ae, ad = p[_ATT + j], p[_ATT + N_STATES + j], p[_ATT + 2 * N_STATES + j]
        vn, ve, vd = p[_VEL + j], p[_VEL + N_STATES + j], p[_VEL + 2 * N_STATES + j]
        p[_POS + j] += dt * vn + half * (ae * fd - ad * fe + sped_n)
        p[_POS + N_STATES + j] += dt * ve + half * (ad * fn - an * fd + sped_e)
        p[_POS + 2 * N_STATES + j] += dt * vd + half * (an * fe - ae * fn + sped_d)
        mn, me, md = an + 0.5 * turned_n, ae + 0.5 * turned_e, ad + 0.5 * turned_d
        p[_VEL + j] = vn + (me * fd - md * fe) + sped_n
        p[_VEL + N_STATES + j] = ve + (md * fn - mn * fd) + sped_e
        p[_VEL + 2 * N_STATES + j] = vd + (mn * fe - me * fn) + sped_d
        p[_ATT + j] = an + turned_n
        p[_ATT + N_STATES + j] = ae + turned_e
        p[_ATT + 2 * N_STATES + j] = ad + turned_d


@compiled()
def propagate(p: FloatArray, dt: float, dv: _Vector, c: Nine, turn: float, q: FloatArray) -> None:
    """P <- Phi P Phi' + Q in place.

    Phi touches the nine rows of position, velocity and attitude only. So Phi P is transformed rows above P's own; their
    transpose, as P is symmetric, is what P Phi' has in the columns beside, and what is left to transform in the nine.

    Parameters
    ----------
    p : (N_STATES**2,) covariance, flat
    dt : s
    dv : integral of the specific force in n over the interval, m/s
    c : mean C_n_from_b over the interval, by rows
    turn : integral of the rate about b's z axis over the interval, rad
    q : (N_STATES,) variances that the interval adds
    """
    _transform(p, N_STATES, dt, dv, c, turn)
    for i in range(N_MOVING):
        for j in range(i):
            upper, lower = j * N_STATES + i, i * N_STATES + j
            p[upper], p[lower] = p[lower], p[upper]
        for j in range(N_MOVING, N_STATES):
            p[j * N_STATES + i] = p[i * N_STATES + j]
    _transform(p, N_MOVING, dt, dv, c, turn)
    for i in range(N_STATES):
        p[i * (N_STATES + 1)] += q[i]


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
