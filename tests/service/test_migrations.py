"""The schema's history makes the schema that the code works with, on both databases, forward and back."""

from __future__ import annotations

import random
import threading

import pytest
import sqlalchemy
from alembic.autogenerate import compare_metadata
from alembic.runtime.migration import MigrationContext

from service.errors import DatabaseError
from service.local_days import day_of
from service.storage import cell_sums, schema, trip_cells
from service.storage.database import open_database, read, write
from service.storage.tables import metadata
from tests.service.trip_records import a_trip_record


@pytest.fixture(params=["sqlite", "postgresql"])
def empty_url(request, tmp_path):
    if request.param == "sqlite":
        return f"sqlite:///{tmp_path / 'sub' / 'new.db'}"
    return request.getfixturevalue("empty_postgres_url")


@pytest.fixture
def empty(empty_url):
    engine = open_database(empty_url)
    yield engine
    engine.dispose()


def tables(engine):
    return set(sqlalchemy.inspect(engine).get_table_names()) - {"alembic_version"}


def test_migrations_make_what_the_code_declares(empty):
    assert schema.upgrade(empty) == (None, schema.newest())
    with read(empty) as connection:
        context = MigrationContext.configure(connection, opts={"compare_type": True, "compare_server_default": True})
        assert compare_metadata(context, metadata) == []
    assert tables(empty) == set(metadata.tables)


def test_sqlite_keeps_the_clauses_that_alembic_does_not_compare(tmp_path):
    migrated, created = (open_database(f"sqlite:///{tmp_path / name}.db") for name in ("migrated", "created"))
    schema.upgrade(migrated)
    metadata.create_all(created)

    def clauses(engine):
        with read(engine) as connection:
            rows = connection.exec_driver_sql("SELECT name, sql FROM sqlite_master WHERE type = 'table'")
            return {
                name: ("AUTOINCREMENT" in sql, "WITHOUT ROWID" in sql, sql.count("ON DELETE CASCADE"))
                for name, sql in rows
                if name in metadata.tables
            }

    assert clauses(migrated) == clauses(created)


def test_upgrade_is_repeatable_and_downgrade_leaves_nothing(empty):
    schema.upgrade(empty)
    assert schema.upgrade(empty) == (schema.newest(), schema.newest())
    assert schema.downgrade(empty, schema.BASE) == (schema.newest(), None)
    assert tables(empty) == set()
    schema.upgrade(empty)
    assert tables(empty) == set(metadata.tables)


def test_trips_from_before_are_evidence_of_their_cells(empty):
    rows = [a_trip_record(random.Random(number), 1, f"trip-{number:04d}", number) for number in range(1100)]
    schema.upgrade(empty, "0005")
    with write(empty) as connection:
        before = sqlalchemy.MetaData()
        before.reflect(connection, only=["tenants", "vehicles", "trips", "trip_records"])
        connection.execute(before.tables["tenants"].insert(), {"id": "t", "name": "t", "created_ns": 1})
        vehicle = {"pk": 1, "tenant_id": "t", "vehicle_id": "v", "config": {}, "registered_ns": 1, "updated_ns": 1}
        connection.execute(before.tables["vehicles"].insert(), vehicle)
        places = ("start_lat_deg", "start_lon_deg", "end_lat_deg", "end_lon_deg")
        same = dict.fromkeys((*places, "distance_m", "moving_s", "coasting_s", "max_speed_mps"), 1.0) | {"ended": True}
        trips = [
            same | {"id": row.trip_id, "vehicle_pk": 1, "start_ns": row.start_ns, "end_ns": row.start_ns + 1}
            for row in rows
        ]
        connection.execute(before.tables["trips"].insert(), trips)
        told = [
            {
                "trip_id": row.trip_id,
                "vehicle_pk": 1,
                "start_ns": row.start_ns,
                "day": day_of(row.start_ns),
                "model_sha256": "",
                "assessed_ns": 1,
                "record": {},
                "cells": cell_sums.packed(row.record.cells),
                "timeline": b"",
            }
            for row in rows
        ]
        connection.execute(before.tables["trip_records"].insert(), told)
    schema.upgrade(empty)
    with read(empty) as connection:
        for cell in sorted({cell for row in rows for cell in row.record.cells}):
            found = trip_cells.farthest(connection, 1, [cell], 0, 2000, trips=len(rows))
            driven = [(row.record.cells[cell].distance_mm, row.trip_id) for row in rows if cell in row.record.cells]
            assert [(one.weight, one.id) for one in found[cell]] == sorted(driven, reverse=True)[:5]


def test_processes_that_start_together_do_not_collide(empty_url):
    engines = [open_database(empty_url) for _ in range(4)]
    found = []
    threads = [threading.Thread(target=lambda e=engine: found.append(schema.upgrade(e))) for engine in engines]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for engine in engines:
        engine.dispose()
    assert sorted(found, key=str) == sorted(
        [(None, schema.newest())] + [(schema.newest(), schema.newest())] * 3, key=str
    )


def test_a_schema_of_a_newer_version_is_refused_with_what_to_do(empty):
    schema.upgrade(empty)
    with write(empty) as connection:
        connection.exec_driver_sql("UPDATE alembic_version SET version_num = '9999'")
    with pytest.raises(DatabaseError, match=r"9999.*newer"):
        schema.upgrade(empty)


def test_a_failed_migration_leaves_the_schema_as_it_was(empty):
    with write(empty) as connection:
        connection.exec_driver_sql("CREATE TABLE journal (in_the_way INTEGER)")
    with pytest.raises(sqlalchemy.exc.SQLAlchemyError):
        schema.upgrade(empty)
    assert tables(empty) == {"journal"}
    with read(empty) as connection:
        assert schema.current(connection) is None
