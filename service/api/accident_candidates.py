"""What felt like an accident and was judged to be none, as GeoJSON, so that a reviewer can look."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Depends, Path, Query, Request, Response
from sqlalchemy import Connection

from core.accident.events import NoAccident
from schemas import geojson
from schemas.accidents import CandidateCollection, CandidateFeature
from schemas.geojson import GEOJSON_MEDIA_TYPE
from service.api.accidents import (
    BoundingBox,
    DateTime,
    OfVehicle,
    answer_features,
    placed,
    point_of,
    where_and_when,
)
from service.api.conditional import answer
from service.api.dependencies import ID_PATTERN, Database
from service.api.pagination import Page
from service.api.security import Principal, require
from service.errors import NotFoundError
from service.storage import candidates
from service.storage.candidates import CandidateFilter, CandidateRow
from service.storage.database import read

router = APIRouter(tags=["accidents"])

Reader = Annotated[Principal, Depends(require("accidents:read"))]
CandidatePath = Annotated[str, Path(pattern=ID_PATTERN, description="The candidate's id.")]


@router.get(
    "/accident-candidates",
    responses={200: {"model": CandidateCollection, "content": {GEOJSON_MEDIA_TYPE: {}}}},
    response_class=Response,
)
def list_accident_candidates(
    request: Request,
    caller: Reader,
    engine: Database,
    page: Page,
    bbox: BoundingBox = None,
    interval: DateTime = None,
    reason: Annotated[list[NoAccident] | None, Query(description="One reason or several.")] = None,
    vehicle: OfVehicle = None,
) -> Response:
    """Shocks that were judged to be no accident, newest first, as long as they are kept."""
    wanted = CandidateFilter(
        where=where_and_when(bbox, interval, vehicle),
        reasons=None if reason is None else {each.value for each in reason},
    )
    after = page.after(int, str)
    with read(engine) as connection:
        rows = candidates.page(connection, caller.tenant_id, wanted, after=after, limit=page.limit + 1)
    return answer_features(request, page, rows, candidate_feature)


@router.get(
    "/accident-candidates/{candidate_id}",
    responses={200: {"model": CandidateFeature, "content": {GEOJSON_MEDIA_TYPE: {}}}},
    response_class=Response,
)
def get_accident_candidate(request: Request, candidate_id: CandidatePath, caller: Reader, engine: Database) -> Response:
    """One of them."""
    with read(engine) as connection:
        row = the_candidate(connection, caller.tenant_id, candidate_id)
    return answer(request, candidate_feature(row), media_type=GEOJSON_MEDIA_TYPE)


def the_candidate(
    connection: Connection, tenant_id: str, candidate_id: str, *, to_change: bool = False
) -> CandidateRow:
    """The tenant's candidate; raises NotFoundError for none."""
    row = candidates.find(connection, tenant_id, candidate_id, to_change=to_change)
    if row is None:
        raise NotFoundError(f"there is no candidate '{candidate_id}'; GET /v1/accident-candidates lists them")
    return row


def candidate_feature(row: CandidateRow) -> dict[str, Any]:
    """A candidate as it is told."""
    own = ("vehicle_id", "reason", "probability", "verdict")
    properties = {name: getattr(row, name) for name in own} | placed(row) | dict(row.detail)
    return geojson.feature(row.id, point_of(row), properties)
