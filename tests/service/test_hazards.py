"""Braking that a detected hazard explains does not count: in whichever order things come, and only in one's tenant."""

from __future__ import annotations

import math

import pytest
from sqlalchemy import delete, insert, select

from service.accidents.reviewing import review_accident, review_candidate
from service.storage import accidents, audit, candidates, erasure, manoeuvres, records, tables, trips, vehicles
from service.storage.database import read, write
from service.storage.erasure import Span
from service.storage.places import Box
from tests.service.fleet_drives import S, seconds
from tests.service.fleet_drives import trips as drives
from tests.service.stored_rows import accident_row, candidate_row, trip_row
from tests.service.trip_harness import Driver

AHEAD_M = 200.0


@pytest.fixture(scope="module")
def packets():
    return [one for part in list(drives(1)) for one in seconds(part)]


class Road:
    """A car with an assessed trip and a braking in its midst, and another vehicle that may have accidents."""

    def __init__(self, database, packets, tenant="default"):
        self.driver = Driver(database)
        self.database = database
        self.driver.drive(packets)
        self.driver.turn()
        self.other = self.driver.directory.register(tenant, "other").ref
        with write(database) as connection:
            (self.trip,) = trips.page(
                connection, "default", self.driver.ref.pk, from_ns=None, to_ns=None, after=None, limit=9
            )
            self.braking_ns = self.trip.start_ns + 60 * S
            self.at = trips.position_before(connection, self.driver.ref.pk, self.braking_ns, S)
            connection.execute(delete(tables.manoeuvres))
            row = manoeuvres.ManoeuvreRow(
                id="the-braking",
                tenant_id="default",
                vehicle_pk=self.driver.ref.pk,
                vehicle_id="car",
                kind="braking",
                start_ns=self.braking_ns,
                peak_ns=self.braking_ns + S,
                end_ns=self.braking_ns + 3 * S,
                stored_ns=1,
                peak_mps2=6.0,
                direction="",
                aggressive=True,
                counted=True,
                recovery=False,
                **dict.fromkeys(
                    ("speed_before_mps", "speed_at_peak_mps", "speed_after_mps", "across_mps2", "radius_m")
                ),
                heading_change_deg=None,
                lat_deg=self.at.lat_deg,
                lon_deg=self.at.lon_deg,
            )
            assert manoeuvres.put(connection, row)
        self.touch()

    def touch(self):
        """Have the car's trip due, and all that is due assessed until nothing is left to do."""
        with write(self.database) as connection:
            trips.mark_trip_due(connection, self.trip.id, self.now())
        self.settle()

    def now(self):
        with read(self.database) as connection:
            return 1 + max(
                one or 0
                for row in connection.execute(select(tables.trips.c.due_ns, tables.trips.c.assessed_ns))
                for one in row
            )

    def settle(self):
        for _ in range(9):
            if not self.driver.turn(1.0):
                return
        raise AssertionError("trips have each other assessed without an end")

    def place(self, ahead_m=AHEAD_M):
        """So far on from where it was braked."""
        course = math.atan2(self.at.ve_mps, self.at.vn_mps)
        north, east = (ahead_m * part(course) for part in (math.cos, math.sin))
        return self.at.lat_deg + north / 111_200.0, self.at.lon_deg + east / (
            111_200.0 * math.cos(math.radians(self.at.lat_deg))
        )

    def accident(self, ahead_m=AHEAD_M, before_s=600.0, **changes):
        """The other vehicle has an accident on a trip of its own, which thereby is due."""
        lat, lon = self.place(ahead_m)
        t_ns = self.braking_ns - round(before_s * S)
        trip = trip_row(self.other.pk, 0, 1) | {"start_ns": t_ns - 60 * S, "end_ns": t_ns, "due_ns": self.now()}
        told = accident_row(self.other.tenant_id, self.other.pk, 0, lat, lon) | {"t_ns": t_ns, "trip_id": trip["id"]}
        with write(self.database) as connection:
            connection.execute(insert(tables.trips), [trip])
            connection.execute(insert(tables.accidents), [told | changes])
        return told["id"]

    def candidate(self, after_s, reason="pothole"):
        told = candidate_row("default", self.driver.ref.pk, 0, reason=reason)
        told |= {"t_ns": self.braking_ns + round(after_s * S)}
        with write(self.database) as connection:
            connection.execute(insert(tables.accident_candidates), [told])
        return told["id"]

    @property
    def excuse(self):
        with read(self.database) as connection:
            return manoeuvres.find(connection, "default", "the-braking").excuse

    def says(self, reason, by=None):
        """That the braking is excused so, and the records with it."""
        assert self.excuse == (None if reason is None else (reason, by))
        with read(self.database) as connection:
            record = records.find(connection, self.trip.id).record
            whole = records.of_period(connection, self.driver.ref.pk, 0, 2**62)
        counted = ({}, {"braking": 1}) if reason else ({"braking": 1}, {})
        assert (record.manoeuvres, record.excused) == counted
        assert (whole.manoeuvres, whole.excused) == counted
        return True

    def assessed_from_nothing(self):
        """As a recovery would do it that has the packets alone; returns whether the records are the same to the bit."""
        before = self.driver.stored()
        with write(self.database) as connection:
            connection.execute(tables.manoeuvres.update().values(excused=None, excused_by=None))
            records.remove(connection, self.driver.ref.pk)
        self.touch()
        return self.driver.stored() == before


