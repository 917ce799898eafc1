"""What is kept for how long, and what is removed: in small transactions, so that packets never wait long."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Final

from sqlalchemy import Column, ColumnElement, Connection, Engine, and_, delete, exists, func, not_, select, true, update

from service.ingest.sequencing import Sequencer
from service.storage import evidence, idempotency
from service.storage.database import read, write
from service.storage.tables import (
    accident_candidates,
    checkpoints,
    deliveries,
    events,
    idempotency_keys,
    journal,
    manoeuvres,
    track_points,
)

CHUNK: Final = 2_000
"""Rows a transaction: some 20 ms of the disk's time, in which no packet becomes durable."""

FEW: Final = 20
"""The same of rows that hold files of megabytes."""

DAY_NS: Final = 24 * 3600 * 1_000_000_000


@dataclass(frozen=True, slots=True)
class Removed:
    """How many rows went."""

    packets: int
    track_points: int
    manoeuvre_places: int
    events: int
    candidates: int
    evidence: int
    idempotency_keys: int


def prune(
    engine: Engine,
    now_ns: int,
    *,
    journal_days: int,
    track_days: int,
    events_days: int,
    candidates_days: int = 0,
    evidence_days: int = 0,
) -> Removed:
    """Remove what is older than so many days; 0 keeps for ever.

    A packet stays while its vehicle's checkpoint does not stand beyond it or holds it back behind a gap, or evidence
    is to be built from it; an event stays while one of its webhooks is still to be sent, evidence while it is being
    built. Accidents, their reviews and trips stay, and of these their records, which know no places but H3 cells; a
    manoeuvre keeps its place as long as the track is kept.
    """
    with read(engine) as connection:
        pks = list(connection.scalars(select(checkpoints.c.vehicle_pk)))
    packets = points = places = 0
    for pk in pks:
        if journal_days:
            before_ns = now_ns - journal_days * DAY_NS
            packets += _in_chunks(engine, partial(_prune_journal, vehicle_pk=pk, before_ns=before_ns))
        if track_days:
            before_ns = now_ns - track_days * DAY_NS
            points += _in_chunks(engine, partial(_prune_track, vehicle_pk=pk, before_ns=before_ns))
            places += _in_chunks(engine, partial(_forget_places, vehicle_pk=pk, before_ns=before_ns))
    gone = looked_at = proofs = 0
    if events_days:
        gone = _in_chunks(engine, partial(_prune_events, before_ns=now_ns - events_days * DAY_NS))
    if candidates_days:
        before_ns = now_ns - candidates_days * DAY_NS
        looked_at = _in_chunks(engine, partial(_prune_candidates, before_ns=before_ns))
    if evidence_days:
        before_ns = now_ns - evidence_days * DAY_NS
        proofs = _in_chunks(engine, partial(evidence.prune, before_ns=before_ns, limit=FEW), FEW)
    with write(engine) as connection:
        answers = connection.execute(
            delete(idempotency_keys).where(idempotency_keys.c.created_ns < now_ns - idempotency.KEPT_NS)
        ).rowcount
    return Removed(packets, points, places, gone, looked_at, proofs, answers)


def erase_history(engine: Engine, vehicle_pk: int) -> None:
    """Remove the bulk of what is stored about a vehicle, before its own row takes the rest along."""
    _in_chunks(engine, partial(_prune_journal, vehicle_pk=vehicle_pk, before_ns=None))
    _in_chunks(engine, partial(_prune_track, vehicle_pk=vehicle_pk, before_ns=None))


def _in_chunks(engine: Engine, remove: Callable[[Connection], int], chunk: int = CHUNK) -> int:
    removed = 0
    while True:
        with write(engine) as connection:
            count = remove(connection)
        removed += count
        if count < chunk:
            return removed


def _prune_journal(connection: Connection, vehicle_pk: int, before_ns: int | None) -> int:
    wanted: ColumnElement[bool] = journal.c.vehicle_pk == vehicle_pk
    too_old: ColumnElement[bool] = true()
    if before_ns is not None:
        row = connection.execute(
            select(checkpoints.c.journal_id, checkpoints.c.sequencer).where(checkpoints.c.vehicle_pk == vehicle_pk)
        ).one_or_none()
        if row is None or evidence.is_open(connection, vehicle_pk):
            return 0
        # The last one stays too, so that the vehicle still shows when its box last spoke.
        keep_from = min([row.journal_id, *Sequencer.from_json(row.sequencer).pending_ids()])
        wanted, too_old = and_(wanted, journal.c.id < keep_from), journal.c.received_ns < before_ns
    return _delete_first(connection, journal.c.id, wanted, too_old)


def _prune_events(connection: Connection, before_ns: int) -> int:
    unsent = exists().where(deliveries.c.event_id == events.c.id, deliveries.c.status == "pending")
    return _delete_first(connection, events.c.cursor, not_(unsent), events.c.stored_ns < before_ns)


def _prune_candidates(connection: Connection, before_ns: int) -> int:
    table = accident_candidates
    old = select(table.c.id).where(table.c.stored_ns < before_ns).order_by(table.c.stored_ns).limit(CHUNK)
    return connection.execute(delete(table).where(table.c.id.in_(old))).rowcount


def _delete_first(
    connection: Connection, key: Column[int], wanted: ColumnElement[bool], too_old: ColumnElement[bool]
) -> int:
    # Rows stand in the order in which they came, so only the first ones are looked at: where one of them is
    # young the rest is too, and need not be read each time.
    first = select(key).where(wanted).order_by(key).limit(CHUNK)
    return connection.execute(delete(key.table).where(key.in_(first), too_old)).rowcount


def _prune_track(connection: Connection, vehicle_pk: int, before_ns: int | None) -> int:
    mine = track_points.c.vehicle_pk == vehicle_pk
    wanted = mine
    if before_ns is not None:
        newest = select(func.max(track_points.c.t_ns)).where(mine).scalar_subquery()
        wanted = and_(mine, track_points.c.t_ns < before_ns, track_points.c.t_ns < newest)
    first = select(track_points.c.t_ns).where(wanted).order_by(track_points.c.t_ns).limit(CHUNK)
    times = list(connection.scalars(first))
    if not times:
        return 0
    return connection.execute(delete(track_points).where(mine, track_points.c.t_ns <= times[-1])).rowcount


def _forget_places(connection: Connection, vehicle_pk: int, before_ns: int) -> int:
    table = manoeuvres
    placed = and_(table.c.vehicle_pk == vehicle_pk, table.c.start_ns < before_ns, table.c.lat_deg.is_not(None))
    some = select(table.c.id).where(placed).limit(CHUNK)
    nowhere = dict.fromkeys(("lat_deg", "lon_deg", "sd_n_m", "sd_e_m", "cov_ne_m2"))
    return connection.execute(update(table).where(table.c.id.in_(some)).values(nowhere)).rowcount
