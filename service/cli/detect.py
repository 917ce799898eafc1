"""``telefuse detect``: accidents and manoeuvres of a drive folder, one JSON object a line."""

from __future__ import annotations

import argparse
import json
import math
from dataclasses import asdict, replace
from typing import Any, Final

from core.accident.placing import Accident, Place, Suppressed, place_at
from core.accident.profiles import PROFILES, for_vehicle
from core.driving.manoeuvres import Episode, Manoeuvre
from core.navigation.track import Track
from service.accidents.rows import each_impact
from service.cli.drives import add_drive, fuse_with_progress, open_drive

_TYPES: Final = {
    Manoeuvre.BRAKING: "harsh_braking",
    Manoeuvre.ACCELERATION: "harsh_acceleration",
    Manoeuvre.CORNERING: "harsh_cornering",
    Manoeuvre.LANE_CHANGE: "lane_change",
}


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    add_drive(parser)
    parser.add_argument(
        "--detector",
        choices=("telefuse", "paper"),
        default="telefuse",
        help="the project's own detector, or the two-threshold rule of the accident-location paper",
    )
    parser.add_argument(
        "--vehicle-class", choices=tuple(PROFILES), default="car", help="sensitivity of the detector (default: car)"
    )
    parser.add_argument(
        "--suppressed", action="store_true", help="tell too what felt like an accident and was judged to be none"
    )


def run(arguments: argparse.Namespace) -> int:
    """Fold the drive through a session and print what it found, in the order of its time."""
    drive, config = open_drive(arguments, every_s=0.1)
    config = replace(config, detector=arguments.detector, impact=for_vehicle(arguments.vehicle_class))
    fused = fuse_with_progress(drive, config, [])
    lines = [_accident(accident, drive.start_t_ns) for accident in fused.accidents]
    if arguments.suppressed:
        lines += [_suppressed(one, drive.start_t_ns) for one in fused.suppressed]
    lines += [_manoeuvre(one, fused.track, drive.start_t_ns) for one in fused.episodes]
    for line in sorted(lines, key=lambda line: float(line["t_s"])):
        print(json.dumps(line))
    return 0


def _accident(accident: Accident, start_t_ns: int) -> dict[str, Any]:
    impact = accident.impact
    low_mps, high_mps = impact.delta_v_interval_mps
    return {
        "type": "accident",
        "t_s": (impact.t_ns - start_t_ns) * 1e-9,
        "decided_t_s": (impact.decided_t_ns - start_t_ns) * 1e-9,
        **_place(accident.place),
        "kind": impact.kind.value,
        "status": impact.status.value,
        "severity": impact.severity.value,
        "confidence": impact.confidence,
        "delta_v_mps": impact.delta_v_mps,
        "delta_v_sd_mps": _finite(impact.delta_v_sd_mps),
        "delta_v_interval_mps": [_finite(low_mps), _finite(high_mps)],
        "pdof_deg": _finite(impact.pdof_deg),
        "pdof_sd_deg": _finite(impact.pdof_sd_deg),
        "peak_mps2": impact.peak_mps2,
        "duration_s": impact.duration_s,
        "clipped": impact.clipped,
        "impacts": impact.impacts,
        "each_impact": each_impact(impact),
        "rollover": impact.rollover,
        "injury": None if impact.injury is None else asdict(impact.injury),
        "speed_before_mps": _finite(impact.speed_before_mps),
        "reasons": list(impact.reasons),
        "detector": impact.detector,
        "paper_agrees": impact.paper_agrees,
    }


def _suppressed(suppressed: Suppressed, start_t_ns: int) -> dict[str, Any]:
    candidate = suppressed.candidate
    return {
        "type": "suppressed",
        "t_s": (candidate.t_ns - start_t_ns) * 1e-9,
        "decided_t_s": (candidate.decided_t_ns - start_t_ns) * 1e-9,
        **_place(suppressed.place),
        "reason": candidate.reason.value,
        "probability": candidate.probability,
        "delta_v_mps": candidate.delta_v_mps,
        "vertical_mps": candidate.vertical_mps,
        "peak_mps2": candidate.peak_mps2,
        "duration_s": candidate.duration_s,
        "speed_before_mps": _finite(candidate.speed_before_mps),
        "paper_agrees": candidate.paper_agrees,
    }


def _manoeuvre(episode: Episode, track: Track, start_t_ns: int) -> dict[str, Any]:
    return {
        "type": _TYPES[episode.kind],
        "t_s": (episode.start_t_ns - start_t_ns) * 1e-9,
        "duration_s": episode.duration_s,
        **_place(place_at(episode.peak_t_ns, track)),
        "direction": episode.direction or None,
        "aggressive": episode.aggressive,
        "peak_mps2": episode.peak_mps2,
        "speed_before_mps": _finite(episode.speed_before_mps),
        "speed_after_mps": _finite(episode.speed_after_mps),
        "radius_m": _finite(episode.radius_m),
        "heading_change_deg": math.degrees(episode.heading_change_rad),
        "counted": episode.counted,
        "defensive": episode.defensive,
    }


def _place(place: Place) -> dict[str, Any]:
    return {
        "lat_deg": _finite(math.degrees(place.lat_rad)),
        "lon_deg": _finite(math.degrees(place.lon_rad)),
        "sd_n_m": _finite(place.sd_n_m),
        "sd_e_m": _finite(place.sd_e_m),
        "mode": place.mode.name.lower(),
    }


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