@pytest.fixture
def road(any_database, packets):
    return Road(any_database, packets)


@pytest.fixture
def sqlite_road(database, packets):
    return Road(database, packets)


def test_an_accident_ahead_excuses_until_it_is_taken_back_whichever_came_first(road):
    assert road.says(None)
    accident_id = road.accident()  # told after the trip was assessed
    road.settle()
    assert road.says("hazard", accident_id)
    assert road.assessed_from_nothing(), "told before it"
    assert road.says("hazard", accident_id)
    for verdict, reason in (("false", None), ("confirmed", "hazard"), ("false", None)):
        with write(road.database) as connection:
            row = accidents.find(connection, "default", accident_id, to_change=True)
            review_accident(connection, row, verdict, "", None)
        road.settle()
        assert road.says(reason, accident_id if reason else None)
        assert road.assessed_from_nothing()
    with read(road.database) as connection:
        entries = [one for one in audit.page(connection, "default", None, 99) if one.action == "trip.rescored"]
    assert f"trip/{road.trip.id}" in {one.subject for one in entries}
    road.driver.told.clear()
    road.touch()
    assert road.driver.told == [], "nothing changed, so nothing is told"


@pytest.mark.parametrize(
    "changes",
    [
        {"ahead_m": -200.0},
        {"ahead_m": 900.0},
        {"before_s": 3700.0},
        {"before_s": -30.0},
        {"status": "retracted"},
        {"kind": "parked_hit"},
        {"lat_deg": None, "lon_deg": None},
    ],
    ids=lambda changes: "-".join(map(str, changes)) + "-" + str(next(iter(changes.values()))),
)
def test_another_accident_does_not(sqlite_road, changes):
    sqlite_road.accident(**changes)
    sqlite_road.settle()
    assert sqlite_road.says(None)


def test_another_tenants_accident_neither_excuses_nor_is_told(database, packets):
    road = Road(database, packets, tenant="somebody-else")
    road.accident()
    road.settle()
    road.touch()
    assert road.says(None)


def test_two_that_explain_each_others_braking_are_not_assessed_for_ever(sqlite_road):
    road = sqlite_road
    accident_id = road.accident(before_s=10.0)
    theirs_ns = road.braking_ns - 40 * S
    with write(road.database) as connection:
        mine = accident_row("default", road.driver.ref.pk, 0, *road.place()) | {"trip_id": road.trip.id}
        mine |= {"t_ns": theirs_ns - 5 * S}
        their_braking = connection.execute(select(tables.manoeuvres)).one()._asdict() | {
            "id": "their-braking",
            "vehicle_pk": road.other.pk,
            "start_ns": theirs_ns,
            "end_ns": theirs_ns + 3 * S,
        }
        their_place = connection.execute(
            select(tables.track_points).where(tables.track_points.c.t_ns == road.at.t_ns)
        ).one()._asdict() | {"vehicle_pk": road.other.pk, "t_ns": theirs_ns}
        connection.execute(insert(tables.accidents), [mine])
        connection.execute(insert(tables.manoeuvres), [their_braking])
        connection.execute(insert(tables.track_points), [their_place])
    road.touch()
    assert road.says("hazard", accident_id)
    with read(road.database) as connection:
        assert manoeuvres.find(connection, "default", "their-braking").excuse == ("hazard", mine["id"])


