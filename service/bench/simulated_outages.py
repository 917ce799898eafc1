"""How far the filter drifts in a minute without GNSS: simulated drives on a smooth road, by what may aid it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from core.measurements import GNSS, FloatArray
from core.navigation.track import Track
from core.simulation.scenarios import simulate
from service.recordings.drive_folder import Drive
from service.recordings.fusing import Outage, fuse, fuse_config, track_errors, vehicle_config
from service.recordings.simulated import drive_of

Tell = Callable[[float, float], None]
"""Told how many steps of how many are done."""

SCENARIO: Final = "exact_outages"
SEEDS: Final = tuple(range(1, 17))
"""With three outages of 60 s a drive: 48."""
INSTANTS_S: Final = (30.0, 60.0)
"""Since the outage's start, s: where errors are compared."""


@dataclass(frozen=True, slots=True)
class Aiding:
    """What the filter is given of a drive, and which constraints it may use."""

    text: str
    velocity: bool = True
    constraints: bool = True
    wheel: bool = False


AIDINGS: Final = {
    "constrained": Aiding("GNSS position and velocity, non-holonomic and zero-velocity updates"),
    "velocity": Aiding("GNSS position and velocity, no constraint", constraints=False),
    "position_only": Aiding("GNSS position, no constraint", velocity=False, constraints=False),
    "wheel": Aiding("as constrained, and a wheel speed of unknown scale, some 0.5 % off", wheel=True),
}


def measure(tell: Tell, seeds: Sequence[int] = SEEDS, duration_s: float | None = None) -> dict[str, Any]:
    """RMS over all outages of the horizontal error 30 s and 60 s after the start, for each aiding."""
    errors: dict[str, list[FloatArray]] = {name: [] for name in AIDINGS}
    starts: list[dict[str, float]] = []
    for done, seed in enumerate(seeds):
        tell(done, len(seeds))
        drive = drive_of(simulate(SCENARIO, seed, duration_s))
        outages = outages_of(drive)
        starts += [{"seed": seed, "start_s": outage.start_s} for outage in outages]
        for name, aiding in AIDINGS.items():
            errors[name].append(at_instants(drive, _fused(drive, aiding), outages, INSTANTS_S))
    aidings = {}
    for name, aiding in AIDINGS.items():
        found = np.concatenate(errors[name])
        aidings[name] = {"text": aiding.text} | spread(found)
    return {"scenario": SCENARIO, "drives": len(seeds), "outages": starts, "aidings": aidings}


def outages_of(drive: Drive) -> list[Outage]:
    """The outages that a simulated drive has of itself."""
    truth = {} if drive.truth is None else drive.truth
    return [Outage(one["start_s"], one["duration_s"]) for one in truth["outages"]]


def at_instants(drive: Drive, track: Track, outages: Sequence[Outage], instants_s: Sequence[float]) -> FloatArray:
    """Horizontal error at the last sample before each instant after each outage's start, (outages, instants), m."""
    _, errors = track_errors(drive, track, ())
    if errors is None:
        return np.full((len(outages), len(instants_s)), np.nan)
    ends_s = np.array([[outage.start_s + instant for instant in instants_s] for outage in outages])
    rows = np.searchsorted(errors.t_s, ends_s) - 1
    return np.asarray(errors.horizontal_m[rows])


def spread(errors_m: FloatArray) -> dict[str, Any]:
    """Figures of (outages, instants) errors by instant."""
    return {
        f"at_{instant:.0f}_s": {
            "rms_m": float(np.sqrt(np.mean(errors_m[:, i] ** 2))),
            "median_m": float(np.median(errors_m[:, i])),
            "max_m": float(errors_m[:, i].max()),
            "errors_m": [float(v) for v in errors_m[:, i]],
        }
        for i, instant in enumerate(INSTANTS_S)
    }


def _fused(drive: Drive, aiding: Aiding) -> Track:
    config = fuse_config(vehicle_config(drive), non_holonomic=aiding.constraints, zero_velocity=aiding.constraints)
    return fuse(_given(drive, aiding), config).track


def _given(drive: Drive, aiding: Aiding) -> Drive:
    """The drive with only what the aiding may use."""
    m = drive.measurements
    if not aiding.wheel:
        m = replace(m, speed_t_ns=m.speed_t_ns[:0], speed_mps=m.speed_mps[:0])
    if not aiding.velocity:
        gnss = m.gnss.copy()
        gnss[:, [GNSS[name] for name in ("vn_mps", "ve_mps", "vd_mps", "speed_mps", "course_rad", "sd_v_mps")]] = np.nan
        m = replace(m, gnss=gnss)
    return replace(drive, measurements=m)
