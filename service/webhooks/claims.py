"""The sender's side of the outbox: claim what is due, record what came of it.

A claim is written down before anything is sent: the delivery is leased (its next attempt is moved
past the lease) and an open attempt is added. A process that dies in between therefore leaves a trace,
and the delivery is sent again when the lease runs out: at least once, never lost.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Final

from sqlalchemy import ColumnElement, Connection, Row, and_, exists, func, insert, or_, select, update

from service.storage.tables import deliveries, delivery_attempts, events, webhook_endpoints
from service.webhooks.outbox import cancel_pending
from service.webhooks.schedule import RetrySchedule
from service.webhooks.signing import Secret, secrets_from_json

INTERRUPTED: Final = "interrupted: the service stopped before the outcome was known"

MAX_ERROR_LENGTH: Final = 500

ALERT_PREFIX: Final = "accident."
"""Types that overtake others and whose latency is measured."""

LOOK: Final = 64
"""Due deliveries looked at from each end of an endpoint's queue; an accident within them is sent first, and a
backlog of any length costs a turn no more than this."""

_OPEN: Final = and_(delivery_attempts.c.status_code.is_(None), delivery_attempts.c.error.is_(None))


@dataclass(frozen=True, slots=True)
class Claim:
    """One delivery that is ours to send now; ``attempts`` counts this one."""

    delivery_id: int
    endpoint_id: str
    attempts: int
    url: str
    secrets: tuple[Secret, ...]
    event_id: str
    type: str
    t_ns: int
    received_ns: int
    body: dict[str, Any]


class Outcome(StrEnum):
    """What came of an attempt."""

    DELIVERED = "delivered"
    FAILED = "failed"
    GONE = "gone"
    """The receiver answered 410: it wants nothing more, ever."""
    INTERRUPTED = "interrupted"
    """The service is stopping; it says nothing about the receiver."""


@dataclass(frozen=True, slots=True)
class Result:
    """A finished attempt."""

    claim: Claim
    outcome: Outcome
    duration_ms: float
    status_code: int | None = None
    error: str | None = None
    retry_after_s: float | None = None


def next_due_ns(connection: Connection, after_ns: int) -> tuple[bool, int | None]:
    """Whether anything is due at ``after_ns``, and when the next delivery after it is."""
    due = select(deliveries.c.id).where(deliveries.c.next_attempt_ns <= after_ns).limit(1)
    later = select(func.min(deliveries.c.next_attempt_ns)).where(deliveries.c.next_attempt_ns > after_ns)
    return connection.execute(due).first() is not None, connection.execute(later).scalar()


def claim_due(
    connection: Connection, now_ns: int, lease_ns: int, full: Collection[str], accept: Callable[[int, str], bool]
) -> list[Claim]:
    """Lease due deliveries, accidents first, then what waited longest; endpoints in ``full`` are left out.

    ``accept(delivery_id, endpoint_id)`` has the last word on each.
    """
    due = [
        row
        for endpoint_id in _endpoints_with_due(connection, now_ns, full)
        for row in _due(connection, endpoint_id, now_ns)
    ]
    due.sort(key=lambda row: (not row.type.startswith(ALERT_PREFIX), row.next_attempt_ns, row.id))
    wanted = [row.id for row in due if accept(row.id, row.endpoint_id)]
    if not wanted:
        return []
    # Another process may have been faster: take only what is still due, and wait for nobody.
    locked = connection.execute(
        select(deliveries.c.id)
        .where(deliveries.c.id.in_(wanted), deliveries.c.next_attempt_ns <= now_ns)
        .with_for_update(skip_locked=True)
    )
    ids = list(locked.scalars())
    if not ids:
        return []
    connection.execute(
        update(deliveries)
        .where(deliveries.c.id.in_(ids))
        .values(attempts=deliveries.c.attempts + 1, next_attempt_ns=now_ns + lease_ns)
    )
    connection.execute(
        update(delivery_attempts).where(delivery_attempts.c.delivery_id.in_(ids), _OPEN).values(error=INTERRUPTED)
    )
    connection.execute(
        insert(delivery_attempts), [{"delivery_id": id_, "started_ns": now_ns, "duration_ms": 0.0} for id_ in ids]
    )
    rows = connection.execute(
        select(
            deliveries.c.id.label("delivery_id"),
            deliveries.c.endpoint_id,
            deliveries.c.attempts,
            webhook_endpoints.c.url,
            webhook_endpoints.c.secrets,
            events.c.id.label("event_id"),
            events.c.type,
            events.c.t_ns,
            events.c.received_ns,
            events.c.body,
        )
        .join(webhook_endpoints, webhook_endpoints.c.id == deliveries.c.endpoint_id)
        .join(events, events.c.id == deliveries.c.event_id)
        .where(deliveries.c.id.in_(ids))
    ).mappings()
    claims = {row["delivery_id"]: Claim(**{**row, "secrets": secrets_from_json(row["secrets"])}) for row in rows}
    return [claims[id_] for id_ in wanted if id_ in claims]


def record(connection: Connection, results: Sequence[Result], now_ns: int, schedule: RetrySchedule) -> list[str]:
    """Write down what came of attempts; returns each delivery's outcome: delivered, retried, dead, gone, interrupted.

    Recording a result twice, or for a delivery that was deleted meanwhile, changes nothing.
    """
    # Endpoints before deliveries, these by id: whoever disables an endpoint takes its locks in the same order.
    ordered = sorted(results, key=lambda result: (result.outcome is not Outcome.GONE, result.claim.delivery_id))
    told = {result.claim.delivery_id: _record(connection, result, now_ns, schedule) for result in ordered}
    return [told[result.claim.delivery_id] for result in results]


def release_interrupted(connection: Connection, now_ns: int) -> int:
    """Make what a dead predecessor had claimed due at once; only where no other process sends."""
    interrupted = select(delivery_attempts.c.delivery_id).where(_OPEN)
    return connection.execute(
        update(deliveries)
        .where(deliveries.c.status == "pending", deliveries.c.id.in_(interrupted))
        .values(next_attempt_ns=now_ns)
    ).rowcount


def _endpoints_with_due(connection: Connection, now_ns: int, full: Collection[str]) -> list[str]:
    has_due = (
        exists()
        .where(deliveries.c.endpoint_id == webhook_endpoints.c.id, deliveries.c.next_attempt_ns <= now_ns)
        .correlate(webhook_endpoints)
    )
    found = connection.execute(
        select(webhook_endpoints.c.id).where(
            webhook_endpoints.c.status == "enabled", webhook_endpoints.c.id.not_in(full), has_due
        )
    )
    return list(found.scalars())


def _due(connection: Connection, endpoint_id: str, now_ns: int) -> set[Row[Any]]:
    """An endpoint's due deliveries from both ends: those that waited longest, and what has just come in."""
    next_ns = deliveries.c.next_attempt_ns
    found: set[Row[Any]] = set()
    for order in (next_ns.asc(), next_ns.desc()):
        due = (
            select(deliveries.c.id, deliveries.c.endpoint_id, deliveries.c.event_id, next_ns)
            .where(deliveries.c.endpoint_id == endpoint_id, next_ns <= now_ns)
            .order_by(order)
            .limit(LOOK)
            .subquery()
        )
        with_type = select(due.c.id, due.c.endpoint_id, due.c.next_attempt_ns, events.c.type)
        found.update(connection.execute(with_type.join(events, events.c.id == due.c.event_id)))
    return found


