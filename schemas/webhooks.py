"""Webhook endpoints and deliveries as they are set up and read over REST."""

from __future__ import annotations

from typing import Annotated, Final, Literal

from pydantic import AfterValidator, Field, StringConstraints

from schemas.model import Model
from schemas.notifications import EventType
from schemas.times import Time

MAX_URL_LENGTH: Final = 2048
MAX_DESCRIPTION_LENGTH: Final = 500
MAX_OVERLAP_S: Final = 7 * 86400


def _subscribable(types: tuple[EventType, ...]) -> tuple[EventType, ...]:
    if EventType.PING in types:
        raise ValueError("ping is not asked for: it comes when an endpoint is tested")
    return tuple(dict.fromkeys(types))


Url = Annotated[
    str,
    StringConstraints(strip_whitespace=True, min_length=1, max_length=MAX_URL_LENGTH),
    Field(description="Where messages are posted; https, a public host.", examples=["https://example.com/hooks"]),
]
Description = Annotated[str, StringConstraints(max_length=MAX_DESCRIPTION_LENGTH, pattern=r"^[^\x00]*$")]
Types = Annotated[
    tuple[EventType, ...],
    Field(max_length=len(EventType), description="Event types to receive; empty for all of them."),
    AfterValidator(_subscribable),
]
EndpointStatus = Literal["enabled", "disabled"]
DeliveryStatus = Literal["pending", "delivered", "dead", "cancelled"]


class EndpointSettings(Model):
    """What makes an endpoint, or takes the place of all that is set of one."""

    url: Url
    description: Description = ""
    types: Types = ()
    status: EndpointStatus = "enabled"


class EndpointChange(Model):
    """What changes of an endpoint; a field that is left out stays as it is."""

    url: Url | None = None
    description: Description | None = None
    types: Types | None = None
    status: EndpointStatus | None = Field(
        None, description="Disabling cancels what is still to be sent; cancelled deliveries can be replayed."
    )


class Endpoint(Model):
    """A webhook endpoint; its secret is shown only when it is made or rotated."""

    id: str
    url: str
    description: str
    types: tuple[str, ...] = Field(description="Event types that it receives; empty for all of them.")
    status: EndpointStatus
    created_at: Time
    updated_at: Time


class NewEndpoint(Endpoint):
    """An endpoint just made."""

    secret: str = Field(description="Verifies the signatures. Keep it: it is not shown again.")


class EndpointList(Model):
    """A page of endpoints, oldest first."""

    endpoints: list[Endpoint]
    next_cursor: str | None = Field(description="Give it as cursor for the page after this one; null at the end.")


class SecretRotation(Model):
    """How a secret is replaced."""

    overlap_s: Annotated[
        int,
        Field(ge=0, le=MAX_OVERLAP_S, description="Seconds that the secret in use goes on signing beside the new one."),
    ] = 86400


class RotatedSecret(Model):
    """The new secret of an endpoint."""

    secret: str = Field(description="Verifies the signatures. Keep it: it is not shown again.")
    previous_valid_until: Time = Field(description="Until then messages carry the old secret's signature, too.")


class DeliveryAttempt(Model):
    """One attempt; without status and error it is under way."""

    started_at: Time
    duration_ms: float
    status_code: int | None
    error: str | None


class Delivery(Model):
    """An event on its way to an endpoint."""

    id: int
    event_id: str = Field(description="The webhook-id header, the same at every attempt and endpoint.")
    event_type: str
    status: DeliveryStatus = Field(
        description="pending; delivered; dead: the last attempt failed, or 410; cancelled: its endpoint was disabled."
    )
    attempts: int = Field(description="Attempts since it was made, or last replayed.")
    next_attempt_at: Time | None
    created_at: Time
    finished_at: Time | None
    last_status_code: int | None
    last_error: str | None
    history: list[DeliveryAttempt] = Field(description="The newest attempts, oldest of them first.")


class DeliveryList(Model):
    """A page of deliveries, newest first."""

    deliveries: list[Delivery]
    next_cursor: str | None = Field(description="Give it as cursor for the page after this one; null at the end.")
