"""A black box's sending side: keeps what is not acknowledged and sends it again until it is.

It outlives its service: a service that is killed and started again gets everything from the acknowledged
sequence on, and recognises what it had.
"""

from __future__ import annotations

import threading
import time
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np

from core.earth import STANDARD_GRAVITY_MPS2
from schemas.packet import measurements_from_packet
from schemas.telemetry_pb2 import TelemetryPacket

WINDOW: Final = 8
"""Packets under way at once. With packets of a second it is less than the 10 s for which the service waits for a
missing one, so what the box still has is never stepped over."""

CAPACITY: Final = 600
"""Packets kept in memory: ten minutes without a service; then ``put`` waits."""

RESEND_AFTER_S: Final = 2.0
"""Silence after which what is under way is sent again; each time in vain doubles it, up to the next."""

MAX_RESEND_AFTER_S: Final = 5.0

GAP_RESEND_S: Final = 0.5
"""Where the service says that a packet is missing, what is under way goes again, no more often than this: several
acknowledgements tell of the same gap."""

RETRY_CODES: Final = frozenset({"unknown_vehicle"})
"""Refusals that are not for good: the vehicle may be registered yet."""

IMPACT_MPS2: Final = 15.0
"""Specific force beyond gravity that makes a packet urgent: above any braking, below any severe crash."""


@dataclass(frozen=True, slots=True)
class Outgoing:
    """An encoded packet; ``urgent`` if it holds what may be an impact."""

    sequence: int
    data: bytes
    urgent: bool


@dataclass(frozen=True, slots=True)
class Ack:
    """Everything of ``boot_id`` up to ``sequence`` is durable or refused for good; with ``gap`` the next is missing."""

    boot_id: str
    sequence: int
    refused: tuple[tuple[int, str], ...] = ()
    gap: bool = False


class LinkError(Exception):
    """What was given may not have gone out; the box tries again, unless trying again is ``final``ly of no use."""

    def __init__(self, message: str, *, final: bool = False) -> None:
        super().__init__(message)
        self.final = final


class LinkListener(Protocol):
    """What a link tells its box, from any thread."""

    def on_ack(self, ack: Ack) -> None:
        """The service said what is durable."""

    def on_connected(self) -> None:
        """The service is there, again or for the first time."""


class Link(Protocol):
    """How packets leave the box."""

    def open(self, listener: LinkListener) -> None:
        """Say whom to tell; connecting may wait for the first ``send``."""

    def send(self, packets: Sequence[Outgoing]) -> None:
        """Send packets in order; raises LinkError."""

    def close(self) -> None:
        """Let go of everything."""


@dataclass(frozen=True, slots=True)
class BoxFigures:
    """Packets, each counted once but for ``resent``, which counts transmissions beyond a packet's first.

    ``unacknowledged`` are those that the box still keeps: lost, if it ends now.
    """

    sent: int
    acknowledged: int
    resent: int
    refused: int
    unacknowledged: int


