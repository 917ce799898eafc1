"""Poses at any instants: against scipy's slerp, against the truth of a drive, and where there are none."""

from __future__ import annotations

import functools
import math

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial.transform import Rotation, Slerp

from core.earth import ned_offset_m
from core.navigation.poses import PoseStatus, covariance_at, poses_at
from core.navigation.solution import SLOW_COLUMNS, Solution
from core.navigation.track import TRACK, TRACK_COLUMNS, Mode, Track
from core.simulation.scenarios import simulate

START_NS = 1_700_000_000_000_000_000


@functools.cache
def truth():
    return simulate("city", 3, 150.0, 200.0).trajectory


def solution_of(every):
    """The truth itself as a solution with a row each ``every`` samples; covariance grows by its node's number."""
    t = truth()
    rows = np.arange(0, len(t.t_s), every)
    values = np.full((len(rows), len(TRACK_COLUMNS)), np.nan)
    for name in ("lat_rad", "lon_rad", "alt_m"):
        values[:, TRACK[name]] = getattr(t, name)[rows]
    values[:, TRACK["vn_mps"] : TRACK["vd_mps"] + 1] = t.v_n[rows]
    values[:, TRACK["roll_rad"] : TRACK["yaw_rad"] + 1] = t.rpy_rad[rows]
    values[:, TRACK["mode"]] = Mode.AIDED
    t_ns = START_NS + np.rint(t.t_s[rows] * 1e9).astype(np.int64)
    nodes = t_ns[:: max(20 // every, 1)]
    covariance = np.eye(9) * (1.0 + np.arange(len(nodes)))[:, None, None]
    slow = np.full((len(nodes), len(SLOW_COLUMNS)), np.nan)
    return Solution(Track(t_ns, values), nodes, covariance, slow, slow)


def at_s(*seconds):
    return START_NS + np.rint(np.array(seconds) * 1e9).astype(np.int64)


def test_rows_are_given_as_they_are():
    solution = solution_of(2)
    found = poses_at(solution, solution.track.t_ns)
    assert set(found.status) == {PoseStatus.AIDED}
    assert np.array_equal(found.lat_rad, solution.track.column("lat_rad"))
    assert np.array_equal(found.alt_m, solution.track.column("alt_m"))
    assert np.unwrap(found.rpy_rad[:, 2]) == pytest.approx(np.unwrap(solution.track.column("yaw_rad")), abs=1e-9)
    assert np.linalg.norm(found.q_n_from_b, axis=1) == pytest.approx(np.ones(len(found.t_ns)), abs=1e-12)
    assert found.q_n_from_b[:, 0].min() >= 0.0


def test_attitude_is_scipys_slerp_and_position_its_hermite_spline():
    solution = solution_of(20)
    track = solution.track
    rng = np.random.default_rng(1)
    instants = np.sort(rng.integers(track.t_ns[0], track.t_ns[-1], 500))
    found = poses_at(solution, instants)
    turns = Rotation.from_euler("ZYX", track.values[:, TRACK["yaw_rad"] : TRACK["roll_rad"] - 1 : -1])
    expected = Slerp(track.t_ns - START_NS, turns)(instants - START_NS)
    difference = Rotation.from_quat(found.q_n_from_b, scalar_first=True) * expected.inv()
    assert difference.magnitude().max() < 1e-7  # its arc cosine near 1 keeps half of the digits
    spline = CubicHermiteSpline((track.t_ns - START_NS) * 1e-9, track.column("alt_m"), -track.column("vd_mps"))
    assert found.alt_m == pytest.approx(spline((instants - START_NS) * 1e-9), abs=1e-8)


@pytest.mark.parametrize(("every", "position_m", "attitude_deg"), [(2, 1e-3, 0.02), (20, 0.02, 0.6)])
def test_odd_instants_against_the_truth(every, position_m, attitude_deg):
    """Rows at 100 and 10 Hz, instants on samples in between: in turns of 9 m, hard braking and over bumps."""
    t = truth()
    among = np.arange(1, len(t.t_s) - every, 7)
    found = poses_at(solution_of(every), at_s(*t.t_s[among]))
    origin = (float(t.lat_rad[0]), float(t.lon_rad[0]), 0.0)
    off = ned_offset_m(found.lat_rad, found.lon_rad, found.alt_m, origin)
    off -= ned_offset_m(t.lat_rad[among], t.lon_rad[among], t.alt_m[among], origin)
    turn = Rotation.from_euler("ZYX", found.rpy_rad[:, ::-1])
    turn *= Rotation.from_euler("ZYX", t.rpy_rad[among][:, ::-1]).inv()
    # A cubic errs by the fourth derivative dt^4 / 384, slerp by the angular acceleration dt^2 / 8: bumps give most.
    assert np.abs(off).max() < position_m
    assert math.degrees(turn.magnitude().max()) < attitude_deg


def test_covariance_is_interpolated_between_its_nodes():
    solution = solution_of(2)
    node_s = (solution.t_ns[5:7] - START_NS) * 1e-9
    instants = at_s(node_s[0], node_s[0] + 0.25 * (node_s[1] - node_s[0]), node_s[1])
    found = poses_at(solution, instants)
    assert found.covariance[:, 0, 0] == pytest.approx([6.0, 6.25, 7.0])
    assert found.covariance.shape == (3, 6, 6)
    everywhere, reached = covariance_at(solution, solution.track.t_ns)
    assert reached.all()
    assert np.linalg.eigvalsh(everywhere).min() > 0.0


def test_outside_and_in_gaps_there_is_no_pose():
    whole = solution_of(2)
    t_s = (whole.track.t_ns - START_NS) * 1e-9
    kept = ~((t_s > 50.0) & (t_s < 55.0))
    track = Track(whole.track.t_ns[kept], whole.track.values[kept].copy())
    track.values[track.t_ns < at_s(10.0)[0], TRACK["mode"]] = Mode.ALIGNING
    track.values[track.t_ns > at_s(100.0)[0], TRACK["mode"]] = Mode.COASTING
    solution = Solution(track, whole.t_ns, whole.covariance, whole.slow, whole.slow_sd)
    found = poses_at(solution, at_s(-5.0, 5.0, 20.003, 50.0, 52.0, 55.0, 120.003, 149.999, 150.0, 150.001, 1e4))
    expected = [*["OUTSIDE"] * 2, "AIDED", "AIDED", "GAP", "AIDED", *["COASTING"] * 3, *["OUTSIDE"] * 2]
    assert [PoseStatus(value).name for value in found.status] == expected
    without = found.status >= PoseStatus.OUTSIDE
    for values in (found.lat_rad, found.alt_m, found.q_n_from_b, found.rpy_rad, found.covariance):
        flat = values.reshape(len(values), -1)
        assert np.isnan(flat[without]).all()
        assert np.isfinite(flat[~without]).all()


def test_instants_may_come_in_any_order_and_across_the_date_line():
    solution = solution_of(20)
    solution.track.values[:, TRACK["lon_rad"]] += math.pi - solution.track.values[400, TRACK["lon_rad"]]
    wrapped = np.mod(solution.track.values[:, TRACK["lon_rad"]] + math.pi, 2 * math.pi) - math.pi
    solution.track.values[:, TRACK["lon_rad"]] = wrapped
    seconds = np.array([60.031, 12.34, 40.02, 40.01])
    found = poses_at(solution, at_s(*seconds))
    assert np.array_equal(poses_at(solution, at_s(*sorted(seconds))).lat_rad, found.lat_rad[np.argsort(seconds)])
    everywhere = poses_at(solution, at_s(*np.arange(35.0, 45.0, 0.01)))
    steps = np.abs(np.mod(np.diff(everywhere.lon_rad) + math.pi, 2 * math.pi) - math.pi)
    assert steps.max() < 1e-7  # 0.5 m in 10 ms


def test_a_solution_without_rows_has_no_poses():
    solution = solution_of(2)
    none = Solution(
        Track(solution.track.t_ns[:0], solution.track.values[:0]),
        solution.t_ns[:0], solution.covariance[:0], solution.slow[:0], solution.slow_sd[:0],
    )  # fmt: skip
    assert set(poses_at(none, at_s(1.0, 2.0)).status) == {PoseStatus.OUTSIDE}
