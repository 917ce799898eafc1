"""A vehicle's packets in order: gaps, duplicates, reboots, markers, and going on from a saved state."""

from __future__ import annotations

import json

import pytest

from service.ingest.sequencing import MAX_BOOTS, MAX_HELD, UNKNOWN_TIME, Release, Sequencer

SECOND_NS = 1_000_000_000
T0_NS = 1_700_000_000 * SECOND_NS


class Feed:
    """Offers packets of one second each and numbers the journal rows."""

    def __init__(self, sequencer: Sequencer | None = None) -> None:
        self.sequencer = sequencer or Sequencer(10 * SECOND_NS)
        self.rows: list[tuple[str, int]] = []

    def offer(self, sequence: int, boot_id: str = "a", t_ns: int | None = None) -> Release:
        self.rows.append((boot_id, sequence))
        start_t_ns = T0_NS + sequence * SECOND_NS if t_ns is None else t_ns
        return self.sequencer.offer(boot_id, sequence, start_t_ns, len(self.rows))

    def names(self, release: Release) -> list[tuple[str, int]]:
        return [self.rows[journal_id - 1] for journal_id in release.released]

    def sequences(self, *offered: int, boot_id: str = "a") -> list[int]:
        return [sequence for one in offered for _, sequence in self.names(self.offer(one, boot_id))]


def test_packets_in_order_are_released_at_once() -> None:
    feed = Feed()
    assert feed.sequences(1, 2, 3) == [1, 2, 3]
    assert feed.sequencer.durable_sequence("a") == 3
    assert feed.sequencer.pending_ids() == ()


def test_a_gap_is_waited_for_and_filled() -> None:
    feed = Feed()
    assert feed.sequences(1, 3, 4) == [1]
    assert feed.sequencer.durable_sequence("a") == 1
    assert feed.sequencer.pending_ids() == (2, 3)
    assert feed.sequences(2) == [2, 3, 4]
    assert feed.sequencer.durable_sequence("a") == 4


def test_a_gap_is_stepped_over_when_the_packets_own_time_is_up() -> None:
    feed = Feed()
    assert feed.sequences(1, *range(3, 14)) == [1]  # 13 starts 10 s after 3: not more than the wait
    release = feed.offer(14)
    assert feed.names(release) == [("a", sequence) for sequence in range(3, 15)]
    assert release.skipped == (("a", 2, 2),)
    assert feed.sequencer.classify("a", 2) == "late"
    assert feed.sequencer.classify("a", 3) == "duplicate"
    assert feed.sequences(2) == []  # what comes late changes nothing
    assert feed.sequences(15) == [15]


def test_the_first_packets_of_a_boot_can_be_missing() -> None:
    feed = Feed()
    assert feed.sequences(*range(5, 16)) == []
    assert feed.sequences(16) == list(range(5, 17))
    assert feed.sequencer.classify("a", 4) == "late"


def test_two_gaps_are_judged_one_by_one() -> None:
    feed = Feed()
    feed.sequences(1, 3, 10)
    release = feed.offer(14)  # 11 s after 3, but 4 s after 10
    assert feed.names(release) == [("a", 3)]
    assert release.skipped == (("a", 2, 2),)
    assert feed.sequencer.classify("a", 5) == "new"
    assert feed.sequences(4, 5, 6, 7, 8, 9) == [4, 5, 6, 7, 8, 9, 10]


def test_a_marker_lets_go_what_is_held() -> None:
    feed = Feed()
    feed.sequences(1, 4, 5)
    release = feed.offer(-5)
    assert feed.names(release) == [("a", 4), ("a", 5)]
    assert release.skipped == (("a", 2, 3),)
    assert feed.sequencer.newest_held() is None


def test_a_duplicate_changes_nothing() -> None:
    feed = Feed()
    feed.sequences(1, 3)
    before = feed.sequencer.to_json()
    assert feed.offer(1) == feed.offer(3) == Release()
    assert feed.sequencer.to_json() == before


def test_a_newer_boot_waits_for_the_older_ones_gap() -> None:
    feed = Feed()
    feed.sequences(1, 3, boot_id="a")
    assert feed.names(feed.offer(1, "b", T0_NS + 5 * SECOND_NS)) == []
    assert feed.sequencer.durable_sequence("b") == 1  # it is durable though its turn has not come
    assert feed.names(feed.offer(2, "a")) == [("a", 2), ("a", 3), ("b", 1)]
    assert feed.sequencer.classify("a", 4) == "late"  # the newer boot went on


def test_a_newer_boot_steps_over_the_older_ones_gap() -> None:
    feed = Feed()
    feed.sequences(1, 3, boot_id="a")
    release = feed.offer(1, "b", T0_NS + 60 * SECOND_NS)
    assert feed.names(release) == [("a", 3), ("b", 1)]
    assert release.skipped == (("a", 2, 2),)


def test_a_clock_set_back_at_a_reboot_holds_nothing_up() -> None:
    feed = Feed()
    feed.sequences(1, 3, boot_id="a")
    assert feed.names(feed.offer(1, "b", T0_NS - 86_400 * SECOND_NS)) == [("a", 3), ("b", 1)]


def test_a_refused_packet_keeps_its_place_and_says_nothing_about_time() -> None:
    feed = Feed()
    feed.sequences(1, 3)
    assert feed.names(feed.offer(4, t_ns=UNKNOWN_TIME)) == []
    assert feed.sequences(2) == [2, 3, 4]


def test_what_is_held_is_bounded() -> None:
    feed = Feed()
    held = [feed.offer(sequence, t_ns=T0_NS) for sequence in range(2, MAX_HELD + 1)]
    assert not any(release.released for release in held)
    assert len(feed.offer(MAX_HELD + 1, t_ns=T0_NS).released) == MAX_HELD


def test_boots_are_forgotten_oldest_first() -> None:
    feed = Feed()
    for boot in range(MAX_BOOTS + 5):
        assert feed.names(feed.offer(1, f"boot-{boot}", T0_NS + boot * SECOND_NS)) == [(f"boot-{boot}", 1)]
    assert not feed.sequencer.knows_boot("boot-4")
    assert feed.sequencer.classify("boot-5", 1) == "duplicate"
    assert len(feed.sequencer.to_json()["boots"]) == MAX_BOOTS


@pytest.mark.parametrize("cut", range(8))
def test_a_saved_state_goes_on_the_same(cut: int) -> None:
    offers = [("a", 1), ("a", 3), ("a", 4), ("b", 1), ("b", 3), ("a", 2), ("b", 9), ("b", 25)]
    whole, first = Feed(), Feed()
    expected = [whole.offer(sequence, boot) for boot, sequence in offers]
    got = [first.offer(sequence, boot) for boot, sequence in offers[:cut]]
    second = Feed(Sequencer.from_json(json.loads(json.dumps(first.sequencer.to_json()))))
    second.rows = first.rows
    got += [second.offer(sequence, boot) for boot, sequence in offers[cut:]]
    assert got == expected
    assert second.sequencer.to_json() == whole.sequencer.to_json()
