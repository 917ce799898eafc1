"""Assesses trips beside the hot path, once they have ended or their vehicle has fallen silent, and when they change."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from sqlalchemy import Connection, Engine
from sqlalchemy.exc import SQLAlchemyError

from core.scoring.record import Record
from service.local_days import DEFAULT_ZONE
from service.observability import Metrics
from service.rating.announcing import announce
from service.rating.scoring import Reading
from service.resting import Rest, StoppedError
from service.roads.protocol import RoadMatcher
from service.storage import accidents, audit, manoeuvres, records, trips
from service.storage.accidents import AccidentRow
from service.storage.database import read, write
from service.storage.manoeuvres import Excuse
from service.storage.records import TripRecord
from service.storage.trips import TripRow
from service.storage.vehicles import VehicleDirectory, VehicleRef
from service.trips import hazards
from service.trips.assessing import AROUND_NS, GAP_NS, TripRows, assess_trip, model_sha256
from service.trips.excusing import with_events
from service.webhooks.outbox import NewEvent

logger = logging.getLogger(__name__)

Tell = Callable[[VehicleRef, NewEvent], None]
"""Hands on an event that was stored, after the commit. Must not block."""


def _tell_nobody(_ref: VehicleRef, _event: NewEvent) -> None:
    return


@dataclass(frozen=True, slots=True)
class TripPolicy:
    """When trips are assessed.

    ``silent_s``: a trip that has not ended and that nothing has touched for so long is assessed as it is, and again
    when more comes. ``rest_per_work``: the thread rests so many times as long as it worked, so that packets go first.
    ``roads_again_s``: so long after each attempt in vain a trip's roads are looked up again; then they stay unknown.
    """

    silent_s: float = 900.0
    poll_s: float = 2.0
    rest_per_work: float = 3.0
    at_once: int = 50
    roads_again_s: tuple[float, ...] = (60.0, 300.0, 1800.0, 7200.0)


@dataclass(frozen=True, slots=True)
class _Found:
    """What is to be stored of a trip; ``before`` is its record of until now, ``unmatched_s`` as of ``AssessedTrip``,
    None where the track is gone and no road is looked up any more."""

    row: TripRecord
    excused: dict[str, Excuse | None]
    before: Record | None
    accidents: Sequence[AccidentRow]
    unmatched_s: int | None


class TripWorker:
    """A thread that looks for trips to be assessed; what a crash broke off is found again at the next start.

    A trip is read in one transaction and stored in another, together with the mark that it is done. If it changed in
    between, nothing is stored and it is still due.
    """

    def __init__(
        self,
        database: Engine,
        directory: VehicleDirectory,
        matcher: RoadMatcher,
        metrics: Metrics,
        *,
        reading: Reading,
        policy: TripPolicy | None = None,
        tell: Tell = _tell_nobody,
    ) -> None:
        self._database = database
        self._directory = directory
        self._matcher = matcher
        self._metrics = metrics
        self._policy = TripPolicy() if policy is None else policy
        self._reading = reading
        self._tell = tell
        self._stopping = threading.Event()
        self._reconsidered: set[int] | None = None
        self._lock = threading.Lock()
        self._thread = threading.Thread(target=self._work, name="trips", daemon=True)
        directory.on_change(self._reconsider)

    def start(self) -> None:
        """Begin, with what was left over first."""
        self._thread.start()

    def stop(self) -> None:
        """Break off what is under way and end."""
        self._stopping.set()
        if self._thread.ident is not None:
            self._thread.join()

    @property
    def is_working(self) -> bool:
        """Whether the thread lives."""
        return self._thread.is_alive()

    def _work(self) -> None:
        while not self._stopping.is_set():
            more = False
            try:
                self.keep_days()
                more = self.turn(time.time_ns()) >= self._policy.at_once
            except StoppedError:
                return
            except SQLAlchemyError as error:
                logger.warning("trips wait: the database fails: %s", error)
            self._stopping.wait(0.0 if more else self._policy.poll_s)

    def turn(self, now_ns: int) -> int:
        """Look once for trips that wait; how many there were, as far as they are taken at once."""
        policy = self._policy
        with read(self._database) as connection:
            waiting = trips.due(connection, now_ns, round(policy.silent_s * 1e9), policy.at_once)
            self._metrics.trips_waiting.set(trips.waiting(connection)[0])
        rest = Rest(self._stopping, policy.rest_per_work)
        for trip in waiting:
            self._assess(trip, now_ns)
            rest()
        return len(waiting)

    def _assess(self, trip: TripRow, now_ns: int) -> None:
        ref = self._directory.by_pk(trip.vehicle_pk)
        if ref is None:
            return  # erased meanwhile
        try:
            self._take_in_accidents(trip, now_ns)
            found = self._found(trip, ref, now_ns)
        except (StoppedError, SQLAlchemyError):
            raise
        except Exception:
            logger.exception("trip %s cannot be assessed; it is tried again when something about it changes", trip.id)
            self._metrics.trips_assessed_total.labels(outcome="failed").inc()
            with write(self._database) as connection:
                trips.give_up(connection, trip)
            return
        if self._stopping.is_set():
            raise StoppedError  # roads that stop with the service answer that they know nothing
        with write(self._database) as connection:
            again_ns, failures = self._roads_again(trip, found.unmatched_s, now_ns)
            if not trips.mark_assessed(
                connection, trip, now_ns, found.row.model_sha256, again_ns=again_ns, road_failures=failures
            ):
                return
            records.put(connection, found.row, zone=ref.config.time_zone or DEFAULT_ZONE)
            manoeuvres.excuse(connection, found.excused)
            hazards.mark_due(connection, found.accidents, now_ns)
            changed = found.before != found.row.record
            if found.before is not None and changed:
                sums = {"before": _sums(found.before), "after": _sums(found.row.record)}
                audit.note(connection, ref.tenant_id, None, "trip.rescored", f"trip/{trip.id}", now_ns, sums)
            cause = "trip" if found.before is None else "rescored"
            event = (
                announce(connection, self._reading, ref, cause=cause, trip_id=trip.id, now_ns=now_ns)
                if changed
                else None
            )
        self._metrics.trips_assessed_total.labels(outcome="assessed").inc()
        if found.unmatched_s:
            self._tell_unmatched(trip, found.unmatched_s, again_ns, now_ns)
        if event is not None:
            self._tell(ref, event)

    def _roads_again(self, trip: TripRow, unmatched_s: int | None, now_ns: int) -> tuple[int | None, int | None]:
        """When to look up roads again, None for never, and how often in a row that was in vain."""
        if unmatched_s is None:
            return None, trip.road_failures
        if not unmatched_s:
            return None, None
        failures = (trip.road_failures or 0) + 1
        waits_s = self._policy.roads_again_s
        return (now_ns + round(1e9 * waits_s[failures - 1]) if failures <= len(waits_s) else None), failures

    def _tell_unmatched(self, trip: TripRow, unmatched_s: int, again_ns: int | None, now_ns: int) -> None:
        what = "trip %s: the roads of %d s could not be looked up"
        if again_ns is None:
            self._metrics.trips_unmatched_total.labels(outcome="given_up").inc()
            logger.error(f"{what} and stay unknown", trip.id, unmatched_s)
        else:
            self._metrics.trips_unmatched_total.labels(outcome="again").inc()
            logger.warning(f"{what}; again in %.0f s", trip.id, unmatched_s, (again_ns - now_ns) * 1e-9)

    def _take_in_accidents(self, trip: TripRow, now_ns: int) -> None:
        """Have accidents of its first seconds, before it was told, belong to the trip and to no earlier one."""
        span = trip.vehicle_pk, trip.id, trip.start_ns, trip.end_ns
        with read(self._database) as connection:
            if not accidents.strays(connection, *span):
                return
        with write(self._database) as connection:
            strays = accidents.strays(connection, *span)
            accidents.give_to_trip(connection, list(strays), trip.id)
            for owner in {one for one in strays.values() if one is not None}:
                trips.mark_trip_due(connection, owner, now_ns)

    def _found(self, trip: TripRow, ref: VehicleRef, now_ns: int) -> _Found:
        with read(self._database) as connection:
            before = records.find(connection, trip.id)
            rows = _rows(connection, trip, ref)
            basis = self._reading.risk(connection, ref.tenant_id)
            kept_from_ns = trips.oldest_position_ns(connection, ref.pk)
        excused_before = {one.id: one.excuse for one in rows.manoeuvres}
        unmatched_s = None
        is_gone = kept_from_ns is None or kept_from_ns > trip.start_ns + GAP_NS
        if before is not None and is_gone:  # what the track told stays as it is
            record, excused = with_events(before.record, rows.manoeuvres, rows.accidents, rows.hazards)
            timeline, sha256 = before.timeline, before.model_sha256
        else:
            assessed = assess_trip(rows, ref.config, self._matcher, basis.model)
            record, excused, unmatched_s = assessed.record, dict(assessed.excused), assessed.unmatched_s
            timeline, sha256 = assessed.timeline.packed(), model_sha256(basis)
        row = TripRecord(trip.id, ref.pk, trip.start_ns, record, timeline, sha256, now_ns)
        changed = {one: reason for one, reason in excused.items() if reason != excused_before[one]}
        return _Found(row, changed, None if before is None else before.record, rows.accidents, unmatched_s)

    def _reconsider(self, vehicle_pk: int) -> None:
        with self._lock:
            if self._reconsidered is not None:
                self._reconsidered.add(vehicle_pk)

    def keep_days(self) -> None:
        """Tell days apart anew of vehicles that were given another time zone."""
        with self._lock:
            asked, self._reconsidered = self._reconsidered, set()
        with read(self._database) as connection:
            known = (
                records.zones(connection)
                if asked is None
                else [one for pk in sorted(asked) for one in records.zones(connection, pk)]
            )
        for pk, zone in known:
            ref = self._directory.by_pk(pk)
            wanted = DEFAULT_ZONE if ref is None else ref.config.time_zone or DEFAULT_ZONE
            if ref is not None and wanted != zone:
                with write(self._database) as connection:
                    records.rebuild(connection, pk, zone=wanted)


def _rows(connection: Connection, trip: TripRow, ref: VehicleRef) -> TripRows:
    done = manoeuvres.between(connection, ref.pk, trip.start_ns, trip.end_ns)
    return TripRows(
        trip=trip,
        positions=trips.positions(connection, ref.pk, trip.start_ns - AROUND_NS, trip.end_ns + AROUND_NS),
        manoeuvres=done,
        hazards=hazards.explaining(connection, done),
        accidents=accidents.of_trip(connection, ref.tenant_id, trip.id),
    )


def _sums(record: Record) -> dict[str, Any]:
    """What of a record goes into the audit: nothing of where, when or who."""
    return {
        "distance_mm": record.exposure.total.distance_mm,
        "time_ms": record.exposure.total.time_ms,
        "speeding_over_ms": record.speeding.over_ms,
        "manoeuvres": dict(record.manoeuvres),
        "excused": dict(record.excused),
        "accidents": dict(record.accidents),
    }
