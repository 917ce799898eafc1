"""API keys: made, looked up, revoked. Only a hash of a key is ever stored."""

from __future__ import annotations

import hashlib
import secrets
import time
from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

from sqlalchemy import Connection, Row, insert, select, update

from service.storage.tables import api_keys


@dataclass(frozen=True, slots=True)
class ApiKey:
    """A key as it is known after it was made. Times are UTC nanoseconds."""

    id: str
    tenant_id: str
    name: str
    scopes: frozenset[str]
    created_ns: int
    expires_ns: int | None
    revoked_ns: int | None

    def is_valid(self, now_ns: int) -> bool:
        """Whether the key opens anything at that time."""
        return self.revoked_ns is None and (self.expires_ns is None or now_ns < self.expires_ns)


def create(
    connection: Connection, tenant_id: str, name: str, scopes: Collection[str], expires_ns: int | None = None
) -> tuple[ApiKey, str]:
    """Make a key for an existing tenant; returns it with its text ``tf_ID_SECRET``, which cannot be had again."""
    key = ApiKey(secrets.token_hex(6), tenant_id, name, frozenset(scopes), time.time_ns(), expires_ns, None)
    # 256 random bits cannot be guessed from their plain hash, so no slow password hash is needed.
    token = f"tf_{key.id}_{secrets.token_urlsafe(32)}"
    connection.execute(
        insert(api_keys).values(
            id=key.id,
            tenant_id=key.tenant_id,
            name=key.name,
            key_sha256=_hash(token),
            scopes=sorted(key.scopes),
            created_ns=key.created_ns,
            expires_ns=key.expires_ns,
        )
    )
    return key, token


def lookup(connection: Connection, token: str) -> ApiKey | None:
    """The key with this text, valid or not."""
    prefix, _, rest = token.partition("_")
    key_id = rest.partition("_")[0]
    if prefix != "tf" or not (key_id.isascii() and key_id.isalnum()):
        return None
    row = connection.execute(select(api_keys).where(api_keys.c.id == key_id)).one_or_none()
    if row is None or not secrets.compare_digest(row.key_sha256, _hash(token)):
        return None
    return _key(row)


def revoke(connection: Connection, key_id: str) -> bool:
    """Close a key for good, at once; False if there is none. A key that is closed already stays as it is."""
    connection.execute(
        update(api_keys)
        .where(api_keys.c.id == key_id, api_keys.c.revoked_ns.is_(None))
        .values(revoked_ns=time.time_ns())
    )
    return connection.execute(select(api_keys.c.id).where(api_keys.c.id == key_id)).first() is not None


def of_tenant(connection: Connection, tenant_id: str | None) -> list[ApiKey]:
    """All keys of a tenant, or of every one, oldest first."""
    statement = select(api_keys).order_by(api_keys.c.created_ns, api_keys.c.id)
    if tenant_id is not None:
        statement = statement.where(api_keys.c.tenant_id == tenant_id)
    return [_key(row) for row in connection.execute(statement)]


def _hash(token: str) -> str:
    return hashlib.sha256(token.encode()).hexdigest()


def _key(row: Row[Any]) -> ApiKey:
    return ApiKey(
        row.id, row.tenant_id, row.name, frozenset(row.scopes), row.created_ns, row.expires_ns, row.revoked_ns
    )
