"""Kill −9 of a real service at several points of a drive: nothing acknowledged is lost, nothing happens twice."""

from __future__ import annotations

import sqlite3
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

from core.measurements import Measurements, TimeArray
from core.simulation.scenarios import simulate
from schemas.telemetry_pb2 import TelemetryPacket
from service.blackbox.box import BlackBox
from service.blackbox.http_link import HttpLink
from service.blackbox.zenoh_link import ZenohLink
from service.demo.alert_receiver import AlertReceiver
from service.demo.service_process import ServiceProcess, free_port
from service.evidence.bundle import from_bytes
from service.recordings.drive_folder import Drive
from service.recordings.packets import drive_packets
from service.recordings.simulated import drive_of

VEHICLE = "car-1"
BOOT = "boot-1"
WAIT_S = 30.0
NS_PER_S = 1_000_000_000

# What a run leaves behind, but for the times at which a packet happened to come in or was stored.
STORED = {
    "track_points": "SELECT * FROM track_points ORDER BY vehicle_pk, t_ns",
    "trips": "SELECT id, vehicle_pk, start_ns, end_ns, ended, start_lat_deg, start_lon_deg, end_lat_deg, end_lon_deg,"
    " distance_m, moving_s, coasting_s, max_speed_mps FROM trips ORDER BY id",
    "records": "SELECT trip_id, day, model_sha256, record, cells, timeline FROM trip_records ORDER BY trip_id",
    "cells": "SELECT cell, distance_mm, start_ns FROM trip_cells ORDER BY cell, distance_mm, start_ns",
    "rollups": "SELECT period, begin, zone, record, cells FROM record_rollups ORDER BY period, begin",
    "manoeuvres": "SELECT id, kind, start_ns, end_ns, peak_mps2, lat_deg, lon_deg, excused, excused_by FROM manoeuvres"
    " ORDER BY id",
    "accidents": "SELECT id, vehicle_pk, trip_id, t_ns, decided_t_ns, severity, revision, kind, status, confidence,"
    " lat_deg, lon_deg, alt_m, sd_n_m, sd_e_m, cov_ne_m2, heading_deg, mode, detail FROM accidents ORDER BY id",
    "candidates": "SELECT id, vehicle_pk, t_ns, reason, probability, detail FROM accident_candidates ORDER BY id",
    "evidence": "SELECT accident_id, vehicle_pk, t_ns, status, anchor_journal_id, reason FROM evidence",
    "events": "SELECT id, vehicle_pk, type, t_ns, body FROM events WHERE type <> 'score.updated' ORDER BY id",
    # Told as often as a trip was assessed, which depends on when the worker looked: in the end they are the same.
    "scores": "SELECT json_extract(body, '$.scores') FROM events WHERE type = 'score.updated'"
    " ORDER BY cursor DESC LIMIT 1",
}


@dataclass(frozen=True)
class Story:
    """Packets of a drive, and the sequence of the one that holds the crash."""

    packets: list[TelemetryPacket]
    crash: int


def between(m: Measurements, begin_ns: int, end_ns: int, shift_ns: int = 0) -> Measurements:
    def cut(t_ns: TimeArray) -> slice:
        first, last = np.searchsorted(t_ns, [begin_ns, end_ns])
        return slice(int(first), int(last))

    imu, gnss, magnetic = cut(m.imu_t_ns), cut(m.gnss_t_ns), cut(m.magnetometer_t_ns)
    return replace(
        m,
        imu_t_ns=m.imu_t_ns[imu] + shift_ns,
        f_s=m.f_s[imu],
        omega_s=m.omega_s[imu],
        gnss_t_ns=m.gnss_t_ns[gnss] + shift_ns,
        gnss=m.gnss[gnss],
        magnetometer_t_ns=m.magnetometer_t_ns[magnetic] + shift_ns,
        magnetic_s_ut=m.magnetic_s_ut[magnetic],
    )


