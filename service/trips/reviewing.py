"""A person's verdict on a manoeuvre: it decides whether that counts, and its trip is scored anew."""

from __future__ import annotations

import time
from typing import Final
from uuid import uuid4

from sqlalchemy import Connection

from service.accidents.reviewing import keep_review
from service.storage import manoeuvres, trips
from service.storage.manoeuvres import ManoeuvreRow
from service.storage.reviews import ReviewRow

UNSAID: Final = "none"
"""What a manoeuvre was before anybody or anything said anything of it."""


def review_manoeuvre(
    connection: Connection, manoeuvre: ManoeuvreRow, verdict: str, note: str, reviewer: str | None
) -> ReviewRow:
    """Let a verdict decide whether a manoeuvre counts; in the caller's transaction."""
    now_ns = time.time_ns()
    manoeuvres.judge(connection, manoeuvre.id, verdict)
    trips.mark_due(connection, manoeuvre.vehicle_pk, manoeuvre.start_ns, manoeuvre.start_ns, now_ns)
    review = ReviewRow(
        id=str(uuid4()),
        tenant_id=manoeuvre.tenant_id,
        vehicle_pk=manoeuvre.vehicle_pk,
        subject_id=manoeuvre.id,
        verdict=verdict,
        note=note,
        reviewer=reviewer,
        before=manoeuvre.verdict or manoeuvre.excused or UNSAID,
        after=verdict,
        created_ns=now_ns,
    )
    keep_review(connection, "manoeuvre", review)
    return review
