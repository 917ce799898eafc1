"""What a tenant rates by: risk tables, score model, tariff and risk of places, as shipped or its own."""

from __future__ import annotations

import json
import time
from typing import Annotated, Any, Final

from fastapi import APIRouter, Depends, Query, Request, Response
from sqlalchemy import Connection, Engine
from starlette.concurrency import run_in_threadpool

from schemas.problem import Problem
from schemas.rating import PlacesBuild, RatingHistory, RatingParts, RatingVersion
from service.api.conditional import IfMatch, answer, answer_content, check_preconditions
from service.api.dependencies import Database
from service.api.pagination import Page, encode_cursor, link_next
from service.api.security import Principal, require
from service.errors import InvalidParameterError, NotFoundError, TooLargeError, UnsupportedMediaTypeError
from service.rating.parts import JSON, KINDS, TOML, Holding, Part, holding, is_json
from service.rating.places import build_places
from service.storage import audit, rating, tenants
from service.storage.database import read, write
from service.storage.rating import RatingRow

router = APIRouter(tags=["scores"])

_TAKEN: Final = {TOML: (TOML, "text/toml", "text/plain", JSON), JSON: (JSON,)}
MOST_BYTES: Final = 4 * 2**20
"""The risk of 100 000 cells; a choice."""

Reader = Annotated[Principal, Depends(require("scores:read"))]
Admin = Annotated[Principal, Depends(require("admin"))]
_TEXT: Final = {"content": {TOML: {"schema": {"type": "string"}}, JSON: {"schema": {"type": "object"}}}}
PUT_RESPONSES: Final[dict[int | str, dict[str, Any]]] = {
    412: {"model": Problem, "description": "Changed meanwhile"},
    413: {"model": Problem, "description": "Larger than is taken"},
    415: {"model": Problem, "description": "Not TOML or JSON"},
}


@router.get("/rating", response_model=RatingParts)
def list_rating(request: Request, caller: Reader, engine: Database) -> Response:
    """What scores and quotes go by, part for part."""
    with read(engine) as connection:
        held = [_held(connection, caller.tenant_id, part) for part in Part]
    return answer(request, RatingParts(parts=[_shown(one) for one in held]))


@router.get(
    "/rating/{part}", responses={200: {"description": "TOML; places are JSON", **_TEXT}}, response_class=Response
)
def get_rating(
    request: Request,
    part: Part,
    caller: Reader,
    engine: Database,
    version: Annotated[
        int | None, Query(ge=0, description="One that held before; left out, the one that holds.")
    ] = None,
) -> Response:
    """A part as it was put, or as it is shipped: a text to begin one's own with. The ETag is that of its version."""
    with read(engine) as connection:
        held = holding(connection, caller.tenant_id, part, version)
    if held is None:
        raise NotFoundError(f"there is no version {version} of {part}; GET /v1/rating/{part}/versions lists them")
    headers = {"X-Rating-Version": str(held.version)}
    return answer_content(
        request,
        held.text.encode(),
        media_type=f"{JSON if is_json(held.text) else TOML}; charset=utf-8",
        headers=headers,
    )


@router.get("/rating/{part}/versions", response_model=RatingHistory)
def list_rating_versions(request: Request, part: Part, caller: Reader, engine: Database, page: Page) -> Response:
    """Every version of a part, newest first."""
    position = page.after(int)
    before = None if position is None else position[0]
    with read(engine) as connection:
        rows = rating.page(connection, caller.tenant_id, part, before, page.limit + 1)
        held = [holding(connection, caller.tenant_id, part, row.version) for row in rows[: page.limit]]
    next_cursor = encode_cursor(rows[page.limit - 1].version) if len(rows) > page.limit else None
    body = RatingHistory(versions=[_shown(one) for one in held if one is not None], next_cursor=next_cursor)
    return answer(request, body, headers=link_next(request, next_cursor))


