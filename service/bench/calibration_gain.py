"""Figures 21 and 22 of seed 1 as a table: GNSS alone, integrated, and integrated with a calibrated box."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from scipy.stats import ttest_rel

from core.earth import ned_offset_m
from core.measurements import GNSS, FloatArray
from core.simulation.scenarios import simulate
from schemas.calibration import Calibration
from service.bench.simulated_outages import SEEDS, Tell, outages_of
from service.recordings.drive_folder import Drive
from service.recordings.fusing import Outage, figures, fuse, fuse_config, vehicle_config
from service.recordings.simulated import drive_of

SCENARIO: Final = "uncalibrated_outages"

SOLUTIONS: Final = {
    "gnss_held": "GNSS alone, its last fix held",
    "gnss_carried_on": "GNSS alone, its last fix carried on by its last velocity",
    "uncalibrated": "integrated, the box as soldered",
    "calibrated": "integrated, the box calibrated",
}
DRAWS: Final = 4
"""Drives of each box over each route, with other noise: within one, luck decides where the two boxes are near."""
CHANCE: Final = 0.025
"""How often two boxes that are as good as each other may be told apart, one-sided; usual."""

GNSS_ALONE: Final = ("gnss_held", "gnss_carried_on")


def measure(
    tell: Tell, seeds: Sequence[int] = SEEDS, duration_s: float | None = None, draws: int = DRAWS
) -> dict[str, Any]:
    """RMS and greatest error in each outage by solution, and in how many outages the order is another than expected.

    The calibrated box is corrected by its true parameters, so no calibration could do better.
    """
    by_draw: list[tuple[dict[str, Any], ...]] = []
    for done, seed in enumerate(seeds):
        tell(done, len(seeds))
        drives = [drive_of(simulate(SCENARIO, seed, duration_s, draw=draw)) for draw in range(draws)]
        by_draw += zip(*(_of_drive(drive, seed) for drive in drives), strict=True)
    outages = [_over_draws(same) for same in by_draw]
    rms = {name: np.array([one[name]["rms_m"] for one in outages]) for name in SOLUTIONS}
    largest = {name: np.array([one[name]["max_m"] for one in outages]) for name in SOLUTIONS}
    alone = np.minimum(*(rms[name] for name in GNSS_ALONE))
    return {
        "scenario": SCENARIO,
        "drives": len(seeds) * draws,
        "solutions": {
            name: {
                "text": text,
                "rms_m": float(np.sqrt(np.mean(rms[name] ** 2))),
                "max_m": float(largest[name].max()),
            }
            for name, text in SOLUTIONS.items()
        },
        "outages": outages,
        "calibrated_not_better": int(np.sum(rms["calibrated"] >= rms["uncalibrated"])),
        "calibrated_worse_beyond_chance": sum(_is_worse_beyond_chance(same) for same in by_draw),
        "calibrated_not_beating_gnss": int(np.sum(rms["calibrated"] >= alone)),
        "uncalibrated_not_beating_gnss": int(np.sum(rms["uncalibrated"] >= alone)),
    }


def _over_draws(same: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """One outage from its draws: the RMS over them, the greatest of their greatest."""
    out = dict(same[0])
    for name in SOLUTIONS:
        rms = np.array([one[name]["rms_m"] for one in same])
        out[name] = {
            "rms_m": float(np.sqrt(np.mean(rms**2))),
            "max_m": max(one[name]["max_m"] for one in same),
        }
    return out


def _is_worse_beyond_chance(same: Sequence[dict[str, Any]]) -> bool:
    """Whether the calibrated box has the greater error over the same routes and noises, by more than luck explains."""
    calibrated, as_soldered = ([one[name]["rms_m"] for one in same] for name in ("calibrated", "uncalibrated"))
    return len(same) > 1 and bool(ttest_rel(calibrated, as_soldered, alternative="greater").pvalue < CHANCE)


def _of_drive(drive: Drive, seed: int) -> list[dict[str, Any]]:
    truth = {} if drive.truth is None else drive.truth
    spans = outages_of(drive)
    by_solution: dict[str, list[dict[str, float]]] = {
        "gnss_held": [_gnss_alone(drive, outage, carried_on=False) for outage in spans],
        "gnss_carried_on": [_gnss_alone(drive, outage, carried_on=True) for outage in spans],
    }
    for name, calibration in (("uncalibrated", None), ("calibrated", Calibration(**truth["calibration"]))):
        fused = fuse(drive, fuse_config(vehicle_config(drive), calibration))
        by_solution[name] = [
            {"rms_m": one["rms_m"], "max_m": one["max_m"]} for one in figures(drive, fused, spans)["outages"]
        ]
    return [
        {"seed": seed, "start_s": span.start_s} | {name: by_solution[name][i] for name in SOLUTIONS}
        for i, span in enumerate(spans)
    ]


def _gnss_alone(drive: Drive, outage: Outage, *, carried_on: bool) -> dict[str, float]:
    """Error in the outage of the last fix before it, held or carried on by that fix's own velocity."""
    m, reference = drive.measurements, drive.reference
    if reference is None:
        raise ValueError("a simulated drive has a reference")
    row = int(np.searchsorted(drive.t_s(m.gnss_t_ns), outage.start_s)) - 1
    fix, fix_s = m.gnss[row], float(drive.t_s(m.gnss_t_ns)[row])
    t_s = drive.t_s(reference.t_ns)
    inside = (t_s >= outage.start_s) & (t_s < outage.end_s)
    origin = (float(fix[GNSS["lat_rad"]]), float(fix[GNSS["lon_rad"]]), 0.0)
    true = ned_offset_m(reference.lat_rad[inside], reference.lon_rad[inside], reference.alt_m[inside], origin)
    velocity = fix[[GNSS["vn_mps"], GNSS["ve_mps"]]] if carried_on else np.zeros(2)
    error: FloatArray = np.hypot(*((t_s[inside] - fix_s)[:, None] * velocity - true[:, :2]).T)
    return {"rms_m": float(np.sqrt(np.mean(error**2))), "max_m": float(error.max())}
