"""The journal: every packet on disk, in one order, before its sender is told so.

One thread writes. It takes whatever has queued up while the disk was busy and commits it as one transaction
(group commit), so that the cost of an fsync is shared by all packets that wait for it. A future resolves only
after its commit returned: on SQLite (WAL, ``synchronous=FULL``) after the log was fsynced, on PostgreSQL with
its default ``synchronous_commit=on`` likewise. What a process killed at any instant had not committed, it had
not acknowledged either.

A row with an empty payload holds no packet: a positive sequence is a packet refused for good, which keeps its
place in the sequence; a negative one is a flush marker, written when nothing came to fill a gap.
"""

from __future__ import annotations

import logging
import queue
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Final, Literal

from sqlalchemy import Engine, select
from sqlalchemy.exc import IntegrityError, SQLAlchemyError

from service.errors import UnavailableError
from service.ingest.journal_rows import JournalEntry, NewRow, insert_rows, load_rows, read_after
from service.ingest.sequencing import GAP_WAIT_NS, UNKNOWN_TIME
from service.ingest.tracking import Tracking
from service.observability import Metrics
from service.storage.database import read, write
from service.storage.tables import vehicles
from service.storage.vehicles import VehicleRef

__all__ = ["BacklogError", "Incoming", "Journal", "JournalEntry", "JournalError", "Outcome", "Span", "Status"]

log = logging.getLogger(__name__)

MAX_BATCH: Final = 1024
"""Packets a transaction: enough to make the fsync's share of each small, few enough to commit in some 50 ms."""

MAX_BATCH_BYTES: Final = 16 * 2**20
"""Bytes a transaction, for the same reason where packets are large."""

QUEUE_LIMIT: Final = 20_000
"""Packets that may wait to become durable before more are turned away: some seconds of what a disk takes."""

QUEUE_LIMIT_BYTES: Final = 256 * 2**20
"""The same in bytes, so that large packets cannot exhaust memory."""

FLUSH_AFTER_S: Final = 5.0
"""Wall time after which held packets of a vehicle from which nothing new came are let go; above twice the 2 s
in which a sender repeats what was not acknowledged."""

_TICK_S: Final = 0.25  # how often held packets are looked after
_STOP: Final = object()

Status = Literal["accepted", "duplicate", "refused"]
Span = tuple[str, int, int]


class BacklogError(UnavailableError):
    """Packets come faster than they can be made durable; nothing was taken, send again."""

    code = "backlog"


class JournalError(UnavailableError):
    """The journal could not be written; nothing was taken, send again."""

    code = "journal_unavailable"


