"""The running service without its HTTP face: what there is, in which order it starts, and how it ends."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Awaitable, Callable, Mapping
from contextlib import AsyncExitStack, suppress
from dataclasses import asdict
from functools import partial
from typing import Any, Final

from sqlalchemy import Engine as Database
from sqlalchemy.exc import SQLAlchemyError

from service.calibrations.files import RunFiles
from service.calibrations.worker import CalibrationWorker
from service.engine import checkpoints
from service.engine.sessions import warm_up
from service.engine.shard import EngineConfig
from service.engine.telling import cloud_event
from service.engine.worker import Engine
from service.evidence.worker import EvidenceWorker
from service.ingest.journal import Journal
from service.ingest.receiver import Receiver
from service.ingest.zenoh import ZenohIngest
from service.observability import Metrics
from service.rating.scoring import Reading
from service.roads.matching import RoadService
from service.settings import Settings
from service.storage import retention, schema
from service.storage.database import open_database, read
from service.storage.holding import hold_database
from service.storage.vehicles import VehicleDirectory, VehicleRef
from service.trips.worker import TripPolicy, TripWorker
from service.webhooks.outbox import NewEvent
from service.webhooks.sender import Sender

logger = logging.getLogger(__name__)

DRAIN_S: Final = 20.0
"""How long a stop waits for packets in hand to be fused; what is left is fused after the next start."""

PRUNE_EVERY_S: Final = 3600.0


class Runtime:
    """Owns everything that runs; ``start`` once, ``stop`` once.

    Data flows one way: receivers (Zenoh, HTTP) → journal → engine → database → sender and Zenoh. It starts from
    the end of that way and stops from its beginning, so that no part ever hands on to one that is not there.
    """

    settings: Settings
    metrics: Metrics
    database: Database
    directory: VehicleDirectory
    engine: Engine
    journal: Journal
    receiver: Receiver
    sender: Sender
    run_files: RunFiles
    calibrating: CalibrationWorker
    proving: EvidenceWorker
    assessing: TripWorker
    roads: RoadService
    zenoh: ZenohIngest
    reading: Reading
    _sending: asyncio.Task[None]

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self.metrics = Metrics()
        self.reading = Reading()
        self._running = AsyncExitStack()
        self._started = False

    async def start(self) -> None:
        """Open and upgrade the database, recover, and only then take packets."""
        async with AsyncExitStack() as starting:
            await self._start(starting)
            self._running = starting.pop_all()
        self._started = True
        logger.info("ready")

    async def stop(self) -> None:
        """Take no more packets, finish and store those taken, let webhooks under way end."""
        self._started = False
        await self._running.aclose()
        logger.info("stopped")

    async def _start(self, stack: AsyncExitStack) -> None:
        settings = self.settings
        in_thread = asyncio.to_thread

        def at_stop(close: Callable[[], object]) -> None:
            stack.push_async_callback(in_thread, close)

        self.roads = RoadService(settings.roads)
        self.roads.start()
        at_stop(self.roads.stop)
        self.database = open_database(settings.database_url)
        at_stop(self.database.dispose)
        at_stop(await in_thread(hold_database, self.database))
        await in_thread(schema.upgrade, self.database)

        self.directory = VehicleDirectory(self.database, open_registration=settings.registration == "open")
        self.sender = Sender(self.database, settings, self.metrics)
        self._sending = asyncio.create_task(self.sender.run(), name="webhook-sender")
        stack.push_async_callback(_stop_task, self._sending, self.sender.stop)

        self.engine = Engine(
            self.database,
            self.directory,
            self.metrics,
            config=EngineConfig(
                workers=settings.workers,
                checkpoint_interval_s=settings.checkpoint_interval_s,
                gap_wait_s=settings.gap_wait_s,
            ),
            on_event=self._on_event,
            on_state=lambda ref, state: self.zenoh.publish_state(ref, state),
        )
        self.journal = Journal(
            self.database, self.engine.submit, metrics=self.metrics, gap_wait_ns=round(settings.gap_wait_s * 1e9)
        )
        self.receiver = Receiver(self.directory, self.journal, self.metrics, is_busy=lambda: self.engine.is_full)
        self.zenoh = ZenohIngest(settings, self.receiver, self.metrics)
        await in_thread(warm_up)
        behind = await in_thread(self.engine.recover)
        if behind:
            logger.info("%d packets are fused again from the journal", behind)
        self.engine.start()
        at_stop(self.engine.stop)
        for vehicle_pk in await in_thread(self._held_back):
            self.journal.watch(vehicle_pk)
        await in_thread(self.zenoh.start)
        at_stop(self.zenoh.stop)
        at_stop(partial(self.engine.drain, DRAIN_S))
        self.run_files = RunFiles(settings.data_dir)
        self.calibrating = CalibrationWorker(self.database, self.run_files)
        self.calibrating.start()
        at_stop(self.calibrating.stop)
        self.proving = EvidenceWorker(
            self.database,
            self.directory,
            gap_wait_s=settings.gap_wait_s,
            street_of=lambda *way: self.roads.match(*way).street(-1),
        )
        self.proving.start()
        at_stop(self.proving.stop)
        self.assessing = TripWorker(
            self.database,
            self.directory,
            self.roads,
            self.metrics,
            reading=self.reading,
            policy=TripPolicy(silent_s=settings.trip_silence_s),
            tell=self.tell,
        )
        self.assessing.start()
        at_stop(self.assessing.stop)
        # Nothing is taken before this line, and nothing after its stop; what comes is refused to be sent again.
        self.journal.start()
        at_stop(self.journal.stop)
        pruning = asyncio.create_task(self._prune_for_ever(), name="retention")
        stack.push_async_callback(_stop_task, pruning)

    def problems(self) -> dict[str, str | None]:
        """What keeps the parts from working, for ``/readyz``; None for one that works.

        A single vehicle that is set aside is not among them: restarting would help no other.
        """
        if not self._started:
            return {"runtime": "starting or stopping"}
        engine = "; ".join(self.engine.health().failed) or None
        if engine is None and self.engine.is_full:
            engine = f"{self.engine.backlog} packets wait to be fused; new ones are turned away"
        return {
            "engine": engine,
            "trips": None if self.assessing.is_working else "trips are not assessed any more; the log says why",
            "webhooks": "the sender has ended; the log says why" if self._sending.done() else None,
        }

    def _held_back(self) -> set[int]:
        """Vehicles that may have packets behind a gap, which the journal must let go after a while."""
        with read(self.database) as connection:
            return {lag.vehicle_pk for lag in checkpoints.lagging(connection)} | checkpoints.holding(connection)

    def tell(self, ref: VehicleRef, event: NewEvent) -> None:
        """Have an event go out that was stored; after the commit."""
        self._on_event(ref, cloud_event(ref, event))

    def _on_event(self, ref: VehicleRef, event: Mapping[str, Any]) -> None:
        self.sender.notify()
        self.zenoh.publish_event(ref, event)

    async def _prune_for_ever(self) -> None:
        settings = self.settings
        while True:
            try:
                removed = await asyncio.to_thread(
                    retention.prune,
                    self.database,
                    time.time_ns(),
                    journal_days=settings.retention_journal_days,
                    track_days=settings.retention_track_days,
                    events_days=settings.retention_events_days,
                    candidates_days=settings.retention_candidates_days,
                    evidence_days=settings.retention_evidence_days,
                )
                files = await asyncio.to_thread(
                    self.run_files.sweep, self.database, time.time_ns(), settings.retention_recordings_days
                )
                if files:
                    logger.info("removed %d files of calibration runs", files)
                if any(asdict(removed).values()):
                    logger.info("removed what is older than it is kept", extra={"fields": asdict(removed)})
            except (SQLAlchemyError, OSError) as error:
                logger.warning("what is too old could not be removed and is tried again in an hour: %s", error)
            await asyncio.sleep(PRUNE_EVERY_S)


async def _stop_task(task: asyncio.Task[None], ask: Callable[[], Awaitable[None]] | None = None) -> None:
    if ask is None:
        task.cancel()
    else:
        await ask()
    with suppress(asyncio.CancelledError):
        await task
