"""Webhook endpoints: set up, rotate the secret, test, and see and repeat what was sent."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Annotated, Any, Final
from uuid import uuid4

from fastapi import APIRouter, Depends, Path, Query, Request, Response
from sqlalchemy import Connection

from schemas.problem import Problem
from schemas.webhooks import (
    Delivery,
    DeliveryAttempt,
    DeliveryList,
    DeliveryStatus,
    Endpoint,
    EndpointChange,
    EndpointList,
    EndpointSettings,
    NewEndpoint,
    RotatedSecret,
    SecretRotation,
)
from service.api.conditional import IfMatch, answer, check_preconditions
from service.api.dependencies import ID_PATTERN, Database
from service.api.idempotency import Idempotent
from service.api.pagination import Page, encode_cursor, link_next
from service.api.security import Principal, require
from service.errors import ConflictError, NotFoundError
from service.storage import webhooks
from service.storage.database import read, write
from service.storage.webhooks import DeliveryRow, EndpointRow
from service.webhooks import outbox, signing
from service.webhooks.targets import check_url

router = APIRouter(tags=["webhooks"])

MAX_ENDPOINTS: Final = 50
"""Of one tenant; each event is written once for every endpoint that asks for it."""

NO_STORE: Final = {"Cache-Control": "no-store"}
CONFLICT: Final[dict[int | str, dict[str, Any]]] = {409: {"model": Problem, "description": "Not in its present state"}}
PRECONDITION: Final[dict[int | str, dict[str, Any]]] = {412: {"model": Problem, "description": "Changed meanwhile"}}

Reader = Annotated[Principal, Depends(require("webhooks:read"))]
Writer = Annotated[Principal, Depends(require("webhooks:write"))]
EndpointPath = Annotated[str, Path(pattern=ID_PATTERN, description="The endpoint's id.")]
DeliveryPath = Annotated[int, Path(ge=1, lt=2**63, description="The delivery's id.")]


@router.post("/webhook-endpoints", response_model=NewEndpoint, status_code=201, responses=CONFLICT)
def create_webhook_endpoint(request: Request, settings: EndpointSettings, caller: Writer, once: Idempotent) -> Response:
    """Make an endpoint. The answer is the only one that shows its secret."""
    _check_url(request, settings.url)
    now_ns = time.time_ns()
    secret = signing.new_secret()
    row = EndpointRow(
        id=str(uuid4()),
        tenant_id=caller.tenant_id,
        secrets=(signing.Secret(secret),),
        created_ns=now_ns,
        updated_ns=now_ns,
        **_settings(settings),
    )

    def create(connection: Connection) -> Response:
        if webhooks.count_endpoints(connection, caller.tenant_id) >= MAX_ENDPOINTS:
            raise ConflictError(f"there are {MAX_ENDPOINTS} webhook endpoints, which is the most; remove one first")
        webhooks.add_endpoint(connection, row)
        body = NewEndpoint(**dict(_endpoint(row)), secret=secret)
        return answer(request, body, status=201, headers={"Location": f"{request.url.path}/{row.id}", **NO_STORE})

    return once.run(create)


@router.get("/webhook-endpoints", response_model=EndpointList)
def list_webhook_endpoints(request: Request, caller: Reader, engine: Database, page: Page) -> Response:
    """The tenant's endpoints, oldest first."""
    with read(engine) as connection:
        rows = webhooks.page_endpoints(connection, caller.tenant_id, page.after(int, str), page.limit + 1)
    shown = rows[: page.limit]
    next_cursor = encode_cursor(shown[-1].created_ns, shown[-1].id) if len(rows) > page.limit else None
    body = EndpointList(endpoints=[_endpoint(row) for row in shown], next_cursor=next_cursor)
    return answer(request, body, headers=link_next(request, next_cursor))


@router.get("/webhook-endpoints/{endpoint_id}", response_model=Endpoint)
def get_webhook_endpoint(request: Request, endpoint_id: EndpointPath, caller: Reader, engine: Database) -> Response:
    """An endpoint, without its secret."""
    with read(engine) as connection:
        row = _the_endpoint(connection, caller, endpoint_id)
    return answer(request, _endpoint(row))