@dataclass(frozen=True, slots=True)
class Incoming:
    """A packet to be made durable. With ``refused_code`` only its place in the sequence is kept."""

    vehicle: VehicleRef
    boot_id: str
    sequence: int
    start_t_ns: int
    received_ns: int
    payload: bytes
    refused_code: str | None = None


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of a packet. Everything of its boot up to ``durable_sequence`` is durable or refused for good;
    ``skipped`` are the (boot_id, first, last) that this packet caused to be stepped over; ``gap`` says that packets
    of its boot wait for a missing one."""

    status: Status
    code: str | None
    durable_sequence: int
    skipped: tuple[Span, ...] = ()
    gap: bool = False


_Submission = tuple[Incoming, "Future[Outcome]"]


@dataclass(frozen=True, slots=True)
class _Decision:
    """What is told of one packet when the transaction is through."""

    future: Future[Outcome]
    outcome: Outcome


class Journal:
    """The one writer of the journal. ``deliver`` gets every committed row, in journal order, on its thread."""

    def __init__(
        self,
        engine: Engine,
        deliver: Callable[[Sequence[JournalEntry]], None],
        *,
        metrics: Metrics | None = None,
        gap_wait_ns: int = GAP_WAIT_NS,
        flush_after_s: float = FLUSH_AFTER_S,
        queue_limit: int = QUEUE_LIMIT,
        monotonic_s: Callable[[], float] = time.monotonic,
        now_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        self._engine = engine
        self._deliver = deliver
        self._metrics = metrics or Metrics()
        self._tracking = Tracking(engine, gap_wait_ns, monotonic_s)
        self._flush_after_s = flush_after_s
        self._queue_limit = queue_limit
        self._monotonic_s = monotonic_s
        self._now_ns = now_ns
        self._queue: queue.SimpleQueue[_Submission | int | object] = queue.SimpleQueue()
        self._queued = 0
        self._queued_bytes = 0
        self._lock = threading.Lock()  # guards the two counts and _open
        self._open = False
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Begin to take packets."""
        with self._lock:
            self._open = True
        self._thread = threading.Thread(target=self._run, name="journal", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Take no more, commit what was taken, and end the thread."""
        with self._lock:
            was_open, self._open = self._open, False
        if was_open and self._thread is not None:
            self._queue.put(_STOP)
            self._thread.join()

    def submit(self, incoming: Incoming) -> Future[Outcome]:
        """Queue a packet; the future resolves once it is durable, or fails with JournalError.

        Raises BacklogError at once where too much waits already, or the journal is stopped.
        """
        future: Future[Outcome] = Future()
        with self._lock:
            if not self._open:
                raise BacklogError("the service is not taking packets (starting or stopping); send again")
            if self._queued >= self._queue_limit or self._queued_bytes >= QUEUE_LIMIT_BYTES:
                raise BacklogError(f"{self._queued} packets wait to become durable; send again in a second")
            self._queued += 1
            self._queued_bytes += len(incoming.payload)
            # Under the lock, so that nothing comes after the mark that ends the thread.
            self._queue.put((incoming, future))
        return future

    def watch(self, vehicle_pk: int) -> None:
        """Look after a vehicle that had packets behind a gap when the service last ended, though nothing comes."""
        self._queue.put(vehicle_pk)

    def read(self, vehicle_pk: int, after_id: int) -> Iterator[JournalEntry]:
        """A vehicle's rows after a journal id, in order."""
        return read_after(self._engine, vehicle_pk, after_id)

    def load(self, ids: Iterable[int]) -> list[JournalEntry]:
        """Rows by their ids, in journal order; ids that are gone are left out."""
        return load_rows(self._engine, ids)

    # --- the thread -------------------------------------------------------------------------------

    def _run(self) -> None:
        stopping = False
        while not stopping:
            batch, watched, stopping = self._take()
            for vehicle_pk in watched:
                self._look_after(vehicle_pk)
            if batch:
                self._commit(batch)
            if not stopping:
                for vehicle_pk, held in self._tracking.idle_behind_gap(self._flush_after_s):
                    self._flush(vehicle_pk, *held)

    def _take(self) -> tuple[list[_Submission], list[int], bool]:
        """What has queued up, waiting for the first a tick at most; vehicles to watch; whether to end."""
        batch: list[_Submission] = []
        watched: list[int] = []
        count = size = 0
        stopping = False
        try:
            # Without packets behind a gap there is nothing that time alone could bring about.
            item = self._queue.get(timeout=_TICK_S if self._tracking.holding else None)
            while True:
                if item is _STOP:
                    stopping = True
                    break
                if isinstance(item, tuple):
                    incoming, future = item
                    count += 1
                    size += len(incoming.payload)
                    if future.set_running_or_notify_cancel():
                        batch.append((incoming, future))
                    if count >= MAX_BATCH or size >= MAX_BATCH_BYTES:
                        break
                elif isinstance(item, int):
                    watched.append(item)
                item = self._queue.get_nowait()
        except queue.Empty:
            pass
        with self._lock:
            self._queued -= count
            self._queued_bytes -= size
            self._metrics.journal_queue.set(self._queued)
        return batch, watched, stopping

    def _commit(self, batch: list[_Submission]) -> None:
        """Decide on each packet in turn, make the new ones durable together, then tell engine and senders."""
        started_s = self._monotonic_s()
        try:
            decisions, rows = self._decide(batch)
            entries = self._write(rows)
        except IntegrityError as error:
            self._forget(batch)
            self._commit_registered(batch, error)
            return
        except Exception as error:
            self._fail(batch, error)
            return
        self._metrics.journal_commit_seconds.observe(self._monotonic_s() - started_s)
        self._hand_on(entries)
        for decision in decisions:
            self._tell(decision)

    def _decide(self, batch: list[_Submission]) -> tuple[list[_Decision], list[NewRow]]:
        decisions: list[_Decision] = []
        rows: list[NewRow] = []
        for incoming, future in batch:
            pk, boot_id, sequence, code = (
                incoming.vehicle.pk,
                incoming.boot_id,
                incoming.sequence,
                incoming.refused_code,
            )
            self._hand_on(self._tracking.sequencer(pk)[1])
            kind = self._tracking.classify(pk, boot_id, sequence)
            skipped: tuple[Span, ...] = ()
            if kind == "new":
                start_t_ns, payload = (UNKNOWN_TIME, b"") if code else (incoming.start_t_ns, incoming.payload)
                skipped = self._tracking.offer(pk, boot_id, sequence, start_t_ns).skipped
                rows.append((pk, boot_id, sequence, start_t_ns, incoming.received_ns, payload))
            floor, gap = self._tracking.standing(pk, boot_id)
            if kind == "late":
                code = code or "late"
                floor = max(floor, sequence)  # its place is gone, whatever the floor of that boot was
            status: Status = "refused" if code else "accepted" if kind == "new" else "duplicate"
            decisions.append(_Decision(future, Outcome(status, code, floor, skipped, gap)))
        return decisions, rows

    def _write(self, rows: list[NewRow]) -> list[JournalEntry]:
        if not rows:
            return []
        with write(self._engine) as connection:
            return insert_rows(connection, rows)

    def _commit_registered(self, batch: list[_Submission], error: Exception) -> None:
        """Commit again without the packets of vehicles that were removed while these waited."""
        wanted = {incoming.vehicle.pk for incoming, _ in batch}
        try:
            with read(self._engine) as connection:
                present = set(connection.scalars(select(vehicles.c.pk).where(vehicles.c.pk.in_(wanted))))
        except SQLAlchemyError as reading_error:
            self._fail(batch, reading_error)
            return
        if present == wanted:
            self._fail(batch, error)  # another writer's rows; the sequencers are rebuilt with them
            return
        for incoming, future in batch:
            if incoming.vehicle.pk not in present:
                self._metrics.packets_refused_total.labels(code="unknown_vehicle").inc()
                future.set_result(Outcome("refused", "unknown_vehicle", 0))
        remaining = [(incoming, future) for incoming, future in batch if incoming.vehicle.pk in present]
        if remaining:
            self._commit(remaining)

    def _fail(self, batch: list[_Submission], error: Exception) -> None:
        log.error("%d packets could not be made durable: %s", len(batch), error)
        self._forget(batch)
        for _, future in batch:
            future.set_exception(JournalError("the packet could not be made durable; send again"))

    def _forget(self, batch: list[_Submission]) -> None:
        self._tracking.forget(incoming.vehicle.pk for incoming, _ in batch)

    def _tell(self, decision: _Decision) -> None:
        outcome = decision.outcome
        if outcome.status == "accepted":
            self._metrics.packets_accepted_total.inc()
        elif outcome.status == "duplicate":
            self._metrics.packets_duplicate_total.inc()
        else:
            self._metrics.packets_refused_total.labels(code=outcome.code).inc()
        self._metrics.gaps_stepped_over_total.inc(len(outcome.skipped))
        decision.future.set_result(outcome)

    def _hand_on(self, entries: list[JournalEntry]) -> None:
        if not entries:
            return
        try:
            self._deliver(entries)
        except Exception:
            # They are durable all the same: the engine finds them in the journal when it next recovers.
            log.exception("%d journal rows could not be handed on", len(entries))

    def _look_after(self, vehicle_pk: int) -> None:
        try:
            self._hand_on(self._tracking.sequencer(vehicle_pk)[1])
        except Exception:
            log.exception("vehicle %d cannot be read from the journal; it waits for its next packet", vehicle_pk)

    def _flush(self, vehicle_pk: int, boot_id: str, sequence: int, start_t_ns: int) -> None:
        """Nothing came to fill the gap: say so in the journal, so that the decision is the same for ever."""
        try:
            with write(self._engine) as connection:
                row = (vehicle_pk, boot_id, -sequence, start_t_ns, self._now_ns(), b"")
                entries = insert_rows(connection, [row])
        except Exception as error:
            log.error("the gap of vehicle %d could not be stepped over, to be tried again: %s", vehicle_pk, error)
            self._tracking.forget([vehicle_pk])
            self.watch(vehicle_pk)
            return
        skipped = self._tracking.offer(vehicle_pk, boot_id, -sequence, start_t_ns).skipped
        self._metrics.gaps_stepped_over_total.inc(len(skipped))
        self._hand_on(entries)
