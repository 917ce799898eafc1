"""Seed 3 as a table: the mobile-mapping paper's filter in GNSS gaps, against our causal filter and our smoother."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from core.simulation.scenarios import simulate
from service.bench.simulated_outages import Tell, outages_of
from service.recordings.drive_folder import Drive, read_drive
from service.recordings.fusing import Fused, Outage, figures, fuse, fuse_config, vehicle_config
from service.recordings.fusing_ecef import fuse_ecef
from service.recordings.simulated import drive_of

SCENARIO: Final = "outages"
SEEDS: Final = (1, 2, 3)
GAPS: Final = {
    "kth_stockholm": (Outage(120.0, 30.0), Outage(200.0, 60.0)),
    "comma2k19_segment": (Outage(20.0, 30.0),),
    "boston_vn100": (Outage(1000.0, 30.0), Outage(1200.0, 30.0), Outage(1400.0, 30.0)),
}
"""Gaps with fixes on either side, while the vehicle moves."""
FILTERS: Final = {"ecef": "the paper's filter", "causal": "our filter", "smoothed": "our smoother"}


def measure(tell: Tell, folder: Path | None = None) -> dict[str, Any]:
    """RMS in each gap by each filter; of simulated drives, and of the recorded ones in ``folder`` if it is given."""
    gaps: list[dict[str, Any]] = []
    drives = list(_drives(folder))
    for done, (drive, outages) in enumerate(drives):
        tell(done, len(drives))
        gaps += _of_drive(drive, outages)
    return {"filters": FILTERS, "gaps": gaps}


def _drives(folder: Path | None) -> Iterator[tuple[Drive, tuple[Outage, ...]]]:
    for seed in SEEDS:
        drive = drive_of(simulate(SCENARIO, seed, None, 100.0))
        yield drive, tuple(outages_of(drive))
    if folder is not None:
        for name, outages in GAPS.items():
            yield read_drive(folder / name), outages


def _of_drive(drive: Drive, outages: tuple[Outage, ...]) -> list[dict[str, Any]]:
    config = fuse_config(vehicle_config(drive))
    causal = fuse(drive, config, outages, keep=True)
    runs: dict[str, Fused] = {
        "ecef": fuse_ecef(drive, config, outages, causal),
        "causal": causal,
        "smoothed": fuse(drive, config, outages, smooth=True),
    }
    rms = {name: [one["rms_m"] for one in figures(drive, run, outages)["outages"]] for name, run in runs.items()}
    return [
        {"drive": drive.name, "start_s": outage.start_s, "duration_s": outage.duration_s}
        | {f"{name}_rms_m": rms[name][i] for name in FILTERS}
        for i, outage in enumerate(outages)
    ]
