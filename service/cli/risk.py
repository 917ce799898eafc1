"""``telefuse risk``: combine masses of belief, assess a drive's risk, and show the tables that it goes by."""

from __future__ import annotations

import argparse
import json
import sys
from contextlib import AbstractContextManager, nullcontext
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

from core.risk.combination import RULES
from core.risk.driver import SEXES, Driver
from schemas.times import parse_time
from service import settings
from service.cli.drives import add_drive, check_outages, fuse_with_progress, open_drive
from service.cli.progress import Progress
from service.errors import UsageError
from service.recordings.drive_folder import Drive
from service.recordings.files import write_whole
from service.recordings.fusing import Fused, Outage
from service.risk import telling
from service.risk.assessing import SOURCES, Clock, assess_drive, by_source
from service.risk.combining import combined
from service.risk.districts import district_table
from service.risk.loading import PRESETS, risk_model, shipped_text
from service.roads.protocol import NullMatcher, RoadMatcher

TABLE_1: Final = ("reference", "raw", "fused")
DEFINED: Final = ("pcr6", "pcr6+", "pcr5", "yager", "dubois-prade")
"""Rules that give every instant a mass that sums to 1 without conflict, so that their mean says something."""


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the command's parts."""
    parts = parser.add_subparsers(dest="part", metavar="PART", required=True, parser_class=type(parser))
    _configure_combine(parts.add_parser("combine", help="combine the masses of several sources by a rule"))
    _configure_assess(parts.add_parser("assess", help="assess the risk of a drive by driver, environment and vehicle"))
    tables = parts.add_parser("tables", help="print a file of tables with its sources, to begin one's own with")
    tables.add_argument("name", choices=(*PRESETS, "vehicle"), nargs="?", default=PRESETS[0], help="which (default)")
    tables.set_defaults(part_run=_tables)
    districts = parts.add_parser("districts", help="make tables of a CSV of districts' rates, for --tables")
    districts.add_argument(
        "file", type=Path, metavar="RATES.csv", help="columns district, rate and, if there, exposure"
    )
    districts.add_argument("--source", default="the user's own", metavar="TEXT", help="where the rates come from")
    districts.set_defaults(part_run=_districts)


def run(arguments: argparse.Namespace) -> int:
    """Run the part asked for."""
    return int(arguments.part_run(arguments))


def _configure_combine(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "file",
        type=Path,
        metavar="FILE.json",
        help='{"sources": [{"MR": 0.3, "LR|MR": 0.7}, …]} or a list of such',
    )
    parser.add_argument(
        "--rule", metavar="RULE", help=f"one of {', '.join(RULES)} (default: the case's own, or {RULES[0]})"
    )
    parser.add_argument("--explain", action="store_true", help="tell what each source contributes, by Shapley values")
    parser.add_argument("--json", action="store_true", help="print JSON, which is what is printed anyway")
    parser.set_defaults(part_run=_combine)


