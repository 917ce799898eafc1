"""What explains a braking: an accident on the way ahead that is not long past, a pothole that was struck."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from core.driving.hazards import Braking, HazardTuning, accident_explains, pothole_explains
from core.earth import radii_m

S = 1_000_000_000
LAT, LON = math.radians(60.17), math.radians(24.94)
T = 1_800_000_000 * S
TUNING = HazardTuning()


def braking(course_deg=0.0, lat=LAT, lon=LON):
    """Three seconds of it."""
    return Braking(T, T + 3 * S, lat, lon, math.radians(course_deg))


def place(distance_m, bearing_deg, lat=LAT, lon=LON):
    """Where one is so far away."""
    meridian, transverse = radii_m(lat)
    bearing = math.radians(bearing_deg)
    return lat + distance_m * math.cos(bearing) / meridian, lon + distance_m * math.sin(bearing) / (
        transverse * math.cos(lat)
    )


@pytest.mark.parametrize(
    ("distance_m", "bearing_deg", "course_deg", "explains"),
    [
        (300.0, 0.0, 0.0, True),
        (300.0, 40.0, 0.0, True),
        (300.0, 60.0, 0.0, False),
        (300.0, 180.0, 0.0, False),  # left behind
        (300.0, 340.0, 10.0, True),  # across north
        (600.0, 0.0, 0.0, False),
        (30.0, 180.0, 0.0, True),  # the scene itself
        (300.0, 0.0, math.nan, False),
        (30.0, 0.0, math.nan, True),
    ],
)
def test_it_lies_ahead_or_is_right_there(distance_m, bearing_deg, course_deg, explains):
    at = place(distance_m, bearing_deg)
    assert accident_explains(braking(course_deg), T - 60 * S, *at) is explains


@pytest.mark.parametrize(
    ("seconds", "explains"), [(-3700, False), (-3599, True), (-1, True), (0, True), (2, True), (4, False)]
)
def test_it_happened_within_the_hour_before_or_while_one_braked(seconds, explains):
    assert accident_explains(braking(), T + seconds * S, *place(200.0, 0.0)) is explains


def test_what_is_nowhere_explains_nothing():
    assert not accident_explains(braking(), T, math.nan, LON)
    assert not accident_explains(Braking(T, T + S), T, LAT, LON)


@given(st.floats(0.0, 2000.0), st.floats(0.0, 360.0), st.floats(0.0, 360.0), st.floats(-80.0, 80.0))
def test_turned_as_a_whole_it_is_the_same(distance_m, bearing_deg, turn_deg, lat_deg):
    """Whichever way north is, wherever on earth, and across the antimeridian."""
    off_deg = abs(math.remainder(bearing_deg, 360.0))
    cone_deg = math.degrees(TUNING.cone_rad)
    # Rounding and the earth's curvature move edges by less than this.
    if abs(off_deg - cone_deg) < 0.1 or min(abs(distance_m - TUNING.ahead_m), abs(distance_m - TUNING.beside_m)) < 1.0:
        return
    lat, lon = math.radians(lat_deg), math.radians(179.9999)
    at_lat, at_lon = place(distance_m, bearing_deg + turn_deg, lat, lon)
    expected = distance_m < TUNING.beside_m or (distance_m < TUNING.ahead_m and off_deg < cone_deg)
    at_lon = math.remainder(at_lon, math.tau)
    assert accident_explains(braking(turn_deg, lat, lon), T, at_lat, at_lon) is expected


@pytest.mark.parametrize(("seconds", "explains"), [(-0.5, False), (0.0, True), (2.9, True), (4.9, True), (5.1, False)])
def test_a_pothole_is_struck_while_one_brakes_or_right_after(seconds, explains):
    assert pothole_explains(Braking(T, T + 3 * S), T + round(seconds * S)) is explains
