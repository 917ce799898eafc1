"""Who did what to what: entries that outlive their subjects."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from sqlalchemy import Connection, insert, select

from service.storage.tables import audit


@dataclass(frozen=True, slots=True)
class AuditRow:
    """One entry."""

    id: int
    t_ns: int
    actor: str | None
    action: str
    subject: str
    detail: Mapping[str, Any]


def note(
    connection: Connection,
    tenant_id: str,
    actor: str | None,
    action: str,
    subject: str,
    now_ns: int,
    detail: Mapping[str, Any] | None = None,
) -> None:
    """Write an entry, in the transaction that does what it tells of."""
    values = {"tenant_id": tenant_id, "actor": actor, "action": action, "subject": subject, "t_ns": now_ns}
    connection.execute(insert(audit).values(**values, detail=dict(detail or {})))


def page(connection: Connection, tenant_id: str, before: int | None, limit: int) -> list[AuditRow]:
    """The tenant's entries, newest first, those before an id."""
    columns = (audit.c[name] for name in AuditRow.__slots__)
    chosen = select(*columns).where(audit.c.tenant_id == tenant_id)
    if before is not None:
        chosen = chosen.where(audit.c.id < before)
    return [AuditRow(*row) for row in connection.execute(chosen.order_by(audit.c.id.desc()).limit(limit))]
