"""Trips become records: once they end or fall silent, the same whenever they are computed, anew when they change."""

from __future__ import annotations

import pytest
from sqlalchemy import delete, insert, select, update

from core.driving.exposure import Facet
from core.scoring.record import Record
from schemas.vehicles import VehicleConfig
from service.storage import audit, manoeuvres, records, schema, trips
from service.storage.database import open_database, read, write
from service.storage.tables import accidents, track_points
from service.storage.tables import manoeuvres as manoeuvre_table
from service.storage.tables import trips as trip_table
from service.trips.timeline import Timeline
from service.trips.worker import TripPolicy
from tests.service.fleet_drives import S, seconds
from tests.service.fleet_drives import trips as drives
from tests.service.stored_rows import accident_row
from tests.service.trip_harness import MOUNTED, Driver

FOREVER = (0, 2**62)


@pytest.fixture(scope="module")
def packets():
    return [one for part in drives(2) for one in seconds(part)]


@pytest.fixture(scope="module")
def driven(packets, tmp_path_factory):
    """A vehicle with two trips, assessed."""
    engine = open_database(f"sqlite:///{tmp_path_factory.mktemp('trips') / 'a.db'}")
    schema.upgrade(engine)
    driver = Driver(engine)
    driver.drive(packets)
    assert driver.turn() == 2
    yield driver
    engine.dispose()


def trip_rows(driver):
    with read(driver.database) as connection:
        return trips.page(connection, "default", driver.ref.pk, from_ns=None, to_ns=None, after=None, limit=9)[::-1]


def whole(driver):
    with read(driver.database) as connection:
        return records.of_period(connection, driver.ref.pk, *FOREVER, cells=True)


def record_of(driver, trip_id):
    with read(driver.database) as connection:
        return records.find(connection, trip_id).record


def test_a_trip_that_ended_has_its_record(driven):
    rows = trip_rows(driven)
    assert [(row.ended, row.due_ns, row.assessed_ns is not None) for row in rows] == [(True, None, True)] * 2
    assert driven.scored == [row.id for row in rows]
    assert {event.body["cause"] for event in driven.told} == {"trip"}
    assert all(event.body["scores"]["payd"]["score"] > 0.0 for event in driven.told)
    for row in rows:
        record = record_of(driven, row.id)
        # Left sums at whole seconds beside an integral at every sample: a second at the ends, and what speed bends.
        assert record.distance_m == pytest.approx(row.distance_m, rel=0.01)
        assert record.exposure.total.time_s == pytest.approx(row.moving_s, abs=15.0)
        assert record.trips == 1
        instants = record.belief["fused"].instants
        assert instants == pytest.approx((row.end_ns - row.start_ns) * 1e-9, abs=1.0)
        assert sum(record.belief["fused"].mean()) == pytest.approx(1.0, abs=1e-8)
        for facet in Facet:
            told = record.cells if facet is Facet.CELL else record.exposure.by[facet]
            assert sum(one.distance_mm for one in told.values()) == record.exposure.total.distance_mm
        assert record.exposure.by[Facet.ROAD_CLASS].keys() == {""}
        assert record.speeding.known_ms == 0 < record.speeding.unknown_ms
        assert record.evidence["mileage"] == ((record.exposure.total.distance_mm, "trip", row.id),)
        assert record.mean_coverage()["vehicle.motion"] > 0.9
        assert record.mean_coverage()["driver.age"] == 0.0
    assert whole(driven).trips == 2
    assert whole(driven).days == 1


def test_the_timeline_is_what_the_record_sums(driven):
    for row in trip_rows(driven):
        with read(driven.database) as connection:
            found = records.find(connection, row.id)
        timeline = Timeline.unpacked(found.timeline)
        assert len(timeline.t_ns) == found.record.belief["fused"].instants
        assert row.start_ns <= timeline.t_ns[0] < row.start_ns + S
        mean = found.record.belief["fused"].mean()
        assert timeline.mass["fused"].mean(axis=0) == pytest.approx(
            mean, abs=5e-5
        )  # half of what masses are counted in
        assert set(timeline.mass) == {"fused", "environment", "vehicle"}
        assert timeline.speed_mps.max() == pytest.approx(row.max_speed_mps, abs=0.5)
        assert timeline.packed() == found.timeline


