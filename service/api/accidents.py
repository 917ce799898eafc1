"""Accidents as GeoJSON: by place, time, severity and vehicle."""

from __future__ import annotations

import math
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Path, Query, Request, Response

from core.accident.events import Severity
from schemas import geojson
from schemas.accidents import AccidentCollection, AccidentFeature
from schemas.geojson import GEOJSON_MEDIA_TYPE
from schemas.model import VehicleId
from schemas.notifications import rfc3339
from service.api.conditional import answer
from service.api.dependencies import ID_PATTERN, Database
from service.api.pagination import Page, encode_cursor, link_next
from service.api.security import Principal, require
from service.api.times import interval_ns
from service.api.vehicles import MODES
from service.errors import InvalidParameterError, NotFoundError
from service.storage import accidents
from service.storage.accidents import AccidentFilter, AccidentRow, Box
from service.storage.database import read

router = APIRouter(tags=["accidents"])

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
    vehicle: Annotated[VehicleId | None, Query(description="Of this vehicle only.")] = None,
) -> Response:
    """Accidents where all that is asked for is met, newest first; within the box and the time, edges included."""
    from_ns, to_ns = interval_ns("datetime", interval)
    wanted = AccidentFilter(
        box=None if bbox is None else parse_bbox(bbox),
        from_ns=from_ns,
        to_ns=to_ns,
        severities=None if severity is None else {each.value for each in severity},
        vehicle_id=vehicle,
    )
    after = page.after(int, str)
    with read(engine) as connection:
        rows = accidents.page(connection, caller.tenant_id, wanted, after=after, limit=page.limit + 1)
    shown = rows[: page.limit]
    next_cursor = encode_cursor(shown[-1].t_ns, shown[-1].id) if len(rows) > page.limit else None
    headers = link_next(request, next_cursor)
    links = []
    if headers:
        href = headers["Link"].partition(">")[0].removeprefix("<")
        links = [{"rel": "next", "href": href, "type": GEOJSON_MEDIA_TYPE}]
    body = {
        "type": "FeatureCollection",
        "features": [_feature(row) for row in shown],
        "links": links,
        "numberReturned": len(shown),
    }
    return answer(request, body, media_type=GEOJSON_MEDIA_TYPE, headers=headers)


@router.get(
    "/accidents/{accident_id}",
    responses={200: {"model": AccidentFeature, "content": {GEOJSON_MEDIA_TYPE: {}}}},
    response_class=Response,
)
def get_accident(
    request: Request,
    accident_id: Annotated[str, Path(pattern=ID_PATTERN, description="The accident's id.")],
    caller: Reader,
    engine: Database,
) -> Response:
    """One accident."""
    with read(engine) as connection:
        row = accidents.find(connection, caller.tenant_id, accident_id)
    if row is None:
        raise NotFoundError(f"there is no accident '{accident_id}'; GET /v1/accidents lists them")
    return answer(request, _feature(row), media_type=GEOJSON_MEDIA_TYPE)


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


def _feature(row: AccidentRow) -> dict[str, Any]:
    properties = {
        "vehicle_id": row.vehicle_id,
        "trip_id": row.trip_id,
        "time": rfc3339(row.t_ns),
        "decided_at": rfc3339(row.decided_t_ns),
        "received_at": rfc3339(row.received_ns),
        "stored_at": rfc3339(row.stored_ns),
        "status": row.status,
        "severity": row.severity,
        "confidence": row.confidence,
        "sd_n_m": row.sd_n_m,
        "sd_e_m": row.sd_e_m,
        "cov_ne_m2": row.cov_ne_m2,
        "heading_deg": row.heading_deg,
        "mode": MODES[row.mode],
        **row.detail,
    }
    placed = row.lat_deg is not None and row.lon_deg is not None and row.alt_m is not None
    place = geojson.point(row.lon_deg, row.lat_deg, row.alt_m) if placed else None
    return geojson.feature(row.id, place, properties)
