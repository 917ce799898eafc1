"""The mounting is found for a box that sits in any way, as surely as is told, and not where nothing is to be found."""

from __future__ import annotations

import functools
import math
from dataclasses import replace

import numpy as np
import pytest

from core.measurements import GNSS
from core.navigation.mounting import MountingFinder
from core.navigation.mounting_evidence import (
    REST,
    SUMS,
    MountingTuning,
    add_motion,
    add_rest,
    carried_force,
    regress,
)
from core.rotation import matrix_from_rpy, rpy_from_matrix
from core.simulation.scenarios import simulate

G = 9.81
S = 10**9
RATE_HZ = 50.0
ANY_WAY_DEG = [
    (0, 0, 90),
    (0, 0, 180),
    (170, 20, -100),
    (90, 0, 45),
    (-90, 30, 0),
    (5, 85, 20),
    (180, 0, 0),
    (8, -5, 30),
]
TUNING = MountingTuning()


def observed(C_b_from_m, accel_b, bias_m=(0.0, 0.0, 0.0), noise_mps2=0.0, rest_s=0, seed=1):
    """Sums of accelerations (n, 2) along and across as a box mounted so feels them on a level road."""
    sums, rest = np.zeros(SUMS), np.zeros(REST)
    rng = np.random.default_rng(seed)
    for _ in range(rest_s):
        add_rest(rest, C_b_from_m.T @ [0.0, 0.0, -G], 60.0)
    for forward, right in accel_b:
        force_m = C_b_from_m.T @ [forward, right, -G] + np.array(bias_m) + noise_mps2 * rng.standard_normal(3)
        add_motion(sums, force_m, np.array([forward, right]), 1.0, 1e5)
    return regress(sums, rest, TUNING)


PULLS_AWAY_AND_BRAKES = np.array([[1.5, 0.0], [1.0, 0.2], [0.0, -1.0], [-2.0, 0.0], [-1.0, 1.0], [0.5, -0.2]])


@pytest.mark.parametrize("rpy_deg", ANY_WAY_DEG)
def test_clean_observations_give_any_mounting_back(rpy_deg):
    C_b_from_m = matrix_from_rpy(*np.radians(rpy_deg))
    evidence = observed(C_b_from_m, PULLS_AWAY_AND_BRAKES)
    assert pytest.approx(C_b_from_m, abs=1e-3) == evidence.C_b_from_m  # 3 rounds of level and yaw, not a closed form
    assert evidence.yaw_sd_rad < 0.2


def test_a_bias_tilts_but_does_not_turn():
    C_b_from_m = matrix_from_rpy(0.4, -0.7, 2.0)
    evidence = observed(C_b_from_m, PULLS_AWAY_AND_BRAKES, bias_m=C_b_from_m.T @ [0.5, -0.3, 0.0])
    roll, pitch, yaw = rpy_from_matrix(evidence.C_b_from_m @ C_b_from_m.T)
    assert abs(yaw) < 0.02  # to first order nothing, to second the product of two tilts of 3 deg
    assert math.hypot(roll, pitch) == pytest.approx(math.hypot(0.5, 0.3) / G, rel=0.1)


def test_evenly_driven_seconds_say_where_down_is_and_nothing_of_the_yaw():
    evidence = observed(matrix_from_rpy(1.0, 0.0, 2.0), np.zeros((20, 2)))
    assert evidence.yaw_sd_rad == math.inf
    assert evidence.C_b_from_m[2] == pytest.approx(matrix_from_rpy(1.0, 0.0, 2.0)[2], abs=1e-9)
    assert 0.02 < evidence.tilt_sd_rad < 0.1
    assert observed(np.eye(3), np.zeros((0, 2))).tilt_sd_rad == math.inf


def test_the_stated_sd_is_that_of_noise():
    errors, told = [], []
    for seed in range(200):
        accel = np.random.default_rng(seed).normal(0.0, 0.8, (20, 2))
        evidence = observed(np.eye(3), accel, noise_mps2=0.4, rest_s=5, seed=seed)
        errors.append(rpy_from_matrix(evidence.C_b_from_m)[2])
        told.append(evidence.yaw_sd_rad)
    z = np.array(errors) / np.array(told)
    # Its share of the sd is floor; sd of 200 draws is good to 5 %.
    assert 0.75 < z.std() < 1.15
    assert abs(z.mean()) < 0.25


