"""Smoothing after the drive: Rauch-Tung-Striebel over the filter's own nodes, and whole-drive solutions from them.

The filter is closed-loop, so what is smoothed is the error of its nominal state. At node k the filter left the
nominal x+ with the covariance P+; mechanised to node k + 1 it became x-, which the aids there moved to x+. A
smoothed error e of x+ at k + 1 is d = (x+ - x-) + e against x-, and e = G d at k with G = P+ Phi' (P-)^-1
(Gelb 1974, sec. 5.2; Groves 2013, sec. 3.4.5). Between nodes the correction of the mechanised rows goes evenly
from e to d.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt
from scipy.linalg import cho_factor, cho_solve

from core.earth import radii_m
from core.measurements import FloatArray, TimeArray
from core.navigation import nodes as node
from core.navigation.error_model import transition_matrix
from core.navigation.recorder import Recorder
from core.navigation.solution import Solution
from core.navigation.state import ACCEL_BIAS, ATT, GNSS_ERROR, GYRO_BIAS, MOUNT_PITCH, MOUNT_YAW, N_STATES, POS, VEL
from core.navigation.track import TRACK, Mode, Track
from core.rotation import (
    matrix_from_quaternion,
    matrix_from_rpy,
    quaternion_from_matrix,
    rotation_vector_from_matrix,
    rpy_from_matrix,
    skew,
)

_UPPER = np.triu_indices(N_STATES)
_RESET = np.array([POS, POS + 1, VEL, VEL + 1])  # what fixes tell anew where the position is reset
_OPENED = np.array([POS, POS + 1, POS + 2, VEL, VEL + 1])
_RIDGE = 1e-12
"""Added to a covariance of unit diagonal before it is inverted: rounding leaves it that far from positive."""


@dataclass(frozen=True, slots=True, eq=False)
class _Errors:
    """Of each node: ``after`` (k, n) against x+, ``before`` (k, n) against x-, ``covariance`` (k, n, n)."""

    after: FloatArray
    before: FloatArray
    covariance: FloatArray


def causal(recorder: Recorder, imu_lever_b_m: FloatArray) -> Solution:
    """What the filter knew at each instant from what lay before it.

    Parameters
    ----------
    recorder : what the filter wrote while it folded the drive
    imu_lever_b_m : (3,) inertial sensor in the vehicle's body
    """
    t_ns, table = recorder.node_table()
    nothing = np.zeros((len(t_ns), N_STATES))
    covariance = np.array([_covariance(row) for row in table]).reshape(-1, N_STATES, N_STATES)
    return _solution(recorder.track(), t_ns, table, _Errors(nothing, nothing, covariance), imu_lever_b_m, False)


def smoothed(recorder: Recorder, imu_lever_b_m: FloatArray) -> Solution:
    """The whole drive's measurements in every row; parameters as of ``causal``.

    Nothing flows back over an alignment: there the filter began anew. A reset of the position says how far the filter
    was off, and that it had been too sure.
    """
    t_ns, table = recorder.node_table()
    errors = _Errors(
        np.zeros((len(t_ns), N_STATES)), np.zeros((len(t_ns), N_STATES)), np.zeros((len(t_ns), N_STATES, N_STATES))
    )
    begins = np.searchsorted(t_ns, np.array(recorder.starts_ns, np.int64))
    broken = np.setdiff1d(np.flatnonzero(table[:, node.N_BROKEN] > 0.0), begins)
    bounds = np.unique(np.concatenate([[0], begins, broken, [len(t_ns)]]))
    for first, end in reversed(list(pairwise(bounds))):
        _smooth_stretch(t_ns, table, errors, first, end, end in broken)
    return _solution(recorder.track(), t_ns, table, errors, imu_lever_b_m, True)


def _smooth_stretch(t_ns: TimeArray, table: FloatArray, errors: _Errors, first: int, end: int, reset: bool) -> None:
    """Backward over nodes that follow each other, ``first`` to before ``end``, whose ``errors`` are written.

    ``reset`` is whether at ``end`` the position was reset: then that node is smoothed already.
    """
    after, before, covariance = errors.after, errors.before, errors.covariance
    last = end - 1
    if not reset:
        covariance[last] = _covariance(table[last])
        before[last] = _moved(table[last])
        last -= 1
    widened, widened_ns = 1.0, 0
    for k in range(last, first - 1, -1):
        p, row = _covariance(table[k]), table[k + 1]
        phi, added = _interval(row)
        predicted = phi @ p @ phi.T + added
        following = covariance[k + 1]
        if k + 1 == end:
            widened_ns = int(t_ns[end]) - round(row[node.N_BROKEN] * 1e9)
            before[end], following, widened = _reset_seen(before[end], following, predicted)
        variance = np.diag(predicted)
        spread = np.sqrt(np.where(variance > 0.0, variance, 1.0))  # of a state that is known, such as a given delay
        factor = cho_factor(predicted / np.outer(spread, spread) + _RIDGE * np.eye(N_STATES), check_finite=False)
        gain = (cho_solve(factor, (phi @ p) / spread[:, None], check_finite=False) / spread[:, None]).T
        after[k] = gain @ before[k + 1]
        before[k] = _moved(table[k]) + after[k]
        share = widened if t_ns[k] >= widened_ns else 1.0
        narrowed = share * p + gain @ (following - share * predicted) @ gain.T
        covariance[k] = 0.5 * (narrowed + narrowed.T)


def _reset_seen(
    error: FloatArray, covariance: FloatArray, predicted: FloatArray
) -> tuple[FloatArray, FloatArray, float]:
    """What a reset of the position tells of the state before it, whose spread (n, n) was ``predicted``.

    Its fixes and those after it give horizontal position and velocity, of which the filter before knew next to
    nothing: an observation of the ``error`` (n,) of x- with the smoothed ``covariance`` (n, n). It lies far outside the
    predicted spread, which is widened until it is usual.

    Returns
    -------
    the error of x-, its covariance, and how many times the predicted one is to be taken
    """
    p = predicted[:, _RESET]
    observed, noise = error[_RESET], covariance[np.ix_(_RESET, _RESET)]
    ratio = float(observed @ np.linalg.solve(p[_RESET] + noise, observed)) / len(_RESET)
    widened = max(1.0, ratio)
    gain = np.linalg.solve(widened * p[_RESET] + noise, widened * p.T).T
    return gain @ observed, widened * (predicted - gain @ p.T), widened


def _covariance(row: FloatArray) -> FloatArray:
    """P+ of a node, (n, n)."""
    p = np.zeros((N_STATES, N_STATES))
    p[_UPPER] = row[node.N_P :]
    return p + np.triu(p, 1).T


def _interval(row: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Phi (n, n) and the covariance (n, n) added over the interval that ends at a node.

    With what the aids there opened of the filter's certainty, as if it had come before them.
    """
    c = row[node.N_C : node.N_C + 9].reshape(3, 3)
    phi = transition_matrix(row[node.N_DT], row[node.N_DV : node.N_DV + 3], c, row[node.N_TURN])
    added = row[node.N_ADDED : node.N_ADDED + N_STATES].copy()
    slow = slice(GNSS_ERROR, GNSS_ERROR + 3)
    decay, exchanged = row[node.N_DECAY], row[[node.N_EXCHANGED, node.N_EXCHANGED, node.N_EXCHANGED + 1]]
    phi[slow] *= decay
    added[slow] = row[node.N_DECAY_VAR : node.N_DECAY_VAR + 3] + decay**2 * exchanged
    added[_OPENED] += row[node.N_OPENED : node.N_OPENED + 5]
    added[ATT : ATT + 2] += row[node.N_OPENED + 5]
    added[POS : POS + 3] += exchanged
    both = np.diag(added)
    places, errors = np.arange(POS, POS + 3), np.arange(GNSS_ERROR, GNSS_ERROR + 3)
    both[places, errors] = both[errors, places] = -decay * exchanged
    return phi, both


