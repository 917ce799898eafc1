"""The feed of events, read in the order in which they were stored."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any, Final

from sqlalchemy import ColumnElement, Connection, literal_column, select

from service.storage.tables import events, vehicles

_SETTLED: Final[ColumnElement[bool]] = literal_column(
    "age(events.xmin) > age(pg_snapshot_xmin(pg_current_snapshot())::xid)"
)
"""PostgreSQL: written by a transaction older than every one that still runs."""


@dataclass(frozen=True, slots=True)
class EventRow:
    """An event with its vehicle's name."""

    cursor: int
    id: str
    type: str
    t_ns: int
    stored_ns: int
    vehicle_id: str | None
    body: Mapping[str, Any]


def after(connection: Connection, tenant_id: str, cursor: int, types: Collection[str], limit: int) -> list[EventRow]:
    """The tenant's events of these types after ``cursor``; whoever asks again from the last one misses none.

    On PostgreSQL a cursor is drawn before its event is committed, so that a later one can be seen first:
    events are held back until nothing before them can still appear.
    """
    statement = (
        select(
            events.c.cursor,
            events.c.id,
            events.c.type,
            events.c.t_ns,
            events.c.stored_ns,
            vehicles.c.vehicle_id,
            events.c.body,
        )
        .outerjoin(vehicles, vehicles.c.pk == events.c.vehicle_pk)
        .where(events.c.tenant_id == tenant_id, events.c.cursor > cursor, events.c.type.in_(types))
    )
    if connection.dialect.name == "postgresql":
        statement = statement.where(_SETTLED)
    return [EventRow(*row) for row in connection.execute(statement.order_by(events.c.cursor).limit(limit))]
