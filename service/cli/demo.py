"""``telefuse demo``: the main job end to end on this machine, held against the truth."""

from __future__ import annotations

import argparse
import json
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from types import FrameType
from typing import Final, NoReturn

from service.demo import report
from service.demo.alert_receiver import AlertReceiver
from service.demo.boxes import recorded_boxes, simulated_boxes
from service.demo.service_process import ServiceProcess, default_ports
from service.demo.story import play
from service.errors import UsageError
from service.recordings.drive_folder import read_drive

FELL_SHORT: Final = 1


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("--drive", type=Path, metavar="DIR", help="send this drive folder and not the simulated drive")
    parser.add_argument("--exit", action="store_true", help="end when done, 0 if everything promised held, else 1")
    parser.add_argument("--json", action="store_true", help="print the figures as one JSON object")
    parser.add_argument(
        "--data-dir", type=Path, metavar="DIR", help="keep the service's data here (default: removed at the end)"
    )


def run(arguments: argparse.Namespace) -> int:
    """Start a service, let two boxes send, judge; then serve on until it is interrupted, unless told to end."""
    with _ending_cleanly(), _data_dir(arguments.data_dir) as data_dir, AlertReceiver() as receiver:
        boxes = simulated_boxes() if arguments.drive is None else recorded_boxes(read_drive(arguments.drive))
        service = ServiceProcess(
            data_dir,
            *default_ports(),
            log_level="warning",
            retention_track_days="0",  # drives may be of years ago
            trip_silence_s="2",  # the boxes send no more once the drive is over, and a demo does not wait
            dangerous_allow_private_webhook_targets="true",
        )
        say = _Teller(quiet=arguments.json)
        try:
            say.line("starting a service on loopback …")
            service.start()
            say.line(f"  HTTP {service.http_url}, Zenoh {service.zenoh_endpoint}, data {service.data_dir}")
            say.line(f"  webhooks go to {receiver.url}: a private address, which only this demo's setting allows")
            say.line("    (dangerous_allow_private_webhook_targets)")
            result = play(service, receiver, boxes, say.progress)
            say.line(f"done in {result.seconds:.1f} s\n")
            print(json.dumps(report.figures(result)) if arguments.json else report.table(result, boxes), flush=True)
            if not arguments.exit:
                say.line("\n" + report.addresses(service, boxes[0], result) + "\n\nServing until Ctrl-C.")
                with suppress(KeyboardInterrupt):
                    service.wait()
        finally:
            service.stop()
    return FELL_SHORT if result.shortfalls() else 0


@contextmanager
def _data_dir(asked: Path | None) -> Iterator[Path]:
    if asked is None:
        with TemporaryDirectory(prefix="telefuse-demo-") as temporary:
            yield Path(temporary)
        return
    if asked.exists() and not (asked.is_dir() and not any(asked.iterdir())):
        raise UsageError(f"--data-dir {asked}: is not empty; expected a new or an empty folder")
    yield asked


@contextmanager
def _ending_cleanly() -> Iterator[None]:
    """Let SIGTERM unwind the stack, so that the service does not outlive the demo."""

    def end(_number: int, _frame: FrameType | None) -> NoReturn:
        raise SystemExit(128 + signal.SIGTERM)

    before = signal.signal(signal.SIGTERM, end)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


class _Teller:
    """Says how far it is: nothing where figures alone are asked for, a bar only on a terminal."""

    def __init__(self, *, quiet: bool) -> None:
        self._quiet = quiet
        self._bar = sys.stderr.isatty()

    def line(self, text: str) -> None:
        """A line for people."""
        if self._bar:
            sys.stderr.write("\r\x1b[K")
        if not self._quiet:
            print(text, flush=True)

    def progress(self, acknowledged: int, total: int) -> None:
        """How many packets are acknowledged."""
        if self._bar:
            done = round(30 * acknowledged / max(total, 1))
            sys.stderr.write(f"\r[{'#' * done}{'.' * (30 - done)}] {acknowledged} of {total} packets acknowledged")
            sys.stderr.flush()
