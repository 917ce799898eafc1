"""Checkpoints: a vehicle's whole state as of one journal row, from which recovery goes on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from sqlalchemy import Connection, func, select

from service.ingest.sequencing import Sequencer
from service.storage.statements import insert_into
from service.storage.tables import checkpoints, journal


@dataclass(frozen=True, slots=True)
class Checkpoint:
    """State after every journal row up to ``journal_id``; held packets are named inside ``sequencer``."""

    journal_id: int
    sequencer: Any
    session: bytes


@dataclass(frozen=True, slots=True)
class Lag:
    """What the journal holds of a vehicle beyond its checkpoint."""

    vehicle_pk: int
    newest_id: int
    rows: int


def load(connection: Connection, vehicle_pk: int) -> Checkpoint | None:
    """The vehicle's checkpoint, if it has one."""
    row = connection.execute(
        select(checkpoints.c.journal_id, checkpoints.c.sequencer, checkpoints.c.session).where(
            checkpoints.c.vehicle_pk == vehicle_pk
        )
    ).one_or_none()
    return None if row is None else Checkpoint(*row)


def save(connection: Connection, vehicle_pk: int, checkpoint: Checkpoint, stored_ns: int) -> None:
    """Put the checkpoint in the place of an older one; one that is newer stays."""
    insert = insert_into(connection, checkpoints).values(
        vehicle_pk=vehicle_pk,
        journal_id=checkpoint.journal_id,
        sequencer=checkpoint.sequencer,
        session=checkpoint.session,
        stored_ns=stored_ns,
    )
    connection.execute(
        insert.on_conflict_do_update(
            index_elements=[checkpoints.c.vehicle_pk],
            set_={name: insert.excluded[name] for name in ("journal_id", "sequencer", "session", "stored_ns")},
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
