"""Matching on an invented map: the street under a drive, its limit and district, and what happens when it cannot be."""

import os
import signal
import time

import numpy as np
import pytest

from service.roads.matching import RoadService
from service.roads.protocol import NO_WAY, Certainty, RoadClass
from tests.road_map import BORDER, MAIN, MPH, PARALLEL, RURAL, TUNNEL, TWO_LIMITS, at, heading_deg

SECOND_NS = 1_000_000_000
START_NS = 1_714_984_200 * SECOND_NS


@pytest.fixture(scope="module")
def roads(built_roads):
    with RoadService(built_roads, processes=1) as service:
        yield service


def drive(corners_m, speed_mps=10.0, every_s=1.0, sd_m=2.0, rng=None):
    """Positions along a line with errors of ``sd_m``: times, latitude, longitude, sd and heading."""
    corners = np.array(corners_m, float)
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(corners, axis=0).T))])
    s = np.arange(0.0, along[-1], speed_mps * every_s)
    x, y = (np.interp(s, along, corners[:, i]) for i in (0, 1))
    piece = np.clip(np.searchsorted(along, s, side="right") - 1, 0, len(corners) - 2)
    heading = np.array([heading_deg(*step) for step in np.diff(corners, axis=0)])[piece]
    if rng is not None:
        x, y = x + sd_m * rng.standard_normal(x.size), y + sd_m * rng.standard_normal(x.size)
    lon, lat = at(x, y)
    t_ns = START_NS + np.round(np.arange(s.size) * every_s * SECOND_NS).astype(np.int64)
    return t_ns, lat, lon, np.full(s.size, sd_m), heading


def share_on(matched, way):
    return np.mean(matched.way_id == way)


def test_a_drive_is_on_its_street_and_not_on_the_one_beside_it(roads):
    rng = np.random.default_rng(1)
    for way, y in ((MAIN, 0), (PARALLEL, 60)):
        matched = roads.match(*drive([(20, y), (1480, y)], sd_m=8.0, rng=rng))
        # Errors of 8 m against 60 m between the streets; at corners a point may be laid on the crossing one.
        assert share_on(matched, way) > 0.95
        assert matched.street(50) == {MAIN: "Hauptweg", PARALLEL: "Parallelgasse"}[way]
        assert np.nanmax(matched.distance_m) < 40.0


def test_what_is_known_of_the_street_comes_along(roads):
    matched = roads.match(*drive([(20, 0), (400, 0)]))
    assert (matched.road_class == RoadClass.PRIMARY).all()
    assert (matched.limit_kmh == 50).all()
    assert (matched.limit_certainty == Certainty.TAGGED).all()
    assert {matched.district(i) for i in range(len(matched))} == {"Westviertel"}
    assert matched.confidence.min() > 0.3
    # Away from junctions the nearest other street is 60 m off, 30 standard deviations.
    assert matched.confidence[10] > 0.99


def test_a_turn_is_followed(roads):
    matched = roads.match(*drive([(20, 0), (500, 0), (500, 580)], rng=np.random.default_rng(2)))
    assert share_on(matched, MAIN) + share_on(matched, MPH) > 0.95
    assert matched.way_id[10] == MAIN
    assert matched.way_id[-5] == MPH


def test_the_limit_is_that_of_the_direction_driven(roads):
    up = roads.match(*drive([(1500, 100), (1500, 560)]))
    down = roads.match(*drive([(1500, 560), (1500, 100)]))
    assert set(up.way_id.tolist()) == set(down.way_id.tolist()) == {TWO_LIMITS}
    assert set(up.limit_kmh.tolist()) == {40.0}
    assert set(down.limit_kmh.tolist()) == {20.0}


def test_a_tunnel_is_matched_by_a_drifted_track(roads):
    t_ns, lat, lon, sd_m, heading = drive([(1500, 100), (1500, 600), (2380, 600), (2400, 600)])
    inside = lon > at(1500, 0)[0] + 1e-6
    # Off by as much as a minute without GNSS brings, and stated so.
    off_m = np.where(inside, np.linspace(0, 25, lat.size), 0.0)
    _, north = at(0, off_m)
    sd_m = np.where(inside, 15.0, sd_m)
    matched = roads.match(t_ns, lat + north - at(0, 0)[1], lon, sd_m, heading)
    assert share_on(matched.at(np.flatnonzero(inside)[2:]), TUNNEL) > 0.95
    assert matched.tunnel[np.flatnonzero(inside)[10]]
    assert not matched.tunnel[0]


def test_a_border_street_keeps_its_district(roads):
    matched = roads.match(*drive([(1000, 100), (1000, 560)], sd_m=6.0, rng=np.random.default_rng(3)))
    assert share_on(matched, BORDER) > 0.95
    assert len({matched.district(i) for i in range(len(matched))}) == 1


def test_off_the_map_nothing_is_known(roads):
    t_ns, lat, lon, sd_m, heading = drive([(20, 0), (400, 0)])
    far = roads.match(t_ns, lat + 3.0, lon, sd_m, heading)
    assert (far.way_id == NO_WAY).all()
    assert np.isnan(far.limit_kmh).all()
    assert far.district(0) is None
    # In a field: no road, but a district.
    field = roads.match(t_ns, lat + at(0, 900)[1] - at(0, 0)[1], lon, sd_m, heading)
    assert (field.way_id == NO_WAY).all()
    assert field.district(5) == "Westviertel"


