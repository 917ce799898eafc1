"""The whole session on simulated drives: seed 1's hours with 21 accidents, and how far filter and model agree."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np

from core.accident.placing import Accident
from core.earth import ned_offset_m
from core.measurements import FloatArray
from core.navigation.track import Mode
from core.simulation.box_model import Box, estimated_down, estimated_speed
from core.simulation.collisions import Truth
from core.simulation.disturbances import NonAccident
from core.simulation.scenarios import simulate
from core.simulation.trajectory import matrices_b_from_n
from service.bench.accident_scoring import (
    DETECTORS,
    accident_figures,
    accident_record,
    quiet_figures,
    quiet_record,
    reliability,
    stories,
)
from service.bench.simulated_outages import Tell
from service.recordings.drive_folder import Drive
from service.recordings.fusing import Fused, fuse, fuse_config, vehicle_config
from service.recordings.simulated import drive_of

SEEDS: Final = (1, 2, 3)
"""Of seed 1's drive: three times 3.5 h."""
ERROR_SEEDS: Final = (1, 2, 3)


def seed1(tell: Tell, seeds: Sequence[int] = SEEDS, duration_s: float | None = None) -> dict[str, Any]:
    """Seed 1's scenario through the whole session, by drive and over all; places against the truth."""
    found: dict[str, list[dict[str, Any]]] = {name: [] for name in DETECTORS}
    steps = len(seeds) * (1 + len(DETECTORS))
    for at, seed in enumerate(seeds):
        tell(at * (1 + len(DETECTORS)), steps)
        drive = drive_of(simulate("seed1", seed, duration_s))
        for k, name in enumerate(DETECTORS):
            tell(at * (1 + len(DETECTORS)) + 1 + k, steps)
            found[name].append({"seed": seed} | _judged(drive, name))
    return {name: {"drives": drives} | _over_all(drives) for name, drives in found.items()}


def _over_all(drives: Sequence[dict[str, Any]]) -> dict[str, Any]:
    accidents = [one for drive in drives for one in drive.pop("records")]
    silent = [one for drive in drives for one in drive.pop("quiet_records")]
    errors = {
        key: [one["place_error_m"] for one in accidents if one["found"] and one["in_outage"] is inside]
        for key, inside in (("open", False), ("outage", True))
    }
    return accident_figures(accidents) | {
        "km": sum(drive["km"] for drive in drives),
        "missed": sum(not one["found"] for one in accidents),
        "false_alarms": sum(drive["false_alarms"] for drive in drives),
        "withdrawn": sum(drive["withdrawn"] for drive in drives),
        "place_error_m": {
            key: {"count": len(values), "median": _median(values), "max": max(values, default=None)}
            for key, values in errors.items()
        },
        "quiet": quiet_figures(silent),
        "reliability": reliability([*accidents, *silent]),
    }


def _judged(drive: Drive, detector: str) -> dict[str, Any]:
    """What a session with this detector tells of a drive with truth."""
    config = replace(fuse_config(vehicle_config(drive), every_s=0.1), detector=detector)  # type: ignore[arg-type]
    fused = fuse(drive, config)
    told, candidates = stories([*(one.impact for one in fused.accidents), *suppressed(fused)])
    truth = drive.truth or {}
    records: list[dict[str, Any]] = []
    mine: set[int] = set()
    for one in truth["accidents"]:
        t_ns = drive.start_t_ns + round(one["t_s"] * 1e9)
        near = [story for story in told if abs(story.first.t_ns - t_ns) < 3_000_000_000]
        nearby = [candidate for candidate in candidates if abs(candidate.t_ns - t_ns) < 3_000_000_000]
        mine.update(story.first.t_ns for story in near)
        record = accident_record(_truth_of(one), t_ns, one["clipped"], near, nearby)
        placed = [accident for accident in fused.accidents if any(s.last is accident.impact for s in near)]
        record |= {"in_outage": one["in_outage"], "t_s": one["t_s"], "place_error_m": None}
        if placed:
            record["place_error_m"] = _place_error_m(placed[0], one)
        records.append(record)
    quiet = []
    for one in truth["non_accidents"]:
        begin = drive.start_t_ns + round(one["t_s"] * 1e9)
        end = begin + round(one["duration_s"] * 1e9)
        others = [story for story in told if story.first.t_ns not in mine]
        quiet.append(quiet_record(NonAccident(one["kind"]), begin, end, others, candidates))
    wrong = [story for story in told if story.first.t_ns not in mine]
    return {
        "km": _distance_km(drive),
        "accidents": len(records),
        "found": sum(one["found"] for one in records),
        "false_alarms": sum(story.stands for story in wrong),
        "withdrawn": sum(not story.stands for story in told),
        "false_at_s": [round(1e-9 * (story.first.t_ns - drive.start_t_ns), 2) for story in wrong if story.stands],
        "missed_at_s": [one["t_s"] for one in records if not one["found"]],
        "records": records,
        "quiet_records": quiet,
    }