def joined(first: Measurements, second: Measurements) -> Measurements:
    names = ("imu_t_ns", "f_s", "omega_s", "gnss_t_ns", "gnss", "magnetometer_t_ns", "magnetic_s_ut")
    return replace(first, **{name: np.concatenate([getattr(first, name), getattr(second, name)]) for name in names})


@pytest.fixture(scope="module")
def story() -> Story:
    """50 s of streets with the low-speed crash, ten minutes of silence that end the trip, and 12 s of driving on."""
    drive: Drive = drive_of(simulate("tunnel_crash", 1))
    assert drive.truth is not None
    crash_ns = drive.start_t_ns + round(drive.truth["accidents"][0]["t_s"] * NS_PER_S)
    m = drive.measurements
    before = between(m, crash_ns - 40 * NS_PER_S, crash_ns + 10 * NS_PER_S)
    after = between(m, crash_ns + 40 * NS_PER_S, crash_ns + 52 * NS_PER_S, shift_ns=600 * NS_PER_S)
    packets = list(drive_packets(replace(drive, measurements=joined(before, after)), BOOT, vehicle_id=VEHICLE))
    crash = max(packet.sequence for packet in packets if packet.start_time_ns <= crash_ns)
    return Story(packets, crash)


@dataclass(frozen=True)
class Left:
    """What a run leaves behind."""

    stored: dict[str, list[tuple[Any, ...]]]
    evidence: dict[str, Any]


class Setup:
    """A service on its own directory and ports, with a vehicle, a webhook endpoint and a box."""

    def __init__(self, directory: Path, transport: str, receiver: AlertReceiver, story: Story) -> None:
        self.service = ServiceProcess(
            directory,
            free_port(),
            free_port(),
            log_level="warning",
            checkpoint_interval_s="7",
            retention_track_days="0",  # the drive is of years ago
            dangerous_allow_private_webhook_targets="true",
        )
        self.packets = story.packets
        self.given = 0
        link = (
            ZenohLink(self.service.zenoh_endpoint, "default", VEHICLE)
            if transport == "zenoh"
            else HttpLink(self.service.http_url)
        )
        self.box = BlackBox(link, BOOT, resend_after_s=0.3)
        self.box.start()
        try:
            self.service.start()
            receiver.secret = self._register(receiver.url)
        except BaseException:
            self.close()
            raise

    def _register(self, url: str) -> str:
        with httpx.Client(base_url=self.service.http_url) as client:
            config = {"mounting_rpy_deg": [0.0, 0.0, 0.0]}
            client.put(f"/v1/vehicles/{VEHICLE}", json={"config": config}).raise_for_status()
            endpoint = client.post("/v1/webhook-endpoints", json={"url": url}).raise_for_status().json()
        return str(endpoint["secret"])

    def put(self, through: int) -> None:
        """Give the box its packets up to a sequence."""
        while self.given < through:
            assert self.box.put(self.packets[self.given], WAIT_S)
            self.given += 1

    def send(self, through: int) -> None:
        """The same, and wait until they are acknowledged."""
        self.put(through)
        assert self.box.wait_acknowledged(WAIT_S), self.box.trouble

    def close(self) -> None:
        self.box.stop()
        self.service.kill()

    def stored(self) -> dict[str, list[tuple[Any, ...]]]:
        """What is in the database, once the service has ended."""
        with sqlite3.connect(self.service.data_dir / "telefuse.db") as connection:
            return {name: connection.execute(query).fetchall() for name, query in STORED.items()}

    def await_evidence(self, status: str) -> None:
        """Wait until that of the one accident has come so far."""
        deadline = time.monotonic() + WAIT_S
        while (found := self.query("SELECT status FROM evidence")) != [(status,)]:
            assert time.monotonic() < deadline, found
            time.sleep(0.1)

    def await_record(self) -> None:
        """Wait until trips that ended are assessed, as they are now."""
        deadline = time.monotonic() + WAIT_S
        while found := self.query("SELECT id FROM trips WHERE ended AND due_ns IS NOT NULL"):
            assert time.monotonic() < deadline, found
            time.sleep(0.1)

    def evidence(self) -> dict[str, Any]:
        """What the one bundle holds: its members' hashes, and how its replay compares."""
        ((data,),) = self.query("SELECT bundle FROM evidence")
        manifest = from_bytes(data).manifest
        return {"members": manifest["members"], "replay": manifest["replay"], "covered": manifest["covered"]}

    def query(self, sql: str) -> list[tuple[Any, ...]]:
        with sqlite3.connect(self.service.data_dir / "telefuse.db") as connection:
            return connection.execute(sql).fetchall()


