"""Simulated vehicles for a load test: a few drives with crashes, sent by many boxes that never run out of them."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from core.simulation.scenarios import simulate
from schemas.telemetry_pb2 import TelemetryPacket
from service.blackbox.box import BlackBox, Link, LinkListener, Outgoing
from service.recordings.packets import drive_packets
from service.recordings.simulated import drive_of

SCENARIO: Final = "crash_series"
SEEDS: Final = (1, 2)
DRIVE_S: Final = 600.0
"""Long enough for three crashes each: far more than any fleet has, so that there are alerts to be measured."""

PARKED_NS: Final = 600 * 1_000_000_000
"""Pause before a vehicle drives the same again."""

GOLDEN_RATIO: Final = (math.sqrt(5.0) - 1.0) / 2.0

REPEAT_EVERY: Final = 50
"""One packet in so many goes out twice, as on a bad radio link; the service must take it once."""


@dataclass(frozen=True, slots=True)
class RecordedDrive:
    """A drive's packets, and the time after which it may be driven again."""

    packets: tuple[TelemetryPacket, ...]
    period_ns: int

    def endless(self, vehicle_id: str, boot_id: str, first: int) -> Iterator[TelemetryPacket]:
        """Packets of one boot of a vehicle, for ever, from packet ``first`` of the drive on."""
        for sequence in itertools.count(1):
            lap, at = divmod(first + sequence - 1, len(self.packets))
            packet = TelemetryPacket()
            packet.CopyFrom(self.packets[at])
            packet.vehicle_id = vehicle_id
            packet.boot_id = boot_id
            packet.sequence = sequence
            packet.start_time_ns += lap * self.period_ns
            yield packet


def record_drives(rate_hz: float) -> tuple[RecordedDrive, ...]:
    """The drives that the whole fleet shares, at this rate of inertial samples."""
    drives = []
    for seed in SEEDS:
        packets = tuple(drive_packets(drive_of(simulate(SCENARIO, seed, DRIVE_S, rate_hz)), "recording"))
        span_ns = packets[-1].start_time_ns - packets[0].start_time_ns
        drives.append(RecordedDrive(packets, span_ns + PARKED_NS))
    return tuple(drives)


class RepeatingLink:
    """A link that sends one packet in ``REPEAT_EVERY`` twice; ``offset`` says which."""

    def __init__(self, link: Link, offset: int) -> None:
        self._link = link
        self._offset = offset
        self.repeated = 0

    def open(self, listener: LinkListener) -> None:
        """Note whom to tell."""
        self._link.open(listener)

    def send(self, packets: Sequence[Outgoing]) -> None:
        """Send packets, then some of them again; raises LinkError."""
        self._link.send(packets)
        again = [packet for packet in packets if (packet.sequence + self._offset) % REPEAT_EVERY == 0]
        if again:
            self._link.send(again)
            self.repeated += len(again)

    def close(self) -> None:
        """Let go of everything."""
        self._link.close()


class SimulatedVehicle:
    """The box of the fleet's vehicle ``number``, with all that it will ever have to send."""

    def __init__(self, vehicle_id: str, boot_id: str, link: Link, drives: Sequence[RecordedDrive], number: int) -> None:
        self.vehicle_id = vehicle_id
        self.link = RepeatingLink(link, number)
        self.box = BlackBox(self.link, boot_id)
        drive = drives[number % len(drives)]
        # However many vehicles there are, these steps spread their crashes evenly over the test.
        first = int(len(drive.packets) * (number * GOLDEN_RATIO % 1.0))
        self._packets = drive.endless(vehicle_id, boot_id, first)

    def send_next(self, timeout_s: float) -> bool:
        """Give the box its next packet; False if it had no room in time."""
        return self.box.put(next(self._packets), timeout_s)
