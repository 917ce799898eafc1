"""What each stage of a packet's way could do by itself: the service's own parts, one after the other, each alone.

None of them can be as fast in the service, where all share the processors and the interpreter's lock; the least
of these limits says where to look first.
"""

from __future__ import annotations

import itertools
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path
from typing import Final
from uuid import uuid4

import zenoh
from sqlalchemy import Engine as Database

from core.measurements import Measurements
from core.session import Outputs
from schemas.keys import KEY_ROOT
from schemas.packet import decode, measurements_from_packet
from schemas.vehicles import VehicleConfig
from service.bench.fleet import RecordedDrive
from service.bench.target import MOUNTING
from service.blackbox.box import Ack, LinkError, Outgoing
from service.blackbox.zenoh_link import ZenohLink
from service.engine.checkpoints import Checkpoint
from service.engine.effects import Effects
from service.engine.sessions import open_session, warm_up
from service.engine.shard import EngineConfig
from service.ingest.journal import Incoming, Journal, Outcome
from service.ingest.journal_rows import JournalEntry
from service.ingest.sequencing import Sequencer
from service.ingest.validation import check_content, check_identity
from service.ingest.zenoh_session import open_session as open_zenoh
from service.ingest.zenoh_session import service_config
from service.settings import Settings
from service.storage import schema, webhooks
from service.storage.database import open_database, write
from service.storage.tenants import DEFAULT_TENANT
from service.storage.vehicles import VehicleDirectory, VehicleRef
from service.storage.webhooks import EndpointRow
from service.webhooks import signing

BUDGET_S: Final = 1.0
"""How long each stage runs."""

VEHICLES: Final = 256
"""Of the stages with a database; the engine stores at most twice as many packets in a transaction."""

JOURNAL_UNDER_WAY: Final = 1024
"""Packets that wait for the journal at once: what it commits together at the most."""

MATCHED_WITHIN_S: Final = 10.0

STAGES: Final = ("receive", "decode", "journal", "fuse", "store")


@dataclass(frozen=True, slots=True)
class StageFigures:
    """Packets a second of each stage, by its name; ``fusion_ns_per_epoch`` is the whole session's, per sample."""

    limits_per_s: dict[str, float]
    fusion_ns_per_epoch: float


@dataclass(frozen=True, slots=True, eq=False)
class _Fused:
    """One drive through one session."""

    outputs: tuple[Outputs, ...]
    snapshot: bytes


def measure(drive: RecordedDrive, directory: Path, tell: Callable[[int], None]) -> StageFigures:
    """Measure every stage on a drive's packets, with databases in ``directory``; ``tell`` gets how many are done."""
    data = [packet.SerializeToString() for packet in drive.packets]
    limits: dict[str, float] = {}

    def done(name: str, per_s: float) -> None:
        limits[name] = per_s
        tell(len(limits))

    done("receive", _receive(data))
    done("decode", _decode(data))
    done("journal", _journal(data, directory / "journal.db"))
    per_s, ns_per_epoch, fused = _fuse([measurements_from_packet(packet) for packet in drive.packets])
    done("fuse", per_s)
    done("store", _store(drive, fused, directory / "store.db"))
    return StageFigures(limits, ns_per_epoch)


def _receive(data: Sequence[bytes]) -> float:
    """From a box's link over TCP on loopback to the service's callback; both ends in this process."""
    settings = Settings(
        zenoh_mode="router", zenoh_listen=("tcp/127.0.0.1:0",), zenoh_connect=(), zenoh_config=None, auth="on"
    )
    config, endpoints = service_config(settings)
    came = 0

    def on_packet(sample: zenoh.Sample) -> None:
        nonlocal came
        came += len(sample.payload) > 0

    with open_zenoh(config) as router:
        subscriber = router.declare_subscriber(f"{KEY_ROOT}/*/*/*/telemetry", on_packet)
        link = ZenohLink(endpoints[0], DEFAULT_TENANT, "bench")
        link.open(_NobodyListens())
        _await(lambda: _goes_out(link, data[0]))
        _await(lambda: came == 1)
        started_s, sent = time.perf_counter(), 0
        for content in _repeated(data, started_s):
            link.send([Outgoing(1, content, urgent=False)])
            sent += 1
        _await(lambda: came == 1 + sent)
        per_s = sent / (time.perf_counter() - started_s)
        link.close()
        subscriber.undeclare()  # type: ignore[no-untyped-call]
    return per_s


class _NobodyListens:
    """A link's listener where no acknowledgement is expected."""

    def on_ack(self, ack: Ack) -> None:
        """Nothing is kept."""

    def on_connected(self) -> None:
        """Nothing is to be sent again."""


def _goes_out(link: ZenohLink, content: bytes) -> bool:
    try:
        link.send([Outgoing(1, content, urgent=False)])
    except LinkError:  # the router's subscriber is not known to the box yet
        return False
    return True


