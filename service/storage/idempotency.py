"""Answers to requests that carried an idempotency key, kept so that a repeated request gets the same."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from sqlalchemy import Connection, select, update

from service.storage.statements import insert_into
from service.storage.tables import idempotency_keys

KEPT_NS: Final = 24 * 3600 * 1_000_000_000
"""How long an answer is kept, at least."""


@dataclass(frozen=True, slots=True)
class StoredAnswer:
    """What a request was answered, and which request that was."""

    request_sha256: str
    status: int
    headers: Mapping[str, str]
    body: bytes


def begin(connection: Connection, tenant_id: str, key: str, request_sha256: str) -> StoredAnswer | None:
    """Take the key for this transaction, or return what its earlier request was answered.

    On PostgreSQL this waits for a transaction that has taken the same key to end either way.
    """
    taken = connection.execute(
        insert_into(connection, idempotency_keys)
        .values(
            tenant_id=tenant_id,
            key=key,
            request_sha256=request_sha256,
            status=0,
            headers={},
            body=b"",
            created_ns=time.time_ns(),
        )
        .on_conflict_do_nothing()
        .returning(idempotency_keys.c.key)
    )
    if taken.first() is not None:
        return None
    row = connection.execute(
        select(
            idempotency_keys.c.request_sha256,
            idempotency_keys.c.status,
            idempotency_keys.c.headers,
            idempotency_keys.c.body,
        ).where(idempotency_keys.c.tenant_id == tenant_id, idempotency_keys.c.key == key)
    ).one()
    return StoredAnswer(*row)


def is_used(connection: Connection, tenant_id: str, key: str) -> bool:
    """Whether a request with this key was answered before."""
    mine = select(idempotency_keys.c.key).where(
        idempotency_keys.c.tenant_id == tenant_id, idempotency_keys.c.key == key
    )
    return connection.execute(mine).first() is not None


def finish(
    connection: Connection, tenant_id: str, key: str, status: int, headers: Mapping[str, str], body: bytes
) -> None:
    """Keep the answer under the key, in the transaction that did what it tells of."""
    connection.execute(
        update(idempotency_keys)
        .where(idempotency_keys.c.tenant_id == tenant_id, idempotency_keys.c.key == key)
        .values(status=status, headers=dict(headers), body=body)
    )
