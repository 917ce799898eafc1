"""One vehicle in the engine: its journal rows, put in order and folded through its session into effects."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Sequence
from typing import Protocol

from core.errors import SnapshotError
from core.measurements import Measurements
from core.session import Outputs
from schemas.packet import decode, measurements_from_packet
from schemas.vehicles import VehicleConfig
from service.engine.checkpoints import Checkpoint
from service.ingest.journal_rows import JournalEntry
from service.ingest.sequencing import Sequencer
from service.storage.calibrations import GivenCalibration
from service.storage.vehicles import VehicleRef

logger = logging.getLogger(__name__)


class Fold(Protocol):
    """What the engine needs of a session; ``core.session.Session`` is the one."""

    def step(self, measurements: Measurements) -> Outputs:
        """Take the next measurements."""
        ...

    def snapshot(self) -> bytes:
        """The whole state as bytes."""
        ...


class Taker(Protocol):
    """What takes over outputs; ``service.engine.effects.Effects`` is the one that stores them."""

    def add(self, outputs: Outputs, packet: JournalEntry) -> None:
        """Take over what the session made of a packet."""
        ...


SessionFactory = Callable[[VehicleConfig, Sequence[GivenCalibration], bytes | None], Fold]
"""A session with a vehicle's settings and calibrations: new, or going on from a snapshot (raises SnapshotError)."""

Load = Callable[[Sequence[int]], Iterable[JournalEntry]]
"""Journal rows by their ids."""


class Vehicle:
    """A vehicle's session with the sequencer that orders its input.

    ``journal_id`` is the newest row offered to the sequencer. Rows are offered in journal order and
    each once, so the same journal gives the same session, whoever reads it and when. Packets that the
    sequencer holds back are not kept here; they are loaded when it lets them go. A calibration that was put while
    packets came in is known to the session from that place in the journal on, also when they are folded again.
    """

    def __init__(
        self, ref: VehicleRef, saved: Checkpoint | None, factory: SessionFactory, gap_wait_ns: int, now_ns: int
    ) -> None:
        self.ref = ref
        self.active_ns = now_ns
        self._factory = factory
        self.journal_id = 0 if saved is None else saved.journal_id
        self._calibrations, self._coming = _known_at(self.journal_id, ref)
        if saved is None:
            self._sequencer = Sequencer(gap_wait_ns)
            self._session = factory(ref.config, self._calibrations, None)
        else:
            self._sequencer = Sequencer.from_json(saved.sequencer, gap_wait_ns)
            self._session = self._restored(saved.session)
        self._must_save = False
        self._saved_id = self.journal_id
        self._saved_ns = now_ns
        self._packet_ns: int | None = None
        self._sample_ns = None if saved is None else saved.t_ns
        self._saved_packet_ns = 0

    def fold(self, entries: Iterable[JournalEntry], load: Load, effects: Taker) -> None:
        """Offer journal rows and step the session with what comes out, adding to ``effects``.

        An exception leaves the session unusable; ``effects`` then holds what came before it.
        """
        at_hand: dict[int, JournalEntry] = {}
        for entry in entries:
            if entry.journal_id <= self.journal_id:
                continue
            if self._coming and entry.journal_id > self._coming:
                self._calibrations, self._coming = _known_at(entry.journal_id - 1, self.ref)
                self._session = self._restored(self._session.snapshot())
            at_hand[entry.journal_id] = entry
            release = self._sequencer.offer(entry.boot_id, entry.sequence, entry.start_t_ns, entry.journal_id)
            missing = [journal_id for journal_id in release.released if journal_id not in at_hand]
            if missing:
                at_hand.update((held.journal_id, held) for held in load(missing))
            for journal_id in release.released:
                self._step(at_hand.pop(journal_id), effects)
            self.journal_id = entry.journal_id

    def _step(self, packet: JournalEntry, effects: Taker) -> None:
        if packet.payload:  # none where a refused packet only keeps its place in the sequence
            measurements = measurements_from_packet(decode(packet.payload))
            effects.add(self._session.step(measurements), packet)
            self._sample_ns = int(measurements.imu_t_ns[-1]) if len(measurements.imu_t_ns) else packet.start_t_ns
            if self._packet_ns is None:
                self._saved_packet_ns = packet.start_t_ns
            self._packet_ns = packet.start_t_ns

    @property
    def is_saved(self) -> bool:
        """Whether the newest checkpoint is of the present state."""
        return self.journal_id == self._saved_id and not self._must_save

    def is_due(self, interval_ns: int, now_ns: int) -> bool:
        """Whether a checkpoint is due, by the packets' time or by the clock."""
        in_packets_ns = 0 if self._packet_ns is None else abs(self._packet_ns - self._saved_packet_ns)
        is_time = in_packets_ns >= interval_ns or now_ns - self._saved_ns >= interval_ns
        return self._must_save or (is_time and not self.is_saved)

    def checkpoint(self) -> Checkpoint:
        """The state as of now."""
        return Checkpoint(self.journal_id, self._sequencer.to_json(), self._session.snapshot(), self._sample_ns)

    def mark_saved(self, checkpoint: Checkpoint, now_ns: int) -> None:
        """Note that a checkpoint is stored."""
        self._must_save = self._must_save and checkpoint.journal_id != self.journal_id
        self._saved_id = checkpoint.journal_id
        self._saved_ns = now_ns
        if self._packet_ns is not None:
            self._saved_packet_ns = self._packet_ns

    def reconfigure(self, ref: VehicleRef) -> None:
        """Go on in the same state with changed settings; a checkpoint is due, so that no replay uses them too early."""
        before, self.ref = self.ref, ref
        known, self._coming = _known_at(self.journal_id, ref)
        if ref.config != before.config or known != self._calibrations:
            self._calibrations = known
            self._session = self._restored(self._session.snapshot())
            self._must_save = True

    def _restored(self, snapshot: bytes) -> Fold:
        """A session going on from a snapshot; one begun anew where this version cannot read it."""
        ref = self.ref
        try:
            return self._factory(ref.config, self._calibrations, snapshot)
        except SnapshotError as error:
            logger.warning(
                "vehicle %s of tenant %s begins anew, as after a long gap: its saved session cannot be used: %s",
                ref.vehicle_id,
                ref.tenant_id,
                error,
            )
            return self._factory(ref.config, self._calibrations, None)


def _known_at(journal_id: int, ref: VehicleRef) -> tuple[tuple[GivenCalibration, ...], int]:
    """The calibrations that packets after a place in the journal are folded with, and the next such place, 0 for none.

    Those put before the first packet hold from it on.
    """
    known = tuple(one for one in ref.calibrations if one.journal_id <= journal_id)
    return known, min((one.journal_id for one in ref.calibrations if one.journal_id > journal_id), default=0)
