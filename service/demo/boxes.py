"""The demo's black boxes: the same drive over Zenoh and over HTTP, by two vehicles."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final
from uuid import uuid4

from core.simulation.scenarios import simulate
from schemas.telemetry_pb2 import TelemetryPacket
from schemas.vehicles import VehicleConfig
from service.blackbox.box import BlackBox, BoxFigures, Link
from service.blackbox.http_link import HttpLink
from service.blackbox.zenoh_link import ZenohLink
from service.demo.service_process import ServiceProcess
from service.recordings.drive_folder import Drive
from service.recordings.fusing import vehicle_config
from service.recordings.packets import drive_packets
from service.recordings.simulated import drive_of
from service.storage.tenants import DEFAULT_TENANT

SCENARIO: Final = "tunnel_crash"
WIDE_SCENARIO: Final = "wide_sensor"
"""The same drive as ``SCENARIO``, by another sensor."""

SEED: Final = 1
GIVE_UP_AFTER_S: Final = 30.0
"""A box gives up once nothing was acknowledged for so long; the demo then says what was lost."""


@dataclass(frozen=True, slots=True)
class Box:
    """A vehicle of the demo with what its box recorded and how it sends it."""

    vehicle_id: str
    transport: str
    sensor: str
    drive: Drive

    @property
    def config(self) -> VehicleConfig:
        """How the box sits in its vehicle, as its drive says."""
        return vehicle_config(self.drive)

    def link(self, service: ServiceProcess) -> Link:
        """Its way to the service."""
        if self.transport == "zenoh":
            return ZenohLink(service.zenoh_endpoint, DEFAULT_TENANT, self.vehicle_id)
        return HttpLink(service.http_url)


def simulated_boxes() -> list[Box]:
    """One drive, recorded by a sensor that clips in the severe crash and by one that does not."""
    return [
        Box("demo-zenoh", "zenoh", "clips at 2 g", drive_of(simulate(SCENARIO, SEED))),
        Box("demo-http", "http", "16 g", drive_of(simulate(WIDE_SCENARIO, SEED))),
    ]


def recorded_boxes(drive: Drive) -> list[Box]:
    """A recording, sent by two vehicles."""
    return [Box(f"demo-{transport}", transport, "as recorded", drive) for transport in ("zenoh", "http")]


def send_all(boxes: Sequence[Box], service: ServiceProcess, progress: Callable[[int, int], None]) -> list[BoxFigures]:
    """Have every box send its drive, as fast as it is acknowledged; returns how it went for each."""
    boot_id = uuid4().hex
    queues = [list(drive_packets(box.drive, boot_id, vehicle_id=box.vehicle_id)) for box in boxes]
    senders = [BlackBox(box.link(service), boot_id) for box in boxes]
    total = sum(map(len, queues))
    threads = [
        threading.Thread(target=_send, args=(sender, packets), name=f"box-{box.vehicle_id}", daemon=True)
        for box, sender, packets in zip(boxes, senders, queues, strict=True)
    ]
    for thread in threads:
        thread.start()
    while any(thread.is_alive() for thread in threads):
        for thread in threads:
            thread.join(0.1)
        progress(sum(sender.figures.acknowledged for sender in senders), total)
    figures = [sender.figures for sender in senders]
    for sender in senders:
        sender.stop()
    return figures


def _send(sender: BlackBox, packets: Sequence[TelemetryPacket]) -> None:
    sender.start()
    for packet in packets:
        if not sender.put(packet, GIVE_UP_AFTER_S):
            return
    sender.wait_acknowledged(GIVE_UP_AFTER_S)
