"""The load test: how many packets a second a service keeps up with, and how soon it tells of a crash.

Throughput and latency are measured apart. A saturated service has a queue, and the time spent in a queue says how
long it was let grow; so latency is taken at a fixed share of the throughput that was just found.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import Final
from uuid import uuid4

import numpy as np

from service.bench.fleet import RecordedDrive, SimulatedVehicle
from service.bench.target import Address, Counts, Target, TargetFailedError
from service.demo.alert_receiver import AlertReceiver

UNDER_WAY: Final = 2048
"""Packets between box and track while saturated: above what comes through between two looks at the service,
and few enough that the service's memory and journal stay those of a service that keeps up."""

UNDER_WAY_PER_VEHICLE: Final = 64
"""The same of one vehicle: well below what a box keeps."""

LATENCY_LOAD: Final = 0.5
"""Share of the throughput at which latency is measured: what one would run a machine at."""

CONNECT_TOGETHER: Final = 50
"""Boxes that connect at once; a thousand would time out waiting for each other on one machine."""

WARM_UP_PACKETS: Final = 15
"""Of each vehicle, before the test: a session aligns within some seconds of driving, once."""

POLL_S: Final = 0.05
PACE_S: Final = 0.002
PATIENCE_S: Final = 60.0
"""How long nothing may move before the test gives up."""

DELIVERED_WITHIN_S: Final = 15.0

Tell = Callable[[str, float, float], None]
"""Told what is going on, how much of it is done, and how much there is."""


@dataclass(frozen=True, slots=True)
class LoadFigures:
    """What the load test found. ``duplicates_sent`` were meant, ``resent`` the boxes' own doing.

    ``latencies_ms`` is one for each crash of the second part, from the packet's arrival at the service to its alert's
    arrival at the receiver; None where the service refuses to send to this machine.
    """

    vehicles: int
    seconds: float
    packets_per_s: float
    sent: int
    acknowledged: int
    counted: Counts
    resent: int
    duplicates_sent: int
    latency_load_per_s: float
    latencies_ms: tuple[float, ...] | None
    accidents: int
    alerts: int

    @property
    def lost(self) -> int:
        """Packets that were sent, or even taken, and not fused."""
        return max(0, max(self.sent, self.counted.accepted) - self.counted.fused)

    @property
    def duplicates_applied(self) -> int:
        """Packets that were taken or fused more than once."""
        return max(0, max(self.counted.accepted, self.counted.fused) - self.sent)

    def latency_ms(self, percent: float) -> float | None:
        """A percentile of the latencies."""
        return float(np.percentile(self.latencies_ms, percent)) if self.latencies_ms else None

    def shortfalls(self) -> list[str]:
        """What a service must never do and did."""
        short = []
        if self.lost:
            short.append(f"{self.lost} of {self.sent} packets were lost")
        if self.duplicates_applied:
            short.append(f"{self.duplicates_applied} packets were applied twice")
        if self.latencies_ms is not None and self.alerts < self.accidents:
            short.append(f"{self.accidents - self.alerts} of {self.accidents} accidents brought no alert")
        return short


def measure(
    address: Address, drives: Sequence[RecordedDrive], vehicles: int, seconds: float, tell: Tell
) -> LoadFigures:
    """Load a service that is ready and has no other traffic, for twice ``seconds`` and what it takes to settle."""
    run_id = uuid4().hex[:8]
    names = [f"bench-{run_id}-{number:04d}" for number in range(1, vehicles + 1)]
    with AlertReceiver() as receiver, Target(address) as target:
        target.register(names)
        secret = target.listen(receiver.url)
        receiver.secret = secret or ""
        fleet = [
            SimulatedVehicle(name, run_id, address.link(name), drives, number) for number, name in enumerate(names)
        ]
        with _Fleet(target, fleet, tell) as driver:
            driver.connect()
            packets_per_s = driver.saturate(seconds)
            paced_from_ns = time.time_ns()
            latency_load_per_s = LATENCY_LOAD * packets_per_s
            driver.pace(latency_load_per_s, seconds)
        accidents = target.accidents(names)
        latencies_ms, alerts = None, 0
        if secret is not None:
            arrived_ns = _await_alerts(receiver, accidents)
            alerts = len(arrived_ns)
            latencies_ms = tuple(
                (arrived_ns[name] - received_ns) * 1e-6
                for name, received_ns in accidents.items()
                if received_ns >= paced_from_ns and name in arrived_ns
            )
    figures = [vehicle.box.figures for vehicle in fleet]
    return LoadFigures(
        vehicles=vehicles,
        seconds=seconds,
        packets_per_s=packets_per_s,
        sent=sum(one.sent for one in figures),
        acknowledged=sum(one.acknowledged for one in figures),
        counted=driver.counted,
        resent=sum(one.resent for one in figures),
        duplicates_sent=sum(vehicle.link.repeated for vehicle in fleet),
        latency_load_per_s=latency_load_per_s,
        latencies_ms=latencies_ms,
        accidents=len(accidents),
        alerts=alerts,
    )