def _distance_km(drive: Drive) -> float:
    assert drive.reference is not None
    v_n, t_ns = drive.reference.v_n_mps, drive.reference.t_ns
    return float(np.sum(np.hypot(v_n[1:, 0], v_n[1:, 1]) * np.diff(t_ns))) * 1e-12


def suppressed(fused: Fused) -> list[Any]:
    """The candidates that the session judged to be no accident."""
    return [one.candidate for one in getattr(fused, "suppressed", ())]


def _truth_of(one: dict[str, Any]) -> Truth:
    """An accident of a drive's truth in the corpus' form."""
    impact = {name: one[name] for name in ("t_s", "delta_v_mps", "pdof_deg", "duration_s", "peak_mps2")}
    return Truth(
        name=one["severity"],
        kind="collision",
        t_s=one["t_s"],
        delta_v_mps=one["delta_v_mps"],
        pdof_deg=one["pdof_deg"],
        duration_s=one["duration_s"],
        speed_mps=one["speed_before_mps"],
        peak_mps2=one["peak_mps2"],
        impacts=(impact,),
        ignition=True,
        roll_deg=0.0,
    )


def _place_error_m(accident: Accident, one: dict[str, Any]) -> float:
    origin = (math.radians(one["lat_deg"]), math.radians(one["lon_deg"]), 0.0)
    place = accident.place
    offset = ned_offset_m(np.array([place.lat_rad]), np.array([place.lon_rad]), np.zeros(1), origin)[0]
    return float(math.hypot(offset[0], offset[1]))


def errors(tell: Tell, seeds: Sequence[int] = ERROR_SEEDS) -> dict[str, Any]:
    """The filter's errors of attitude and speed on whole drives, beside those that the fast drives are made with.

    Tilt: RMS of an axis of the vertical, and its correlation time (to 1/e); the same of the speed.
    """
    rows: dict[str, list[tuple[FloatArray, FloatArray]]] = {"filter": [], "model": []}
    for done, seed in enumerate(seeds):
        tell(done, len(seeds))
        simulated = simulate("city", seed, 600.0, 100.0)
        drive = drive_of(simulated)
        track = fuse(drive, fuse_config(vehicle_config(drive))).track
        truth = simulated.trajectory
        used = (track.column("mode") != Mode.ALIGNING) & np.isfinite(track.column("roll_rad"))
        first = int(np.argmax(used)) + 3000  # half a minute after it began
        t_ns = track.t_ns[first:]
        at = np.clip(np.searchsorted(drive.measurements.imu_t_ns, t_ns), 0, truth.t_s.size - 1)
        down = matrices_b_from_n(truth.rpy_rad[at])[:, :, 2]
        rpy = np.column_stack([track.column(name)[first:] for name in ("roll_rad", "pitch_rad", "yaw_rad")])
        speed = np.hypot(track.column("vn_mps")[first:], track.column("ve_mps")[first:])
        rows["filter"].append((matrices_b_from_n(rpy)[:, :, 2] - down, speed - truth.speed_mps[at]))
        rng, box = np.random.default_rng([seed, 5]), Box()
        modelled = estimated_down(down, truth.omega_b[at], box, rng) - down
        v_n = np.column_stack([truth.speed_mps[at], np.zeros(at.size)])
        model_speed = estimated_speed(v_n, np.zeros((at.size, 3)), np.zeros(at.size), box, rng)
        rows["model"].append((modelled, model_speed - truth.speed_mps[at]))
    return {
        name: {
            "tilt_rms_deg": math.degrees(math.sqrt(np.mean([np.mean(tilt[:, :2] ** 2) for tilt, _ in parts]))),
            "tilt_p99_deg": math.degrees(
                float(np.percentile(np.abs(np.concatenate([tilt[:, :2] for tilt, _ in parts])), 99.0))
            ),
            "tilt_s": float(np.median([_correlation_s(tilt[:, axis]) for tilt, _ in parts for axis in (0, 1)])),
            "speed_rms_mps": math.sqrt(np.mean([np.mean(speed**2) for _, speed in parts])),
            "speed_s": float(np.median([_correlation_s(speed) for _, speed in parts])),
        }
        for name, parts in rows.items()
    }


def _correlation_s(error: FloatArray, rate_hz: float = 100.0) -> float:
    """Lag at which the autocorrelation has fallen to 1/e, s."""
    thin = (error - error.mean())[::10]
    spectrum = np.abs(np.fft.rfft(thin, 2 * thin.size)) ** 2
    correlation = np.fft.irfft(spectrum)[: thin.size]
    below = np.flatnonzero(correlation < correlation[0] / math.e)
    return float(below[0] * 10.0 / rate_hz) if below.size else math.inf


def _median(values: Sequence[float]) -> float | None:
    return float(np.median(values)) if values else None
