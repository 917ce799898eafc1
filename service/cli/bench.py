"""``telefuse bench``: what this machine can do with this service, and where it would end first."""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from service.bench import (
    accident_long,
    accident_report,
    accidents,
    belief,
    calibration,
    calibration_report,
    driving,
    kernel,
    load,
    navigation,
    navigation_report,
    report,
    roads,
    score_queries,
    scores,
    scores_report,
    stages,
)
from service.bench.fleet import record_drives
from service.bench.target import Address
from service.cli.ending import unwinding_on_sigterm
from service.cli.progress import Phases, Progress
from service.demo.service_process import ServiceProcess, free_port
from service.errors import UsageError

FELL_SHORT: Final = 1

MAX_VEHICLES: Final = 1000
"""Each is a connection and two threads of this process."""

MAX_SECONDS: Final = 3600.0
RATES_HZ: Final = (10.0, 1000.0)

_HTTP: Final = re.compile(r"https?://[^\s/]+/?")
_ZENOH: Final = re.compile(r"(tcp|tls|quic|ws|udp)/\S+:\d{1,5}\S*")


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("--vehicles", type=int, default=50, metavar="N", help="simulated vehicles (default 50)")
    parser.add_argument(
        "--rate", type=float, default=200.0, metavar="HZ", help="inertial samples a second of each (default 200)"
    )
    parser.add_argument(
        "--seconds",
        type=float,
        default=8.0,
        metavar="S",
        help="how long the service is saturated, and then how long it is loaded by half for latency (default 8)",
    )
    instead = parser.add_mutually_exclusive_group()
    instead.add_argument("--kernel", action="store_true", help="measure the navigation filter alone")
    instead.add_argument("--belief", action="store_true", help="measure the fusion of beliefs alone")
    instead.add_argument(
        "--navigation",
        action="store_true",
        help="measure the navigation's accuracy instead: errors in outages of simulated and recorded drives, whether"
        " they are as large as stated, what calibration is worth; beside what is asked of each",
    )
    instead.add_argument(
        "--calibration",
        action="store_true",
        help="measure the calibration instead: its minimiser beside SciPy's, simulated units against their truth,"
        " public recordings against what other programs found; beside what is asked of each",
    )
    instead.add_argument(
        "--accidents",
        action="store_true",
        help="measure the accident engine instead: accidents found, placed and described, false alarms per 100 000 km,"
        " in simulation and on recordings; the paper's rule on the same input; beside what is asked of each",
    )
    instead.add_argument(
        "--driving",
        action="store_true",
        help="measure the driving manoeuvres instead: what is found of those of labelled trips, and what beside them",
    )
    instead.add_argument(
        "--score-queries",
        action="store_true",
        help="measure how long a score over HTTP takes instead, of a vehicle with 10 000 trips over five years",
    )
    parser.add_argument(
        "--database",
        metavar="URL",
        help="with --score-queries: an empty database, such as postgresql+psycopg://USER@HOST/NAME (default: SQLite)",
    )
    instead.add_argument(
        "--scores",
        action="store_true",
        help="measure the scores instead, over a simulated portfolio with known claim rates: calibration, lift,"
        " stability, intervals, and what wrong models would show",
    )
    instead.add_argument(
        "--roads",
        type=Path,
        metavar="ROADS",
        help="measure road matching instead, by simulated drives on a folder that 'telefuse roads build' made",
    )
    parser.add_argument(
        "--drivers", type=int, metavar="N", help=f"with --scores: how many drivers (default {scores.DRIVERS})"
    )
    parser.add_argument(
        "--km",
        type=float,
        metavar="KM",
        help=f"with --accidents: how far the part 'long' drives (default {accident_long.KM:.0f})",
    )
    parser.add_argument(
        "--part",
        action="append",
        default=[],
        metavar="NAME",
        help=f"with --navigation: only this part, {', '.join(navigation.PART_NAMES)}; with --calibration:"
        f" {', '.join(calibration.PART_NAMES)}; with --accidents: {', '.join(accidents.PART_NAMES)}; may be repeated"
        " (default: all)",
    )
    parser.add_argument(
        "--recordings",
        type=Path,
        metavar="DIR",
        help="with --calibration, --accidents or --driving: where the recordings are (default: ../shared/data beside"
        " the checkout; the parts 'recordings' and 'noise' are left out where there are none)",
    )
    parser.add_argument(
        "--drives",
        metavar="DIR|N",
        help=f"with --roads: how many drives (default {roads.DRIVES}); with --navigation or --accidents: where the"
        " recorded drives are (default: ../shared/drives beside the checkout;"
        " the part 'real' is left out where there are none)",
    )
    parser.add_argument("--json", action="store_true", help="print the figures as one JSON object")
    parser.add_argument(
        "--to",
        metavar="URL",
        help="load this running service, which must have no other traffic, instead of one of its own; "
        "the vehicles are removed afterwards",
    )
    parser.add_argument("--token", metavar="KEY", help="API key for --to, with the scope admin")
    parser.add_argument(
        "--zenoh", metavar="ENDPOINT", help="with --to: send packets to this Zenoh endpoint (default: over HTTP)"
    )
    parser.add_argument("--http", action="store_true", help="without --to: send packets over HTTP, not Zenoh")


