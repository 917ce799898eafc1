"""Rates integrated over turns of a box, and how the turn follows what the gyroscope's calibration is taken to be."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit

from core.measurements import FloatArray

IntArray = npt.NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Turns:
    """Integrated turns, k of them, from a box's axes at a turn's begin (a) to those at its end (e).

    With rate = G (shown - bias), a small change of G and bias turns the end's axes further by
    ``by_inverse`` : dG + ``by_rate`` @ d(rate), in the end's axes.

    Parameters
    ----------
    C_a_from_e : (k, 3, 3)
    by_inverse : (k, 3, 3, 3) [axis, row of G, column of G], rad per 1
    by_rate : (k, 3, 3), s; a change of the bias is one of the rate by -G
    covariance : (k, 3, 3), rad2, of the turning that white noise of the rates adds, in the end's axes
    duration_s : (k,)
    """

    C_a_from_e: FloatArray
    by_inverse: FloatArray
    by_rate: FloatArray
    covariance: FloatArray
    duration_s: FloatArray


def integrate(
    t_s: FloatArray,
    shown: FloatArray,
    begins: IntArray,
    ends: IntArray,
    inverse: FloatArray,
    bias: FloatArray,
    noise: FloatArray,
) -> Turns:
    """Integrate rate = inverse @ (shown - bias) from sample ``begins`` to ``ends`` (k,), that one included.

    Rates are taken as linear between samples: each step is the rotation vector with the coning term of that,
    h (w0 + w1) / 2 + h^2 (w0 x w1) / 12 (Magnus expansion to third order; Iserles et al. 2000, sec. 5).

    Parameters
    ----------
    t_s, shown : (n,), (n, 3) as the gyroscope shows it
    inverse : (3, 3) G, rad/s per shown unit
    bias : (k, 3) of each turn, shown unit
    noise : (3,) density of each axis' white noise, shown unit/sqrt(Hz)
    """
    count = len(begins)
    C, by_inverse = np.empty((count, 3, 3)), np.empty((count, 3, 3, 3))
    by_rate, covariance = np.empty((count, 3, 3)), np.empty((count, 3, 3))
    _integrate(t_s, shown, begins, ends, inverse, bias, noise**2, C, by_inverse, by_rate, covariance)
    return Turns(C, by_inverse, by_rate, covariance, t_s[ends] - t_s[begins])


@njit(cache=True, nogil=True)
def _integrate(
    t_s: FloatArray,
    shown: FloatArray,
    begins: IntArray,
    ends: IntArray,
    inverse: FloatArray,
    bias: FloatArray,
    noise_sq: FloatArray,
    turned: FloatArray,
    by_inverse: FloatArray,
    by_rate: FloatArray,
    covariance: FloatArray,
) -> None:
    spread = inverse * noise_sq @ inverse.T
    w0, w1, phi = np.empty(3), np.empty(3), np.empty(3)
    step, jacobian, mixed = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    after, from0, from1 = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    for k in range(begins.shape[0]):
        C = np.eye(3)
        C_next = np.empty((3, 3))
        sensitivity = np.zeros((3, 3, 3))
        lever = np.zeros((3, 3))
        cov = np.zeros((3, 3))
        _rate(inverse, shown[begins[k]], bias[k], w0)
        for i in range(begins[k], ends[k]):
            h = t_s[i + 1] - t_s[i]
            _rate(inverse, shown[i + 1], bias[k], w1)
            coning = h * h / 12.0
            phi[0] = 0.5 * h * (w0[0] + w1[0]) + coning * (w0[1] * w1[2] - w0[2] * w1[1])
            phi[1] = 0.5 * h * (w0[1] + w1[1]) + coning * (w0[2] * w1[0] - w0[0] * w1[2])
            phi[2] = 0.5 * h * (w0[2] + w1[2]) + coning * (w0[0] * w1[1] - w0[1] * w1[0])
            _exponential(phi, step, jacobian)
            _product(C, spread, mixed)
            for a in range(3):
                for b in range(3):
                    cov[a, b] += h * (mixed[a, 0] * C[b, 0] + mixed[a, 1] * C[b, 1] + mixed[a, 2] * C[b, 2])
            _product(C, step, C_next)
            C, C_next = C_next, C
            _product(C, jacobian, after)
            _half(after, w1, 0.5 * h, -coning, from0)
            _half(after, w0, 0.5 * h, coning, from1)
            for b in range(3):
                x0, x1 = shown[i, b] - bias[k, b], shown[i + 1, b] - bias[k, b]
                for row in range(3):
                    lever[row, b] += from0[row, b] + from1[row, b]
                    for a in range(3):
                        sensitivity[row, a, b] += from0[row, a] * x0 + from1[row, a] * x1
            w0, w1 = w1, w0
        back = np.ascontiguousarray(C.T)
        turned[k] = C
        for a in range(3):
            by_inverse[k, :, a, :] = back @ np.ascontiguousarray(sensitivity[:, a, :])
        by_rate[k] = back @ lever
        covariance[k] = back @ cov @ C


@njit(cache=True, nogil=True)
def _rate(inverse: FloatArray, shown: FloatArray, bias: FloatArray, rate: FloatArray) -> None:
    x, y, z = shown[0] - bias[0], shown[1] - bias[1], shown[2] - bias[2]
    for a in range(3):
        rate[a] = inverse[a, 0] * x + inverse[a, 1] * y + inverse[a, 2] * z


@njit(cache=True, nogil=True)
def _product(left: FloatArray, right: FloatArray, out: FloatArray) -> None:
    for a in range(3):
        for b in range(3):
            out[a, b] = left[a, 0] * right[0, b] + left[a, 1] * right[1, b] + left[a, 2] * right[2, b]


@njit(cache=True, nogil=True)
def _half(after: FloatArray, rate: FloatArray, half_s: float, coning: float, out: FloatArray) -> None:
    """after @ (half_s I + coning [rate x])."""
    for a in range(3):
        x, y, z = after[a, 0], after[a, 1], after[a, 2]
        out[a, 0] = half_s * x + coning * (y * rate[2] - z * rate[1])
        out[a, 1] = half_s * y + coning * (z * rate[0] - x * rate[2])
        out[a, 2] = half_s * z + coning * (x * rate[1] - y * rate[0])


@njit(cache=True, nogil=True)
def _exponential(phi: FloatArray, step: FloatArray, jacobian: FloatArray) -> None:
    """exp([phi x]) and the right Jacobian of rotations there, (3, 3) each (Chirikjian 2012, eq. 10.86)."""
    square = phi[0] ** 2 + phi[1] ** 2 + phi[2] ** 2
    if square < 1e-6:  # the next terms of these series are below 1e-14
        sine, versed, cubed = 1.0 - square / 6.0, 0.5 - square / 24.0, 1.0 / 6.0 - square / 120.0
    else:
        angle = math.sqrt(square)
        sine, versed = math.sin(angle) / angle, (1.0 - math.cos(angle)) / square
        cubed = (1.0 - sine) / square
    for a in range(3):
        for b in range(3):
            twice = phi[a] * phi[b] - (square if a == b else 0.0)  # [phi x]^2
            step[a, b] = versed * twice
            jacobian[a, b] = cubed * twice
        step[a, a] += 1.0
        jacobian[a, a] += 1.0
    for a in range(3):
        b, c = (a + 1) % 3, (a + 2) % 3
        step[c, b] += sine * phi[a]
        step[b, c] -= sine * phi[a]
        jacobian[c, b] -= versed * phi[a]
        jacobian[b, c] += versed * phi[a]
