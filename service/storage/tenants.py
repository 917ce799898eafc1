"""Tenants: whose vehicles, keys and webhooks are kept apart."""

from __future__ import annotations

import time
from typing import Final

from sqlalchemy import Connection, select

from service.storage.statements import insert_into
from service.storage.tables import tenants

DEFAULT_TENANT: Final = "default"
"""Everybody's tenant while auth is off."""


def ensure(connection: Connection, tenant_id: str, name: str | None = None) -> None:
    """Make the tenant if it is not there."""
    insert = insert_into(connection, tenants).values(
        id=tenant_id, name=tenant_id if name is None else name, created_ns=time.time_ns()
    )
    connection.execute(insert.on_conflict_do_nothing())


def lock(connection: Connection, tenant_id: str) -> None:
    """Let nobody else change what is the tenant's until this transaction ends, so that reading first is safe.

    SQLite has one writer anyway. Rows that only refer to the tenant are not kept waiting.
    """
    connection.execute(select(tenants.c.id).where(tenants.c.id == tenant_id).with_for_update(key_share=True))


def exists(connection: Connection, tenant_id: str) -> bool:
    """Whether there is such a tenant."""
    return connection.execute(select(tenants.c.id).where(tenants.c.id == tenant_id)).first() is not None
