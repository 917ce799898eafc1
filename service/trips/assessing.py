"""A stored trip through the assessment: its record for scores and its risk second by second, from rows alone.

The same rows give the same record to the bit.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import Final
from zoneinfo import ZoneInfo

import numpy as np
import numpy.typing as npt

from core.driving.exposure import UNKNOWN, Driven, Exposure, Facet, exposure
from core.driving.speeding import Speeding, speeding
from core.earth import horizontal_distance_m
from core.measurements import FloatArray, TimeArray
from core.navigation.track import TRACK, TRACK_COLUMNS, Mode, Track
from core.risk.assessment import VEHICLE, Assessment, RiskModel, assess
from core.risk.belief import N_SETS, SINGLETONS
from core.risk.driver import Driver
from core.risk.environment import Environment, solar_offset_s
from core.scoring.record import MASS_UNIT, BeliefSums, Evidence, Record, SpeedingSums
from schemas.vehicles import VehicleConfig
from service.cells import cells
from service.risk.instants import EVERY_NS, Instants, by_fixes, by_track, first_known, matched_under, road_of
from service.risk.loading import RiskBasis
from service.roads.protocol import Certainty, MatchedPoints, RoadClass, RoadMatcher
from service.storage.accidents import AccidentRow
from service.storage.manoeuvres import Excuse, ManoeuvreRow
from service.storage.trips import TrackRow, TripRow
from service.trips.excusing import with_events
from service.trips.timeline import FUSED, Timeline

VERSION: Final = 2
"""Of what is made of a trip beside the risk tables; it goes up where the same rows give another record."""
AROUND_NS: Final = 1_500_000_000
"""Rows of so long before and after a trip are taken along, so that its first and last second lie between two."""
ASSUMED_CERTAINTY: Final = 0.6
"""What a legal limit is worth that the map does not say, but country and class of road; a choice. A match's confidence
goes on top."""
GAP_NS: Final = 2_000_000_000
"""Across more without a row nobody knows how it was driven, but how far: the straight line, as a trip counts it."""
_PLACES_TOLD: Final = 3
"""Of how many districts and road classes a trip is evidence at most: those in which it was longest."""
_QUARTER_NS: Final = 900_000_000_000


@dataclass(frozen=True, slots=True)
class TripRows:
    """All that is stored of a trip and matters to its record."""

    trip: TripRow
    positions: Sequence[TrackRow]
    manoeuvres: Sequence[ManoeuvreRow]
    accidents: Sequence[AccidentRow]
    hazards: Mapping[str, str | None]
    """By manoeuvre what explains it (``service.trips.hazards``)."""


@dataclass(frozen=True, slots=True)
class AssessedTrip:
    """A trip's record, its risk second by second, and why manoeuvres do not count, by their ids.

    Of ``unmatched_s`` seconds the roads are unknown only because looking them up failed.
    """

    record: Record
    timeline: Timeline
    excused: Mapping[str, Excuse | None]
    unmatched_s: int


def model_sha256(basis: RiskBasis) -> str:
    """What trips are assessed by: the tables and this module's version."""
    return hashlib.sha256(f"{basis.sha256} {VERSION}".encode()).hexdigest()


def assess_trip(rows: TripRows, config: VehicleConfig, matcher: RoadMatcher, model: RiskModel) -> AssessedTrip:
    """Assess a trip by the vehicle's settings; roads wait for the matcher's processes."""
    track = track_of(rows.positions)
    t_ns = _seconds(rows.trip)
    instants = first_known(by_track(track, t_ns), _by_fixes(track, t_ns))
    found = matched_under(instants, matcher)
    offsets_s = _utc_offsets_s(instants, config.time_zone)
    environment = Environment(
        t_ns=t_ns,
        utc_offset_s=float(offsets_s[0]) if len(offsets_s) else 0.0,
        lat_rad=instants.lat_rad,
        lon_rad=instants.lon_rad,
        road=road_of(found, instants),
    )
    assessed = assess(model, _driver(config, rows.trip.start_ns), environment, instants.motion)
    record = Record(
        trips=1,
        coasting_ms=round(1e3 * rows.trip.coasting_s),
        speeding=_speeding_sums(_speeding(instants, found)),
        belief=_belief(assessed),
        coverage={name: int(_units(share).sum()) for name, share in assessed.coverage.items()},
    )
    record = _with_exposure(record, rows.trip.id, _exposure(instants, found, track, offsets_s))
    record, excused = with_events(record, rows.manoeuvres, rows.accidents, rows.hazards)
    timeline = Timeline.of(t_ns, instants.motion.speed_mps, found, assessed)
    return AssessedTrip(record, timeline, excused, int(found.failed.sum()))


