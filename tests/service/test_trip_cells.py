"""Which trips drove farthest in a cell: as a search through all of them says, whatever was stored or removed."""

from __future__ import annotations

import random
from dataclasses import replace

import pytest
from sqlalchemy import func, select

from core.driving.exposure import Driven
from core.scoring.record import Evidence, heaviest
from service.storage import records, trip_cells, vehicles
from service.storage.database import read, write
from service.storage.tables import trip_cells as table
from service.storage.tables import trip_records
from tests.service.trip_records import DAY_NS, a_trip_record, a_vehicle, put, put_all

CELLS = [f"881f1d48{number:02x}fffff" for number in range(12)]
TRIPS = 120


def a_trip(rng, pk, number):
    """A trip through some cells, and through what is no cell; distances are few, so that some are the same."""
    row = a_trip_record(rng, pk, f"{pk}-{number}", number * DAY_NS // 3 + rng.randrange(1000))
    driven = {cell: Driven(rng.randrange(4) * 1000, 1) for cell in [*rng.sample(CELLS, 5), ""]}
    return replace(row, record=replace(row.record, cells=driven))


def searched(rows, cell, from_ns, to_ns):
    """By a search through all trips: how far each of the farthest drove in a cell."""
    in_time = [
        row for row in rows if from_ns <= row.start_ns < to_ns and row.record.cells.get(cell, Driven()).distance_mm
    ]
    return heaviest(Evidence(row.record.cells[cell].distance_mm, "trip", row.trip_id) for row in in_time)


def agree(database, pk, rows, rng):
    """Both ways to look say what a search does, but for which of trips that drove equally far."""
    with read(database) as connection:
        for _ in range(12):
            from_ns = rng.randrange(TRIPS * DAY_NS // 3)
            to_ns = from_ns + rng.randrange(40 * DAY_NS)
            for trips in (0, 10**6):
                found = trip_cells.farthest(connection, pk, CELLS, from_ns, to_ns, trips=trips)
                for cell in CELLS:
                    expected, told = searched(rows, cell, from_ns, to_ns), found.get(cell, [])
                    assert sorted(one.weight for one in told) == sorted(one.weight for one in expected)
                    farthest = {row.trip_id: row.record.cells.get(cell, Driven()).distance_mm for row in rows}
                    assert all(farthest[one.id] == one.weight for one in told)
        assert trip_cells.farthest(connection, pk, [], 0, 2**62, trips=1) == {}


def test_it_follows_what_is_stored_changed_and_removed(any_database):
    rng = random.Random(5)
    with write(any_database) as connection:
        pk, other = a_vehicle(connection), a_vehicle(connection, "other")
        rows = {row.trip_id: row for row in (a_trip(rng, pk, number) for number in range(TRIPS))}
        strangers = [a_trip(rng, other, number) for number in range(40)]
        put_all(connection, list(rows.values()))
        put_all(connection, strangers)
    agree(any_database, pk, rows.values(), rng)
    with write(any_database) as connection:
        for trip_id in rng.sample(sorted(rows), 30):  # assessed anew, otherwise than before
            driven = {cell: Driven(rng.randrange(9) * 1000, 1) for cell in rng.sample(CELLS, 4)}
            rows[trip_id] = replace(rows[trip_id], record=replace(rows[trip_id].record, cells=driven))
            records.put(connection, rows[trip_id])
        put(connection, late := a_trip(rng, pk, 900))
        rows[late.trip_id] = late
        records.rebuild(connection, pk, zone="Asia/Tokyo")
    agree(any_database, pk, rows.values(), rng)
    with write(any_database) as connection:
        gone = rng.sample(sorted(rows), 50)
        assert records.remove(connection, pk, trip_records.c.trip_id.in_(gone)) == 50
        for trip_id in gone:
            del rows[trip_id]
    agree(any_database, pk, rows.values(), rng)
    agree(any_database, other, strangers, rng)
    with write(any_database) as connection:
        vehicles.delete_row(connection, pk)
        left = connection.execute(select(table.c.vehicle_pk, func.count()).group_by(table.c.vehicle_pk)).all()
    assert [row[0] for row in left] == [other]


@pytest.mark.parametrize("trips", [0, 10**6])
def test_a_cell_that_nobody_drove_in_has_no_evidence(database, trips):
    with write(database) as connection:
        pk = a_vehicle(connection)
        put(connection, a_trip(random.Random(1), pk, 1))
        assert trip_cells.farthest(connection, pk, ["881f1d4fffffffff"[:15]], 0, 2**62, trips=trips) == {}
