"""What is too old goes, what is still needed stays, and the feed misses nothing that commits late."""

from __future__ import annotations

import threading

import pytest
from sqlalchemy import func, insert, select, text

from service.ingest.sequencing import Sequencer
from service.storage import events, idempotency, retention, tables
from service.storage.database import read, write
from service.storage.vehicles import VehicleDirectory
from service.webhooks.outbox import NewEvent, publish
from tests.service.stored_rows import NS, T0, point_row

DAY = retention.DAY_NS
NOW = T0 + 100 * DAY


@pytest.fixture
def pk(any_database):
    return VehicleDirectory(any_database, open_registration=False).register("acme", "a").ref.pk


def add(engine, table, rows):
    with write(engine) as connection:
        connection.execute(insert(table), rows)


def remaining(engine, column):
    with read(engine) as connection:
        return list(connection.scalars(select(column).order_by(column)))


def prune(engine, days=30):
    return retention.prune(engine, NOW, journal_days=days, track_days=days, events_days=days)


def packets(pk, received):
    return [
        {
            "vehicle_pk": pk,
            "boot_id": "b",
            "sequence": number,
            "start_t_ns": T0 + number * NS,
            "received_ns": received_ns,
            "payload": b"p",
        }
        for number, received_ns in received.items()
    ]


def checkpoint(engine, pk, journal_id, sequencer):
    row = {"vehicle_pk": pk, "journal_id": journal_id, "sequencer": sequencer.to_json(), "session": b"", "stored_ns": 0}
    add(engine, tables.checkpoints, [row])


def test_packets_go_when_old_unless_the_session_still_needs_them(any_database, pk):
    old, young = NOW - 31 * DAY, NOW - 29 * DAY
    add(any_database, tables.journal, packets(pk, {1: old, 2: old, 4: old, 5: young}))
    ids = remaining(any_database, tables.journal.c.id)
    assert prune(any_database).packets == 0, "without a checkpoint every packet is needed"
    sequencer = Sequencer()
    for number, journal_id in zip((1, 2, 4), ids, strict=False):
        sequencer.offer("b", number, T0 + number * NS, journal_id)
    checkpoint(any_database, pk, ids[3], sequencer)
    assert prune(any_database, days=0).packets == 0
    assert prune(any_database).packets == 2
    assert remaining(any_database, tables.journal.c.sequence) == [4, 5], "4 is held back behind a gap"


def test_packets_beyond_the_checkpoint_stay_however_old(any_database, pk):
    add(any_database, tables.journal, packets(pk, {1: 0, 2: 0, 3: 0}))
    ids = remaining(any_database, tables.journal.c.id)
    checkpoint(any_database, pk, ids[1], Sequencer())
    prune(any_database)
    assert remaining(any_database, tables.journal.c.sequence) == [2, 3]


def test_many_rows_go_in_many_small_transactions(any_database, pk):
    count = 2 * retention.CHUNK + 1
    add(any_database, tables.track_points, [point_row(pk, second) for second in range(count)])
    checkpoint(any_database, pk, 0, Sequencer())
    assert prune(any_database).track_points == count - 1
    assert remaining(any_database, tables.track_points.c.t_ns) == [T0 + (count - 1) * NS], "where it stands is known"


def test_a_manoeuvre_loses_its_place_with_the_track_and_is_kept(any_database, pk):
    old, young = NOW - 31 * DAY, NOW - 29 * DAY
    add(any_database, tables.track_points, [point_row(pk, 0)])
    checkpoint(any_database, pk, 0, Sequencer())
    same = {"tenant_id": "acme", "vehicle_pk": pk, "kind": "braking", "stored_ns": 0, "peak_mps2": 5.0, "direction": ""}
    same |= {"aggressive": True, "counted": True, "recovery": False, "lat_deg": 57.7, "lon_deg": 11.9, "sd_n_m": 1.0}
    rows = [same | {"id": str(t), "start_ns": t, "peak_ns": t, "end_ns": t} for t in (old, young)]
    add(any_database, tables.manoeuvres, rows)
    assert prune(any_database).manoeuvre_places == 1
    assert remaining(any_database, tables.manoeuvres.c.lat_deg) in ([57.7, None], [None, 57.7])
    assert prune(any_database).manoeuvre_places == 0


