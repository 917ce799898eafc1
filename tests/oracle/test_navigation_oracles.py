"""Earth, rotations, filter algebra and mechanisation against other people's implementations and exact motion."""

from __future__ import annotations

import math

import numpy as np
import pymap3d
import pytest
from filterpy.kalman import KalmanFilter
from pymap3d.vincenty import vdist
from scipy.spatial.transform import Rotation

from core.earth import horizontal_distance_m, ned_offset_m, radii_m
from core.measurements import GNSS
from core.navigation import kalman, kernel, state
from core.navigation.mechanization import start_frame
from core.navigation.track import TRACK, TRACK_COLUMNS
from core.navigation.tuning import Tuning
from core.rotation import (
    matrix_from_quaternion,
    matrix_from_rpy,
    quaternion_from_matrix,
    rpy_from_matrix,
    wrap_angle_rad,
)
from core.simulation.scenarios import simulate

PLACES = [(0.0, 10.0), (40.4, -3.7), (-33.9, 151.2), (68.4, 17.4), (59.35, 179.9995)]


@pytest.mark.parametrize("lat_deg", [-80.0, -33.9, 0.0, 12.3, 45.0, 89.0])
def test_radii_of_curvature(lat_deg):
    ours = radii_m(math.radians(lat_deg))
    theirs = pymap3d.rcurve.meridian(lat_deg), pymap3d.rcurve.transverse(lat_deg)
    assert ours == pytest.approx(theirs, rel=1e-9)  # the flattening's last digit


@pytest.mark.parametrize(("lat_deg", "lon_deg"), PLACES)
def test_offsets_in_a_local_frame(lat_deg, lon_deg):
    rng = np.random.default_rng(1)
    n, e, d = rng.uniform(-60.0, 60.0, (3, 200))
    lat, lon, alt = pymap3d.ned2geodetic(n, e, d, lat_deg, lon_deg, 120.0)
    ours = ned_offset_m(np.radians(lat), np.radians(lon), alt, (math.radians(lat_deg), math.radians(lon_deg), 120.0))
    # Meridians meet, by n e tan(lat) / R; the plane leaves the Earth, by (n^2 + e^2) / 2 R; its metres are those of
    # 120 m, whatever d is, by n d / R.
    curvature = 60.0**2 / 6.36e6
    bend = curvature * (1.0 + math.tan(math.radians(abs(lat_deg))))
    assert np.abs(ours - np.column_stack([n, e, d])).max(axis=0) == pytest.approx([0, 0, 0], abs=bend)


@pytest.mark.parametrize(("lat_deg", "lon_deg"), PLACES)
def test_distances_along_the_ellipsoid(lat_deg, lon_deg):
    rng = np.random.default_rng(2)
    lat = lat_deg + rng.uniform(-0.04, 0.04, 100)
    lon = lon_deg + rng.uniform(-0.04, 0.04, 100)
    theirs = np.array([vdist(lat_deg, lon_deg, a, b)[0] for a, b in zip(lat, lon, strict=True)]).reshape(-1)
    here = np.full(100, math.radians(lat_deg)), np.full(100, math.radians(lon_deg))
    ours = horizontal_distance_m(*here, np.radians(lat), np.radians(lon))
    # Within 10 km a straight line on the map of the middle latitude: (d / R tan(lat))^2 / 24 of the way, 1e-6.
    assert ours == pytest.approx(theirs, rel=2e-6, abs=1e-3)


def test_rotations():
    rng = np.random.default_rng(3)
    for rpy in rng.uniform([-math.pi, -1.5, -math.pi], [math.pi, 1.5, math.pi], (200, 3)):
        theirs = Rotation.from_euler("ZYX", rpy[::-1])
        c = matrix_from_rpy(*rpy)
        assert c == pytest.approx(theirs.as_matrix(), abs=1e-14)
        assert quaternion_from_matrix(c) == pytest.approx(theirs.as_quat(canonical=True, scalar_first=True), abs=1e-14)
        assert matrix_from_quaternion(quaternion_from_matrix(c)) == pytest.approx(c, abs=1e-14)
        back = wrap_angle_rad(np.array(rpy_from_matrix(c)) - rpy)
        assert back == pytest.approx(np.zeros(3), abs=1e-12)