def run(arguments: argparse.Namespace) -> int:
    """Measure; 1 if a packet was lost or taken twice, or an alert did not come."""
    if arguments.recordings is not None and not (arguments.calibration or arguments.accidents or arguments.driving):
        raise UsageError("--recordings is for --calibration, --accidents and --driving; expected one of these")
    if arguments.km is not None and not arguments.accidents:
        raise UsageError("--km is for --accidents; expected --accidents beside it")
    if arguments.drivers is not None and not arguments.scores:
        raise UsageError("--drivers is for --scores; expected --scores beside it")
    if arguments.database is not None and not arguments.score_queries:
        raise UsageError("--database is for --score-queries; expected --score-queries beside it")
    if arguments.score_queries:
        with unwinding_on_sigterm(), Phases() as phases:
            queried = score_queries.measure(arguments.database, partial(phases.tell, "score queries"))
        print(json.dumps(queried) if arguments.json else score_queries.lines(queried))
        return 0
    if arguments.kernel:
        _print_kernel(as_json=arguments.json)
        return 0
    if arguments.belief:
        fused = belief.measure()
        print(json.dumps(fused) if arguments.json else belief.lines(fused))
        return 0
    if arguments.navigation:
        with Phases() as phases:
            found = navigation.measure(arguments.part, _folder(arguments.drives), phases.tell)
        print(json.dumps(found) if arguments.json else navigation_report.tables(found))
        return 0
    if arguments.roads is not None:
        count = _count(arguments.drives)
        with Phases() as phases:
            found = roads.measure(arguments.roads, count, phases.tell)
        print(json.dumps(found) if arguments.json else roads.tables(found))
        return 0
    if arguments.calibration:
        with Phases() as phases:
            found = calibration.measure(arguments.part, arguments.recordings, phases.tell)
        print(json.dumps(found) if arguments.json else calibration_report.tables(found))
        return 0
    if arguments.driving:
        with Phases() as phases:
            found = driving.measure(arguments.recordings, partial(phases.tell, "labelled trips"))
        print(json.dumps(found) if arguments.json else driving.tables(found))
        return 0
    if arguments.scores:
        with Phases() as phases:
            found = scores.measure(scores.DRIVERS if arguments.drivers is None else arguments.drivers, phases.tell)
        print(json.dumps(found, allow_nan=False) if arguments.json else scores_report.tables(found))
        return 0
    if arguments.accidents:
        km = accident_long.KM if arguments.km is None else arguments.km
        with Phases() as phases:
            found = accidents.measure(arguments.part, km, arguments.recordings, _folder(arguments.drives), phases.tell)
        print(json.dumps(found) if arguments.json else accident_report.tables(found))
        return 0
    _check(arguments)
    with unwinding_on_sigterm(), TemporaryDirectory(prefix="telefuse-bench-") as directory:
        drives = record_drives(arguments.rate)
        with _service(arguments, Path(directory) / "service") as address, Phases() as phases:
            loaded = load.measure(address, drives, arguments.vehicles, arguments.seconds, phases.tell)
        with Progress("stages", len(stages.STAGES)) as progress:
            measured = stages.measure(drives[0], Path(directory), progress.update)
    if arguments.json:
        print(json.dumps(report.figures(loaded, measured, arguments.rate)))
    else:
        print(report.table(loaded, measured, arguments.rate))
    if shortfalls := loaded.shortfalls():
        sys.stderr.write(f"telefuse bench: {'; '.join(shortfalls)}\n")
        return FELL_SHORT
    return 0


