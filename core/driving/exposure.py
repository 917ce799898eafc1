"""Exposure: how far and how long a vehicle drove, by local hour, light, weekday, month, road class, district, cell.

Whole millimetres and milliseconds, so that trips add up to the same in any order and of any parts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from core.errors import InvalidInputError
from core.measurements import FloatArray, TimeArray
from core.sun import CIVIL_DUSK_RAD, SUNSET_RAD, solar_elevation_rad
from core.tunables import Tunables, tunable

UNKNOWN: Final = ""
"""Label of what is not known: a road off the map, a place in no district."""


class Facet(StrEnum):
    """By what exposure is told."""

    HOUR = "hour"
    LIGHT = "light"
    WEEKDAY = "weekday"
    MONTH = "month"
    ROAD_CLASS = "road_class"
    DISTRICT = "district"
    CELL = "cell"


class Light(StrEnum):
    """By the sun's elevation: above the horizon, down to 6 degrees below, or less."""

    DAY = "day"
    TWILIGHT = "twilight"
    NIGHT = "night"


WEEKDAYS: Final = ("monday", "tuesday", "wednesday", "thursday", "friday", "saturday", "sunday")


class Driven(NamedTuple):
    """Distance and time of moving."""

    distance_mm: int = 0
    time_ms: int = 0

    @property
    def distance_m(self) -> float:
        """Distance, m."""
        return self.distance_mm * 1e-3

    @property
    def time_s(self) -> float:
        """Time, s."""
        return self.time_ms * 1e-3

    def plus(self, other: Driven) -> Driven:
        """Both together."""
        return Driven(self.distance_mm + other.distance_mm, self.time_ms + other.time_ms)


NOTHING: Final = Driven()


@dataclass(frozen=True, slots=True)
class ExposureTuning(Tunables):
    """Which rows count."""

    moving_mps: float = tunable(
        1.0, unit="m/s", low=0.0, high=10.0, source="as a trip's moving_mps; standing is no exposure"
    )
    gap_s: float = tunable(
        2.0, unit="s", low=0.1, high=60.0, source="choice: a row stands for no longer; rows come every 0.1 to 1 s"
    )


@dataclass(frozen=True, slots=True)
class Exposure:
    """What was driven in all and by label of each facet; each facet adds up to ``total``."""

    total: Driven = NOTHING
    by: Mapping[Facet, Mapping[str, Driven]] = field(default_factory=dict)

    def __add__(self, other: Exposure) -> Exposure:
        by: dict[Facet, dict[str, Driven]] = {facet: dict(labels) for facet, labels in self.by.items()}
        for facet, labels in other.by.items():
            mine = by.setdefault(facet, {})
            for label, driven in labels.items():
                mine[label] = mine.get(label, NOTHING).plus(driven)
        return Exposure(self.total.plus(other.total), by)

    def share(self, facet: Facet, *labels: str) -> float:
        """Share of the distance under these labels of a facet; 0 where nothing was driven."""
        if not self.total.distance_mm:
            return 0.0
        known = self.by.get(facet, {})
        return sum(known.get(label, NOTHING).distance_mm for label in labels) / self.total.distance_mm


def exposure(
    t_ns: TimeArray,
    lat_rad: FloatArray,
    lon_rad: FloatArray,
    speed_mps: FloatArray,
    utc_offset_s: npt.NDArray[np.int64],
    labels: Mapping[Facet, Sequence[str]] | None = None,
    tuning: ExposureTuning | None = None,
) -> Exposure:
    """Exposure of a drive's rows (n,), in time order, each of which stands for the time until the next.

    Parameters
    ----------
    speed_mps, lat_rad, lon_rad : NaN where unknown: such rows count for nothing
    utc_offset_s : local time less UTC
    labels : of each row: road class, district, cell; what is missing is not told, ``UNKNOWN`` is told as such

    Raises
    ------
    InvalidInputError
        If lengths differ, times do not increase, or labels are given for what follows from time and place.
    """
    tuning = tuning or ExposureTuning()
    given = dict(labels or {})
    columns = {"latitudes": lat_rad, "longitudes": lon_rad, "speeds": speed_mps, "UTC offsets": utc_offset_s}
    for name, column in columns.items():
        if len(column) != t_ns.size:
            raise InvalidInputError(f"{t_ns.size} times and {len(column)} {name}; expected as many of each")
    for facet, told in given.items():
        if facet not in (Facet.ROAD_CLASS, Facet.DISTRICT, Facet.CELL):
            raise InvalidInputError(f"labels for '{facet}' are given; expected road_class, district or cell alone")
        if len(told) != t_ns.size:
            raise InvalidInputError(f"{t_ns.size} times and {len(told)} labels of '{facet}'; expected as many of each")
    if t_ns.size and not (np.diff(t_ns) > 0).all():
        raise InvalidInputError("times do not increase; expected rows in the order of time, each once")
    until_next_ns = np.append(np.diff(t_ns), 0)
    counts = (
        np.isfinite(lat_rad + lon_rad + speed_mps)
        & (speed_mps >= tuning.moving_mps)
        & (until_next_ns <= round(1e9 * tuning.gap_s))
    )
    rows = np.flatnonzero(counts)
    at_ns = t_ns[rows]
    # Ends are rounded, not lengths, so that parts make up the whole.
    time_ms = (at_ns + until_next_ns[rows]) // 1_000_000 - at_ns // 1_000_000
    distance_mm = np.rint(speed_mps[rows] * until_next_ns[rows] * 1e-6).astype(np.int64)
    local = (at_ns + utc_offset_s[rows] * 1_000_000_000).astype("datetime64[ns]")
    days = local.astype("datetime64[D]")
    light = [
        Light.DAY if sun >= SUNSET_RAD else Light.TWILIGHT if sun >= CIVIL_DUSK_RAD else Light.NIGHT
        for sun in solar_elevation_rad(at_ns, lat_rad[rows], lon_rad[rows]).tolist()
    ]
    hours = (local - days) // np.timedelta64(1, "h")
    told_by: dict[Facet, Sequence[str]] = {
        Facet.HOUR: [f"{hour:02d}" for hour in hours.astype(np.int64).tolist()],
        Facet.LIGHT: light,
        # 1970-01-01 was a Thursday.
        Facet.WEEKDAY: [WEEKDAYS[(day + 3) % 7] for day in days.astype(np.int64).tolist()],
        Facet.MONTH: [f"{month % 12 + 1:02d}" for month in local.astype("datetime64[M]").astype(np.int64).tolist()],
    }
    told_by |= {facet: [told[row] for row in rows.tolist()] for facet, told in given.items()}
    return Exposure(
        Driven(int(distance_mm.sum()), int(time_ms.sum())),
        {facet: _summed(told, distance_mm, time_ms) for facet, told in told_by.items()},
    )


def _summed(
    told: Sequence[str], distance_mm: npt.NDArray[np.int64], time_ms: npt.NDArray[np.int64]
) -> dict[str, Driven]:
    found: dict[str, list[int]] = {}
    for label, mm, ms in zip(told, distance_mm.tolist(), time_ms.tolist(), strict=True):
        driven = found.setdefault(label, [0, 0])
        driven[0] += mm
        driven[1] += ms
    return {label: Driven(*driven) for label, driven in sorted(found.items())}
