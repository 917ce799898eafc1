"""The vehicle directory: found without a query, registered once, forgotten when removed."""

from __future__ import annotations

import threading

import pytest
from pydantic import TypeAdapter, ValidationError
from sqlalchemy import event, insert

from schemas.keys import MAX_VEHICLE_ID, is_name
from schemas.model import VehicleId
from schemas.vehicles import VehicleConfig
from service.ingest.sequencing import Sequencer
from service.storage import tables, tenants, vehicles
from service.storage.database import read, write
from service.storage.vehicles import VehicleDirectory
from tests.service.stored_rows import NS, T0


@pytest.fixture
def closed(any_database):
    return VehicleDirectory(any_database, open_registration=False)


@pytest.fixture
def opened(any_database):
    return VehicleDirectory(any_database, open_registration=True)


class Statements:
    """Counts what is asked of a database."""

    def __init__(self, engine):
        self.count = 0
        event.listen(engine, "before_cursor_execute", self._count)

    def _count(self, *_):
        self.count += 1


def test_settings_come_back_as_they_were(closed, any_database):
    config = VehicleConfig(mounting_rpy_deg=(1.0, 2.0, 90.0 + 1 / 3), detector="paper")
    ref = closed.register("acme", "a", config).ref
    fresh = VehicleDirectory(any_database, open_registration=False)
    assert fresh.resolve("acme", "a") == fresh.by_pk(ref.pk) == ref
    assert fresh.resolve("acme", "a").config == config


def test_a_known_vehicle_costs_no_query(closed, any_database):
    ref = closed.register("acme", "a").ref
    statements = Statements(any_database)
    assert closed.resolve("acme", "a") is ref
    assert closed.by_pk(ref.pk) is ref
    assert statements.count == 0


def test_closed_refuses_the_unknown_and_finds_what_another_process_added(closed, any_database):
    assert closed.resolve("acme", "a") is None
    VehicleDirectory(any_database, open_registration=False).register("acme", "a")
    assert closed.resolve("acme", "a").vehicle_id == "a"


def test_open_registers_in_tenants_that_there_are(opened, any_database):
    assert opened.resolve("default", "a").config == VehicleConfig()
    assert opened.resolve("acme", "a") is None, "whoever writes a key must not make tenants"
    with write(any_database) as connection:
        tenants.ensure(connection, "acme")
    assert opened.resolve("acme", "a").tenant_id == "acme"
    assert opened.resolve("default", "no name") is None


def test_many_first_packets_at_once_register_one_vehicle(opened):
    found = []
    threads = [threading.Thread(target=lambda: found.append(opened.resolve("default", "a"))) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(found) == 8
    assert len({ref.pk for ref in found}) == 1


def test_a_change_is_seen_at_once_and_told(closed):
    told = []
    closed.on_change(told.append)
    ref = closed.register("acme", "a").ref
    changed = closed.update("acme", "a", lambda config: config.model_copy(update={"detector": "paper"}))
    assert changed.ref.pk == ref.pk
    assert closed.resolve("acme", "a").config.detector == closed.by_pk(ref.pk).config.detector == "paper"
    assert closed.update("acme", "b", lambda config: config) is None
    assert told == [ref.pk, ref.pk]


def test_a_removed_vehicle_is_gone_with_its_rows_and_its_number(closed, any_database):
    told = []
    ref = closed.register("acme", "a").ref
    closed.on_change(lambda pk: told.append((pk, closed.by_pk(pk))))
    row = {"vehicle_pk": ref.pk, "boot_id": "b", "sequence": 1, "start_t_ns": 0, "received_ns": 0, "payload": b"p"}
    with write(any_database) as connection:
        connection.execute(insert(tables.journal), [row])
    assert closed.remove("acme", "a")
    assert not closed.remove("acme", "a")
    assert told == [(ref.pk, None)]
    assert closed.resolve("acme", "a") is None
    with read(any_database) as connection:
        assert vehicles.newest_packet(connection, ref.pk) is None
    assert closed.register("acme", "a").ref.pk != ref.pk, (
        "what still holds the old number must not meet the new vehicle"
    )


def test_tenants_have_names_of_their_own(closed):
    assert closed.register("acme", "a").ref.pk != closed.register("other", "a").ref.pk


def test_durable_sequence_is_what_the_box_was_told(closed, any_database):
    pk = closed.register("acme", "a").ref.pk
    sequencer = Sequencer()
    sequencer.offer("b1", 1, T0, 1)

    def rows(*numbers):
        return [
            {
                "vehicle_pk": pk,
                "boot_id": "b1",
                "sequence": number,
                "start_t_ns": T0 + number * NS,
                "received_ns": T0,
                "payload": b"p",
            }
            for number in numbers
        ]

    def durable():
        with read(any_database) as connection:
            return vehicles.durable_sequence(connection, pk, "b1", 10 * NS)

    with write(any_database) as connection:
        connection.execute(insert(tables.journal), rows(1))
        checkpoint = {
            "vehicle_pk": pk,
            "journal_id": 1,
            "sequencer": sequencer.to_json(),
            "session": b"",
            "stored_ns": 0,
        }
        connection.execute(insert(tables.checkpoints), [checkpoint])
    assert durable() == 1
    with write(any_database) as connection:
        connection.execute(insert(tables.journal), rows(2, 3, 5))
    assert durable() == 3
    with write(any_database) as connection:
        connection.execute(insert(tables.journal), rows(20))
    assert durable() == 5, "more than 10 s past the gap at 4 it is stepped over; that at 6 is waited for"


@pytest.mark.parametrize(
    "text", ["a", "0", "A.b_c-d", "a:b", "a+b", "x" * 128, "x" * 129, "", "-a", "a/b", "a b", "ä", "a\n", "a*"]
)
def test_the_documented_pattern_of_an_id_is_the_rule(text):
    try:
        allowed = TypeAdapter(VehicleId).validate_python(text) == text
    except ValidationError:
        allowed = False
    assert allowed == is_name(text, MAX_VEHICLE_ID)
