"""What the service says over Zenoh: acknowledgements, states and events, put by one thread."""

from __future__ import annotations

import json
import logging
import threading
import time
from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import zenoh

log = logging.getLogger(__name__)

STATE_PERIOD_S: Final = 1.0
"""States of a vehicle are at least this far apart (interface, section 4); the newest one goes."""

MAX_EVENTS: Final = 10_000
"""Events that may wait; beyond, the oldest is dropped: webhooks and the feed are what guarantees them."""

MAX_REFUSALS: Final = 1_000
"""Refusals that one acknowledgement lists; its sequence counts for all of them."""

AckKey = tuple[str, str]
"""A vehicle's key prefix and a boot."""


@dataclass(slots=True)
class _Ack:
    sequence: int = 0
    gap: bool = False
    codes: dict[int, str] = field(default_factory=dict)

    def message(self) -> dict[str, Any]:
        refused = [{"sequence": number, "code": code} for number, code in sorted(self.codes.items())[:MAX_REFUSALS]]
        return {"sequence": self.sequence, "refused": refused, "gap": self.gap}


class Publisher:
    """Puts what is told to it. Every method is safe from any thread and returns at once.

    Acknowledgements of one boot that wait together become one, with the highest sequence. They may be dropped
    under congestion: a box that hears nothing sends again and is acknowledged again.
    """

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session
        self._changed = threading.Condition()
        self._acks: dict[AckKey, _Ack] = {}
        self._states: dict[str, Mapping[str, Any]] = {}
        self._state_put_s: dict[str, float] = {}
        self._events: deque[tuple[str, Mapping[str, Any]]] = deque(maxlen=MAX_EVENTS)
        self._stopping = False
        self._thread = threading.Thread(target=self._run, name="zenoh-publisher", daemon=True)
        self._thread.start()

    def ack(
        self, prefix: str, boot_id: str, sequence: int, refused: Iterable[tuple[int, str]] = (), gap: bool = False
    ) -> None:
        """Everything up to ``sequence`` is durable or refused for good; with ``gap`` the next one is missing."""
        with self._changed:
            ack = self._acks.setdefault((prefix, boot_id), _Ack())
            ack.codes.update(refused)
            if sequence >= ack.sequence:
                ack.sequence, ack.gap = sequence, gap
            self._changed.notify()

    def state(self, prefix: str, state: Mapping[str, Any]) -> None:
        """The vehicle's state now; put at most once a second."""
        with self._changed:
            self._states[prefix] = state
            self._changed.notify()

    def event(self, prefix: str, event: Mapping[str, Any]) -> None:
        """Something that happened to the vehicle, as a CloudEvent."""
        with self._changed:
            self._events.append((prefix, event))
            self._changed.notify()

    def stop(self) -> None:
        """Put what waits, but for states that are not due, and end the thread."""
        with self._changed:
            self._stopping = True
            self._changed.notify()
        self._thread.join()

    def _run(self) -> None:
        while True:
            with self._changed:
                while not (self._acks or self._events or self._stopping or self._due()):
                    self._changed.wait(self._until_due_s())
                acks, self._acks = self._acks, {}
                events = list(self._events)
                self._events.clear()
                states = {prefix: self._states.pop(prefix) for prefix in self._due()}
                stopping = self._stopping
            for (prefix, boot_id), ack in acks.items():
                self._put(f"{prefix}/ack", {"boot_id": boot_id, **ack.message()})
            for prefix, event in events:
                self._put(f"{prefix}/event", event, "application/cloudevents+json")
            for prefix, state in states.items():
                self._state_put_s[prefix] = time.monotonic()
                self._put(f"{prefix}/state", state)
            if stopping:
                return

    def _due(self) -> list[str]:
        """Vehicles whose waiting state may be put now."""
        latest_s = time.monotonic() - STATE_PERIOD_S
        return [prefix for prefix in self._states if self._state_put_s.get(prefix, latest_s) <= latest_s]

    def _until_due_s(self) -> float | None:
        if not self._states:
            return None
        oldest_s = min(self._state_put_s.get(prefix, 0.0) for prefix in self._states)
        return max(0.0, oldest_s + STATE_PERIOD_S - time.monotonic())

    def _put(self, key: str, message: Mapping[str, Any], encoding: str = "application/json") -> None:
        try:
            self._session.put(key, json.dumps(message), encoding=encoding)
        except zenoh.ZError as error:
            log.warning("%s could not be put: %s", key, error)
