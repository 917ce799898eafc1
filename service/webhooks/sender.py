"""The sender: takes what is due from the outbox, sends it and records the outcome, for ever.

One loop in the service's event loop. Each turn is one short transaction on a thread of its own, which
records what has finished and claims what is due; requests run between the turns, never inside one.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Final, ParamSpec, TypeVar

from sqlalchemy import Engine
from sqlalchemy.exc import SQLAlchemyError

from schemas.notifications import message
from service.observability import Metrics
from service.settings import Settings
from service.storage import database
from service.webhooks.claims import (
    ALERT_PREFIX,
    Claim,
    Outcome,
    Result,
    claim_due,
    next_due_ns,
    record,
    release_interrupted,
)
from service.webhooks.client import ClientLimits, Reply, WebhookClient
from service.webhooks.schedule import RetrySchedule, parse_retry_after
from service.webhooks.signing import sign
from service.webhooks.targets import Resolve

P = ParamSpec("P")
T = TypeVar("T")

logger = logging.getLogger(__name__)

USER_AGENT: Final = "telefuse-webhooks/1"


@dataclass(frozen=True, slots=True)
class SenderLimits:
    """Bounds of the sender.

    ``concurrency``: 1 or more; requests at the same time in all.
    ``per_endpoint``: 1 or more; to one endpoint. One whose last attempt failed gets a single one, so
    that dead receivers, each holding a request for the whole time-out, do not fill ``concurrency``.
    ``lease_s``: seconds, above ``client.total_s``; after it a claim of a dead process is sent again.
    ``poll_s``: seconds, > 0; how long events of other processes may go unnoticed (our own wake the sender).
    ``database_retry_s``: seconds, > 0; pause after the database failed.
    ``grace_s``: seconds, >= 0; what requests under way get to finish when the service stops.
    """

    concurrency: int = 256
    per_endpoint: int = 8
    lease_s: float = 30.0
    poll_s: float = 1.0
    database_retry_s: float = 1.0
    grace_s: float = 5.0
    client: ClientLimits = field(default_factory=ClientLimits)


class Sender:
    """Delivers the outbox's messages; ``run`` once, in the service's event loop."""

    def __init__(
        self,
        engine: Engine,
        settings: Settings,
        metrics: Metrics,
        *,
        clock: Callable[[], int] = time.time_ns,
        resolve: Resolve | None = None,
        limits: SenderLimits | None = None,
        schedule: RetrySchedule | None = None,
    ) -> None:
        self._engine = engine
        self._metrics = metrics
        self._clock = clock
        self._limits = limits or SenderLimits()
        self._schedule = schedule or RetrySchedule()
        self._client = WebhookClient(
            allow_private=settings.dangerous_allow_private_webhook_targets,
            limits=self._limits.client,
            resolve=resolve,
        )
        self._loop: asyncio.AbstractEventLoop | None = None
        self._wake = asyncio.Event()
        self._stopping = asyncio.Event()
        self._stopped = asyncio.Event()
        # SQLite has one sending process: whatever is claimed at its start was claimed by a dead one.
        self._release_first = engine.dialect.name == "sqlite"
        self._threads = ThreadPoolExecutor(1, thread_name_prefix="webhook-outbox")
        self._in_flight: dict[int, Claim] = {}
        self._tasks: set[asyncio.Task[None]] = set()
        self._results: list[Result] = []
        self._failing: set[str] = set()

    def notify(self) -> None:
        """Say, from any thread, that a transaction with new deliveries was committed."""
        if self._loop is not None:
            with suppress(RuntimeError):  # the loop was closed: nobody is to be woken any more
                self._loop.call_soon_threadsafe(self._wake.set)

    async def run(self) -> None:
        """Send until ``stop``; failures of receivers and of the database are survived."""
        self._loop = asyncio.get_running_loop()
        try:
            while not self._stopping.is_set():
                self._wake.clear()
                await self._sleep(await self._turn())
            await self._finish()
        except Exception:
            logger.exception("the webhook sender ended; deliveries wait in the database until the service is restarted")
            raise
        finally:
            for task in self._tasks:
                task.cancel()
            await self._client.aclose()
            self._threads.shutdown(wait=False)
            self._stopped.set()

    async def stop(self) -> None:
        """Send nothing new, give requests under way a moment, record what came of them."""
        self._stopping.set()
        self._wake.set()
        if self._loop is not None:
            await self._stopped.wait()

    async def _turn(self) -> float:
        """Record and claim, start the requests; returns the seconds to sleep unless woken."""
        results, self._results = self._results, []
        try:
            claims, next_ns = await self._on_thread(self._exchange, results, dict(self._in_flight), set(self._failing))
        except SQLAlchemyError as error:
            # Recording twice changes nothing, so it does not matter how far the transaction had come.
            self._results = results + self._results
            logger.warning("webhooks wait for the database: %s", error)
            return self._limits.database_retry_s
        for claim in claims:
            self._in_flight[claim.delivery_id] = claim
            task = asyncio.create_task(self._attempt(claim))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)
        if next_ns is None:
            return self._limits.poll_s
        return min(max(0.0, (next_ns - self._clock()) * 1e-9), self._limits.poll_s)

    def _exchange(
        self, results: list[Result], in_flight: dict[int, Claim], failing: set[str]
    ) -> tuple[list[Claim], int | None]:
        """One turn's transaction; runs on the outbox thread."""
        now_ns = self._clock()
        if self._release_first:
            with database.write(self._engine) as connection:
                release_interrupted(connection, now_ns)
            self._release_first = False
        with database.read(self._engine) as connection:
            due, next_ns = next_due_ns(connection, now_ns)
        if not due and not results:
            return [], next_ns
        slots = _Slots(self._limits, in_flight, failing)
        with database.write(self._engine) as connection:
            told = record(connection, results, now_ns, self._schedule)
            claims = claim_due(
                connection,
                now_ns,
                int(self._limits.lease_s * 1e9),
                slots.full_endpoints(),
                slots.take,
            )
            _, next_ns = next_due_ns(connection, now_ns)
        self._count(results, told)
        return claims, next_ns

    async def _attempt(self, claim: Claim) -> None:
        started = time.monotonic()
        try:
            outcome, reply = await self._send(claim)
        except asyncio.CancelledError:
            outcome, reply = Outcome.INTERRUPTED, Reply(None, "interrupted: the service was stopped")
        except Exception as error:
            logger.exception("webhook delivery %d failed unexpectedly", claim.delivery_id)
            outcome, reply = Outcome.FAILED, Reply(None, f"internal error: {type(error).__name__}")
        if outcome is Outcome.DELIVERED:
            self._failing.discard(claim.endpoint_id)
        elif outcome is Outcome.FAILED:
            self._failing.add(claim.endpoint_id)
        retry_after_s = None if reply.retry_after is None else parse_retry_after(reply.retry_after, self._clock())
        duration_ms = (time.monotonic() - started) * 1e3
        del self._in_flight[claim.delivery_id]
        self._results.append(Result(claim, outcome, duration_ms, reply.status_code, reply.error, retry_after_s))
        self._wake.set()

    async def _send(self, claim: Claim) -> tuple[Outcome, Reply]:
        body = message(claim.type, claim.t_ns, claim.body)
        now_ns = self._clock()
        timestamp_s = now_ns // 1_000_000_000
        headers = {
            "Content-Type": "application/json",
            "User-Agent": USER_AGENT,
            "Webhook-Id": claim.event_id,
            "Webhook-Timestamp": str(timestamp_s),
            "Webhook-Signature": sign(claim.secrets, claim.event_id, timestamp_s, body, now_ns),
        }
        reply = await self._client.post(claim.url, headers, body, lambda: self._observe_latency(claim))
        return _judge(reply)

    def _observe_latency(self, claim: Claim) -> None:
        # Only the first attempt: later ones measure the receiver.
        if claim.attempts == 1 and claim.type.startswith(ALERT_PREFIX):
            self._metrics.alert_latency_seconds.observe((self._clock() - claim.received_ns) * 1e-9)

    def _count(self, results: list[Result], told: list[str]) -> None:
        for result, outcome in zip(results, told, strict=True):
            self._metrics.webhook_deliveries_total.labels(outcome=outcome).inc()
            if outcome in ("dead", "gone"):
                claim = result.claim
                logger.warning("webhook delivery %d of event %s is %s", claim.delivery_id, claim.event_id, outcome)

    async def _on_thread(self, work: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
        return await asyncio.get_running_loop().run_in_executor(self._threads, partial(work, *args, **kwargs))

    async def _sleep(self, seconds: float) -> None:
        try:
            async with asyncio.timeout(seconds):
                await self._wake.wait()
        except TimeoutError:
            return

    async def _finish(self) -> None:
        if self._tasks:
            _, late = await asyncio.wait(self._tasks, timeout=self._limits.grace_s)
            for task in late:
                task.cancel()
            if late:
                await asyncio.wait(late)
        results, self._results = self._results, []
        try:
            await self._on_thread(self._record_only, results)
        except SQLAlchemyError as error:
            logger.warning("%d webhook outcomes were not recorded, these are sent again: %s", len(results), error)

    def _record_only(self, results: list[Result]) -> None:
        with database.write(self._engine) as connection:
            told = record(connection, results, self._clock(), self._schedule)
        self._count(results, told)


class _Slots:
    """Free places for requests during one turn, in all and to each endpoint."""

    def __init__(self, limits: SenderLimits, in_flight: dict[int, Claim], failing: set[str]) -> None:
        self._limits = limits
        self._failing = failing
        self._taken = set(in_flight)
        self._used = Counter(claim.endpoint_id for claim in in_flight.values())

    def take(self, delivery_id: int, endpoint_id: str) -> bool:
        """Take a place for a delivery, if there is one."""
        if delivery_id in self._taken or len(self._taken) >= self._limits.concurrency or self._is_full(endpoint_id):
            return False
        self._taken.add(delivery_id)
        self._used[endpoint_id] += 1
        return True

    def full_endpoints(self) -> list[str]:
        """Endpoints for which there is no place now."""
        return [endpoint_id for endpoint_id in self._used if self._is_full(endpoint_id)]

    def _is_full(self, endpoint_id: str) -> bool:
        return self._used[endpoint_id] >= (1 if endpoint_id in self._failing else self._limits.per_endpoint)


def _judge(reply: Reply) -> tuple[Outcome, Reply]:
    """What a reply means: 2xx is success, 410 an endpoint that is gone, anything else a failure."""
    status = reply.status_code
    if status is None:
        return Outcome.FAILED, reply
    if 200 <= status < 300:
        return Outcome.DELIVERED, reply
    text = f"HTTP {status}"
    if 300 <= status < 400:
        text += ": redirects are not followed; register the final address"
    if status == 410:
        return Outcome.GONE, replace(reply, error=text)
    asked = reply.retry_after if status in (429, 503) else None
    return Outcome.FAILED, replace(reply, error=text, retry_after=asked)
