"""What people said of accidents, of what was taken for none, and of manoeuvres."""

from __future__ import annotations

from dataclasses import dataclass

from sqlalchemy import Connection, insert, select

from service.storage.tables import reviews


@dataclass(frozen=True, slots=True)
class ReviewRow:
    """One verdict; the columns of ``reviews``."""

    id: str
    tenant_id: str
    vehicle_pk: int
    subject_id: str
    verdict: str
    note: str
    reviewer: str | None
    before: str
    after: str
    created_ns: int


def add(connection: Connection, row: ReviewRow) -> None:
    """Store a verdict."""
    connection.execute(insert(reviews).values({name: getattr(row, name) for name in ReviewRow.__slots__}))


def of(connection: Connection, subject_id: str) -> list[ReviewRow]:
    """All verdicts on something, newest first."""
    mine = select(reviews).where(reviews.c.subject_id == subject_id)
    ordered = mine.order_by(reviews.c.created_ns.desc(), reviews.c.id.desc())
    return [ReviewRow(**row._mapping) for row in connection.execute(ordered)]
