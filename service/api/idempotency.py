"""POSTs that create something once, however often a nervous network repeats them."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Final

from fastapi import Depends, Header, Request, Response
from sqlalchemy import Connection, Engine

from service.api.dependencies import Database
from service.api.security import Caller
from service.errors import IdempotencyError
from service.storage import idempotency
from service.storage.database import read, write

_REPLAYED_HEADERS: Final = ("content-type", "location", "etag")


@dataclass(frozen=True, slots=True)
class Once:
    """Runs what creates something in one transaction with the answer that tells of it.

    The same key with the same request gets the stored answer (header ``Idempotency-Replayed: true``); with
    another request it is refused. A request that failed has left nothing and may be sent again as it is.
    """

    engine: Engine
    tenant_id: str
    key: str | None
    request_sha256: str

    def is_new(self) -> bool:
        """Whether nothing was answered under this key: else ``run`` will do nothing."""
        if self.key is None:
            return True
        with read(self.engine) as connection:
            return not idempotency.is_used(connection, self.tenant_id, self.key)

    def run(self, create: Callable[[Connection], Response]) -> Response:
        """``create(connection)`` makes the thing and its answer; both are committed when this returns."""
        with write(self.engine) as connection:
            if self.key is None:
                return create(connection)
            stored = idempotency.begin(connection, self.tenant_id, self.key, self.request_sha256)
            if stored is None:
                response = create(connection)
                kept = {name: response.headers[name] for name in _REPLAYED_HEADERS if name in response.headers}
                body = bytes(response.body)
                idempotency.finish(connection, self.tenant_id, self.key, response.status_code, kept, body)
                return response
        if stored.request_sha256 != self.request_sha256:
            raise IdempotencyError("Idempotency-Key: used before for another request; take a new key for a new request")
        return Response(stored.body, stored.status, {**stored.headers, "Idempotency-Replayed": "true"})


IdempotencyKey = Annotated[
    str | None,
    Header(
        min_length=1,
        max_length=255,
        pattern=r"^[\x21-\x7e]+$",
        description="Any text of the caller's, new for each new request: repeated within 24 hours, the request "
        "gets the first answer again and nothing is made twice.",
    ),
]


async def once(request: Request, caller: Caller, engine: Database, idempotency_key: IdempotencyKey = None) -> Once:
    """Dependency for an endpoint that creates something by POST."""
    digest = hashlib.sha256()
    for part in (request.method, request.url.path, request.url.query):
        digest.update(part.encode() + b"\0")
    digest.update(await request.body())
    return Once(engine, caller.tenant_id, idempotency_key, digest.hexdigest())


Idempotent = Annotated[Once, Depends(once)]
