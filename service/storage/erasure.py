"""Erasure of what is stored of a vehicle, all of it or of a time: nothing of it is left in any table."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Final

from sqlalchemy import (
    Column,
    ColumnElement,
    Connection,
    Engine,
    Table,
    and_,
    delete,
    exists,
    func,
    insert,
    not_,
    or_,
    select,
    update,
)

from service.ingest.sequencing import Sequencer
from service.local_days import DEFAULT_ZONE
from service.storage import records
from service.storage.database import read, write
from service.storage.manoeuvres import forget_cause
from service.storage.retention import CHUNK
from service.storage.tables import (
    accident_candidates,
    accidents,
    calibrations,
    checkpoints,
    deliveries,
    delivery_attempts,
    erasure_requests,
    events,
    evidence,
    journal,
    manoeuvres,
    older_checkpoints,
    reviews,
    track_points,
    trip_records,
    trips,
    vehicles,
)
from service.storage.vehicles import VehicleRef

EVER_NS: Final = (0, 2**63 - 1)
PACKET_NS: Final = 60_000_000_000
"""The longest packet: one that begins so long before a time may reach into it."""
HELD_NS: Final = 300_000_000_000
"""How far back a session still knows where it was: the last minute of samples, with room."""


@dataclass(frozen=True, slots=True)
class ErasureRow:
    """What was asked for and removed; the columns of ``erasure_requests``."""

    id: str
    tenant_id: str
    vehicle_id: str
    from_ns: int | None
    to_ns: int | None
    unregister: bool
    reason: str
    actor: str | None
    created_ns: int
    removed: Mapping[str, int]


@dataclass(frozen=True, slots=True)
class Span:
    """From one instant up to another; ``is_all`` where nothing of the vehicle is to be left."""

    from_ns: int
    to_ns: int
    is_all: bool

    @classmethod
    def asked(cls, from_ns: int | None, to_ns: int | None) -> Span:
        """What is meant by two times that may be left out."""
        is_all = from_ns is None and to_ns is None
        return cls(EVER_NS[0] if from_ns is None else from_ns, EVER_NS[1] if to_ns is None else to_ns, is_all)

    def of(self, column: Column[int]) -> ColumnElement[bool]:
        """Whether a time lies in it."""
        return and_(column >= self.from_ns, column < self.to_ns)


def whole_trips(connection: Connection, vehicle_pk: int, span: Span) -> Span:
    """The span with all of those trips that lie partly in it."""
    touched = and_(trips.c.vehicle_pk == vehicle_pk, trips.c.start_ns < span.to_ns, trips.c.end_ns >= span.from_ns)
    first, last = connection.execute(select(func.min(trips.c.start_ns), func.max(trips.c.end_ns)).where(touched)).one()
    if first is None:
        return span
    return replace(span, from_ns=min(span.from_ns, first), to_ns=max(span.to_ns, last + 1))


def remove_bulk(engine: Engine, vehicle_pk: int, span: Span) -> dict[str, int]:
    """Remove packets and track in small transactions, so that others' packets never wait long; how many of each.

    The vehicle must be set aside by the engine.
    """
    removed: dict[str, int] = {}
    for table, key, chosen in (
        (journal, journal.c.id, _packets(vehicle_pk, span)),
        (track_points, track_points.c.t_ns, _of(track_points, vehicle_pk, span.of(track_points.c.t_ns))),
    ):
        count = CHUNK
        removed[table.name] = 0
        while count == CHUNK:
            with write(engine) as connection:
                some = select(key).where(chosen).order_by(key).limit(CHUNK)
                count = connection.execute(delete(table).where(chosen, key.in_(some))).rowcount
            removed[table.name] += count
    return removed


def remove(connection: Connection, ref: VehicleRef, span: Span, anew: Callable[[], bytes]) -> dict[str, int]:
    """Remove everything of a vehicle's span in the caller's transaction; how many rows of each table.

    ``anew`` makes the snapshot of a session that knows nothing, with which the vehicle goes on where its own knows of
    the span. The engine must have set the vehicle aside.
    """
    pk = ref.pk
    removed: dict[str, int] = {}

    def gone(table: Table, *chosen: ColumnElement[bool]) -> None:
        removed[table.name] = removed.get(table.name, 0) + connection.execute(delete(table).where(*chosen)).rowcount

    def mine(table: Table, column: Column[int]) -> ColumnElement[bool]:
        return _of(table, pk, span.of(column))

    forgets = _forgets(connection, pk, span)
    _sum_children(connection, pk, span, removed)
    removed[trip_records.name] = records.remove(
        connection, pk, span.of(trip_records.c.start_ns), zone=ref.config.time_zone or DEFAULT_ZONE
    )
    gone(reviews, reviews.c.vehicle_pk == pk, _reviewed_in(pk, span))
    gone(events, mine(events, events.c.t_ns))
    gone(evidence, mine(evidence, evidence.c.t_ns))
    forget_cause(connection, select(accidents.c.id).where(mine(accidents, accidents.c.t_ns)))
    gone(accidents, mine(accidents, accidents.c.t_ns))
    gone(accident_candidates, mine(accident_candidates, accident_candidates.c.t_ns))
    gone(manoeuvres, mine(manoeuvres, manoeuvres.c.start_ns))
    gone(trips, mine(trips, trips.c.start_ns))
    gone(track_points, mine(track_points, track_points.c.t_ns))
    gone(journal, _packets(pk, span))
    gone(calibrations, mine(calibrations, calibrations.c.valid_from_ns), calibrations.c.base.is_not(None))
    # Whatever was saved after the span began may still know of it.
    gone(older_checkpoints, older_checkpoints.c.vehicle_pk == pk, older_checkpoints.c.t_ns >= span.from_ns)
    if forgets:
        begun = update(checkpoints).where(checkpoints.c.vehicle_pk == pk).values(session=anew(), t_ns=None)
        removed["sessions"] = connection.execute(begun).rowcount
    _give_up_held(connection, pk)
    if span.is_all:
        connection.execute(update(vehicles).where(vehicles.c.pk == pk).values(last_seen_ns=None))
    return {name: count for name, count in removed.items() if count}


def add(connection: Connection, row: ErasureRow) -> None:
    """Keep a request with what it removed."""
    values = {name: getattr(row, name) for name in ErasureRow.__slots__} | {"removed": dict(row.removed)}
    connection.execute(insert(erasure_requests).values(values))


def find(connection: Connection, tenant_id: str, request_id: str) -> ErasureRow | None:
    """The tenant's request."""
    mine = and_(erasure_requests.c.tenant_id == tenant_id, erasure_requests.c.id == request_id)
    row = connection.execute(select(erasure_requests).where(mine)).one_or_none()
    return None if row is None else ErasureRow(**row._mapping)


