"""``telefuse fuse``: post-process a drive folder with the very filter that the service streams through."""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from core.navigation.road_profile import SPACING_M
from core.navigation.track import Track
from service.cli.denoising import denoise_lines, denoise_with_progress
from service.cli.drives import add_drive, check_outages, fuse_ecef_with_progress, fuse_with_progress, open_drive
from service.cli.progress import Progress
from service.errors import UsageError
from service.recordings.drive_folder import Drive
from service.recordings.exporters import TrackFile, check_ending, export_track
from service.recordings.files import write_whole
from service.recordings.fusing import Fused, Outage, figures
from service.recordings.mapping import Mapping, mapping_text
from service.reports.navigation import NavigationReport


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    add_drive(parser)
    parser.add_argument(
        "--out", type=Path, metavar="FILE", help="trajectory to write: .csv, .csv.gz, .geojson, .gpx, .kml or .parquet"
    )
    parser.add_argument(
        "--outage",
        action="append",
        default=[],
        metavar="START:DURATION",
        help="withhold GNSS for that span, in seconds of the drive, and tell the error in it; may be repeated",
    )
    parser.add_argument(
        "--filter",
        choices=("ned", "ecef"),
        default="ned",
        help="ned: the one that the service streams through (default); ecef: the mobile-mapping paper's, with the"
        " attitude of attitude.csv or, without it, of the ned filter; it knows no constraints and no wheel speed",
    )
    parser.add_argument(
        "--poses",
        type=Path,
        metavar="TIMES.csv",
        help="give position, attitude and their covariance at these instants (a column t_s, seconds of the drive)",
    )
    parser.add_argument(
        "--poses-out", type=Path, metavar="FILE.csv", help="where poses go (default: TIMES_poses.csv beside TIMES.csv)"
    )
    parser.add_argument(
        "--profile",
        type=Path,
        metavar="ROAD",
        help="write the road driven, its line in 3-D with height, grade and banking: .geojson, .csv or .csv.gz",
    )
    parser.add_argument(
        "--profile-spacing",
        type=float,
        default=SPACING_M,
        metavar="M",
        help=f"distance between the points of the profile (default: {SPACING_M:g} m)",
    )
    parser.add_argument("--every", type=float, default=0.0, metavar="S", help="thin the rows to one each S seconds")
    parser.add_argument(
        "--denoise",
        action="store_true",
        help="denoise the inertial samples by wavelets first, and tell the figures with and without",
    )
    parser.add_argument(
        "--smooth", action="store_true", help="let the whole drive enter each row, backwards through every outage too"
    )
    parser.add_argument(
        "--report",
        type=Path,
        metavar="FILE.html",
        help="page to write: map, errors, aids and biases as interactive plots, without any network",
    )
    parser.add_argument("--no-nhc", action="store_true", help="without non-holonomic constraints")
    parser.add_argument("--no-zupt", action="store_true", help="without zero-velocity updates")
    parser.add_argument("--json", action="store_true", help="print the figures as one JSON object")


