"""The demo: its comparison with truth by hand, its receiver against the public package, and the whole of it."""

from __future__ import annotations

import json
import math
import socket
import subprocess
import sys
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from standardwebhooks import Webhook

from core.measurements import Measurements
from core.simulation.scenarios import simulate
from schemas.notifications import rfc3339
from service.cli import main
from service.demo.alert_receiver import AlertReceiver, verify
from service.demo.comparison import compare_accidents, compare_tunnels
from service.demo.service_process import ServiceFailedError, ServiceProcess, free_port
from service.demo.story import Result
from service.recordings.drive_folder import Drive, Reference, write_drive
from service.recordings.simulated import drive_of

START_NS = 1_750_000_000_000_000_000
NS_PER_S = 1_000_000_000
ENTRY = "import sys; from service.cli import main; sys.exit(main())"
SECRET = "whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw"
METRE_DEG = math.degrees(1 / 6_335_439.0)  # of latitude at the equator (WGS-84 meridian radius there)


def truth_drive() -> Drive:
    """At rest at 0/0 for 100 s, an outage from 20 to 60 s, crashes at 10 and 40 s."""
    t_ns = START_NS + np.arange(101) * NS_PER_S
    zeros = np.zeros(101)
    crash = {"lat_deg": 0.0, "lon_deg": 0.0, "delta_v_mps": 8.0, "severity": "severe"}
    return Drive(
        name="by hand",
        start_t_ns=START_NS,
        vehicle_id="v",
        measurements=Measurements(),
        reference=Reference(t_ns, zeros, zeros, zeros, np.zeros((101, 3)), np.zeros((101, 3))),
        truth={
            "accidents": [{**crash, "t_s": 10.0, "in_outage": False}, {**crash, "t_s": 40.0, "in_outage": True}],
            "outages": [{"start_s": 20.0, "duration_s": 40.0}],
        },
    )


def found(name: str, t_s: float, north_m: float = 0.0, delta_v_mps: float = 8.0) -> dict[str, Any]:
    t_ns = START_NS + round(t_s * NS_PER_S)
    return {
        "id": name,
        "geometry": {"type": "Point", "coordinates": [0.0, north_m * METRE_DEG, 0.0]},
        "properties": {
            "vehicle_id": "v",
            "time": rfc3339(t_ns),
            "received_at": rfc3339(t_ns + NS_PER_S),
            "sd_n_m": 3.0,
            "sd_e_m": 4.0,
            "delta_v_mps": delta_v_mps,
            "severity": "severe",
        },
    }


def test_each_crash_meets_the_nearest_accident_found_and_the_rest_is_invented() -> None:
    features = [found("far", 90.0), found("second", 40.2, north_m=12.0, delta_v_mps=9.5), found("first", 9.9)]
    alerts = {"second": START_NS + round(41.25 * NS_PER_S)}
    crashes, invented = compare_accidents("v", truth_drive(), features, alerts)
    assert [crash.found and crash.found["id"] for crash in crashes] == ["first", "second"]
    assert [one["id"] for one in invented] == ["far"]
    assert crashes[1].position_error_m == pytest.approx(12.0, abs=0.01)  # 1 mm is the API's own rounding
    assert crashes[1].position_sd_m == 5.0
    assert crashes[1].delta_v_error_mps == pytest.approx(1.5)
    assert crashes[1].alert_latency_ms == pytest.approx(50.0)
    assert crashes[0].alert_latency_ms is None


def test_the_error_in_a_tunnel_is_the_greatest_between_its_ends() -> None:
    times = [5, 25, 35, 45, 70]
    north_m = [50.0, 1.0, 3.0, 7.0, 90.0]
    track = {
        "features": [
            {
                "geometry": {"type": "LineString", "coordinates": [[0.0, n * METRE_DEG, 0.0] for n in north_m]},
                "properties": {"times": [rfc3339(START_NS + t * NS_PER_S) for t in times]},
            }
        ]
    }
    (tunnel,) = compare_tunnels("v", truth_drive(), track)
    assert tunnel.max_error_m == pytest.approx(7.0, abs=0.01)
    assert tunnel.max_error_before_crash_m == pytest.approx(3.0, abs=0.01)


def test_whatever_was_promised_and_did_not_hold_is_named() -> None:
    features = [found("first", 10.0, north_m=15.5), found("far", 90.0)]
    crashes, invented = compare_accidents("v", truth_drive(), features, {"first": START_NS})
    result = Result(tuple(crashes), tuple(invented), (), 10, 9, 9, {}, {"v": {}}, 2, (), 1.0)
    said = "; ".join(result.shortfalls())
    for part in (
        "placed 15.5 m away",
        "at 40.0 s was not found",
        "invented",
        "1 packets were lost",
        "2 of 2 webhooks",
        "not scored",
    ):
        assert part in said
    assert replace(result, crashes=(), invented=(), sent=9, events=0, scores={}).shortfalls() == []


