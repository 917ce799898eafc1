"""Drives along given streets: on their line, within limits and comfort, standing where they should."""

import math
from itertools import pairwise

import numpy as np
import pytest

from core.earth import horizontal_distance_m, radii_m
from core.errors import InvalidInputError
from core.simulation.route import Sky
from core.simulation.street_route import Driving, Sampled, StreetPath, drive_streets
from core.simulation.trajectory import RIGID, drive

LAT_RAD, LON_RAD = math.radians(47.1), math.radians(9.5)
SIDE_M = 400.0


def path(corners_m, limit_kmh=50.0, lane_m=0.0, tunnel=(), junction=True):
    """A path by corners north and east of a place."""
    north, east = np.array(corners_m, float).T
    meridian, transverse = radii_m(LAT_RAD)
    n = north.size
    return StreetPath(
        lat_rad=LAT_RAD + north / meridian,
        lon_rad=LON_RAD + east / (transverse * math.cos(LAT_RAD)),
        limit_mps=np.full(n - 1, limit_kmh / 3.6),
        lane_m=np.full(n - 1, lane_m),
        tunnel=np.isin(np.arange(n - 1), tunnel),
        junction=np.full(n, junction),
    )


def stairs(steps=40):
    """North and east in turn, 400 m each: over 16 km and right angles all the way."""
    return [(SIDE_M * ((i + 1) // 2), SIDE_M * (i // 2)) for i in range(steps)]


def driven(streets, seed=1, duration_s=600.0, rate_hz=20.0, **options):
    result = drive_streets(streets, np.random.default_rng(seed), duration_s, **options)
    return result, drive(result.route, result.place, rate_hz, RIGID)


def off_line_m(streets, truth):
    """Distance of each position from the path."""
    meridian, transverse = radii_m(LAT_RAD)
    scale = np.array([meridian, transverse * math.cos(LAT_RAD)])
    start = (np.column_stack([streets.lat_rad, streets.lon_rad]) - [LAT_RAD, LON_RAD]) * scale
    at = (np.column_stack([truth.lat_rad, truth.lon_rad]) - [LAT_RAD, LON_RAD]) * scale
    best = np.full(len(at), np.inf)
    for a, b in pairwise(start):
        share = np.clip((at - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
        best = np.minimum(best, np.hypot(*(at - a - share[:, None] * (b - a)).T))
    return best


def test_the_car_stays_on_the_line():
    streets = path(stairs())
    _, truth = driven(streets)
    off = off_line_m(streets, truth)
    # A corner of 16 m is cut by 0.15 of that times the root of a half; besides, the places of the plane in which this
    # test measures are off by d^2 / R tan(latitude), under 0.5 m within 2 km.
    assert off.max() < 2.5
    assert np.median(off) < 0.5


def test_the_drive_ends_where_its_line_does_to_the_decimetre():
    # Over 5 km of an integrated velocity: what the tables' steps leave.
    straight = path([(0, 0), (8000, 0)])
    result, truth = driven(straight, duration_s=400.0)
    assert np.abs(truth.lon_rad - LON_RAD).max() * 6.4e6 < 0.1
    speed, _ = result.route.forward_by_tyres.at(np.arange(0.0, 400.0, 0.001))
    length = horizontal_distance_m(truth.lat_rad[0], truth.lon_rad[0], truth.lat_rad[-1], truth.lon_rad[-1])
    assert speed.sum() * 0.001 == pytest.approx(float(length), abs=0.1)


@pytest.mark.parametrize(("lane_m", "side"), [(1.7, 1.0), (-1.7, -1.0)])
def test_the_lane_is_beside_the_line(lane_m, side):
    _, truth = driven(path([(0, 0), (8000, 0)], lane_m=lane_m), duration_s=400.0)
    east = (truth.lon_rad - LON_RAD) * radii_m(LAT_RAD)[1] * math.cos(LAT_RAD)
    assert east[len(east) // 2] == pytest.approx(side * 1.7, abs=0.05)


def test_limits_and_comfort_are_kept():
    how = Driving()
    streets = path(stairs(), limit_kmh=40.0)
    _, truth = driven(streets)
    assert truth.speed_mps.max() <= 40.0 / 3.6 * how.limit_share_high + 1e-6
    forward, right = truth.f_b[:, 0], truth.f_b[:, 1]
    # Pedals ease over 1.6 s, so that a corner is met some 0.3 m/s faster than it allows.
    assert np.abs(right).max() < 1.5 * how.lateral_mps2
    assert forward.max() < how.accelerating_mps2 + 0.1
    assert forward.min() > -how.braking_mps2 - 0.1


def test_it_stands_at_both_ends_and_at_some_junctions():
    _, truth = driven(path(stairs()))
    still = truth.speed_mps < 0.01
    assert still[truth.t_s < 14.0].all()
    assert still[truth.t_s > 599.0].all()
    between = still[(truth.t_s > 20.0) & (truth.t_s < 580.0)]
    stops = np.count_nonzero(np.diff(between.astype(int)) == 1)
    assert 2 <= stops <= 20
    _, going = driven(path(stairs(), junction=False))
    assert (going.speed_mps[(going.t_s > 25.0) & (going.t_s < 580.0)] > 1.0).all()


def test_the_piece_under_the_car_is_told():
    streets = path(stairs(), tunnel=(3,))
    result, truth = driven(streets, outages_s=((100.0, 160.0),))
    piece = result.piece[np.searchsorted(result.piece_t_s, truth.t_s, side="right") - 1]
    assert (np.diff(piece) >= 0).all()
    assert piece[0] == 0
    # North on even pieces, east on odd ones, where the car is away from the corners.
    heading = np.degrees(truth.rpy_rad[:, 2])
    settled = np.abs(np.mod(heading + 45.0, 90.0) - 45.0) < 0.5
    assert np.allclose(heading[settled], np.where(piece[settled] % 2 == 0, 0.0, 90.0), atol=0.6)
    (outage,) = (one for one in result.route.sky if one.kind is Sky.OUTAGE)
    (tunnel,) = (one for one in result.route.sky if one.kind is Sky.TUNNEL)
    assert (outage.start_s, outage.end_s) == (100.0, 160.0)
    inside = (truth.t_s > tunnel.start_s + 0.1) & (truth.t_s < tunnel.end_s - 0.1)
    assert set(piece[inside].tolist()) == {3}
    assert tunnel.end_s <= 600.0


def test_the_same_seed_drives_the_same():
    streets = path(stairs())
    (one, first), (_, second), (_, other) = driven(streets), driven(streets), driven(streets, seed=2)
    assert (first.lat_rad == second.lat_rad).all()
    assert (first.f_b == second.f_b).all()
    assert not np.array_equal(first.speed_mps, other.speed_mps)
    assert one.place.field_n_ut[1] == 0.0


def test_heading_and_rate_agree():
    result, _ = driven(path(stairs()))
    t_s = np.arange(20.0, 500.0, 0.001)
    for signal in (result.route.heading_rad, result.route.forward_by_tyres):
        value, rate = signal.at(t_s)
        # A central difference over 2 ms of a cubic: its third derivative times 1e-6 / 6.
        assert np.abs(np.gradient(value, 0.001)[1:-1] - rate[1:-1]).max() < 0.02


def test_a_sampled_signal_goes_through_its_samples_and_holds_its_ends():
    t_s = np.arange(5) * 0.5
    signal = Sampled(0.5, t_s**3, 3 * t_s**2)
    value, rate = signal.at(np.array([-1.0, 0.0, 0.25, 0.5, 1.7, 2.0, 3.0]))
    assert value == pytest.approx([0.0, 0.0, 0.25**3, 0.125, 1.7**3, 8.0, 8.0])
    assert rate == pytest.approx([0.0, 0.0, 3 * 0.25**2, 0.75, 3 * 1.7**2, 12.0, 0.0])


@pytest.mark.parametrize(
    ("streets", "duration_s", "said"),
    [
        (path([(0, 0), (500, 0)]), 600.0, "a path of 0.5 km"),
        (path([(0, 0), (10, 0)]), 60.0, "a path of 10 m"),
        (path([(0, 0), (8000, 0)]), 25.0, "too short to go anywhere"),
    ],
)
def test_a_path_that_does_not_fit_says_so(streets, duration_s, said):
    with pytest.raises(InvalidInputError, match=said):
        drive_streets(streets, np.random.default_rng(1), duration_s)