def run(arguments: argparse.Namespace) -> int:
    """Fuse, write the trajectory, print the figures."""
    if not (math.isfinite(arguments.every) and 0.0 <= arguments.every <= 60.0):
        raise UsageError(f"--every {arguments.every:g}: expected 0 (every sample) to 60 s")
    out: Path | None = arguments.out
    if out is not None:
        check_ending(out)
    if arguments.smooth and arguments.filter == "ecef":
        raise UsageError("--smooth goes with --filter ned: the paper's filter runs forward only")
    mapping = Mapping.asked(arguments.poses, arguments.poses_out, arguments.profile, arguments.profile_spacing)
    report: Path | None = arguments.report
    if report is not None and report.suffix.lower() != ".html":
        raise UsageError(f"--report {report}: unknown file ending; expected .html")
    outages = [Outage.parse(text) for text in arguments.outage]
    drive, config = open_drive(arguments, non_holonomic=not arguments.no_nhc, zero_velocity=not arguments.no_zupt)
    check_outages(outages, drive)
    instants = mapping.instants(drive)
    run_filter: Callable[[Drive], Fused]
    if arguments.filter == "ecef":
        run_filter = partial(fuse_ecef_with_progress, config=config, outages=outages)
    else:
        keep = mapping.wanted or report is not None
        run_filter = partial(fuse_with_progress, config=config, outages=outages, keep=keep, smooth=arguments.smooth)
    denoised = denoise_with_progress(drive) if arguments.denoise else None
    fused = run_filter(drive if denoised is None else denoised.drive)
    if out is not None:
        rows = _written(fused.track, arguments.every)
        content = TrackFile(rows, drive.start_t_ns, drive.name, drive.gnss_alt_is_msl)
        with Progress(f"writing {out.name}", 100) as progress:
            export_track(out, content, lambda share: progress.update(int(100 * share)))
    found = figures(drive, fused, outages) | {"out": None if out is None else str(out)}
    if denoised is not None:
        raw = figures(drive, run_filter(drive), outages)
        found["denoise"] = denoised.figures() | {"without": raw}
    if fused.solution is not None:
        found |= mapping.write(drive, config, fused.solution, instants)
    found["report"] = None if report is None else str(report)
    if report is not None:
        page = NavigationReport(drive, config, outages, fused, found, fused.solution, fused.records)
        with Progress(f"writing {report.name}", 1) as progress:
            progress.update(0)
            write_whole(report, page.html().encode())
    print(json.dumps(found, default=float) if arguments.json else _text(drive.name, found))
    return 0


def _written(track: Track, every_s: float) -> Track:
    """The rows that have a place, thinned to the first of each ``every_s``: figures are of all rows."""
    placed = np.isfinite(track.column("lat_rad"))
    t_ns, rows = track.t_ns[placed], track.values[placed]
    if every_s > 0.0:
        first = np.diff(t_ns // round(every_s * 1e9), prepend=-1) != 0
        t_ns, rows = t_ns[first], rows[first]
    return Track(t_ns, rows)


def _text(name: str, found: dict[str, Any]) -> str:
    lines = [
        f"{name}: {found['duration_s']:.0f} s, {found['epochs']} samples, {found['ns_per_epoch']:.0f} ns each",
        "never aligned: no heading could be found"
        if found["aligned_after_s"] is None
        else f"aligned after {found['aligned_after_s']:.1f} s",
    ]
    if found["against"] is not None:
        rms = found["position_rms_m"] if found["against"] == "reference" else found["gnss_rms_m"]
        lines.append(f"horizontal error against {found['against']}: {rms:.2f} m RMS")
    if found.get("position_rms_offset_removed_m") is not None:
        north, east, down = found["offset_ned_m"]
        lines.append(
            f"  constant offset north {north:.2f}, east {east:.2f}, down {down:.2f} m; without it"
            f" {found['position_rms_offset_removed_m']:.2f} m RMS"
        )
    if found.get("yaw_rms_deg") is not None:
        lines.append(f"heading error: {found['yaw_rms_deg']:.2f}° RMS")
    for outage in found["outages"]:
        span = f"outage {outage['start_s']:g} s + {outage['duration_s']:g} s"
        if outage["rms_m"] is None:
            lines.append(f"{span}: nothing to compare with")
        else:
            lines.append(
                f"{span}: {outage['rms_m']:.2f} m RMS, {outage['end_m']:.2f} m at its end,"
                f" {outage['max_m']:.2f} m at most, over {outage['distance_m']:.0f} m, against {outage['against']}"
            )
    mounting = found["mounting"]
    how = "given" if mounting["given"] else "found" if mounting["found"] else "not given, nominal"
    lines.append(
        f"mounting {how}: "
        + ", ".join(
            f"{name} {angle:.1f}° ± {sd:.1f}°"
            for name, angle, sd in zip(("roll", "pitch", "yaw"), mounting["rpy_deg"], mounting["sd_deg"], strict=True)
        )
    )
    for aid, outcomes in found["aids"].items():
        lines.append(f"  {aid}: " + ", ".join(f"{count} {outcome}" for outcome, count in outcomes.items()))
    lines += denoise_lines(found)
    lines += mapping_text(found)
    if found["out"]:
        lines.append(f"written: {found['out']}")
    if found["report"]:
        lines.append(f"written: {found['report']}")
    return "\n".join(lines)
