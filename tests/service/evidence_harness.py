"""A vehicle that crashes, its packets folded by an engine, and the worker that makes evidence of it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

from sqlalchemy import Engine as Database
from sqlalchemy import select, update

from core.simulation.scenarios import simulate
from schemas.telemetry_pb2 import TelemetryPacket
from service.engine.shard import EngineConfig
from service.engine.worker import Engine
from service.evidence.bundle import Bundle, from_bytes
from service.evidence.worker import EvidencePolicy, EvidenceWorker, StreetOf
from service.ingest.journal_rows import insert_rows
from service.observability import Metrics
from service.recordings.drive_folder import Drive
from service.recordings.fusing import vehicle_config
from service.recordings.packets import drive_packets
from service.recordings.simulated import drive_of
from service.storage import evidence, tables
from service.storage.database import read, write
from service.storage.evidence import EvidenceRow
from service.storage.vehicles import VehicleDirectory

NS = 1_000_000_000
BOOT = "boot-1"
VEHICLE = "car-1"
WAIT_S = 60.0
NOW_NS = 1_800_000_000 * NS
"""Packets come in a second after each other from here on."""


@cache
def crash_drive() -> tuple[Drive, int]:
    """The simulated drive from two minutes before its first crash to 40 s after it, and the time of that crash."""
    drive = drive_of(simulate("tunnel_crash", 1))
    assert drive.truth is not None
    crash_ns = drive.start_t_ns + round(drive.truth["accidents"][0]["t_s"] * NS)
    return replace(drive, measurements=drive.measurements.between(crash_ns - 125 * NS, crash_ns + 40 * NS)), crash_ns


@cache
def crash_packets() -> tuple[TelemetryPacket, ...]:
    """That drive as a box sends it."""
    return tuple(drive_packets(crash_drive()[0], BOOT, vehicle_id=VEHICLE))


class Story:
    """The vehicle's way through the service, without its network."""

    def __init__(self, database: Database, street_of: StreetOf | None = None, *, begun: bool = False) -> None:
        self.database = database
        self.directory = VehicleDirectory(database, open_registration=True)
        self.ref = self.directory.register("default", VEHICLE, vehicle_config(crash_drive()[0])).ref
        self.packets = list(crash_packets())
        self.crash = max(n for n, one in enumerate(self.packets) if one.start_time_ns <= crash_drive()[1])
        self.worker = EvidenceWorker(
            database,
            self.directory,
            gap_wait_s=10.0,
            policy=EvidencePolicy(rest_per_work=0.0),
            street_of=street_of,
        )
        self.worker._begun_ns = NOW_NS
        self.now_ns = NOW_NS
        self._sent = len(self.packets) if begun else 0

    def send(self, through: int, skipped: frozenset[int] = frozenset()) -> None:
        """Make packets durable, up to the index ``through``, and fold them as a service would that starts anew."""
        rows = []
        for n, one in enumerate(self.packets):
            if self._sent <= n <= through and n not in skipped:
                self.now_ns += NS
                rows.append((self.ref.pk, BOOT, one.sequence, one.start_time_ns, self.now_ns, one.SerializeToString()))
        self._sent = through + 1
        with write(self.database) as connection:
            entries = insert_rows(connection, rows)
        engine = Engine(
            self.database, self.directory, Metrics(), config=EngineConfig(workers=1, packets_per_vehicle=16)
        )
        engine.recover()
        engine.start()
        engine.submit(entries)
        assert engine.drain(WAIT_S)
        engine.stop()
        with write(self.database) as connection:  # the engine goes by the clock on the wall
            connection.execute(update(tables.evidence).values(created_ns=NOW_NS))

    def turn(self, seconds: float = 1.0) -> EvidenceRow:
        """Let so much time pass and the worker look; returns what there is of the accident."""
        self.now_ns += round(seconds * NS)
        self.worker.turn(self.now_ns)
        return self.evidence()

    def evidence(self) -> EvidenceRow:
        with read(self.database) as connection:
            first = select(tables.evidence.c.accident_id).order_by(tables.evidence.c.t_ns).limit(1)
            found = evidence.find(connection, connection.execute(first).scalar_one())
        assert found is not None
        return found

    def bundle(self) -> Bundle:
        row = self.evidence()
        assert row.bundle is not None, row
        return from_bytes(row.bundle)
