"""How far the filter drifts in a minute without GNSS, in simulated drives and by what may aid it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from core.measurements import GNSS, FloatArray
from core.navigation.track import Mode, Track
from core.simulation.scenarios import simulate
from service.recordings.drive_folder import Drive
from service.recordings.fusing import Outage, fuse, fuse_config, track_errors, vehicle_config
from service.recordings.simulated import drive_of

Tell = Callable[[float, float], None]
"""Told how many steps of how many are done."""

EXACT: Final = "exact_outages"
"""What the project's figures on outages are promised for."""
ON_THE_ROAD: Final = "outages"
"""The same routes with bumps, springs and vibration, by a sensor that drifts: what is left of it in a car."""
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


def measure(
    tell: Tell, scenario: str = EXACT, seeds: Sequence[int] = SEEDS, duration_s: float | None = None
) -> dict[str, Any]:
    """Over all outages the horizontal error 30 s and 60 s after the start, for each aiding that the drives allow."""
    found: dict[str, list[FloatArray]] = {}
    starts: list[dict[str, float]] = []
    for done, seed in enumerate(seeds):
        tell(done, len(seeds))
        drive = drive_of(simulate(scenario, seed, duration_s))
        outages = outages_of(drive)
        starts += [{"seed": seed, "start_s": outage.start_s} for outage in outages]
        for name, aiding in AIDINGS.items():
            if drive.measurements.speed_t_ns.size or not aiding.wheel:
                found.setdefault(name, []).append(_at_instants(drive, _fused(drive, aiding), outages))
    return {
        "scenario": scenario,
        "drives": len(seeds),
        "outages": starts,
        "aidings": {
            name: {"text": AIDINGS[name].text} | _figures(np.concatenate(parts)) for name, parts in found.items()
        },
    }


def outages_of(drive: Drive) -> list[Outage]:
    """The outages that a simulated drive has of itself."""
    truth = {} if drive.truth is None else drive.truth
    return [Outage(one["start_s"], one["duration_s"]) for one in truth["outages"]]


def _at_instants(drive: Drive, track: Track, outages: Sequence[Outage]) -> FloatArray:
    """Horizontal error and its stated sd at the last sample before each instant, (outages, instants, 2), m.

    Infinite where the filter had lost itself and had no position to tell.
    """
    ends_s = np.array([[outage.start_s + instant for instant in INSTANTS_S] for outage in outages])
    _, errors = track_errors(drive, track, ())
    if errors is None:
        return np.full((*ends_s.shape, 2), np.inf)
    at = np.searchsorted(errors.t_s, ends_s) - 1
    row = np.searchsorted(drive.t_s(track.t_ns), ends_s) - 1
    told = track.column("mode")[row] != Mode.ALIGNING
    sd_m = np.hypot(track.column("sd_n_m")[row], track.column("sd_e_m")[row])
    return np.stack([np.where(told, errors.horizontal_m[at], np.inf), np.where(told, sd_m, np.inf)], axis=-1)


def _figures(found: FloatArray) -> dict[str, Any]:
    """Figures of (outages, instants, 2) errors and sd, by instant; None where a figure is not finite."""
    return {
        f"at_{instant:.0f}_s": {
            "rms_m": _finite(np.sqrt(np.mean(errors_m**2))),
            "stated_rms_m": _finite(np.sqrt(np.mean(sd_m**2))),
            "median_m": _finite(np.median(errors_m)),
            "max_m": _finite(errors_m.max()),
            "errors_m": [_finite(v) for v in errors_m],
        }
        for instant, (errors_m, sd_m) in zip(INSTANTS_S, np.moveaxis(found, 0, -1), strict=True)
    }


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _fused(drive: Drive, aiding: Aiding) -> Track:
    config = fuse_config(vehicle_config(drive), non_holonomic=aiding.constraints, zero_velocity=aiding.constraints)
    return fuse(given(drive, aiding), config).track


def given(drive: Drive, aiding: Aiding) -> Drive:
    """The drive with only what the aiding may use."""
    m = drive.measurements
    if not aiding.wheel:
        m = replace(m, speed_t_ns=m.speed_t_ns[:0], speed_mps=m.speed_mps[:0])
    if not aiding.velocity:
        gnss = m.gnss.copy()
        gnss[:, [GNSS[name] for name in ("vn_mps", "ve_mps", "vd_mps", "speed_mps", "course_rad", "sd_v_mps")]] = np.nan
        m = replace(m, gnss=gnss)
    return replace(drive, measurements=m)
