"""The environment of each instant: local time, daylight, and the road and district around the vehicle."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from core.measurements import FloatArray, TimeArray
from core.risk.lookup import LIGHTS, WEEKDAYS, Values
from core.sun import solar_elevation_rad

_HOUR_NS: Final = 3_600_000_000_000
_DAYS_TO_MONDAY: Final = 3
"""1970-01-01 was a Thursday."""
CIVIL_TWILIGHT_RAD: Final = math.radians(-6.0)

Words = npt.NDArray[np.str_]


@dataclass(frozen=True, slots=True, eq=False)
class Road:
    """The road under a vehicle at n instants; NaN and "" where it is not known.

    Parameters
    ----------
    limit_kmh : (n,) legal limit; infinite where the law knows none
    kind, surroundings, district : (n,) words: OpenStreetMap's class, urban or rural, name of the district
    position_sd_m : (n,) horizontal sd of the position by which it was found, an axis; 0 where that is exact
    """

    limit_kmh: FloatArray
    kind: Words
    surroundings: Words
    district: Words
    position_sd_m: FloatArray

    @classmethod
    def unknown(cls, n: int) -> Road:
        """Without a map."""
        nothing = np.full(n, "")
        return cls(np.full(n, np.nan), nothing, nothing, nothing, np.zeros(n))


@dataclass(frozen=True, slots=True, eq=False)
class Environment:
    """What is around a vehicle at n instants.

    Parameters
    ----------
    t_ns : (n,) UTC
    utc_offset_s : local time less UTC, s
    lat_rad, lon_rad : (n,), for the sun; NaN where not known
    road : of the n instants
    """

    t_ns: TimeArray
    utc_offset_s: float
    lat_rad: FloatArray
    lon_rad: FloatArray
    road: Road

    def sun_rad(self) -> FloatArray:
        """Elevation of the sun, (n,); NaN without a position."""
        return solar_elevation_rad(self.t_ns, self.lat_rad, self.lon_rad)

    def values(self) -> Values:
        """As inputs of the environment's tables, (n,) each."""
        hour, weekday, month = calendar(self.t_ns, self.utc_offset_s)
        elevation = self.sun_rad()
        light = np.where(elevation >= 0.0, LIGHTS[0], np.where(elevation >= CIVIL_TWILIGHT_RAD, LIGHTS[1], LIGHTS[2]))
        return {
            "hour": hour,
            "weekday": np.array(WEEKDAYS)[weekday],
            "month": month,
            "light": np.where(np.isnan(elevation), "", light),
            "road": self.road.kind,
            "surroundings": self.road.surroundings,
            "district": self.road.district,
        }


def calendar(t_ns: TimeArray, utc_offset_s: float) -> tuple[npt.NDArray[Any], npt.NDArray[np.int64], npt.NDArray[Any]]:
    """Hour (0 to 23), weekday (0 Monday to 6 Sunday) and month (1 to 12) of local time, (n,) each."""
    local_ns = t_ns + round(utc_offset_s * 1e9)
    hours = local_ns // _HOUR_NS
    days = hours // 24
    months = days.astype("datetime64[D]").astype("datetime64[M]").astype(np.int64)
    return hours % 24, (days + _DAYS_TO_MONDAY) % 7, months % 12 + 1


def solar_offset_s(lon_rad: float) -> float:
    """Whole hours by which local time differs from UTC at a longitude, s: where no time zone is known."""
    return 3600.0 * round(math.degrees(lon_rad) / 15.0)
