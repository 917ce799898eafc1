"""A sender at work on a real database with a clock that tests turn, and what they look at in between."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Callable
from typing import Final
from uuid import uuid4

from sqlalchemy import Engine, insert, select

from service.observability import Metrics
from service.settings import Settings
from service.storage import tenants
from service.storage.database import read, write
from service.storage.tables import deliveries, delivery_attempts, webhook_endpoints
from service.webhooks.client import ClientLimits
from service.webhooks.outbox import NewEvent, publish
from service.webhooks.sender import Sender, SenderLimits
from service.webhooks.signing import Secret, new_secret, secrets_to_json

S = 10**9

FAST: Final = SenderLimits(poll_s=60.0, database_retry_s=0.02, client=ClientLimits(total_s=0.3, drain_s=0.1))
"""Time-outs that a test can wait for."""


def eventually(condition: Callable[[], object], timeout_s: float = 10.0):
    """The condition's value, once it is true."""
    end = time.monotonic() + timeout_s
    while not (value := condition()):
        if time.monotonic() > end:
            raise AssertionError(f"still not true after {timeout_s} s")
        time.sleep(0.005)
    return value


class Clock:
    """UTC nanoseconds that stand still until they are advanced."""

    def __init__(self) -> None:
        self.now_ns = time.time_ns()

    def __call__(self) -> int:
        return self.now_ns

    def advance(self, seconds: float) -> None:
        self.now_ns += int(seconds * S)


class RunningSender:
    """A sender in an event loop of its own; leaving the block stops it gracefully."""

    def __init__(
        self, engine: Engine, clock: Callable[[], int] = time.time_ns, *, private: bool = True, **options
    ) -> None:
        self.metrics = Metrics()
        settings = Settings(dangerous_allow_private_webhook_targets=private)
        options.setdefault("limits", SenderLimits(poll_s=60.0, database_retry_s=0.02))
        self.sender = Sender(engine, settings, self.metrics, clock=clock, **options)
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_until_complete, args=(self.sender.run(),))

    def __enter__(self) -> RunningSender:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        asyncio.run_coroutine_threadsafe(self.sender.stop(), self._loop)
        self._thread.join(30)
        assert not self._thread.is_alive()
        self._loop.close()

    def notify(self) -> None:
        self.sender.notify()

    @property
    def has_begun(self) -> bool:
        """Whether it has released what a dead predecessor had claimed."""
        return not self.sender._release_first

    def count(self, outcome: str) -> float:
        value = self.metrics.registry.get_sample_value("telefuse_webhook_deliveries_total", {"outcome": outcome})
        return value or 0.0


class Outbox:
    """What the tests put into the database and read from it."""

    def __init__(self, engine: Engine, clock: Callable[[], int] = time.time_ns, tenant_id: str = "acme") -> None:
        self.engine = engine
        self.clock = clock
        self.tenant_id = tenant_id
        with write(engine) as connection:
            tenants.ensure(connection, tenant_id)

    def add_endpoint(self, url: str, types: tuple[str, ...] = (), status: str = "enabled") -> tuple[str, str]:
        """Its id and secret."""
        endpoint_id, secret = str(uuid4()), new_secret()
        with write(self.engine) as connection:
            connection.execute(
                insert(webhook_endpoints).values(
                    id=endpoint_id,
                    tenant_id=self.tenant_id,
                    url=url,
                    description="",
                    types=list(types),
                    secrets=secrets_to_json([Secret(secret)]),
                    status=status,
                    created_ns=self.clock(),
                    updated_ns=self.clock(),
                )
            )
        return endpoint_id, secret

    def publish(self, event_id: str | None = None, type: str = "accident.detected", **body) -> str:
        event_id = event_id or str(uuid4())
        with write(self.engine) as connection:
            self.publish_in(connection, event_id, type, **body)
        return event_id

    def publish_in(self, connection, event_id: str, type: str = "accident.detected", **body) -> bool:
        now_ns = self.clock()
        event = NewEvent(event_id, self.tenant_id, None, type, now_ns - 2 * S, now_ns - S, body or {"speed_mps": 12.5})
        return publish(connection, event, now_ns)

    def deliveries(self, **where) -> list:
        statement = select(deliveries).order_by(deliveries.c.id)
        for name, value in where.items():
            statement = statement.where(deliveries.c[name] == value)
        with read(self.engine) as connection:
            return list(connection.execute(statement))

    def delivery(self, event_id: str, endpoint_id: str | None = None):
        (row,) = self.deliveries(event_id=event_id, **({"endpoint_id": endpoint_id} if endpoint_id else {}))
        return row

    def attempts(self, delivery_id: int) -> list:
        table = delivery_attempts
        with read(self.engine) as connection:
            return list(
                connection.execute(select(table).where(table.c.delivery_id == delivery_id).order_by(table.c.id))
            )

    def endpoint_status(self, endpoint_id: str) -> str:
        with read(self.engine) as connection:
            return connection.execute(
                select(webhook_endpoints.c.status).where(webhook_endpoints.c.id == endpoint_id)
            ).scalar_one()
