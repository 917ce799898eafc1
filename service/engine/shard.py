"""A shard of the engine: one thread that owns some vehicles, from their packets to what is stored of them."""

from __future__ import annotations

import logging
import os
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import islice, takewhile
from typing import Any, Final, TypeVar

from prometheus_client import Counter
from sqlalchemy import Engine as Database
from sqlalchemy.exc import InterfaceError, OperationalError

from service.engine import checkpoints
from service.engine.checkpoints import Checkpoint
from service.engine.effects import Effects
from service.engine.inbox import Inbox, Work
from service.engine.telling import cloud_event, fused_state
from service.engine.vehicle import SessionFactory, Vehicle
from service.ingest.journal_rows import JournalEntry, load_rows, read_after
from service.observability import Metrics
from service.storage.database import read, write
from service.storage.vehicles import VehicleDirectory, VehicleRef
from service.webhooks.outbox import NewEvent

logger = logging.getLogger(__name__)

_T = TypeVar("_T")

Tell = Callable[[VehicleRef, Mapping[str, Any]], None]
"""Told about a vehicle after the commit; must not block."""

_FIRST_RETRY_S: Final = 0.05
_LONGEST_RETRY_S: Final = 5.0
_CHECKPOINTS_PER_COMMIT: Final = 64
_IDLE_TURN_S: Final = 1.0
_USED: Final = "fused"


@dataclass(frozen=True, slots=True)
class EngineConfig:
    """What the engine may spend, and what it keeps.

    ``checkpoint_interval_s`` bounds what is computed again after a crash. ``track_interval_s``: which rows
    of the track are kept. ``idle_s``: a vehicle silent for so long gets a checkpoint and leaves memory.
    ``max_sessions`` and ``max_held_packets`` bound memory (about 50 kB and 4 kB each); beyond, the vehicle
    longest silent leaves, and packets are read from the journal when it is their turn.
    ``packets_per_vehicle`` and ``packets_per_commit`` bound a transaction, so that a vehicle that is far
    behind holds up no other. ``full_backlog``: packets waiting at which receivers are to be told to wait.
    """

    workers: int = os.cpu_count() or 1
    checkpoint_interval_s: float = 30.0
    gap_wait_s: float = 10.0
    track_interval_s: float = 1.0
    idle_s: float = 60.0
    max_sessions: int = 20_000
    max_held_packets: int = 20_000
    packets_per_vehicle: int = 64
    packets_per_commit: int = 512
    full_backlog: int = 200_000


@dataclass(frozen=True, slots=True)
class Context:
    """What the shards of an engine share.

    One interpreter computes in one thread at a time. Taking turns at ``folding``, a batch each, costs less
    than fighting for the interpreter at every compiled call (two shards: 4.1 against 2.7 thousand packets
    a second), and a shard still folds while another waits for the disk.
    """

    database: Database
    directory: VehicleDirectory
    metrics: Metrics
    packets_fused: Counter
    config: EngineConfig
    session_factory: SessionFactory
    on_event: Tell
    on_state: Tell
    folding: threading.Lock = field(default_factory=threading.Lock)


class _StoppedError(Exception):
    """The database does not answer and the engine stops: the journal has what was not stored."""


