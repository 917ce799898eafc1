"""The mobile-mapping paper's filter (seed 3): its equations by themselves, and drives with known truth."""

from __future__ import annotations

import functools
import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from core.earth import ecef_from_geodetic, matrix_e_from_n, ned_offset_m
from core.errors import InvalidInputError
from core.measurements import GNSS
from core.navigation import ecef_model as model
from core.navigation.ecef_filter import EcefConfig, EcefTuning, GivenAttitude, run
from core.navigation.track import Mode
from core.past import BodySamples
from core.rotation import matrix_from_quaternion, wrap_angle_rad
from core.simulation.scenarios import simulate
from core.simulation.sensors import gauss_markov

LAT, LON, ALT = 0.93, -0.11, 80.0


def quaternion(rpy_rad):
    return Rotation.from_euler("ZYX", rpy_rad[::-1]).as_quat(scalar_first=True)


def some_state():
    x = np.zeros(model.N_STATES)
    x[:3] = ecef_from_geodetic(LAT, LON, ALT)
    x[3:6] = matrix_e_from_n(LAT, LON) @ [11.0, -7.0, 0.6]
    x[6:10] = quaternion([0.03, -0.05, 2.1])
    x[10] = 9.81
    return x


F_B, OMEGA_B = np.array([0.7, -2.3, -9.6]), np.array([0.05, -0.03, 0.4])
GIVEN = quaternion([0.05, -0.03, 2.06]), quaternion([0.052, -0.031, 2.064])
STEP = (F_B, OMEGA_B, *GIVEN, 0.98, 0.01)


def differences(function, x):
    """Central differences; steps in proportion to what each state is, since x, y, z are of 6e6 m."""
    columns = []
    for i in range(model.N_STATES):
        step = np.zeros(model.N_STATES)
        step[i] = 1.0 if i < 3 else 1e-5
        columns.append((function(x + step) - function(x - step)) / (2 * step[i]))
    return np.array(columns).T


def test_the_transition_is_the_derivative_of_the_dynamics():
    found = model.transition(some_state(), *STEP)
    expected = differences(lambda x: model.propagate(x, *STEP), some_state())
    # Differences of 6e6 m over 1e-5 keep 1e-4 of a metre a unit; the turning of north with position is left out
    # (1.6e-7 rad a metre: 2e-8 m/s here), and 10 ms make the neglected part of the centripetal term 1e-8.
    assert found[3:] == pytest.approx(expected[3:], abs=2e-6)
    assert found[:3] == pytest.approx(expected[:3], abs=2e-4)


def test_the_measurements_jacobian_is_their_derivative():
    lever = np.array([0.8, -0.4, -1.5])
    found = model.measurement_jacobian(some_state(), lever, OMEGA_B)
    expected = differences(lambda x: model.measured(x, lever, OMEGA_B), some_state())
    assert found[3:] == pytest.approx(expected[3:], abs=1e-6)
    assert found[:3] == pytest.approx(expected[:3], abs=2e-4)


def test_rotations_and_quaternions_are_each_others_derivative():
    q = quaternion([0.03, -0.05, 2.1])
    phi = np.array([2e-6, -1e-6, 3e-6])
    turned = (Rotation.from_rotvec(phi) * Rotation.from_quat(q, scalar_first=True)).as_quat(scalar_first=True)
    assert model.quaternion_by_rotation(q) @ phi == pytest.approx(turned - q, abs=1e-11)
    there_and_back = model.navigation_jacobian(some_state())[6:, 6:10] @ model.quaternion_by_rotation(
        some_state()[6:10]
    )
    assert there_and_back == pytest.approx(np.eye(3), abs=1e-12)


