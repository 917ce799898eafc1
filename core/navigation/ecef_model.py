"""Equations of the mobile-mapping paper's filter (seed 3): state, dynamics, measurement, and their Jacobians.

State (eq. 8): position and velocity over ground in e, the quaternion q_n_from_b, gravity along n's down axis.
What is the paper's, and where its text had to be mended:

- Eq. 1 is kept with two misprints put right: its first element is a2 + b2 - c2 - d2, and the last of its second
  row 2(cd - ab).
- Eq. 2 prints ``cos theta`` for cos(phi); it is north-east-down from ECEF. Eq. 3 is kept.
- Eq. 4 is kept with its signs: specific force, minus the rate crossed with the velocity in b, plus gravity in b.
  (The sentence before it says that gravity is subtracted: of the reaction that an accelerometer shows. And the
  gyroscopes' rate is called omega_ie, which is the Earth's.) The Earth's rotation is left out, as there: Coriolis
  at 15 m/s is 2 mm/s2.
- Eq. 5 turns a velocity, not its derivative: the new velocity in b by the attitude at the interval's end. The turn
  over the interval is that of the gyroscopes, as in eq. 4, so that the centripetal term and the turning of the axes
  undo each other; turned by another sensor's attitude, the noise of that would become speed.
- Eq. 6 is the trapezoidal rule.
- The paper says "velocity NED in ECEF frame" of what its eq. 5 gives in e, and measures it likewise: e it is.
- How the sensor's attitude enters eq. 8 is not said. Here the state's quaternion is the sensor's attitude turned
  by an error that hangs together in time (first-order Gauss-Markov, about the axes of n): it follows the sensor
  and forgets, over the correlation time, what GNSS taught about the sensor's error.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numba import njit

from core.earth import geodetic_from_ecef, matrix_e_from_n
from core.measurements import FloatArray
from core.rotation import matrix_from_quaternion

POSITION: Final = 0
VELOCITY: Final = 3
QUATERNION: Final = 6
GRAVITY: Final = 10
N_STATES: Final = 11
N_MEASURED: Final = 6


@njit(cache=True, nogil=True)
def quaternion_from_rotation(rotation_rad: FloatArray) -> FloatArray:
    """Unit quaternion (4,) of a rotation vector (3,), rad."""
    angle = math.sqrt(rotation_rad[0] ** 2 + rotation_rad[1] ** 2 + rotation_rad[2] ** 2)
    # sin(a/2)/a, by its series where the quotient would be 0/0.
    share = math.sin(angle / 2.0) / angle if angle > 1e-6 else 0.5 - angle * angle / 48.0
    q = np.empty(4)
    q[0] = math.cos(angle / 2.0)
    q[1:] = share * rotation_rad
    return q


@njit(cache=True, nogil=True)
def quaternion_product(p: FloatArray, q: FloatArray) -> FloatArray:
    """Hamilton product (4,): first ``q``, then ``p``."""
    return right_multiplication(q) @ p


@njit(cache=True, nogil=True)
def conjugate(q: FloatArray) -> FloatArray:
    """The inverse rotation (4,) of a unit quaternion."""
    return np.array([q[0], -q[1], -q[2], -q[3]])


@njit(cache=True, nogil=True)
def right_multiplication(q: FloatArray) -> FloatArray:
    """The (4, 4) matrix that multiplies a quaternion by ``q`` from the right."""
    w, x, y, z = q[0], q[1], q[2], q[3]
    m = np.empty((4, 4))
    m[0, 0], m[0, 1], m[0, 2], m[0, 3] = w, -x, -y, -z
    m[1, 0], m[1, 1], m[1, 2], m[1, 3] = x, w, z, -y
    m[2, 0], m[2, 1], m[2, 2], m[2, 3] = y, -z, w, x
    m[3, 0], m[3, 1], m[3, 2], m[3, 3] = z, y, -x, w
    return m


@njit(cache=True, nogil=True)
def _turned_by_quaternion(q: FloatArray, u: FloatArray) -> FloatArray:
    """Derivative (3, 4) of C(q) u by the components of a quaternion that is kept of unit length."""
    w, x, y, z = q[0], q[1], q[2], q[3]
    a, b, c = u[0], u[1], u[2]
    d = np.empty((3, 4))
    d[0, 0], d[0, 1], d[0, 2] = w * a - z * b + y * c, x * a + y * b + z * c, -y * a + x * b + w * c
    d[0, 3] = -z * a - w * b + x * c
    d[1, 0], d[1, 1], d[1, 2] = z * a + w * b - x * c, y * a - x * b - w * c, x * a + y * b + z * c
    d[1, 3] = w * a - z * b + y * c
    d[2, 0], d[2, 1], d[2, 2] = -y * a + x * b + w * c, z * a + w * b - x * c, -w * a + z * b - y * c
    d[2, 3] = x * a + y * b + z * c
    return 2.0 * d @ (np.eye(4) - np.outer(q, q))


@njit(cache=True, nogil=True)
def propagate(
    x: FloatArray,
    f_b: FloatArray,
    omega_b: FloatArray,
    q_given_before: FloatArray,
    q_given: FloatArray,
    kept: float,
    dt_s: float,
) -> FloatArray:
    """The state after an interval (eq. 4, 5, 6).

    Parameters
    ----------
    x : (11,) state before
    f_b, omega_b : (3,) mean specific force (m/s2) and rate (rad/s) over the interval, in b
    q_given_before, q_given : (4,) q_n_from_b that the attitude's source gives at its ends
    kept : share of the error of that source that is left after the interval
    dt_s : length of the interval

    Returns
    -------
    (11,) state after
    """
    at = x[POSITION : POSITION + 3]
    v_e = x[VELOCITY : VELOCITY + 3]
    q = x[QUATERNION : QUATERNION + 4] / np.linalg.norm(x[QUATERNION : QUATERNION + 4])
    lat, lon, _ = geodetic_from_ecef(at[0], at[1], at[2])
    C_e_from_n = matrix_e_from_n(lat, lon)
    gravity_n = np.array([0.0, 0.0, x[GRAVITY]])
    C_n_from_b = matrix_from_quaternion(q)
    C_n_from_b_middle = matrix_from_quaternion(quaternion_product(q, quaternion_from_rotation(0.5 * dt_s * omega_b)))
    C_n_from_b_end = matrix_from_quaternion(quaternion_product(q, quaternion_from_rotation(dt_s * omega_b)))

    # Eq. 4 by the midpoint rule.
    v_b = C_n_from_b.T @ (C_e_from_n.T @ v_e)
    rate_b = f_b - np.cross(omega_b, v_b) + C_n_from_b.T @ gravity_n
    v_b_middle = v_b + 0.5 * dt_s * rate_b
    v_b_end = v_b + dt_s * (f_b - np.cross(omega_b, v_b_middle) + C_n_from_b_middle.T @ gravity_n)

    after = x.copy()
    v_e_end = C_e_from_n @ (C_n_from_b_end @ v_b_end)  # eq. 5
    after[VELOCITY : VELOCITY + 3] = v_e_end
    after[POSITION : POSITION + 3] = at + 0.5 * dt_s * (v_e + v_e_end)  # eq. 6
    error = quaternion_product(q, conjugate(q_given_before))
    error[1:] *= kept
    after[QUATERNION : QUATERNION + 4] = quaternion_product(error / np.linalg.norm(error), q_given)
    return after


@njit(cache=True, nogil=True)
def transition(
    x: FloatArray,
    f_b: FloatArray,
    omega_b: FloatArray,
    q_given_before: FloatArray,
    q_given: FloatArray,
    kept: float,
    dt_s: float,
) -> FloatArray:
    """The Jacobian (11, 11) of ``propagate`` by the state; parameters as there.

    Neglected: that north turns as the vehicle goes (1 m is 1.6e-7 rad), and what the midpoint rule leaves of the
    centripetal term, (omega dt)^3 / 6.
    """
    q = x[QUATERNION : QUATERNION + 4] / np.linalg.norm(x[QUATERNION : QUATERNION + 4])
    lat, lon, _ = geodetic_from_ecef(x[0], x[1], x[2])
    C_e_from_n = matrix_e_from_n(lat, lon)
    f_middle = matrix_from_quaternion(quaternion_from_rotation(0.5 * dt_s * omega_b)) @ f_b
    v_by_q = dt_s * C_e_from_n @ _turned_by_quaternion(q, f_middle)
    v_by_g = dt_s * C_e_from_n[:, 2]

    error = quaternion_product(q, conjugate(q_given_before))
    error[1:] *= kept
    length = np.linalg.norm(error)
    error /= length
    shrink = np.diag(np.array([1.0, kept, kept, kept])) / length
    q_by_q = right_multiplication(q_given) @ (np.eye(4) - np.outer(error, error)) @ shrink
    q_by_q = q_by_q @ right_multiplication(conjugate(q_given_before)) @ (np.eye(4) - np.outer(q, q))

    F = np.eye(N_STATES)
    for i in range(3):
        F[POSITION + i, VELOCITY + i] = dt_s
    F[POSITION : POSITION + 3, QUATERNION : QUATERNION + 4] = 0.5 * dt_s * v_by_q
    F[POSITION : POSITION + 3, GRAVITY] = 0.5 * dt_s * v_by_g
    F[VELOCITY : VELOCITY + 3, QUATERNION : QUATERNION + 4] = v_by_q
    F[VELOCITY : VELOCITY + 3, GRAVITY] = v_by_g
    F[QUATERNION : QUATERNION + 4, QUATERNION : QUATERNION + 4] = q_by_q
    return F


@njit(cache=True, nogil=True)
def measured(x: FloatArray, lever_b_m: FloatArray, omega_b: FloatArray) -> FloatArray:
    """Position and velocity of the antenna in e, (6,), ``lever_b_m`` from the inertial sensor."""
    C_e_from_b = _C_e_from_b(x)
    z = np.empty(N_MEASURED)
    z[:3] = x[POSITION : POSITION + 3] + C_e_from_b @ lever_b_m
    z[3:] = x[VELOCITY : VELOCITY + 3] + C_e_from_b @ np.cross(omega_b, lever_b_m)
    return z


@njit(cache=True, nogil=True)
def measurement_jacobian(x: FloatArray, lever_b_m: FloatArray, omega_b: FloatArray) -> FloatArray:
    """The Jacobian (6, 11) of ``measured`` by the state."""
    q = x[QUATERNION : QUATERNION + 4] / np.linalg.norm(x[QUATERNION : QUATERNION + 4])
    lat, lon, _ = geodetic_from_ecef(x[0], x[1], x[2])
    C_e_from_n = matrix_e_from_n(lat, lon)
    H = np.zeros((N_MEASURED, N_STATES))
    for i in range(N_MEASURED):
        H[i, i] = 1.0
    H[:3, QUATERNION : QUATERNION + 4] = C_e_from_n @ _turned_by_quaternion(q, lever_b_m)
    H[3:, QUATERNION : QUATERNION + 4] = C_e_from_n @ _turned_by_quaternion(q, np.cross(omega_b, lever_b_m))
    return H


@njit(cache=True, nogil=True)
def quaternion_by_rotation(q: FloatArray) -> FloatArray:
    """Derivative (4, 3) of a quaternion by a small rotation in n: C(true) = (I + [phi x]) C(q)."""
    return 0.5 * np.ascontiguousarray(right_multiplication(q)[:, 1:])


@njit(cache=True, nogil=True)
def navigation_jacobian(x: FloatArray) -> FloatArray:
    """Derivative (9, 11) of position, velocity (n; m, m/s) and attitude (rotation in n, rad) by the state."""
    lat, lon, _ = geodetic_from_ecef(x[0], x[1], x[2])
    C_n_from_e = matrix_e_from_n(lat, lon).T
    T = np.zeros((9, N_STATES))
    T[:3, POSITION : POSITION + 3] = C_n_from_e
    T[3:6, VELOCITY : VELOCITY + 3] = C_n_from_e
    T[6:, QUATERNION : QUATERNION + 4] = 2.0 * right_multiplication(conjugate(x[QUATERNION : QUATERNION + 4]))[1:]
    return T


@njit(cache=True, nogil=True)
def _C_e_from_b(x: FloatArray) -> FloatArray:
    """Eq. 3."""
    lat, lon, _ = geodetic_from_ecef(x[0], x[1], x[2])
    q = x[QUATERNION : QUATERNION + 4] / np.linalg.norm(x[QUATERNION : QUATERNION + 4])
    return matrix_e_from_n(lat, lon) @ matrix_from_quaternion(q)