def test_ones_own_accident_and_a_reviewer_come_first(sqlite_road):
    road = sqlite_road
    other_id = road.accident()
    road.settle()
    with write(road.database) as connection:
        manoeuvres.judge(connection, "the-braking", "confirmed")
    road.touch()
    assert road.excuse is None, "a reviewer has the last word"
    with write(road.database) as connection:
        manoeuvres.judge(connection, "the-braking", None)
        mine = accident_row("default", road.driver.ref.pk, 0, *road.place()) | {"trip_id": road.trip.id}
        mine |= {"t_ns": road.braking_ns + 4 * S}
        connection.execute(insert(tables.accidents), [mine])
    road.touch()
    assert road.excuse == ("accident", mine["id"])
    with write(road.database) as connection:
        row = accidents.find(connection, "default", mine["id"], to_change=True)
        review_accident(connection, row, "false", "", None)
    road.settle()
    assert road.excuse == ("hazard", other_id)


def test_a_pothole_that_was_struck_excuses_and_a_speed_bump_does_not(road):
    for reason in ("speed_bump", "kerb", "railway_crossing", "emergency_braking"):
        road.candidate(1.0, reason)
    road.candidate(-1.0)
    road.candidate(6.0)
    road.touch()
    assert road.says(None)
    struck = road.candidate(4.0)
    road.touch()
    assert road.says("hazard", struck)
    assert road.assessed_from_nothing()


def test_a_pothole_that_was_an_accident_after_all_excuses_as_that(sqlite_road):
    road = sqlite_road
    struck = road.candidate(4.0)
    road.touch()
    assert road.says("hazard", struck)
    with write(road.database) as connection:
        candidate = candidates.find(connection, "default", struck, to_change=True)
        became = review_candidate(connection, candidate, road.driver.ref, "accident", "", None).accident_id
    road.settle()
    assert road.excuse == ("accident", became)
    with write(road.database) as connection:
        candidate = candidates.find(connection, "default", struck, to_change=True)
        review_candidate(connection, candidate, road.driver.ref, "no_accident", "", None)
    road.settle()
    assert road.excuse == ("hazard", struck)


def test_what_is_not_kept_any_more_excuses_still(sqlite_road):
    road = sqlite_road
    struck = road.candidate(4.0)
    road.touch()
    with write(road.database) as connection:
        connection.execute(delete(tables.accident_candidates))  # kept for 90 days
    road.touch()
    assert road.says("hazard", struck)


def test_without_a_track_an_accident_excuses_as_long_as_it_stands(sqlite_road):
    road = sqlite_road
    accident_id = road.accident()
    road.settle()
    with write(road.database) as connection:
        connection.execute(delete(tables.track_points))
        connection.execute(tables.manoeuvres.update().values(lat_deg=None, lon_deg=None))
    road.touch()
    assert road.says("hazard", accident_id)
    with write(road.database) as connection:
        row = accidents.find(connection, "default", accident_id, to_change=True)
        review_accident(connection, row, "false", "", None)
    road.settle()
    assert road.says(None)


@pytest.mark.parametrize("unregistered", [False, True])
def test_what_others_had_erased_excuses_without_being_named(road, unregistered):
    road.accident()
    road.settle()
    with write(road.database) as connection:
        if unregistered:
            vehicles.delete_row(connection, road.other.pk)
        else:
            erasure.remove(connection, road.other, Span.asked(None, None), lambda: b"")
    assert road.says("hazard", None)
    road.touch()
    assert road.says("hazard", None)


@pytest.mark.parametrize(("lat_deg", "lon_deg"), [(60.0, 25.0), (0.0, 180.0), (-75.0, -179.9999), (89.999, 10.0)])
def test_a_box_holds_all_that_is_near(lat_deg, lon_deg):
    box = Box.around(lat_deg, lon_deg, 1000.0)
    for bearing in range(0, 360, 5):
        north, east = (999.0 * part(math.radians(bearing)) for part in (math.cos, math.sin))
        lat = lat_deg + north / 111_695.0  # m a degree of the meridian at the pole, where it is longest
        lon = math.remainder(lon_deg + east / (111_695.0 * max(math.cos(math.radians(lat)), 1e-9)), 360.0)
        if lat > 90.0:
            continue
        west, east_end = box.min_lon_deg, box.max_lon_deg
        inside = west <= lon <= east_end if west <= east_end else (lon >= west or lon <= east_end)
        assert box.min_lat_deg <= lat <= box.max_lat_deg
        assert inside, bearing