def test_a_fresh_database_gives_the_same_bits(driven, packets, postgres_database):
    again = Driver(postgres_database)
    for begin in range(0, len(packets), 97):  # in other batches, with a restart between each, looked at in between
        again.drive(packets[begin : begin + 97])
        again.turn(TripPolicy().silent_s if begin % 2 else 0.0)
    again.turn()
    assert again.stored() == driven.stored()
    with read(postgres_database) as connection, read(driven.database) as other:
        chosen = select(*(one for one in manoeuvre_table.c if one.name not in ("stored_ns", "vehicle_pk")))
        ordered = chosen.order_by(manoeuvre_table.c.start_ns, manoeuvre_table.c.kind)
        assert connection.execute(ordered).all() == other.execute(ordered).all()


def test_a_trip_without_an_end_is_assessed_once_nothing_comes_and_again_when_more_does(packets, database):
    driver = Driver(database)
    driver.drive(packets[:100])
    assert driver.turn(TripPolicy().silent_s - 1.0) == 0
    assert driver.turn(TripPolicy().silent_s) == 1
    (before,) = trip_rows(driver)
    assert (before.ended, before.due_ns) == (False, None)
    first = record_of(driver, before.id)
    driver.drive(packets[100:240])
    assert driver.turn(TripPolicy().silent_s) == 1
    (after,) = trip_rows(driver)
    assert after.id == before.id
    assert record_of(driver, after.id).distance_m > first.distance_m + 100.0
    assert whole(driver).trips == 1


def test_what_changes_while_a_trip_is_assessed_is_not_lost(packets, database, monkeypatch):
    driver = Driver(database)
    driver.drive(packets[:250])
    real = driver.worker._found

    def meanwhile(trip, ref, now_ns):
        found = real(trip, ref, now_ns)
        with write(database) as connection:
            trips.mark_trip_due(connection, trip.id, now_ns + 1)
        return found

    monkeypatch.setattr(driver.worker, "_found", meanwhile)
    driver.turn()
    assert driver.stored() == []
    monkeypatch.setattr(driver.worker, "_found", real)
    driver.turn()
    assert len(driver.stored()) == 1


def test_a_trip_that_cannot_be_assessed_stops_no_other(packets, database, monkeypatch):
    driver = Driver(database)
    driver.drive(packets)
    bad, good = trip_rows(driver)
    real = driver.worker._found

    def failing(trip, ref, now_ns):
        if trip.id == bad.id:
            raise ZeroDivisionError
        return real(trip, ref, now_ns)

    monkeypatch.setattr(driver.worker, "_found", failing)
    assert driver.turn() == 2
    assert [row[0] for row in driver.stored()] == [good.id]
    assert driver.turn() == 0
    monkeypatch.setattr(driver.worker, "_found", real)
    with write(database) as connection:
        trips.mark_trip_due(connection, bad.id, 1)
    driver.turn()
    assert len(driver.stored()) == 2


def braking(driver, connection, start_ns, **changes):
    """A harsh braking in the database."""
    row = manoeuvres.ManoeuvreRow(
        **{
            "id": f"m-{start_ns}",
            "tenant_id": "default",
            "vehicle_pk": driver.ref.pk,
            "vehicle_id": "car",
            "kind": "braking",
            "start_ns": start_ns,
            "peak_ns": start_ns + S,
            "end_ns": start_ns + 2 * S,
            "stored_ns": 1,
            "peak_mps2": 6.0,
            "direction": "",
            "aggressive": True,
            "counted": True,
            "recovery": False,
            **dict.fromkeys(
                ("speed_before_mps", "speed_at_peak_mps", "speed_after_mps", "across_mps2", "radius_m"), 9.0
            ),
            "heading_change_deg": 0.0,
        }
        | changes
    )
    assert manoeuvres.put(connection, row)
    assert not manoeuvres.put(connection, row), "it is there"
    return row


@pytest.fixture
def rescored(packets, database):
    """A vehicle with one assessed trip and, in the midst of it, a braking; with the times of both."""
    driver = Driver(database)
    driver.drive(packets[:250])
    driver.turn()
    (trip,) = trip_rows(driver)
    with write(database) as connection:
        connection.execute(delete(manoeuvre_table))
        row = braking(driver, connection, trip.start_ns + 60 * S)
        trips.mark_due(connection, driver.ref.pk, row.start_ns, row.start_ns, 2)
    driver.turn()
    return driver, trip, row