def _moved(row: FloatArray) -> FloatArray:
    """How far the aids of a node moved the nominal state: x+ minus x-, as an error (n,)."""
    x0 = row[node.N_BEFORE : node.N_BEFORE + node.N_NOMINAL].copy()
    x1 = row[node.N_AFTER : node.N_AFTER + node.N_NOMINAL]
    first_error = node.S_SLOW + GNSS_ERROR - GYRO_BIAS
    x0[first_error : first_error + 3] *= row[node.N_DECAY]
    moved = np.empty(N_STATES)
    difference = x1 - x0
    metres = _metres_per_rad(x1[node.S_LAT], x1[node.S_LAT + 2])
    east = (difference[node.S_LAT + 1] + np.pi) % (2 * np.pi) - np.pi
    moved[POS : POS + 3] = difference[node.S_LAT] * metres[0], east * metres[1], -difference[node.S_LAT + 2]
    moved[VEL : VEL + 3] = difference[node.S_V : node.S_V + 3]
    turn = matrix_from_quaternion(x1[:4]) @ matrix_from_quaternion(x0[:4]).T
    moved[ATT : ATT + 3] = rotation_vector_from_matrix(turn)
    moved[GYRO_BIAS:] = difference[node.S_SLOW :]
    return moved


def _metres_per_rad(lat_rad: float, alt_m: float) -> tuple[float, float]:
    """Metres a radian of latitude and of longitude."""
    meridian, transverse = radii_m(lat_rad)
    return meridian + alt_m, (transverse + alt_m) * float(np.cos(lat_rad))


def _vehicle_map(x: FloatArray, imu_lever_b_m: FloatArray) -> FloatArray:
    """Errors of the vehicle's position, velocity and attitude from those of the filter's states, (9, n).

    The vehicle stands in n as the box does, turned by the mounting: an error of the mounting is one of its attitude.
    """
    C_n_from_b = matrix_from_quaternion(x[:4])
    pitch, yaw = x[node.S_SLOW + MOUNT_PITCH - GYRO_BIAS], x[node.S_SLOW + MOUNT_YAW - GYRO_BIAS]
    C_n_from_v = C_n_from_b @ matrix_from_rpy(0.0, pitch, yaw)
    out = np.zeros((9, N_STATES))
    out[:6, :6] = np.eye(6)
    out[6:, ATT : ATT + 3] = np.eye(3)
    out[6:, MOUNT_YAW] = C_n_from_b[:, 2]
    out[6:, MOUNT_PITCH] = C_n_from_v[:, 1]
    # Position of the vehicle = that of the sensor - C l, and phi x (-C l) = [C l x] phi.
    out[:3, ATT : ATT + 3] = skew(C_n_from_b @ imu_lever_b_m)
    return out


