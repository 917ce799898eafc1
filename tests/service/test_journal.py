"""The journal on a real database: durable before told, duplicates, markers, failures and restarts."""

from __future__ import annotations

import sqlite3
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, wait
from pathlib import Path

import pytest
from sqlalchemy import Engine, func, insert, select

from service.ingest.journal import MAX_BATCH, BacklogError, Incoming, Journal, JournalEntry, JournalError, Outcome
from service.observability import Metrics
from service.storage.database import open_database, read, write
from service.storage.tables import checkpoints, journal, metadata
from service.storage.vehicles import VehicleDirectory, VehicleRef

SECOND_NS = 1_000_000_000
T0_NS = 1_700_000_000 * SECOND_NS
WAIT_S = 20.0  # a bound on what takes milliseconds, so that a fault fails and does not hang


class Delivered:
    """Takes what the journal hands on."""

    def __init__(self) -> None:
        self.entries: list[JournalEntry] = []
        self._changed = threading.Condition()

    def __call__(self, entries: Sequence[JournalEntry]) -> None:
        with self._changed:
            self.entries += entries
            self._changed.notify_all()

    def wait_for(self, ready: Callable[[list[JournalEntry]], bool]) -> None:
        with self._changed:
            assert self._changed.wait_for(lambda: ready(self.entries), WAIT_S), self.entries