def test_eq_4_to_6_against_an_integrator():
    """The paper's body-frame equation as it is written, integrated finely in a turn, against one step of 10 ms."""
    x, dt_s = some_state(), 0.01
    C_e_from_n = matrix_e_from_n(LAT, LON)

    def rates(_t, y):
        v_b, q = y[:3], y[3:7]
        C_n_from_b = matrix_from_quaternion(q / np.linalg.norm(q))
        v_b_dot = F_B - np.cross(OMEGA_B, v_b) + C_n_from_b.T @ [0.0, 0.0, x[10]]
        q_dot = 0.5 * model.quaternion_product(q, np.array([0.0, *OMEGA_B]))
        return np.concatenate([v_b_dot, q_dot, C_e_from_n @ C_n_from_b @ v_b])

    v_b = matrix_from_quaternion(x[6:10]).T @ C_e_from_n.T @ x[3:6]
    end = solve_ivp(rates, (0.0, dt_s), [*v_b, *x[6:10], 0.0, 0.0, 0.0], rtol=1e-12, atol=1e-12).y[:, -1]
    after = model.propagate(x, *STEP)
    # The step's own error is (omega dt)^3 v = 1e-6 m/s, and half of a jerk times dt^3 in position.
    assert after[3:6] == pytest.approx(C_e_from_n @ matrix_from_quaternion(end[3:7]) @ end[:3], abs=3e-6)
    assert after[:3] - x[:3] == pytest.approx(end[7:], abs=1e-6)


def test_the_attitude_follows_the_sensor_and_forgets_its_error():
    x = some_state()
    x[6:10] = quaternion([0.05, -0.03, 2.16])  # a tenth of a radian from what the sensor says
    for _ in range(200):
        x = model.propagate(x, F_B, np.zeros(3), GIVEN[0], GIVEN[0], 0.99, 0.01)
    off = Rotation.from_quat(x[6:10], scalar_first=True) * Rotation.from_quat(GIVEN[0], scalar_first=True).inv()
    assert off.magnitude() == pytest.approx(0.1 * 0.99**200, rel=0.01)


RATE_HZ = 50.0


@functools.cache
def drive():
    """Streets, with an outage of 60 s from 150 s on."""
    return simulate("outages", 1, 240.0, RATE_HZ)


def samples(m):
    none = np.zeros(len(m.imu_t_ns))
    return BodySamples(m.imu_t_ns, m.f_s, m.omega_s, none, none)


SD_RAD = math.radians(2.0)


def ahrs(sd_rad=SD_RAD, seed=7):
    """A sensor's own attitude: the truth turned by an error that hangs together in time."""
    truth, rng = drive().trajectory, np.random.default_rng(seed)
    turn = np.column_stack([gauss_markov(len(truth.t_s), sd_rad, 60.0, 1.0 / RATE_HZ, rng) for _ in range(3)])
    q = Rotation.from_rotvec(turn) * Rotation.from_euler("ZYX", truth.rpy_rad[:, ::-1])
    return GivenAttitude.by_ahrs(drive().measurements.imu_t_ns, q.as_quat(scalar_first=True), EcefTuning())


def filtered(m=None, attitude=None, **config):
    m = m or drive().measurements
    return run(samples(m), m.gnss_t_ns, m.gnss, attitude or ahrs(), EcefConfig(**config))


@functools.cache
def usual():
    return filtered()


def errors(track):
    """Truth minus estimate at each row: position n, e, d (m) and yaw (rad)."""
    truth = drive().trajectory
    at = np.searchsorted(drive().measurements.imu_t_ns, track.t_ns)
    origin = (float(truth.lat_rad[0]), float(truth.lon_rad[0]), 0.0)
    true = ned_offset_m(truth.lat_rad[at], truth.lon_rad[at], truth.alt_m[at], origin)
    found = ned_offset_m(*(track.column(name) for name in ("lat_rad", "lon_rad", "alt_m")), origin)
    return true - found, wrap_angle_rad(truth.rpy_rad[at, 2] - track.column("yaw_rad"))


def spread(track):
    return np.column_stack([track.column(name) for name in ("sd_n_m", "sd_e_m", "sd_d_m")])


def test_errors_are_as_stated_in_and_out_of_an_outage():
    ratios, yaw_ratios = [], []
    for seed in range(3):
        solution, counts = filtered(attitude=ahrs(seed=seed))
        error, yaw = errors(solution.track)
        coasting = solution.track.column("mode") == Mode.COASTING
        ratios.append(error / spread(solution.track))
        yaw_ratios.append(yaw / solution.track.column("sd_yaw_rad"))
        assert counts["gnss_position.fused"] == counts["gnss_velocity.fused"] + 1  # the first one starts the filter
        # White fixes of 1.5 m and 2.7 m up, averaged by the filter; then a tilt error of a fraction of 2 degrees.
        assert np.sqrt(np.mean(error[~coasting] ** 2, axis=0)).max() < 1.5
        assert 2.0 < np.abs(error[coasting]).max() < 600.0
    # The errors of a drive hang together for minutes: three drives are a handful of independent errors.
    within = np.mean(np.abs(np.concatenate(ratios)) < 3.0)
    assert within > 0.99
    assert 0.4 < np.sqrt(np.mean(np.concatenate(ratios) ** 2)) < 1.5
    assert 0.4 < np.sqrt(np.mean(np.concatenate(yaw_ratios) ** 2)) < 1.5


