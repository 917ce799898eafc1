"""Whatever the order, duplicates and losses: each packet is released once, in order, and the same on a replay."""

from __future__ import annotations

import json

from hypothesis import given, settings
from hypothesis import strategies as st

from service.ingest.sequencing import Sequencer

SECOND_NS = 1_000_000_000
T0_NS = 1_700_000_000 * SECOND_NS

offers = st.lists(st.tuples(st.sampled_from(["a", "b", "c"]), st.integers(1, 40)), max_size=120)
markers = st.sets(st.integers(0, 120), max_size=4)


def play(
    sequence_of_offers: list[tuple[str, int]], flush_at: set[int], save_at: int | None = None
) -> dict[str, object]:
    """Offer packets as the journal does (only what is new gets a row), with markers in between."""
    sequencer = Sequencer(10 * SECOND_NS)
    rows: dict[int, tuple[str, int]] = {}
    released: list[tuple[str, int]] = []
    skipped: list[tuple[str, int, int]] = []
    for index, (boot_id, sequence) in enumerate(sequence_of_offers):
        if index == save_at:
            sequencer = Sequencer.from_json(json.loads(json.dumps(sequencer.to_json())))
        if sequencer.classify(boot_id, sequence) == "new":
            rows[index] = (boot_id, sequence)
            release = sequencer.offer(boot_id, sequence, T0_NS + sequence * SECOND_NS, index)
            released += [rows[journal_id] for journal_id in release.released]
            skipped += release.skipped
        held = sequencer.newest_held()
        if index in flush_at and held is not None:
            release = sequencer.offer(held[0], -held[1], held[2], -1)
            assert sequencer.newest_held() is None
            released += [rows[journal_id] for journal_id in release.released]
            skipped += release.skipped
    pending = [rows[journal_id] for journal_id in sequencer.pending_ids()]
    floors = {boot_id: sequencer.durable_sequence(boot_id) for boot_id in "abc"}
    return {"rows": list(rows.values()), "released": released, "skipped": skipped, "pending": pending, "floors": floors}


@given(offers, markers)
@settings(max_examples=300, deadline=None)
def test_each_packet_is_released_once_and_in_order(given_offers: list[tuple[str, int]], flush_at: set[int]) -> None:
    outcome = play(given_offers, flush_at)
    rows, released, pending = outcome["rows"], outcome["released"], outcome["pending"]
    assert isinstance(rows, list)
    assert isinstance(released, list)
    assert isinstance(pending, list)
    assert len(set(rows)) == len(rows)
    assert sorted(released + pending) == sorted(rows)
    boots = list(dict.fromkeys(boot_id for boot_id, _ in rows))  # by first appearance
    assert released == sorted(released, key=lambda row: (boots.index(row[0]), row[1]))


@given(offers, markers)
@settings(max_examples=200, deadline=None)
def test_the_floor_is_what_is_there_or_stepped_over(given_offers: list[tuple[str, int]], flush_at: set[int]) -> None:
    outcome = play(given_offers, flush_at)
    rows, skipped, floors = outcome["rows"], outcome["skipped"], outcome["floors"]
    assert isinstance(rows, list)
    assert isinstance(skipped, list)
    assert isinstance(floors, dict)
    for boot_id, floor in floors.items():
        stepped_over = {s for boot, first, last in skipped if boot == boot_id for s in range(first, last + 1)}
        there = {sequence for boot, sequence in rows if boot == boot_id}
        assert set(range(1, floor + 1)) <= stepped_over | there
        assert not stepped_over & there
        assert floor + 1 not in there


@given(offers, markers, st.integers(0, 120))
@settings(max_examples=200, deadline=None)
def test_a_replay_from_any_saved_state_decides_the_same(
    given_offers: list[tuple[str, int]], flush_at: set[int], save_at: int
) -> None:
    assert play(given_offers, flush_at, save_at) == play(given_offers, flush_at)


@given(st.permutations(list(range(1, 9))))
def test_any_order_within_the_wait_comes_out_in_sequence(order: list[int]) -> None:
    outcome = play([("a", sequence) for sequence in order], set())
    assert outcome["released"] == [("a", sequence) for sequence in range(1, 9)]
    assert outcome["skipped"] == []
