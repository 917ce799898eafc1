"""The engine over a real database, with a small fold in the session's place so that every input shows in the output."""

from __future__ import annotations

import json
import logging
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sqlalchemy import Engine as Database
from sqlalchemy import select, text

from core.accident.events import Candidate, Impact, NoAccident, Severity, Status
from core.accident.placing import Accident, Place, Suppressed
from core.driving.trips import Trip
from core.errors import SnapshotError
from core.measurements import Measurements
from core.navigation.track import TRACK, TRACK_COLUMNS, Mode, Track
from core.session import Outputs
from schemas.packet import encode_packet
from schemas.vehicles import VehicleConfig
from service.engine.shard import EngineConfig
from service.engine.worker import Engine
from service.ingest.journal_rows import JournalEntry, insert_rows
from service.observability import Metrics
from service.storage import schema
from service.storage.database import open_database, read, write
from service.storage.tables import (
    accident_candidates,
    accidents,
    checkpoints,
    deliveries,
    events,
    evidence,
    manoeuvres,
    older_checkpoints,
    track_points,
    trips,
    webhook_endpoints,
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


@pytest.fixture
def bench(database: Database) -> Bench:
    return Bench(database)


@pytest.fixture
def other(tmp_path: Path) -> Iterator[Bench]:
    """A second database, for what must come out the same."""
    database = open_database(f"sqlite:///{tmp_path / 'other.db'}")
    schema.upgrade(database)
    yield Bench(database)
    database.dispose()


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


def test_packets_become_track_trips_accidents_events_and_deliveries(bench: Bench) -> None:
    ref = bench.vehicle("car-1")
    with write(bench.database) as connection:
        connection.execute(
            webhook_endpoints.insert().values(
                id="e1", tenant_id="default", url="https://example.org/hook", description="", types=[], secrets=[],
                status="enabled", created_ns=0, updated_ns=0,
            )
        )  # fmt: skip
    run(bench, bench.journal(*drive(ref)))
    stored = bench.stored()
    assert [row[1] for row in stored["track_points"]] == [START_NS + n * SECOND_NS for n in range(1, 13)]
    assert len(stored["trips"]) == 1
    (accident,) = stored["accidents"]
    trip_id = stored["trips"][0][0]
    assert trip_id in accident
    with read(bench.database) as connection:
        assert connection.execute(select(deliveries.c.event_id)).scalars().all() == [row["id"] for _, row in bench.told]
    assert [(name, event["type"]) for name, event in bench.told] == [
        ("car-1", "accident.detected"),
        ("car-1", "trip.completed"),
    ]
    told = bench.told[0][1]
    assert told["specversion"] == "1.0"
    assert told["data"]["trip_id"] == trip_id
    assert told["data"]["mode"] == "coasting"
    assert told["data"]["speed_before_mps"] is None
    assert bench.states[0]["vehicle_id"] == "car-1"
    assert 'telefuse_session_rejections_total{aid="gnss_position",outcome="rejected_gate"} 12.0' in bench.exposition()


def test_a_packet_out_of_order_waits_its_turn_and_one_sent_twice_counts_once(bench: Bench, other: Bench) -> None:
    packets = drive(bench.vehicle("car-1"))
    run(bench, bench.journal(*packets))
    packets = drive(other.vehicle("car-1"))
    entries = other.journal(*[packets[n] for n in (0, 2, 4, 1, 3, 5, 7, 6, 8, 10, 9, 11)])
    for part in (entries[:2], entries[:5], entries[5:], entries):  # told again, as after a commit in doubt
        run(other, part)
    assert other.stored() == bench.stored()


@pytest.mark.parametrize("kept", [0, 3, 7, 8, 12])
@pytest.mark.parametrize("interval_s", [1.0, 5.0, 3600.0])
def test_a_killed_engine_repeats_work_and_no_effect(bench: Bench, other: Bench, kept: int, interval_s: float) -> None:
    run(bench, bench.journal(*drive(bench.vehicle("car-1"))))
    entries = other.journal(*drive(other.vehicle("car-1")))
    first = other.engine(checkpoint_interval_s=interval_s)
    first.start()
    first.submit(entries[:kept])
    assert first.drain(WAIT_S)  # then it is gone: no stop, no last checkpoint, the rest never delivered
    run(other, [], checkpoint_interval_s=interval_s)
    assert other.stored() == bench.stored()
    assert len({event["id"] for _, event in other.told}) == len(other.told) == 2


@pytest.mark.parametrize("kept", [7, 9, 12])
def test_an_accident_that_turns_out_worse_is_told_again_and_keeps_its_place(bench: Bench, kept: int) -> None:
    ref = bench.vehicle("car-1")
    packets = [(r, n, WORSE_MPS2 if n == 9 else value) for r, n, value in drive(ref)]
    entries = bench.journal(*packets)
    first = bench.engine(checkpoint_interval_s=3600.0)
    first.start()
    first.submit(entries[:kept])
    assert first.drain(WAIT_S)
    with write(bench.database) as connection:  # as if it had been killed before the accident's own checkpoint
        connection.execute(checkpoints.delete())
    run(bench, [])
    (accident,) = bench.stored()["accidents"]
    assert START_NS + (7 + 2) * SECOND_NS in accident, "decided by the later impact"
    assert [event["type"] for _, event in bench.told].count("accident.detected") == 1
    updates = [event for _, event in bench.told if event["type"] == "accident.updated"]
    assert [update["data"]["accident_id"] for update in updates] == [accident[0]]


def row_of(bench: Bench, table: Any, *names: str) -> list[tuple[Any, ...]]:
    with read(bench.database) as connection:
        return [tuple(row) for row in connection.execute(select(*(table.c[name] for name in names)))]


def test_an_accident_is_told_in_steps_and_taken_back_where_it_was_none(bench: Bench) -> None:
    ref = bench.vehicle("car-1")
    signs = {4: CRASH_MPS2, 6: WORSE_MPS2, 8: NOTHING_MPS2}
    run(bench, bench.journal(*[(ref, n, signs.get(n, 0.1)) for n in range(1, 11)]))
    told = [event for _, event in bench.told]
    assert [(one["type"], one["data"]["revision"], one["data"]["status"]) for one in told] == [
        ("accident.detected", 0, "suspected"),
        ("accident.updated", 1, "suspected"),
        ("accident.retracted", 2, "retracted"),
    ]
    assert len({one["id"] for one in told}) == 3
    assert len({one["data"]["accident_id"] for one in told}) == 1
    assert list(told[0]["data"]["delta_v_interval_mps"]) == [7.0, None], "nothing bounds it from above"
    (row,) = row_of(bench, accidents, "revision", "status", "t_ns", "received_ns")
    crashed_ns = START_NS + 4 * SECOND_NS
    assert row == (2, "retracted", crashed_ns, crashed_ns + SECOND_NS), "the time of the first alert stays"


def test_revisions_of_one_packet_are_all_told_in_order(bench: Bench, other: Bench) -> None:
    def at_once(bench: Bench) -> list[JournalEntry]:
        ref = bench.vehicle("car-1")
        return bench.journal(*[(ref, n, AT_ONCE_MPS2 if n == 4 else 0.1) for n in range(1, 9)])

    run(bench, at_once(bench))
    assert [event["data"]["revision"] for _, event in bench.told] == [0, 1, 2]
    with read(bench.database) as connection:
        stored = connection.scalars(select(events.c.type).order_by(events.c.cursor)).all()
    assert stored == ["accident.detected", "accident.updated", "accident.updated"]
    entries = at_once(other)
    for entry in entries:  # a packet a batch
        run(other, [entry])
    assert other.stored() == bench.stored()


@pytest.mark.parametrize("kept", [4, 6, 9])
def test_an_outdated_revision_that_is_computed_again_changes_nothing(bench: Bench, other: Bench, kept: int) -> None:
    signs = {3: CRASH_MPS2, 5: POTHOLE_MPS2, 6: WORSE_MPS2, 8: NOTHING_MPS2}

    def packets(bench: Bench) -> list[JournalEntry]:
        ref = bench.vehicle("car-1")
        return bench.journal(*[(ref, n, signs.get(n, 0.1)) for n in range(1, 11)])

    run(bench, packets(bench))
    first = other.engine(checkpoint_interval_s=3600.0)
    first.start()
    first.submit(packets(other)[:kept])
    assert first.drain(WAIT_S)
    with write(other.database) as connection:  # as if it had been killed before the accident's own checkpoint
        connection.execute(checkpoints.delete())
    run(other, [])
    assert other.stored() == bench.stored()
    assert len(other.told) == len(bench.told) == 3


def test_what_felt_like_an_accident_is_kept_with_its_reason_and_told_to_nobody(any_database: Database) -> None:
    bench = Bench(any_database)
    ref = bench.vehicle("car-1")
    entries = bench.journal(*[(ref, n, POTHOLE_MPS2 if n == 3 else 0.1) for n in range(1, 6)])
    run(bench, entries)
    run(bench, entries)
    (row,) = row_of(bench, accident_candidates, "vehicle_pk", "t_ns", "reason", "probability", "heading_deg", "detail")
    assert row[:5] == (ref.pk, START_NS + 3 * SECOND_NS, "pothole", 0.04, None)
    assert row[5] == {
        "delta_v_mps": 1.5, "vertical_mps": None, "peak_mps2": 31.0, "duration_s": 0.05, "speed_before_mps": 12.0,
        "paper_agrees": True,
    }  # fmt: skip
    assert bench.told == []


def test_evidence_is_asked_for_with_a_checkpoint_of_a_minute_before(any_database: Database) -> None:
    bench = Bench(any_database)
    ref = bench.vehicle("car-1")
    crashes = (50, 400)
    entries = bench.journal(*[(ref, n, CRASH_MPS2 if n in crashes else 0.1) for n in range(1, 420)])
    engine = bench.engine(checkpoint_interval_s=10.0, packets_per_vehicle=16)
    engine.start()
    engine.submit(entries)
    assert engine.drain(WAIT_S)
    engine.stop()
    asked = dict(row_of(bench, evidence, "t_ns", "anchor_journal_id"))
    early, late = (START_NS + n * SECOND_NS for n in crashes)
    assert asked[early] is None, "its session began less than a minute before"
    kept = dict(row_of(bench, older_checkpoints, "journal_id", "t_ns"))
    assert 60 * SECOND_NS < late - kept[asked[late]] < 300 * SECOND_NS
    assert len(kept) <= 3, "two, and one that is needed for open evidence"


def test_postgresql_holds_the_same_to_the_bit(bench: Bench, postgres_database: Database) -> None:
    run(bench, bench.journal(*drive(bench.vehicle("car-1"))))
    other = Bench(postgres_database)
    entries = other.journal(*drive(other.vehicle("car-1")))
    first = other.engine(checkpoint_interval_s=5.0)
    first.start()
    first.submit(entries[:8])
    assert first.drain(WAIT_S)
    run(other, [], checkpoint_interval_s=5.0)
    assert other.stored() == bench.stored()
    first.stop()


def test_recovery_comes_before_what_is_submitted_after_it(bench: Bench, other: Bench) -> None:
    run(bench, bench.journal(*drive(bench.vehicle("car-1"))))
    entries = other.journal(*drive(other.vehicle("car-1")))
    engine = other.engine()
    assert engine.recover() == 12
    engine.submit(entries[10:])
    engine.start()
    assert engine.drain(WAIT_S)
    engine.stop()
    assert other.stored() == bench.stored()


def test_many_vehicles_in_little_memory_give_the_same(bench: Bench, other: Bench) -> None:
    def fleet(bench: Bench) -> list[JournalEntry]:
        drives = [drive(bench.vehicle(f"car-{n}"), crash_at=n + 1) for n in range(8)]
        return bench.journal(*(packet for second in zip(*drives, strict=True) for packet in second))

    run(bench, fleet(bench))
    entries = fleet(other)
    engine = other.engine(max_sessions=2, max_held_packets=6, packets_per_vehicle=2, packets_per_commit=4)
    engine.start()
    for start in range(0, len(entries), 16):
        engine.submit(entries[start : start + 16])
    assert engine.drain(WAIT_S)
    engine.stop()
    assert other.stored() == bench.stored()


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
