"""The engine where sessions raise, databases fail, vehicles change, go or idle: nothing is lost or done twice."""

from __future__ import annotations

import logging
import threading
from typing import Any

from sqlalchemy import select, text

from core.errors import SnapshotError
from core.measurements import Measurements
from core.session import Outputs
from schemas.vehicles import VehicleConfig
from service.storage.database import read, write
from service.storage.tables import (
    checkpoints,
)
from tests.service.engine_bench import (
    POISON_MPS2,
    WAIT_S,
    Bench,
    SummingFold,
    drive,
    run,
)


def test_a_session_that_raises_stops_no_other_and_its_packets_are_used_after_a_restart(bench: Bench) -> None:
    poisoned, healthy = bench.vehicle("poisoned"), bench.vehicle("healthy")
    packets = [p for n in range(1, 6) for p in ((poisoned, n, POISON_MPS2 if n == 3 else 1.0), (healthy, n, 1.0))]
    engine = run(bench, bench.journal(*packets), workers=1)
    health = engine.health()
    assert health.backlog == 0
    assert len(health.quarantined) == 1
    assert "default/poisoned: ZeroDivisionError: a bug in the session" in health.quarantined[0]
    count = [sum(row[0] == ref.pk for row in bench.stored()["track_points"]) for ref in (poisoned, healthy)]
    assert count == [2, 5]
    with read(bench.database) as connection:
        saved = dict(connection.execute(select(checkpoints.c.vehicle_pk, checkpoints.c.journal_id)).all())
    assert poisoned.pk not in saved

    class MendedFold(SummingFold):
        def step(self, measurements: Measurements) -> Outputs:
            measurements.f_s[measurements.f_s == POISON_MPS2] = 0.0
            return super().step(measurements)

    run(bench, [], factory=MendedFold)
    assert sum(row[0] == poisoned.pk for row in bench.stored()["track_points"]) == 5


def test_a_vehicle_set_aside_goes_on_once_its_settings_are_mended(bench: Bench) -> None:
    ref = bench.vehicle("car-1")
    entries = bench.journal(*drive(ref))

    def picky(config: VehicleConfig, calibrations: Any, snapshot: bytes | None) -> SummingFold:
        if config.detector == "paper":
            raise ValueError("settings that no session can use")
        return SummingFold(config, calibrations, snapshot)

    engine = bench.engine(picky)
    engine.start()
    engine.submit(entries[:4])
    assert engine.drain(WAIT_S)
    bench.directory.register("default", "car-1", VehicleConfig(detector="paper"))
    engine.submit(entries[4:8])
    assert engine.drain(WAIT_S)
    assert len(engine.health().quarantined) == 1
    bench.directory.register("default", "car-1", VehicleConfig())
    engine.submit(entries[8:])
    assert engine.drain(WAIT_S)
    engine.stop()
    assert engine.health().quarantined == ()
    assert len(bench.stored()["track_points"]) == 12


def test_rows_that_were_never_handed_on_are_found_when_the_vehicle_is_opened(bench: Bench, other: Bench) -> None:
    run(bench, bench.journal(*drive(bench.vehicle("car-1"))))
    entries = other.journal(*drive(other.vehicle("car-1")))
    run(other, entries[:3])
    engine = other.engine()  # without recovery, as after an eviction
    engine.start()
    engine.submit(entries[6:])
    assert engine.drain(WAIT_S)
    engine.stop()
    assert other.stored() == bench.stored()


def test_nothing_is_lost_and_no_packet_used_twice_while_the_database_fails(bench: Bench, other: Bench) -> None:
    run(bench, bench.journal(*drive(bench.vehicle("car-1"))))
    entries = other.journal(*drive(other.vehicle("car-1")))
    with write(other.database) as connection:
        connection.execute(text("ALTER TABLE track_points RENAME TO away"))
    warned = threading.Event()
    engine = other.engine()
    engine.start()

    class Watch(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            warned.set()

    handler = Watch()
    logging.getLogger("service.engine.shard").addHandler(handler)
    engine.submit(entries)
    assert warned.wait(WAIT_S)
    logging.getLogger("service.engine.shard").removeHandler(handler)
    with write(other.database) as connection:
        connection.execute(text("ALTER TABLE away RENAME TO track_points"))
    assert engine.drain(WAIT_S)
    engine.stop()
    assert other.stored() == bench.stored()


def test_a_removed_vehicle_takes_nothing_with_it(bench: Bench) -> None:
    gone, stays = bench.vehicle("gone"), bench.vehicle("stays")
    first = bench.journal((gone, 1, 1.0), (stays, 1, 1.0))
    second = bench.journal((gone, 2, 1.0), (stays, 2, 1.0))
    removed = threading.Event()

    class RemovingFold(SummingFold):
        """Removes the vehicle between its fold and the commit."""

        def step(self, measurements: Measurements) -> Outputs:
            if not removed.is_set():
                removed.set()
                bench.directory.remove("default", "gone")
            return super().step(measurements)

    engine = run(bench, first + second, workers=1, factory=RemovingFold)
    assert engine.health().quarantined == ()
    assert {row[0] for row in bench.stored()["track_points"]} == {stays.pk}


def test_changed_settings_apply_to_the_same_session_from_then_on(bench: Bench) -> None:
    ref = bench.vehicle("car-1")
    entries = bench.journal(*drive(ref))
    opened: list[tuple[VehicleConfig, bool]] = []

    def factory(config: VehicleConfig, calibrations: Any, snapshot: bytes | None) -> SummingFold:
        opened.append((config, snapshot is None))
        return SummingFold(config, calibrations, snapshot)

    engine = bench.engine(factory)
    engine.start()
    engine.submit(entries[:6])
    assert engine.drain(WAIT_S)
    changed = VehicleConfig(detector="paper")
    bench.directory.register("default", "car-1", changed)
    engine.submit(entries[6:])
    assert engine.drain(WAIT_S)
    engine.stop()
    assert opened == [(VehicleConfig(), True), (changed, False)]
    assert len(bench.stored()["track_points"]) == 12


def test_a_snapshot_of_another_version_begins_anew_and_keeps_the_sequence(bench: Bench) -> None:
    entries = bench.journal(*drive(bench.vehicle("car-1")))
    run(bench, entries[:6])

    def newer(config: VehicleConfig, calibrations: Any, snapshot: bytes | None) -> SummingFold:
        if snapshot is not None and b"version" not in snapshot:
            raise SnapshotError("snapshot has version 1, expected 2")
        return SummingFold(config, calibrations, snapshot)

    run(bench, entries, factory=newer)
    assert len(bench.stored()["track_points"]) == 12


def test_idle_vehicles_leave_memory_with_a_checkpoint(bench: Bench) -> None:
    entries = bench.journal(*drive(bench.vehicle("car-1")))
    engine = bench.engine(idle_s=0.01, checkpoint_interval_s=3600.0)
    engine.start()
    engine.submit(entries)
    assert engine.drain(WAIT_S)
    for _ in range(1000):
        if engine.health().sessions == 0:
            break
        threading.Event().wait(0.01)
    assert engine.health().sessions == 0
    with read(bench.database) as connection:
        assert connection.execute(select(checkpoints.c.journal_id)).scalar_one() == entries[-1].journal_id
    engine.stop()
