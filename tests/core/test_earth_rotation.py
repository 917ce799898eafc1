"""Earth and rotations against published values and hand values."""

from __future__ import annotations

import math

import numpy as np
import pymap3d
import pytest

from core.earth import (
    EARTH_RATE_RADPS,
    SEMI_MAJOR_M,
    ecef_from_geodetic,
    geodetic_from_ecef,
    gravity_mps2,
    horizontal_distance_m,
    matrix_e_from_n,
    ned_offset_m,
    radii_m,
)
from core.rotation import (
    matrix_from_quaternion,
    matrix_from_rpy,
    quaternion_from_matrix,
    rpy_from_matrix,
    wrap_angle_rad,
)


@pytest.mark.parametrize(
    ("lat_deg", "gravity"),
    # NIMA TR8350.2, table 3.4: equator and pole; Moritz 1980 (GRS 80, which differs by 1e-6): 45 deg.
    [(0.0, 9.7803253359), (90.0, 9.8321849378), (45.0, 9.806199)],
)
def test_normal_gravity_on_the_ellipsoid(lat_deg, gravity):
    assert gravity_mps2(math.radians(lat_deg), 0.0) == pytest.approx(gravity, abs=2e-6)


@pytest.mark.parametrize("lat_deg", [-60.0, 0.0, 45.0])
def test_gravity_falls_by_the_free_air_gradient(lat_deg):
    lat = math.radians(lat_deg)
    assert gravity_mps2(lat, 0.0) - gravity_mps2(lat, 1000.0) == pytest.approx(3.086e-3, rel=2e-3)
    # Far up it is Newton's law, but for the spin and the flattening, 0.3 % of 6e-3: 20 km shows the second order, 3e-5.
    radius = 6.371e6
    assert gravity_mps2(lat, 20_000.0) / gravity_mps2(lat, 0.0) == pytest.approx(
        (radius / (radius + 2e4)) ** 2, rel=5e-5
    )


def test_radii_at_the_equator_and_the_pole():
    b = SEMI_MAJOR_M * (1 - 1 / 298.257223563)
    assert radii_m(0.0) == pytest.approx((b * b / SEMI_MAJOR_M, SEMI_MAJOR_M), rel=1e-12)
    assert radii_m(math.pi / 2) == pytest.approx((SEMI_MAJOR_M**2 / b,) * 2, rel=1e-12)


def test_a_day_is_a_sidereal_one():
    assert 2 * math.pi / EARTH_RATE_RADPS == pytest.approx(86164.1, abs=0.1)


def test_offsets_and_distances_go_over_the_date_line():
    lat, west, east = np.array([0.3]), np.array([-math.pi + 1e-6]), math.pi - 1e-6
    _, transverse = radii_m(0.3)
    metres = 2e-6 * transverse * math.cos(0.3)
    offset = ned_offset_m(lat, west, np.zeros(1), (0.3, east, 0.0))
    assert offset[0] == pytest.approx([0.0, metres, 0.0], rel=1e-9)
    assert horizontal_distance_m(lat, west, lat, np.array([east])) == pytest.approx([metres], rel=1e-9)


def test_a_quarter_turn_by_hand():
    nose_east = matrix_from_rpy(0.0, 0.0, math.pi / 2)
    assert nose_east @ [1.0, 0.0, 0.0] == pytest.approx([0.0, 1.0, 0.0], abs=1e-15)
    nose_up = matrix_from_rpy(0.0, math.pi / 2, 0.0)
    assert nose_up @ [1.0, 0.0, 0.0] == pytest.approx([0.0, 0.0, -1.0], abs=1e-15)
    right_down = matrix_from_rpy(math.pi / 2, 0.0, 0.0)
    assert right_down @ [0.0, 1.0, 0.0] == pytest.approx([0.0, 0.0, 1.0], abs=1e-15)


@pytest.mark.parametrize("axis", range(3))
def test_half_turns_have_a_quaternion(axis):
    # Where the trace is -1 a careless formula divides by zero.
    c = -np.eye(3)
    c[axis, axis] = 1.0
    q = quaternion_from_matrix(c)
    expected = np.zeros(4)
    expected[1 + axis] = 1.0
    assert np.abs(q) == pytest.approx(expected, abs=1e-15)
    assert matrix_from_quaternion(q) == pytest.approx(c, abs=1e-15)


def test_pitch_stays_a_number_where_rounding_leaves_a_sine_above_one():
    c = matrix_from_rpy(0.0, math.pi / 2, 0.0)
    c[2, 0] = -1.0 - 1e-15
    assert rpy_from_matrix(c)[1] == pytest.approx(math.pi / 2)


def test_angles_are_wrapped_into_one_turn():
    angles = np.array([0.0, math.pi, -math.pi, 3.5 * math.pi, -7.0, 1e3])
    wrapped = wrap_angle_rad(angles)
    assert ((wrapped >= -math.pi) & (wrapped < math.pi)).all()
    assert np.cos(wrapped) == pytest.approx(np.cos(angles), abs=1e-12)
    assert np.sin(wrapped) == pytest.approx(np.sin(angles), abs=1e-12)


@pytest.mark.parametrize("lat_deg", [-75.0, -33.9, 0.0, 45.0, 89.0])
@pytest.mark.parametrize("alt_m", [-400.0, 0.0, 9000.0])
def test_ecef_and_back(lat_deg, alt_m):
    lat, lon = math.radians(lat_deg), math.radians(-123.4)
    place = ecef_from_geodetic(lat, lon, alt_m)
    assert place == pytest.approx(pymap3d.geodetic2ecef(lat_deg, -123.4, alt_m), abs=1e-8)
    back = geodetic_from_ecef(*place)
    # 1e-14 rad is 0.06 um; heights lose the last digits of 6e6 m.
    assert back[:2] == pytest.approx((lat, lon), abs=1e-14)
    assert back[2] == pytest.approx(alt_m, abs=1e-8)


def test_north_east_down_of_a_place():
    north_east_down = np.array([300.0, -200.0, 50.0])
    moved = matrix_e_from_n(0.7, 2.1) @ north_east_down
    expected = pymap3d.enu2ecefv(-200.0, 300.0, -50.0, math.degrees(0.7), math.degrees(2.1))
    assert moved == pytest.approx(np.array(expected), abs=1e-9)
