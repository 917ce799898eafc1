"""What the journal knows of each vehicle's sequence: kept in memory, rebuilt from disk when first needed."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterable
from typing import Final

from sqlalchemy import Engine, select

from service.ingest.journal_rows import JournalEntry, read_after
from service.ingest.sequencing import Kind, Release, Sequencer
from service.storage.database import read
from service.storage.tables import checkpoints, journal

MAX_TRACKED: Final = 50_000
"""Vehicles whose sequencer is kept in memory; the one longest unused goes first."""


class Tracking:
    """The sequencers of all vehicles, for duplicates and acknowledgements. Used by the journal's thread alone."""

    def __init__(self, engine: Engine, gap_wait_ns: int, monotonic_s: Callable[[], float]) -> None:
        self._engine = engine
        self._gap_wait_ns = gap_wait_ns
        self._monotonic_s = monotonic_s
        self._sequencers: OrderedDict[int, Sequencer] = OrderedDict()
        self._holding: dict[int, float] = {}  # vehicles with packets behind a gap -> when something new last came
        self._in_doubt: set[int] = set()  # vehicles with rows that a failed commit may have left behind

    @property
    def holding(self) -> bool:
        """Whether any vehicle has packets behind a gap."""
        return bool(self._holding)

    def sequencer(self, vehicle_pk: int) -> tuple[Sequencer, list[JournalEntry]]:
        """A vehicle's sequencer; with it, after a commit in doubt, the rows that must be handed on (again)."""
        known = self._sequencers.get(vehicle_pk)
        if known is not None:
            self._sequencers.move_to_end(vehicle_pk)
            return known, []
        sequencer, entries = self._rebuild(vehicle_pk)
        self._sequencers[vehicle_pk] = sequencer
        self._in_doubt.discard(vehicle_pk)
        self._note(vehicle_pk, sequencer)
        if len(self._sequencers) > MAX_TRACKED:
            idle = next((pk for pk in self._sequencers if pk not in self._holding), None)
            if idle is not None:
                del self._sequencers[idle]
        return sequencer, entries

    def classify(self, vehicle_pk: int, boot_id: str, sequence: int) -> Kind:
        """As ``Sequencer.classify``, but a boot that was forgotten long ago is still known by its rows."""
        sequencer = self._sequencers[vehicle_pk]
        if sequencer.knows_boot(boot_id):
            return sequencer.classify(boot_id, sequence)
        earlier = select(journal.c.id).where(journal.c.vehicle_pk == vehicle_pk, journal.c.boot_id == boot_id)
        with read(self._engine) as connection:
            return "new" if connection.scalar(earlier.limit(1)) is None else "late"

    def offer(self, vehicle_pk: int, boot_id: str, sequence: int, start_t_ns: int) -> Release:
        """Offer what is about to be written; ``forget`` the vehicle if the writing fails."""
        sequencer = self._sequencers[vehicle_pk]
        release = sequencer.offer(boot_id, sequence, start_t_ns, journal_id=0)
        self._note(vehicle_pk, sequencer)
        return release

    def standing(self, vehicle_pk: int, boot_id: str) -> tuple[int, bool]:
        """``Sequencer.durable_sequence`` and ``has_gap``."""
        sequencer = self._sequencers[vehicle_pk]
        return sequencer.durable_sequence(boot_id), sequencer.has_gap(boot_id)

    def idle_behind_gap(self, for_s: float) -> list[tuple[int, tuple[str, int, int]]]:
        """Vehicles from which nothing new came for so long while packets are held, with the last one held."""
        now_s = self._monotonic_s()
        idle = []
        for pk, newest_s in self._holding.items():
            held = self._sequencers[pk].newest_held()
            if held is not None and now_s - newest_s >= for_s:
                idle.append((pk, held))
        return idle

    def forget(self, vehicle_pks: Iterable[int]) -> None:
        """What was offered for these may not be on disk: rebuild them when next needed."""
        for pk in vehicle_pks:
            if self._sequencers.pop(pk, None) is not None:
                self._in_doubt.add(pk)
            self._holding.pop(pk, None)

    def _note(self, vehicle_pk: int, sequencer: Sequencer) -> None:
        if sequencer.newest_held() is None:
            self._holding.pop(vehicle_pk, None)
        else:
            self._holding[vehicle_pk] = self._monotonic_s()

    def _rebuild(self, vehicle_pk: int) -> tuple[Sequencer, list[JournalEntry]]:
        saved_columns = (checkpoints.c.journal_id, checkpoints.c.sequencer)
        with read(self._engine) as connection:
            saved = connection.execute(
                select(*saved_columns).where(checkpoints.c.vehicle_pk == vehicle_pk)
            ).one_or_none()
        if saved is None:
            after_id, sequencer = 0, Sequencer(self._gap_wait_ns)
        else:
            after_id, sequencer = saved.journal_id, Sequencer.from_json(saved.sequencer, self._gap_wait_ns)
        entries = []
        for entry in read_after(self._engine, vehicle_pk, after_id):
            sequencer.offer(entry.boot_id, entry.sequence, entry.start_t_ns, entry.journal_id)
            if vehicle_pk in self._in_doubt:
                entries.append(entry)
        return sequencer, entries
