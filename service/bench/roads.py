"""How right roads are under simulated drives on an extract's own streets, and how fast they are found."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from service.bench.tables import aligned, verdicts
from service.bench.targets import Target, judged
from service.errors import UsageError
from service.recordings.fusing import fuse, fuse_config, vehicle_config
from service.recordings.simulated import drive_of
from service.roads import drives, extra
from service.roads.drives import Positions, Rightness
from service.roads.matching import RoadService

DRIVES: Final = 10
MOST_DRIVES: Final = 1000
DURATION_S: Final = 600.0
RATE_HZ: Final = 100.0
TRACE_POINTS: Final = 180
"""Of the traces that are counted a second: three minutes, one with a minute before and after it."""
_TIMED_S: Final = 5.0

TARGETS: Final = (
    Target("wrong way with GNSS, of the distance", "roads/wrong_way_with_gnss", 0.03, ""),
    Target("wrong way in outages of 60 s, of the distance", "roads/wrong_way_in_outages", 0.10, ""),
    Target("wrong limit on the right way where the map has one", "roads/wrong_limit_on_right_way", 0.0, ""),
)


def measure(folder: Path, count: int, tell: Callable[[str, float, float], None]) -> dict[str, Any]:
    """Figures of drives with the seeds from 1 on, fused causally; outages are those of 60 s, tunnels count nowhere."""
    extra.require()
    if not 1 <= count <= MOST_DRIVES:
        raise UsageError(f"--drives {count}: expected 1 to {MOST_DRIVES} drives with --roads")
    from service.roads.simulated import OUTAGE_S, simulate_on_roads

    total = Rightness()
    rows: list[dict[str, Any]] = []
    with RoadService(folder) as roads:
        manifest = roads.manifest
        assert manifest is not None
        for seed in range(1, count + 1):
            tell("roads", seed - 1, count)
            drive = drive_of(simulate_on_roads(folder, seed, DURATION_S, RATE_HZ))
            fused = fuse(drive, fuse_config(vehicle_config(drive), every_s=1.0))
            positions = drives.of_track(fused.track)
            matched = positions.matched(roads)
            spans = [(one["start_s"], one["start_s"] + one["duration_s"]) for one in (drive.truth or {})["outages"]]
            outages = [one for one in spans if abs(one[1] - one[0] - OUTAGE_S) < 0.5]
            right = drives.rightness(drive, positions, matched, outages)
            assert right is not None
            total = total.plus(right)
            distance_km = (right.with_gnss_m + right.outage_m) / 1000.0
            rows.append({"seed": seed, "distance_km": distance_km} | right.shares())
        tell("traces", 0, 1)
        speed = _traces_per_s(roads, positions)
    shares = total.shares()
    wrong = {
        name.replace("right_", "wrong_", 1): None if share is None else 1.0 - share for name, share in shares.items()
    }
    found: dict[str, Any] = {
        "roads": {
            "extract": manifest.extract,
            "drives": rows,
            "distance_km": (total.with_gnss_m + total.outage_m) / 1000.0,
            "outage_km": total.outage_m / 1000.0,
            "tagged_km": total.tagged_m / 1000.0,
            **shares,
            **wrong,
            **speed,
        }
    }
    return found | {"targets": judged(found, TARGETS)}


def _traces_per_s(roads: RoadService, positions: Positions) -> dict[str, Any]:
    """Traces a second that come back from the processes, each of ``TRACE_POINTS`` points of the last drive."""
    known = np.flatnonzero(np.isfinite(positions.lat_deg))[:TRACE_POINTS]
    columns = [getattr(positions, name)[known] for name in Positions.__slots__]
    done, begin = 0, time.perf_counter()
    while time.perf_counter() - begin < _TIMED_S:
        done += roads.match_traces([columns] * roads.processes)
    return {
        "traces_per_s": done / (time.perf_counter() - begin),
        "trace_points": int(known.size),
        "processes": roads.processes,
    }


def tables(found: Mapping[str, Any]) -> str:
    """What was measured, drive by drive, and what was asked of it."""
    return "\n\n".join(("\n".join(_roads(found["roads"])), "\n".join(verdicts(found["targets"]))))


def _roads(one: Mapping[str, Any]) -> Iterable[str]:
    yield f"simulated drives on {one['extract']}, the fused track matched once a second; % of the distance:"
    names = (
        ("right_way_with_gnss", "way, GNSS"),
        ("right_way_in_outages", "way, outage"),
        ("right_street", "street"),
        ("right_limit_where_tagged", "mapped limit"),
        ("right_district", "district"),
    )
    rows = [("seed", "km", *(text for _, text in names))]
    rows += [
        (str(row["seed"]), f"{row['distance_km']:.2f}", *(_percent(row[name]) for name, _ in names))
        for row in [*one["drives"], {"seed": "all", **one}]
    ]
    yield from aligned(rows)
    yield (f"{one['traces_per_s']:.0f} traces of {one['trace_points']} points a second by {one['processes']} processes")


def _percent(share: float | None) -> str:
    return "" if share is None else f"{100 * share:.1f}"