class Setup:
    """A database with vehicles, and journals over it."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.engine: Engine = open_database(f"sqlite:///{path}")
        metadata.create_all(self.engine)
        self.directory = VehicleDirectory(self.engine, open_registration=True)
        self.vehicle = self.ref("car-1")
        self.metrics = Metrics()
        self.delivered = Delivered()
        self.journals: list[Journal] = []

    def ref(self, name: str) -> VehicleRef:
        ref = self.directory.resolve("default", name)
        assert ref is not None
        return ref

    def start(self, **options: object) -> Journal:
        journal = Journal(self.engine, self.delivered, metrics=self.metrics, **options)  # type: ignore[arg-type]
        journal.start()
        self.journals.append(journal)
        return journal

    def packet(self, sequence: int, boot_id: str = "a", **changes: object) -> Incoming:
        start_t_ns = T0_NS + sequence * SECOND_NS
        values = {
            "vehicle": self.vehicle,
            "boot_id": boot_id,
            "sequence": sequence,
            "start_t_ns": start_t_ns,
            "received_ns": start_t_ns + SECOND_NS,
            "payload": f"{boot_id} {sequence}".encode(),
        }
        return Incoming(**{**values, **changes})  # type: ignore[arg-type]

    def count(self) -> int:
        with read(self.engine) as connection:
            return connection.scalar(select(func.count()).select_from(journal)) or 0

    def metric(self, name: str, **labels: str) -> float:
        return self.metrics.registry.get_sample_value(f"telefuse_{name}", labels) or 0.0


@pytest.fixture
def setup(tmp_path: Path) -> Iterator[Setup]:
    made = Setup(tmp_path / "telefuse.db")
    yield made
    for one in made.journals:
        one.stop()
    made.engine.dispose()


def results(futures: Sequence[Future[Outcome]]) -> list[Outcome]:
    wait(futures, WAIT_S)
    return [future.result(0) for future in futures]


def test_what_is_told_is_on_disk_and_handed_on(setup: Setup) -> None:
    running = setup.start()
    outcomes = results([running.submit(setup.packet(sequence)) for sequence in (1, 2, 3)])
    assert [outcome.status for outcome in outcomes] == ["accepted"] * 3
    assert outcomes[-1].durable_sequence == 3
    with sqlite3.connect(setup.path) as another_process:
        rows = another_process.execute("SELECT boot_id, sequence, payload FROM journal ORDER BY id").fetchall()
    assert rows == [("a", 1, b"a 1"), ("a", 2, b"a 2"), ("a", 3, b"a 3")]
    assert [entry.sequence for entry in setup.delivered.entries] == [1, 2, 3]
    assert list(running.read(setup.vehicle.pk, 0)) == setup.delivered.entries
    assert running.load([setup.delivered.entries[1].journal_id, 999]) == [setup.delivered.entries[1]]
    assert setup.metric("packets_accepted_total") == 3
    assert setup.metric("journal_commit_seconds_count") >= 1


def test_many_senders_share_transactions_and_keep_their_order(setup: Setup) -> None:
    refs = [setup.ref(f"car-{n}") for n in range(20)]
    running = setup.start()
    futures = [running.submit(setup.packet(sequence, vehicle=ref)) for sequence in range(1, 51) for ref in refs]
    assert {outcome.status for outcome in results(futures)} == {"accepted"}
    ids = [entry.journal_id for entry in setup.delivered.entries]
    assert ids == sorted(ids)
    for ref in refs:
        assert [entry.sequence for entry in running.read(ref.pk, 0)] == list(range(1, 51))
    assert setup.metric("journal_commit_seconds_count") < len(futures)


def test_duplicates_change_nothing_within_a_batch_and_after_it(setup: Setup) -> None:
    running = setup.start()
    together = results([running.submit(setup.packet(1)) for _ in range(3)])
    later = results([running.submit(setup.packet(1, payload=b"other"))])
    assert sorted(outcome.status for outcome in together + later) == ["accepted", "duplicate", "duplicate", "duplicate"]
    assert {outcome.durable_sequence for outcome in together + later} == {1}
    assert setup.count() == len(setup.delivered.entries) == 1
    assert setup.metric("packets_duplicate_total") == 3


def test_a_gap_keeps_the_floor_and_a_late_packet_is_refused(setup: Setup) -> None:
    running = setup.start(gap_wait_ns=10 * SECOND_NS)
    outcomes = results([running.submit(setup.packet(sequence)) for sequence in (1, 3, 4)])
    assert {outcome.durable_sequence for outcome in outcomes[:1]} <= {1}
    assert outcomes[2].durable_sequence == 1
    (stepping,) = results([running.submit(setup.packet(14))])
    assert stepping.skipped == (("a", 2, 2),)
    assert stepping.durable_sequence == 4
    (late,) = results([running.submit(setup.packet(2))])
    assert (late.status, late.code, late.durable_sequence) == ("refused", "late", 4)
    assert setup.metric("gaps_stepped_over_total") == 1
    assert setup.metric("packets_refused_total", code="late") == 1


def test_a_refused_packet_moves_the_floor_and_stays_refused(setup: Setup) -> None:
    running = setup.start()
    poisoned = setup.packet(2, refused_code="null_island")
    outcomes = results([running.submit(one) for one in (setup.packet(1), poisoned, setup.packet(3), poisoned)])
    assert [(outcome.status, outcome.code) for outcome in outcomes] == [
        ("accepted", None),
        ("refused", "null_island"),
        ("accepted", None),
        ("refused", "null_island"),
    ]
    assert outcomes[-1].durable_sequence == 3
    assert [entry.payload for entry in setup.delivered.entries] == [b"a 1", b"", b"a 3"]


def test_silence_behind_a_gap_writes_a_marker(setup: Setup) -> None:
    running = setup.start(flush_after_s=0.05)
    results([running.submit(setup.packet(sequence)) for sequence in (1, 3, 4)])
    setup.delivered.wait_for(lambda entries: entries[-1].sequence < 0)
    marker = setup.delivered.entries[-1]
    assert (marker.boot_id, marker.sequence, marker.payload) == ("a", -4, b"")
    (duplicate,) = results([running.submit(setup.packet(4))])
    assert (duplicate.status, duplicate.durable_sequence) == ("duplicate", 4)
    (late,) = results([running.submit(setup.packet(2))])
    assert late.code == "late"


def test_a_restart_knows_what_was_there(setup: Setup) -> None:
    first = setup.start()
    results([first.submit(setup.packet(sequence)) for sequence in (1, 2, 4)])
    first.stop()
    with pytest.raises(BacklogError):
        first.submit(setup.packet(5))

    second = setup.start()
    again, filled = results([second.submit(setup.packet(4)), second.submit(setup.packet(3))])
    assert (again.status, again.durable_sequence >= 2) == ("duplicate", True)
    assert (filled.status, filled.durable_sequence) == ("accepted", 4)


def test_a_restart_goes_on_from_the_checkpoint(setup: Setup) -> None:
    first = setup.start()
    results([first.submit(setup.packet(sequence)) for sequence in (1, 2, 3)])
    first.stop()
    state = {"gap_wait_ns": 1, "boots": [{"boot_id": "a", "floor": 7, "closed": False, "held": [], "skipped": []}]}
    newest_id = setup.delivered.entries[-1].journal_id
    with write(setup.engine) as connection:
        connection.execute(
            insert(checkpoints).values(
                vehicle_pk=setup.vehicle.pk, journal_id=newest_id, sequencer=state, session=b"", stored_ns=0
            )
        )
    (outcome,) = results([setup.start().submit(setup.packet(8))])
    assert (outcome.status, outcome.durable_sequence) == ("accepted", 8)


def test_a_vehicle_that_was_behind_a_gap_at_the_end_is_looked_after(setup: Setup) -> None:
    first = setup.start()
    results([first.submit(setup.packet(sequence)) for sequence in (1, 3)])
    first.stop()
    setup.start(flush_after_s=0.05).watch(setup.vehicle.pk)
    setup.delivered.wait_for(lambda entries: entries[-1].sequence == -3)


def test_a_boot_long_forgotten_is_late(setup: Setup) -> None:
    running = setup.start()
    boots = [setup.packet(1, f"boot-{n:02}", start_t_ns=T0_NS + n * SECOND_NS) for n in range(30)]
    assert {outcome.status for outcome in results([running.submit(one) for one in boots])} == {"accepted"}
    again, next_one = results([running.submit(boots[0]), running.submit(setup.packet(2, "boot-00"))])
    assert (again.code, again.durable_sequence) == ("late", 1)
    assert (next_one.code, next_one.durable_sequence) == ("late", 2)


def test_too_much_at_once_is_turned_away_and_taken_later(setup: Setup) -> None:
    running = setup.start(queue_limit=3)
    futures: list[Future[Outcome]] = []

    def submit_until_refused() -> None:
        while len(futures) < 10 * MAX_BATCH:
            futures.append(running.submit(setup.packet(len(futures) + 1)))

    with write(setup.engine), pytest.raises(BacklogError) as turned_away:  # nothing can be committed meanwhile
        submit_until_refused()
    assert turned_away.value.status == 503
    taken = results(futures)
    assert {outcome.status for outcome in taken} == {"accepted"}
    (later,) = results([running.submit(setup.packet(len(futures) + 1))])
    assert later.durable_sequence == len(futures) + 1


def test_a_database_that_cannot_be_written_is_told_and_survived(setup: Setup) -> None:
    running = setup.start()
    results([running.submit(setup.packet(1))])
    with write(setup.engine) as connection:
        connection.exec_driver_sql(
            "CREATE TRIGGER full BEFORE INSERT ON journal BEGIN SELECT RAISE(FAIL, 'disk is full'); END"
        )
    failed = running.submit(setup.packet(2))
    with pytest.raises(JournalError):
        failed.result(WAIT_S)
    with write(setup.engine) as connection:
        connection.exec_driver_sql("DROP TRIGGER full")
    (outcome,) = results([running.submit(setup.packet(2))])
    assert (outcome.status, outcome.durable_sequence) == ("accepted", 2)
    assert [entry.sequence for entry in running.read(setup.vehicle.pk, 0)] == [1, 2]


def test_a_vehicle_removed_while_its_packet_waited_fails_nobody_else(setup: Setup) -> None:
    other = setup.ref("car-2")
    running = setup.start()
    assert setup.directory.remove("default", "car-1")
    orphan, fine = results([running.submit(setup.packet(1)), running.submit(setup.packet(1, vehicle=other))])
    assert (orphan.status, orphan.code) == ("refused", "unknown_vehicle")
    assert fine.status == "accepted"


def test_an_engine_that_fails_does_not_stop_the_journal(setup: Setup) -> None:
    def broken(_: Sequence[JournalEntry]) -> None:
        raise RuntimeError("no")

    running = Journal(setup.engine, broken)
    running.start()
    setup.journals.append(running)
    assert results([running.submit(setup.packet(1))])[0].status == "accepted"
    assert results([running.submit(setup.packet(2))])[0].status == "accepted"


def test_a_sender_that_went_away_harms_nobody(setup: Setup) -> None:
    running = setup.start()
    with write(setup.engine):
        gone, stays = running.submit(setup.packet(1)), running.submit(setup.packet(1, "b"))
        gone.cancel()
    assert results([stays])[0].status == "accepted"


def test_rows_that_a_failed_commit_left_behind_are_handed_on(setup: Setup) -> None:
    """A commit can be through although its answer was lost: then the engine must still get the rows."""
    running = setup.start()
    results([running.submit(setup.packet(1))])
    with write(setup.engine) as connection:  # what the lost answer was about
        connection.execute(
            insert(journal).values(
                vehicle_pk=setup.vehicle.pk, boot_id="a", sequence=2, start_t_ns=T0_NS, received_ns=0, payload=b"a 2"
            )
        )
    with pytest.raises(JournalError):
        running.submit(setup.packet(2)).result(WAIT_S)
    (again,) = results([running.submit(setup.packet(2))])
    assert (again.status, again.durable_sequence) == ("duplicate", 2)
    assert [entry.sequence for entry in setup.delivered.entries][-1] == 2


def test_postgresql_keeps_the_same_order_and_outcomes(postgres_database: Engine) -> None:
    ref = VehicleDirectory(postgres_database, open_registration=True).resolve("default", "car-1")
    assert ref is not None
    delivered = Delivered()
    running = Journal(postgres_database, delivered)
    running.start()
    try:
        offered = [1, 2, 2, *range(4, 200), 3]
        packets = [Incoming(ref, "a", n, T0_NS + n * SECOND_NS // 100, 0, str(n).encode()) for n in offered]
        outcomes = results([running.submit(one) for one in packets])
        assert [outcome.status for outcome in outcomes].count("duplicate") == 1
        assert outcomes[-1].durable_sequence == 199
        assert [entry.payload for entry in running.read(ref.pk, 0)] == [entry.payload for entry in delivered.entries]
        assert [entry.sequence for entry in delivered.entries] == [1, 2, *range(4, 200), 3]
    finally:
        running.stop()
