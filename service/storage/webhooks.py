"""Webhook endpoints and their deliveries, as REST reads and changes them."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

from sqlalchemy import Connection, Row, Select, and_, delete, func, insert, or_, select, update

from service.storage.tables import deliveries, delivery_attempts, events, webhook_endpoints
from service.webhooks.signing import Secret, secrets_from_json, secrets_to_json

MAX_HISTORY: Final = 50
"""Attempts shown of a delivery; replays can make any number of them."""


@dataclass(frozen=True, slots=True)
class EndpointRow:
    """An endpoint with its secrets, newest first. Times are UTC nanoseconds."""

    id: str
    tenant_id: str
    url: str
    description: str
    types: tuple[str, ...]
    secrets: tuple[Secret, ...]
    status: str
    created_ns: int
    updated_ns: int


@dataclass(frozen=True, slots=True)
class AttemptRow:
    """One attempt; neither status nor error while it is under way."""

    started_ns: int
    duration_ms: float
    status_code: int | None
    error: str | None


@dataclass(frozen=True, slots=True)
class DeliveryRow:
    """A delivery with its event's type and its newest attempts, oldest of them first."""

    id: int
    event_id: str
    event_type: str
    status: str
    attempts: int
    next_attempt_ns: int | None
    created_ns: int
    finished_ns: int | None
    last_status_code: int | None
    last_error: str | None
    history: tuple[AttemptRow, ...]


def add_endpoint(connection: Connection, endpoint: EndpointRow) -> None:
    """Store a new endpoint."""
    connection.execute(insert(webhook_endpoints).values(_columns(endpoint)))


def save_endpoint(connection: Connection, endpoint: EndpointRow) -> None:
    """Store a changed endpoint."""
    connection.execute(
        update(webhook_endpoints).where(webhook_endpoints.c.id == endpoint.id).values(_columns(endpoint))
    )


def remove_endpoint(connection: Connection, tenant_id: str, endpoint_id: str) -> bool:
    """Remove the tenant's endpoint with its deliveries; False if there is none."""
    table = webhook_endpoints
    removed = connection.execute(delete(table).where(table.c.id == endpoint_id, table.c.tenant_id == tenant_id))
    return removed.rowcount == 1


def find_endpoint(
    connection: Connection, tenant_id: str, endpoint_id: str, *, to_change: bool = False
) -> EndpointRow | None:
    """The tenant's endpoint; ``to_change`` keeps others from changing it until the transaction ends."""
    table = webhook_endpoints
    statement = select(table).where(table.c.id == endpoint_id, table.c.tenant_id == tenant_id)
    row = connection.execute(statement.with_for_update() if to_change else statement).one_or_none()
    return None if row is None else _endpoint(row)


def count_endpoints(connection: Connection, tenant_id: str) -> int:
    """How many endpoints the tenant has."""
    count: int = connection.execute(
        select(func.count()).select_from(webhook_endpoints).where(webhook_endpoints.c.tenant_id == tenant_id)
    ).scalar_one()
    return count


def page_endpoints(
    connection: Connection, tenant_id: str, after: tuple[int, str] | None, limit: int
) -> list[EndpointRow]:
    """The tenant's endpoints, oldest first, those after ``(created_ns, id)``."""
    table = webhook_endpoints
    statement = select(table).where(table.c.tenant_id == tenant_id)
    if after is not None:
        created_ns, endpoint_id = after
        statement = statement.where(
            or_(table.c.created_ns > created_ns, and_(table.c.created_ns == created_ns, table.c.id > endpoint_id))
        )
    return [
        _endpoint(row) for row in connection.execute(statement.order_by(table.c.created_ns, table.c.id).limit(limit))
    ]


def find_delivery(connection: Connection, endpoint_id: str, delivery_id: int) -> DeliveryRow | None:
    """A delivery to the endpoint."""
    found = _deliveries(connection, _select_deliveries(endpoint_id).where(deliveries.c.id == delivery_id))
    return found[0] if found else None


def page_deliveries(
    connection: Connection, endpoint_id: str, status: str | None, before_id: int | None, limit: int
) -> list[DeliveryRow]:
    """Deliveries to the endpoint, newest first, those before ``before_id``."""
    statement = _select_deliveries(endpoint_id)
    if status is not None:
        statement = statement.where(deliveries.c.status == status)
    if before_id is not None:
        statement = statement.where(deliveries.c.id < before_id)
    return _deliveries(connection, statement.order_by(deliveries.c.id.desc()).limit(limit))


def _select_deliveries(endpoint_id: str) -> Select[Any]:
    return (
        select(deliveries, events.c.type)
        .join(events, events.c.id == deliveries.c.event_id)
        .where(deliveries.c.endpoint_id == endpoint_id)
    )


def _deliveries(connection: Connection, statement: Select[Any]) -> list[DeliveryRow]:
    rows = connection.execute(statement).all()
    history = _history(connection, [row.id for row in rows])
    return [
        DeliveryRow(
            row.id,
            row.event_id,
            row.type,
            row.status,
            row.attempts,
            row.next_attempt_ns,
            row.created_ns,
            row.finished_ns,
            row.last_status_code,
            row.last_error,
            tuple(history[row.id]),
        )
        for row in rows
    ]


def _history(connection: Connection, delivery_ids: Sequence[int]) -> defaultdict[int, list[AttemptRow]]:
    table = delivery_attempts
    newest = func.row_number().over(partition_by=table.c.delivery_id, order_by=table.c.id.desc())
    ranked = select(table, newest.label("rank")).where(table.c.delivery_id.in_(delivery_ids)).subquery()
    history: defaultdict[int, list[AttemptRow]] = defaultdict(list)
    for row in connection.execute(select(ranked).where(ranked.c.rank <= MAX_HISTORY).order_by(ranked.c.id)):
        history[row.delivery_id].append(AttemptRow(row.started_ns, row.duration_ms, row.status_code, row.error))
    return history


def _columns(endpoint: EndpointRow) -> dict[str, Any]:
    return {
        "id": endpoint.id,
        "tenant_id": endpoint.tenant_id,
        "url": endpoint.url,
        "description": endpoint.description,
        "types": list(endpoint.types),
        "secrets": secrets_to_json(endpoint.secrets),
        "status": endpoint.status,
        "created_ns": endpoint.created_ns,
        "updated_ns": endpoint.updated_ns,
    }


def _endpoint(row: Row[Any]) -> EndpointRow:
    return EndpointRow(
        row.id,
        row.tenant_id,
        row.url,
        row.description,
        tuple(row.types),
        secrets_from_json(row.secrets),
        row.status,
        row.created_ns,
        row.updated_ns,
    )
