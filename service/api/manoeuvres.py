"""Manoeuvres, and people's verdicts on them."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Depends, Path, Request, Response
from sqlalchemy import Connection

from schemas.trips import Manoeuvre, ManoeuvreReview, ManoeuvreReviewList, NewManoeuvreReview
from service.api.conditional import answer
from service.api.dependencies import ID_PATTERN, Database
from service.api.idempotency import Idempotent
from service.api.security import Principal, require
from service.errors import NotFoundError
from service.storage import manoeuvres, reviews
from service.storage.database import read
from service.storage.manoeuvres import ManoeuvreRow
from service.storage.reviews import ReviewRow
from service.trips.reviewing import review_manoeuvre
from service.trips.telling import shown_manoeuvre

router = APIRouter(tags=["trips"])

Reader = Annotated[Principal, Depends(require("vehicles:read"))]
Reviewer = Annotated[Principal, Depends(require("manoeuvres:review"))]
ManoeuvrePath = Annotated[str, Path(pattern=ID_PATTERN, description="The manoeuvre's id.")]


@router.get("/manoeuvres/{manoeuvre_id}", response_model=Manoeuvre)
def get_manoeuvre(request: Request, manoeuvre_id: ManoeuvrePath, caller: Reader, engine: Database) -> Response:
    """A manoeuvre, such as the evidence of a score names; its place only for keys with positions:read."""
    with read(engine) as connection:
        row = _the_manoeuvre(connection, caller.tenant_id, manoeuvre_id)
    return answer(request, shown_manoeuvre(row, places=caller.may("positions:read")))


@router.post("/manoeuvres/{manoeuvre_id}/reviews", response_model=ManoeuvreReview, status_code=201)
def review_a_manoeuvre(
    request: Request, manoeuvre_id: ManoeuvrePath, review: NewManoeuvreReview, caller: Reviewer, once: Idempotent
) -> Response:
    """Say whether a manoeuvre counts: confirmed does, whatever explains it; defensive was because of others; false was
    none.

    The trip's record follows within seconds, and every score of a period that it is part of. The last verdict counts;
    all are kept, and audited.
    """

    def create(connection: Connection) -> Response:
        row = _the_manoeuvre(connection, caller.tenant_id, manoeuvre_id, to_change=True)
        given = review_manoeuvre(connection, row, review.verdict, review.note, caller.key_id)
        return answer(request, _shown(given), status=201)

    return once.run(create)


@router.get("/manoeuvres/{manoeuvre_id}/reviews", response_model=ManoeuvreReviewList)
def list_manoeuvre_reviews(request: Request, manoeuvre_id: ManoeuvrePath, caller: Reader, engine: Database) -> Response:
    """What people said of a manoeuvre, newest first."""
    with read(engine) as connection:
        row = _the_manoeuvre(connection, caller.tenant_id, manoeuvre_id)
        rows = reviews.of(connection, row.id)
    return answer(request, ManoeuvreReviewList(reviews=[_shown(one) for one in rows]))


def _the_manoeuvre(
    connection: Connection, tenant_id: str, manoeuvre_id: str, *, to_change: bool = False
) -> ManoeuvreRow:
    row = manoeuvres.find(connection, tenant_id, manoeuvre_id, to_change=to_change)
    if row is None:
        raise NotFoundError(f"there is no manoeuvre '{manoeuvre_id}'; GET /v1/trips/ID/manoeuvres lists a trip's")
    return row


def _shown(row: ReviewRow) -> ManoeuvreReview:
    return ManoeuvreReview(
        id=row.id,
        verdict=row.verdict,  # type: ignore[arg-type]
        note=row.note,
        reviewer=row.reviewer,
        before=row.before,
        after=row.after,
        reviewed_at=row.created_ns,
    )
