"""Packets over Zenoh: the service's router or peer, what it takes from boxes, and what it tells them.

Zenoh closes a link whose callback stalls for five seconds and loses what follows without a word, so the
callback here only queues; and a packet that finds no room is dropped unacknowledged, for its box to send again.
"""

from __future__ import annotations

import logging
import queue
import threading
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from functools import partial
from typing import Any, Final

import zenoh
from prometheus_client import Gauge

from schemas.keys import KEY_ROOT, parse_key, zenoh_prefix
from service.errors import UsageError
from service.ingest.journal import BacklogError
from service.ingest.receiver import Receipt, Receiver, refused_of
from service.ingest.validation import MAX_PACKET_BYTES
from service.ingest.zenoh_publisher import Publisher
from service.ingest.zenoh_session import one_line, open_session, service_config
from service.observability import Metrics
from service.settings import Settings
from service.storage.vehicles import VehicleRef

log = logging.getLogger(__name__)

QUEUE_LIMIT: Final = 4096
"""Packets that may wait to be decoded: a burst of a fleet that reconnects; some 20 MB of usual ones."""

Presence = Callable[[str, str, bool], None]
"""Told with tenant, vehicle and whether its box is there."""


def _nobody(_tenant_id: str, _vehicle_id: str, _present: bool) -> None:
    return


class ZenohIngest:
    """Zenoh's side of the service. ``start`` opens it; ``endpoints`` then says where boxes connect."""

    def __init__(
        self, settings: Settings, receiver: Receiver, metrics: Metrics, *, on_presence: Presence = _nobody
    ) -> None:
        self._settings = settings
        self._receiver = receiver
        self._metrics = metrics
        self._on_presence = on_presence
        self._session: zenoh.Session | None = None
        self._subscriber: zenoh.Subscriber[None] | None = None
        self._presence: zenoh.Subscriber[None] | None = None
        self._publisher: Publisher | None = None
        self._queue: queue.Queue[tuple[str, zenoh.ZBytes] | None] = queue.Queue(QUEUE_LIMIT)
        self._thread = threading.Thread(target=self._drain, name="zenoh-ingest", daemon=True)
        self._present: set[str] = set()
        online = Gauge("telefuse_boxes_online", "Boxes that are connected over Zenoh.", registry=metrics.registry)
        online.set_function(lambda: len(self._present))
        self.endpoints: tuple[str, ...] = ()

    def start(self) -> None:
        """Open Zenoh and begin to take packets; does nothing where the mode is off. Raises UsageError."""
        if self._settings.zenoh_mode == "off":
            return
        try:
            config, self.endpoints = service_config(self._settings)
            self._session = open_session(config)
        except (zenoh.ZError, TimeoutError, OSError) as error:
            where = ", ".join((*self._settings.zenoh_listen, *self._settings.zenoh_connect))
            raise UsageError(
                f"Zenoh cannot be opened ({self._settings.zenoh_mode}, {where}): {one_line(error)}; "
                "is the port in use? Set zenoh_listen to another, or zenoh_mode to off"
            ) from error
        self._publisher = Publisher(self._session)
        self._thread.start()
        self._subscriber = self._session.declare_subscriber(f"{KEY_ROOT}/*/*/*/telemetry", self._on_packet)
        self._presence = self._session.liveliness().declare_subscriber(
            f"{KEY_ROOT}/*/*/*/alive", self._on_alive, history=True
        )

    def stop(self) -> None:
        """Take no more, tell what is decided, and close. Packets not taken stay with their boxes."""
        if self._session is None or self._subscriber is None or self._publisher is None:
            return
        self._subscriber.undeclare()  # type: ignore[no-untyped-call]
        self._queue.put(None)
        self._thread.join()
        self._publisher.stop()
        self._session.close()  # type: ignore[no-untyped-call]
        self._session = None

    def publish_state(self, ref: VehicleRef, state: Mapping[str, Any]) -> None:
        """Say how the vehicle is; at most once a second goes out, the newest."""
        if self._publisher is not None:
            self._publisher.state(zenoh_prefix(ref.tenant_id, ref.vehicle_id), state)

    def publish_event(self, ref: VehicleRef, event: Mapping[str, Any]) -> None:
        """Say what happened to the vehicle: a CloudEvent."""
        if self._publisher is not None:
            self._publisher.event(zenoh_prefix(ref.tenant_id, ref.vehicle_id), event)

    # --- on Zenoh's threads: never wait -----------------------------------------------------------

    def _on_packet(self, sample: zenoh.Sample) -> None:
        if sample.kind != zenoh.SampleKind.PUT:
            return
        key = str(sample.key_expr)
        if len(sample.payload) > MAX_PACKET_BYTES:
            self._refuse(key, "too_large")
            return
        try:
            self._queue.put_nowait((key, sample.payload))
        except queue.Full:
            self._metrics.packets_refused_total.labels(code="backlog").inc()

    def _on_alive(self, sample: zenoh.Sample) -> None:
        text = str(sample.key_expr)
        key = parse_key(text)
        if key is None or not key.bucket_is_right:
            return
        present = sample.kind == zenoh.SampleKind.PUT
        (self._present.add if present else self._present.discard)(text)
        self._on_presence(key.tenant_id, key.vehicle_id, present)

    # --- on the draining thread -------------------------------------------------------------------

    def _drain(self) -> None:
        while (item := self._queue.get()) is not None:
            key, payload = item
            try:
                self._take(key, payload.to_bytes())
            except BacklogError:
                self._metrics.packets_refused_total.labels(code="backlog").inc()
            except Exception:
                # Such as a database that cannot be reached: the box hears nothing and sends again.
                log.exception("a packet on %s could not be taken", key)

    def _take(self, text: str, data: bytes) -> None:
        key = parse_key(text)
        if key is None:
            self._refuse(text, "wrong_key")
        elif not key.bucket_is_right:
            self._refuse(text, "wrong_bucket")
        else:
            receipt = self._receiver.receive(key.tenant_id, data, transport="zenoh", vehicle_id=key.vehicle_id)
            receipt.add_done_callback(partial(self._acknowledge, text.rpartition("/")[0]))

    def _refuse(self, key: str, code: str) -> None:
        """Refuse a packet that was not looked into: there is no boot and sequence to name."""
        self._metrics.packets_received_total.labels(transport="zenoh").inc()
        self._metrics.packets_refused_total.labels(code=code).inc()
        if self._publisher is not None:
            self._publisher.ack(key.rpartition("/")[0], "", 0, [(0, code)])

    def _acknowledge(self, prefix: str, done: Future[Receipt]) -> None:
        if done.exception() is not None or self._publisher is None:
            return  # not durable, so not acknowledged
        receipt = done.result()
        floors = {boot_id: last for boot_id, _, last in receipt.skipped}
        floors[receipt.boot_id] = receipt.durable_sequence
        refused = refused_of(receipt)
        for boot_id, floor in floors.items():
            codes = [(sequence, code) for of_boot, sequence, code in refused if of_boot == boot_id]
            self._publisher.ack(prefix, boot_id, floor, codes, receipt.gap and boot_id == receipt.boot_id)
