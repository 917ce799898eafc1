"""People's verdicts on accidents and on what was taken for none, and the trail of who did what."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Depends, Request, Response
from sqlalchemy import Connection

from schemas.accidents import NewCandidateReview, NewReview, Review, ReviewList
from schemas.evidence import AuditEntry, AuditTrail
from service.accidents.reviewing import Reviewed, review_accident, review_candidate
from service.api.accident_candidates import CandidatePath, the_candidate
from service.api.accidents import AccidentPath, the_accident
from service.api.conditional import answer
from service.api.dependencies import Database, the_vehicle
from service.api.idempotency import Idempotent
from service.api.pagination import Page, encode_cursor, link_next
from service.api.security import Principal, require
from service.stable_ids import stable_id
from service.storage import accidents, audit, reviews
from service.storage.database import read
from service.storage.reviews import ReviewRow

router = APIRouter()

Reader = Annotated[Principal, Depends(require("accidents:read"))]
Reviewer = Annotated[Principal, Depends(require("accidents:review"))]
Admin = Annotated[Principal, Depends(require("admin"))]


@router.post("/accidents/{accident_id}/reviews", response_model=Review, status_code=201, tags=["accidents"])
def review_an_accident(
    request: Request, accident_id: AccidentPath, review: NewReview, caller: Reviewer, once: Idempotent
) -> Response:
    """Say whether an accident was one: its status follows, whatever the detector says later.

    Who listens is told by accident.updated or accident.retracted. The last verdict counts; all are kept, and audited.
    """
    done: list[Reviewed] = []

    def create(connection: Connection) -> Response:
        accident = the_accident(connection, caller.tenant_id, accident_id, to_change=True)
        reviewed = review_accident(connection, accident, review.verdict, review.note, caller.key_id)
        done.append(reviewed)
        return answer(request, _shown(reviewed.review, reviewed.accident_id), status=201)

    response = once.run(create)
    _tell(request, caller, done)
    return response


@router.get("/accidents/{accident_id}/reviews", response_model=ReviewList, tags=["accidents"])
def list_reviews(request: Request, accident_id: AccidentPath, caller: Reader, engine: Database) -> Response:
    """What people said of an accident, newest first."""
    with read(engine) as connection:
        accident = the_accident(connection, caller.tenant_id, accident_id)
        rows = reviews.of(connection, accident.id)
    return answer(request, ReviewList(reviews=[_shown(row, accident.id) for row in rows]))


@router.post("/accident-candidates/{candidate_id}/reviews", response_model=Review, status_code=201, tags=["accidents"])
def review_an_accident_candidate(
    request: Request, candidate_id: CandidatePath, review: NewCandidateReview, caller: Reviewer, once: Idempotent
) -> Response:
    """Say whether what was taken for none was an accident: then it is one, confirmed, with evidence as far as its
    packets are still there.

    Who listens is told by accident.detected. A later verdict takes it back.
    """
    done: list[Reviewed] = []

    def create(connection: Connection) -> Response:
        candidate = the_candidate(connection, caller.tenant_id, candidate_id, to_change=True)
        ref = the_vehicle(connection, caller.tenant_id, candidate.vehicle_id).ref
        reviewed = review_candidate(connection, candidate, ref, review.verdict, review.note, caller.key_id)
        done.append(reviewed)
        return answer(request, _shown(reviewed.review, reviewed.accident_id), status=201)

    response = once.run(create)
    _tell(request, caller, done)
    return response


@router.get("/accident-candidates/{candidate_id}/reviews", response_model=ReviewList, tags=["accidents"])
def list_candidate_reviews(request: Request, candidate_id: CandidatePath, caller: Reader, engine: Database) -> Response:
    """What people said of a candidate, newest first."""
    with read(engine) as connection:
        candidate = the_candidate(connection, caller.tenant_id, candidate_id)
        ref = the_vehicle(connection, caller.tenant_id, candidate.vehicle_id).ref
        became = accidents.find(connection, caller.tenant_id, stable_id(ref, candidate.t_ns, "accident"))
        rows = reviews.of(connection, candidate.id)
    accident_id = None if became is None else became.id
    return answer(request, ReviewList(reviews=[_shown(row, accident_id) for row in rows]))


@router.get("/audit", response_model=AuditTrail, tags=["operation"])
def list_audit(request: Request, caller: Admin, engine: Database, page: Page) -> Response:
    """Who did what to what, newest first; entries stay when what they are about is erased."""
    before = page.after(int)
    with read(engine) as connection:
        rows = audit.page(connection, caller.tenant_id, None if before is None else before[0], page.limit + 1)
    shown = rows[: page.limit]
    next_cursor = encode_cursor(shown[-1].id) if len(rows) > page.limit else None
    entries = [
        AuditEntry(time=row.t_ns, actor=row.actor, action=row.action, subject=row.subject, detail=dict(row.detail))
        for row in shown
    ]
    return answer(
        request, AuditTrail(entries=entries, next_cursor=next_cursor), headers=link_next(request, next_cursor)
    )


def _tell(request: Request, caller: Principal, done: list[Reviewed]) -> None:
    """After the commit."""
    runtime = request.app.state.runtime
    for reviewed in done:
        event = reviewed.event
        ref = None if event is None or event.vehicle_pk is None else runtime.directory.by_pk(event.vehicle_pk)
        if ref is not None:
            runtime.tell(ref, event)


def _shown(row: ReviewRow, accident_id: str | None) -> Review:
    return Review(
        id=row.id,
        verdict=row.verdict,  # type: ignore[arg-type]
        note=row.note,
        reviewer=row.reviewer,
        before=row.before,
        after=row.after,
        reviewed_at=row.created_ns,
        accident_id=accident_id,
    )
