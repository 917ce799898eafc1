"""Checkpoints: a vehicle's whole state as of one journal row, from which recovery goes on.

Beside the newest a few older ones are kept, from which the minute before an accident is replayed for its evidence.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

from sqlalchemy import Column, Connection, Table, delete, exists, func, select

from service.ingest.sequencing import Sequencer
from service.storage.evidence import BEFORE_NS, OPEN
from service.storage.statements import insert_into
from service.storage.tables import checkpoints, evidence, journal, older_checkpoints

OLDER_APART_NS: Final = BEFORE_NS + 30_000_000_000
"""Time between two older checkpoints. Of two, the older one then lies at least a minute before whatever accident is
decided next, with half a minute for what is decided late; a choice."""
OLDER_KEPT: Final = 2


@dataclass(frozen=True, slots=True)
class Checkpoint:
    """State after every journal row up to ``journal_id``; held packets are named inside ``sequencer``.

    ``t_ns`` is the newest sample in it, by the box's clock; None before the first.
    """

    journal_id: int
    sequencer: Any
    session: bytes
    t_ns: int | None = None


@dataclass(frozen=True, slots=True)
class Lag:
    """What the journal holds of a vehicle beyond its checkpoint."""

    vehicle_pk: int
    newest_id: int
    rows: int


def load(connection: Connection, vehicle_pk: int) -> Checkpoint | None:
    """The vehicle's checkpoint, if it has one."""
    row = connection.execute(select(*_columns(checkpoints)).where(checkpoints.c.vehicle_pk == vehicle_pk)).one_or_none()
    return None if row is None else Checkpoint(*row)


def load_older(connection: Connection, vehicle_pk: int, journal_id: int) -> Checkpoint | None:
    """One of the vehicle's older checkpoints, if it is there."""
    older = older_checkpoints
    row = connection.execute(
        select(*_columns(older)).where(older.c.vehicle_pk == vehicle_pk, older.c.journal_id == journal_id)
    ).one_or_none()
    return None if row is None else Checkpoint(*row)


def save(connection: Connection, vehicle_pk: int, checkpoint: Checkpoint, stored_ns: int) -> None:
    """Put the checkpoint in the place of an older one; one that is newer stays."""
    _keep_older(connection, vehicle_pk, checkpoint.journal_id)
    insert = insert_into(connection, checkpoints).values(
        vehicle_pk=vehicle_pk,
        journal_id=checkpoint.journal_id,
        t_ns=checkpoint.t_ns,
        sequencer=checkpoint.sequencer,
        session=checkpoint.session,
        stored_ns=stored_ns,
    )
    connection.execute(
        insert.on_conflict_do_update(
            index_elements=[checkpoints.c.vehicle_pk],
            set_={name: insert.excluded[name] for name in ("journal_id", "t_ns", "sequencer", "session", "stored_ns")},
            where=checkpoints.c.journal_id <= insert.excluded.journal_id,
        )
    )


def lagging(connection: Connection) -> list[Lag]:
    """Every vehicle with journal rows after its checkpoint, or with rows and no checkpoint."""
    rows = connection.execute(
        select(journal.c.vehicle_pk, func.max(journal.c.id), func.count())
        .select_from(journal.outerjoin(checkpoints, checkpoints.c.vehicle_pk == journal.c.vehicle_pk))
        .where(journal.c.id > func.coalesce(checkpoints.c.journal_id, 0))
        .group_by(journal.c.vehicle_pk)
    )
    return [Lag(*row) for row in rows]


def holding(connection: Connection) -> set[int]:
    """Vehicles whose checkpoint has packets held back behind a gap."""
    rows = connection.execute(select(checkpoints.c.vehicle_pk, checkpoints.c.sequencer)).yield_per(1000)
    return {pk for pk, sequencer in rows if Sequencer.from_json(sequencer).pending_ids()}


def _keep_older(connection: Connection, vehicle_pk: int, next_id: int) -> None:
    """Keep the checkpoint that is about to be replaced, where the last one kept is long before it."""
    now, older = checkpoints, older_checkpoints
    near = exists().where(
        older.c.vehicle_pk == vehicle_pk,
        older.c.t_ns > now.c.t_ns - OLDER_APART_NS,
        older.c.t_ns <= now.c.t_ns,  # a clock that was set back makes no checkpoint of later
    )
    names = [column.name for column in older.c]
    replaced = select(*(now.c[name] for name in names)).where(
        now.c.vehicle_pk == vehicle_pk, now.c.journal_id < next_id, now.c.t_ns.is_not(None), ~near
    )
    kept = connection.execute(
        insert_into(connection, older)
        .from_select(names, replaced)
        .on_conflict_do_nothing(index_elements=[older.c.vehicle_pk, older.c.journal_id])
        .returning(older.c.journal_id)
    )
    if kept.first() is None:
        return
    newest = (
        select(older.c.journal_id)
        .where(older.c.vehicle_pk == vehicle_pk)
        .order_by(older.c.journal_id.desc())
        .limit(OLDER_KEPT)
    )
    needed = select(evidence.c.anchor_journal_id).where(
        evidence.c.vehicle_pk == vehicle_pk,
        evidence.c.status.in_(OPEN),
        evidence.c.anchor_journal_id.is_not(None),
    )
    connection.execute(
        delete(older).where(
            older.c.vehicle_pk == vehicle_pk, older.c.journal_id.not_in(newest), older.c.journal_id.not_in(needed)
        )
    )


def _columns(table: Table) -> list[Column[Any]]:
    return [table.c[name] for name in ("journal_id", "sequencer", "session", "t_ns")]