@pytest.fixture
def receiver() -> Iterator[AlertReceiver]:
    with AlertReceiver() as receiver:
        yield receiver


@pytest.fixture(scope="module")
def undisturbed(story: Story, tmp_path_factory: pytest.TempPathFactory) -> Left:
    """What a run leaves behind that nobody disturbs."""
    with AlertReceiver() as receiver:
        setup = Setup(tmp_path_factory.mktemp("undisturbed"), "http", receiver, story)
        try:
            setup.send(through=story.packets[-1].sequence)
            setup.await_evidence("complete")
            setup.await_record()
            assert setup.service.stop() == 0
        finally:
            setup.close()
    newest = setup.query("SELECT max(id) FROM journal")
    assert setup.query("SELECT journal_id FROM checkpoints") == newest, "a clean stop leaves nothing to repeat"
    stored = setup.stored()
    assert [row[5] for row in stored["accidents"]] == ["low_speed"]
    told = sorted(row[2] for row in stored["events"])
    assert (told[0], set(told[1:-1]), told[-1]) == ("accident.detected", {"accident.updated"}, "trip.completed")
    assert len(stored["track_points"]) > 50
    assert len(stored["records"]) == 1
    assert [row[3] for row in stored["evidence"]] == ["complete"]
    evidence = setup.evidence()
    assert evidence["replay"]["same"], evidence["replay"]
    return Left(stored, evidence)


@pytest.mark.parametrize("transport", ["zenoh", "http"])
def test_a_killed_service_loses_nothing_acknowledged_and_doubles_nothing(
    story: Story,
    undisturbed: Left,
    receiver: AlertReceiver,
    tmp_path: Path,
    transport: str,
) -> None:
    last, crash = story.packets[-1].sequence, story.crash
    # Acknowledged up to the first, and the box at work up to the second, when the service is killed.
    kills = [(3, 6), (crash - 2, crash - 1), (crash + 2, crash + 4), (last, last)]
    setup = Setup(tmp_path, transport, receiver, story)
    try:
        for acknowledged, under_way in kills:
            setup.send(through=acknowledged)
            setup.put(through=under_way)
            if acknowledged == crash + 2:
                setup.await_evidence(
                    "pending"
                )  # its time is not over; the last kill meets it while it is built, or not
            setup.service.kill()
            durable = {sequence for (sequence,) in setup.query("SELECT sequence FROM journal")}
            assert set(range(1, acknowledged + 1)) <= durable
            setup.service.start()
        setup.send(through=last)
        wanted = {row[0] for row in undisturbed.stored["events"]}
        came = receiver.wait_until(lambda came: wanted <= {one.id for one in came}, WAIT_S)
        setup.await_evidence("complete")
        setup.await_record()
        assert setup.service.stop() == 0
    finally:
        setup.close()
    assert setup.query("SELECT sequence FROM journal ORDER BY sequence") == [(n,) for n in range(1, last + 1)]
    assert setup.stored() == undisturbed.stored
    assert setup.evidence() == undisturbed.evidence
    told = {one.id for one in came if one.message["type"] != "score.updated"}
    assert told == wanted, "each event told, and none that is not stored"
    assert all(one.verified for one in came)
