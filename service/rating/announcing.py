"""Tells that a vehicle's scores changed, in the transaction in which they do."""

from __future__ import annotations

from sqlalchemy import Connection

from core.scoring.score import Product
from schemas.notifications import EventType, ScoreBody, ScoreFigures
from service.rating.period import Asked
from service.rating.scoring import Reading, scored
from service.stable_ids import event_id
from service.storage.vehicles import VehicleRef
from service.webhooks import outbox
from service.webhooks.outbox import NewEvent


def announce(
    connection: Connection, reading: Reading, ref: VehicleRef, *, cause: str, trip_id: str | None, now_ns: int
) -> NewEvent:
    """Publish the scores of a vehicle's last year, once a change: ``now_ns`` tells changes apart.

    The event is to be handed on once the transaction is committed.
    """
    found = scored(connection, reading, ref, tuple(Product), Asked(), now_ns)
    any_of_them = found.scores[Product.PHYD]
    body = ScoreBody(
        vehicle_id=ref.vehicle_id,
        trip_id=trip_id,
        cause=cause,
        from_ns=found.period.from_ns,
        to_ns=found.period.to_ns,
        scores={
            product.value: ScoreFigures(score=one.score, interval95=one.interval95, relativity=one.relativity)
            for product, one in found.scores.items()
        },
        model_version=any_of_them.model_version,
        model_sha256=any_of_them.model_sha256,
    ).model_dump()
    event = NewEvent(
        id=event_id(f"{ref.tenant_id}/{ref.vehicle_id}/{trip_id}/{now_ns}", EventType.SCORE_UPDATED.value),
        tenant_id=ref.tenant_id,
        vehicle_pk=ref.pk,
        type=EventType.SCORE_UPDATED.value,
        t_ns=now_ns,
        received_ns=now_ns,
        body=body,
    )
    outbox.publish(connection, event, now_ns)
    return event
