"""A drive folder through a session, with withheld fixes, and its figures against reference and fixes."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from core.accident.events import NoAccident, Status
from core.accident.placing import Accident, Suppressed
from core.driving.manoeuvres import Episode, explained
from core.earth import ned_offset_m
from core.measurements import GNSS, FloatArray, Measurements, TimeArray
from core.navigation.filter import FilterConfig
from core.navigation.recorder import Recorder
from core.navigation.records import AidRecords
from core.navigation.smoother import causal, smoothed
from core.navigation.solution import Solution
from core.navigation.track import Mode, Track
from core.rotation import wrap_angle_rad
from core.session import MountingEstimate, Session, SessionConfig
from schemas.calibration import Calibration
from schemas.vehicles import SensorNoise, VehicleConfig
from service.engine.sessions import box_calibration, session_config, warm_up
from service.errors import UsageError
from service.recordings.drive_folder import Drive
from service.storage.calibrations import EVER_NS, GivenCalibration

CHUNK_S: Final = 10.0
"""Samples handed to the session at a time: only progress depends on it, no bit of the result does."""


@dataclass(frozen=True, slots=True)
class Outage:
    """A span of the drive in which fixes are withheld; seconds of the drive's own time."""

    start_s: float
    duration_s: float

    @property
    def end_s(self) -> float:
        """Where it ends."""
        return self.start_s + self.duration_s

    @classmethod
    def parse(cls, text: str) -> Outage:
        """Read ``START:DURATION`` in seconds; raises UsageError."""
        try:
            start, duration = (float(part) for part in text.split(":"))
        except ValueError:
            raise UsageError(f"outage '{text}': expected START:DURATION in seconds, such as 200:60") from None
        if not (math.isfinite(start) and math.isfinite(duration) and duration > 0):
            raise UsageError(f"outage '{text}': expected a finite start and a duration above 0, such as 200:60")
        return cls(start, duration)


@dataclass(frozen=True, slots=True, eq=False)
class Fused:
    """What a session made of a drive: track at the samples' rate, accidents, counts, the mounting, and the time.

    ``accidents`` are those that were not retracted, as they were told last; ``told`` is each as often as it was told.
    ``solution`` and ``records`` where they were asked for.
    """

    track: Track
    accidents: tuple[Accident, ...]
    counts: dict[str, int]
    epochs: int
    fusion_s: float
    mounting: MountingEstimate
    solution: Solution | None = None
    records: AidRecords | None = None
    suppressed: tuple[Suppressed, ...] = ()
    episodes: tuple[Episode, ...] = ()
    told: tuple[Accident, ...] = ()


def vehicle_config(drive: Drive, noise: SensorNoise | None = None) -> VehicleConfig:
    """The settings of a vehicle whose box is as the drive says; ``noise`` goes before the drive's own."""
    return VehicleConfig(
        mounting_rpy_deg=drive.imu.mounting_rpy_deg,
        imu_lever_arm_m=drive.imu.lever_arm_m,
        gnss_lever_arm_m=drive.gnss.lever_arm_m,
        gnss_time_offset_s=drive.gnss.time_offset_s,
        accel_full_scale_mps2=drive.imu.accel_full_scale_mps2,
        noise=drive.imu.noise if noise is None else noise,
    )


def fuse_config(
    config: VehicleConfig,
    calibration: Calibration | None = None,
    *,
    every_s: float = 0.0,
    non_holonomic: bool = True,
    zero_velocity: bool = True,
) -> SessionConfig:
    """A session's settings with rows every ``every_s`` (0: every sample) and constraints switched.

    No trip comes after a recording's, so what is followed is not folded back in its midst.
    """
    base = session_config(config)
    if calibration is not None:
        box = box_calibration(GivenCalibration(1, EVER_NS, 0, calibration))
        base = replace(base, accelerometer=box.accelerometer, gyroscope=box.gyroscope, magnetometer=box.magnetometer)
    filter_config: FilterConfig = replace(
        base.filter,
        tuning=replace(base.filter.tuning, output_interval_s=every_s),
        non_holonomic=non_holonomic,
        zero_velocity=zero_velocity,
    )
    return replace(base, filter=filter_config, fold_back=False)


