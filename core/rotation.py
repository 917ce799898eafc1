"""Rotations: Hamilton quaternions (w, x, y, z), matrices, and roll-pitch-yaw (Groves 2013, sec. 2.2)."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from core.measurements import FloatArray


@njit(cache=True, nogil=True)
def matrix_from_rpy(roll_rad: float, pitch_rad: float, yaw_rad: float) -> FloatArray:
    """Rz(yaw) Ry(pitch) Rx(roll) as a (3, 3) matrix: from the rotated frame to the reference."""
    cr, sr = math.cos(roll_rad), math.sin(roll_rad)
    cp, sp = math.cos(pitch_rad), math.sin(pitch_rad)
    cy, sy = math.cos(yaw_rad), math.sin(yaw_rad)
    c = np.empty((3, 3))
    c[0, 0], c[0, 1], c[0, 2] = cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr
    c[1, 0], c[1, 1], c[1, 2] = sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr
    c[2, 0], c[2, 1], c[2, 2] = -sp, cp * sr, cp * cr
    return c


@njit(cache=True, nogil=True)
def rpy_from_matrix(c: FloatArray) -> tuple[float, float, float]:
    """Roll, pitch, yaw (rad) of a (3, 3) matrix; yaw in (-pi, pi]."""
    pitch = math.asin(min(1.0, max(-1.0, -c[2, 0])))
    return math.atan2(c[2, 1], c[2, 2]), pitch, math.atan2(c[1, 0], c[0, 0])


@njit(cache=True, nogil=True)
def quaternion_from_matrix(c: FloatArray) -> FloatArray:
    """Quaternion (4,) of a (3, 3) rotation matrix, w >= 0, by the largest of its four components."""
    q = np.empty(4)
    trace = c[0, 0] + c[1, 1] + c[2, 2]
    if trace > 0.0:
        s = 2.0 * math.sqrt(1.0 + trace)
        q[0], q[1] = 0.25 * s, (c[2, 1] - c[1, 2]) / s
        q[2], q[3] = (c[0, 2] - c[2, 0]) / s, (c[1, 0] - c[0, 1]) / s
    elif c[0, 0] >= c[1, 1] and c[0, 0] >= c[2, 2]:
        s = 2.0 * math.sqrt(1.0 + c[0, 0] - c[1, 1] - c[2, 2])
        q[0], q[1] = (c[2, 1] - c[1, 2]) / s, 0.25 * s
        q[2], q[3] = (c[0, 1] + c[1, 0]) / s, (c[0, 2] + c[2, 0]) / s
    elif c[1, 1] >= c[2, 2]:
        s = 2.0 * math.sqrt(1.0 + c[1, 1] - c[0, 0] - c[2, 2])
        q[0], q[1] = (c[0, 2] - c[2, 0]) / s, (c[0, 1] + c[1, 0]) / s
        q[2], q[3] = 0.25 * s, (c[1, 2] + c[2, 1]) / s
    else:
        s = 2.0 * math.sqrt(1.0 + c[2, 2] - c[0, 0] - c[1, 1])
        q[0], q[1] = (c[1, 0] - c[0, 1]) / s, (c[0, 2] + c[2, 0]) / s
        q[2], q[3] = (c[1, 2] + c[2, 1]) / s, 0.25 * s
    if q[0] < 0.0:
        q = -q
    return q / math.sqrt(q[0] ** 2 + q[1] ** 2 + q[2] ** 2 + q[3] ** 2)


@njit(cache=True, nogil=True)
def matrix_from_quaternion(q: FloatArray) -> FloatArray:
    """(3, 3) matrix of a unit quaternion (4,)."""
    w, x, y, z = q[0], q[1], q[2], q[3]
    c = np.empty((3, 3))
    c[0, 0], c[0, 1], c[0, 2] = w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)
    c[1, 0], c[1, 1], c[1, 2] = 2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)
    c[2, 0], c[2, 1], c[2, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z
    return c


def wrap_angle_rad(angle_rad: FloatArray) -> FloatArray:
    """Angles brought into [-pi, pi), element by element."""
    return np.asarray(np.mod(np.asarray(angle_rad) + np.pi, 2 * np.pi) - np.pi)


def skew(v: FloatArray) -> FloatArray:
    """[v x] (3, 3): the matrix whose product with a vector is the cross product of ``v`` (3,) with it."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def rotation_vector_from_matrix(c: FloatArray) -> FloatArray:
    """Rotation vector (3,), rad, of a (3, 3) rotation matrix, its length in [0, pi]."""
    q = quaternion_from_matrix(c)
    length = math.sqrt(q[1] ** 2 + q[2] ** 2 + q[3] ** 2)
    return np.asarray(q[1:] * (2.0 if length < 1e-9 else 2.0 * math.atan2(length, q[0]) / length))


def matrix_from_rotation_vector(vector_rad: FloatArray) -> FloatArray:
    """(3, 3) matrix exp([v x]) of a rotation vector (3,), rad (Rodrigues)."""
    angle = float(np.linalg.norm(vector_rad))
    cross = skew(vector_rad)
    versed = 0.5 * np.sinc(0.5 * angle / math.pi) ** 2
    return np.asarray(np.eye(3) + np.sinc(angle / math.pi) * cross + versed * (cross @ cross))