def test_positions_that_are_missing_are_unknown_and_disturb_no_other(roads):
    t_ns, lat, lon, sd_m, heading = drive([(20, 0), (900, 0)])
    lat[30:33] = np.nan
    sd_m[40] = np.nan
    matched = roads.match(t_ns, lat, lon, sd_m, heading)
    missing = np.zeros(lat.size, bool)
    missing[[30, 31, 32, 40]] = True
    assert (matched.way_id[missing] == NO_WAY).all()
    assert (matched.way_id[~missing] == MAIN).all()


@pytest.mark.parametrize("n", [0, 1, 2])
def test_few_positions_are_matched_as_well(roads, n):
    t_ns, lat, lon, sd_m, heading = (one[10 : 10 + n] for one in drive([(20, 0), (400, 0)]))
    matched = roads.match(t_ns, lat, lon, sd_m, heading)
    assert len(matched) == n
    assert (matched.way_id == MAIN).all()


def test_positions_many_times_a_second_are_on_the_same_ways(roads):
    dense = drive([(20, 0), (500, 0), (500, 580)], every_s=0.02)
    matched = roads.match(*dense)
    assert len(matched) == dense[0].size
    assert share_on(matched, MAIN) == pytest.approx(480 / 1060, abs=0.03)
    assert share_on(matched, MPH) == pytest.approx(580 / 1060, abs=0.03)


def test_sparse_positions_are_matched_along_the_road(roads):
    # A fix every 40 s, 600 m apart, on a road whose nodes are 500 m apart.
    matched = roads.match(*drive([(2700, 0), (5900, 0)], speed_mps=15.0, every_s=40.0))
    assert (matched.way_id == RURAL).all()


def test_a_drive_is_told_the_same_however_long_it_goes_on(roads):
    long = drive([(20, 0), (1480, 0), (1480, 60), (20, 60)], speed_mps=5.0)
    matched = roads.match(*long)
    repeated = roads.match(*long)
    assert matched.way_id.tolist() == repeated.way_id.tolist()
    assert long[0].size > 500
    assert share_on(matched, MAIN) == pytest.approx(0.49, abs=0.03)
    assert share_on(matched, PARALLEL) == pytest.approx(0.49, abs=0.03)


def place(roads, x_m, y_m, covariance=(9.0, 9.0, 0.0), heading=None):
    lon, lat = at(x_m, y_m)
    return roads.place(lat, lon, covariance, heading)


def test_the_street_at_one_place(roads):
    found = place(roads, 700, 5)
    assert (found.way_id, found.street, found.district) == (MAIN, "Hauptweg", "Westviertel")
    assert found.distance_m == pytest.approx(5.0, abs=0.1)
    assert found.confidence > 0.99
    assert found.json()["limit_certainty"] == "tagged"


def test_how_a_place_is_spread_decides_between_streets(roads):
    # Halfway and a little nearer to the Hauptweg: as good as any, unless the spread is along north.
    undecided = place(roads, 700, 28, (400.0, 400.0, 0.0))
    assert undecided.confidence < 0.7
    # At a corner, 12 m from one street and 10 m from the other: the covariance says along which the error goes.
    assert place(roads, 510, 12, (4.0, 400.0, 0.0)).way_id == MPH
    assert place(roads, 510, 12, (400.0, 4.0, 0.0)).way_id == MAIN


def test_the_heading_decides_at_a_corner(roads):
    assert place(roads, 508, 8, heading=0.0).way_id == MPH
    assert place(roads, 508, 8, heading=90.0).way_id == MAIN


def test_at_one_place_the_heading_chooses_the_direction(roads):
    assert place(roads, 1500, 300, heading=0.0).limit_kmh == 40
    assert place(roads, 1500, 300, heading=180.0).limit_kmh == 20


def test_a_place_in_a_field_has_a_district_only(roads):
    found = place(roads, 200, 900)
    assert (found.way_id, found.street, found.district, found.confidence) == (None, None, "Westviertel", 0.0)
    assert place(roads, float("nan"), 0).way_id is None


def test_a_process_that_dies_is_replaced(built_roads):
    points = drive([(20, 0), (400, 0)])
    with RoadService(built_roads, processes=1) as roads:
        assert (roads.match(*points).way_id == MAIN).all()
        (worker,) = roads._processes._workers
        os.kill(worker._process.pid, signal.SIGKILL)
        worker._process.join(10)
        assert (roads.match(*points).way_id == MAIN).all()
        os.kill(worker._process.pid, signal.SIGSTOP)
        hung = worker._process
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("service.roads.workers.MOST_S", 1.0)  # in which a new process may not come up either
            roads.match(*points)
        assert not hung.is_alive()
        assert (roads.match(*points).way_id == MAIN).all()
        last = worker._process
    deadline = time.monotonic() + 10
    while last.is_alive() and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not last.is_alive()


def test_a_position_that_might_be_anywhere_is_on_no_road_for_sure(roads):
    t_ns, lat, lon, _, heading = drive([(20, 0), (400, 0)])
    matched = roads.match(t_ns, lat, lon, np.full(lat.size, 5000.0), heading)
    assert len(matched) == lat.size
    assert np.nanmax(matched.confidence) < 0.6
    assert place(roads, 700, 0, (1e9, 1e9, 0.0)).confidence < 0.6


def test_after_the_stop_everything_is_unknown(built_roads):
    roads = RoadService(built_roads, processes=1)
    points = drive([(20, 0), (100, 0)])
    assert (roads.match(*points).way_id == NO_WAY).all()
    roads.start()
    roads.stop()
    assert (roads.match(*points).way_id == NO_WAY).all()
    assert roads.place(points[1][0], points[2][0], (4.0, 4.0, 0.0)).way_id is None
