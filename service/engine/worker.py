"""The engine: folds journaled packets into what is stored and told, in threads beside the event loop."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby

from prometheus_client import Counter, Gauge
from sqlalchemy import Engine as Database

from service.engine import checkpoints
from service.engine.sessions import open_session
from service.engine.shard import Context, EngineConfig, Shard, Tell
from service.engine.vehicle import SessionFactory
from service.ingest.journal_rows import JournalEntry
from service.observability import Metrics
from service.storage.database import read
from service.storage.vehicles import VehicleDirectory, VehicleRef


@dataclass(frozen=True, slots=True)
class EngineHealth:
    """What an operator should know: ``failed`` shards need a restart, ``quarantined`` vehicles a look at the log."""

    backlog: int
    sessions: int
    quarantined: tuple[str, ...]
    failed: tuple[str, ...]


def _tell_nobody(_ref: VehicleRef, _message: object) -> None:
    return


class Engine:
    """A session per vehicle, each in the one shard (thread) that owns the vehicle.

    ``recover`` once, then ``start``; from then on ``submit`` takes journal entries, from any thread and
    without waiting. ``stop`` leaves checkpoints, so that a start after it has nothing to repeat.
    """

    def __init__(
        self,
        database: Database,
        directory: VehicleDirectory,
        metrics: Metrics,
        *,
        config: EngineConfig | None = None,
        session_factory: SessionFactory = open_session,
        on_event: Tell = _tell_nobody,
        on_state: Tell = _tell_nobody,
    ) -> None:
        self._database = database
        self._config = config or EngineConfig()
        fused = Counter(
            "telefuse_packets_fused", "Packets that had their turn and are stored.", registry=metrics.registry
        )
        context = Context(database, directory, metrics, fused, self._config, session_factory, on_event, on_state)
        self._shards = [Shard(number, context) for number in range(self._config.workers)]
        directory.on_change(lambda pk: self._shard(pk).reconsider(pk))
        metrics.engine_backlog.set_function(lambda: self.backlog)
        quarantined = Gauge(
            "telefuse_vehicles_quarantined",
            "Vehicles set aside because their session failed; the log says why.",
            registry=metrics.registry,
        )
        quarantined.set_function(lambda: len(self.health().quarantined))
        metrics.vehicles_active.set_function(lambda: sum(shard.sessions for shard in self._shards))

    def recover(self) -> int:
        """Have every vehicle with journal rows after its checkpoint go on from there; returns how many rows.

        The shards read those rows in their turns. What is submitted meanwhile is read after them, because
        a vehicle that is behind takes everything from the journal, in its order.
        """
        with read(self._database) as connection:
            lagging = checkpoints.lagging(connection)
        for lag in lagging:
            self._shard(lag.vehicle_pk).inbox.mark_behind(lag)
        return sum(lag.rows for lag in lagging)

    def start(self) -> None:
        """Begin to work."""
        for shard in self._shards:
            shard.start()

    def submit(self, entries: Sequence[JournalEntry]) -> None:
        """Take durable packets, in journal order; never waits."""
        if len(self._shards) == 1:
            self._shards[0].inbox.put(entries)
            return
        by_shard = sorted(entries, key=lambda entry: entry.vehicle_pk % len(self._shards))
        for _, group in groupby(by_shard, key=lambda entry: entry.vehicle_pk % len(self._shards)):
            mine = list(group)
            self._shard(mine[0].vehicle_pk).inbox.put(mine)

    def set_aside(self, vehicle_pk: int, timeout_s: float) -> bool:
        """Have a vehicle leave memory, with its checkpoint stored, until ``take_back``; False where it took longer."""
        return self._shard(vehicle_pk).set_aside(vehicle_pk, timeout_s)

    def take_back(self, vehicle_pk: int) -> None:
        """Go on with a vehicle from its checkpoint and the journal, as these are by now."""
        self._shard(vehicle_pk).take_back(vehicle_pk)

    @property
    def backlog(self) -> int:
        """Durable packets that are not folded and stored yet, here or still to be read from the journal."""
        return sum(shard.inbox.backlog for shard in self._shards)

    @property
    def is_full(self) -> bool:
        """Whether receivers should refuse packets for a while."""
        return self.backlog >= self._config.full_backlog

    def drain(self, timeout_s: float) -> bool:
        """Wait until everything submitted so far is stored; False if that took longer."""
        deadline = time.monotonic() + timeout_s
        return all(shard.inbox.wait_empty(max(0.0, deadline - time.monotonic())) for shard in self._shards)

    def stop(self) -> None:
        """Finish what is in hand, store a checkpoint of every vehicle and end the threads."""
        for shard in self._shards:
            shard.stop()
        for shard in self._shards:
            if shard.ident is not None:
                shard.join()

    def health(self) -> EngineHealth:
        """How the engine is, for ``/readyz``."""
        return EngineHealth(
            backlog=self.backlog,
            sessions=sum(shard.sessions for shard in self._shards),
            quarantined=tuple(reason for shard in self._shards for reason in list(shard.quarantined.values())),
            failed=tuple(f"{shard.name}: {shard.failure}" for shard in self._shards if shard.failure is not None),
        )

    def _shard(self, vehicle_pk: int) -> Shard:
        return self._shards[vehicle_pk % len(self._shards)]