def test_a_better_attitude_coasts_better():
    def end_m(sd_rad):
        tuning = EcefTuning(ahrs_sd_rad=sd_rad)
        ends = []
        for seed in range(2):
            solution, _ = filtered(attitude=ahrs(sd_rad, seed=seed), own=tuning)
            coasting = solution.track.column("mode") == Mode.COASTING
            ends.append(np.hypot(*errors(solution.track)[0][coasting][-1, :2]))
        return np.mean(ends)

    assert end_m(math.radians(0.2)) < 0.5 * end_m(math.radians(3.0))


def test_three_satellites_are_as_good_as_none():
    m = drive().measurements
    few = m.gnss.copy()
    blocked = (m.gnss_t_ns > m.gnss_t_ns[0] + 60e9) & (m.gnss_t_ns < m.gnss_t_ns[0] + 90e9)
    few[blocked, GNSS["satellites"]] = 3.0
    few[blocked, GNSS["lat_rad"]] += 1e-3  # 6 km off: it would show
    solution, counts = filtered(replace(m, gnss=few))
    without, _ = filtered(replace(m, gnss=m.gnss[~blocked], gnss_t_ns=m.gnss_t_ns[~blocked]))
    assert counts["gnss_position.rejected_range"] == np.count_nonzero(blocked)
    assert np.array_equal(solution.track.values, without.track.values, equal_nan=True)
    track = solution.track
    inside = (track.t_ns > m.gnss_t_ns[0] + 63e9) & (track.t_ns < m.gnss_t_ns[0] + 90e9)
    assert set(track.column("mode")[inside]) == {Mode.COASTING}
    assert track.column("gnss_used")[inside].sum() == 0


def test_a_receiver_that_does_not_count_satellites_is_believed():
    m = drive().measurements
    silent = m.gnss.copy()
    silent[:, GNSS["satellites"]] = np.nan
    found, expected = filtered(replace(m, gnss=silent))[0].track.values, usual()[0].track.values
    assert np.array_equal(found, expected, equal_nan=True)


def test_a_receiver_without_velocity_corrects_the_position_alone():
    m = drive().measurements
    bare = m.gnss.copy()
    bare[:, GNSS["vn_mps"] : GNSS["vd_mps"] + 1] = np.nan
    solution, counts = filtered(replace(m, gnss=bare))
    assert "gnss_velocity.fused" not in counts
    error, _ = errors(solution.track)
    settled = (solution.track.column("mode") == Mode.AIDED) & (solution.track.t_ns > m.imu_t_ns[0] + 30e9)
    assert np.sqrt(np.mean(error[settled] ** 2, axis=0)).max() < 3.0  # 1.5 m fixes and their slope for velocity


def test_speed_and_course_serve_as_velocity():
    m = drive().measurements
    other = m.gnss.copy()
    north, east = other[:, GNSS["vn_mps"]], other[:, GNSS["ve_mps"]]
    other[:, GNSS["speed_mps"]], other[:, GNSS["course_rad"]] = np.hypot(north, east), np.arctan2(east, north)
    other[:, GNSS["vn_mps"] : GNSS["vd_mps"] + 1] = np.nan
    solution, counts = filtered(replace(m, gnss=other))
    assert 0 < counts["gnss_velocity.fused"] < counts["gnss_position.fused"]  # not when standing
    error, _ = errors(solution.track)
    aided = solution.track.column("mode") == Mode.AIDED
    assert np.sqrt(np.mean(error[aided] ** 2, axis=0)).max() < 2.0