@router.put("/webhook-endpoints/{endpoint_id}", response_model=Endpoint, responses=PRECONDITION)
def put_webhook_endpoint(
    request: Request,
    endpoint_id: EndpointPath,
    settings: EndpointSettings,
    caller: Writer,
    engine: Database,
    if_match: IfMatch = None,
) -> Response:
    """Replace an endpoint's settings; its secret and its deliveries remain."""
    return _change(request, endpoint_id, _settings(settings), caller, engine, if_match)


@router.patch("/webhook-endpoints/{endpoint_id}", response_model=Endpoint, responses=PRECONDITION)
def patch_webhook_endpoint(
    request: Request,
    endpoint_id: EndpointPath,
    change: EndpointChange,
    caller: Writer,
    engine: Database,
    if_match: IfMatch = None,
) -> Response:
    """Change some of an endpoint's settings: another URL, other types, disabled or enabled again."""
    return _change(request, endpoint_id, _settings(change), caller, engine, if_match)


@router.delete("/webhook-endpoints/{endpoint_id}", status_code=204)
def delete_webhook_endpoint(endpoint_id: EndpointPath, caller: Writer, engine: Database) -> Response:
    """Remove an endpoint with its deliveries, those not sent yet, too."""
    with write(engine) as connection:
        if not webhooks.remove_endpoint(connection, caller.tenant_id, endpoint_id):
            raise _no_endpoint(endpoint_id)
    return Response(status_code=204)


@router.post("/webhook-endpoints/{endpoint_id}:rotate-secret", response_model=RotatedSecret)
def rotate_webhook_secret(
    request: Request,
    endpoint_id: EndpointPath,
    caller: Writer,
    once: Idempotent,
    rotation: SecretRotation | None = None,
) -> Response:
    """Replace the secret. The old one goes on signing beside the new one for a while, so no message is refused."""
    now_ns = time.time_ns()
    overlap_ns = (rotation or SecretRotation()).overlap_s * 1_000_000_000

    def rotate(connection: Connection) -> Response:
        row = _the_endpoint(connection, caller, endpoint_id, to_change=True)
        fresh = signing.new_secret()
        held = signing.rotate(row.secrets, fresh, now_ns, overlap_ns)
        webhooks.save_endpoint(connection, replace(row, secrets=held, updated_ns=now_ns))
        body = RotatedSecret(secret=fresh, previous_valid_until=now_ns + overlap_ns)
        return answer(request, body, headers=NO_STORE)

    return once.run(rotate)


@router.post("/webhook-endpoints/{endpoint_id}:test", response_model=Delivery, status_code=202, responses=CONFLICT)
def test_webhook_endpoint(request: Request, endpoint_id: EndpointPath, caller: Writer, once: Idempotent) -> Response:
    """Send a ``ping`` to the endpoint; its delivery tells what came of it."""

    def ping(connection: Connection) -> Response:
        row = _the_endpoint(connection, caller, endpoint_id)
        _check_enabled(row)
        delivery_id = outbox.publish_ping(connection, caller.tenant_id, endpoint_id, time.time_ns())
        return answer(request, _delivery(_the_delivery(connection, endpoint_id, delivery_id)), status=202)

    response = once.run(ping)
    request.app.state.runtime.sender.notify()
    return response


@router.get("/webhook-endpoints/{endpoint_id}/deliveries", response_model=DeliveryList)
def list_webhook_deliveries(
    request: Request,
    endpoint_id: EndpointPath,
    caller: Reader,
    engine: Database,
    page: Page,
    status: Annotated[DeliveryStatus | None, Query(description="Only those in this state.")] = None,
) -> Response:
    """What was sent to an endpoint or is to be, newest first, with the attempts."""
    position = page.after(int)
    before_id = None if position is None else position[0]
    with read(engine) as connection:
        _the_endpoint(connection, caller, endpoint_id)
        rows = webhooks.page_deliveries(connection, endpoint_id, status, before_id, page.limit + 1)
    shown = rows[: page.limit]
    next_cursor = encode_cursor(shown[-1].id) if len(rows) > page.limit else None
    body = DeliveryList(deliveries=[_delivery(row) for row in shown], next_cursor=next_cursor)
    return answer(request, body, headers=link_next(request, next_cursor))