class BlackBox:
    """Sends one boot's packets in order over a link. Every method is safe from any thread."""

    def __init__(
        self,
        link: Link,
        boot_id: str,
        *,
        window: int = WINDOW,
        capacity: int = CAPACITY,
        resend_after_s: float = RESEND_AFTER_S,
    ) -> None:
        self._link = link
        self._boot_id = boot_id
        self._window = window
        self._capacity = max(capacity, window)
        self._resend_after_s = self._silence_s = resend_after_s
        self._changed = threading.Condition()
        self._kept: OrderedDict[int, Outgoing] = OrderedDict()  # not acknowledged, in order
        self._next = 0  # the first sequence that is to go out next; what is kept below it is under way
        self._floor = 0
        self._highest_sent = 0
        self._taken = self._sent = self._resent = 0
        self._codes: dict[int, str] = {}  # refused: sequence -> code
        self._progress_s = self._sent_s = self._gap_resend_s = time.monotonic()
        self._trouble: str | None = None
        self._given_up = False
        self._stopping = False
        self._thread = threading.Thread(target=self._run, name="blackbox", daemon=True)

    def start(self) -> None:
        """Begin to send."""
        self._link.open(self)
        self._thread.start()

    def put(self, packet: TelemetryPacket, timeout_s: float | None = None) -> bool:
        """Take the next packet, waiting for room; False if there was none in time, or sending is of no use."""
        outgoing = Outgoing(packet.sequence, packet.SerializeToString(), holds_impact(packet))
        with self._changed:
            if not self._changed.wait_for(lambda: self._given_up or len(self._kept) < self._capacity, timeout_s):
                return False
            if self._given_up:
                return False
            self._taken += 1
            if outgoing.sequence > self._floor:  # else the service has it from an earlier run of this boot
                if not self._kept:
                    self._progress_s = time.monotonic()
                self._kept[outgoing.sequence] = outgoing
                self._changed.notify_all()
        return True

    def wait_acknowledged(self, timeout_s: float) -> bool:
        """Wait until nothing is kept; False after ``timeout_s``, or if sending is of no use."""
        with self._changed:
            self._changed.wait_for(lambda: self._given_up or not self._kept, timeout_s)
            return not self._kept

    def is_stuck(self, silence_s: float) -> bool:
        """Whether nothing of what is kept was acknowledged for so long, or sending is of no use."""
        with self._changed:
            return self._given_up or (bool(self._kept) and time.monotonic() - self._progress_s >= silence_s)

    def stop(self) -> None:
        """End; what is kept is gone with the box."""
        with self._changed:
            self._stopping = True
            self._changed.notify_all()
        self._thread.join()
        self._link.close()

    @property
    def figures(self) -> BoxFigures:
        """How it stands."""
        with self._changed:
            refused = sum(sequence <= self._floor for sequence in self._codes)
            kept = len(self._kept)
            return BoxFigures(self._sent, self._taken - kept - refused, self._resent, refused, kept)

    @property
    def refusals(self) -> dict[int, str]:
        """Sequences that the service refused, with its reasons."""
        with self._changed:
            return dict(self._codes)

    @property
    def trouble(self) -> str | None:
        """Why nothing goes out, if so."""
        return self._trouble

    # --- the link's side --------------------------------------------------------------------------

    def on_ack(self, ack: Ack) -> None:
        """Forget what is acknowledged; go back to what is missing."""
        now_s = time.monotonic()
        with self._changed:
            if ack.boot_id != self._boot_id:
                if not ack.boot_id and ack.refused:
                    self._trouble = f"the service refuses packets: {ack.refused[0][1]}"
                return
            for number, code in ack.refused:
                if number in self._kept and code not in RETRY_CODES:
                    self._codes[number] = code
            if ack.sequence > self._floor:
                self._floor = ack.sequence
                for sequence in [kept for kept in self._kept if kept <= ack.sequence]:
                    del self._kept[sequence]
                self._progress_s = now_s
                self._silence_s = self._resend_after_s
                self._trouble = None
            elif ack.refused:
                self._trouble = f"the service refuses packets: {ack.refused[0][1]}"
            if ack.gap and self._floor == ack.sequence and now_s - self._gap_resend_s > GAP_RESEND_S:
                self._gap_resend_s = now_s
                self._next = 0
            self._changed.notify_all()

    def on_connected(self) -> None:
        """What was under way may be lost: send it again."""
        with self._changed:
            self._next = 0
            self._trouble = None
            self._changed.notify_all()

    # --- the sending thread -----------------------------------------------------------------------

    def _run(self) -> None:
        while (batch := self._next_batch()) is not None:
            failure: LinkError | None = None
            try:
                self._link.send(batch)
            except LinkError as error:
                failure = error
            with self._changed:
                self._sent_s = time.monotonic()
                if failure is None:
                    again = sum(packet.sequence <= self._highest_sent for packet in batch)
                    self._resent += again
                    self._sent += len(batch) - again
                    self._highest_sent = max(self._highest_sent, batch[-1].sequence)
                else:
                    # The batch counts as under way, so the silence that follows brings it again; or the
                    # link does, when it says that it is connected.
                    self._trouble = str(failure)
                    self._given_up = failure.final
                    self._changed.notify_all()

    def _next_batch(self) -> list[Outgoing] | None:
        """Wait for what is to go out now; None to end."""
        with self._changed:
            while not (self._stopping or self._given_up):
                in_window = list(self._kept.values())[: self._window]
                batch = [packet for packet in in_window if packet.sequence >= self._next]
                if batch:
                    self._next = batch[-1].sequence + 1
                    return batch
                if not in_window:
                    self._changed.wait()
                    continue
                due_s = max(self._sent_s, self._progress_s) + self._silence_s
                if time.monotonic() >= due_s:
                    self._next = 0
                    self._silence_s = min(2 * self._silence_s, max(MAX_RESEND_AFTER_S, self._resend_after_s))
                else:
                    self._changed.wait(due_s - time.monotonic())
            return None


def holds_impact(packet: TelemetryPacket) -> bool:
    """Whether a packet's samples hold what may be an impact."""
    f_s = measurements_from_packet(packet).f_s
    return bool(len(f_s)) and float(np.linalg.norm(f_s, axis=1).max()) > STANDARD_GRAVITY_MPS2 + IMPACT_MPS2