def test_a_manoeuvre_counts_unless_an_accident_or_a_reviewer_explains_it(rescored):
    driver, trip, row = rescored
    record = record_of(driver, trip.id)
    assert (record.manoeuvres, record.excused) == ({"braking": 1}, {})
    assert record.evidence["braking"] == ((6000, "manoeuvre", row.id),)
    for verdict, counted, excused in (
        ("defensive", {}, {"braking": 1}),
        ("false", {}, {}),
        ("confirmed", {"braking": 1}, {}),
    ):
        with write(driver.database) as connection:
            manoeuvres.judge(connection, row.id, verdict)
            trips.mark_trip_due(connection, trip.id, 3)
        driver.turn()
        record = record_of(driver, trip.id)
        assert (dict(record.manoeuvres), dict(record.excused)) == (counted, excused), verdict
        assert ("braking" in record.evidence) == bool(counted)
    assert whole(driver).manoeuvres == {"braking": 1}


def test_an_accident_excuses_until_it_is_taken_back_and_the_audit_says_so(rescored):
    driver, trip, row = rescored
    with write(driver.database) as connection:
        told = accident_row("default", driver.ref.pk, 0) | {
            "trip_id": None,
            "t_ns": row.end_ns + S,
            "status": "suspected",
        }
        connection.execute(insert(accidents), [told])
        trips.mark_trip_due(connection, trip.id, 4)
    driver.turn()
    record = record_of(driver, trip.id)
    assert (record.manoeuvres, record.excused, record.accidents) == ({}, {"braking": 1}, {"severe": 1})
    with write(driver.database) as connection:
        assert manoeuvres.find(connection, "default", row.id).excused == "accident"
        assert connection.scalar(select(accidents.c.trip_id)) == trip.id, "told before its trip was"
        connection.execute(update(accidents).values(status="retracted"))
        trips.mark_trip_due(connection, trip.id, 5)
    driver.turn()
    record = record_of(driver, trip.id)
    assert (record.manoeuvres, record.excused, record.accidents) == ({"braking": 1}, {}, {})
    with read(driver.database) as connection:
        entries = [one for one in audit.page(connection, "default", None, 9) if one.action == "trip.rescored"]
    assert [one.subject for one in entries] == [f"trip/{trip.id}"] * 3
    assert entries[0].detail["before"]["excused"] == {"braking": 1}
    assert entries[0].detail["after"]["manoeuvres"] == {"braking": 1}
    assert len(driver.scored) == 4


def test_without_its_track_a_trip_keeps_what_that_told(rescored):
    driver, trip, row = rescored
    before = record_of(driver, trip.id)
    with write(driver.database) as connection:
        connection.execute(delete(track_points))
        manoeuvres.judge(connection, row.id, "defensive")
        trips.mark_trip_due(connection, trip.id, 6)
    driver.turn()
    after = record_of(driver, trip.id)
    assert after.excused == {"braking": 1}
    assert (after.exposure, after.belief, after.cells) == (before.exposure, before.belief, before.cells)


def test_a_trip_of_one_position_and_one_of_none(database):
    driver = Driver(database)
    figures = dict.fromkeys(("start_lat_deg", "start_lon_deg", "end_lat_deg", "end_lon_deg"), 1.0)
    figures |= dict.fromkeys(("distance_m", "moving_s", "coasting_s", "max_speed_mps"), 1.0)
    point = dict.fromkeys(("lat_deg", "lon_deg", "alt_m", "vn_mps", "ve_mps", "vd_mps"), 0.0)
    point |= dict.fromkeys(("sd_n_m", "sd_e_m", "sd_d_m"), 1.0) | {"cov_ne_m2": 0.0, "gnss_used": True, "mode": 1}
    with write(database) as connection:
        for trip_id, start_ns in (("one", 100 * S), ("none", 500 * S)):
            same = {"id": trip_id, "vehicle_pk": driver.ref.pk, "start_ns": start_ns, "end_ns": start_ns + 10 * S}
            connection.execute(insert(trip_table), [same | figures | {"ended": True, "due_ns": 1}])
        connection.execute(insert(track_points), [point | {"vehicle_pk": driver.ref.pk, "t_ns": 105 * S}])
    assert driver.turn() == 2
    for trip_id in ("one", "none"):
        record = record_of(driver, trip_id)
        assert record.trips == 1
        assert record.exposure.total == (0, 0)
        assert record.belief["vehicle"].mean()[7] == 1.0, "no velocity: on Theta, as in the paper"
    assert whole(driver).trips == 2


def test_another_time_zone_tells_days_apart_anew(packets, database):
    driver = Driver(database)
    driver.drive(packets[:250])
    driver.turn()
    driver.worker.keep_days()
    driver.directory.register("default", "car", VehicleConfig(**MOUNTED.model_dump() | {"time_zone": "Asia/Tokyo"}))
    driver.worker.keep_days()
    with read(database) as connection:
        assert records.zones(connection) == [(driver.ref.pk, "Asia/Tokyo")]
    assert whole(driver) != Record()
