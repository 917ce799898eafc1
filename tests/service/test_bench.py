"""``telefuse bench``: that its figures are of real work, that they tell when something went wrong, and that nothing of
it is left behind. How fast anything is decides no test."""

from __future__ import annotations

import itertools
import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import httpx
import pytest

from service.bench import load, score_queries
from service.bench.fleet import REPEAT_EVERY, RecordedDrive, RepeatingLink, record_drives
from service.bench.load import LoadFigures
from service.bench.target import Address, Counts
from service.blackbox.box import LinkListener, Outgoing
from service.cli import main

ENTRY = "import sys; from service.cli import main; sys.exit(main())"
WAIT_S = 120.0
VEHICLES = 3


@pytest.fixture(scope="module")
def drives() -> tuple[RecordedDrive, ...]:
    return record_drives(20.0)


def figures(**changed: Any) -> LoadFigures:
    """A run in which all was well."""
    well = LoadFigures(
        vehicles=2,
        seconds=1.0,
        packets_per_s=10.0,
        sent=20,
        acknowledged=20,
        counted=Counts(accepted=20, fused=20),
        resent=1,
        duplicates_sent=2,
        latency_load_per_s=5.0,
        latencies_ms=(10.0, 20.0, 30.0),
        accidents=4,
        alerts=4,
    )
    return replace(well, **changed)


def test_whatever_must_not_happen_is_named() -> None:
    assert figures().shortfalls() == []
    assert figures(counted=Counts(accepted=20, fused=18)).shortfalls() == ["2 of 20 packets were lost"]
    assert figures(counted=Counts(accepted=20, fused=21)).shortfalls() == ["1 packets were applied twice"]
    both = figures(counted=Counts(accepted=21, fused=20)).shortfalls()
    assert both == ["1 of 20 packets were lost", "1 packets were applied twice"], "neither hides the other"
    assert figures(alerts=3).shortfalls() == ["1 of 4 accidents brought no alert"]
    assert figures(alerts=0, latencies_ms=None).shortfalls() == [], "where none could come none is missed"
    assert figures().latency_ms(50) == 20.0
    assert figures(latencies_ms=None).latency_ms(50) is None
    assert figures(latencies_ms=()).latency_ms(99) is None


def test_a_drive_is_driven_again_and_again_by_one_boot(drives: tuple[RecordedDrive, ...]) -> None:
    drive = drives[0]
    count = len(drive.packets)
    sent = list(itertools.islice(drive.endless("v", "b", first=count - 2), count + 4))
    assert [packet.sequence for packet in sent] == list(range(1, count + 5))
    assert {(packet.vehicle_id, packet.boot_id) for packet in sent} == {("v", "b")}
    starts_ns = [packet.start_time_ns for packet in sent]
    assert all(earlier < later for earlier, later in itertools.pairwise(starts_ns))
    assert starts_ns[count] - starts_ns[0] == drive.period_ns
    assert sent[2].imu.samples == drive.packets[0].imu.samples


class KeepingLink:
    """A link that keeps what it was given."""

    def __init__(self) -> None:
        self.sent: list[int] = []

    def open(self, listener: LinkListener) -> None:
        """Nobody is to be told."""

    def send(self, packets: Sequence[Outgoing]) -> None:
        """Keep."""
        self.sent += [packet.sequence for packet in packets]

    def close(self) -> None:
        """Nothing is open."""


def test_one_packet_in_so_many_is_sent_twice() -> None:
    kept = KeepingLink()
    link = RepeatingLink(kept, offset=3)
    for sequence in range(1, 2 * REPEAT_EVERY + 1):
        link.send([Outgoing(sequence, b"", urgent=False)])
    assert link.repeated == 2
    assert len(kept.sent) == 2 * REPEAT_EVERY + 2
    assert set(kept.sent) == set(range(1, 2 * REPEAT_EVERY + 1))


def test_a_running_service_is_loaded_over_http_and_left_as_it_was(
    service: Any, tenant: str, drives: tuple[RecordedDrive, ...]
) -> None:
    address = Address(service.url, token=service.token(tenant, "admin"))
    parts = []
    found = load.measure(address, drives, VEHICLES, 1.0, lambda part, _done, _all: parts.append(part))
    assert found.sent == found.acknowledged == found.counted.fused > VEHICLES * load.WARM_UP_PACKETS
    assert found.shortfalls() == []
    assert found.latencies_ms is None, "this service sends nothing to private addresses"
    assert [part for part, _ in itertools.groupby(parts)] == ["connecting", "throughput", "latency"]
    with service.client(tenant, "admin") as client:
        assert client.get("/v1/vehicles").json()["vehicles"] == []
        assert client.get("/v1/webhook-endpoints").json()["endpoints"] == []


