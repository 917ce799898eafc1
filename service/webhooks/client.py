"""One webhook request: guarded target, no redirects, no proxy, a bound on everything the receiver does."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import httpcore
import httpx

from service.webhooks.targets import GuardedBackend, Resolve, TargetError, check_url, system_resolver


@dataclass(frozen=True, slots=True)
class ClientLimits:
    """Bounds on one request and on the connections.

    ``total_s``: seconds, > 0; the whole attempt from name lookup to response (the interface's 15 s).
    ``connect_s``: seconds, > 0, for one address, so that a dead first address leaves time for the next.
    ``drain_bytes``, ``drain_s``: how much of a response's body is read, and how long, only so that the
    connection can be used again; the status has decided by then.
    ``keepalive_s``: seconds, >= 0; idle connections are closed after it, before common servers do (60 s).
    ``connections``: 1 or more; open connections in all.
    ``lookup_threads``: 1 or more; names looked up at the same time.
    """

    total_s: float = 15.0
    connect_s: float = 5.0
    drain_bytes: int = 4096
    drain_s: float = 1.0
    keepalive_s: float = 30.0
    connections: int = 256
    lookup_threads: int = 16


@dataclass(frozen=True, slots=True)
class Reply:
    """What came back: a status, or ``error`` where there was none."""

    status_code: int | None
    error: str | None = None
    retry_after: str | None = None


class WebhookClient:
    """Posts messages over kept-alive connections to checked addresses.

    Uses httpcore rather than httpx's client: that one takes proxies from the environment, which would
    connect around the guard.
    """

    def __init__(self, *, allow_private: bool, limits: ClientLimits, resolve: Resolve | None = None) -> None:
        self._limits = limits
        self._allow_private = allow_private
        self._lookups = ThreadPoolExecutor(limits.lookup_threads, thread_name_prefix="webhook-lookup")
        self._pool = httpcore.AsyncConnectionPool(
            ssl_context=httpx.create_ssl_context(),
            max_connections=limits.connections,
            keepalive_expiry=limits.keepalive_s,
            network_backend=GuardedBackend(resolve or system_resolver(self._lookups), allow_private=allow_private),
        )

    async def post(self, url: str, headers: Mapping[str, str], body: bytes, on_sent: Callable[[], None]) -> Reply:
        """Send one request; ``on_sent`` is called when its last byte was written. Failures are replies, too."""
        reply: Reply | None = None
        try:
            async with asyncio.timeout(self._limits.total_s):
                target = check_url(url, allow_private=self._allow_private)
                async with self._pool.stream(
                    "POST",
                    httpcore.URL(
                        scheme=target.raw_scheme, host=target.raw_host, port=target.port, target=target.raw_path
                    ),
                    headers=[(b"Host", target.netloc), *((k.encode(), v.encode()) for k, v in headers.items())],
                    content=body,
                    extensions={"timeout": {"connect": self._limits.connect_s}, "trace": _tell_when_sent(on_sent)},
                ) as response:
                    reply = Reply(response.status, None, _header(response, b"retry-after"))
                    await self._drain(response)
        except TimeoutError:
            return reply or Reply(None, f"timeout: no response within {self._limits.total_s:g} s")
        except TargetError as error:
            return Reply(None, f"{error.code}: {error.detail}")
        except (httpcore.NetworkError, httpcore.TimeoutException, httpcore.ProtocolError, OSError) as error:
            # Once there is a status, what happens to the rest of the response is of no interest.
            return reply or Reply(None, f"{type(error).__name__}: {error}".rstrip(": "))
        return reply

    async def aclose(self) -> None:
        """Close all connections."""
        await self._pool.aclose()
        self._lookups.shutdown(wait=False, cancel_futures=True)

    async def _drain(self, response: httpcore.Response) -> None:
        size = 0
        try:
            async with asyncio.timeout(self._limits.drain_s):
                async for chunk in response.aiter_stream():
                    size += len(chunk)
                    if size > self._limits.drain_bytes:
                        return
        except TimeoutError:
            return


def _tell_when_sent(on_sent: Callable[[], None]) -> Callable[[str, object], object]:
    async def trace(name: str, _info: object) -> None:
        if name == "http11.send_request_body.complete":
            on_sent()

    return trace


def _header(response: httpcore.Response, wanted: bytes) -> str | None:
    return next((value.decode("latin-1") for name, value in response.headers if name.lower() == wanted), None)