def test_the_receiver_believes_what_the_public_package_signs_and_nothing_else() -> None:
    body = b'{"type":"ping"}'
    now = datetime.now(UTC)
    signed = {
        "webhook-id": "msg_1",
        "webhook-timestamp": str(int(now.timestamp())),
        "webhook-signature": "v1,c29tZSBvdGhlcg== " + Webhook(SECRET).sign("msg_1", now, body.decode()),
    }
    assert verify(SECRET, signed, body, now.timestamp())
    assert not verify(SECRET, signed, body + b" ", now.timestamp())
    assert not verify(SECRET, signed | {"webhook-id": "msg_2"}, body, now.timestamp())
    assert not verify(SECRET, signed, body, now.timestamp() + 301)
    assert not verify("whsec_" + "A" * 32, signed, body, now.timestamp())
    assert not verify(SECRET, {}, body, now.timestamp())
    with AlertReceiver() as receiver:
        receiver.secret = SECRET
        httpx.post(receiver.url, content=body, headers=signed)
        httpx.post(receiver.url, content=body, headers=signed | {"webhook-signature": "v1,bm8="})
        came = receiver.wait_until(lambda came: len(came) == 2, 10.0)
    assert [one.verified for one in came] == [True, False]


def test_a_request_whose_sender_is_killed_in_the_midst_of_it_is_none() -> None:
    with AlertReceiver() as receiver:
        with socket.create_connection(("127.0.0.1", int(receiver.url.split(":")[2].split("/")[0]))) as sender:
            sender.sendall(b"POST /alerts HTTP/1.1\r\nHost: x\r\nContent-Length: 100\r\n\r\n{")
            sender.shutdown(socket.SHUT_WR)
            assert sender.recv(1) == b""  # no answer, and so all of it was looked at
        assert receiver.wait_until(lambda came: True, 1.0) == []


def demo(directory: Path, *words: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", ENTRY, "demo", "--exit", *words]
    return subprocess.run(command, capture_output=True, text=True, cwd=directory, timeout=120, check=False)


def test_the_whole_demo_holds_what_it_promises(tmp_path: Path) -> None:
    run = demo(tmp_path, "--json")
    assert run.returncode == 0, run.stderr + run.stdout
    figures = json.loads(run.stdout)
    assert figures["shortfalls"] == []
    assert [crash["found"] for crash in figures["accidents"]] == [True] * 4
    assert max(crash["position_error_m"] for crash in figures["accidents"]) < 15.0
    assert figures["false_accidents"] == 0
    assert figures["tunnel"]["duration_s"] > 100
    packets = figures["packets"]
    assert packets["sent"] == packets["acknowledged"] == packets["processed"] > 800
    assert packets["lost"] == 0
    assert figures["webhooks"]["delivered"] == figures["webhooks"]["verified"] >= 5
    scores = figures["scores"]
    assert scores["vehicles"]["demo-zenoh"] == {product: scores[product] for product in ("payd", "phyd", "pwyd")}
    # Of two kilometres the portfolio's mean of 70 is most of each score; without roads it is all of where.
    assert all(60.0 < scores[product] < 80.0 for product in ("payd", "phyd"))
    assert scores["pwyd"] == 70.0


def test_a_recording_without_truth_and_without_a_crash_is_a_success(tmp_path: Path) -> None:
    drive = drive_of(simulate("city", seed=3, duration_s=60.0))
    write_drive(tmp_path / "drive", replace(drive, truth=None, reference=None))
    run = demo(tmp_path, "--drive", "drive", "--data-dir", "data")
    assert run.returncode == 0, run.stderr + run.stdout
    assert "none found, none expected" in run.stdout
    assert (tmp_path / "data" / "telefuse.db").is_file()


def test_a_data_directory_in_use_is_refused_before_anything_starts(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "something").touch()
    drive = tmp_path / "none"
    assert main(["demo", "--exit", "--drive", str(drive)]) == 2
    assert main(["demo", "--exit", "--data-dir", str(tmp_path)]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 2
    assert f"{drive}: no such folder" in said
    assert f"--data-dir {tmp_path}: is not empty" in said


def test_a_service_that_cannot_start_says_why(tmp_path: Path) -> None:
    service = ServiceProcess(tmp_path, free_port(), free_port(), http_host="192.0.2.1")
    with pytest.raises(ServiceFailedError, match="http_host is 192"):
        service.start()