def fuse(
    drive: Drive,
    config: SessionConfig,
    outages: Sequence[Outage] = (),
    progress: Callable[[float], None] = lambda share: None,
    *,
    keep: bool = False,
    smooth: bool = False,
) -> Fused:
    """Fold a drive, without the fixes inside ``outages``, through a session.

    ``keep`` brings the solution's covariance and the records of the aids; ``smooth`` does as well, and lets the whole
    drive enter each row.
    """
    warm_up()
    m = withhold(drive, outages)
    session = Session(config)
    recorder = Recorder() if keep or smooth else None
    session.filter.recorder = recorder
    tracks: list[Track] = []
    told: list[Accident] = []
    suppressed: list[Suppressed] = []
    episodes: list[Episode] = []
    counts: dict[str, int] = {}
    spent_s = 0.0
    for share, part in _chunks(m):
        begin = time.perf_counter()
        outputs = session.step(part)
        spent_s += time.perf_counter() - begin
        tracks.append(outputs.track)
        told += outputs.accidents
        suppressed += outputs.suppressed
        episodes += outputs.episodes
        for name, count in outputs.counts.items():
            counts[name] = counts.get(name, 0) + count
        progress(share)
    track = Track(np.concatenate([t.t_ns for t in tracks]), np.concatenate([t.values for t in tracks]))
    solution = records = None
    if recorder is not None:
        lever_b_m = np.array(config.filter.imu_lever_b_m)
        solution = smoothed(recorder, lever_b_m) if smooth else causal(recorder, lever_b_m)
        records = recorder.aid_records()
        if smooth:
            track = solution.track
    last = {one.impact.t_ns: one for one in told}
    standing = tuple(one for one in last.values() if one.impact.status is not Status.RETRACTED)
    potholes = [one.candidate.t_ns for one in suppressed if one.candidate.reason is NoAccident.POTHOLE]
    return Fused(
        track,
        standing,
        counts,
        len(m.imu_t_ns),
        spent_s,
        session.mounting,
        solution=solution,
        records=records,
        suppressed=tuple(suppressed),
        episodes=tuple(explained(episodes, [one.impact.t_ns for one in standing], potholes)),
        told=tuple(told),
    )


def withhold(drive: Drive, outages: Sequence[Outage]) -> Measurements:
    """The drive's measurements without the fixes inside the outages."""
    m = drive.measurements
    kept = ~_inside(_seconds(m.gnss_t_ns, drive), outages)
    return replace(m, gnss_t_ns=m.gnss_t_ns[kept], gnss=m.gnss[kept])


def figures(drive: Drive, fused: Fused, outages: Sequence[Outage]) -> dict[str, Any]:
    """Figures as ``telefuse fuse --json`` prints them (INTERFACES, section 8)."""
    m, track = drive.measurements, fused.track
    placed = np.isfinite(track.column("lat_rad"))
    navigating = track.column("mode") != Mode.ALIGNING
    result: dict[str, Any] = {
        "epochs": fused.epochs,
        "duration_s": float(m.imu_t_ns[-1] - m.imu_t_ns[0]) * 1e-9,
        "ns_per_epoch": 1e9 * fused.fusion_s / max(fused.epochs, 1),
        "aligned_after_s": None if not navigating.any() else float(track.t_ns[navigating][0] - m.imu_t_ns[0]) * 1e-9,
        "rows": int(placed.sum()),
        "smoothed": fused.solution is not None and fused.solution.smoothed,
        "aids": _by_aid(fused.counts),
        "mounting": {
            "given": fused.mounting.given,
            "found": fused.mounting.found,
            "rpy_deg": [math.degrees(angle) for angle in fused.mounting.rpy_rad],
            "sd_deg": [math.degrees(angle) for angle in fused.mounting.sd_rad],
        },
    }
    against, errors = track_errors(drive, track, outages)
    result["against"] = against
    if errors is None:
        missing = dict.fromkeys(_COMPARED)
        return result | missing | {"outages": [_not_compared(outage, against) for outage in outages]}
    result["position_rms_m"] = _rms(errors.horizontal_m) if against == "reference" else None
    result["gnss_rms_m"] = _rms(errors.horizontal_m) if against == "gnss" else None
    result["yaw_rms_deg"] = (
        None if errors.yaw_rad is None else math.degrees(_rms(errors.yaw_rad[np.isfinite(errors.yaw_rad)]))
    )
    result["offset_ned_m"] = None if errors.offset_n_m is None else [float(v) for v in errors.offset_n_m]
    result["position_rms_offset_removed_m"] = None if errors.freed_m is None else _rms(errors.freed_m)
    parts, all_errors = [], []
    for outage in outages:
        inside = (errors.t_s >= outage.start_s) & (errors.t_s < outage.end_s)
        if not inside.any():
            parts.append(_not_compared(outage, against))
            continue
        h = errors.horizontal_m[inside] if errors.freed_m is None else errors.freed_m[inside]
        all_errors.append(h)
        parts.append(
            {
                "start_s": outage.start_s,
                "duration_s": outage.duration_s,
                "against": against,
                "rms_m": _rms(h),
                "end_m": float(h[-1]),
                "max_m": float(h.max()),
                "distance_m": _distance_m(errors, inside),
            }
        )
    result["outages"] = parts
    joined = np.concatenate(all_errors) if all_errors else None
    result["outage_rms_m"] = None if joined is None else _rms(joined)
    result["outage_max_m"] = None if joined is None else float(joined.max())
    return result


_COMPARED: Final = (
    "position_rms_m",
    "gnss_rms_m",
    "yaw_rms_deg",
    "offset_ned_m",
    "position_rms_offset_removed_m",
    "outage_rms_m",
    "outage_max_m",
)
"""Figures that need something to compare the track with."""


def _not_compared(outage: Outage, against: str | None) -> dict[str, Any]:
    return {"start_s": outage.start_s, "duration_s": outage.duration_s, "against": against} | dict.fromkeys(
        ("rms_m", "end_m", "max_m", "distance_m")
    )


