"""Packets over Zenoh, with real routers and clients: acknowledged once durable, refused with a code, never lost."""

from __future__ import annotations

import json
import queue
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import zenoh

from schemas.keys import zenoh_prefix
from service.errors import UsageError
from service.ingest.zenoh_session import client_config, open_session, service_config
from service.settings import Settings
from service.storage.database import write
from tests.service.ingest_harness import WAIT_S, IngestService, packet, poisoned

PREFIX = zenoh_prefix("default", "car-1")


class Box:
    """A bare Zenoh client that hears what the service says of a vehicle."""

    def __init__(self, endpoint: str, prefix: str = PREFIX) -> None:
        self.session = open_session(client_config([endpoint]))
        self.prefix = prefix
        self.heard: dict[str, queue.Queue[dict[str, Any]]] = {}
        self._subscribers = [self._listen(leaf) for leaf in ("ack", "state", "event")]
        listened_to = threading.Event()
        self._publisher = self.session.declare_publisher(f"{prefix}/telemetry")
        self._matching = self._publisher.declare_matching_listener(lambda status: status.matching and listened_to.set())
        assert listened_to.wait(WAIT_S)

    def _listen(self, leaf: str) -> object:
        heard = self.heard[leaf] = queue.Queue()
        return self.session.declare_subscriber(
            f"{self.prefix}/{leaf}", lambda sample: heard.put(json.loads(sample.payload.to_bytes()))
        )

    def put(self, data: bytes) -> None:
        self._publisher.put(data)

    def ack(self) -> dict[str, Any]:
        return self.heard["ack"].get(timeout=WAIT_S)

    def ack_of(self, sequence: int) -> dict[str, Any]:
        while (ack := self.ack())["sequence"] < sequence:
            pass
        return ack

    def close(self) -> None:
        self.session.close()


@pytest.fixture
def service(tmp_path: Path) -> Iterator[IngestService]:
    made = IngestService(tmp_path / "telefuse.db")
    yield made
    made.stop()


@pytest.fixture
def box(service: IngestService) -> Iterator[Box]:
    made = Box(service.start_zenoh())
    yield made
    made.close()


def test_a_packet_is_acknowledged_once_it_is_on_disk(box: Box, service: IngestService) -> None:
    box.put(packet(1).SerializeToString())
    assert box.ack() == {"boot_id": "boot-1", "sequence": 1, "refused": [], "gap": False}
    assert service.rows() == [("boot-1", 1, True)]
    box.put(packet(1).SerializeToString())
    assert box.ack()["sequence"] == 1  # a box that missed the acknowledgement gets it again
    assert service.metric("packets_duplicate_total") == 1
    assert service.metric("packets_received_total", transport="zenoh") == 2


def test_nothing_is_acknowledged_before_it_is_on_disk(box: Box, service: IngestService) -> None:
    box.put(packet(1).SerializeToString())
    assert box.ack()["sequence"] == 1
    with write(service.database):  # nothing can be committed while this stands
        box.put(packet(2).SerializeToString())
        box.put(packet(1, vehicle_id="car-2").SerializeToString())  # refused at once: the link is alive
        assert box.ack()["refused"] == [{"sequence": 1, "code": "vehicle_mismatch"}]
        assert box.heard["ack"].empty()
    assert box.ack()["sequence"] == 2


def test_a_gap_is_told_filled_and_stepped_over(box: Box) -> None:
    box.put(packet(1).SerializeToString())
    assert box.ack()["sequence"] == 1
    box.put(packet(3).SerializeToString())
    assert box.ack() == {"boot_id": "boot-1", "sequence": 1, "refused": [], "gap": True}
    box.put(packet(2).SerializeToString())
    assert box.ack() == {"boot_id": "boot-1", "sequence": 3, "refused": [], "gap": False}
    box.put(packet(5).SerializeToString())
    assert box.ack()["gap"]
    box.put(packet(16).SerializeToString())
    assert box.ack() == {
        "boot_id": "boot-1",
        "sequence": 5,
        "refused": [{"sequence": 4, "code": "gap_stepped_over"}],
        "gap": True,
    }
    box.put(packet(4).SerializeToString())
    assert box.ack()["refused"] == [{"sequence": 4, "code": "late"}]


def test_a_poisoned_packet_moves_the_acknowledgement_on(box: Box, service: IngestService) -> None:
    box.put(poisoned(1).SerializeToString())
    assert box.ack() == {
        "boot_id": "boot-1",
        "sequence": 1,
        "refused": [{"sequence": 1, "code": "null_island"}],
        "gap": False,
    }
    assert service.rows() == [("boot-1", 1, False)]


@pytest.mark.parametrize(
    ("data", "sequence", "code"),
    [
        (b"\xff\xff\xff", 0, "malformed"),
        (bytes(2**20 + 1), 0, "too_large"),
        (packet(4, vehicle_id="car-2").SerializeToString(), 4, "vehicle_mismatch"),
        (packet(0).SerializeToString(), 0, "sequence"),
    ],
)
def test_what_cannot_be_placed_is_told_and_counted(
    box: Box, service: IngestService, data: bytes, sequence: int, code: str
) -> None:
    box.put(data)
    ack = box.ack()
    assert (ack["sequence"], ack["refused"]) == (0, [{"sequence": sequence, "code": code}])
    assert service.metric("packets_refused_total", code=code) == 1
    assert service.rows() == []
    box.put(packet(1).SerializeToString())
    assert box.ack_of(1)["refused"] == []


