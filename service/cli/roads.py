"""``telefuse roads``: prepare an OpenStreetMap extract, and find the roads under a drive."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any, Final

from service import settings
from service.cli import OneLineParser
from service.cli.drives import add_drive, fuse_with_progress, open_drive
from service.cli.ending import unwinding_on_sigterm
from service.cli.progress import Phases
from service.errors import UsageError
from service.recordings.drive_folder import Drive
from service.recordings.fusing import Outage
from service.roads import drives, extra, files
from service.roads.drives import Positions
from service.roads.matching import RoadService
from service.roads.protocol import MatchedPoints

EVERY_S: Final = 1.0
"""Positions are matched once a second."""


def configure(parser: argparse.ArgumentParser) -> None:
    """build or match."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True, parser_class=OneLineParser)
    text = "prepare an OpenStreetMap extract for matching: street, class, legal limit, district"
    build = actions.add_parser("build", help=text, description=text)
    build.add_argument("extract", metavar="EXTRACT.osm.pbf", type=Path, help="the extract")
    build.add_argument("out", metavar="OUT", type=Path, help="folder to make; one that was built before is replaced")
    build.add_argument(
        "--country", metavar="CODE", help="country of roads outside the borders that the extract has, such as FI"
    )
    build.add_argument(
        "--limits",
        type=Path,
        metavar="FILE.toml",
        help="default limits of your own, by country: they go before the ones that come along",
    )
    districts = build.add_mutually_exclusive_group()
    districts.add_argument(
        "--districts",
        type=Path,
        metavar="FILE",
        help="districts of your own: GeoJSON polygons with a property 'name', or CSV with columns name and wkt",
    )
    districts.add_argument(
        "--district-level",
        type=int,
        metavar="N",
        help="admin_level of the boundaries that are districts (default: the deepest from 7 to 10 that covers the"
        " roads)",
    )
    text = "find the roads under a drive folder's positions"
    match = actions.add_parser("match", help=text, description=text)
    add_drive(match)
    match.add_argument("--roads", type=Path, metavar="ROADS", help="folder of built roads (default: the setting ROADS)")
    match.add_argument("--out", type=Path, metavar="FILE", help="what was found: .csv, .csv.gz or .geojson")
    match.add_argument(
        "--source",
        choices=("fused", "raw", "reference"),
        default="fused",
        help="positions of the filter (default), of the receiver alone, or of the reference",
    )
    match.add_argument(
        "--outage",
        action="append",
        default=[],
        metavar="START:DURATION",
        help="withhold GNSS for that span, in seconds of the drive; may be repeated",
    )
    match.add_argument("--smooth", action="store_true", help="let the whole drive enter each fused position")
    for one in (build, match):
        one.add_argument("--json", action="store_true", help="print the figures as one JSON object")


def run(arguments: argparse.Namespace) -> int:
    """Do it, and say what came of it."""
    with unwinding_on_sigterm():
        return _build(arguments) if arguments.action == "build" else _match(arguments)


def _build(arguments: argparse.Namespace) -> int:
    extra.require()
    from service.roads.build import build

    with Phases() as phases:
        manifest = build(
            arguments.extract,
            arguments.out,
            phases.tell,
            limits=arguments.limits,
            country=arguments.country,
            district_level=arguments.district_level,
            own_districts=arguments.districts,
        )
    if arguments.json:
        print(json.dumps({"folder": str(arguments.out)} | manifest.json(), ensure_ascii=False))
        return 0
    print(f"{arguments.out}: {manifest.ways} ways of {manifest.extract}; {manifest.attribution}")
    print(f"  limits: {manifest.ways_with_stated_limit} ways as mapped, {manifest.ways_with_assumed_limit} assumed by")
    print(f"  the defaults of {', '.join(manifest.countries) or 'no country: give --country'}")
    if manifest.districts:
        by = f"of admin_level {manifest.district_level}" if arguments.districts is None else f"of {arguments.districts}"
        print(f"  {manifest.districts} districts, {by}")
    else:
        print("  no districts: the extract has no administrative boundaries that close")
    return 0


def _match(arguments: argparse.Namespace) -> int:
    if arguments.out is not None:
        files.check_ending(arguments.out)
    folder = arguments.roads or settings.load_settings().settings.roads
    if folder is None:
        raise UsageError("roads are unknown: give --roads ROADS, a folder made by 'telefuse roads build'")
    outages = [Outage.parse(text) for text in arguments.outage]
    if arguments.source != "fused" and (outages or arguments.smooth):
        raise UsageError(f"--outage and --smooth are of the fused track; expected no --source {arguments.source}")
    with RoadService(folder) as roads:
        drive, positions = _positions(arguments, outages)
        matched = positions.matched(roads)
    if arguments.out is not None:
        files.write_matched(arguments.out, positions, matched, drive.start_t_ns)
    _print(arguments, drive, positions, matched)
    return 0


def _positions(arguments: argparse.Namespace, outages: list[Outage]) -> tuple[Drive, Positions]:
    drive, config = open_drive(arguments, every_s=0.0 if arguments.smooth else EVERY_S)
    if arguments.source == "raw":
        return drive, drives.of_fixes(drive)
    if arguments.source == "reference":
        positions = drives.of_reference(drive)
        if positions is None:
            raise UsageError(f"{arguments.drive}: has no reference.csv; expected --source fused or raw")
        return drive, positions
    return drive, drives.of_track(fuse_with_progress(drive, config, outages, smooth=arguments.smooth).track)


def _print(arguments: argparse.Namespace, drive: Drive, positions: Positions, matched: MatchedPoints) -> None:
    found: dict[str, Any] = drives.summary(positions, matched)
    spans = [(one["start_s"], one["start_s"] + one["duration_s"]) for one in (drive.truth or {}).get("outages", ())]
    right = drives.rightness(drive, positions, matched, spans)
    if right is not None:
        found["truth"] = right.shares()
    if arguments.json:
        print(json.dumps(found, ensure_ascii=False))
        return
    print(f"{arguments.drive}: {found['matched_km']:.2f} of {found['distance_km']:.2f} km on known roads")
    print(
        f"  {found['ways']} ways, {found['streets']} streets; districts: {', '.join(found['districts']) or 'unknown'}"
    )
    print(f"  limits: {found['limit_tagged_km']:.2f} km as mapped, {found['limit_assumed_km']:.2f} km assumed")
    for name, share in found.get("truth", {}).items():
        if share is not None:
            print(f"  {name.replace('_', ' ')}: {100 * share:.1f} % of the distance")
    if found["matched_km"] == 0.0:
        sys.stderr.write("telefuse roads: no road was found; is the drive inside the extract?\n")
