"""The catch-up feed: what happened, in the order in which it was stored."""

from __future__ import annotations

from typing import Any

from pydantic import Field

from schemas.model import Model, VehicleId
from schemas.notifications import EventType
from schemas.times import Time


class FeedEvent(Model):
    """One event; ``id`` and ``data`` are those of its webhook."""

    cursor: str = Field(description="The place in the feed just after this event.")
    id: str
    type: EventType
    time: Time
    stored_at: Time
    vehicle_id: VehicleId | None
    data: dict[str, Any]


class EventFeed(Model):
    """Events after a cursor, oldest first."""

    events: list[FeedEvent]
    cursor: str = Field(description="Give it as after for what comes next, at once or later; never null.")
    more: bool = Field(description="Whether more is there already.")
