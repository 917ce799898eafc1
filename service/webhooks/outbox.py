"""The outbox: what must be sent about an event is stored in the event's own transaction.

A delivery is one event for one endpoint. It is ``pending`` until it is ``delivered``, ``dead`` (the
schedule is used up) or ``cancelled`` (its endpoint was disabled), and can be replayed from each of them.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any
from uuid import uuid4

from sqlalchemy import Connection, insert, select, update

from schemas.notifications import EventType, PingBody, message
from service.storage.statements import insert_into
from service.storage.tables import deliveries, events, webhook_endpoints


@dataclass(frozen=True, slots=True)
class NewEvent:
    """Something that happened. ``id`` is deterministic, so that telling it again changes nothing.

    ``t_ns`` is when it happened, ``received_ns`` when the packet that caused it came in; ``body`` is
    the ``data`` of its webhook message.
    """

    id: str
    tenant_id: str
    vehicle_pk: int | None
    type: str
    t_ns: int
    received_ns: int
    body: Mapping[str, Any]


def publish(connection: Connection, event: NewEvent, stored_ns: int | None = None) -> bool:
    """Store an event and its deliveries in the caller's transaction; False if it was there already.

    Wake the sender (``Sender.notify``) once the transaction is committed.
    """
    stored_ns = time.time_ns() if stored_ns is None else stored_ns
    if not _store(connection, event, stored_ns):
        return False
    # The share lock (PostgreSQL) makes disabling an endpoint wait, so that it sees and cancels these.
    listening = connection.execute(
        select(webhook_endpoints.c.id, webhook_endpoints.c.types)
        .where(webhook_endpoints.c.tenant_id == event.tenant_id, webhook_endpoints.c.status == "enabled")
        .with_for_update(read=True)
    )
    _deliver(connection, event.id, [row.id for row in listening if not row.types or event.type in row.types], stored_ns)
    return True


def publish_ping(connection: Connection, tenant_id: str, endpoint_id: str, now_ns: int) -> int:
    """A ``ping`` for one endpoint, whatever types it asks for; returns the delivery's id."""
    body = PingBody(endpoint_id=endpoint_id).model_dump()
    ping = NewEvent(str(uuid4()), tenant_id, None, EventType.PING, now_ns, now_ns, body)
    _store(connection, ping, now_ns)
    _deliver(connection, ping.id, [endpoint_id], now_ns)
    delivery_id: int = connection.execute(select(deliveries.c.id).where(deliveries.c.event_id == ping.id)).scalar_one()
    return delivery_id


def replay(connection: Connection, delivery_id: int, now_ns: int) -> None:
    """Send a delivery again, now and with the whole schedule before it; its past attempts remain on record."""
    connection.execute(
        update(deliveries)
        .where(deliveries.c.id == delivery_id)
        .values(status="pending", attempts=0, next_attempt_ns=now_ns, finished_ns=None)
    )


def cancel_pending(connection: Connection, endpoint_id: str, now_ns: int) -> None:
    """Give up what is still to be sent to an endpoint; for when it is disabled."""
    pending = (
        select(deliveries.c.id)
        .where(deliveries.c.endpoint_id == endpoint_id, deliveries.c.status == "pending")
        .order_by(deliveries.c.id)
        .with_for_update()  # in the order in which the sender locks them
    )
    connection.execute(
        update(deliveries)
        .where(deliveries.c.id.in_(pending))
        .values(status="cancelled", next_attempt_ns=None, finished_ns=now_ns)
    )


def _store(connection: Connection, event: NewEvent, stored_ns: int) -> bool:
    message(event.type, event.t_ns, event.body)  # what could never be sent must not be stored either
    stored = connection.execute(
        insert_into(connection, events)
        .values(
            id=event.id,
            tenant_id=event.tenant_id,
            vehicle_pk=event.vehicle_pk,
            type=str(event.type),
            t_ns=event.t_ns,
            received_ns=event.received_ns,
            stored_ns=stored_ns,
            body=dict(event.body),
        )
        .on_conflict_do_nothing(index_elements=["id"])
        .returning(events.c.cursor)  # PostgreSQL's driver counts no rows here
    )
    return stored.first() is not None


def _deliver(connection: Connection, event_id: str, endpoint_ids: Sequence[str], now_ns: int) -> None:
    rows = [
        {
            "event_id": event_id,
            "endpoint_id": endpoint_id,
            "status": "pending",
            "attempts": 0,
            "next_attempt_ns": now_ns,
            "created_ns": now_ns,
        }
        for endpoint_id in endpoint_ids
    ]
    if rows:
        connection.execute(insert(deliveries), rows)