@router.post(
    "/webhook-endpoints/{endpoint_id}/deliveries/{delivery_id}:replay",
    response_model=Delivery,
    status_code=202,
    responses=CONFLICT,
)
def replay_webhook_delivery(
    request: Request, endpoint_id: EndpointPath, delivery_id: DeliveryPath, caller: Writer, engine: Database
) -> Response:
    """Send a delivery again, or at once if it waits, with the same webhook-id and the whole schedule before it."""
    with write(engine) as connection:
        row = _the_endpoint(connection, caller, endpoint_id)
        _the_delivery(connection, endpoint_id, delivery_id)
        _check_enabled(row)
        outbox.replay(connection, delivery_id, time.time_ns())
        delivery = _the_delivery(connection, endpoint_id, delivery_id)
    request.app.state.runtime.sender.notify()
    return answer(request, _delivery(delivery), status=202)


def _change(
    request: Request,
    endpoint_id: str,
    values: dict[str, Any],
    caller: Principal,
    engine: Database,
    if_match: str | None,
) -> Response:
    if "url" in values:
        _check_url(request, values["url"])
    now_ns = time.time_ns()
    with write(engine) as connection:
        before = _the_endpoint(connection, caller, endpoint_id, to_change=True)
        check_preconditions(_endpoint(before), if_match, None)
        row = replace(before, **values, updated_ns=now_ns)
        webhooks.save_endpoint(connection, row)
        if row.status == "disabled":
            outbox.cancel_pending(connection, endpoint_id, now_ns)
    return answer(request, _endpoint(row))


def _check_url(request: Request, url: str) -> None:
    check_url(url, allow_private=request.app.state.settings.dangerous_allow_private_webhook_targets)


def _check_enabled(endpoint: EndpointRow) -> None:
    if endpoint.status != "enabled":
        raise ConflictError("the endpoint is disabled, so nothing is sent to it; enable it first")


def _the_endpoint(
    connection: Connection, caller: Principal, endpoint_id: str, *, to_change: bool = False
) -> EndpointRow:
    row = webhooks.find_endpoint(connection, caller.tenant_id, endpoint_id, to_change=to_change)
    if row is None:
        raise _no_endpoint(endpoint_id)
    return row


def _no_endpoint(endpoint_id: str) -> NotFoundError:
    return NotFoundError(f"there is no webhook endpoint '{endpoint_id}'; GET /v1/webhook-endpoints lists what there is")


def _the_delivery(connection: Connection, endpoint_id: str, delivery_id: int) -> DeliveryRow:
    row = webhooks.find_delivery(connection, endpoint_id, delivery_id)
    if row is None:
        raise NotFoundError(f"there is no delivery {delivery_id} to this endpoint")
    return row


def _settings(given: EndpointSettings | EndpointChange) -> dict[str, Any]:
    values = given.model_dump(mode="json", exclude_none=True)
    if "types" in values:
        values["types"] = tuple(values["types"])
    return values


def _endpoint(row: EndpointRow) -> Endpoint:
    return Endpoint(
        id=row.id,
        url=row.url,
        description=row.description,
        types=row.types,
        status=row.status,  # type: ignore[arg-type]
        created_at=row.created_ns,
        updated_at=row.updated_ns,
    )


def _delivery(row: DeliveryRow) -> Delivery:
    return Delivery(
        id=row.id,
        event_id=row.event_id,
        event_type=row.event_type,
        status=row.status,  # type: ignore[arg-type]
        attempts=row.attempts,
        next_attempt_at=row.next_attempt_ns,
        created_at=row.created_ns,
        finished_at=row.finished_ns,
        last_status_code=row.last_status_code,
        last_error=row.last_error,
        history=[
            DeliveryAttempt(
                started_at=attempt.started_ns,
                duration_ms=attempt.duration_ms,
                status_code=attempt.status_code,
                error=attempt.error,
            )
            for attempt in row.history
        ],
    )