def test_a_sequence_of_scalar_updates():
    rng = np.random.default_rng(4)
    n = state.N_STATES
    root = rng.normal(size=(n, n))
    p0 = root @ root.T + np.eye(n)
    theirs = KalmanFilter(dim_x=n, dim_z=1)
    theirs.P, theirs.x = p0.copy(), np.zeros((n, 1))
    p, dx, ph = p0.reshape(-1).copy(), np.zeros(n), np.empty(n)
    groups = (state.VEL, state.ATT, state.SPEED_SCALE)
    columns = [g + i for g in groups for i in range(3)]
    for _ in range(60):
        z, variance = rng.normal(), rng.uniform(0.01, 4.0)
        H = np.zeros((1, n))
        if rng.random() < 0.5:
            row = tuple(rng.normal(size=9))
            H[0, columns] = row
            s = kalman.project(p, n, groups, row, ph) + variance
            innovation = z - kalman.along(groups, row, dx)
        else:
            axis = int(rng.integers(n))
            H[0, axis] = 1.0
            s = kalman.project_axis(p, n, axis, ph) + variance
            innovation = z - dx[axis]
        kalman.update(p, n, ph, s, innovation, dx)
        theirs.update(np.array([[z]]), R=np.array([[variance]]), H=H)
        # Joseph's form there, the short one here: they part by rounding, 60 times 1e-16 of P's size.
        assert dx == pytest.approx(theirs.x[:, 0], abs=1e-11)
        assert p.reshape(n, n) == pytest.approx(theirs.P, abs=1e-11 * np.abs(p0).max())
    kalman.symmetrise(p, n)
    assert (p.reshape(n, n) == p.reshape(n, n).T).all()


@pytest.mark.parametrize(
    ("scenario", "from_s", "rate_hz"), [("city", 40.0, 200.0), ("highway", 60.0, 200.0), ("city", 40.0, 100.0)]
)
def test_a_minute_of_dead_reckoning_on_exact_samples(scenario, from_s, rate_hz):
    truth = simulate(scenario, 2, 200.0, rate_hz).trajectory
    first, last = round(from_s * rate_hz), round((from_s + 60.0) * rate_hz)
    start_ns = 1_700_000_000_000_000_000
    x, ti = np.zeros(state.NX), np.zeros(state.NT, np.int64)
    x[:4] = quaternion_from_matrix(matrix_from_rpy(*truth.rpy_rad[first]))
    x[state.X_V : state.X_V + 3] = truth.v_n[first]
    x[state.X_LAT], x[state.X_LON], x[state.X_ALT] = truth.lat_rad[first], truth.lon_rad[first], truth.alt_m[first]
    x[state.X_F : state.X_F + 3], x[state.X_W : state.X_W + 3] = truth.f_b[first], truth.omega_b[first]
    ti[state.T_NOW] = ti[state.T_COV] = ti[state.T_NEXT_BLOCK] = start_ns
    ti[state.T_NEXT_CONSTRAINT] = 1 << 62
    start_frame(x, ti)
    n = last - first
    t_ns = start_ns + np.rint((1 + np.arange(n)) * 1e9 / rate_hz).astype(np.int64)
    none = np.empty(0, np.int64)
    out_t_ns, out = np.empty(n, np.int64), np.empty((n, len(TRACK_COLUMNS)))
    *_, rows, stopped = kernel.run(
        x, ti, np.zeros(state.N_STATES**2), np.zeros(6 * state.N_BLOCKS), np.zeros(kernel.SCRATCH),
        Tuning(output_interval_s=0.0).as_array(), 0,
        np.zeros(3), np.zeros(3), t_ns, truth.f_b[first + 1 : last + 1], truth.omega_b[first + 1 : last + 1],
        np.zeros(n), none, np.empty((0, len(GNSS))), none, np.empty(0), np.empty((n, 4)), out_t_ns, out,
        np.zeros((len(state.AIDS), len(state.OUTCOMES)), np.int64),
    )  # fmt: skip
    assert (rows, stopped) == (n, kernel.STOPPED_END)
    there = slice(first + 1, last + 1)
    origin = (truth.lat_rad[first], truth.lon_rad[first], truth.alt_m[first])
    place = ned_offset_m(truth.lat_rad[there], truth.lon_rad[there], truth.alt_m[there], origin)
    drift = np.linalg.norm(ned_offset_m(*out[:, :3].T, origin) - place, axis=1)
    velocity = np.linalg.norm(out[:, TRACK["vn_mps"] : TRACK["vn_mps"] + 3] - truth.v_n[there], axis=1)
    attitude = wrap_angle_rad(out[:, TRACK["roll_rad"] : TRACK["roll_rad"] + 3] - truth.rpy_rad[there])
    # Samples are instants, and what lies between two of them is taken as straight: of accelerations of 2 m/s2 that
    # come and go within half a second, (2 pi 2 Hz 10 ms)^2 / 12 = 1e-3 stays, as velocity, 0.02 m/s, and as a
    # drift that mostly comes back; of turns and rolls of 0.1 rad 1e-3 as well, which gravity turns into a drift.
    assert velocity.max() < 0.02
    assert np.abs(attitude).max() < 1e-4
    assert drift.max() < 0.1