def test_events_go_unless_a_webhook_still_waits(any_database, pk):
    endpoint = {"id": "e", "tenant_id": "acme", "url": "https://x", "description": "", "types": [], "secrets": []}
    add(any_database, tables.webhook_endpoints, [endpoint | {"status": "enabled", "created_ns": 0, "updated_ns": 0}])
    with write(any_database) as connection:
        for name in ("sent", "waiting", "young"):
            stored_ns = NOW if name == "young" else 0
            publish(connection, NewEvent(name, "acme", pk, "trip.completed", T0, T0, {}), stored_ns)
        connection.execute(
            tables.deliveries.update()
            .where(tables.deliveries.c.event_id == "sent")
            .values(status="delivered", next_attempt_ns=None)
        )
    assert prune(any_database).events == 1
    assert remaining(any_database, tables.events.c.id) == ["waiting", "young"]
    with read(any_database) as connection:
        assert connection.scalar(select(func.count()).select_from(tables.deliveries)) == 2


def test_answers_to_idempotent_requests_are_kept_a_day(any_database, pk):
    with write(any_database) as connection:
        for key in ("old", "new"):
            idempotency.begin(connection, "acme", key, "0" * 64)
        table = tables.idempotency_keys
        connection.execute(table.update().where(table.c.key == "old").values(created_ns=NOW - DAY - 1))
        connection.execute(table.update().where(table.c.key == "new").values(created_ns=NOW - DAY))
    assert prune(any_database).idempotency_keys == 1
    assert remaining(any_database, tables.idempotency_keys.c.key) == ["new"]


def test_the_feed_waits_for_an_event_that_commits_late(postgres_database):
    engine = postgres_database
    pk = VehicleDirectory(engine, open_registration=False).register("acme", "a").ref.pk

    def event(name):
        return NewEvent(name, "acme", pk, "trip.completed", T0, T0, {})

    def seen(cursor=0):
        with read(engine) as connection:
            return [row.id for row in events.after(connection, "acme", cursor, ["trip.completed"], 10)]

    with write(engine) as slow:
        publish(slow, event("first"))
        with write(engine) as quick:
            publish(quick, event("second"))
        assert seen() == [], "shown now, the second's cursor would hide the first for ever"
    assert seen() == ["first", "second"]


def test_one_of_two_same_requests_at_once_waits_for_the_other(any_database, pk):
    begun, let_go, found = threading.Event(), threading.Event(), []

    def first():
        with write(any_database) as connection:
            idempotency.begin(connection, "acme", "k", "0" * 64)
            begun.set()
            let_go.wait(10)
            idempotency.finish(connection, "acme", "k", 201, {}, b"made")

    def second():
        with write(any_database) as connection:
            found.append(idempotency.begin(connection, "acme", "k", "0" * 64))

    threads = [threading.Thread(target=first), threading.Thread(target=second)]
    threads[0].start()
    assert begun.wait(10)
    threads[1].start()
    let_go.set()
    for thread in threads:
        thread.join()
    assert found[0].body == b"made"


def test_a_read_is_one_view_whatever_commits_meanwhile(any_database, pk):
    with read(any_database) as view:
        count = select(func.count()).select_from(tables.track_points)
        assert view.scalar(count) == 0
        add(any_database, tables.track_points, [point_row(pk, 0)])
        assert view.scalar(count) == 0


def test_sqlite_commits_are_durable_and_keys_are_kept(database):
    with read(database) as connection:
        settings = {
            name: connection.execute(text(f"PRAGMA {name}")).scalar()
            for name in ("journal_mode", "synchronous", "foreign_keys")
        }
    assert settings == {"journal_mode": "wal", "synchronous": 2, "foreign_keys": 1}  # 2 is FULL
