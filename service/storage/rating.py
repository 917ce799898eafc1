"""What tenants rate by: each part's versions, of which the newest holds; one without a text is the shipped one."""

from __future__ import annotations

from dataclasses import dataclass

from sqlalchemy import Connection, bindparam, func, insert, select

from service.storage.tables import rating_documents


@dataclass(frozen=True, slots=True)
class RatingRow:
    """One version of a part; the columns of ``rating_documents``."""

    part: str
    version: int
    text: str | None
    created_ns: int
    created_by: str | None


def newest(connection: Connection, tenant_id: str, part: str) -> RatingRow | None:
    """The version that holds; None where the tenant never had its own."""
    rows = page(connection, tenant_id, part, None, 1)
    return rows[0] if rows else None


def newest_versions(connection: Connection, tenant_id: str) -> dict[str, int]:
    """By part, the version that holds, where the tenant has had its own."""
    return {row.part: row.newest for row in connection.execute(_NEWEST, {"tenant_id": tenant_id})}


def find(connection: Connection, tenant_id: str, part: str, version: int) -> RatingRow | None:
    """A version."""
    chosen = select(*_COLUMNS).where(
        rating_documents.c.tenant_id == tenant_id,
        rating_documents.c.part == part,
        rating_documents.c.version == version,
    )
    row = connection.execute(chosen).one_or_none()
    return None if row is None else RatingRow(*row)


def page(connection: Connection, tenant_id: str, part: str, before: int | None, limit: int) -> list[RatingRow]:
    """Versions of a part, newest first, those before a version."""
    chosen = select(*_COLUMNS).where(rating_documents.c.tenant_id == tenant_id, rating_documents.c.part == part)
    if before is not None:
        chosen = chosen.where(rating_documents.c.version < before)
    chosen = chosen.order_by(rating_documents.c.version.desc()).limit(limit)
    return [RatingRow(*row) for row in connection.execute(chosen)]


def add(connection: Connection, tenant_id: str, row: RatingRow) -> None:
    """Put a version, which holds from then on; the caller holds the tenant's lock."""
    values = {name: getattr(row, name) for name in RatingRow.__slots__}
    connection.execute(insert(rating_documents).values(tenant_id=tenant_id, **values))


_COLUMNS = [rating_documents.c[name] for name in RatingRow.__slots__]
_NEWEST = (
    select(rating_documents.c.part, func.max(rating_documents.c.version).label("newest"))
    .where(rating_documents.c.tenant_id == bindparam("tenant_id"))
    .group_by(rating_documents.c.part)
)
