"""A person's verdict: it changes what an accident counts as, is told to whoever listens, and noted for good.

Each is a transaction of the caller's, with the event to be told once that is committed.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import Final
from uuid import uuid4

from sqlalchemy import Connection

from core.accident.events import Kind, Severity
from core.accident.severity import classify
from core.accident.thresholds import SeverityThresholds
from service.accidents.telling import created_event, review_event
from service.stable_ids import stable_id
from service.storage import accidents, audit, candidates, evidence, reviews, trips
from service.storage.accidents import REVIEWER, AccidentRow
from service.storage.candidates import CandidateRow
from service.storage.reviews import ReviewRow
from service.storage.vehicles import VehicleRef
from service.webhooks import outbox
from service.webhooks.outbox import NewEvent

ACCIDENT: Final = "accident"
"""A reviewer's verdict on a candidate that was one."""
SAID_BY_PERSON: Final = "a reviewer says so"


@dataclass(frozen=True, slots=True)
class Reviewed:
    """What was stored, and what is to be told of it after the commit; ``accident_id`` None where there is none."""

    review: ReviewRow
    accident_id: str | None
    event: NewEvent | None


def review_accident(
    connection: Connection, accident: AccidentRow, verdict: str, note: str, reviewer: str | None
) -> Reviewed:
    """Let a verdict decide whether an accident was one."""
    now_ns = time.time_ns()
    accidents.judge(connection, accident.id, verdict)
    judged = replace(accident, verdict=verdict, status=verdict)
    trips.mark_trip_due(connection, accident.trip_id, now_ns)
    review = _review(accident, verdict, note, reviewer, accident.status, now_ns)
    keep_review(connection, "accident", review)
    event = review_event(judged, review.id, now_ns)
    outbox.publish(connection, event, now_ns)
    return Reviewed(review, accident.id, event)


def review_candidate(
    connection: Connection, candidate: CandidateRow, ref: VehicleRef, verdict: str, note: str, reviewer: str | None
) -> Reviewed:
    """Let a verdict decide whether a candidate was an accident after all: then there is one from now on."""
    now_ns = time.time_ns()
    candidates.judge(connection, candidate.id, verdict)
    review = _review(candidate, verdict, note, reviewer, candidate.verdict or candidate.reason, now_ns)
    keep_review(connection, "candidate", review)
    accident_id = stable_id(ref, candidate.t_ns, "accident")
    known = accidents.find(connection, candidate.tenant_id, accident_id, to_change=True)
    if known is None and verdict != ACCIDENT:
        return Reviewed(review, None, None)
    if known is not None:
        # There was one, made by an earlier verdict or suspected and then retracted: it follows this one.
        follows = review_accident(connection, known, "confirmed" if verdict == ACCIDENT else "false", note, reviewer)
        return Reviewed(review, accident_id, follows.event)
    accident = accidents.put(connection, _accident_of(connection, candidate, accident_id, now_ns))
    trips.mark_trip_due(connection, accident.trip_id, now_ns)
    evidence.ask_for(connection, accident, ref.config, now_ns)
    event = created_event(accident, review.id)
    outbox.publish(connection, event, now_ns)
    return Reviewed(review, accident_id, event)


def _review(
    subject: AccidentRow | CandidateRow, verdict: str, note: str, reviewer: str | None, before: str, now_ns: int
) -> ReviewRow:
    return ReviewRow(
        id=str(uuid4()),
        tenant_id=subject.tenant_id,
        vehicle_pk=subject.vehicle_pk,
        subject_id=subject.id,
        verdict=verdict,
        note=note,
        reviewer=reviewer,
        before=before,
        after=verdict,
        created_ns=now_ns,
    )


def keep_review(connection: Connection, kind: str, review: ReviewRow) -> None:
    """Store a verdict, and that it was given."""
    reviews.add(connection, review)
    # Without the note, which may say things of people: the audit outlives the vehicle.
    said = {"review_id": review.id, "verdict": review.verdict, "before": review.before, "after": review.after}
    about = f"{kind}/{review.subject_id}"
    audit.note(connection, review.tenant_id, review.reviewer, f"{kind}.reviewed", about, review.created_ns, said)


def _accident_of(connection: Connection, candidate: CandidateRow, accident_id: str, now_ns: int) -> AccidentRow:
    """An accident with the figures of a candidate; where the force came from, nobody has worked out."""
    felt = candidate.detail
    delta_v_mps, duration_s = float(felt["delta_v_mps"] or 0.0), float(felt["duration_s"] or 0.0)
    severity: Severity = classify(delta_v_mps, duration_s, SeverityThresholds())
    same = {name: getattr(candidate, name) for name in CandidateRow.__slots__ if name in AccidentRow.__slots__}
    return AccidentRow(
        **same
        | {
            "id": accident_id,
            "received_ns": now_ns,
            "stored_ns": now_ns,
            "verdict": "confirmed",
            "detail": {
                "detector": REVIEWER,
                "delta_v_mps": delta_v_mps,
                "delta_v_sd_mps": None,
                "delta_v_interval_mps": [None, None],
                "delta_v_b_mps": [None, None],
                "pdof_deg": None,
                "pdof_sd_deg": None,
                "peak_mps2": float(felt["peak_mps2"] or 0.0),
                "duration_s": duration_s,
                "clipped": False,
                "speed_before_mps": felt["speed_before_mps"],
                "impacts": 1,
                "each_impact": [],
                "rollover": False,
                "injury": None,
                "reasons": [SAID_BY_PERSON],
                "paper_agrees": bool(felt["paper_agrees"]),
            },
        },
        trip_id=accidents.trip_at(connection, candidate.vehicle_pk, candidate.t_ns),
        revision=0,
        kind=str(Kind.COLLISION),
        status="confirmed",
        severity=str(severity),
        confidence=1.0,
    )