def test_the_force_is_carried_to_the_middle_of_its_window():
    rate_hz, turn_radps = 100, 0.4
    t_s = np.arange(0, 401) / rate_hz
    # Turning about down at 0.4 rad/s under a force that stays north, with a gyroscope bias about x.
    angle = turn_radps * (t_s - 2.0)
    imu = np.column_stack([2.0 * np.cos(angle), -2.0 * np.sin(angle), np.full(len(t_s), -G)] + [np.zeros(len(t_s))] * 3)
    imu[:, 5] = turn_radps
    t_ns = np.rint(t_s * S).astype(np.int64)
    for knots_s, area_s in (((1.0, 3.0), 2.0), ((0.0, 2.0, 4.0), 2.0)):
        knots_ns = np.array([round(s * S) for s in knots_s])
        force, area, hole_s = carried_force(t_ns, imu, knots_ns)
        assert area == pytest.approx(area_s, rel=1e-3)
        assert hole_s == pytest.approx(0.01)
        # Not averaged away by the turn: a mean in the turning axes would be 3 % to 10 % short.
        assert force == pytest.approx([2.0, 0.0, -G], abs=2e-3)
        tilted = imu.copy()
        tilted[:, 3] += 0.02
        force, _, _ = carried_force(t_ns, tilted, knots_ns)
        assert force == pytest.approx([2.0, 0.0, -G], abs=0.04)  # at the ends gravity leaks by ten times that


