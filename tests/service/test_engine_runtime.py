"""The runtime as a whole: starts and stops in order, keeps others off its database, tells over Zenoh what it found."""

from __future__ import annotations

import asyncio
import json
import threading
from concurrent.futures import wait
from pathlib import Path
from typing import Any

import pytest
import zenoh
from sqlalchemy import func, select

from core.simulation.scenarios import simulate
from schemas.keys import zenoh_prefix
from schemas.telemetry_pb2 import TelemetryPacket
from schemas.vehicles import VehicleConfig
from service.errors import DatabaseError
from service.ingest.journal import BacklogError
from service.ingest.zenoh_session import client_config, open_session
from service.recordings.packets import drive_packets
from service.recordings.simulated import drive_of
from service.runtime import Runtime
from service.settings import Settings
from service.storage.database import open_database, read
from service.storage.holding import hold_database
from service.storage.tables import checkpoints, journal, track_points

VEHICLE = "car-1"
WAIT_S = 20.0


def settings(directory: Path, **changed: Any) -> Settings:
    chosen = {"auth": "off", "zenoh_mode": "off", "workers": 2, "retention_track_days": 0, **changed}
    return Settings(data_dir=directory, **chosen)


@pytest.fixture(scope="module")
def packets() -> list[TelemetryPacket]:
    """From 40 s before the low-speed crash to 5 s after it."""
    drive = drive_of(simulate("tunnel_crash", 1))
    assert drive.truth is not None
    crash_ns = drive.start_t_ns + round(drive.truth["accidents"][0]["t_s"] * 1e9)
    all_packets = drive_packets(drive, "b1", vehicle_id=VEHICLE)
    chosen = [p for p in all_packets if -40e9 < p.start_time_ns - crash_ns < 5e9]
    for sequence, packet in enumerate(chosen, start=1):
        packet.sequence = sequence
    return chosen


def send(runtime: Runtime, packets: list[TelemetryPacket]) -> None:
    """Have packets made durable, as a receiver does."""
    futures = [runtime.receiver.receive("default", p.SerializeToString(), transport="test") for p in packets]
    wait(futures, WAIT_S)
    assert [future.result().status for future in futures] == ["accepted"] * len(packets)


def test_what_was_taken_is_stored_before_it_stops_and_nothing_is_taken_after(
    tmp_path: Path, packets: list[TelemetryPacket]
) -> None:
    async def run() -> None:
        runtime = Runtime(settings(tmp_path))
        assert runtime.problems() == {"runtime": "starting or stopping"}
        await runtime.start()
        assert not any(runtime.problems().values())
        send(runtime, packets)
        await runtime.stop()
        with pytest.raises(BacklogError):
            send(runtime, packets[:1])

        again = Runtime(settings(tmp_path))
        await again.start()
        with read(again.database) as connection:
            newest = connection.execute(select(func.max(journal.c.id))).scalar_one()
            assert connection.execute(select(checkpoints.c.journal_id)).scalar_one() == newest
            points = connection.execute(select(func.count()).select_from(track_points)).scalar_one()
        assert points >= len(packets) - 15  # a second each, but for the first ones, before the heading is known
        await again.stop()

    asyncio.run(run())


def test_a_second_service_on_the_same_database_is_refused_until_the_first_ends(tmp_path: Path) -> None:
    async def run() -> None:
        first = Runtime(settings(tmp_path))
        await first.start()
        second = Runtime(settings(tmp_path))
        with pytest.raises(DatabaseError, match="in use by another telefuse service"):
            await second.start()
        await first.stop()
        await second.start()
        await second.stop()

    asyncio.run(run())


def test_a_postgresql_database_is_held_by_one_service_too(empty_postgres_url: str) -> None:
    one, other = open_database(empty_postgres_url), open_database(empty_postgres_url)
    let_go = hold_database(one)
    with pytest.raises(DatabaseError, match="in use by another telefuse service"):
        hold_database(other)
    let_go()
    hold_database(other)()
    one.dispose()
    other.dispose()
    with pytest.raises(DatabaseError, match="cannot be reached"):
        hold_database(open_database("postgresql+psycopg://nobody@127.0.0.1:1/none"))


def test_a_start_that_fails_lets_go_of_everything(tmp_path: Path) -> None:
    async def run() -> None:
        taken = "tcp/192.0.2.1:7447"  # no address of this machine
        broken = Runtime(
            settings(tmp_path, auth="on", zenoh_mode="router", zenoh_listen=(taken,), dangerous_allow_plain_zenoh=True)
        )
        with pytest.raises(Exception, match="Zenoh cannot be opened"):
            await broken.start()
        mended = Runtime(settings(tmp_path))
        await mended.start()
        await mended.stop()

    asyncio.run(run())


def test_states_and_events_are_told_over_zenoh(tmp_path: Path, packets: list[TelemetryPacket]) -> None:
    told: dict[str, list[dict[str, Any]]] = {"state": [], "event": []}
    heard = threading.Event()

    def on_sample(sample: zenoh.Sample) -> None:
        leaf = str(sample.key_expr).rpartition("/")[2]
        if leaf in told:
            told[leaf].append(json.loads(sample.payload.to_bytes()))
        if all(told.values()):
            heard.set()

    async def run() -> None:
        runtime = Runtime(settings(tmp_path, zenoh_mode="router", zenoh_listen=("tcp/127.0.0.1:0",)))
        await runtime.start()
        runtime.directory.register("default", VEHICLE, VehicleConfig(mounting_rpy_deg=(0.0, 0.0, 0.0)))
        session = await asyncio.to_thread(open_session, client_config(runtime.zenoh.endpoints))
        subscriber = session.declare_subscriber(f"{zenoh_prefix('default', VEHICLE)}/*", on_sample)
        # The router knows of the subscription once a publisher of its own finds it.
        publisher = session.declare_publisher(f"{zenoh_prefix('default', VEHICLE)}/state")
        while not publisher.matching_status.matching:
            await asyncio.sleep(0.01)
        await asyncio.to_thread(send, runtime, packets)
        assert await asyncio.to_thread(heard.wait, WAIT_S)
        subscriber.undeclare()
        session.close()
        await runtime.stop()

    asyncio.run(run())
    event = told["event"][0]
    assert event["type"] == "accident.detected"
    assert event["subject"] == event["data"]["vehicle_id"] == VEHICLE
    assert set(event) >= {"specversion", "id", "source", "type", "time", "data"}
    state = told["state"][0]
    assert state["vehicle_id"] == VEHICLE
    assert 40.40 < state["lat_deg"] < 40.42
    assert state["mode"] in ("aligning", "aided")
