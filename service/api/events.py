"""The catch-up feed: whoever asks again from the last cursor misses no event, whatever became of webhooks."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Final

from fastapi import APIRouter, Query, Request, Response

from schemas.events import EventFeed, FeedEvent
from schemas.notifications import EventType
from service.api.conditional import answer
from service.api.dependencies import Database
from service.api.pagination import DEFAULT_LIMIT, MAX_LIMIT, PageRequest, encode_cursor
from service.api.security import Caller
from service.errors import ForbiddenError
from service.storage import events
from service.storage.database import read

router = APIRouter(tags=["events"])

SCOPE_OF: Final[Mapping[EventType, str]] = {
    EventType.ACCIDENT_DETECTED: "accidents:read",
    EventType.ACCIDENT_UPDATED: "accidents:read",
    EventType.ACCIDENT_RETRACTED: "accidents:read",
    EventType.TRIP_COMPLETED: "vehicles:read",
    EventType.CALIBRATION_CHANGED: "vehicles:read",
    EventType.CALIBRATION_DRIFTED: "vehicles:read",
    EventType.VEHICLE_OFFLINE: "vehicles:read",
    EventType.SCORE_UPDATED: "scores:read",
}
"""What a key needs to see an event; a ping is for its endpoint alone."""


@router.get("/events", response_model=EventFeed)
def list_events(
    request: Request,
    caller: Caller,
    engine: Database,
    after: Annotated[
        str | None, Query(max_length=500, description="A cursor from this feed; left out, from the beginning.")
    ] = None,
    limit: Annotated[int, Query(ge=1, le=MAX_LIMIT, description="Events at most.")] = DEFAULT_LIMIT,
) -> Response:
    """Events after a cursor, oldest first; of the types that the key's scopes let it see."""
    types = [kind.value for kind, scope in SCOPE_OF.items() if caller.may(scope)]
    if not types:
        raise ForbiddenError(
            "this key lacks a scope that any event needs: accidents:read, vehicles:read or scores:read"
        )
    position = PageRequest(limit, after).after(int)
    start: int = 0 if position is None else position[0]
    with read(engine) as connection:
        rows = events.after(connection, caller.tenant_id, start, types, limit + 1)
    shown = rows[:limit]
    found = [
        FeedEvent(
            cursor=encode_cursor(row.cursor),
            id=row.id,
            type=EventType(row.type),
            time=row.t_ns,
            stored_at=row.stored_ns,
            vehicle_id=row.vehicle_id,
            data=dict(row.body),
        )
        for row in shown
    ]
    cursor = encode_cursor(shown[-1].cursor if shown else start)
    return answer(request, EventFeed(events=found, cursor=cursor, more=len(rows) > limit))