@router.put(
    "/rating/{part}",
    response_model=RatingVersion,
    responses=PUT_RESPONSES,
    openapi_extra={"requestBody": {"required": True, "description": "At most 4 MiB.", **_TEXT}},
)
async def put_rating(
    request: Request, part: Part, caller: Admin, engine: Database, if_match: IfMatch = None
) -> Response:
    """Rate by a text of one's own from now on. It is read first: what is wrong in it is said, and nothing changes.

    Scores go by the new model at once. Trips that were assessed keep what the tables of then made of them; which
    those were is told with each.
    """
    kind = (request.headers.get("content-type") or "").partition(";")[0].strip().lower()
    wanted = KINDS[part].media_type
    if kind not in _TAKEN[wanted]:
        raise UnsupportedMediaTypeError(f"the body is {kind or 'of no type'}; expected {wanted}")
    text = await _text(request)
    return await run_in_threadpool(_put, request, part, text, caller, engine, if_match)


@router.post("/rating/places:build", response_model=PlacesBuild, status_code=201)
def build_rating_places(request: Request, caller: Admin, engine: Database) -> Response:
    """Work out the risk of places from the tenant's own vehicles, and rate by it from now on.

    A cell's relativity is its accidents (suspected or confirmed) over what its share of the distance lets expect,
    drawn toward 1 the more, the less was driven there.
    """
    with read(engine) as connection:
        built = build_places(connection, caller.tenant_id)
    text = json.dumps(built.places.to_json(), sort_keys=True, indent=1)
    version = _keep(Part.PLACES, text, caller, engine, None)
    body = PlacesBuild(
        rating=version,
        vehicles=built.vehicles,
        distance_m=built.distance_m,
        cells=len(built.places.relativity),
        accidents=built.accidents,
        accidents_left_out=built.left_out,
    )
    return answer(request, body, status=201)


@router.delete("/rating/{part}", response_model=RatingVersion)
def delete_rating(request: Request, part: Part, caller: Admin, engine: Database) -> Response:
    """Rate by the shipped part again from now on; versions of one's own stay readable."""
    return _put(request, part, None, caller, engine, None)


async def _text(request: Request) -> str:
    content = b""
    async for piece in request.stream():
        content += piece
        if len(content) > MOST_BYTES:
            raise TooLargeError(f"the body is larger than {MOST_BYTES} bytes")
    try:
        return content.decode()
    except UnicodeDecodeError as error:
        raise InvalidParameterError(f"body: is no UTF-8 text at byte {error.start}") from None


def _put(
    request: Request, part: Part, text: str | None, caller: Principal, engine: Engine, if_match: str | None
) -> Response:
    if text is not None:
        KINDS[part].read(text)
    return answer(request, _keep(part, text, caller, engine, if_match))


def _keep(part: Part, text: str | None, caller: Principal, engine: Engine, if_match: str | None) -> RatingVersion:
    with write(engine) as connection:
        tenants.lock(connection, caller.tenant_id)
        before = _held(connection, caller.tenant_id, part)
        check_preconditions(_shown(before), if_match, None)
        if (before.text if before.own else None) == text:
            return _shown(before)
        row = RatingRow(part, before.version + 1, text, time.time_ns(), caller.key_id)
        rating.add(connection, caller.tenant_id, row)
        after = _held(connection, caller.tenant_id, part)
        said = {"version": after.version, "sha256": after.sha256, "own": after.own}
        audit.note(
            connection, caller.tenant_id, caller.key_id, "rating.changed", f"rating/{part}", row.created_ns, said
        )
        return _shown(after)


def _held(connection: Connection, tenant_id: str, part: Part) -> Holding:
    held = holding(connection, tenant_id, part)
    assert held is not None
    return held


def _shown(held: Holding) -> RatingVersion:
    return RatingVersion(
        part=held.part,
        version=held.version,
        own=held.own,
        sha256=held.sha256,
        created_at=held.created_ns,
        created_by=held.created_by,
    )
