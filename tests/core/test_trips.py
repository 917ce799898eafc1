"""Trips as timelines: given how a vehicle moved, which trips are told and when."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest

from core.driving.trips import TripThresholds, TripTracker
from core.navigation.track import TRACK, TRACK_COLUMNS, Mode, Track
from core.snapshot import pack, unpack

EPOCH_NS = 1_700_000_000_000_000_000
RATE_HZ = 10.0
METRES_PER_RAD = 6.367e6
LIMITS = TripThresholds()


def timeline(*parts, lat_rad=0.8, t0_s=0.0):
    """Track of (seconds, speed_mps[, mode]) parts, northward; a part with speed None is a gap in the rows."""
    t_s, speeds, modes = [], [], []
    clock = t0_s
    for part in parts:
        seconds, speed, mode = (*part, Mode.AIDED)[:3]
        if speed is not None:
            count = round(seconds * RATE_HZ)
            t_s += [clock + k / RATE_HZ for k in range(count)]
            speeds += [speed] * count
            modes += [mode] * count
        clock += seconds
    values = np.full((len(t_s), len(TRACK_COLUMNS)), np.nan)
    t_s, speeds = np.array(t_s), np.array(speeds, dtype=float)
    steps = np.diff(t_s, prepend=t_s[0])
    values[:, TRACK["lat_rad"]] = lat_rad + np.cumsum(steps * speeds) / METRES_PER_RAD
    values[:, TRACK["lon_rad"]] = 0.3
    values[:, TRACK["vn_mps"]] = speeds
    values[:, TRACK["ve_mps"]] = 0.0
    values[:, TRACK["mode"]] = modes
    return Track(EPOCH_NS + np.round(t_s * 1e9).astype(np.int64), values)


def cut(track, size):
    for k in range(0, len(track.t_ns), size):
        yield Track(track.t_ns[k : k + size], track.values[k : k + size])


def told(track, ignition=None, tracker=None):
    return (tracker or TripTracker()).step(track, ignition)


def seconds(t_ns):
    return (t_ns - EPOCH_NS) * 1e-9


def ended(trips):
    return [trip for trip in trips if trip.ended]


def test_a_drive_begins_is_told_while_it_goes_on_and_ends():
    trips = told(timeline((60, 0.0), (100, 10.0), (400, 0.0)))
    assert not trips[0].ended
    assert trips[-1].ended
    assert all(not trip.ended for trip in trips[:-1])
    # Every 10 s, and no more once nothing changes: about 100 s / 10 s of them, with the first.
    assert 9 <= len(trips) - 1 <= 11
    (trip,) = ended(trips)
    assert seconds(trip.start_t_ns) == pytest.approx(59.9, abs=0.05)  # the last row at which it stood
    assert seconds(trip.end_t_ns) == pytest.approx(159.9, abs=0.05)
    assert trip.distance_m == pytest.approx(1000.0, abs=2.0)  # the jump to 10 m/s between two rows is 0.5 m
    assert trip.moving_s == pytest.approx(100.0, abs=0.2)
    assert trip.max_speed_mps == 10.0
    assert trip.coasting_s == 0.0
    north_m = (trip.end_lat_rad - trip.start_lat_rad) * METRES_PER_RAD
    assert north_m == pytest.approx(1000.0, abs=2.0)


def test_all_words_on_one_trip_carry_its_start_and_never_take_back():
    trips = told(timeline((5, 0.0), (50, 10.0), (20, 0.0), (50, 10.0), (301, 0.0)))
    assert len({trip.start_t_ns for trip in trips}) == 1
    for before, after in itertools.pairwise(trips):
        assert after.end_t_ns >= before.end_t_ns
        assert after.distance_m >= before.distance_m


@pytest.mark.parametrize(
    ("moving_s", "speed", "begins"),
    [(2.5, 10.0, False), (3.5, 10.0, True), (60.0, 0.9, False), (3.5, 1.1, False), (12.0, 1.1, True)],
)
def test_a_trip_begins_only_after_time_and_distance(moving_s, speed, begins):
    assert bool(told(timeline((10, 0.0), (moving_s, speed), (5, 0.0)))) is begins


@pytest.mark.parametrize(("stop_s", "trips"), [(299.0, 1), (301.0, 2)])
def test_a_stop_of_five_minutes_parts_two_trips(stop_s, trips):
    last = told(timeline((5, 0.0), (60, 10.0), (stop_s, 0.0), (60, 10.0), (301, 0.0)))
    assert len(ended(last)) == trips
    assert sum(trip.distance_m for trip in ended(last)) == pytest.approx(1200.0, abs=4.0)


@pytest.mark.parametrize(("gap_s", "trips"), [(299.0, 1), (300.5, 2)])
def test_a_silence_of_five_minutes_parts_two_trips(gap_s, trips):
    last = told(timeline((5, 0.0), (60, 10.0), (gap_s, None), (60, 10.0), (301, 0.0)))
    assert len(ended(last)) == trips
    if trips == 2:
        assert seconds(ended(last)[0].end_t_ns) == pytest.approx(64.9, abs=0.05)


def test_a_bridged_gap_counts_its_straight_line_and_as_time_without_gnss():
    (trip,) = ended(told(timeline((5, 0.0), (60, 10.0), (30, None), (60, 10.0), (301, 0.0))))
    # The track goes on northward through the gap at 10 m/s: 150 s of movement in all. 0.3 % for the test's sphere.
    assert trip.distance_m == pytest.approx(1500.0, rel=3e-3, abs=2.0)
    assert trip.coasting_s == pytest.approx(30.0, abs=0.3)


def test_time_in_a_tunnel_is_counted_with_a_stop_inside_but_not_after_the_last_movement():
    (trip,) = ended(
        told(
            timeline(
                (5, 0.0),
                (20, 10.0),
                (15, 10.0, Mode.COASTING),
                (10, 0.0, Mode.COASTING),
                (15, 10.0, Mode.COASTING),
                (301, 0.0, Mode.COASTING),
            )
        )
    )
    assert trip.coasting_s == pytest.approx(40.0, abs=0.3)
    assert trip.moving_s == pytest.approx(50.0, abs=0.5)


def test_ignition_off_ends_a_trip_sooner_only_at_a_standstill():
    tracker = TripTracker()
    driving = timeline((5, 0.0), (60, 10.0), (5, 0.0))
    assert not ended(told(driving, True, tracker))
    parked = timeline((29, 0.0), lat_rad=0.8001, t0_s=70.0)
    assert not ended(told(parked, False, tracker))
    assert len(ended(told(timeline((2, 0.0), lat_rad=0.8001, t0_s=99.0), None, tracker))) == 1

    rolling = TripTracker()
    assert not ended(told(timeline((5, 0.0), (120, 10.0)), False, rolling))


def test_an_engine_that_stalls_and_starts_again_does_not_end_a_trip():
    tracker = TripTracker()
    told(timeline((5, 0.0), (60, 10.0)), True, tracker)
    told(timeline((20, 0.0), t0_s=65.0), False, tracker)
    told(timeline((1, 0.0), t0_s=85.0), True, tracker)
    assert not ended(told(timeline((20, 0.0), t0_s=86.0), False, tracker))


def test_noise_of_a_parked_car_is_no_trip_and_no_distance():
    rng = np.random.default_rng(7)
    parked = timeline((3600, 0.0))
    noise_mps = rng.normal(0.0, 0.1, (len(parked.t_ns), 2))  # ten times a zero-velocity update's, per axis
    parked.values[:, TRACK["vn_mps"]] = noise_mps[:, 0]
    parked.values[:, TRACK["ve_mps"]] = noise_mps[:, 1]
    assert told(parked) == []

    stop = timeline((5, 0.0), (60, 10.0), (200, 0.0), (60, 10.0), (301, 0.0))
    standing = stop.values[:, TRACK["vn_mps"]] == 0.0
    stop.values[standing, TRACK["vn_mps"]] = rng.normal(0.0, 0.1, standing.sum())
    (trip,) = ended(told(stop))
    assert trip.distance_m == pytest.approx(1200.0, abs=4.0)
    assert trip.moving_s == pytest.approx(120.0, abs=0.5)


def test_a_session_that_begins_in_motion_has_a_trip_from_its_first_row():
    trips = told(timeline((30, 15.0)))
    assert seconds(trips[0].start_t_ns) == 0.0


def test_rows_without_a_position_or_out_of_order_are_left_out():
    track = timeline((5, 0.0), (60, 10.0), (301, 0.0))
    expected = told(track)
    values = track.values.copy()
    aligning = Track(track.t_ns - 400_000_000_000, np.full_like(values, np.nan))
    tracker = TripTracker()
    assert told(aligning, None, tracker) == []
    first = told(Track(track.t_ns[:300], values[:300]), None, tracker)
    again = told(Track(track.t_ns[:300], values[:300]), None, tracker)
    rest = told(Track(track.t_ns[300:], values[300:]), None, tracker)
    assert again == []
    assert first + rest == expected


@pytest.mark.parametrize("size", [1, 7, 10, 333])
def test_any_cutting_and_any_snapshot_between_tell_the_same(size):
    track = timeline((5, 0.0), (40, 10.0), (20, None), (40, 7.3, Mode.COASTING), (305, 0.0), (30, 3.0), (301, 0.0))
    expected = told(track)
    assert len(ended(expected)) == 2
    tracker, trips = TripTracker(), []
    for block in cut(track, size):
        trips += tracker.step(block, None)
        restored = TripTracker()
        restored.load(unpack(pack(tracker.state(), 1), 1))
        tracker = restored
    assert [dataclasses.astuple(trip) for trip in trips] == [dataclasses.astuple(trip) for trip in expected]


def test_crossing_the_date_line_is_a_short_way():
    track = timeline((5, 0.0), (60, 10.0), (30, None), (60, 10.0), (301, 0.0))
    before_gap = track.t_ns < EPOCH_NS + 80_000_000_000
    track.values[:, TRACK["lon_rad"]] = np.where(before_gap, np.pi - 1e-6, -np.pi + 1e-6)
    (trip,) = ended(told(track))
    assert trip.distance_m < 1510.0
