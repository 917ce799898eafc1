"""Roads under a drive folder: its positions as the matcher takes them, and how right it is where the truth is known."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np

from core.earth import horizontal_distance_m
from core.measurements import GNSS
from core.navigation.track import Mode, Track
from service.recordings.drive_folder import Drive
from service.roads.protocol import BoolArray, Certainty, FloatArray, IntArray, MatchedPoints, RoadMatcher

Source = Literal["fused", "raw", "reference"]
SURE_HEADING_DEG: Final = 20.0
"""A heading that is less sure than this is not told: it would speak for no road in particular."""
DEFAULT_SD_M: Final = 5.0
"""Of a fix without a stated accuracy; a choice, as receivers have in streets."""
REFERENCE_SD_M: Final = 0.5
EVERY_NS: Final = 1_000_000_000


@dataclass(frozen=True, slots=True, eq=False)
class Positions:
    """Positions of a drive over time, (n,) each; NaN where there is none."""

    t_ns: IntArray
    lat_deg: FloatArray
    lon_deg: FloatArray
    sd_m: FloatArray
    heading_deg: FloatArray

    def matched(self, matcher: RoadMatcher) -> MatchedPoints:
        """The roads under them."""
        return matcher.match(self.t_ns, self.lat_deg, self.lon_deg, self.sd_m, self.heading_deg)


def of_track(track: Track) -> Positions:
    """Positions of a fused track, but for the time before it is aligned."""
    known = track.column("mode") != Mode.ALIGNING
    sure = known & (track.column("sd_yaw_rad") <= np.radians(SURE_HEADING_DEG))
    return Positions(
        t_ns=track.t_ns,
        lat_deg=np.where(known, np.degrees(track.column("lat_rad")), np.nan),
        lon_deg=np.where(known, np.degrees(track.column("lon_rad")), np.nan),
        sd_m=np.sqrt((track.column("sd_n_m") ** 2 + track.column("sd_e_m") ** 2) / 2),
        heading_deg=np.where(sure, np.degrees(track.column("yaw_rad")), np.nan),
    )


def of_fixes(drive: Drive) -> Positions:
    """Positions of the receiver alone."""
    m = drive.measurements
    sd = m.gnss[:, GNSS["sd_h_m"]]
    north, east = m.gnss[:, GNSS["vn_mps"]], m.gnss[:, GNSS["ve_mps"]]
    course = np.where(np.hypot(north, east) > 3.0, np.degrees(np.arctan2(east, north)), np.nan)
    return Positions(
        t_ns=m.gnss_t_ns,
        lat_deg=np.degrees(m.gnss[:, GNSS["lat_rad"]]),
        lon_deg=np.degrees(m.gnss[:, GNSS["lon_rad"]]),
        sd_m=np.where(np.isfinite(sd), sd, DEFAULT_SD_M),
        heading_deg=course,
    )


def of_reference(drive: Drive) -> Positions | None:
    """Positions of the reference, one a second; None where the drive has none."""
    reference = drive.reference
    if reference is None or reference.t_ns.size == 0:
        return None
    seconds = np.arange(reference.t_ns[0], reference.t_ns[-1] + 1, EVERY_NS)
    rows = np.unique(np.searchsorted(reference.t_ns, seconds))
    return Positions(
        t_ns=reference.t_ns[rows],
        lat_deg=np.degrees(reference.lat_rad[rows]),
        lon_deg=np.degrees(reference.lon_rad[rows]),
        sd_m=np.full(rows.size, REFERENCE_SD_M),
        heading_deg=np.degrees(reference.rpy_rad[rows, 2]),
    )


def step_m(positions: Positions) -> FloatArray:
    """Distance from each position to the next one, shared between both, (n,) m; 0 where there is none."""
    if positions.t_ns.size < 2:
        return np.zeros(positions.t_ns.size)
    lat, lon = np.radians([positions.lat_deg, positions.lon_deg])
    step = np.nan_to_num(horizontal_distance_m(lat[:-1], lon[:-1], lat[1:], lon[1:]))
    return np.asarray(np.concatenate([step / 2, [0.0]]) + np.concatenate([[0.0], step / 2]))


def summary(positions: Positions, matched: MatchedPoints) -> dict[str, Any]:
    """Distance by what is known of its road."""
    step = step_m(positions)

    def km(chosen: BoolArray) -> float:
        return round(float(step[chosen].sum()) / 1000.0, 3)

    on = matched.way_id > 0
    certainty = matched.limit_certainty
    return {
        "points": int(positions.t_ns.size),
        "distance_km": km(np.ones(step.size, np.bool_)),
        "matched_km": km(on),
        "limit_tagged_km": km(on & (certainty == Certainty.TAGGED)),
        "limit_assumed_km": km(on & (certainty == Certainty.ASSUMED)),
        "ways": int(np.unique(matched.way_id[on]).size),
        "streets": len(matched.streets),
        "districts": list(matched.districts),
    }


@dataclass(frozen=True, slots=True)
class Rightness:
    """Distances by whether they were matched rightly, m; sums of them go on being right."""

    with_gnss_m: float = 0.0
    with_gnss_right_m: float = 0.0
    outage_m: float = 0.0
    outage_right_m: float = 0.0
    street_m: float = 0.0
    street_right_m: float = 0.0
    tagged_m: float = 0.0
    tagged_right_m: float = 0.0
    tagged_right_way_m: float = 0.0
    tagged_right_way_right_m: float = 0.0
    district_m: float = 0.0
    district_right_m: float = 0.0

    def plus(self, other: Rightness) -> Rightness:
        """Of both together."""
        return Rightness(*(getattr(self, name) + getattr(other, name) for name in self.__slots__))

    def shares(self) -> dict[str, float | None]:
        """What was right, as a share of the distance that it could be."""

        def share(right: float, whole: float) -> float | None:
            return right / whole if whole > 0.0 else None

        return {
            "right_way_with_gnss": share(self.with_gnss_right_m, self.with_gnss_m),
            "right_way_in_outages": share(self.outage_right_m, self.outage_m),
            "right_street": share(self.street_right_m, self.street_m),
            "right_limit_where_tagged": share(self.tagged_right_m, self.tagged_m),
            "right_limit_on_right_way": share(self.tagged_right_way_right_m, self.tagged_right_way_m),
            "right_district": share(self.district_right_m, self.district_m),
        }


def rightness(
    drive: Drive, positions: Positions, matched: MatchedPoints, outages: Sequence[tuple[float, float]]
) -> Rightness | None:
    """Against the truth of a drive that was simulated on the same roads; None for any other.

    ``outages`` are (start, end) in seconds of the drive; tunnels, too, are without GNSS and counted with neither.
    """
    truth: Mapping[str, Any] | None = (drive.truth or {}).get("roads")
    if truth is None:
        return None
    t_s = (positions.t_ns - drive.start_t_ns) / 1e9
    at = np.rint(t_s).astype(np.int64)
    usable = (at >= 0) & (at < len(truth["t_s"])) & (np.abs(t_s - at) < 0.01)
    at = np.clip(at, 0, len(truth["t_s"]) - 1)
    step = np.where(usable, step_m(positions), 0.0)
    way = np.array(truth["way_id"])[at]
    limit = np.array([np.nan if one is None else one for one in truth["limit_kmh"]])[at]
    tagged = np.array([one == "tagged" for one in truth["limit_certainty"]])[at]
    limit[tagged & np.isnan(limit)] = np.inf  # JSON has no way to say that there is none
    street = np.array([matched.street(i) == truth["street"][at[i]] for i in range(at.size)], np.bool_)
    district = np.array([matched.district(i) == truth["district"][at[i]] for i in range(at.size)], np.bool_)
    right, right_limit = matched.way_id == way, matched.limit_kmh == limit
    blind = np.zeros(at.size, np.bool_)
    for one in (drive.truth or {}).get("outages", ()):
        blind |= (t_s >= one["start_s"]) & (t_s < one["start_s"] + one["duration_s"])
    out = np.zeros(at.size, np.bool_)
    for start_s, end_s in outages:
        out |= (t_s >= start_s) & (t_s < end_s)

    def metres(*conditions: BoolArray) -> float:
        return float(step[np.logical_and.reduce(conditions)].sum())

    everywhere = np.ones(at.size, np.bool_)
    named = np.array([one is not None for one in truth["street"]])[at]
    return Rightness(
        with_gnss_m=metres(~blind),
        with_gnss_right_m=metres(~blind, right),
        outage_m=metres(out),
        outage_right_m=metres(out, right),
        street_m=metres(named),
        street_right_m=metres(named, street),
        tagged_m=metres(tagged),
        tagged_right_m=metres(tagged, right_limit),
        tagged_right_way_m=metres(tagged, right),
        tagged_right_way_right_m=metres(tagged, right, right_limit),
        district_m=metres(everywhere),
        district_right_m=metres(everywhere, district),
    )
