"""What waits for one shard: packets at hand, and vehicles that are to be read on from the journal."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass

from service.engine.checkpoints import Lag
from service.ingest.journal_rows import JournalEntry


@dataclass(frozen=True, slots=True)
class Work:
    """A vehicle's next packets; with ``lag`` they are still to be read from the journal."""

    vehicle_pk: int
    entries: tuple[JournalEntry, ...]
    lag: Lag | None = None


class Inbox:
    """Packets of the vehicles of one shard, a queue a vehicle. Every method is safe from any thread.

    The packets are in the journal already, so memory is bounded simply: once ``capacity`` packets are
    held, only their number is remembered, and their vehicles are read on from the journal when it is
    their turn. Recovery and a vehicle that comes back after a failure are the same case.
    """

    def __init__(self, capacity: int) -> None:
        self._capacity = capacity
        self._changed = threading.Condition()
        self._queues: dict[int, deque[JournalEntry]] = {}
        self._behind: dict[int, Lag] = {}
        self._closed: set[int] = set()
        self._held = 0
        self._lag_rows = 0
        self._in_flight = 0
        self._busy = False

    def put(self, entries: Iterable[JournalEntry]) -> None:
        """Add packets in journal order; never blocks for longer than another call here."""
        with self._changed:
            for entry in entries:
                pk = entry.vehicle_pk
                if pk in self._closed:
                    continue
                lag = self._behind.get(pk)
                if lag is not None or self._held >= self._capacity:
                    self._set_lag(Lag(pk, entry.journal_id, 1 if lag is None else lag.rows + 1))
                else:
                    self._queues.setdefault(pk, deque()).append(entry)
                    self._held += 1
            self._changed.notify_all()

    def mark_behind(self, lag: Lag) -> None:
        """Have a vehicle read on from the journal, up to ``lag.newest_id`` at least."""
        with self._changed:
            self._set_lag(lag)
            self._changed.notify_all()

    def close(self, vehicle_pk: int) -> None:
        """Forget what waits for a vehicle, and take nothing for it until ``reopen``."""
        with self._changed:
            self._closed.add(vehicle_pk)
            self._drop_lag(vehicle_pk)
            self._held -= len(self._queues.pop(vehicle_pk, ()))

    def reopen(self, vehicle_pk: int) -> None:
        """Take packets for a vehicle again, after those that the journal has of it by now."""
        with self._changed:
            self._closed.discard(vehicle_pk)
            self._set_lag(Lag(vehicle_pk, newest_id=0, rows=1))
            self._changed.notify_all()

    def wait(self, timeout_s: float) -> None:
        """Return once there is work, or something called ``wake``, or the time is over."""
        with self._changed:
            if not self._queues and not self._behind:
                self._changed.wait(timeout_s)

    def wake(self) -> None:
        """Let ``wait`` return."""
        with self._changed:
            self._changed.notify_all()

    def take(self, per_vehicle: int, in_all: int) -> list[Work]:
        """The next packets, each vehicle once: at most so many of a vehicle and about so many in all.

        Half of it goes to vehicles that are behind, if there are any, so that neither kind starves the other.
        """
        work: list[Work] = []
        with self._changed:
            budget = in_all
            for pk, lag in self._behind.items():
                if budget <= in_all // 2:
                    break
                if pk not in self._queues:  # else what is at hand comes first: it is older
                    work.append(Work(pk, (), lag))
                    budget -= per_vehicle
            for pk in list(self._queues):
                if budget <= 0:
                    break
                queue = self._queues.pop(pk)
                entries = tuple(queue.popleft() for _ in range(min(per_vehicle, len(queue))))
                if queue:
                    self._queues[pk] = queue  # behind the others
                work.append(Work(pk, entries))
                budget -= len(entries)
                self._held -= len(entries)
                self._in_flight += len(entries)
            self._busy = bool(work)
        return work

    def read_on(self, work: Work, rows: int, *, at_end: bool) -> None:
        """Say that ``rows`` were read for ``work``; a vehicle that has caught up is queued again from here on."""
        with self._changed:
            lag = self._behind.get(work.vehicle_pk)
            if lag is None or work.lag is None:
                return
            # What was put since the work was taken may have missed the read: then it is read again.
            if at_end and lag.newest_id == work.lag.newest_id:
                self._drop_lag(work.vehicle_pk)
            else:
                self._set_lag(Lag(work.vehicle_pk, lag.newest_id, max(1, lag.rows - rows)))

    def done(self) -> None:
        """Say that what was taken is finished."""
        with self._changed:
            self._in_flight = 0
            self._busy = False
            self._changed.notify_all()

    @property
    def backlog(self) -> int:
        """Packets that were put and are not finished; those in the journal are counted, not held."""
        with self._changed:
            return self._held + self._in_flight + self._lag_rows

    def wait_empty(self, timeout_s: float) -> bool:
        """Wait until nothing is left to do; False if it took longer."""
        with self._changed:
            return self._changed.wait_for(lambda: not (self._queues or self._behind or self._busy), timeout=timeout_s)

    def _set_lag(self, lag: Lag) -> None:
        self._drop_lag(lag.vehicle_pk)
        self._behind[lag.vehicle_pk] = lag
        self._lag_rows += lag.rows

    def _drop_lag(self, vehicle_pk: int) -> None:
        lag = self._behind.pop(vehicle_pk, None)
        self._lag_rows -= 0 if lag is None else lag.rows