def bench(directory: Path, *words: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", ENTRY, "bench", *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "TMPDIR": str(directory)},
    )


def test_the_whole_of_it_gives_every_figure_and_leaves_nothing(tmp_path: Path) -> None:
    process = bench(tmp_path, "--json", "--vehicles", str(VEHICLES), "--rate", "20", "--seconds", "2")
    out, err = process.communicate(timeout=WAIT_S)
    assert (process.returncode, err) == (0, "")
    found = json.loads(out)
    assert (found["vehicles"], found["rate_hz"], found["seconds"]) == (VEHICLES, 20.0, 2.0)
    # Both are rounded: the factor to 0.005, the packets to 0.05 a second.
    assert found["real_time_factor"] == pytest.approx(found["packets_per_s"] / VEHICLES, abs=0.01 + 0.05 / VEHICLES)
    assert found["sent"] == found["acknowledged"] > 0
    assert found["lost"] == found["duplicates_applied"] == 0
    assert found["duplicates_sent"] > 0
    assert found["accidents"] == found["alerts"] > 0
    assert found["latency_alerts"] > 0
    assert 0 < found["latency_ms"]["p50"] <= found["latency_ms"]["p99"]
    assert list(found["stages"]) == ["receive", "decode", "journal", "fuse", "store"]
    assert all(stage["limit_per_s"] > 0 for stage in found["stages"].values())
    assert found["fusion_ns_per_epoch"] > 0
    assert not [path for path in tmp_path.iterdir() if path.name.startswith("telefuse-bench-")]


def test_ended_early_it_ends_its_service_too(tmp_path: Path) -> None:
    process = bench(tmp_path, "--vehicles", "1", "--rate", "20", "--seconds", "600")
    url = running_at(tmp_path, process)
    assert httpx.get(f"{url}/livez").status_code == 200
    process.send_signal(signal.SIGTERM)
    process.communicate(timeout=WAIT_S)
    assert process.returncode == 128 + signal.SIGTERM
    with pytest.raises(httpx.ConnectError):
        httpx.get(f"{url}/livez")
    assert not [path for path in tmp_path.iterdir() if path.name.startswith("telefuse-bench-")]


def running_at(directory: Path, process: subprocess.Popen[str]) -> str:
    """Where the benchmark's own service says that it serves, once it does."""
    deadline = time.monotonic() + WAIT_S
    while time.monotonic() < deadline and process.poll() is None:
        for log in directory.glob("telefuse-bench-*/service/service.log"):
            if found := re.search(r"telefuse serves (http://\S+)/v1", log.read_text()):
                return found[1]
        time.sleep(0.05)
    raise AssertionError(f"no service was started: {process.communicate()}")


def test_the_filter_alone(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "--kernel", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    low, high = found["ns_per_epoch_quartiles"]
    assert 0 < low <= found["ns_per_epoch"] <= high
    assert found["rate_hz"] == 200
    assert main(["bench", "--kernel"]) == 0
    assert "ns an epoch" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--vehicles", "0"], "--vehicles 0: expected 1 to 1000"),
        (["--vehicles", "some"], "invalid int value"),
        (["--rate", "5"], "--rate 5: expected 10 to 1000 Hz"),
        (["--rate", "nan"], "--rate nan: expected"),
        (["--seconds", "0.5"], "--seconds 0.5: expected 1 to 3600"),
        (["--to", "somewhere"], "--to somewhere: expected http://HOST:PORT"),
        (["--to", "http://127.0.0.1:1", "--zenoh", "7447"], "--zenoh 7447: expected tcp/HOST:PORT"),
        (["--to", "http://127.0.0.1:1", "--http"], "--http is for a service of one's own"),
        (["--zenoh", "tcp/127.0.0.1:1"], "--zenoh is for a running service"),
        (["--token", "tf_x"], "--token is for a running service"),
        (["--to", "http://127.0.0.1:1", "--rate", "10", "--vehicles", "1"], "is the service running?"),
    ],
)
def test_bad_usage_is_one_line(words: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    try:
        code = main(["bench", *words])
    except SystemExit as ended:
        code = int(ended.code or 0)
    captured = capsys.readouterr()
    assert code == 2
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    assert said in captured.err


def test_score_queries_read_records_of_a_vehicle_with_many_trips() -> None:
    found = score_queries.measure(trips_in_all=60, queries=20)
    assert (found["database"], found["trips"], found["queries"]) == ("sqlite", 60, 20)
    for name in ("http_ms", "http_pwyd_ms", "ms", "with_cells_ms", "put_ms"):
        assert 0.0 < found[name]["p50"] <= found[name]["p99"]
        assert f"{found[name]['p99']:.2f} ms" in score_queries.lines(found)
