"""The order of one vehicle's packets: each once, in sequence, waiting for a gap no longer than agreed.

Pure and deterministic: decided by the packets' own times and by journaled markers, never by a clock, so the
same journal gives the same order in the service, after a restart and in an audit.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Final, Literal

GAP_WAIT_NS: Final = 10_000_000_000
"""How much of the packets' own time a gap is waited for: twice a sender's slowest resend, with room."""

MAX_HELD: Final = 256
"""Packets held behind gaps before the oldest gap is stepped over whatever their times: bounds memory where a
sender's times stand still. 10 s at 20 packets a second fit."""

MAX_BOOTS: Final = 16
"""Boots of a vehicle that are remembered, so that what they send again is known."""

MAX_SKIPPED_RANGES: Final = 64
"""Stepped-over ranges remembered a boot; an older missing packet that still comes counts as a duplicate."""

UNKNOWN_TIME: Final = 0
"""Start time of a packet that was refused: it takes its place in the sequence but says nothing about time."""

Kind = Literal["new", "duplicate", "late"]


@dataclass(frozen=True, slots=True)
class Release:
    """``released``: journal ids whose turn has come, in order; ``skipped``: (boot_id, first, last) stepped over."""

    released: tuple[int, ...] = ()
    skipped: tuple[tuple[str, int, int], ...] = ()


@dataclass(slots=True)
class _Boot:
    boot_id: str
    floor: int = 0  # everything up to it was offered or stepped over
    closed: bool = False  # a newer boot went on
    held: dict[int, tuple[int, int]] = field(default_factory=dict)  # sequence -> (start_t_ns, journal_id)
    skipped: list[tuple[int, int]] = field(default_factory=list)

    def knows(self, sequence: int) -> bool:
        return sequence <= self.floor or sequence in self.held

    def advance(self) -> None:
        while self.floor + 1 in self.held:
            self.floor += 1