def _folder(drives: str | None) -> Path | None:
    return None if drives is None else Path(drives)


def _count(drives: str | None) -> int:
    if drives is None:
        return roads.DRIVES
    if not drives.isdecimal():
        raise UsageError(f"--drives {drives}: expected a number of drives with --roads")
    return int(drives)


@contextmanager
def _service(arguments: argparse.Namespace, data_dir: Path) -> Iterator[Address]:
    """The service to be loaded: the one asked for, or one of our own for so long."""
    if arguments.to is not None:
        yield Address(arguments.to.rstrip("/"), arguments.zenoh, arguments.token)
        return
    service = ServiceProcess(
        data_dir,
        free_port(),
        free_port(),
        log_level="warning",
        retention_track_days="0",  # the simulated drives are of years ago
        dangerous_allow_private_webhook_targets="true",
    )
    try:
        service.start()
        yield Address(service.http_url, None if arguments.http else service.zenoh_endpoint)
    finally:
        service.stop()


def _print_kernel(*, as_json: bool) -> None:
    figures = kernel.measure()
    if as_json:
        print(json.dumps(figures))
        return
    low, high = figures["ns_per_epoch_quartiles"]
    print(
        f"{figures['ns_per_epoch']:.1f} ns an epoch (quartiles {low:.1f} to {high:.1f}),"
        f" {figures['ns_per_epoch_all_aids']:.1f} with all aids, in the quietest of"
        f" {figures['rounds']} rounds of {figures['packets']} packets of {figures['rate_hz']} samples;"
        f" {figures['call_ns']:.0f} ns of a packet's time is the call itself"
    )
    print("  " + ", ".join(f"{name} {ns:.1f}" for name, ns in figures["parts_ns"].items()))


def _check(arguments: argparse.Namespace) -> None:
    if arguments.part or arguments.drives is not None:
        raise UsageError(
            "--part and --drives are for --navigation and --accidents, --part also for --calibration;"
            " expected one of these beside them"
        )
    if not 1 <= arguments.vehicles <= MAX_VEHICLES:
        raise UsageError(f"--vehicles {arguments.vehicles}: expected 1 to {MAX_VEHICLES}")
    low, high = RATES_HZ
    if not low <= arguments.rate <= high:
        raise UsageError(f"--rate {arguments.rate:g}: expected {low:g} to {high:g} Hz")
    if not 1.0 <= arguments.seconds <= MAX_SECONDS:
        raise UsageError(f"--seconds {arguments.seconds:g}: expected 1 to {MAX_SECONDS:g}")
    if arguments.to is None:
        for option in ("zenoh", "token"):
            if getattr(arguments, option) is not None:
                raise UsageError(f"--{option} is for a running service; say which by --to http://HOST:PORT")
        return
    if arguments.http:
        raise UsageError("--http is for a service of one's own; with --to packets go over HTTP unless --zenoh is given")
    if not _HTTP.fullmatch(arguments.to):
        raise UsageError(f"--to {arguments.to}: expected http://HOST:PORT")
    if arguments.zenoh is not None and not _ZENOH.fullmatch(arguments.zenoh):
        raise UsageError(f"--zenoh {arguments.zenoh}: expected tcp/HOST:PORT")
