"""What outages cost on recorded drives, wherever in the drive they come."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from service.bench.simulated_outages import Tell
from service.recordings.drive_folder import Drive, read_drive
from service.recordings.fusing import Fused, Outage, figures, fuse, fuse_config, vehicle_config

FIRST_S: Final = 60.0
EVERY_S: Final = 45.0
LENGTH_S: Final = 30.0
"""Outages of 30 s, each in a run of its own, every 45 s after the first minute."""

NAMED: Final = {"kth_stockholm": Outage(200.0, 99.0), "comma2k19_segment": Outage(20.0, 30.0)}
"""One outage of a drive that others have published a figure for, or that is all that a short drive allows."""
SWEPT: Final = ("kth_stockholm", "boston_vn100")
DRIVES: Final = tuple(sorted({*NAMED, *SWEPT}))

METHODS: Final[Mapping[str, Mapping[str, Any]]] = {
    "causal": {},
    "smoothed": {"smooth": True},
    "all fixes": {"smooth": True},
}
"""How a drive is fused, as options of ``fuse``."""
NOT_WITHHELD: Final = "all fixes"
"""The method without an outage: what is left there is the error of what it is compared with, and no outage has less."""


def placed(drive: Drive) -> list[Outage]:
    """The outages of the sweep that end inside the drive."""
    first_s, *_, last_s = (float(t_s) for t_s in drive.t_s(drive.measurements.imu_t_ns[[0, -1]]))
    starts = np.arange(first_s + FIRST_S, last_s - LENGTH_S, EVERY_S)
    return [Outage(float(start), LENGTH_S) for start in starts]


def measure(folder: Path, tell: Tell) -> dict[str, Any]:
    """RMS in the named outages; end errors of the swept ones with their median; each method."""
    drives = {name: read_drive(folder / name) for name in DRIVES}
    sweeps = {name: placed(drives[name]) for name in SWEPT}
    total = len(METHODS) * (len(NAMED) + sum(map(len, sweeps.values())))
    done = 0
    whole: dict[str, Fused] = {}
    found: dict[str, Any] = {name: {} for name in drives}
    for method in METHODS:
        for name, outage in NAMED.items():
            tell(done, total)
            fixes_after = int(np.sum(drives[name].t_s(drives[name].measurements.gnss_t_ns) >= outage.end_s))
            found[name].setdefault(
                "outage",
                {"start_s": outage.start_s, "duration_s": outage.duration_s, "fixes_after": fixes_after},
            )
            found[name]["outage"][method] = _in_outage(drives[name], outage, method, whole)
            done += 1
        for name, outages in sweeps.items():
            runs: list[dict[str, Any]] = []
            for outage in outages:
                tell(done, total)
                runs.append({"start_s": outage.start_s} | _in_outage(drives[name], outage, method, whole))
                done += 1
            found[name].setdefault("sweep", {"every_s": EVERY_S, "duration_s": LENGTH_S})
            found[name]["sweep"][method] = {
                "median_end_m": median_end_m(runs),
                "without_position": sum(run["end_m"] is None for run in runs),
                "outages": runs,
            }
    return found


def median_end_m(runs: list[dict[str, Any]]) -> float | None:
    """Of the end errors; an outage in which the filter had no position to tell counts as the worst."""
    median = float(np.median([math.inf if run["end_m"] is None else run["end_m"] for run in runs]))
    return median if math.isfinite(median) else None


def _in_outage(drive: Drive, outage: Outage, method: str, whole: dict[str, Fused]) -> dict[str, float | None]:
    """Figures of one outage; ``whole`` keeps what each drive is with nothing withheld: that is the same for all."""
    if method != NOT_WITHHELD:
        fused = _fused(drive, [outage], method)
    else:
        if drive.name not in whole:
            whole[drive.name] = _fused(drive, [], method)
        fused = whole[drive.name]
    (one,) = figures(drive, fused, [outage])["outages"]
    figures_of_one = {name: one[name] for name in ("rms_m", "end_m", "max_m", "distance_m")}
    return figures_of_one | {"resets": fused.counts.get("imu.reset", 0)}


def _fused(drive: Drive, withheld: list[Outage], method: str) -> Fused:
    return fuse(drive, fuse_config(vehicle_config(drive)), withheld, **METHODS[method])
