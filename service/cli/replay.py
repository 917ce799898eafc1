"""``telefuse replay``: plays a drive folder into a running service as a black box would."""

from __future__ import annotations

import argparse
import hashlib
import json
import math
import re
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from schemas.keys import MAX_BOOT_ID, MAX_TENANT_ID, MAX_VEHICLE_ID, NAME_RULE, is_name
from schemas.telemetry_pb2 import TelemetryPacket
from service.blackbox.box import WINDOW, BlackBox, Link
from service.blackbox.http_link import HttpLink
from service.blackbox.zenoh_link import ZenohLink
from service.cli.drives import read_with_progress
from service.cli.progress import Progress
from service.errors import UsageError
from service.recordings.drive_folder import Drive
from service.recordings.packets import drive_packets

EXIT_UNACKNOWLEDGED: Final = 1
_NS_PER_S: Final = 1_000_000_000
_POLL_S: Final = 0.2  # how often the bar moves while nothing else happens
_ZENOH_ADDRESS: Final = re.compile(r"(tcp|tls|quic|ws|udp)/(\[[^\]]+\]|[^:/\s]+):\d{1,5}(\?\S*)?(#\S*)?")
_HTTP_ADDRESS: Final = re.compile(r"https?://[^\s/]+\S*")


def configure(parser: argparse.ArgumentParser) -> None:
    """Say what the command takes."""
    parser.add_argument("drive", type=Path, metavar="DRIVE", help="drive folder")
    parser.add_argument(
        "--to", required=True, metavar="ADDRESS", help="the service: tcp/HOST:PORT (Zenoh) or http://HOST:PORT"
    )
    parser.add_argument("--vehicle", required=True, metavar="ID", help="vehicle to send as")
    parser.add_argument(
        "--tenant", default="default", metavar="ID", help="tenant of the vehicle, for Zenoh (default: default)"
    )
    parser.add_argument("--token", metavar="KEY", help="API key, for HTTP")
    parser.add_argument(
        "--speed",
        type=float,
        default=1.0,
        metavar="X",
        help="times real time; 0 is as fast as acknowledged (default: 1)",
    )
    parser.add_argument("--from-sequence", type=int, default=1, metavar="N", help="first packet to send (default: 1)")
    parser.add_argument(
        "--boot-id",
        metavar="ID",
        help="boot to send as; without it one that is the same for the same recording, so that a replay that is "
        "repeated changes nothing",
    )
    parser.add_argument(
        "--give-up-after",
        type=float,
        default=60.0,
        metavar="S",
        help="seconds without acknowledgement to end after (default: 60)",
    )
    parser.add_argument("--json", action="store_true", help="print the figures as one JSON object")


@dataclass(frozen=True, slots=True)
class Replayed:
    """What came of a replay; ``lost`` are packets that the service never acknowledged."""

    packets: int
    sent: int
    acknowledged: int
    resent: int
    refused: int
    lost: int
    refused_codes: dict[str, int]
    duration_s: float
    trouble: str | None

    def figures(self) -> dict[str, Any]:
        """The figures by their names."""
        names = ("packets", "sent", "acknowledged", "resent", "refused", "lost", "refused_codes")
        return {**{name: getattr(self, name) for name in names}, "duration_s": round(self.duration_s, 3)}


def run(arguments: argparse.Namespace) -> int:
    """Replay; 1 if something stayed unacknowledged."""
    _check(arguments)
    drive = read_with_progress(arguments.drive)
    boot_id = arguments.boot_id or boot_of(drive)
    packets = [
        packet
        for packet in drive_packets(drive, boot_id, vehicle_id=arguments.vehicle)
        if packet.sequence >= arguments.from_sequence
    ]
    if not packets:
        raise UsageError(f"{arguments.drive}: the drive has no packet {arguments.from_sequence}; see --from-sequence")
    link = link_to(arguments.to, arguments.tenant, arguments.vehicle, arguments.token)
    with Progress("replay", len(packets)) as progress:
        replayed = replay(
            packets, link, boot_id, speed=arguments.speed, give_up_after_s=arguments.give_up_after, tell=progress.update
        )
    _print(replayed, as_json=arguments.json)
    if replayed.lost:
        sys.stderr.write(
            f"telefuse replay: {replayed.lost} packets were not acknowledged: {replayed.trouble or 'no answer'}\n"
        )
        return EXIT_UNACKNOWLEDGED
    return 0