def track_of(positions: Sequence[TrackRow]) -> Track:
    """Stored positions as rows of the filter's track."""
    values = np.full((len(positions), len(TRACK_COLUMNS)), np.nan)
    same = ("alt_m", "vn_mps", "ve_mps", "vd_mps", "sd_n_m", "sd_e_m", "sd_d_m", "cov_ne_m2", "sd_v_h_mps")
    for name in (*same, "sd_accel_bias_mps2", "gnss_used", "mode"):
        values[:, TRACK[name]] = [math.nan if (one := getattr(row, name)) is None else one for row in positions]
    for name in ("lat", "lon", "roll", "pitch", "yaw", "sd_yaw", "sd_tilt"):
        told = [math.nan if (one := getattr(row, f"{name}_deg")) is None else one for row in positions]
        values[:, TRACK[f"{name}_rad"]] = np.radians(np.array(told, np.float64))
    return Track(np.array([row.t_ns for row in positions], np.int64), values)


def _seconds(trip: TripRow) -> TimeArray:
    first = -(-trip.start_ns // EVERY_NS) * EVERY_NS
    return np.arange(first, trip.end_ns + 1, EVERY_NS, dtype=np.int64)


def _by_fixes(track: Track, t_ns: TimeArray) -> Instants:
    """What GNSS alone says while the filter aligns."""
    fixes = track.column("mode") == Mode.ALIGNING
    track = Track(track.t_ns[fixes], track.values[fixes])
    v_n = np.column_stack([track.column("vn_mps"), track.column("ve_mps")])
    sd_m = np.hypot(track.column("sd_n_m"), track.column("sd_e_m")) / np.sqrt(2.0)
    return by_fixes(t_ns, track.t_ns, track.column("lat_rad"), track.column("lon_rad"), v_n, sd_m)


def _driver(config: VehicleConfig, t_ns: int) -> Driver:
    year = datetime.fromtimestamp(t_ns // 1_000_000_000, UTC).year
    return Driver() if config.driver is None else config.driver.in_year(year)


def _utc_offsets_s(instants: Instants, zone: str | None) -> npt.NDArray[np.int64]:
    """Local time less UTC at each instant: by the vehicle's zone, else by the longitude of its first place."""
    if zone is None:
        placed = np.flatnonzero(np.isfinite(instants.lon_rad))
        offset_s = solar_offset_s(float(instants.lon_rad[placed[0]])) if placed.size else 0.0
        return np.full(len(instants.t_ns), round(offset_s), np.int64)
    quarters, which = np.unique(instants.t_ns // _QUARTER_NS, return_inverse=True)
    local = [datetime.fromtimestamp(one * 900, ZoneInfo(zone)).utcoffset() for one in quarters.tolist()]
    return np.array([0 if one is None else round(one.total_seconds()) for one in local], np.int64)[which]


def _exposure(instants: Instants, found: MatchedPoints, track: Track, offsets_s: npt.NDArray[np.int64]) -> Exposure:
    classes = np.array([UNKNOWN, *(kind.name.lower() for kind in list(RoadClass)[1:])])
    districts = np.array([*found.districts, UNKNOWN])
    labels = {
        Facet.ROAD_CLASS: classes[found.road_class].tolist(),
        Facet.DISTRICT: districts[found.district_index].tolist(),
        Facet.CELL: cells(instants.lat_rad, instants.lon_rad),
    }
    speed_mps = _bridged(instants, track)
    return exposure(instants.t_ns, instants.lat_rad, instants.lon_rad, speed_mps, offsets_s, labels)


def _bridged(instants: Instants, track: Track) -> FloatArray:
    """Speed at each instant, across gaps in the rows that of the straight line: nobody drives less for losing data."""
    speed_mps = instants.motion.speed_mps.copy()
    unknown = np.flatnonzero(np.isnan(speed_mps))
    placed = np.isfinite(track.column("lat_rad") + track.column("lon_rad"))
    at_ns, lat, lon = track.t_ns[placed], track.column("lat_rad")[placed], track.column("lon_rad")[placed]
    if len(at_ns) < 2:
        return speed_mps
    after = np.searchsorted(at_ns, instants.t_ns[unknown])
    inside = (after > 0) & (after < len(at_ns))
    unknown, after = unknown[inside], after[inside]
    gap_ns = at_ns[after] - at_ns[after - 1]
    way_m = horizontal_distance_m(lat[after - 1], lon[after - 1], lat[after], lon[after])
    speed_mps[unknown] = np.where(gap_ns > GAP_NS, way_m / (gap_ns * 1e-9), np.nan)
    return speed_mps


def _with_exposure(record: Record, trip_id: str, driven: Exposure) -> Record:
    """A record with what was driven, for which the trip is evidence by its distance."""
    by = dict(driven.by)
    places = by.pop(Facet.CELL, {})
    of: dict[str, int] = {"mileage": driven.total.distance_mm}
    of |= {f"{Facet.HOUR}:{hour}": one.distance_mm for hour, one in by.get(Facet.HOUR, {}).items()}
    of["speeding"] = record.speeding.excess_mm
    of["vehicle"] = _risky(record.belief.get(VEHICLE))
    for facet in (Facet.ROAD_CLASS, Facet.DISTRICT):
        longest = sorted(by.get(facet, {}).items(), key=lambda item: (-item[1].distance_mm, item[0]))[:_PLACES_TOLD]
        of |= {f"{facet}:{label}": one.distance_mm for label, one in longest if label != UNKNOWN}
    evidence = {about: (Evidence(weight, "trip", trip_id),) for about, weight in of.items() if weight}
    cells_driven = {cell: one for cell, one in places.items() if one != Driven()}
    return replace(record, exposure=Exposure(driven.total, by), cells=cells_driven, evidence=evidence)


def _risky(sums: BeliefSums | None) -> int:
    """Thousandths of an instant that were believed to be of higher risk than low."""
    low = 1 << SINGLETONS.index("LR")
    return 0 if sums is None else sum(one for bits, one in enumerate(sums.mass) if not bits & low) // round(1e-3 / 1e-9)


def _speeding(instants: Instants, found: MatchedPoints) -> Speeding:
    certainty = np.where(found.limit_certainty == Certainty.TAGGED, 1.0, ASSUMED_CERTAINTY) * found.confidence
    limit_mps = found.limit_kmh / 3.6
    return speeding(instants.t_ns, instants.motion.speed_mps, limit_mps, np.clip(certainty, 0.0, 1.0))


def _speeding_sums(found: Speeding) -> SpeedingSums:
    return SpeedingSums(
        known_ms=round(1e3 * found.known_s),
        unknown_ms=round(1e3 * found.unknown_s),
        over_ms=round(1e3 * found.over_s),
        certain_ms=round(1e3 * found.certain_s),
        certain_over_ms=round(1e3 * found.certain_over_s),
        excess_mm=round(1e3 * found.excess_m),
        max_excess_mmps=round(1e3 * found.max_excess_mps),
        episodes=len(found.episodes),
    )


def _belief(assessed: Assessment) -> dict[str, BeliefSums]:
    masses = {FUSED: assessed.fused, **assessed.entities}
    if not len(assessed.fused):
        return {}
    sums = {name: _units(mass).sum(axis=0).tolist() for name, mass in masses.items()}
    return {name: BeliefSums(len(masses[name]), tuple(one)) for name, one in sums.items() if len(one) == N_SETS}


def _units(share: FloatArray) -> npt.NDArray[np.int64]:
    return np.rint(np.asarray(share) / MASS_UNIT).astype(np.int64)
