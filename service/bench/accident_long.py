"""Detectors on long simulated drives full of non-accidents: how often they cry wolf in 100 000 km."""

from __future__ import annotations

import math
import time
from typing import Any, Final

from core.simulation.long_drive import PIECE_KM, drive_piece
from service.bench.accident_scoring import DETECTORS, listen, quiet_figures, quiet_record, rate, reliability
from service.bench.processes import in_processes
from service.bench.simulated_outages import Tell

KM: Final = 100_000.0
SHOWN: Final = 50
"""False alarms told one by one, at most: the seed of a piece and when, so that each can be looked at."""


def measure(tell: Tell, km: float = KM) -> dict[str, Any]:
    """False alarms a distance of each detector over the same pieces, and what the non-accidents were named."""
    started_s = time.perf_counter()
    pieces = math.ceil(km / PIECE_KM)
    driven_m, samples = 0.0, 0
    found: dict[str, dict[str, list[Any]]] = {name: {"alarms": [], "withdrawn": [], "quiet": []} for name in DETECTORS}
    for done, (distance_m, count, by_detector) in enumerate(in_processes(_judge, range(pieces))):
        tell(done + 1, pieces)
        driven_m += distance_m
        samples += count
        for name, parts in by_detector.items():
            for key, rows in parts.items():
                found[name][key].extend(rows)
    return {
        "km": driven_m / 1e3,
        "hours": samples / 360_000.0,
        "wall_s": time.perf_counter() - started_s,
        "non_accidents": len(next(iter(found.values()))["quiet"]),
        **{
            name: {
                "false_alarms": rate(len(parts["alarms"]), driven_m / 1e3),
                "withdrawn": rate(len(parts["withdrawn"]), driven_m / 1e3),
                "shown": parts["alarms"][:SHOWN],
                "quiet": quiet_figures(parts["quiet"]),
                "reliability": reliability(parts["quiet"]),
            }
            for name, parts in found.items()
        },
    }


def _judge(seed: int) -> tuple[float, int, dict[str, dict[str, list[Any]]]]:
    """Distance, samples, and by detector the alarms and what was taken for what, of a piece."""
    piece = drive_piece(seed)
    found: dict[str, dict[str, list[Any]]] = {}
    for name in DETECTORS:
        told, candidates = listen(name, piece.motions)
        alarms = [
            {
                "seed": seed,
                "t_ns": story.first.t_ns,
                "delta_v_mps": story.last.delta_v_mps,
                "confidence": story.last.confidence,
                "during": [
                    one.kind.value
                    for one in piece.happenings
                    if one.begin_ns - 1_000_000_000 <= story.first.t_ns <= one.end_ns + 2_000_000_000
                ],
                "stands": story.stands,
            }
            for story in told
        ]
        found[name] = {
            "alarms": [one for one in alarms if one["stands"]],
            "withdrawn": [one for one in alarms if not one["stands"]],
            "quiet": [quiet_record(one.kind, one.begin_ns, one.end_ns, told, candidates) for one in piece.happenings],
        }
    return piece.distance_m, piece.samples, found
