"""Accidents as GeoJSON: by place, time, kind, status, severity and vehicle."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Annotated, Any, TypeVar

from fastapi import APIRouter, Depends, Path, Query, Request, Response
from sqlalchemy import Connection

from core.accident.events import Kind, Severity
from schemas import geojson
from schemas.accidents import AccidentCollection, AccidentFeature, AccidentStatus
from schemas.geojson import GEOJSON_MEDIA_TYPE
from schemas.model import VehicleId
from schemas.notifications import rfc3339
from service.api.conditional import answer
from service.api.dependencies import ID_PATTERN, Database
from service.api.pagination import Page, PageRequest, encode_cursor, link_next
from service.api.security import Principal, require
from service.api.times import interval_ns
from service.api.vehicles import MODES
from service.errors import InvalidParameterError, NotFoundError
from service.storage import accidents
from service.storage.accidents import SHOWN, AccidentFilter, AccidentRow
from service.storage.candidates import CandidateRow
from service.storage.database import read
from service.storage.places import Box, WhereAndWhen

router = APIRouter(tags=["accidents"])

Row = TypeVar("Row", AccidentRow, CandidateRow)

Reader = Annotated[Principal, Depends(require("accidents:read"))]
BoundingBox = Annotated[
    str | None,
    Query(
        description="West, south, east, north in degrees. Where west is above east the box lies across the "
        "antimeridian. With six numbers the third and the sixth, heights, are not looked at.",
        examples=["11.5,57.6,12.1,57.8"],
        max_length=200,
    ),
]
DateTime = Annotated[
    str | None,
    Query(
        alias="datetime",
        description="An RFC 3339 time, or two with a slash between, of which one may be '..' for open.",
        examples=["2026-01-01T00:00:00Z/.."],
        max_length=100,
    ),
]


OfVehicle = Annotated[VehicleId | None, Query(description="Of this vehicle only.")]
AccidentPath = Annotated[str, Path(pattern=ID_PATTERN, description="The accident's id.")]


@router.get(
    "/accidents",
    responses={200: {"model": AccidentCollection, "content": {GEOJSON_MEDIA_TYPE: {}}}},
    response_class=Response,
)
def list_accidents(
    request: Request,
    caller: Reader,
    engine: Database,
    page: Page,
    bbox: BoundingBox = None,
    interval: DateTime = None,
    severity: Annotated[list[Severity] | None, Query(description="One severity or several.")] = None,
    kind: Annotated[list[Kind] | None, Query(description="One kind or several.")] = None,
    status: Annotated[
        list[AccidentStatus] | None,
        Query(description="One status or several; left out, suspected and confirmed: the others were none."),
    ] = None,
    vehicle: OfVehicle = None,
) -> Response:
    """Accidents where all that is asked for is met, newest first; within the box and the time, edges included."""
    wanted = AccidentFilter(
        where=where_and_when(bbox, interval, vehicle),
        severities=None if severity is None else {each.value for each in severity},
        statuses=SHOWN if status is None else set(status),
        kinds=None if kind is None else {each.value for each in kind},
    )
    after = page.after(int, str)
    with read(engine) as connection:
        rows = accidents.page(connection, caller.tenant_id, wanted, after=after, limit=page.limit + 1)
    return answer_features(request, page, rows, accident_feature)


@router.get(
    "/accidents/{accident_id}",
    responses={200: {"model": AccidentFeature, "content": {GEOJSON_MEDIA_TYPE: {}}}},
    response_class=Response,
)
def get_accident(
    request: Request,
    accident_id: AccidentPath,
    caller: Reader,
    engine: Database,
) -> Response:
    """One accident."""
    with read(engine) as connection:
        row = the_accident(connection, caller.tenant_id, accident_id)
    return answer(request, accident_feature(row), media_type=GEOJSON_MEDIA_TYPE)


def the_accident(connection: Connection, tenant_id: str, accident_id: str, *, to_change: bool = False) -> AccidentRow:
    """The tenant's accident; raises NotFoundError for none, also where it is another tenant's."""
    row = accidents.find(connection, tenant_id, accident_id, to_change=to_change)
    if row is None:
        raise NotFoundError(f"there is no accident '{accident_id}'; GET /v1/accidents lists them")
    return row


def where_and_when(bbox: str | None, interval: str | None, vehicle: str | None) -> WhereAndWhen:
    """What lists of things with a place and a time are asked; InvalidParameterError where it is no box or time."""
    from_ns, to_ns = interval_ns("datetime", interval)
    return WhereAndWhen(None if bbox is None else parse_bbox(bbox), from_ns, to_ns, vehicle)


def answer_features(
    request: Request, page: PageRequest, rows: Sequence[Row], feature: Callable[[Row], dict[str, Any]]
) -> Response:
    """A page of features; ``rows`` are one more than the page where there is a next one."""
    shown = rows[: page.limit]
    next_cursor = encode_cursor(shown[-1].t_ns, shown[-1].id) if len(rows) > page.limit else None
    headers = link_next(request, next_cursor)
    links = []
    if headers:
        href = headers["Link"].partition(">")[0].removeprefix("<")
        links = [{"rel": "next", "href": href, "type": GEOJSON_MEDIA_TYPE}]
    body = {
        "type": "FeatureCollection",
        "features": [feature(row) for row in shown],
        "links": links,
        "numberReturned": len(shown),
    }
    return answer(request, body, media_type=GEOJSON_MEDIA_TYPE, headers=headers)


def parse_bbox(text: str) -> Box:
    """``W,S,E,N`` or ``W,S,low,E,N,high`` in degrees (RFC 7946, section 5); InvalidParameterError otherwise."""
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) not in (4, 6) or not all(math.isfinite(number) for number in numbers):
        raise InvalidParameterError(f"query.bbox: '{text}' is not four numbers west,south,east,north in degrees")
    west, south = numbers[0], numbers[1]
    east, north = numbers[len(numbers) // 2], numbers[len(numbers) // 2 + 1]
    if not (-180 <= west <= 180 and -180 <= east <= 180):
        raise InvalidParameterError(f"query.bbox: west {west:g} and east {east:g} must be within -180..180")
    if not -90 <= south <= north <= 90:
        raise InvalidParameterError(
            f"query.bbox: south {south:g} and north {north:g} must be -90 <= south <= north <= 90"
        )
    return Box(west, south, east, north)


def accident_feature(row: AccidentRow) -> dict[str, Any]:
    """An accident as it is told."""
    own = ("vehicle_id", "trip_id", "revision", "kind", "status", "verdict", "severity", "confidence", "street")
    properties = (
        {name: getattr(row, name) for name in own} | {"evidence": row.evidence} | placed(row) | dict(row.detail)
    )
    return geojson.feature(row.id, point_of(row), properties)


def placed(row: Row) -> dict[str, Any]:
    """What features say of their place, beside the point, and of their times."""
    return {
        "time": rfc3339(row.t_ns),
        "decided_at": rfc3339(row.decided_t_ns),
        "received_at": rfc3339(row.received_ns),
        "stored_at": rfc3339(row.stored_ns),
        "sd_n_m": row.sd_n_m,
        "sd_e_m": row.sd_e_m,
        "cov_ne_m2": row.cov_ne_m2,
        "heading_deg": row.heading_deg,
        "mode": MODES[row.mode],
    }


def point_of(row: Row) -> dict[str, Any] | None:
    """The point; None where a box never had a fix."""
    if row.lat_deg is None or row.lon_deg is None or row.alt_m is None:
        return None
    return geojson.point(row.lon_deg, row.lat_deg, row.alt_m)
