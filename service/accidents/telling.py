"""The events that tell of an accident: detected at once, then updated or retracted as more is felt, or said."""

from __future__ import annotations

from core.navigation.track import Mode
from schemas.notifications import AccidentBody, EventType
from service.stable_ids import event_id
from service.storage.accidents import AccidentRow
from service.webhooks.outbox import NewEvent


def revision_event(row: AccidentRow, received_ns: int) -> NewEvent:
    """The event of a revision.

    Each revision is told, also where several are decided by one packet: their ids and order follow from the samples
    alone, however these were cut into packets and packets into batches.
    """
    if row.revision == 0:
        return _event(row, EventType.ACCIDENT_DETECTED, row.id, received_ns)
    return _event(row, _later(row), f"{row.id}/{row.revision}", received_ns)


def review_event(row: AccidentRow, review_id: str, now_ns: int) -> NewEvent:
    """The event of a reviewer's verdict, which ``row`` holds already."""
    return _event(row, _later(row), f"{row.id}/review/{review_id}", now_ns, review_id)


def created_event(row: AccidentRow, review_id: str) -> NewEvent:
    """The event of an accident that a reviewer made of a candidate."""
    return _event(row, EventType.ACCIDENT_DETECTED, row.id, row.received_ns, review_id)


def _later(row: AccidentRow) -> EventType:
    return EventType.ACCIDENT_RETRACTED if row.is_none else EventType.ACCIDENT_UPDATED


def _event(row: AccidentRow, kind: EventType, about: str, received_ns: int, review_id: str | None = None) -> NewEvent:
    # What a later revision is called may depend on a reviewer who came in between; that it was told must not.
    first = kind is EventType.ACCIDENT_DETECTED
    body = AccidentBody(
        accident_id=row.id,
        mode=Mode(row.mode).name.lower(),
        review_id=review_id,
        **{name: getattr(row, name) for name in AccidentBody.model_fields if name in _OF_ROW},
        **row.detail,
    )
    return NewEvent(
        id=event_id(about, kind.value if first else EventType.ACCIDENT_UPDATED.value),
        tenant_id=row.tenant_id,
        vehicle_pk=row.vehicle_pk,
        type=kind.value,
        t_ns=row.t_ns,
        received_ns=received_ns,
        body=body.model_dump(),
    )


_OF_ROW = frozenset(AccidentRow.__slots__) - {"mode", "detail", "id"}