def replay(
    packets: Sequence[TelemetryPacket],
    link: Link,
    boot_id: str,
    *,
    speed: float,
    give_up_after_s: float,
    tell: Callable[[int], None] = lambda _: None,
) -> Replayed:
    """Send packets as a box: at ``speed`` times real time, or as fast as acknowledged for 0.

    Ends when all is acknowledged, or nothing was for ``give_up_after_s``. ``tell`` gets the number acknowledged.
    """
    started_s = time.monotonic()
    box = BlackBox(link, boot_id, capacity=WINDOW if speed == 0 else 10 * WINDOW)
    box.start()
    try:
        for packet in packets:
            if speed > 0:
                due_s = started_s + (packet.start_time_ns - packets[0].start_time_ns) / _NS_PER_S / speed
                time.sleep(max(0.0, due_s - time.monotonic()))
                tell(box.figures.acknowledged)
            while not box.put(packet, _POLL_S) and not box.is_stuck(give_up_after_s):
                tell(box.figures.acknowledged)
            if box.is_stuck(give_up_after_s):
                break
        while not box.wait_acknowledged(_POLL_S) and not box.is_stuck(give_up_after_s):
            tell(box.figures.acknowledged)
        tell(box.figures.acknowledged)
        trouble, figures, refusals = box.trouble, box.figures, box.refusals
    finally:
        box.stop()
    codes = list(refusals.values())
    return Replayed(
        packets=len(packets),
        sent=figures.sent,
        acknowledged=figures.acknowledged,
        resent=figures.resent,
        refused=figures.refused,
        lost=len(packets) - figures.acknowledged - figures.refused,
        refused_codes={code: codes.count(code) for code in sorted(set(codes))},
        duration_s=time.monotonic() - started_s,
        trouble=trouble,
    )


def boot_of(drive: Drive) -> str:
    """A boot id that is the same for the same recording."""
    content = hashlib.sha256(f"{drive.name}\0{drive.start_t_ns}".encode())
    for samples in (drive.measurements.imu_t_ns, drive.measurements.f_s, drive.measurements.gnss):
        content.update(samples.tobytes())
    return f"replay-{content.hexdigest()[:16]}"


def link_to(address: str, tenant_id: str, vehicle_id: str, token: str | None) -> Link:
    """The link that an address asks for; raises UsageError."""
    if _HTTP_ADDRESS.fullmatch(address):
        return HttpLink(address, token)
    if _ZENOH_ADDRESS.fullmatch(address):
        return ZenohLink(address, tenant_id, vehicle_id)
    raise UsageError(f"--to {address}: expected tcp/HOST:PORT for Zenoh, or http://HOST:PORT")


def _check(arguments: argparse.Namespace) -> None:
    for option, name, longest in (
        ("--vehicle", arguments.vehicle, MAX_VEHICLE_ID),
        ("--tenant", arguments.tenant, MAX_TENANT_ID),
        ("--boot-id", arguments.boot_id, MAX_BOOT_ID),
    ):
        if name is not None and not is_name(name, longest):
            raise UsageError(f"{option} {name}: expected 1 to {longest} {NAME_RULE}")
    if not (math.isfinite(arguments.speed) and arguments.speed >= 0):
        raise UsageError(f"--speed {arguments.speed:g}: expected 0 (as fast as acknowledged) or more")
    if not (math.isfinite(arguments.give_up_after) and arguments.give_up_after > 0):
        raise UsageError(f"--give-up-after {arguments.give_up_after:g}: expected seconds, above 0")
    if arguments.from_sequence < 1:
        raise UsageError(f"--from-sequence {arguments.from_sequence}: expected 1 or more")


def _print(replayed: Replayed, *, as_json: bool) -> None:
    if as_json:
        print(json.dumps(replayed.figures()))
        return
    codes = ", ".join(f"{count} {code}" for code, count in replayed.refused_codes.items())
    print(
        f"sent {replayed.sent}, acknowledged {replayed.acknowledged}, resent {replayed.resent}, "
        f"refused {replayed.refused}{f' ({codes})' if codes else ''}, lost {replayed.lost}"
    )