class Sequencer:
    """Orders the packets of one vehicle.

    A boot's packets go by their sequence, boots by their first appearance. Behind a gap packets are held until
    one of them starts more than ``gap_wait_ns`` away from the first held one; then the gap is stepped over for
    good. When a newer boot goes on, the older ones are closed.
    """

    def __init__(self, gap_wait_ns: int = GAP_WAIT_NS) -> None:
        self._gap_wait_ns = gap_wait_ns
        self._boots: dict[str, _Boot] = {}  # oldest first

    def classify(self, boot_id: str, sequence: int) -> Kind:
        """Whether a packet is new, was there before, or comes after its place was stepped over."""
        boot = self._boots.get(boot_id)
        if boot is None:
            return "new"
        if not boot.knows(sequence):
            return "late" if boot.closed else "new"
        return "late" if any(first <= sequence <= last for first, last in boot.skipped) else "duplicate"

    def offer(self, boot_id: str, sequence: int, start_t_ns: int, journal_id: int) -> Release:
        """Take the next journal row. A negative sequence is a flush marker; what is not new changes nothing."""
        if sequence < 0:
            return self.flush(boot_id)
        if self.classify(boot_id, sequence) != "new":
            return Release()
        boot = self._boots.setdefault(boot_id, _Boot(boot_id))
        boot.held[sequence] = (start_t_ns, journal_id)
        boot.advance()
        return self._release(flush_through=None)

    def flush(self, boot_id: str) -> Release:
        """Step over every gap of this boot and of older ones: a marker in the journal says that nothing came."""
        return self._release(flush_through=boot_id)

    def give_up_held(self) -> None:
        """Let go of what is held behind gaps, as if it had been stepped over: its rows are no longer there."""
        for boot in self._boots.values():
            boot.floor = max([boot.floor, *boot.held])
            boot.held = {}

    def durable_sequence(self, boot_id: str) -> int:
        """Everything of this boot up to here was taken, or is refused for good; 0 if nothing."""
        boot = self._boots.get(boot_id)
        return boot.floor if boot else 0

    def has_gap(self, boot_id: str) -> bool:
        """Whether packets of this boot wait behind a missing one."""
        boot = self._boots.get(boot_id)
        return boot is not None and any(sequence > boot.floor for sequence in boot.held)

    def knows_boot(self, boot_id: str) -> bool:
        return boot_id in self._boots

    def pending_ids(self) -> tuple[int, ...]:
        """Journal ids held behind gaps, in the order in which they would be released."""
        return tuple(boot.held[sequence][1] for boot in self._boots.values() for sequence in sorted(boot.held))

    def newest_held(self) -> tuple[str, int, int] | None:
        """(boot_id, sequence, start_t_ns) of the last packet held; None if nothing is held."""
        for boot in reversed(self._boots.values()):
            if boot.held:
                sequence = max(boot.held)
                return boot.boot_id, sequence, boot.held[sequence][0]
        return None

    def to_json(self) -> dict[str, Any]:
        """The whole state as plain JSON values."""
        return {
            "gap_wait_ns": self._gap_wait_ns,
            "boots": [
                {
                    "boot_id": boot.boot_id,
                    "floor": boot.floor,
                    "closed": boot.closed,
                    "held": [[sequence, *boot.held[sequence]] for sequence in sorted(boot.held)],
                    "skipped": [list(span) for span in boot.skipped],
                }
                for boot in self._boots.values()
            ],
        }

    @classmethod
    def from_json(cls, state: Mapping[str, Any], gap_wait_ns: int | None = None) -> Sequencer:
        """Go on where ``to_json`` was taken, with another ``gap_wait_ns`` if one is given."""
        sequencer = cls(state["gap_wait_ns"] if gap_wait_ns is None else gap_wait_ns)
        for saved in state["boots"]:
            sequencer._boots[saved["boot_id"]] = _Boot(
                saved["boot_id"],
                saved["floor"],
                saved["closed"],
                {sequence: (start_t_ns, journal_id) for sequence, start_t_ns, journal_id in saved["held"]},
                [(first, last) for first, last in saved["skipped"]],
            )
        return sequencer

    def _release(self, flush_through: str | None) -> Release:
        released: list[int] = []
        skipped: list[tuple[str, int, int]] = []
        flushing = flush_through in self._boots
        boots = list(self._boots.values())
        for index, boot in enumerate(boots):
            while boot.held:
                first = min(boot.held)
                if first > boot.floor:
                    if not (flushing or self._overdue(boots[index:])):
                        return self._done(released, skipped)
                    skipped.append((boot.boot_id, boot.floor + 1, first - 1))
                    boot.skipped = [*boot.skipped, (boot.floor + 1, first - 1)][-MAX_SKIPPED_RANGES:]
                    boot.floor = first - 1
                    boot.advance()
                for older in boots[:index]:
                    older.closed = True
                while first in boot.held:
                    released.append(boot.held.pop(first)[1])
                    first += 1
            flushing = flushing and boot.boot_id != flush_through
        return self._done(released, skipped)

    def _overdue(self, boots: list[_Boot]) -> bool:
        """Whether what is held behind the first gap of ``boots[0]`` has waited long enough, in its own time."""
        times = list(_held_times(boots))
        if sum(len(boot.held) for boot in boots) >= MAX_HELD:
            return True
        return bool(times) and any(abs(t_ns - times[0]) > self._gap_wait_ns for t_ns in times)

    def _done(self, released: list[int], skipped: list[tuple[str, int, int]]) -> Release:
        closed = [boot.boot_id for boot in self._boots.values() if boot.closed]
        for boot_id in closed[: max(0, len(self._boots) - MAX_BOOTS)]:
            del self._boots[boot_id]
        return Release(tuple(released), tuple(skipped))


def _held_times(boots: list[_Boot]) -> Iterator[int]:
    for boot in boots:
        for sequence in sorted(boot.held):
            t_ns = boot.held[sequence][0]
            if t_ns != UNKNOWN_TIME:
                yield t_ns
