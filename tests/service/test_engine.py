"""The engine over a real database: what packets become, in which order, and the same again after a kill."""

from __future__ import annotations

from typing import Any

import pytest
from sqlalchemy import Engine as Database
from sqlalchemy import select

from service.ingest.journal_rows import JournalEntry
from service.storage.database import read, write
from service.storage.tables import (
    accident_candidates,
    accidents,
    checkpoints,
    deliveries,
    events,
    evidence,
    older_checkpoints,
    webhook_endpoints,
)
from tests.service.engine_bench import (
    AT_ONCE_MPS2,
    CRASH_MPS2,
    NOTHING_MPS2,
    POTHOLE_MPS2,
    SECOND_NS,
    START_NS,
    WAIT_S,
    WORSE_MPS2,
    Bench,
    drive,
    run,
)


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
