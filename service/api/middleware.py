"""What happens to every request: an id, a bound on its body, headers that protect, a log line, a measured time."""

from __future__ import annotations

import logging
import re
import time
from typing import Final
from uuid import uuid4

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.api.problems import problem_response
from service.errors import ServiceError, TooLargeError
from service.observability import Metrics

MAX_BODY_BYTES: Final = 1 << 20
"""Of requests that are read whole before anything looks at them; telemetry bounds its own."""

TELEMETRY: Final = "/telemetry"
"""How the paths end to which packets are sent."""
STREAMED: Final = (TELEMETRY, "/calibration-runs")
"""Likewise of all that read their bodies themselves, as they come, and bound them."""

SECURITY_HEADERS: Final = {
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Content-Security-Policy": "default-src 'none'; frame-ancestors 'none'",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}
"""On every answer that does not say otherwise."""

_REQUEST_ID: Final = re.compile(r"[A-Za-z0-9._-]{1,64}", flags=re.ASCII)
_QUIET_PATHS: Final = frozenset({"/livez", "/readyz", "/metrics"})

access_log = logging.getLogger("telefuse.access")
log = logging.getLogger(__name__)


class RequestContext:
    """Wraps the whole app; an error that nobody caught becomes a problem document here, and a line in the log."""

    def __init__(self, app: ASGIApp, metrics: Metrics | None) -> None:
        self._app = app
        self._metrics = metrics

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        started_s = time.perf_counter()
        given = Headers(scope=scope).get("x-request-id", "")
        request_id = given if _REQUEST_ID.fullmatch(given) else uuid4().hex
        scope.setdefault("state", {})["request_id"] = request_id
        status = 0

        async def send_with_headers(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
                headers = MutableHeaders(scope=message)
                for name, value in SECURITY_HEADERS.items():
                    headers.setdefault(name, value)
                headers["X-Request-Id"] = request_id
            await send(message)

        try:
            await self._app(scope, receive, send_with_headers)
        except Exception:
            log.exception("request failed", extra={"fields": {"request_id": request_id, "path": scope["path"]}})
            if status:
                raise  # the answer is on its way: only breaking the connection tells that it is not whole
            detail = "something went wrong on our side; quote the request_id to the operator"
            response = problem_response(scope, 500, "internal_error", detail)
            await response(scope, receive, send_with_headers)
        finally:
            self._note(scope, request_id, status, time.perf_counter() - started_s)

    def _note(self, scope: Scope, request_id: str, status: int, took_s: float) -> None:
        is_telemetry = scope["path"].endswith(TELEMETRY)
        # The operation's name, not the path: a metric must not grow with what callers make up.
        operation = "telemetry" if is_telemetry else getattr(scope.get("route"), "name", "unknown")
        if self._metrics is not None:
            self._metrics.http_request_seconds.labels(operation, str(status)).observe(took_s)
        quiet = status < 400 and (is_telemetry or scope["path"] in _QUIET_PATHS)
        principal = scope["state"].get("principal")
        # The path alone: neither headers nor the query, so that nothing secret can get into a log.
        fields = {
            "request_id": request_id,
            "method": scope["method"],
            "path": scope["path"],
            "status": status,
            "duration_ms": round(took_s * 1000, 2),
            "client": scope["client"][0] if scope.get("client") else None,
            "tenant": getattr(principal, "tenant_id", None),
            "key": getattr(principal, "key_id", None),
        }
        access_log.log(logging.DEBUG if quiet else logging.INFO, "request", extra={"fields": fields})


class BodyLimit:
    """Reads a request's body, no further than it may be long, before the app sees the request."""

    def __init__(self, app: ASGIApp, limit: int = MAX_BODY_BYTES) -> None:
        self._app = app
        self._limit = limit

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request."""
        if scope["type"] != "http" or scope["path"].endswith(STREAMED):
            await self._app(scope, receive, send)
            return
        try:
            body = await self._read(scope, receive)
        except ServiceError as error:
            await problem_response(scope, error.status, error.code, error.detail)(scope, receive, send)
            return
        if body is None:
            return
        given = False

        async def receive_again() -> Message:
            nonlocal given
            if given:
                return await receive()
            given = True
            return {"type": "http.request", "body": body, "more_body": False}

        await self._app(scope, receive_again, send)

    async def _read(self, scope: Scope, receive: Receive) -> bytes | None:
        """The body; None where the caller went away."""
        too_large = TooLargeError(f"the body is larger than {self._limit} bytes, the most that is taken here")
        declared = Headers(scope=scope).get("content-length", "")
        if declared.isdecimal() and int(declared) > self._limit:
            raise too_large
        chunks: list[bytes] = []
        size = 0
        while True:
            message = await receive()
            if message["type"] == "http.disconnect":
                return None
            chunk = message.get("body", b"")
            size += len(chunk)
            if size > self._limit:
                raise too_large
            chunks.append(chunk)
            if not message.get("more_body", False):
                return b"".join(chunks)