@dataclass(frozen=True, slots=True, eq=False)
class TrackErrors:
    """Track against truth at instants ``t_ns``: error, its horizontal length, the same freed of a constant offset."""

    t_ns: TimeArray
    t_s: FloatArray
    ned_m: FloatArray
    horizontal_m: FloatArray
    freed_m: FloatArray | None
    offset_n_m: FloatArray | None
    yaw_rad: FloatArray | None
    lat_rad: FloatArray
    lon_rad: FloatArray


def track_errors(drive: Drive, track: Track, outages: Sequence[Outage]) -> tuple[str | None, TrackErrors | None]:
    """Errors while navigating, against the reference where there is one, else the fixes (the withheld ones among them).

    A reference that sits elsewhere on the vehicle differs by a constant; the median outside the outages is
    reported as that offset (north, east, down), and outages are judged without it.
    """
    used = np.isfinite(track.column("lat_rad")) & (track.column("mode") != Mode.ALIGNING)
    track = Track(track.t_ns[used], track.values[used])
    if len(track.t_ns) < 2:
        return None, None
    first, last = int(track.t_ns[0]), int(track.t_ns[-1])
    m, reference = drive.measurements, drive.reference
    if reference is not None:
        within = (reference.t_ns >= first) & (reference.t_ns <= last)
        t_ns = reference.t_ns[within]
        lat, lon, alt = (a[within] for a in (reference.lat_rad, reference.lon_rad, reference.alt_m))
        yaw = reference.rpy_rad[within, 2]
    else:
        within = (m.gnss_t_ns >= first) & (m.gnss_t_ns <= last) & np.isfinite(m.gnss[:, GNSS["lat_rad"]])
        t_ns = m.gnss_t_ns[within]
        lat, lon, alt = (m.gnss[within, GNSS[name]] for name in ("lat_rad", "lon_rad", "alt_m"))
        yaw = None
    if not within.any():
        return None, None
    at = {name: _at(t_ns, track, name) for name in ("lat_rad", "lon_rad", "alt_m")}
    origin = (float(lat[0]), float(lon[0]), 0.0)
    alt = np.where(np.isfinite(alt), alt, at["alt_m"])
    error_n = ned_offset_m(at["lat_rad"], at["lon_rad"], at["alt_m"], origin) - ned_offset_m(lat, lon, alt, origin)
    t_s = _seconds(t_ns, drive)
    offset = freed = None
    if reference is not None:
        outside = ~_inside(t_s, outages)
        offset = np.median(error_n[outside if outside.any() else slice(None)], axis=0)
        freed = np.hypot(*(error_n - offset)[:, :2].T)
    yaw_error = None
    if yaw is not None and np.isfinite(yaw).any():
        fused_yaw = np.interp(t_ns, track.t_ns, np.unwrap(track.column("yaw_rad")))
        yaw_error = np.asarray(wrap_angle_rad(fused_yaw - yaw))
    name = "gnss" if reference is None else "reference"
    horizontal = np.hypot(error_n[:, 0], error_n[:, 1])
    return name, TrackErrors(t_ns, t_s, error_n, horizontal, freed, offset, yaw_error, lat, lon)


def _at(t_ns: TimeArray, track: Track, name: str) -> FloatArray:
    """A column of the track at other instants, linear between rows."""
    base = int(track.t_ns[0])
    return np.asarray(np.interp((t_ns - base).astype(float), (track.t_ns - base).astype(float), track.column(name)))


def _chunks(m: Measurements) -> list[tuple[float, Measurements]]:
    """The measurements cut at fixed times, each with the share of the drive that ends with it."""
    first, last = int(m.imu_t_ns[0]), int(m.imu_t_ns[-1])
    edges = np.arange(first, last + 1, int(CHUNK_S * 1e9), dtype=np.int64)
    bounds = [np.iinfo(np.int64).min, *[int(e) for e in edges[1:]], np.iinfo(np.int64).max]
    parts = []
    for low, high in pairwise(bounds):
        parts.append((min(1.0, (high - first) / max(last - first, 1)), m.between(low, high)))
    return parts


def _by_aid(counts: dict[str, int]) -> dict[str, dict[str, int]]:
    aids: dict[str, dict[str, int]] = {}
    for name, count in sorted(counts.items()):
        aid, outcome = name.split(".")
        aids.setdefault(aid, {})[outcome] = count
    return aids


def _inside(t_s: FloatArray, outages: Sequence[Outage]) -> npt.NDArray[np.bool_]:
    inside = np.zeros(len(t_s), np.bool_)
    for outage in outages:
        inside |= (t_s >= outage.start_s) & (t_s < outage.end_s)
    return inside


def _seconds(t_ns: TimeArray, drive: Drive) -> FloatArray:
    return np.asarray((t_ns - drive.start_t_ns) * 1e-9)


def _distance_m(errors: TrackErrors, inside: npt.NDArray[np.bool_]) -> float:
    lat, lon = errors.lat_rad[inside], errors.lon_rad[inside]
    place = ned_offset_m(lat, lon, np.zeros(len(lat)), (float(lat[0]), float(lon[0]), 0.0))
    return float(np.hypot(*np.diff(place[:, :2], axis=0).T).sum())


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
