"""Trips as a fold over the fused track."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt
from numba import njit

from core.earth import radii_m
from core.measurements import FloatArray, TimeArray
from core.navigation.track import TRACK, Mode, Track
from core.tunables import Tunables, tunable


@dataclass(frozen=True, slots=True)
class Trip:
    """One trip as known so far. ``ended`` is False while it may still go on.

    Angles rad, times UTC ns. ``distance_m`` is along the fused track; ``coasting_s`` the time without GNSS.
    A trip is identified by its ``start_t_ns`` within its vehicle.
    """

    start_t_ns: int
    end_t_ns: int
    start_lat_rad: float
    start_lon_rad: float
    end_lat_rad: float
    end_lon_rad: float
    distance_m: float
    moving_s: float
    coasting_s: float
    max_speed_mps: float
    ended: bool


@dataclass(frozen=True, slots=True)
class TripThresholds(Tunables):
    """What begins and ends a trip."""

    moving_mps: float = tunable(
        1.0,
        unit="m/s",
        low=0.2,
        high=5.0,
        source="choice: above the fused speed's noise of a parked car under multipath",
    )
    standing_mps: float = tunable(
        0.5, unit="m/s", low=0.05, high=5.0, source="choice: half of moving_mps, so that creeping does not flicker"
    )
    start_s: float = tunable(3.0, unit="s", low=0.0, high=60.0, source="choice: moving so long on end begins a trip")
    start_m: float = tunable(
        10.0, unit="m", low=0.0, high=1000.0, source="choice: and so far; being shunted in a yard is no trip"
    )
    stop_s: float = tunable(
        300.0, unit="s", low=10.0, high=7200.0, source="choice: 5 min, longer than traffic lights, queues and crossings"
    )
    silence_s: float = tunable(
        300.0, unit="s", low=10.0, high=7200.0, source="choice: as stop_s; a shorter gap in the data is bridged"
    )
    ignition_off_s: float = tunable(
        30.0, unit="s", low=0.0, high=3600.0, source="choice: longer than an engine that stalls or stops at a light"
    )
    report_s: float = tunable(
        10.0, unit="s", low=0.1, high=600.0, source="choice: how often a trip that goes on is told"
    )
    row_gap_s: float = tunable(
        1.0, unit="s", low=0.2, high=60.0, source="choice: rows come every 100 ms; across more, speed says nothing"
    )


_IDLE, _STARTING, _TRIP = range(3)
_PHASE, _MOVING, _IGNITION_OFF, _LAST, _SINCE, _START, _END, _TOLD, _OFF_SINCE = range(9)
"""Registers, int64: the phase; whether the vehicle moves and whether its ignition is off; times of the last row,
of the present run of movement's beginning, of the trip's start and last movement, of what was told last and of
when the ignition was first seen off at a standstill (0 never)."""

(
    _LAT, _LON, _SPEED, _ANCHOR_LAT, _ANCHOR_LON, _START_LAT, _START_LON, _END_LAT, _END_LON,
    _DISTANCE, _MOVING_S, _COASTING_S, _MAX_SPEED, _NEW_DISTANCE, _NEW_MOVING_S, _NEW_COASTING_S,
) = range(16)  # fmt: skip
"""Registers, float64: the last row; the row where it last stood; the trip so far, up to its last movement; and what
has come up since then, which counts once it moves again."""

_NONE, _TELL, _CLOSE = range(3)


class TripTracker:
    """Folds track rows into trips; the same rows give the same trips however they are cut.

    A trip begins when the vehicle has moved for ``start_s`` and ``start_m``, dated back to the last row at
    which it still stood. It ends, dated back to its last movement, once it has stood for ``stop_s``, its data were
    silent for ``silence_s``, or its ignition was off at a standstill for ``ignition_off_s``; whatever is
    shorter belongs to the trip. Its distance is the integral of the fused horizontal speed while it moves, and the
    straight line across a gap in the rows, so that neither noise at a standstill nor the jumps of
    a corrected position add to it.
    """

    def __init__(self, thresholds: TripThresholds | None = None) -> None:
        self._thresholds = thresholds or TripThresholds()
        self._times: TimeArray = np.zeros(9, dtype=np.int64)
        self._values: FloatArray = np.zeros(16)

    def step(self, track: Track, ignition: bool | None) -> list[Trip]:
        """Take the next rows; ``ignition`` holds for all of them, None keeps what was known.

        Returns a trip when it has begun, every ``report_s`` while it goes on, and when it has ended.
        Rows without a position, or not later than the one before, are left out.
        """
        if ignition is not None:
            self._times[_IGNITION_OFF] = not ignition
        limits = self._thresholds
        trips: list[Trip] = []
        row = 0
        while True:
            row, what = _scan(
                np.ascontiguousarray(track.t_ns),
                np.ascontiguousarray(track.values),
                row,
                self._times,
                self._values,
                limits.moving_mps,
                limits.standing_mps,
                limits.start_s,
                limits.start_m,
                limits.stop_s,
                limits.silence_s,
                limits.ignition_off_s,
                limits.report_s,
                limits.row_gap_s,
            )
            if what == _NONE:
                return trips
            trips.append(self._trip(ended=what == _CLOSE))

    def end(self) -> list[Trip]:
        """The trip under way, ended with its last movement: no more rows follow."""
        return [self._trip(ended=True)] if self._times[_PHASE] == _TRIP else []

    def state(self) -> dict[str, npt.NDArray[np.generic]]:
        """Arrays from which ``load`` goes on, to the bit."""
        return {"trips.times": self._times, "trips.values": self._values}

    def load(self, arrays: Mapping[str, npt.NDArray[np.generic]]) -> None:
        """Go on from a ``state``."""
        self._times = np.array(arrays["trips.times"], dtype=np.int64)
        self._values = np.array(arrays["trips.values"], dtype=np.float64)

    def _trip(self, ended: bool) -> Trip:
        times, values = self._times.tolist(), self._values.tolist()
        return Trip(
            start_t_ns=times[_START],
            end_t_ns=times[_END],
            start_lat_rad=values[_START_LAT],
            start_lon_rad=values[_START_LON],
            end_lat_rad=values[_END_LAT],
            end_lon_rad=values[_END_LON],
            distance_m=values[_DISTANCE],
            moving_s=values[_MOVING_S],
            coasting_s=values[_COASTING_S],
            max_speed_mps=values[_MAX_SPEED],
            ended=ended,
        )


_LAT_COLUMN: Final = TRACK["lat_rad"]
_LON_COLUMN: Final = TRACK["lon_rad"]
_VN_COLUMN: Final = TRACK["vn_mps"]
_VE_COLUMN: Final = TRACK["ve_mps"]
_MODE_COLUMN: Final = TRACK["mode"]
_COASTING: Final = float(Mode.COASTING)


@njit(cache=True, nogil=True)
def _scan(
    t_ns: TimeArray,
    rows: FloatArray,
    row: int,
    times: TimeArray,
    values: FloatArray,
    moving_mps: float,
    standing_mps: float,
    start_s: float,
    start_m: float,
    stop_s: float,
    silence_s: float,
    ignition_off_s: float,
    report_s: float,
    row_gap_s: float,
) -> tuple[int, int]:
    """Go on from ``row`` to where a trip is to be told; return the row to go on from, and what is to be done."""
    while row < t_ns.shape[0]:
        now = t_ns[row]
        lat, lon = rows[row, _LAT_COLUMN], rows[row, _LON_COLUMN]
        speed = math.hypot(rows[row, _VN_COLUMN], rows[row, _VE_COLUMN])
        known = times[_LAST] != 0
        if not math.isfinite(lat + lon + speed) or (known and now <= times[_LAST]):
            row += 1
            continue
        dt = (now - times[_LAST]) * 1e-9 if known else 0.0
        if known and dt >= silence_s:
            if times[_PHASE] == _TRIP:
                times[_PHASE] = _IDLE
                return row, _CLOSE  # this row comes again, with no trip
            known, dt = False, 0.0
        if not known:
            times[_PHASE], times[_MOVING], times[_SINCE], times[_OFF_SINCE] = _IDLE, 0, now, 0
            values[_ANCHOR_LAT], values[_ANCHOR_LON] = lat, lon
            values[_NEW_DISTANCE], values[_NEW_MOVING_S], values[_NEW_COASTING_S] = 0.0, 0.0, 0.0

        bridged = dt > row_gap_s
        if known:
            along = 0.5 * dt * (speed + values[_SPEED])
            if bridged:
                along = _distance_m(values[_LAT], values[_LON], lat, lon)
            values[_NEW_DISTANCE] += along
            values[_NEW_MOVING_S] += dt
            if bridged or rows[row, _MODE_COLUMN] == _COASTING:
                values[_NEW_COASTING_S] += dt
            carried = bridged and along >= moving_mps * dt
        else:
            carried = False
        times[_LAST], values[_LAT], values[_LON], values[_SPEED] = now, lat, lon, speed

        if not times[_MOVING] and speed >= moving_mps:
            times[_MOVING] = 1
        elif times[_MOVING] and speed < standing_mps:
            times[_MOVING] = 0
        if times[_MOVING] or (carried and times[_PHASE] == _TRIP):
            if times[_PHASE] == _IDLE:
                times[_PHASE], times[_START] = _STARTING, times[_SINCE]
                values[_START_LAT], values[_START_LON] = values[_ANCHOR_LAT], values[_ANCHOR_LON]
                values[_DISTANCE], values[_MOVING_S], values[_COASTING_S], values[_MAX_SPEED] = 0.0, 0.0, 0.0, 0.0
            values[_DISTANCE] += values[_NEW_DISTANCE]
            values[_MOVING_S] += values[_NEW_MOVING_S]
            values[_COASTING_S] += values[_NEW_COASTING_S]
            values[_MAX_SPEED] = max(values[_MAX_SPEED], speed)
            values[_NEW_DISTANCE], values[_NEW_MOVING_S], values[_NEW_COASTING_S] = 0.0, 0.0, 0.0
            times[_END], values[_END_LAT], values[_END_LON] = now, lat, lon
            times[_OFF_SINCE] = 0
        elif speed < standing_mps:
            if times[_PHASE] == _STARTING:
                times[_PHASE] = _IDLE
            values[_NEW_DISTANCE], values[_NEW_MOVING_S] = 0.0, 0.0
            if times[_PHASE] == _IDLE:
                values[_NEW_COASTING_S] = 0.0
                times[_SINCE], values[_ANCHOR_LAT], values[_ANCHOR_LON] = now, lat, lon
        row += 1

        if times[_PHASE] == _STARTING:
            if (now - times[_START]) * 1e-9 >= start_s and values[_DISTANCE] >= start_m:
                times[_PHASE], times[_TOLD] = _TRIP, now
                return row, _TELL
        elif times[_PHASE] == _TRIP:
            if not times[_MOVING]:
                if not times[_IGNITION_OFF]:
                    times[_OFF_SINCE] = 0
                elif times[_OFF_SINCE] == 0:
                    times[_OFF_SINCE] = now
                off = times[_OFF_SINCE] != 0 and (now - times[_OFF_SINCE]) * 1e-9 >= ignition_off_s
                if off or (now - times[_END]) * 1e-9 >= stop_s:
                    times[_PHASE], times[_SINCE] = _IDLE, now
                    values[_ANCHOR_LAT], values[_ANCHOR_LON] = lat, lon
                    values[_NEW_DISTANCE], values[_NEW_MOVING_S], values[_NEW_COASTING_S] = 0.0, 0.0, 0.0
                    return row, _CLOSE
            if times[_END] > times[_TOLD] and (now - times[_TOLD]) * 1e-9 >= report_s:
                times[_TOLD] = now
                return row, _TELL
    return row, _NONE


@njit(cache=True, nogil=True)
def _distance_m(lat_a_rad: float, lon_a_rad: float, lat_b_rad: float, lon_b_rad: float) -> float:
    """Straight line between two near points on the ellipsoid, m."""
    mid = 0.5 * (lat_a_rad + lat_b_rad)
    meridian, transverse = radii_m(mid)
    d_lon = (lon_b_rad - lon_a_rad + math.pi) % (2.0 * math.pi) - math.pi
    return math.hypot((lat_b_rad - lat_a_rad) * meridian, d_lon * transverse * math.cos(mid))
