"""An engine over a real database, with a small fold in the session's place so that every input shows in the output."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import numpy as np
from sqlalchemy import Engine as Database
from sqlalchemy import select

from core.accident.events import Candidate, Impact, NoAccident, Severity, Status
from core.accident.placing import Accident, Place, Suppressed
from core.driving.trips import Trip
from core.measurements import Measurements
from core.navigation.track import TRACK, TRACK_COLUMNS, Mode, Track
from core.session import Outputs
from schemas.packet import encode_packet
from schemas.vehicles import VehicleConfig
from service.engine.shard import EngineConfig
from service.engine.worker import Engine
from service.ingest.journal_rows import JournalEntry, insert_rows
from service.observability import Metrics
from service.storage.database import read, write
from service.storage.tables import (
    accident_candidates,
    accidents,
    events,
    manoeuvres,
    track_points,
    trips,
)
from service.storage.vehicles import VehicleDirectory, VehicleRef

START_NS = 1_750_000_000_000_000_000
SECOND_NS = 1_000_000_000
CRASH_MPS2 = 100.0
WORSE_MPS2 = 150.0
NOTHING_MPS2 = 160.0
POTHOLE_MPS2 = 30.0
AT_ONCE_MPS2 = 170.0
POISON_MPS2 = 666.0
WAIT_S = 20.0


class SummingFold:
    """A position that depends on every packet so far and on their order; a crash where a sample is large."""

    def __init__(self, config: VehicleConfig, _calibrations: Any, snapshot: bytes | None) -> None:
        state = {"sum": 0.0, "packets": 0, "start": 0, "crashed": 0} if snapshot is None else json.loads(snapshot)
        self.config, self.sum, self.packets = config, state["sum"], state["packets"]
        self.start, self.crashed = state["start"], state["crashed"]

    def snapshot(self) -> bytes:
        names = ("sum", "packets", "start", "crashed")
        return json.dumps({name: getattr(self, name) for name in names}).encode()

    def step(self, measurements: Measurements) -> Outputs:
        value = float(measurements.f_s[0, 0])
        if abs(value - POISON_MPS2) < 0.5:
            raise ZeroDivisionError("a bug in the session")
        t_ns = int(measurements.imu_t_ns[0])
        self.start = self.start or t_ns
        self.packets += 1
        self.sum = 0.9 * self.sum + value * self.packets
        grid = t_ns + np.arange(10) * 100_000_000
        rows = np.zeros((10, len(TRACK_COLUMNS)))
        rows[:, TRACK["lat_rad"]] = 1e-6 * self.sum
        rows[:, TRACK["yaw_rad"]] = np.nan
        rows[:, TRACK["mode"]] = Mode.AIDED
        crash: tuple[Accident, ...] = ()
        suppressed: tuple[Suppressed, ...] = ()
        if abs(value - POTHOLE_MPS2) < 0.5:
            suppressed = (self._pothole(t_ns),)
        elif abs(value - NOTHING_MPS2) < 0.5:
            crash = (self._crash(self.crashed, 2, Status.RETRACTED),)
        elif abs(value - AT_ONCE_MPS2) < 0.5:
            crash, self.crashed = tuple(self._crash(t_ns, n, Status.CONFIRMED) for n in range(3)), t_ns
        elif abs(value - CRASH_MPS2) < 0.5:
            crash, self.crashed = (self._crash(t_ns, 0),), t_ns
        elif abs(value - WORSE_MPS2) < 0.5:
            crash = (self._crash(self.crashed, 1),)
        trip = Trip(self.start, t_ns, 0.0, 0.0, 0.0, 0.0, self.sum, 1.0, 0.0, 1.0, ended=self.packets == 12)
        counts = {"gnss_position.rejected_gate": 1, "gnss_position.fused": 2}
        return Outputs(Track(grid, rows), crash, (trip,), counts, suppressed=suppressed)

    def _place(self) -> Place:
        return Place(1e-6 * self.sum, 0.0, 5.0, 1.0, 2.0, 0.1, np.nan, Mode.COASTING)

    def _pothole(self, t_ns: int) -> Suppressed:
        shock = Candidate(
            t_ns, t_ns + SECOND_NS, NoAccident.POTHOLE, 0.04, 1.5, np.nan, 31.0, 0.05, 12.0, paper_agrees=True
        )
        return Suppressed(shock, self._place())

    def _crash(self, t_ns: int, revision: int, status: Status = Status.SUSPECTED) -> Accident:
        impact = Impact(
            t_ns,
            t_ns + (1 + revision) * SECOND_NS,
            "fold",
            Severity.SEVERE,
            0.9,
            8.0,
            0.5,
            (-8.0, 0.0),
            0.0,
            20.0,
            0.1,
            True,
            np.nan,
            False,
            revision,
            status=status,
            delta_v_interval_mps=(7.0, np.inf),
        )
        return Accident(impact, self._place())


class Bench:
    """A database with vehicles and a journal, and engines over it as a service would start them."""

    def __init__(self, database: Database) -> None:
        self.database = database
        self.directory = VehicleDirectory(self.database, open_registration=True)
        self.told: list[tuple[str, dict[str, Any]]] = []
        self.states: list[dict[str, Any]] = []
        self.metrics = Metrics()

    def vehicle(self, name: str) -> VehicleRef:
        ref = self.directory.resolve("default", name)
        assert ref is not None
        return ref

    def journal(self, *packets: tuple[VehicleRef, int, float], boot: str = "b1") -> list[JournalEntry]:
        """Make packets durable, each (vehicle, sequence, first sample), a second apart by their sequence."""
        rows = []
        for ref, sequence, value in packets:
            start_ns = START_NS + sequence * SECOND_NS
            measured = Measurements(
                imu_t_ns=np.array([start_ns]), f_s=np.array([[value, 0.0, 0.0]]), omega_s=np.zeros((1, 3))
            )
            packet = encode_packet(ref.vehicle_id, boot, sequence, measured, period_ns=SECOND_NS, wide=True)
            rows.append((ref.pk, boot, sequence, start_ns, start_ns + SECOND_NS, packet.SerializeToString()))
        with write(self.database) as connection:
            return insert_rows(connection, rows)

    def engine(self, factory: Callable[..., Any] = SummingFold, **config: Any) -> Engine:
        self.metrics = Metrics()
        return Engine(
            self.database,
            self.directory,
            self.metrics,
            config=EngineConfig(**{"workers": 2, "idle_s": 3600.0, **config}),
            session_factory=factory,
            on_event=lambda ref, event: self.told.append((ref.vehicle_id, dict(event))),
            on_state=lambda _ref, state: self.states.append(dict(state)),
        )

    def exposition(self) -> str:
        return self.metrics.exposition().decode()

    def stored(self) -> dict[str, list[Any]]:
        """Everything that a session brought, without the times at which it was stored."""
        with read(self.database) as connection:
            return {
                table.name: [
                    tuple(row)
                    for row in connection.execute(
                        select(*(c for c in table.c if c.name not in ("stored_ns", "due_ns", "cursor"))).order_by(
                            *table.primary_key
                        )
                    )
                ]
                for table in (track_points, trips, accidents, accident_candidates, manoeuvres)
            } | {"events": sorted(map(tuple, connection.execute(select(events.c.id, events.c.type, events.c.t_ns))))}


def run(bench: Bench, entries: list[JournalEntry], **config: Any) -> Engine:
    """Start an engine as a service does, give it the entries, and stop it once they are stored."""
    engine = bench.engine(**config)
    engine.recover()
    engine.start()
    engine.submit(entries)
    assert engine.drain(WAIT_S)
    engine.stop()
    return engine


def drive(ref: VehicleRef, crash_at: int = 7, last: int = 12) -> list[tuple[VehicleRef, int, float]]:
    return [(ref, n, CRASH_MPS2 if n == crash_at else 0.1 * n) for n in range(1, last + 1)]