def _await_alerts(receiver: AlertReceiver, accidents: Collection[str]) -> dict[str, int]:
    """When the first alert of each of these accidents arrived, UTC nanoseconds."""
    came = receiver.wait_until(lambda received: len(received) >= len(accidents), DELIVERED_WITHIN_S)
    arrived_ns = {one.message["data"]["accident_id"]: one.arrived_ns for one in reversed(came) if one.verified}
    return {name: arrived_ns[name] for name in accidents if name in arrived_ns}


class _Fleet:
    """Drives all vehicles from one thread, and watches what the service has fused."""

    def __init__(self, target: Target, vehicles: Sequence[SimulatedVehicle], tell: Tell) -> None:
        self._target = target
        self._vehicles = vehicles
        self._started: list[SimulatedVehicle] = []
        self._next = itertools.cycle(vehicles)
        self._tell = tell
        self._given = 0
        self._before = Counts(0, 0)
        self.counted = Counts(0, 0)

    def __enter__(self) -> _Fleet:
        self._before = self._target.counts()
        return self

    def __exit__(self, *_: object) -> None:
        for vehicle in self._started:
            vehicle.box.stop()

    def connect(self) -> None:
        """Send every vehicle's first packets, so that all are connected, known and aligned before a clock runs."""
        for first in range(0, len(self._vehicles), CONNECT_TOGETHER):
            self._tell("connecting", first, len(self._vehicles))
            for vehicle in self._vehicles[first : first + CONNECT_TOGETHER]:
                vehicle.box.start()
                self._started.append(vehicle)
                self._send_next(vehicle)
            self._await_acknowledged("connecting")
        for _ in range(WARM_UP_PACKETS - 1):
            self._send(len(self._vehicles))
            self._await_acknowledged("connecting")
        self._settle("connecting")

    def saturate(self, seconds: float) -> float:
        """Send as fast as packets are fused; returns packets a second, from the first sent to the last one fused."""
        given, started_s = self._given, time.monotonic()
        under_way = min(UNDER_WAY, UNDER_WAY_PER_VEHICLE * len(self._vehicles))
        while (elapsed_s := time.monotonic() - started_s) < seconds:
            self._tell("throughput", elapsed_s, seconds)
            self._send(under_way - (self._given - self.counted.fused))
            time.sleep(POLL_S)
            self._look()
        self._settle("throughput")
        return (self._given - given) / (time.monotonic() - started_s)

    def pace(self, packets_per_s: float, seconds: float) -> None:
        """Send at a steady rate, whatever the service does."""
        given, started_s = self._given, time.monotonic()
        while (elapsed_s := time.monotonic() - started_s) < seconds:
            self._tell("latency", elapsed_s, seconds)
            self._send(given + int(packets_per_s * elapsed_s) - self._given)
            time.sleep(PACE_S)
        self._settle("latency")

    def _send(self, count: int) -> None:
        for _ in range(count):
            self._send_next(next(self._next))

    def _send_next(self, vehicle: SimulatedVehicle) -> None:
        if not vehicle.send_next(PATIENCE_S):
            raise TargetFailedError(f"{vehicle.vehicle_id} cannot send: {vehicle.box.trouble or 'no answer'}")
        self._given += 1

    def _settle(self, what: str) -> None:
        """Wait until all that was given is acknowledged and fused, or nothing moves any more."""
        self._await_acknowledged(what)
        moved_s = time.monotonic()
        while self.counted.fused < self._given and time.monotonic() - moved_s < PATIENCE_S:
            time.sleep(POLL_S)
            if self._look():
                moved_s = time.monotonic()

    def _await_acknowledged(self, what: str) -> None:
        for vehicle in self._started:
            if not vehicle.box.wait_acknowledged(PATIENCE_S):
                raise TargetFailedError(
                    f"{what}: {vehicle.vehicle_id} is not answered: {vehicle.box.trouble or 'no answer'}"
                )

    def _look(self) -> bool:
        """Ask how much is fused; whether that is more than before."""
        before, self.counted = self.counted, self._target.counts().since(self._before)
        return self.counted.fused > before.fused