def span_of(engine: Engine, vehicle_pk: int, span: Span) -> Span:
    """``whole_trips`` as of now."""
    with read(engine) as connection:
        return whole_trips(connection, vehicle_pk, span)


def _of(table: Table, vehicle_pk: int, chosen: ColumnElement[bool]) -> ColumnElement[bool]:
    return and_(table.c.vehicle_pk == vehicle_pk, chosen)


def _packets(vehicle_pk: int, span: Span) -> ColumnElement[bool]:
    """Packets that may hold samples of the span; where all goes, those without a time as well."""
    if span.is_all:
        return journal.c.vehicle_pk == vehicle_pk
    begun = and_(journal.c.start_t_ns > span.from_ns - PACKET_NS, journal.c.start_t_ns < span.to_ns)
    return and_(journal.c.vehicle_pk == vehicle_pk, begun)


def _reviewed_in(vehicle_pk: int, span: Span) -> ColumnElement[bool]:
    subjects = [
        exists().where(table.c.id == reviews.c.subject_id, table.c.vehicle_pk == vehicle_pk, span.of(column))
        for table, column in (
            (accidents, accidents.c.t_ns),
            (accident_candidates, accident_candidates.c.t_ns),
            (manoeuvres, manoeuvres.c.start_ns),
        )
    ]
    return reviews.c.vehicle_pk == vehicle_pk if span.is_all else or_(*subjects)


def _sum_children(connection: Connection, vehicle_pk: int, span: Span, removed: dict[str, int]) -> None:
    """Remove what would go with its event anyway, so that it is counted."""
    ids = select(events.c.id).where(_of(events, vehicle_pk, span.of(events.c.t_ns)))
    sent = select(deliveries.c.id).where(deliveries.c.event_id.in_(ids))
    for table, chosen in (
        (delivery_attempts, delivery_attempts.c.delivery_id.in_(sent)),
        (deliveries, deliveries.c.event_id.in_(ids)),
    ):
        removed[table.name] = connection.execute(delete(table).where(chosen)).rowcount


def _forgets(connection: Connection, vehicle_pk: int, span: Span) -> bool:
    """Whether the vehicle's session knows of the span: it ends in it or shortly after it, or its trip began in it."""
    if span.is_all:
        return True
    saved = select(checkpoints.c.t_ns).where(checkpoints.c.vehicle_pk == vehicle_pk)
    t_ns: int | None = connection.execute(saved).scalar_one_or_none()
    open_trip = select(trips.c.id).where(_of(trips, vehicle_pk, span.of(trips.c.start_ns)), not_(trips.c.ended))
    return t_ns is None or t_ns - HELD_NS < span.to_ns or connection.execute(open_trip.limit(1)).first() is not None


def _give_up_held(connection: Connection, vehicle_pk: int) -> None:
    """Let the sequencer wait for no packet whose row is gone."""
    saved = select(checkpoints.c.sequencer).where(checkpoints.c.vehicle_pk == vehicle_pk)
    state = connection.execute(saved).scalar_one_or_none()
    if state is None:
        return
    sequencer = Sequencer.from_json(state)
    held = sequencer.pending_ids()
    left = set(connection.scalars(select(journal.c.id).where(journal.c.id.in_(held)))) if held else set()
    if len(left) < len(held):
        sequencer.give_up_held()
        connection.execute(
            update(checkpoints).where(checkpoints.c.vehicle_pk == vehicle_pk).values(sequencer=sequencer.to_json())
        )