def test_a_hole_in_the_samples_is_told():
    t_ns = np.array([0, 1, 2, 30, 31], dtype=np.int64) * (S // 10)
    assert carried_force(t_ns, np.zeros((5, 6)), np.array([0, 3 * S]))[2] == pytest.approx(2.8)
    assert carried_force(t_ns, np.zeros((5, 6)), np.array([-S, S]))[2] >= 1.0  # begins before the samples
    assert carried_force(t_ns[:1], np.zeros((1, 6)), np.array([0, S]))[2] == math.inf


# Over simulated drives


@functools.cache
def simulated(scenario, seed, duration_s):
    return simulate(scenario, seed, duration_s, RATE_HZ)


def positions_only(m):
    gnss = m.gnss.copy()
    gnss[:, [GNSS["vn_mps"], GNSS["ve_mps"], GNSS["vd_mps"]]] = math.nan
    return replace(m, gnss=gnss)


def judged(m, rpy_deg=(0, 0, 0)):
    """A finder over measurements of a box turned so: evidence at each second, and when it was found."""
    C_m_from_b = matrix_from_rpy(*np.radians(rpy_deg)).T
    f, omega = m.f_s @ C_m_from_b.T, m.omega_s @ C_m_from_b.T
    finder, seconds, begin, begin_fix = MountingFinder(), [], 0, 0
    while begin < len(m.imu_t_ns):
        boundary_ns = finder.boundary_ns(int(m.imu_t_ns[begin]))
        end, end_fix = (int(np.searchsorted(t_ns, boundary_ns)) for t_ns in (m.imu_t_ns, m.gnss_t_ns))
        fixes = slice(begin_fix, end_fix)
        finder.add(m.imu_t_ns[begin:end], f[begin:end], omega[begin:end], (m.gnss_t_ns[fixes], m.gnss[fixes]))
        begin, begin_fix = end, end_fix
        if begin < len(m.imu_t_ns):
            turn = finder.evaluate(int(m.imu_t_ns[begin]))
            found = turn is not None and not finder.contradicted
            evidence = finder.evidence()
            error = evidence.C_b_from_m @ C_m_from_b
            seconds.append(
                (
                    (boundary_ns - int(m.imu_t_ns[0])) * 1e-9,
                    math.acos(min(1.0, error[2, 2])),
                    math.atan2(error[1, 0], error[0, 0]),
                    evidence.tilt_sd_rad,
                    evidence.yaw_sd_rad,
                    finder.contradicted,
                    found,
                )
            )
    return finder, np.array(seconds, dtype=float)


T_S, TILT, YAW, TILT_SD, YAW_SD, CONTRADICTED, FOUND = range(7)


@pytest.mark.parametrize("positions", [False, True])
@pytest.mark.parametrize("rpy_deg", ANY_WAY_DEG)
def test_it_is_found_whichever_way_the_box_sits(rpy_deg, positions):
    drive = simulated("city", 1, 240.0)
    m = positions_only(drive.measurements) if positions else drive.measurements
    finder, seconds = judged(m, rpy_deg)
    found = np.flatnonzero(seconds[:, FOUND])
    assert len(found) == 1
    moves_s = drive.trajectory.t_s[np.argmax(drive.trajectory.speed_mps > 3.0)]
    # A pull-away and a brake or bend; 30 deg off have to be told from 12.
    assert seconds[found[0], T_S] - moves_s < (40.0 if positions else 25.0)
    roll, pitch, yaw = rpy_from_matrix(finder.C_b_from_m @ matrix_from_rpy(*np.radians(rpy_deg)).T)
    assert abs(yaw) < 3 * 0.12
    assert math.hypot(roll, pitch) < math.radians(4.0)  # bias of 6 mg, streets of some per cent


def test_no_way_of_sitting_is_special():
    m = simulated("city", 1, 240.0).measurements
    _, upright = judged(m)
    for rpy_deg in ANY_WAY_DEG:
        _, turned = judged(m, rpy_deg)
        assert turned[-1, [YAW, YAW_SD, TILT_SD]] == pytest.approx(upright[-1, [YAW, YAW_SD, TILT_SD]], abs=1e-3)


def test_the_stated_sd_holds_over_drives():
    z_yaw, z_tilt = [], []
    for seed in range(1, 9):
        for m in (
            simulated("city", seed, 240.0).measurements,
            positions_only(simulated("city", seed, 240.0).measurements),
        ):
            _, seconds = judged(m)
            known = seconds[np.isfinite(seconds[:, YAW_SD]) & (seconds[:, YAW_SD] < 0.3)][::10]
            z_yaw.append(known[:, YAW] / known[:, YAW_SD])
            z_tilt.append(known[:, TILT] / known[:, TILT_SD])
    z_yaw, z_tilt = np.concatenate(z_yaw), np.concatenate(z_tilt)
    assert np.mean(np.abs(z_yaw) < 3.0) >= 0.99
    assert np.sqrt(np.mean(z_yaw**2)) < 1.2
    assert np.sqrt(np.mean(z_tilt**2)) < 1.2 * math.sqrt(2.0)  # two axes


@pytest.mark.parametrize("scenario", ["city", "highway", "parking", "tunnel_crash"])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_box_that_sits_as_it_should_is_never_contradicted(scenario, seed):
    drive = simulated(scenario, seed, 430.0 if scenario == "tunnel_crash" else 240.0)
    for m in (drive.measurements, positions_only(drive.measurements)):
        _, seconds = judged(m, (4, -4, 5))  # fitted by eye
        assert not seconds[:, CONTRADICTED].any()
        assert not seconds[:, FOUND].any()


def test_fixes_that_jump_turn_nothing():
    drive = simulated("city", 2, 200.0)
    gnss = drive.measurements.gnss.copy()
    rng = np.random.default_rng(3)
    hit = rng.random(len(gnss)) < 0.1
    gnss[hit, GNSS["lat_rad"]] += rng.normal(0.0, 40.0, hit.sum()) / 6.4e6
    gnss[hit, GNSS["vn_mps"]] += rng.normal(0.0, 8.0, hit.sum())
    for m in (replace(drive.measurements, gnss=gnss), positions_only(replace(drive.measurements, gnss=gnss))):
        _, seconds = judged(m)
        assert not seconds[:, CONTRADICTED].any()
        assert abs(seconds[-1, YAW]) < 3 * seconds[-1, YAW_SD]


def test_a_box_that_is_refitted_is_found_again():
    first, second = simulated("city", 1, 240.0), simulated("city", 2, 400.0)
    m = first.measurements
    shift_ns = int(m.imu_t_ns[-1] - second.measurements.imu_t_ns[0]) + S // 50
    later = second.measurements
    C = matrix_from_rpy(0.0, 0.0, math.radians(90.0))
    both = replace(
        m,
        imu_t_ns=np.concatenate([m.imu_t_ns, later.imu_t_ns + shift_ns]),
        f_s=np.concatenate([m.f_s, later.f_s @ C]),
        omega_s=np.concatenate([m.omega_s, later.omega_s @ C]),
        gnss_t_ns=np.concatenate([m.gnss_t_ns, later.gnss_t_ns + shift_ns]),
        gnss=np.concatenate([m.gnss, later.gnss]),
    )
    finder, seconds = judged(both)
    assert seconds[:, FOUND].any()
    _, _, yaw = rpy_from_matrix(finder.C_b_from_m)
    assert math.degrees(yaw) == pytest.approx(90.0, abs=20.0)  # some of what was before is still in it
