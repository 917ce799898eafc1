"""The black box and ``telefuse replay``: everything is acknowledged whatever happens to the service meanwhile."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pytest

from core.measurements import GNSS_COLUMNS, Measurements
from schemas.telemetry_pb2 import TelemetryPacket
from service.blackbox.box import Ack, BlackBox, LinkError, LinkListener, Outgoing, holds_impact
from service.blackbox.zenoh_link import ZenohLink
from service.cli import main
from service.cli.replay import boot_of, link_to, replay
from service.ingest.sequencing import Sequencer
from service.recordings.drive_folder import Drive, read_drive, write_drive
from service.storage import keys, tenants
from service.storage.database import write
from tests.recordings import recording
from tests.service.ingest_harness import (
    SECOND_NS,
    T0_NS,
    WAIT_S,
    IngestService,
    free_endpoint,
    packet,
    poisoned,
    spawn,
)


def a_drive(seconds: int) -> Drive:
    count = 10 * seconds
    gnss = np.full((seconds, len(GNSS_COLUMNS)), np.nan)
    gnss[:, :3] = 1.0358, 0.3154, 40.0
    return Drive(
        name="straight",
        start_t_ns=T0_NS,
        vehicle_id="recorded",
        measurements=Measurements(
            imu_t_ns=T0_NS + 100_000_000 * np.arange(count),
            f_s=np.tile([0.0, 0.0, -9.81], (count, 1)),
            omega_s=np.zeros((count, 3)),
            gnss_t_ns=T0_NS + SECOND_NS * np.arange(seconds),
            gnss=gnss,
        ),
    )


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    folder = tmp_path / "drive"
    write_drive(folder, a_drive(40))
    return folder


@pytest.fixture
def service(tmp_path: Path) -> Iterator[IngestService]:
    made = IngestService(tmp_path / "telefuse.db")
    yield made
    made.stop()


def replayed(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, dict[str, object]]:
    status = main(["replay", *arguments, "--vehicle", "car-1", "--speed", "0", "--json"])
    return status, json.loads(capsys.readouterr().out)


@pytest.mark.parametrize("transport", ["zenoh", "http"])
def test_a_drive_arrives_whole_and_a_second_replay_changes_nothing(
    transport: str, drive: Path, service: IngestService, capsys: pytest.CaptureFixture[str]
) -> None:
    address = service.start_zenoh() if transport == "zenoh" else service.start_http()
    status, figures = replayed(capsys, str(drive), "--to", address)
    assert status == 0
    assert (figures["packets"], figures["acknowledged"], figures["refused"], figures["lost"]) == (40, 40, 0, 0)
    boot_id = boot_of(read_drive(drive))
    assert service.rows() == [(boot_id, sequence, True) for sequence in range(1, 41)]

    status, figures = replayed(capsys, str(drive), "--to", address)
    assert (status, figures["acknowledged"], figures["lost"]) == (0, 40, 0)
    assert len(service.rows()) == 40


def test_a_replay_can_begin_in_the_middle(
    drive: Path, service: IngestService, capsys: pytest.CaptureFixture[str]
) -> None:
    status, figures = replayed(capsys, str(drive), "--to", service.start_http(), "--boot-id", "b")
    assert status == 0
    status, figures = replayed(
        capsys, str(drive), "--to", service.start_zenoh(), "--from-sequence", "31", "--boot-id", "b"
    )
    assert (status, figures["packets"], figures["acknowledged"]) == (0, 10, 10)
    assert [sequence for _, sequence, _ in service.rows()] == list(range(1, 41))


@pytest.mark.parametrize("name", ["kth_stockholm", "comma2k19_segment", "boston_vn100"])
def test_real_recordings_arrive_whole(name: str, service: IngestService, capsys: pytest.CaptureFixture[str]) -> None:
    status, figures = replayed(capsys, str(recording("drives", name)), "--to", service.start_zenoh())
    assert (status, figures["refused"], figures["lost"]) == (0, 0, 0)
    assert len(service.rows()) == figures["packets"] == figures["acknowledged"]


def test_a_service_killed_again_and_again_loses_nothing(tmp_path: Path) -> None:
    file, endpoint = tmp_path / "killed.db", free_endpoint()
    packets = [packet(sequence) for sequence in range(1, 401)]
    acknowledged = 0
    kill_at = [60, 170, 280]
    due = threading.Event()

    def tell(count: int) -> None:
        nonlocal acknowledged
        acknowledged = count
        if kill_at and count >= kill_at[0]:
            kill_at.pop(0)
            due.set()

    outcome = []
    sender = threading.Thread(
        target=lambda: outcome.append(
            replay(
                packets,
                ZenohLink(endpoint, "default", "car-1"),
                "boot-1",
                speed=200.0,  # fast, and yet there is time to kill in
                give_up_after_s=WAIT_S,
                tell=tell,
            )
        )
    )
    process = spawn(file, endpoint)
    try:
        sender.start()
        for _ in range(3):
            assert due.wait(WAIT_S)
            due.clear()
            process.kill()
            process.wait()
            process = spawn(file, endpoint)
        sender.join(4 * WAIT_S)
    finally:
        process.kill()
        process.wait()
        assert process.stdout is not None
        process.stdout.close()
    assert (outcome[0].acknowledged, outcome[0].refused, outcome[0].lost) == (400, 0, 0)

    service = IngestService(file)
    try:
        rows = service.rows()
        sequencer, order = Sequencer(), []
        for journal_id, (boot_id, sequence, _) in enumerate(rows):
            order += sequencer.offer(boot_id, sequence, packets[sequence - 1].start_time_ns, journal_id).released
        assert [rows[journal_id][1] for journal_id in order] == list(range(1, 401))  # each once, none stepped over
    finally:
        service.stop()


def test_poisoned_packets_are_refused_once_and_the_rest_arrives(service: IngestService) -> None:
    packets = [poisoned(sequence) if sequence % 10 == 0 else packet(sequence) for sequence in range(1, 41)]
    link = link_to(service.start_zenoh(), "default", "car-1", None)
    outcome = replay(packets, link, "boot-1", speed=0, give_up_after_s=WAIT_S)
    assert (outcome.acknowledged, outcome.refused, outcome.lost) == (36, 4, 0)
    assert outcome.refused_codes == {"null_island": 4}


def test_a_key_without_the_scope_ends_the_replay_with_its_reason(
    tmp_path: Path, drive: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    service = IngestService(tmp_path / "auth.db", auth=True)
    try:
        with write(service.database) as connection:
            tenants.ensure(connection, "default")
            _, token = keys.create(connection, "default", "box", ["telemetry:write"])
        arguments = ["replay", str(drive), "--to", service.start_http(), "--vehicle", "car-1", "--speed", "0"]
        assert main(arguments) == 1
        assert "401" in capsys.readouterr().err
        assert main([*arguments, "--token", token]) == 0
    finally:
        service.stop()


def test_without_a_service_the_replay_gives_up(drive: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["replay", str(drive), "--vehicle", "car-1", "--speed", "0", "--give-up-after", "0.3", "--json"]
    assert main([*arguments, "--to", free_endpoint()]) == 1
    output = capsys.readouterr()
    assert json.loads(output.out)["lost"] == 40
    assert output.err.count("\n") == 1


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--to", "nowhere", "--vehicle", "car-1"], "tcp/HOST:PORT"),
        (["--to", "tcp/127.0.0.1:1", "--vehicle", "a/b"], "--vehicle"),
        (["--to", "tcp/127.0.0.1:1", "--vehicle", "car-1", "--speed", "-1"], "--speed"),
        (["--to", "tcp/127.0.0.1:1", "--vehicle", "car-1", "--from-sequence", "0"], "--from-sequence"),
        (["--to", "tcp/127.0.0.1:1", "--vehicle", "car-1", "--from-sequence", "41"], "41"),
        (["--to", "tcp/127.0.0.1:1", "--vehicle", "car-1", "--give-up-after", "0"], "--give-up-after"),
    ],
)
def test_bad_usage_is_one_line(
    arguments: list[str], said: str, drive: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["replay", str(drive), *arguments]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1


def test_a_folder_that_is_no_drive_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["replay", str(tmp_path / "none"), "--to", "tcp/127.0.0.1:1", "--vehicle", "car-1"]) == 2
    assert capsys.readouterr().err.count("\n") == 1


# --- the box over a link that a test can break -----------------------------------------------------


class BreakableLink:
    """Keeps what was sent; acknowledges as a service would, except for what it is told to lose."""

    def __init__(self, lose: Sequence[int] = (), fail: int = 0) -> None:
        self.sent: list[int] = []
        self._lose = list(lose)
        self._fail = fail
        self._there: set[int] = set()
        self._listener: LinkListener | None = None

    def open(self, listener: LinkListener) -> None:
        self._listener = listener

    def send(self, packets: Sequence[Outgoing]) -> None:
        assert self._listener is not None
        if self._fail:
            self._fail -= 1
            raise LinkError("broken")
        for one in packets:
            self.sent.append(one.sequence)
            if one.sequence in self._lose:
                self._lose.remove(one.sequence)
                continue
            self._there.add(one.sequence)
            floor = 0
            while floor + 1 in self._there:
                floor += 1
            self._listener.on_ack(Ack("boot-1", floor, gap=max(self._there) > floor))

    def close(self) -> None:
        pass


def through(link: BreakableLink, packets: list[TelemetryPacket]) -> BlackBox:
    box = BlackBox(link, "boot-1", resend_after_s=0.05)
    box.start()
    try:
        for one in packets:
            assert box.put(one, WAIT_S)
        assert box.wait_acknowledged(WAIT_S)
    finally:
        box.stop()
    return box


def test_packets_go_in_order_and_once_where_nothing_is_lost() -> None:
    link = BreakableLink()
    figures = through(link, [packet(sequence) for sequence in range(1, 31)]).figures
    assert link.sent == list(range(1, 31))
    assert (figures.sent, figures.acknowledged, figures.resent, figures.unacknowledged) == (30, 30, 0, 0)


@pytest.mark.parametrize("lose", [[1], [30], [5, 6, 7], [5, 5, 5], list(range(1, 31))])
def test_what_is_lost_goes_again(lose: list[int]) -> None:
    figures = through(BreakableLink(lose), [packet(sequence) for sequence in range(1, 31)]).figures
    assert (figures.sent, figures.acknowledged, figures.unacknowledged) == (30, 30, 0)
    assert figures.resent >= len(lose)


def test_a_link_that_fails_is_tried_again() -> None:
    box = through(BreakableLink(fail=3), [packet(1), packet(2)])
    assert box.figures.acknowledged == 2


def test_no_more_than_the_window_is_under_way() -> None:
    class Silent(BreakableLink):
        def send(self, packets: Sequence[Outgoing]) -> None:
            self.sent += [one.sequence for one in packets]
            if 8 in self.sent:
                full.set()

    full = threading.Event()
    link = Silent()
    box = BlackBox(link, "boot-1", capacity=20, resend_after_s=WAIT_S)
    box.start()
    try:
        for sequence in range(1, 21):
            assert box.put(packet(sequence), WAIT_S)
        assert not box.put(packet(21), 0.05)  # memory is full
        assert full.wait(WAIT_S)
        assert link.sent == list(range(1, 9))
        box.on_ack(Ack("boot-1", 20))
        assert box.wait_acknowledged(WAIT_S)
    finally:
        box.stop()


def test_acknowledgements_of_another_boot_are_not_ours() -> None:
    box = BlackBox(BreakableLink(), "boot-1")
    box.put(packet(1))
    box.on_ack(Ack("boot-0", 99))
    assert box.figures.unacknowledged == 1


def test_an_impact_is_urgent() -> None:
    assert not holds_impact(packet(1))
    crash = packet(1)
    rows = np.frombuffer(crash.imu.samples, "<i2").reshape(-1, 6).copy()
    rows[3, 0] = 32_000  # 19.2 m/s2 forward beside gravity: 21.6 m/s2 in all
    crash.imu.samples = rows.tobytes()
    assert not holds_impact(crash)
    rows[3, 1] = 32_000  # and as much to the right: 28.9 m/s2
    crash.imu.samples = rows.tobytes()
    assert holds_impact(crash)