def _record(connection: Connection, result: Result, now_ns: int, schedule: RetrySchedule) -> str:
    claim = result.claim
    error = None if result.error is None else result.error[:MAX_ERROR_LENGTH]
    if result.outcome is Outcome.GONE:
        connection.execute(
            update(webhook_endpoints)
            .where(webhook_endpoints.c.id == claim.endpoint_id)
            .values(status="disabled", updated_ns=now_ns)
        )
    connection.execute(
        update(delivery_attempts)
        .where(delivery_attempts.c.delivery_id == claim.delivery_id, _OPEN)
        .values(duration_ms=result.duration_ms, status_code=result.status_code, error=error)
    )
    still_wanted: ColumnElement[bool] = deliveries.c.status == "pending"
    values: dict[str, Any]
    if result.outcome is Outcome.DELIVERED:
        # It has arrived, even if its endpoint was disabled while it was on its way.
        still_wanted = or_(still_wanted, deliveries.c.status == "cancelled")
        told, values = "delivered", {"status": "delivered", "next_attempt_ns": None, "finished_ns": now_ns}
    elif result.outcome is Outcome.INTERRUPTED:
        told, values = "interrupted", {"next_attempt_ns": now_ns}
    else:
        delay_s = schedule.delay_s(claim.delivery_id, claim.attempts, result.retry_after_s)
        if result.outcome is Outcome.GONE or delay_s is None:
            told = "gone" if result.outcome is Outcome.GONE else "dead"
            values = {"status": "dead", "next_attempt_ns": None, "finished_ns": now_ns}
        else:
            told, values = "retried", {"next_attempt_ns": now_ns + int(delay_s * 1e9)}
    connection.execute(
        update(deliveries)
        .where(deliveries.c.id == claim.delivery_id, still_wanted)
        .values(last_status_code=result.status_code, last_error=error, **values)
    )
    if result.outcome is Outcome.GONE:
        cancel_pending(connection, claim.endpoint_id, now_ns)
    return told
