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
from core.navigation import kalman, kernel, state
from core.navigation.mechanization import start_frame
from core.navigation.nodes import NODE_WIDTH
from core.navigation.records import RECORD_COLUMNS
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


SPARSE_ROWS = {6: (kalman.project_six, kalman.along_six), 9: (kalman.project_nine, kalman.along_nine)}


def test_a_sequence_of_scalar_updates():
    rng = np.random.default_rng(4)
    n = state.N_STATES
    root = rng.normal(size=(n, n))
    p0 = root @ root.T + np.eye(n)
    theirs = KalmanFilter(dim_x=n, dim_z=1)
    theirs.P, theirs.x = p0.copy(), np.zeros((n, 1))
    p, dx, ph = p0.reshape(-1).copy(), np.zeros(n), np.empty(n)
    for _ in range(60):
        z, variance = rng.normal(), rng.uniform(0.01, 4.0)
        H = np.zeros((1, n))
        touched = int(rng.choice([1, 6, 9]))
        at = tuple(int(i) for i in rng.permutation(n)[:touched])
        if touched == 1:
            H[0, at] = 1.0
            s = kalman.project_axis(p, n, at[0], ph) + variance
            innovation = z - dx[at[0]]
        else:
            project, along = SPARSE_ROWS[touched]
            row = tuple(rng.normal(size=touched))
            H[0, at] = row
            s = project(p, n, at, row, ph) + variance
            innovation = z - along(at, row, dx)
        kalman.update(p, n, ph, s, innovation, dx)
        theirs.update(np.array([[z]]), R=np.array([[variance]]), H=H)
        # Joseph's form there, the short one here: they part by rounding, 60 times 1e-16 of P's size.
        assert dx == pytest.approx(theirs.x[:, 0], abs=1e-11)
        assert p.reshape(n, n) == pytest.approx(theirs.P, abs=1e-11 * np.abs(p0).max())
    kalman.symmetrise(p, n)
    assert (p.reshape(n, n) == p.reshape(n, n).T).all()


@pytest.mark.parametrize("left_out", [(), (0,), (1,)])
def test_two_updates_in_one_pass(left_out):
    rng = np.random.default_rng(6)
    n = state.N_STATES
    root = rng.normal(size=(n, n))
    p0 = root @ root.T + np.eye(n)
    H, z, r = np.zeros((2, n)), rng.normal(size=2), rng.uniform(0.5, 4.0, 2)
    p, dx, ph = p0.reshape(-1).copy(), np.zeros(n), (np.empty(n), np.empty(n))
    s = []
    for i in range(2):
        at = tuple(int(j) for j in rng.permutation(n)[:9])
        H[i, at] = rng.normal(size=9)
        s.append(kalman.project_nine(p, n, at, tuple(H[i, at]), ph[i]) + r[i])
    inverse_first = 0.0 if 0 in left_out else 1.0 / s[0]
    share = kalman.along_nine(at, tuple(H[1, at]), ph[0]) * inverse_first
    kalman.decorrelate(n, ph[0], ph[1], share)
    inverse_second = 0.0 if 1 in left_out else 1.0 / (s[1] - share**2 / max(inverse_first, 1e-300))
    kalman.update_pair(p, n, ph[0], inverse_first, z[0], ph[1], inverse_second, z[1] - share * z[0], dx)
    used = [i for i in range(2) if i not in left_out]
    theirs = KalmanFilter(dim_x=n, dim_z=len(used))
    theirs.P, theirs.x = p0.copy(), np.zeros((n, 1))
    theirs.update(z[used][:, None], R=np.diag(r[used]), H=H[used])
    assert dx == pytest.approx(theirs.x[:, 0], abs=1e-12)
    assert p.reshape(n, n) == pytest.approx(theirs.P, abs=1e-13 * np.abs(p0).max())


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
        x, ti, np.zeros(state.N_STATES**2), np.zeros((kernel.KEPT_SECONDS, kernel.KEPT_WIDTH)),
        np.zeros((kernel.KEPT_SECONDS, state.NT), np.int64), np.zeros(kernel.SCRATCH),
        Tuning(output_interval_s=0.0).as_array(), np.zeros(7),
        t_ns, truth.f_b[first + 1 : last + 1], truth.omega_b[first + 1 : last + 1], np.zeros(n),
        none, np.empty((0, state.AID_WIDTH)), np.empty((n, 4)), out_t_ns, out,
        none, np.empty((0, len(RECORD_COLUMNS))), none, np.empty((0, NODE_WIDTH)),
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
