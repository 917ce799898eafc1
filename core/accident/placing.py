"""Where an accident was: an impact, or what was taken for none, put onto the track."""

from __future__ import annotations

import math
from dataclasses import astuple, dataclass
from typing import Final

import numpy as np

from core.accident.events import Candidate, Impact
from core.earth import radii_m
from core.measurements import FloatArray
from core.navigation.alignment import next_second_ns
from core.navigation.track import TRACK, Mode, Track

RECENT_S: Final = 5.0
"""Track kept to place an impact that is decided after it began."""
CARRIED_ON_S: Final = 2.0
"""A row older than this is not carried on by its velocity: two missed fixes at 1 Hz."""
UNSEEN_MPS: Final = 15.0
"""What a vehicle may do unseen, for the spread of a place that is old: 54 km/h, a choice."""


@dataclass(frozen=True, slots=True)
class Place:
    """Where the vehicle was at a time, and how sure that is. Angles rad, spreads m; NaN where no fix had come yet."""

    lat_rad: float
    lon_rad: float
    alt_m: float
    sd_n_m: float
    sd_e_m: float
    cov_ne_m2: float
    heading_rad: float
    mode: Mode

    def as_array(self) -> FloatArray:
        """Its fields in their order, (8,)."""
        return np.array(astuple(self), dtype=np.float64)

    @classmethod
    def from_array(cls, values: FloatArray) -> Place:
        """What ``as_array`` gave."""
        lat_rad, lon_rad, alt_m, sd_n_m, sd_e_m, cov_ne_m2, heading_rad, mode = values.tolist()
        return cls(lat_rad, lon_rad, alt_m, sd_n_m, sd_e_m, cov_ne_m2, heading_rad, Mode(int(mode)))


@dataclass(frozen=True, slots=True)
class Accident:
    """An impact with its place at ``impact.t_ns``."""

    impact: Impact
    place: Place


@dataclass(frozen=True, slots=True)
class Suppressed:
    """What felt like an accident and was none, with its place at ``candidate.t_ns``."""

    candidate: Candidate
    place: Place


def newest(track: Track, span_s: float) -> Track:
    """The rows of the last ``span_s`` and the one before them, which holds until the first of these."""
    if not len(track.t_ns):
        return track
    first = int(np.searchsorted(track.t_ns, track.t_ns[-1] - int(span_s * 1e9), side="right")) - 1
    return Track(track.t_ns[max(first, 0) :], track.values[max(first, 0) :])


def told_until(track: Track, t_ns: int) -> Track:
    """The rows that were there when the sample at ``t_ns`` had been taken, however samples come in packets.

    While aligning, a row is told at the whole second after its fix.
    """
    told_ns = np.where(track.column("mode") == Mode.ALIGNING, next_second_ns(track.t_ns), track.t_ns)
    count = int(np.searchsorted(told_ns, t_ns, side="right"))
    return Track(track.t_ns[:count], track.values[:count])


def place_at(t_ns: int, track: Track) -> Place:
    """Where the vehicle was at a time: the row before it, carried on by its velocity.

    Where rows have ceased (the filter aligns anew), the last one stays the best that is known; what the vehicle may
    have gone since is added to its spread instead.
    """
    if not len(track.t_ns):
        nan = math.nan
        return Place(nan, nan, nan, nan, nan, nan, nan, Mode.ALIGNING)
    at = max(int(np.searchsorted(track.t_ns, t_ns, side="right")) - 1, 0)
    row = {name: float(track.values[at, index]) for name, index in TRACK.items()}
    since_s = (t_ns - int(track.t_ns[at])) * 1e-9
    north_mps, east_mps, down_mps = (
        row[name] if math.isfinite(row[name]) else 0.0 for name in ("vn_mps", "ve_mps", "vd_mps")
    )
    ahead_s = since_s if abs(since_s) <= CARRIED_ON_S else 0.0
    gone_m = 0.0 if ahead_s == since_s else since_s * max(math.hypot(north_mps, east_mps), UNSEEN_MPS)
    meridian, transverse = radii_m(row["lat_rad"])
    return Place(
        lat_rad=row["lat_rad"] + north_mps * ahead_s / meridian,
        lon_rad=row["lon_rad"] + east_mps * ahead_s / (transverse * math.cos(row["lat_rad"])),
        alt_m=row["alt_m"] - down_mps * ahead_s,
        sd_n_m=math.hypot(row["sd_n_m"], gone_m),
        sd_e_m=math.hypot(row["sd_e_m"], gone_m),
        cov_ne_m2=row["cov_ne_m2"],
        heading_rad=row["yaw_rad"],
        mode=Mode(int(row["mode"])),
    )