def _combine(arguments: argparse.Namespace) -> int:
    if arguments.rule is not None and arguments.rule not in RULES:
        raise UsageError(f"unknown rule '{arguments.rule}'; expected one of {', '.join(RULES)}")
    path: Path = arguments.file
    try:
        text = sys.stdin.read() if str(path) == "-" else path.read_text(encoding="utf-8")
    except OSError as error:
        raise UsageError(f"{path}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise UsageError(f"{path}: is no UTF-8 text: {error.reason} at byte {error.start}") from error
    print(json.dumps(combined(text, str(path), arguments.rule, explain=arguments.explain), allow_nan=False))
    return 0


def _configure_assess(parser: argparse.ArgumentParser) -> None:
    add_drive(parser)
    parser.add_argument("--driver-age", type=int, metavar="N", help="years (default: as drive.toml says, or left out)")
    parser.add_argument("--driver-sex", choices=SEXES, help="(default: as drive.toml says, or left out)")
    parser.add_argument("--driver-experience", type=float, metavar="YEARS", help="with a licence (default: left out)")
    parser.add_argument(
        "--start",
        metavar="RFC3339",
        help="take the drive to have begun then; an offset from UTC makes it local time (default: as drive.toml says,"
        " local time by the longitude)",
    )
    parser.add_argument(
        "--source",
        choices=SOURCES,
        default=SOURCES[0],
        help="fused: the filter's solution; raw: GNSS alone; reference: reference.csv (default fused)",
    )
    parser.add_argument("--table", action="store_true", help="all three sources side by side, as the paper's table I")
    parser.add_argument(
        "--roads", type=Path, metavar="ROADS", help="folder of built roads (default: the setting ROADS)"
    )
    parser.add_argument(
        "--outage", action="append", default=[], metavar="START:DURATION", help="withhold GNSS then; may be repeated"
    )
    parser.add_argument("--timeline", type=Path, metavar="FILE.csv", help="write every instant")
    parser.add_argument("--rule", choices=DEFINED, default=RULES[0], help=f"of both levels (default {RULES[0]})")
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--preset", choices=PRESETS, default=PRESETS[0], help=f"tables (default {PRESETS[0]})")
    which.add_argument("--tables", type=Path, metavar="FILE.toml", help="your own; see 'telefuse risk tables'")
    parser.add_argument("--json", action="store_true", help="print the figures as one JSON object")
    parser.set_defaults(part_run=_assess)


def _assess(arguments: argparse.Namespace) -> int:
    timeline: Path | None = arguments.timeline
    if timeline is not None and timeline.suffix.lower() != ".csv":
        raise UsageError(f"--timeline {timeline}: unknown file ending; expected .csv")
    if timeline is not None and arguments.table:
        raise UsageError("--timeline is of one source; expected --source beside it, not --table")
    model = risk_model(arguments.preset, arguments.tables, arguments.rule)
    clock = _clock(arguments.start)
    outages = [Outage.parse(text) for text in arguments.outage]
    drive, config = open_drive(arguments)
    check_outages(outages, drive)
    driver = _driver(arguments, drive, clock)
    sources: tuple[str, ...] = TABLE_1 if arguments.table else (arguments.source,)
    if drive.reference is None:
        if sources == ("reference",):
            raise UsageError(f"{drive.name}: has no reference.csv; expected one for --source reference")
        sources = tuple(source for source in sources if source != "reference")
    if set(sources) != {"reference"} and not len(drive.measurements.gnss_t_ns):
        raise UsageError(f"{drive.name}: has no gnss.csv; expected fixes to assess by")
    fused: Fused | None = None
    if "fused" in sources:
        fused = fuse_with_progress(drive, config, outages, keep=True)
    found: dict[str, dict[str, Any]] = {}
    with _roads(arguments.roads) as matcher, Progress("assessing", len(sources)) as progress:
        for done, source in enumerate(sources):
            progress.update(done)
            instants = by_source(drive, source, outages, fused)
            assessed = assess_drive(drive, model, driver, instants, outages, matcher, clock)
            found[source] = telling.figures(assessed, model, driver, source)
    if timeline is not None:
        write_whole(timeline, telling.timeline(drive, assessed).encode())
    if arguments.table:
        told: dict[str, Any] = {"columns": found}
        if {"fused", "reference"} <= set(found):
            told["difference"] = telling.difference(found)
        print(json.dumps(told) if arguments.json else telling.table_1(drive, found))
    else:
        one = found[sources[0]]
        print(json.dumps(one) if arguments.json else telling.text(drive, one))
    return 0


def _clock(start: str | None) -> Clock:
    if start is None:
        return Clock()
    try:
        start_t_ns = parse_time(start)
    except ValueError as error:
        raise UsageError(f"--start {error}") from None
    if start.strip()[-1] in "Zz":
        return Clock(start_t_ns)
    offset = datetime.fromisoformat(start.strip().upper()).utcoffset()
    return Clock(start_t_ns, None if offset is None else offset.total_seconds())


def _driver(arguments: argparse.Namespace, drive: Drive, clock: Clock) -> Driver:
    """As the options say, else as the drive does."""
    age, told = arguments.driver_age, drive.driver
    if age is None:
        age = told.age
    if age is None and told.birth_year is not None:
        start_t_ns = drive.start_t_ns if clock.start_t_ns is None else clock.start_t_ns
        age = datetime.fromtimestamp(start_t_ns // 1_000_000_000, UTC).year - told.birth_year
    return Driver(age, arguments.driver_sex or told.sex, arguments.driver_experience)


def _roads(asked: Path | None) -> AbstractContextManager[RoadMatcher]:
    folder = asked or settings.load_settings().settings.roads
    if folder is None:
        return nullcontext(NullMatcher())
    from service.roads.matching import RoadService

    return RoadService(folder)


def _tables(arguments: argparse.Namespace) -> int:
    sys.stdout.write(shipped_text(arguments.name))
    return 0


def _districts(arguments: argparse.Namespace) -> int:
    sys.stdout.write(district_table(arguments.file, arguments.source))
    return 0