def test_lever_arms_give_the_bodys_own_place():
    m, truth = drive().measurements, drive().trajectory
    antenna = np.array([1.2, -0.3, -1.4])
    moved = m.gnss.copy()
    row = np.searchsorted(m.imu_t_ns, m.gnss_t_ns)
    turns = Rotation.from_euler("ZYX", truth.rpy_rad[row, ::-1])
    arm_n, arm_v_n = turns.apply(antenna), turns.apply(np.cross(truth.omega_b[row], antenna))
    moved[:, GNSS["lat_rad"]] += arm_n[:, 0] / 6.36e6
    moved[:, GNSS["lon_rad"]] += arm_n[:, 1] / (6.39e6 * np.cos(moved[:, GNSS["lat_rad"]]))
    moved[:, GNSS["alt_m"]] -= arm_n[:, 2]
    moved[:, GNSS["vn_mps"] : GNSS["vd_mps"] + 1] += arm_v_n
    with_arm, _ = filtered(replace(m, gnss=moved), antenna_lever_b_m=tuple(antenna))
    plain, _ = usual()
    aided = plain.track.column("mode") == Mode.AIDED
    apart = errors(with_arm.track)[0][aided] - errors(plain.track)[0][aided]
    # The attitude's error of up to 6 degrees turns the arm of 1.9 m, and what it teaches changes the rest a little.
    assert np.abs(apart).max() < 0.5
    assert np.abs(apart.mean(axis=0)).max() < 0.05


def test_holes_of_the_attitude_are_bridged_by_the_gyroscopes():
    given = ahrs()
    t_s = (given.t_ns - given.t_ns[0]) * 1e-9
    kept = ~((t_s > 100.0) & (t_s < 110.0))
    holed = GivenAttitude(given.t_ns[kept], given.q_n_from_b[kept], given.sd_rad[kept], given.mount_rad[kept])
    solution, _ = filtered(attitude=holed)
    error, yaw = errors(solution.track)
    inside = (solution.track.t_ns > given.t_ns[0] + 100e9) & (solution.track.t_ns < given.t_ns[0] + 112e9)
    assert np.abs(error[inside]).max() < 3.0
    assert np.abs(yaw[inside]).max() < math.radians(7.0)  # the sensor's own, and 10 s of 200 deg/h


def test_it_starts_anew_after_a_hole_in_the_samples():
    m = drive().measurements
    t_s = (m.imu_t_ns - m.imu_t_ns[0]) * 1e-9
    kept = ~((t_s > 60.0) & (t_s < 80.0))
    holed = replace(m, imu_t_ns=m.imu_t_ns[kept], f_s=m.f_s[kept], omega_s=m.omega_s[kept])
    solution, _ = filtered(holed)
    after = solution.track.t_ns > m.imu_t_ns[0] + 85e9
    aided = solution.track.column("mode") == Mode.AIDED
    assert np.abs(errors(solution.track)[0][after & aided] / spread(solution.track)[after & aided]).max() < 5.0
    assert not np.any((solution.track.t_ns > m.imu_t_ns[0] + 60.5e9) & (solution.track.t_ns < m.imu_t_ns[0] + 79e9))


def test_covariance_is_symmetric_and_positive_and_its_nodes_are_the_rows():
    solution, _ = usual()
    assert np.allclose(solution.covariance, solution.covariance.transpose(0, 2, 1), rtol=1e-9, atol=1e-12)
    assert np.linalg.eigvalsh(solution.covariance).min() > 0.0
    rows = np.searchsorted(solution.track.t_ns, solution.t_ns)
    assert np.array_equal(solution.track.t_ns[rows], solution.t_ns)
    deviation = np.sqrt(np.diagonal(solution.covariance, axis1=1, axis2=2))
    assert deviation[:, :3] == pytest.approx(spread(solution.track)[rows])
    assert deviation[:, 8] == pytest.approx(solution.track.column("sd_yaw_rad")[rows])
    assert np.diff(solution.t_ns).max() <= 0.11e9


def test_what_it_cannot_work_without_is_named():
    none = GivenAttitude(np.empty(0, np.int64), np.empty((0, 4)), np.empty((0, 3)), np.empty((0, 2)))
    with pytest.raises(InvalidInputError, match="attitude"):
        filtered(attitude=none)
    m = drive().measurements
    with pytest.raises(InvalidInputError, match="two or more"):
        filtered(replace(m, imu_t_ns=m.imu_t_ns[:1], f_s=m.f_s[:1], omega_s=m.omega_s[:1]))
