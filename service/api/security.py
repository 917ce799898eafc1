"""Who is calling and what they may do: bearer API keys with a tenant and scopes."""

from __future__ import annotations

import hashlib
import threading
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Annotated, Final

from fastapi import Depends, Request, Security
from fastapi.security import HTTPBearer
from sqlalchemy import Engine
from starlette.concurrency import run_in_threadpool
from starlette.requests import HTTPConnection

from service.errors import ForbiddenError, UnauthenticatedError
from service.storage import keys
from service.storage.database import read
from service.storage.tenants import DEFAULT_TENANT

SCOPES: Final = {
    "telemetry:write": "send packets",
    "vehicles:read": "vehicles, their settings, state and trips, without places",
    "vehicles:write": "register, change and remove vehicles",
    "positions:read": "places: state, track, ends of trips",
    "accidents:read": "accidents with their places",
    "accidents:review": "say of an accident, or of what was taken for none, whether it was one",
    "manoeuvres:review": "say of a manoeuvre whether it was one, and whether it was defensive",
    "scores:read": "scores",
    "webhooks:read": "webhook endpoints and deliveries",
    "webhooks:write": "make, change and remove webhook endpoints",
    "admin": "everything within the tenant",
}
"""Scopes that a key can hold. ``vehicles:*``, ``accidents:*`` and ``webhooks:*`` stand for all of each."""

REVOCATION_DELAY_S: Final = 5.0
"""How long a key that was good is taken as good without asking the database; a device sends every second."""

_MAX_REMEMBERED: Final = 50_000


@dataclass(frozen=True, slots=True)
class Principal:
    """An authenticated caller."""

    tenant_id: str
    key_id: str | None
    scopes: frozenset[str]

    def may(self, scope: str) -> bool:
        """Whether the caller holds a scope, by name, by its ``:*`` form or as admin."""
        return bool(self.scopes & {scope, f"{scope.partition(':')[0]}:*", "admin"})

    def check(self, scope: str) -> None:
        """Raise ForbiddenError unless the caller holds the scope."""
        if not self.may(scope):
            raise ForbiddenError(f"this key lacks the scope {scope}, which is needed here", scope=scope)


EVERYBODY: Final = Principal(DEFAULT_TENANT, None, frozenset({"admin"}))
"""Every caller while auth is off."""


def authenticate(engine: Engine, token: str) -> Principal:
    """The caller with this API key; raises UnauthenticatedError if it is unknown, expired or revoked."""
    with read(engine) as connection:
        key = keys.lookup(connection, token)
    if key is None or not key.is_valid(time.time_ns()):
        raise UnauthenticatedError("the API key is unknown, expired or revoked; ask the operator for a new one")
    return Principal(key.tenant_id, key.id, key.scopes)


class Authenticator:
    """Tells who makes a request; for endpoints of any kind. Safe from any thread."""

    def __init__(self, engine: Engine, required: bool, monotonic_s: Callable[[], float] = time.monotonic) -> None:
        self._engine = engine
        self._monotonic_s = monotonic_s
        self._required = required
        self._lock = threading.Lock()
        self._remembered: dict[bytes, tuple[Principal, float]] = {}

    def remembered(self, connection: HTTPConnection) -> Principal | None:
        """Who calls, where that is known without the database: then nothing blocks."""
        if not self._required:
            return _noted(connection, EVERYBODY)
        known = self._remembered.get(_digest(bearer_token(connection)))
        if known is None or self._monotonic_s() >= known[1]:
            return None
        return _noted(connection, known[0])

    def principal(self, connection: HTTPConnection) -> Principal:
        """Who calls; raises UnauthenticatedError. May wait for the database."""
        known = self.remembered(connection)
        if known is not None:
            return known
        token = bearer_token(connection)
        principal = authenticate(self._engine, token)
        with self._lock:
            if len(self._remembered) >= _MAX_REMEMBERED:
                self._remembered.clear()
            self._remembered[_digest(token)] = principal, self._monotonic_s() + REVOCATION_DELAY_S
        return _noted(connection, principal)


def bearer_token(connection: HTTPConnection) -> str:
    """The API key of a request; raises UnauthenticatedError where there is none."""
    scheme, _, token = connection.headers.get("authorization", "").partition(" ")
    if scheme.lower() != "bearer" or not token.strip():
        raise UnauthenticatedError("an API key is needed: send the header 'Authorization: Bearer tf_...'")
    return token.strip()


def _noted(connection: HTTPConnection, principal: Principal) -> Principal:
    connection.state.principal = principal  # for the log
    return principal


def _digest(token: str) -> bytes:
    # Memory then holds no key that could be read out of a dump.
    return hashlib.sha256(token.encode()).digest()


# Only the OpenAPI document needs this; ``Authenticator`` reads the header itself.
_bearer: Final = HTTPBearer(auto_error=False, scheme_name="ApiKey", description="An API key, tf_ID_SECRET.")


async def caller(request: Request, _documented: Annotated[object, Security(_bearer)]) -> Principal:
    """Dependency: the caller, whatever they may do."""
    authenticator: Authenticator = request.app.state.authenticator
    known = authenticator.remembered(request)
    return await run_in_threadpool(authenticator.principal, request) if known is None else known


Caller = Annotated[Principal, Depends(caller)]


def require(scope: str) -> Callable[[Principal], Awaitable[Principal]]:
    """Dependency: the caller, who must hold ``scope``; 401 without a good key, 403 without the scope."""

    # Security rather than Depends, so that the OpenAPI document names the scope.
    async def with_scope(principal: Principal = Security(caller, scopes=[scope])) -> Principal:  # noqa: B008
        principal.check(scope)
        return principal

    return with_scope