@pytest.mark.parametrize(
    ("prefix", "code"),
    [("telefuse/v1/default/c3/car-1", "wrong_bucket"), ("telefuse/v1/default/c2/car 1", "wrong_key")],
)
def test_a_wrong_key_is_told_and_counted(service: IngestService, prefix: str, code: str) -> None:
    box = Box(service.start_zenoh(), prefix)
    try:
        box.put(packet(1).SerializeToString())
        assert box.ack()["refused"] == [{"sequence": 0, "code": code}]
        assert service.metric("packets_refused_total", code=code) == 1
    finally:
        box.close()


def test_an_unknown_vehicle_is_refused_until_it_is_registered(tmp_path: Path) -> None:
    service = IngestService(tmp_path / "telefuse.db", registration="closed")
    box = Box(service.start_zenoh())
    try:
        box.put(packet(1).SerializeToString())
        refused = box.ack()
        assert (refused["sequence"], refused["refused"]) == (0, [{"sequence": 1, "code": "unknown_vehicle"}])
        service.directory.register("default", "car-1")
        box.put(packet(1).SerializeToString())
        assert box.ack() == {"boot_id": "boot-1", "sequence": 1, "refused": [], "gap": False}
    finally:
        box.close()
        service.stop()


def test_a_burst_beyond_the_queue_is_turned_away_and_taken_when_it_comes_again(tmp_path: Path) -> None:
    service = IngestService(tmp_path / "telefuse.db", queue_limit=50)
    box = Box(service.start_zenoh())
    fleet = {f"car-{number}" for number in range(300)}
    acknowledged: queue.Queue[str] = queue.Queue()
    subscriber = box.session.declare_subscriber(
        "telefuse/v1/default/*/*/ack", lambda sample: acknowledged.put(str(sample.key_expr).split("/")[4])
    )
    try:
        for vehicle_id in fleet:  # registering one writes, which must not wait for what stands below
            service.directory.register("default", vehicle_id)

        def send(vehicle_ids: set[str]) -> None:
            for vehicle_id in vehicle_ids:
                body = packet(1, vehicle_id=vehicle_id).SerializeToString()
                box.session.put(f"{zenoh_prefix('default', vehicle_id)}/telemetry", body)

        with write(service.database):  # nothing can be committed while this stands
            send(fleet)
            while service.metric("packets_received_total", transport="zenoh") < len(fleet):
                pass
        assert service.metric("packets_refused_total", code="backlog") > 0
        missing = set(fleet)
        while missing:
            try:
                missing.discard(acknowledged.get(timeout=0.5))
            except queue.Empty:
                send(missing)
        assert len(service.entries) == len(fleet)
    finally:
        subscriber.undeclare()
        box.close()
        service.stop()


def test_states_come_once_a_second_and_events_all(box: Box, service: IngestService) -> None:
    assert service.zenoh is not None
    ref = service.directory.resolve("default", "car-1")
    assert ref is not None
    for number in range(50):
        service.zenoh.publish_state(ref, {"number": number})
        service.zenoh.publish_event(ref, {"specversion": "1.0", "id": str(number)})
    assert [box.heard["event"].get(timeout=WAIT_S)["id"] for _ in range(50)] == [str(number) for number in range(50)]
    states = [box.heard["state"].get(timeout=WAIT_S)["number"]]
    while states[-1] != 49:  # the newest is what remains
        states.append(box.heard["state"].get(timeout=WAIT_S)["number"])
    assert len(states) <= 2


def test_the_presence_of_boxes_is_seen(tmp_path: Path) -> None:
    seen: queue.Queue[tuple[str, str, bool]] = queue.Queue()
    service = IngestService(tmp_path / "telefuse.db")
    endpoint = service.start_zenoh(on_presence=lambda *what: seen.put(what))
    try:
        session = open_session(client_config([endpoint]))
        token = session.liveliness().declare_token(f"{PREFIX}/alive")
        assert seen.get(timeout=WAIT_S) == ("default", "car-1", True)
        assert service.metric("boxes_online") == 1
        token.undeclare()
        assert seen.get(timeout=WAIT_S) == ("default", "car-1", False)
        assert service.metric("boxes_online") == 0
        session.close()
    finally:
        service.stop()


def test_a_port_in_use_is_said_in_one_line(service: IngestService, tmp_path: Path) -> None:
    endpoint = service.start_zenoh()
    other = IngestService(tmp_path / "other.db")
    try:
        with pytest.raises(UsageError) as refused:
            other.start_zenoh(endpoint)
        assert endpoint in refused.value.detail
        assert "\n" not in refused.value.detail
    finally:
        other.stop()


def test_a_configuration_file_that_is_none_is_named(tmp_path: Path) -> None:
    file = tmp_path / "zenoh.json5"
    file.write_text("{ mode: ")
    with pytest.raises(UsageError, match="zenoh_config"):
        service_config(Settings(auth="on", zenoh_config=file))


def test_a_router_that_hangs_is_given_up() -> None:
    config = client_config(["tcp/127.0.0.1:9"])
    config.insert_json5("connect/timeout_ms", "-1")
    config.insert_json5("connect/exit_on_failure", "false")
    with pytest.raises((TimeoutError, zenoh.ZError)):
        open_session(config, timeout_s=0.5)
