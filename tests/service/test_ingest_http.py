"""Packets over HTTP, against a real server: durable before 202, and each refusal a problem with its code."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import httpx
import pytest

from schemas.packet import packet_to_json
from service.ingest.http import MAX_BATCH_BYTES, split_frames
from service.ingest.http_openapi import ingest_paths
from service.storage import keys, tenants
from service.storage.database import write
from tests.service.ingest_harness import WAIT_S, IngestService, packet, poisoned

PROTOBUF = {"Content-Type": "application/x-protobuf"}


@pytest.fixture
def service(tmp_path: Path) -> Iterator[IngestService]:
    made = IngestService(tmp_path / "telefuse.db")
    yield made
    made.stop()


@pytest.fixture
def client(service: IngestService) -> Iterator[httpx.Client]:
    with httpx.Client(base_url=service.start_http(), timeout=WAIT_S) as made:
        yield made


def send(client: httpx.Client, body: bytes, vehicle_id: str = "car-1", **headers: str) -> httpx.Response:
    return client.post(f"/v1/vehicles/{vehicle_id}/telemetry", content=body, headers={**PROTOBUF, **headers})


def frames(*bodies: bytes) -> bytes:
    def varint(value: int) -> bytes:
        return bytes([value]) if value < 0x80 else bytes([value & 0x7F | 0x80]) + varint(value >> 7)

    return b"".join(varint(len(body)) + body for body in bodies)


def assert_problem(response: httpx.Response, status: int, code: str) -> dict[str, Any]:
    assert (response.status_code, response.headers["content-type"]) == (status, "application/problem+json"), (
        response.text
    )
    problem: dict[str, Any] = response.json()
    assert (problem["status"], problem["code"]) == (status, code)
    assert problem["detail"]
    return problem


def test_a_packet_is_on_disk_when_it_is_accepted(client: httpx.Client, service: IngestService) -> None:
    answer = send(client, packet(1).SerializeToString())
    assert answer.status_code == 202
    assert service.rows() == [("boot-1", 1, True)]
    assert answer.json() == {
        "accepted": 1,
        "duplicates": 0,
        "refused": [],
        "durable_sequence": 1,
        "durable": [{"vehicle_id": "car-1", "boot_id": "boot-1", "sequence": 1}],
    }
    again = send(client, packet(1).SerializeToString())
    assert again.status_code == 202
    assert (again.json()["accepted"], again.json()["duplicates"], again.json()["durable_sequence"]) == (0, 1, 1)
    assert service.rows() == [("boot-1", 1, True)]
    assert service.metric("packets_received_total", transport="http") == 2


def test_json_is_journaled_as_protobuf(client: httpx.Client, service: IngestService) -> None:
    body = packet_to_json(packet(1)).encode()
    answer = client.post(
        "/v1/vehicles/car-1/telemetry", content=body, headers={"Content-Type": "application/json; charset=utf-8"}
    )
    assert answer.status_code == 202
    assert service.entries[0].payload == packet(1).SerializeToString()


def test_a_gap_shows_in_the_answer(client: httpx.Client) -> None:
    assert send(client, packet(1).SerializeToString()).json()["durable_sequence"] == 1
    assert send(client, packet(3).SerializeToString()).json()["durable_sequence"] == 1
    stepping = send(client, packet(14).SerializeToString()).json()
    assert stepping["durable_sequence"] == 3
    assert [(one["sequence"], one["code"]) for one in stepping["refused"]] == [(2, "gap_stepped_over")]
    problem = assert_problem(send(client, packet(2).SerializeToString()), 422, "late")
    assert problem["durable_sequence"] == 3


def test_a_poisoned_packet_is_refused_for_good_and_need_not_come_again(
    client: httpx.Client, service: IngestService
) -> None:
    problem = assert_problem(send(client, poisoned(1).SerializeToString()), 422, "null_island")
    assert problem["durable_sequence"] == 1
    assert send(client, packet(2).SerializeToString()).json()["durable_sequence"] == 2
    assert service.rows() == [("boot-1", 1, False), ("boot-1", 2, True)]
    assert service.metric("packets_refused_total", code="null_island") == 1


@pytest.mark.parametrize(
    ("body", "status", "code"),
    [
        (packet(1).SerializeToString()[:-3], 400, "malformed"),
        (b"\xff" * 50, 400, "malformed"),
        (b"", 422, "vehicle_id"),
        (packet(1, vehicle_id="car-2").SerializeToString(), 422, "vehicle_mismatch"),
        (packet(0).SerializeToString(), 422, "sequence"),
        (packet(1, boot_id="a b").SerializeToString(), 422, "boot_id"),
    ],
)
def test_what_cannot_be_placed_leaves_no_trace(
    client: httpx.Client, service: IngestService, body: bytes, status: int, code: str
) -> None:
    problem = assert_problem(send(client, body), status, code)
    assert "durable_sequence" not in problem
    assert service.rows() == []
    assert service.metric("packets_refused_total", code=code) == 1


def test_media_types_that_are_not_taken(client: httpx.Client) -> None:
    assert_problem(send(client, b"x", **{"Content-Type": "text/csv"}), 415, "unsupported_media_type")
    json_batch = client.post("/v1/telemetry", content=b"[]", headers={"Content-Type": "application/json"})
    assert_problem(json_batch, 415, "unsupported_media_type")


def test_a_body_that_is_too_large_is_refused_with_and_without_its_length(client: httpx.Client) -> None:
    assert_problem(send(client, bytes(2**20 + 1)), 413, "body_too_large")
    chunks = (bytes(2**16) for _ in range(32))
    chunked = client.post("/v1/vehicles/car-1/telemetry", content=chunks, headers=PROTOBUF)
    assert_problem(chunked, 413, "body_too_large")


def test_many_vehicles_in_one_request(client: httpx.Client, service: IngestService) -> None:
    bodies = [packet(n, vehicle_id=f"car-{v}").SerializeToString() for n in (1, 2, 3) for v in range(5)]
    answer = client.post("/v1/telemetry", content=frames(*bodies, bodies[0]), headers=PROTOBUF)
    assert answer.status_code == 202
    content = answer.json()
    assert (content["accepted"], content["duplicates"], content["refused"]) == (15, 1, [])
    assert content["durable_sequence"] is None
    assert content["durable"] == [{"vehicle_id": f"car-{v}", "boot_id": "boot-1", "sequence": 3} for v in range(5)]
    assert len(service.entries) == 15


def test_a_refused_packet_keeps_no_other_from_being_taken(client: httpx.Client, service: IngestService) -> None:
    body = frames(
        packet(1).SerializeToString(), b"\xff\xff", poisoned(2).SerializeToString(), packet(3).SerializeToString()
    )
    content = client.post("/v1/telemetry", content=body, headers=PROTOBUF).json()
    assert (content["accepted"], content["durable_sequence"]) == (2, 3)
    assert [(one["sequence"], one["code"]) for one in content["refused"]] == [(0, "malformed"), (2, "null_island")]
    assert service.rows() == [("boot-1", 1, True), ("boot-1", 2, False), ("boot-1", 3, True)]


@pytest.mark.parametrize("body", [b"\x05abc", b"\x80", b"\xff" * 20, frames(packet(1).SerializeToString())[:-1]])
def test_broken_framing_takes_nothing(client: httpx.Client, service: IngestService, body: bytes) -> None:
    assert_problem(client.post("/v1/telemetry", content=body, headers=PROTOBUF), 400, "bad_request")
    assert service.rows() == []


def test_a_batch_that_is_too_large(client: httpx.Client) -> None:
    answer = client.post("/v1/telemetry", content=bytes(MAX_BATCH_BYTES + 1), headers=PROTOBUF)
    assert_problem(answer, 413, "body_too_large")


def test_frames_of_an_empty_body() -> None:
    assert list(split_frames(b"")) == []
    assert list(split_frames(b"\x00\x01a")) == [b"", b"a"]


def test_many_senders_at_once_lose_nothing(client: httpx.Client, service: IngestService) -> None:
    def drive(vehicle: int) -> int:
        for sequence in range(1, 21):
            answer = send(client, packet(sequence, vehicle_id=f"car-{vehicle}").SerializeToString(), f"car-{vehicle}")
            assert answer.status_code == 202
        return int(answer.json()["durable_sequence"])

    with ThreadPoolExecutor(8) as pool:
        assert list(pool.map(drive, range(8))) == [20] * 8
    assert service.metric("packets_accepted_total") == len(service.entries) == 160


def test_an_unknown_vehicle_is_refused_where_registration_is_closed(tmp_path: Path) -> None:
    service = IngestService(tmp_path / "telefuse.db", registration="closed")
    try:
        with httpx.Client(base_url=service.start_http(), timeout=WAIT_S) as client:
            problem = assert_problem(send(client, packet(1).SerializeToString()), 404, "unknown_vehicle")
            assert "durable_sequence" not in problem
            service.directory.register("default", "car-1")
            assert send(client, packet(1).SerializeToString()).status_code == 202
    finally:
        service.stop()


def test_a_key_is_needed_and_its_scope_and_tenant_count(tmp_path: Path) -> None:
    service = IngestService(tmp_path / "telefuse.db", auth=True)
    try:
        with write(service.database) as connection:
            tenants.ensure(connection, "insurer")
            _, sender = keys.create(connection, "insurer", "box", ["telemetry:write"])
            _, reader = keys.create(connection, "insurer", "reader", ["scores:read"])
        with httpx.Client(base_url=service.start_http(), timeout=WAIT_S) as client:
            body = packet(1).SerializeToString()
            assert_problem(send(client, body), 401, "unauthenticated")
            assert_problem(send(client, body, Authorization="Bearer tf_no_such"), 401, "unauthenticated")
            assert_problem(send(client, body, Authorization=f"Bearer {reader}"), 403, "forbidden")
            assert send(client, body, Authorization=f"Bearer {sender}").status_code == 202
        assert service.directory.resolve("insurer", "car-1") is not None
        assert len(service.entries) == 1
    finally:
        service.stop()


def test_a_backlog_is_503_with_retry_after_and_nothing_is_lost(tmp_path: Path) -> None:
    service = IngestService(tmp_path / "telefuse.db", queue_limit=1)
    try:
        with httpx.Client(base_url=service.start_http(), timeout=WAIT_S) as client, ThreadPoolExecutor(8) as pool:
            assert send(client, packet(1).SerializeToString()).status_code == 202
            turned_away = threading.Event()

            def send_until_taken(sequence: int) -> None:
                while (answer := send(client, packet(sequence).SerializeToString())).status_code != 202:
                    problem = assert_problem(answer, 503, "backlog")
                    assert int(answer.headers["Retry-After"]) >= 1
                    assert problem["detail"]
                    turned_away.set()

            with write(service.database):  # nothing can be committed while this stands
                sending = [pool.submit(send_until_taken, sequence) for sequence in range(2, 10)]
                assert turned_away.wait(WAIT_S)
            for one in sending:
                one.result(WAIT_S)
        assert sorted(sequence for _, sequence, _ in service.rows()) == list(range(1, 10))
    finally:
        service.stop()


def test_the_description_names_the_routes() -> None:
    paths = ingest_paths()
    assert set(paths) == {"/v1/vehicles/{vehicle_id}/telemetry", "/v1/telemetry"}
    assert "null_island" in paths["/v1/vehicles/{vehicle_id}/telemetry"]["post"]["description"]
