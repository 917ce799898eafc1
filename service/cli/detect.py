"""``telefuse detect``: accidents of a drive folder, one JSON object a line."""

from __future__ import annotations

import argparse
import json
import math
from dataclasses import replace
from typing import Any

from core.accident.placing import Accident
from service.cli.drives import add_drive, fuse_with_progress, open_drive


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    add_drive(parser)
    parser.add_argument(
        "--detector",
        choices=("telefuse", "paper"),
        default="telefuse",
        help="the project's own detector, or the two-threshold rule of the accident-location paper",
    )


def run(arguments: argparse.Namespace) -> int:
    """Fold the drive through a session and print what it found."""
    drive, config = open_drive(arguments, every_s=0.1)
    fused = fuse_with_progress(drive, replace(config, detector=arguments.detector), [])
    for accident in fused.accidents:
        print(json.dumps(_line(accident, drive.start_t_ns)))
    return 0


def _line(accident: Accident, start_t_ns: int) -> dict[str, Any]:
    impact = accident.impact
    return {
        "type": "accident",
        "t_s": (impact.t_ns - start_t_ns) * 1e-9,
        "decided_t_s": (impact.decided_t_ns - start_t_ns) * 1e-9,
        "lat_deg": _finite(math.degrees(accident.place.lat_rad)),
        "lon_deg": _finite(math.degrees(accident.place.lon_rad)),
        "sd_n_m": _finite(accident.place.sd_n_m),
        "sd_e_m": _finite(accident.place.sd_e_m),
        "mode": accident.place.mode.name.lower(),
        "severity": impact.severity.value,
        "confidence": impact.confidence,
        "delta_v_mps": impact.delta_v_mps,
        "delta_v_sd_mps": impact.delta_v_sd_mps,
        "pdof_deg": _finite(impact.pdof_deg),
        "peak_mps2": impact.peak_mps2,
        "duration_s": impact.duration_s,
        "clipped": impact.clipped,
        "speed_before_mps": _finite(impact.speed_before_mps),
        "detector": impact.detector,
        "paper_agrees": impact.paper_agrees,
    }


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
