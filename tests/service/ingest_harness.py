"""The packets' way in, up to the journal, with real Zenoh, HTTP and SQLite; no engine behind it."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import uvicorn
from fastapi import FastAPI
from sqlalchemy import select

from core.measurements import Measurements
from schemas.packet import encode_packet
from schemas.telemetry_pb2 import TelemetryPacket
from service.api import problems
from service.api.security import Authenticator
from service.ingest.http import ingest_routes
from service.ingest.journal import Journal, JournalEntry
from service.ingest.receiver import Receiver
from service.ingest.zenoh import ZenohIngest
from service.observability import Metrics
from service.settings import Settings
from service.storage.database import open_database, read
from service.storage.tables import journal, metadata, vehicles
from service.storage.vehicles import VehicleDirectory

ROOT = Path(__file__).resolve().parents[2]
SECOND_NS = 1_000_000_000
T0_NS = 1_700_000_000 * SECOND_NS
WAIT_S = 30.0  # a bound on what takes milliseconds, so that a fault fails and does not hang


def packet(
    sequence: int, vehicle_id: str = "car-1", boot_id: str = "boot-1", lat_deg: float = 59.35
) -> TelemetryPacket:
    """One second at 10 Hz with one fix."""
    start_t_ns = T0_NS + sequence * SECOND_NS
    gnss = np.full((1, 15), np.nan)
    gnss[0, :3] = np.radians(lat_deg), 0.3 if lat_deg else 0.0, 40.0
    m = Measurements(
        imu_t_ns=start_t_ns + 100_000_000 * np.arange(10),
        f_s=np.tile([0.0, 0.0, -9.81], (10, 1)),
        omega_s=np.zeros((10, 3)),
        gnss_t_ns=np.array([start_t_ns]),
        gnss=gnss,
    )
    return encode_packet(
        vehicle_id, boot_id, sequence, m, period_ns=100_000_000, accel_scale_mps2=0.0006, gyro_scale_radps=0.00015
    )


def poisoned(sequence: int, **names: str) -> TelemetryPacket:
    """A packet that can be placed, with a fix at null island."""
    return packet(sequence, lat_deg=0.0, **names)


class IngestService:
    """What takes packets, over one database file; can be stopped and made anew over the same file."""

    def __init__(self, file: Path, *, registration: str = "open", auth: bool = False, **journal_options: Any) -> None:
        self.database = open_database(f"sqlite:///{file}")
        metadata.create_all(self.database)
        self.metrics = Metrics()
        self.directory = VehicleDirectory(self.database, open_registration=registration == "open")
        self.entries: list[JournalEntry] = []
        self._arrived = threading.Condition()
        self.journal = Journal(self.database, self._deliver, metrics=self.metrics, **journal_options)
        self.receiver = Receiver(self.directory, self.journal, self.metrics)
        self.zenoh: ZenohIngest | None = None
        self._auth = auth
        self._server: uvicorn.Server | None = None
        self._server_thread: threading.Thread | None = None
        self.journal.start()

    def start_zenoh(self, endpoint: str = "tcp/127.0.0.1:0", **options: Any) -> str:
        """Open a router; returns where it listens."""
        settings = Settings(auth="off", zenoh_listen=(endpoint,))
        self.zenoh = ZenohIngest(settings, self.receiver, self.metrics, **options)
        self.zenoh.start()
        return self.zenoh.endpoints[0]

    def start_http(self) -> str:
        """Serve the telemetry routes; returns the base URL."""
        app = FastAPI()
        problems.install(app)
        app.state.authenticator = Authenticator(self.database, required=self._auth)
        app.router.routes.extend(ingest_routes(self.receiver))
        listener = socket.create_server(("127.0.0.1", 0))
        self._server = uvicorn.Server(uvicorn.Config(app, log_level="error", lifespan="off"))
        self._server_thread = threading.Thread(target=self._server.run, args=([listener],), daemon=True)
        self._server_thread.start()
        return f"http://127.0.0.1:{listener.getsockname()[1]}"

    def stop(self) -> None:
        """End everything that was started."""
        if self._server is not None and self._server_thread is not None:
            self._server.should_exit = True
            self._server_thread.join(WAIT_S)
        if self.zenoh is not None:
            self.zenoh.stop()
        self.journal.stop()
        self.database.dispose()

    def wait_for(self, ready: Callable[[list[JournalEntry]], bool]) -> None:
        """Wait until the journal has handed on what is asked for."""
        with self._arrived:
            assert self._arrived.wait_for(lambda: ready(self.entries), WAIT_S), self.entries

    def metric(self, name: str, **labels: str) -> float:
        """A counter's value."""
        return self.metrics.registry.get_sample_value(f"telefuse_{name}", labels) or 0.0

    def rows(self, vehicle_id: str = "car-1") -> list[tuple[str, int, bool]]:
        """The vehicle's journal: boot, sequence, and whether there is a packet."""
        query = (
            select(journal.c.boot_id, journal.c.sequence, journal.c.payload)
            .join(vehicles, vehicles.c.pk == journal.c.vehicle_pk)
            .where(vehicles.c.vehicle_id == vehicle_id)
            .order_by(journal.c.id)
        )
        with read(self.database) as connection:
            return [(boot_id, sequence, bool(payload)) for boot_id, sequence, payload in connection.execute(query)]

    def _deliver(self, entries: Sequence[JournalEntry]) -> None:
        with self._arrived:
            self.entries += entries
            self._arrived.notify_all()


def free_endpoint() -> str:
    """A Zenoh endpoint that nobody listens on."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        return f"tcp/127.0.0.1:{server.getsockname()[1]}"


def spawn(file: Path, endpoint: str) -> subprocess.Popen[str]:
    """The same in a process of its own, to be killed; returns once it listens."""
    process = subprocess.Popen(
        [sys.executable, "-m", "tests.service.ingest_harness", str(file), endpoint],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    return process


if __name__ == "__main__":
    service = IngestService(Path(sys.argv[1]))
    service.start_zenoh(sys.argv[2])
    print("ready", flush=True)
    signal.pause()