def _decode(data: Sequence[bytes]) -> float:
    """From bytes to a packet that is known to be sound."""
    started_s, count = time.perf_counter(), 0
    for content in _repeated(data, started_s):
        packet = decode(content)
        check_identity(packet)
        check_content(packet, time.time_ns())
        count += 1
    return count / (time.perf_counter() - started_s)


def _journal(data: Sequence[bytes], file: Path) -> float:
    """From a sound packet to one that is durable: group commits into SQLite, each fsynced."""
    database, vehicles = _database(file)
    journal = Journal(database, lambda _entries: None)
    journal.start()
    waiting: deque[Future[Outcome]] = deque()
    started_s, count = time.perf_counter(), 0
    for content in _repeated(data, started_s):
        if len(waiting) >= JOURNAL_UNDER_WAY:
            waiting.popleft().result()
        sequence, number = divmod(count, len(vehicles))
        start_t_ns = sequence * 1_000_000_000
        waiting.append(
            journal.submit(Incoming(vehicles[number], "bench", sequence + 1, start_t_ns, time.time_ns(), content))
        )
        count += 1
    for future in waiting:
        future.result()
    per_s = count / (time.perf_counter() - started_s)
    journal.stop()
    database.dispose()
    return per_s


def _fuse(measurements: Sequence[Measurements]) -> tuple[float, float, _Fused]:
    """A session's steps; also nanoseconds a sample, and what one drive brought."""
    warm_up()
    fused = _fold(measurements)  # not timed: what the warm-up does not reach may have to be compiled
    samples = sum(len(packet.imu_t_ns) for packet in measurements)
    spent_s, laps = 0.0, 0
    while spent_s < BUDGET_S:
        started_s = time.perf_counter()
        _fold(measurements)
        spent_s += time.perf_counter() - started_s
        laps += 1
    return laps * len(measurements) / spent_s, 1e9 * spent_s / (laps * samples), fused


def _fold(measurements: Sequence[Measurements]) -> _Fused:
    session = open_session(VehicleConfig.model_validate(MOUNTING), (), None)
    return _Fused(tuple([session.step(packet) for packet in measurements]), session.snapshot())


def _store(drive: RecordedDrive, fused: _Fused, file: Path) -> float:
    """From a session's outputs to rows, events, deliveries and checkpoints in SQLite: transactions of a packet of
    each vehicle, as of a fleet in real time; more packets of fewer vehicles would cost less."""
    database, vehicles = _database(file)
    engine = EngineConfig()
    with write(database) as connection:
        webhooks.add_endpoint(connection, _endpoint())
    started_s, count = time.perf_counter(), 0
    for turn, (packet, outputs) in enumerate(zip(drive.packets, fused.outputs, strict=True)):
        batch = []
        for number, ref in enumerate(vehicles):
            effects = Effects(ref, round(engine.track_interval_s * 1e9))
            entry = JournalEntry(turn, ref.pk, "bench", packet.sequence, packet.start_time_ns, time.time_ns(), b"")
            effects.add(outputs, entry)
            if (turn + number) % round(engine.checkpoint_interval_s) == 0:
                effects.checkpoint = Checkpoint(turn, Sequencer().to_json(), fused.snapshot)
            batch.append(effects)
        with write(database) as connection:
            for effects in batch:
                effects.store(connection, time.time_ns())
        count += len(vehicles)
        if time.perf_counter() - started_s > BUDGET_S:
            break
    per_s = count / (time.perf_counter() - started_s)
    database.dispose()
    return per_s


def _database(file: Path) -> tuple[Database, list[VehicleRef]]:
    database = open_database(f"sqlite:///{file}")
    schema.upgrade(database)
    directory = VehicleDirectory(database, open_registration=True)
    found = [directory.resolve(DEFAULT_TENANT, f"bench-{number}") for number in range(VEHICLES)]
    return database, [ref for ref in found if ref is not None]


def _endpoint() -> EndpointRow:
    now_ns = time.time_ns()
    return EndpointRow(
        id=str(uuid4()),
        tenant_id=DEFAULT_TENANT,
        url="https://alerts.invalid/",
        description="never sent to",
        types=(),
        secrets=(signing.Secret(signing.new_secret()),),
        status="enabled",
        created_ns=now_ns,
        updated_ns=now_ns,
    )


def _repeated(data: Sequence[bytes], started_s: float) -> Iterator[bytes]:
    """The packets again and again, until the stage's time is over."""
    for content in itertools.cycle(data):
        if time.perf_counter() - started_s > BUDGET_S:
            return
        yield content


def _await(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + MATCHED_WITHIN_S
    while not condition():
        if time.monotonic() > deadline:
            raise TimeoutError("Zenoh on loopback is not through after 10 s")
        time.sleep(0.0005)