class Shard(threading.Thread):
    """Orders, folds and stores the packets of its vehicles, many vehicles in a transaction.

    The steps of a commit, and what a process that dies after each leaves behind:

    1. *Take* what is queued, or read on from the journal for vehicles that are behind. The packets are in
       the journal: after a restart they are read there again.
    2. *Fold*: each vehicle's sequencer orders its packets, its session turns them into effects in memory.
       Nothing is stored; as after 1.
    3. *Store* all effects, and the checkpoints that are due, in one transaction. Before its commit nothing
       of it counts; as after 1. From its commit on, rows, events and their deliveries stand together.
       Packets after the newest checkpoint are folded again after a restart and give the same rows, whose
       keys follow from the packets alone: they meet themselves.
    4. *Tell* the sender of webhooks and the Zenoh subscribers. If that is missed webhooks still go out: the
       sender looks for pending deliveries when it starts. A Zenoh publication is lost, as it is for whoever
       was not listening; the catch-up feed of events has it.
    5. *Forget* what was taken, and drop idle sessions that have their checkpoint. Nothing depends on it.

    While the database fails, 3 is repeated with the same effects: sessions go on only after that. A session
    that raises is set aside with its vehicle (``quarantined``): its checkpoint stays where it was and its
    packets wait in the journal for the next start, or for a change of the vehicle's settings.
    """

    def __init__(self, number: int, context: Context) -> None:
        super().__init__(name=f"engine-{number}", daemon=True)
        config = context.config
        self.inbox = Inbox(max(1, config.max_held_packets // config.workers))
        self.quarantined: dict[int, str] = {}
        self.failure: str | None = None
        self._context = context
        self._config = config
        self._max_sessions = max(1, config.max_sessions // config.workers)
        self._vehicles: OrderedDict[int, Vehicle] = OrderedDict()  # the one longest silent first
        self._stopping = threading.Event()
        self._asked_to_leave: dict[int, threading.Event] = {}

    @property
    def sessions(self) -> int:
        """Vehicles in memory."""
        return len(self._vehicles)

    def run(self) -> None:
        """Work until stopped, then leave a checkpoint of every vehicle."""
        try:
            while not self._stopping.is_set():
                self.inbox.wait(min(_IDLE_TURN_S, self._config.idle_s))
                self._turn()
            while self._store(self._checkpoints(self._vehicles, _CHECKPOINTS_PER_COMMIT)):
                pass
        except _StoppedError:
            logger.warning("%s stops without its last checkpoints: the database does not answer", self.name)
        except Exception as error:
            self.failure = f"{type(error).__name__}: {error}"
            logger.exception("%s has failed; its vehicles' packets wait in the journal for a restart", self.name)

    def stop(self) -> None:
        """Have the thread finish the batch in hand and end; ``join`` waits for it."""
        self._stopping.set()
        self.inbox.wake()

    def set_aside(self, pk: int, timeout_s: float) -> bool:
        """Have a vehicle leave memory with its checkpoint, and take nothing for it until ``take_back``; False where
        that took longer. Packets that come meanwhile wait in the journal."""
        if self.is_alive() and not self._stopping.is_set():
            left = self._asked_to_leave.setdefault(pk, threading.Event())
            self.inbox.wake()
            return left.wait(timeout_s)
        self.inbox.close(pk)
        return True

    def take_back(self, pk: int) -> None:
        """Go on with a vehicle from its checkpoint and the journal, as these are by now."""
        self.quarantined.pop(pk, None)
        self.inbox.reopen(pk)

    def reconsider(self, pk: int) -> None:
        """Try a vehicle that was set aside again, from its checkpoint; its settings have changed."""
        if self.quarantined.pop(pk, None) is not None:
            self.inbox.reopen(pk)

    def _let_leave(self) -> None:
        for pk in list(self._asked_to_leave):
            self.inbox.close(pk)
            if pk in self._vehicles:
                self._store(self._checkpoints([pk], 1))
                self._vehicles.pop(pk, None)
            self._asked_to_leave.pop(pk).set()

    def _turn(self) -> None:
        self._let_leave()
        work = self.inbox.take(self._config.packets_per_vehicle, self._config.packets_per_commit)
        with self._context.folding:
            batch = [effects for item in work if (effects := self._fold(item)) is not None]
        leaving = self._leaving({effects.ref.pk for effects in batch})
        batch += self._checkpoints(leaving, _CHECKPOINTS_PER_COMMIT)
        for effects, events in self._store(batch):
            self._tell(effects, events)
        for pk in leaving:
            vehicle = self._vehicles.get(pk)
            if vehicle is not None and vehicle.is_saved:
                del self._vehicles[pk]
        self.inbox.done()

    # --- 1 and 2: take and fold -------------------------------------------------------------------

    def _fold(self, work: Work) -> Effects | None:
        pk = work.vehicle_pk
        if pk in self.quarantined:
            return None
        ref = self._retry(lambda: self._context.directory.by_pk(pk))
        if ref is None:
            self._remove(pk)
            return None
        effects = Effects(ref, round(self._config.track_interval_s * 1e9))
        is_new = pk not in self._vehicles
        try:
            vehicle = self._vehicle(ref)
            entries = self._entries(work, vehicle)
            if is_new and entries:
                entries = [*self._between(vehicle, entries[0].journal_id), *entries]
            vehicle.fold(entries, self._load, effects)
            if effects.must_be_kept or vehicle.is_due(round(self._config.checkpoint_interval_s * 1e9), time.time_ns()):
                effects.checkpoint = vehicle.checkpoint()
        except _StoppedError:
            raise
        except Exception as error:
            self._quarantine(ref, error)
        return effects

    def _vehicle(self, ref: VehicleRef) -> Vehicle:
        vehicle = self._vehicles.get(ref.pk)
        now_ns = time.time_ns()
        if vehicle is None:
            checkpoint = self._retry(lambda: self._checkpoint(ref.pk))
            gap_wait_ns = round(self._config.gap_wait_s * 1e9)
            vehicle = Vehicle(ref, checkpoint, self._context.session_factory, gap_wait_ns, now_ns)
            self._vehicles[ref.pk] = vehicle
        elif vehicle.ref != ref:
            vehicle.reconfigure(ref)
        vehicle.active_ns = now_ns
        self._vehicles.move_to_end(ref.pk)
        return vehicle

    def _checkpoint(self, pk: int) -> Checkpoint | None:
        with read(self._context.database) as connection:
            return checkpoints.load(connection, pk)

    def _entries(self, work: Work, vehicle: Vehicle) -> Sequence[JournalEntry]:
        if work.lag is None:
            return work.entries
        limit, database = self._config.packets_per_vehicle, self._context.database
        rows = self._retry(lambda: list(islice(read_after(database, work.vehicle_pk, vehicle.journal_id), limit)))
        self.inbox.read_on(work, len(rows), at_end=len(rows) < limit)
        return rows

    def _between(self, vehicle: Vehicle, next_id: int) -> list[JournalEntry]:
        """Rows after the vehicle's checkpoint that nobody handed on: none, unless something went wrong."""
        database, pk, last_id = self._context.database, vehicle.ref.pk, vehicle.journal_id
        return self._retry(
            lambda: list(takewhile(lambda row: row.journal_id < next_id, read_after(database, pk, last_id)))
        )

    def _load(self, ids: Sequence[int]) -> Iterable[JournalEntry]:
        return self._retry(lambda: load_rows(self._context.database, ids))

    # --- 3: store ---------------------------------------------------------------------------------

    def _store(self, batch: Sequence[Effects]) -> list[tuple[Effects, list[NewEvent]]]:
        """Write the batch; what one vehicle's rows break is that vehicle's alone."""
        if not batch:
            return []
        try:
            stored = self._retry(lambda: self._write(batch))
        except _StoppedError:
            raise
        except Exception:
            stored = [done for effects in batch for done in self._store_alone(effects)]
        now_ns = time.time_ns()
        for effects, _ in stored:
            vehicle = self._vehicles.get(effects.ref.pk)
            if effects.checkpoint is not None and vehicle is not None:
                vehicle.mark_saved(effects.checkpoint, now_ns)
        return stored

    def _store_alone(self, effects: Effects) -> list[tuple[Effects, list[NewEvent]]]:
        try:
            return self._retry(lambda: self._write([effects]))
        except _StoppedError:
            raise
        except Exception as error:
            if self._retry(lambda: self._context.directory.by_pk(effects.ref.pk)) is None:
                self._remove(effects.ref.pk)
            else:
                self._quarantine(effects.ref, error)
            return []

    def _write(self, batch: Sequence[Effects]) -> list[tuple[Effects, list[NewEvent]]]:
        stored_ns = time.time_ns()
        with write(self._context.database) as connection:
            return [(effects, effects.store(connection, stored_ns)) for effects in batch]

    def _retry(self, action: Callable[[], _T]) -> _T:
        """Do it again while the database cannot be reached or is locked; a stop ends the waiting."""
        delay_s = _FIRST_RETRY_S
        while True:
            try:
                return action()
            except (OperationalError, InterfaceError) as error:
                logger.warning("%s: the database fails, again in %.2f s: %s", self.name, delay_s, error.orig)
            if self._stopping.wait(delay_s):
                raise _StoppedError
            delay_s = min(2 * delay_s, _LONGEST_RETRY_S)

    # --- 4 and 5: tell and forget -----------------------------------------------------------------

    def _tell(self, effects: Effects, events: Sequence[NewEvent]) -> None:
        ref, metrics = effects.ref, self._context.metrics
        self._context.packets_fused.inc(effects.packets)
        for name, count in effects.counts.items():
            aid, _, outcome = name.rpartition(".")
            if outcome != _USED:
                metrics.session_rejections_total.labels(aid=aid, outcome=outcome).inc(count)
        for event in events:
            if event.type == "accident.detected":
                metrics.accidents_total.labels(severity=event.body["severity"]).inc()
            self._tell_one(self._context.on_event, ref, cloud_event(ref, event))
        if effects.latest is not None:
            self._tell_one(self._context.on_state, ref, fused_state(ref, effects.latest))

    def _tell_one(self, tell: Tell, ref: VehicleRef, message: Mapping[str, Any]) -> None:
        try:
            tell(ref, message)
        except Exception:
            logger.exception("%s: could not tell about vehicle %s", self.name, ref.vehicle_id)

    def _leaving(self, in_batch: set[int]) -> list[int]:
        """Vehicles to drop from memory: silent for long, or the longest silent of too many."""
        silent_since_ns = time.time_ns() - round(self._config.idle_s * 1e9)
        too_many = len(self._vehicles) - self._max_sessions
        candidates = islice(self._vehicles.items(), _CHECKPOINTS_PER_COMMIT)
        return [
            pk
            for rank, (pk, vehicle) in enumerate(candidates)
            if pk not in in_batch and (rank < too_many or vehicle.active_ns < silent_since_ns)
        ]

    def _checkpoints(self, pks: Iterable[int], limit: int) -> list[Effects]:
        """Effects that are a checkpoint alone, for those of these vehicles that need one."""
        found = []
        for pk in islice((pk for pk in pks if not self._vehicles[pk].is_saved), limit):
            vehicle = self._vehicles[pk]
            effects = Effects(vehicle.ref, 1)
            try:
                effects.checkpoint = vehicle.checkpoint()
            except Exception as error:
                self._quarantine(vehicle.ref, error)
                continue
            found.append(effects)
        return found

    def _quarantine(self, ref: VehicleRef, error: Exception) -> None:
        self.quarantined[ref.pk] = f"{ref.tenant_id}/{ref.vehicle_id}: {type(error).__name__}: {error}"
        self.inbox.close(ref.pk)
        self._vehicles.pop(ref.pk, None)
        logger.error(
            "vehicle %s of tenant %s is set aside, as its session failed; its packets wait in the journal until the "
            "service starts again or the vehicle's settings change",
            ref.vehicle_id,
            ref.tenant_id,
            exc_info=error,
        )

    def _remove(self, pk: int) -> None:
        self.inbox.close(pk)
        self._vehicles.pop(pk, None)
