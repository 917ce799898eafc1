"""Pose and covariance of the vehicle at any instants of a solution: where it was when a camera's frame was taken."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from core.earth import radii_m
from core.measurements import FloatArray, TimeArray
from core.navigation.solution import Solution
from core.navigation.track import TRACK, Mode, Track

LONGEST_STEP_S: Final = 1.0
"""Rows farther apart are not interpolated, s: a car turns by 30 degrees and brakes by 8 m/s in it; a choice."""
LONGEST_NODE_STEP_S: Final = 2.0
"""Nodes of covariance farther apart are not interpolated, s: between fixes at 1 Hz it falls once a second; a choice."""


class PoseStatus(IntEnum):
    """What is known at an instant; the first two as the track's modes, the others have no pose."""

    AIDED = 1
    COASTING = 2
    OUTSIDE = 3
    GAP = 4


@dataclass(frozen=True, slots=True, eq=False)
class Poses:
    """Poses of the vehicle's body frame; all but ``t_ns`` and ``status`` are NaN where none is known.

    Parameters
    ----------
    t_ns, status : (n,) instants and what is known there, a ``PoseStatus``
    lat_rad, lon_rad, alt_m : (n,) ellipsoidal
    q_n_from_b : (n, 4), scalar first, w >= 0
    rpy_rad : (n, 3) roll, pitch, yaw
    covariance : (n, 6, 6) of the errors (truth minus estimate) of position (north, east, down; m) and attitude
        (rotation vector in n, rad)
    """

    t_ns: TimeArray
    status: npt.NDArray[np.int64]
    lat_rad: FloatArray
    lon_rad: FloatArray
    alt_m: FloatArray
    q_n_from_b: FloatArray
    rpy_rad: FloatArray
    covariance: FloatArray


def poses_at(solution: Solution, t_ns: TimeArray) -> Poses:
    """Interpolate a solution on the manifold; what lies outside of it or in its gaps has no pose.

    Between two rows position is the cubic that has their positions and velocities (Hermite), in local metres;
    attitude turns at a constant rate about the axis that leads from one to the other (slerp); covariance is linear
    between its nodes, so it stays positive. A row at the very instant is given as it is. Beyond the first or last
    node by less than ``LONGEST_NODE_STEP_S`` that node's covariance holds.

    Parameters
    ----------
    solution : at least its rows that are not aligning are used
    t_ns : (n,) instants in any order, UTC
    """
    track = _navigating(solution.track)
    n = len(t_ns)
    status = np.full(n, int(PoseStatus.OUTSIDE))
    result = Poses(
        t_ns=t_ns,
        status=status,
        lat_rad=np.full(n, np.nan),
        lon_rad=np.full(n, np.nan),
        alt_m=np.full(n, np.nan),
        q_n_from_b=np.full((n, 4), np.nan),
        rpy_rad=np.full((n, 3), np.nan),
        covariance=np.full((n, 6, 6), np.nan),
    )
    if not len(track.t_ns):
        return result
    inside = (t_ns >= track.t_ns[0]) & (t_ns <= track.t_ns[-1])
    before = np.clip(np.searchsorted(track.t_ns, t_ns, side="right") - 1, 0, len(track.t_ns) - 1)
    after = np.clip(np.searchsorted(track.t_ns, t_ns), 0, len(track.t_ns) - 1)
    bridged = track.t_ns[after] - track.t_ns[before] <= LONGEST_STEP_S * 1e9
    covariance, reached = covariance_at(solution, t_ns)
    known = inside & bridged & reached
    status[inside & ~known] = PoseStatus.GAP
    status[known] = track.column("mode")[before[known]].astype(np.int64)

    row, following = track.values[before[known]], track.values[after[known]]
    step_s = (track.t_ns[after[known]] - track.t_ns[before[known]]) * 1e-9
    since_s = (t_ns[known] - track.t_ns[before[known]]) * 1e-9
    share = np.divide(since_s, step_s, out=np.zeros(len(since_s)), where=step_s > 0.0)
    result.lat_rad[known], result.lon_rad[known], result.alt_m[known] = _position(row, following, step_s, share).T
    first, last = _attitude(row), _attitude(following)
    turned = Rotation.from_rotvec(share[:, None] * (last * first.inv()).as_rotvec()) * first
    result.q_n_from_b[known] = turned.as_quat(canonical=True, scalar_first=True)
    result.rpy_rad[known] = turned.as_euler("ZYX")[:, ::-1]
    pose = np.r_[0:3, 6:9]
    result.covariance[known] = covariance[known][:, pose[:, None], pose]
    return result


def _navigating(track: Track) -> Track:
    kept = (track.column("mode") != Mode.ALIGNING) & np.isfinite(track.values[:, : TRACK["yaw_rad"] + 1]).all(axis=1)
    return Track(track.t_ns[kept], track.values[kept])


def _attitude(rows: FloatArray) -> Rotation:
    return Rotation.from_euler("ZYX", rows[:, TRACK["yaw_rad"] : TRACK["roll_rad"] - 1 : -1])


def _position(row: FloatArray, following: FloatArray, step_s: FloatArray, share: FloatArray) -> FloatArray:
    """Latitude, longitude (rad) and height (m), (n, 3), at a share of the way between rows."""
    lat, lon, alt = row[:, :3].T
    meridian, transverse = np.array([radii_m(one) for one in lat]).reshape(-1, 2).T
    m_per_unit = np.column_stack([meridian + alt, (transverse + alt) * np.cos(lat), -np.ones(len(lat))])
    apart = following[:, :3] - row[:, :3]
    apart[:, 1] = np.mod(apart[:, 1] + np.pi, 2 * np.pi) - np.pi
    velocity = slice(TRACK["vn_mps"], TRACK["vd_mps"] + 1)
    s, step = share[:, None], step_s[:, None]
    moved_m = (
        s**2 * (3.0 - 2.0 * s) * apart * m_per_unit
        + s * (1.0 - s) ** 2 * step * row[:, velocity]
        - s**2 * (1.0 - s) * step * following[:, velocity]
    )
    return np.asarray(np.column_stack([lat, lon, alt]) + moved_m / m_per_unit)


def covariance_at(solution: Solution, t_ns: TimeArray) -> tuple[FloatArray, npt.NDArray[np.bool_]]:
    """Covariance (n, 9, 9) of position, velocity and attitude at instants, and where the nodes reach, (n,).

    Linear between nodes that are near enough, and so positive; beyond the first or last by less than
    ``LONGEST_NODE_STEP_S`` that node's own. Where the nodes do not reach, its values mean nothing.
    """
    node_t_ns = solution.t_ns
    if not len(node_t_ns):
        return np.full((len(t_ns), 9, 9), np.nan), np.zeros(len(t_ns), np.bool_)
    before = np.clip(np.searchsorted(node_t_ns, t_ns, side="right") - 1, 0, len(node_t_ns) - 1)
    after = np.clip(np.searchsorted(node_t_ns, t_ns), 0, len(node_t_ns) - 1)
    between_ns = node_t_ns[after] - node_t_ns[before]
    beyond_ns = np.maximum(node_t_ns[0] - t_ns, t_ns - node_t_ns[-1])
    reached = np.maximum(between_ns, beyond_ns) <= LONGEST_NODE_STEP_S * 1e9
    share = np.divide(t_ns - node_t_ns[before], between_ns, out=np.zeros(len(t_ns)), where=between_ns > 0)
    s = share[:, None, None]
    return (1.0 - s) * solution.covariance[before] + s * solution.covariance[after], reached
