"""The one way in for packets of every transport: decode, validate, find the vehicle, make durable, count."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Final, Literal

from schemas.packet import PacketError, decode, packet_from_json
from schemas.telemetry_pb2 import TelemetryPacket
from service.ingest.journal import BacklogError, Incoming, Journal, Outcome, Span, Status
from service.ingest.validation import MAX_PACKET_BYTES, REASONS, check_content, check_identity
from service.observability import Metrics
from service.storage.vehicles import VehicleDirectory, VehicleRef

Form = Literal["protobuf", "json"]

MAX_LISTED_GAPS: Final = 100
"""Given-up sequences named one by one in an answer; ``durable_sequence`` is beyond all of them anyway."""


@dataclass(frozen=True, slots=True)
class Receipt:
    """What became of a packet, for its sender.

    ``vehicle`` is None and the packet left no trace where it could not be read or its vehicle is unknown. Else
    the sender may forget every packet of ``boot_id`` up to ``durable_sequence``, this one too if it is refused.
    """

    status: Status
    code: str | None = None
    detail: str | None = None
    vehicle: VehicleRef | None = None
    vehicle_id: str = ""
    boot_id: str = ""
    sequence: int = 0
    durable_sequence: int = 0
    skipped: tuple[Span, ...] = ()
    gap: bool = False


def refused_of(receipt: Receipt) -> list[tuple[str, int, str]]:
    """(boot_id, sequence, code) of the packet, if it was refused, and of those that it caused to be given up on."""
    refused = (
        [(receipt.boot_id, receipt.sequence, receipt.code)] if receipt.status == "refused" and receipt.code else []
    )
    for boot_id, first, last in receipt.skipped:
        listed = range(first, min(last, first + MAX_LISTED_GAPS - 1) + 1)
        refused += [(boot_id, sequence, "gap_stepped_over") for sequence in listed]
    return refused


class Receiver:
    """Takes packets for the journal. ``is_busy`` says that what comes after the journal cannot keep up."""

    def __init__(
        self,
        directory: VehicleDirectory,
        journal: Journal,
        metrics: Metrics,
        *,
        is_busy: Callable[[], bool] = lambda: False,
        now_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        self._directory = directory
        self._journal = journal
        self._metrics = metrics
        self._is_busy = is_busy
        self._now_ns = now_ns

    def receive(
        self, tenant_id: str, data: bytes, *, transport: str, vehicle_id: str | None = None, form: Form = "protobuf"
    ) -> Future[Receipt]:
        """Take one packet of a tenant, and of ``vehicle_id`` if the sender's address says so.

        The future resolves when the packet is durable, or refused for good; it fails with JournalError. Raises
        BacklogError where nothing can be taken. May wait for the database, for a vehicle not met before.
        """
        received_ns = self._now_ns()
        self._metrics.packets_received_total.labels(transport=transport).inc()
        packet = TelemetryPacket()
        try:
            if len(data) > MAX_PACKET_BYTES:
                raise PacketError("too_large", f"{len(data)} bytes, expected at most {MAX_PACKET_BYTES}")
            packet = decode(data) if form == "protobuf" else packet_from_json(data)
            check_identity(packet, vehicle_id)
        except PacketError as error:
            return self._refuse(packet, error)
        refusal: PacketError | None = None
        try:
            check_content(packet, received_ns)
        except PacketError as error:
            refusal = error
        ref = self._directory.resolve(tenant_id, packet.vehicle_id)
        if ref is None:
            return self._refuse(
                packet, PacketError("unknown_vehicle", f"vehicle '{packet.vehicle_id}' is not registered")
            )
        if self._is_busy():
            raise BacklogError("packets come faster than they can be fused; send again in a second")
        payload = b"" if refusal else data if form == "protobuf" else packet.SerializeToString()
        incoming = Incoming(
            ref,
            packet.boot_id,
            packet.sequence,
            packet.start_time_ns,
            received_ns,
            payload,
            None if refusal is None else refusal.code,
        )
        return _receipt_of(self._journal.submit(incoming), incoming, refusal)

    def _refuse(self, packet: TelemetryPacket, error: PacketError) -> Future[Receipt]:
        self._metrics.packets_refused_total.labels(code=error.code).inc()
        future: Future[Receipt] = Future()
        future.set_result(
            Receipt(
                "refused",
                error.code,
                error.detail,
                vehicle_id=packet.vehicle_id,
                boot_id=packet.boot_id,
                sequence=packet.sequence,
            )
        )
        return future


def _receipt_of(journaled: Future[Outcome], incoming: Incoming, refusal: PacketError | None) -> Future[Receipt]:
    future: Future[Receipt] = Future()
    future.set_running_or_notify_cancel()  # what the journal has taken is not taken back

    def resolve(done: Future[Outcome]) -> None:
        error = done.exception()
        if error is not None:
            future.set_exception(error)
            return
        outcome = done.result()
        if outcome.code is None:
            detail = None
        elif refusal is not None and refusal.code == outcome.code:
            detail = refusal.detail
        else:
            detail = f"packet {incoming.sequence} of boot {incoming.boot_id}: {REASONS[outcome.code]}"
        future.set_result(
            Receipt(
                outcome.status,
                outcome.code,
                detail,
                None if outcome.code == "unknown_vehicle" else incoming.vehicle,
                incoming.vehicle.vehicle_id,
                incoming.boot_id,
                incoming.sequence,
                outcome.durable_sequence,
                outcome.skipped,
                outcome.gap,
            )
        )

    journaled.add_done_callback(resolve)
    return future