def _solution(
    track: Track, t_ns: TimeArray, table: FloatArray, errors: _Errors, imu_lever_b_m: FloatArray, whole: bool
) -> Solution:
    nominal = table[:, node.N_AFTER : node.N_AFTER + node.N_NOMINAL]
    maps = np.array([_vehicle_map(x, imu_lever_b_m) for x in nominal]).reshape(-1, 9, N_STATES)
    covariance = maps @ errors.covariance @ maps.transpose(0, 2, 1)
    # Beside the filter's own: what all fixes err by alike moves the whole drive.
    covariance[:, [0, 1, 2], [0, 1, 2]] += table[:, [node.N_UNSEEN, node.N_UNSEEN, node.N_UNSEEN + 1]]
    slow = nominal[:, node.S_SLOW :] + errors.after[:, GYRO_BIAS:]
    variances = np.diagonal(errors.covariance, axis1=1, axis2=2)[:, GYRO_BIAS:]
    if whole and len(t_ns):
        after = np.einsum("kij,kj->ki", maps, errors.after)
        before = np.einsum("kij,kj->ki", maps, errors.before)
        bias_variance = variances[:, ACCEL_BIAS - GYRO_BIAS :][:, :2].mean(axis=1)
        track = _corrected(track, t_ns, after, before, covariance, bias_variance)
    return Solution(track, t_ns, covariance, slow, np.sqrt(np.maximum(variances, 0.0)), whole)


def _corrected(
    track: Track,
    t_ns: TimeArray,
    after: FloatArray,
    before: FloatArray,
    covariance: FloatArray,
    bias_variance: FloatArray,
) -> Track:
    """The rows moved by the smoothed errors (k, 9) of the nodes around them, with the smoothed spread."""
    values = track.values.copy()
    inside = (track.t_ns >= t_ns[0]) & (track.t_ns <= t_ns[-1]) & (values[:, TRACK["mode"]] != Mode.ALIGNING)
    rows = np.flatnonzero(inside)
    k = np.searchsorted(t_ns, track.t_ns[rows], side="right") - 1
    following = np.minimum(k + 1, len(t_ns) - 1)
    share = (track.t_ns[rows] - t_ns[k]) / np.maximum(t_ns[following] - t_ns[k], 1)
    error = (1.0 - share)[:, None] * after[k] + share[:, None] * before[following]
    spread = (1.0 - share)[:, None, None] * covariance[k] + share[:, None, None] * covariance[following]

    own = values[rows]
    metres = np.array([_metres_per_rad(lat, alt) for lat, alt in own[:, [TRACK["lat_rad"], TRACK["alt_m"]]]])
    own[:, TRACK["lat_rad"]] += error[:, 0] / metres[:, 0]
    own[:, TRACK["lon_rad"]] = (own[:, TRACK["lon_rad"]] + error[:, 1] / metres[:, 1] + np.pi) % (2 * np.pi) - np.pi
    own[:, TRACK["alt_m"]] -= error[:, 2]
    velocity = slice(TRACK["vn_mps"], TRACK["vn_mps"] + 3)
    own[:, velocity] += error[:, 3:6]
    angles = slice(TRACK["roll_rad"], TRACK["roll_rad"] + 3)
    own[:, angles] = [_turned(rpy, phi) for rpy, phi in zip(own[:, angles], error[:, 6:], strict=True)]
    variances = np.maximum(np.diagonal(spread, axis1=1, axis2=2), 0.0)
    own[:, TRACK["sd_n_m"] : TRACK["sd_d_m"] + 1] = np.sqrt(variances[:, :3])
    own[:, TRACK["cov_ne_m2"]] = spread[:, 0, 1]
    own[:, TRACK["sd_yaw_rad"]] = np.sqrt(variances[:, 8])
    own[:, TRACK["sd_v_h_mps"]] = np.sqrt(variances[:, 3:5].mean(axis=1))
    own[:, TRACK["sd_tilt_rad"]] = np.sqrt(variances[:, 6:8].mean(axis=1))
    own[:, TRACK["sd_accel_bias_mps2"]] = np.sqrt(np.maximum(bias_variance[k], 0.0))
    values[rows] = own
    return Track(track.t_ns, values)


def _turned(rpy_rad: FloatArray, phi_n: FloatArray) -> npt.NDArray[np.float64]:
    """Roll, pitch and yaw (3,) after a small rotation (3,) in n."""
    turn = skew(phi_n)
    c = (np.eye(3) + turn + 0.5 * turn @ turn) @ matrix_from_rpy(*rpy_rad)
    return np.array(rpy_from_matrix(matrix_from_quaternion(quaternion_from_matrix(c))))
