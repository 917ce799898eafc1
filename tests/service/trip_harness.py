"""A vehicle that drives trips, its packets folded by an engine, and the worker that assesses them."""

from __future__ import annotations

import json
import math

from sqlalchemy import select

from schemas.packet import encode_packet
from schemas.vehicles import VehicleConfig
from service.engine.shard import EngineConfig
from service.engine.worker import Engine
from service.ingest.journal_rows import insert_rows
from service.observability import Metrics
from service.rating.scoring import Reading
from service.roads.protocol import NullMatcher
from service.storage.database import read, write
from service.storage.tables import trip_records, trips
from service.storage.vehicles import VehicleDirectory
from service.trips.worker import TripPolicy, TripWorker
from tests.service.fleet_drives import RATE_HZ, S, drive

WAIT_S = 300.0
"""A first run on a busy machine compiles the session for a minute or two."""
MOUNTED = VehicleConfig(mounting_rpy_deg=tuple(math.degrees(angle) for angle in drive().mounting_rpy_rad))


class Driver:
    """One vehicle, whose packets go into the journal and are folded, and whose trips are assessed when asked."""

    def __init__(self, database, config=MOUNTED, matcher=None) -> None:
        self.database = database
        self.directory = VehicleDirectory(database, open_registration=True)
        self.ref = self.directory.register("default", "car", config).ref
        self.told = []
        self.worker = TripWorker(
            database,
            self.directory,
            matcher or NullMatcher(),
            Metrics(),
            policy=TripPolicy(rest_per_work=0.0),
            reading=Reading(),
            tell=lambda _ref, event: self.told.append(event),
        )
        self._sent = 0

    def drive(self, parts):
        """Have packets folded, as a service would that starts anew."""
        rows = []
        for part in parts:
            self._sent += 1
            packet = encode_packet("car", "b", self._sent, part, period_ns=round(S / RATE_HZ), wide=True)
            times = int(part.imu_t_ns[0]), int(part.imu_t_ns[-1]) + S
            rows.append((self.ref.pk, "b", self._sent, *times, packet.SerializeToString()))
        with write(self.database) as connection:
            insert_rows(connection, rows)
        engine = Engine(self.database, self.directory, Metrics(), config=EngineConfig(workers=1, idle_s=3600.0))
        engine.recover()
        engine.start()
        assert engine.drain(WAIT_S)
        engine.stop()
        assert engine.health().quarantined == ()

    def turn(self, seconds_later=0.0):
        """Have the worker look."""
        with read(self.database) as connection:
            newest_ns = max([0, *(one for one in connection.scalars(select(trips.c.due_ns)) if one is not None)])
        return self.worker.turn(newest_ns + round(seconds_later * S))

    @property
    def scored(self):
        """The trips that changed scores, as it was told."""
        return [event.body["trip_id"] for event in self.told]

    def stored(self):
        """The records as they are stored, to the bit."""
        columns = (trip_records.c[name] for name in ("trip_id", "record", "cells", "timeline", "model_sha256"))
        with read(self.database) as connection:
            rows = connection.execute(select(*columns).order_by(trip_records.c.start_ns)).all()
        return [(row[0], json.dumps(row[1], sort_keys=True), *row[2:]) for row in rows]
