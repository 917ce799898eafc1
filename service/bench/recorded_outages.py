"""What outages cost on recorded drives, wherever in the drive they come."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from core.measurements import FloatArray
from service.bench.simulated_outages import Tell
from service.recordings.drive_folder import Drive, read_drive
from service.recordings.fusing import Fused, Outage, figures, fuse, fuse_config, track_errors, vehicle_config

FIRST_S: Final = 60.0
EVERY_S: Final = 45.0
LENGTH_S: Final = 30.0
"""Outages of 30 s, each in a run of its own, every 45 s after the first minute."""

NAMED: Final = {"kth_stockholm": Outage(200.0, 99.0), "comma2k19_segment": Outage(20.0, 30.0)}
"""One outage of a drive that others have published a figure for, or that is all that a short drive allows."""
SWEPT: Final = ("kth_stockholm", "boston_vn100")
DRIVES: Final = tuple(sorted({*NAMED, *SWEPT}))

LIMIT: Final = "limit"
"""The method without an outage: smoothed with all but what it is compared with. What is left there is the error of that
itself and of a path with fixes all round, and no outage is to be asked for less."""
METHODS: Final[Mapping[str, Mapping[str, Any]]] = {
    "causal": {},
    "smoothed": {"smooth": True},
    LIMIT: {"smooth": True},
}
"""How a drive is fused, as options of ``fuse``."""
LEFT_OUT_EVERY: Final = 10
"""Compared with fixes, each is left out once, with those that are so many further on and back: far beyond what matters
to a path that has their neighbours."""
INSTANT_S: Final = 1e-3
"""An outage that holds one fix."""


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
    limits: dict[str, tuple[FloatArray, FloatArray]] = {}
    found: dict[str, Any] = {name: {} for name in drives}
    for method in METHODS:
        for name, outage in NAMED.items():
            tell(done, total)
            fixes_after = int(np.sum(drives[name].t_s(drives[name].measurements.gnss_t_ns) >= outage.end_s))
            found[name].setdefault(
                "outage",
                {"start_s": outage.start_s, "duration_s": outage.duration_s, "fixes_after": fixes_after},
            )
            found[name]["outage"][method] = _in_outage(drives[name], outage, method, limits)
            done += 1
        for name, outages in sweeps.items():
            runs: list[dict[str, Any]] = []
            for outage in outages:
                tell(done, total)
                runs.append({"start_s": outage.start_s} | _in_outage(drives[name], outage, method, limits))
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


def _in_outage(
    drive: Drive, outage: Outage, method: str, limits: dict[str, tuple[FloatArray, FloatArray]]
) -> dict[str, float | None]:
    """Figures of one outage; ``limits`` keeps what is left at each drive's fixes: that is the same for all outages."""
    if method == LIMIT and drive.reference is None:
        if drive.name not in limits:
            limits[drive.name] = _at_fixes(drive)
        t_s, error_m = limits[drive.name]
        inside = error_m[(t_s >= outage.start_s) & (t_s < outage.end_s)]
        return {"rms_m": float(np.sqrt(np.mean(inside**2))), "end_m": float(inside[-1]), "max_m": float(inside.max())}
    fused = _fused(drive, [] if method == LIMIT else [outage], method)
    (one,) = figures(drive, fused, [outage])["outages"]
    figures_of_one = {name: one[name] for name in ("rms_m", "end_m", "max_m", "distance_m")}
    return figures_of_one | {"resets": fused.counts.get("imu.reset", 0)}


def _at_fixes(drive: Drive) -> tuple[FloatArray, FloatArray]:
    """Times of the fixes, s, and how far off each is from a path smoothed without it, m."""
    times_ns = drive.measurements.gnss_t_ns
    parts: list[tuple[FloatArray, FloatArray]] = []
    for first in range(LEFT_OUT_EVERY):
        left_out_ns = times_ns[first::LEFT_OUT_EVERY]
        alone = [Outage(float(t_s) - INSTANT_S / 2, INSTANT_S) for t_s in drive.t_s(left_out_ns)]
        _, errors = track_errors(drive, _fused(drive, alone, LIMIT).track, ())
        assert errors is not None
        chosen = np.isin(errors.t_ns, left_out_ns)
        parts.append((errors.t_s[chosen], errors.horizontal_m[chosen]))
    t_s, error_m = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    order = np.argsort(t_s)
    return t_s[order], error_m[order]


def _fused(drive: Drive, withheld: list[Outage], method: str) -> Fused:
    return fuse(drive, fuse_config(vehicle_config(drive)), withheld, **METHODS[method])
