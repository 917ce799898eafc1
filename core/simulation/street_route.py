"""A drive along given streets: their line with its corners rounded, at speeds that limits, curves and stops allow."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicHermiteSpline
from scipy.ndimage import maximum_filter1d

from core.earth import radii_m
from core.errors import InvalidInputError
from core.measurements import FloatArray
from core.simulation.roads import STILL_START_S
from core.simulation.route import Channel, Route, Sky, SkySpan
from core.simulation.trajectory import Place
from core.tunables import Tunables, tunable

Indices = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]

_CURVE_AHEAD_M: Final = 5.0
"""So far before and behind a curve its speed holds, since pedals ease over time."""
_STEP_M: Final = 0.5
"""Along the line, at which it is worked on."""
_STEP_S: Final = 0.02
"""Of the tables of speed and heading over time."""
_STILL_END_S: Final = 5.0
_SHORTEST_M: Final = 50.0
_APART_M: Final = 25.0
"""Stops are no nearer to one another and to the path's ends."""
_EARTH_FIELD_UT: Final = 29.8
"""Of an axial dipole at the equator: a field without declination, as a box knows none."""


@dataclass(frozen=True, slots=True)
class Driving(Tunables):
    """How the streets are driven."""

    corner_m: float = tunable(
        16.0, unit="m", low=4.0, high=60.0, source="choice: a right angle in an arc of 5 m at its tightest, as in towns"
    )
    lane_change_m: float = tunable(60.0, unit="m", low=10.0, high=200.0, source="choice: where the lane's side shifts")
    lateral_mps2: float = tunable(
        2.2, unit="m/s2", low=0.5, high=6.0, source="choice: drivers keep below 2 to 3 in curves (Eboli 2016)"
    )
    accelerating_mps2: float = tunable(1.4, unit="m/s2", low=0.3, high=4.0, source="choice: everyday")
    braking_mps2: float = tunable(1.8, unit="m/s2", low=0.3, high=6.0, source="choice: everyday, below 3")
    easing_s: float = tunable(
        1.6, unit="s", low=0.2, high=5.0, source="choice: pedals are moved within a second or two"
    )
    least_mps: float = tunable(1.5, unit="m/s", low=0.5, high=5.0, source="choice: in the tightest corner")
    limit_share_low: float = tunable(0.85, unit="1", low=0.3, high=1.5, source="choice: of the limit, slowest street")
    limit_share_high: float = tunable(1.0, unit="1", low=0.3, high=1.5, source="choice: of the limit, fastest street")
    stop_share: float = tunable(
        0.3, unit="1", low=0.0, high=1.0, source="choice: of junctions, lights and right of way"
    )
    wait_low_s: float = tunable(3.0, unit="s", low=2.0, high=60.0, source="choice")
    wait_high_s: float = tunable(20.0, unit="s", low=2.0, high=120.0, source="choice: a short red light")
    before_junction_m: float = tunable(8.0, unit="m", low=0.0, high=30.0, source="choice: the stop line")


@dataclass(frozen=True, slots=True, eq=False)
class StreetPath:
    """A line of n points along streets, and what holds on each of its n - 1 pieces.

    Parameters
    ----------
    lat_rad, lon_rad : (n,)
    limit_mps : (n - 1,)
        What may be driven; finite.
    lane_m : (n - 1,)
        How far right of the line the lane is (left is negative).
    tunnel : (n - 1,) bool
    junction : (n,) bool
        Where one may have to stop.
    """

    lat_rad: FloatArray
    lon_rad: FloatArray
    limit_mps: FloatArray
    lane_m: FloatArray
    tunnel: Flags
    junction: Flags


@dataclass(frozen=True, slots=True, eq=False)
class StreetDrive:
    """A path as it is driven: the route, where it begins, and the piece of the path under the car.

    ``piece_t_s`` (m,) increasing and ``piece`` (m,): from each time on the car is on that piece.
    """

    route: Route
    place: Place
    piece_t_s: FloatArray
    piece: Indices


@dataclass(frozen=True, slots=True, eq=False)
class Sampled:
    """A ``Signal`` by its value and derivative at equal steps, with a cubic between them (Hermite)."""

    step_s: float
    value: FloatArray
    rate: FloatArray

    def at(self, t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Value and time derivative, (n,) each; held before the first and after the last step."""
        last = self.value.size - 1
        x = np.clip(t_s / self.step_s, 0.0, last)
        i = np.minimum(x.astype(np.int64), last - 1)
        u = x - i
        p, q = self.value[i], self.value[i + 1]
        m, n = self.rate[i] * self.step_s, self.rate[i + 1] * self.step_s
        value = p + u * (m + u * (3 * (q - p) - 2 * m - n + u * (2 * (p - q) + m + n)))
        rate = (m + u * (2 * (3 * (q - p) - 2 * m - n) + 3 * u * (2 * (p - q) + m + n))) / self.step_s
        return value, np.where((t_s < 0.0) | (t_s > last * self.step_s), 0.0, rate)


def drive_streets(
    path: StreetPath,
    rng: np.random.Generator,
    duration_s: float,
    outages_s: tuple[tuple[float, float], ...] = (),
    driving: Driving | None = None,
    alt_m: float = 100.0,
) -> StreetDrive:
    """Drive along a path for a time, standing at both its ends.

    Parameters
    ----------
    path : StreetPath
    rng : numpy Generator
        Where one stops, for how long, and how near to the limit one drives.
    duration_s : float
    outages_s : tuple of (start, end)
        Without GNSS, beside the tunnels.

    Raises
    ------
    InvalidInputError
        If the path ends before the time does.
    """
    how = driving or Driving()
    line = _Line.along(path, how)
    limit = path.limit_mps[line.piece] * _shares(path, rng, how)[line.piece]
    tightest = maximum_filter1d(np.abs(line.curvature), 2 * round(_CURVE_AHEAD_M / _STEP_M) + 1)
    in_curves = np.sqrt(how.lateral_mps2 / np.maximum(tightest, 1e-6))
    allowed = np.maximum(np.minimum(limit, in_curves), how.least_mps)
    stops, waits = _stops(path, line, rng, how)
    going_s = duration_s - STILL_START_S - _STILL_END_S
    t_s, at, _ = _timed(line.s_m, allowed, stops, waits, how)
    if t_s[-1] < going_s:
        raise InvalidInputError(
            f"a path of {line.s_m[-1] / 1000:.1f} km takes {t_s[-1]:.0f} s: expected one for {going_s:.0f} s"
        )
    # To stop where the path goes on takes longer than to drive by, by half the time of braking.
    spare_s = float(allowed.max()) / (2 * how.braking_mps2)
    end = int(at[np.searchsorted(t_s, going_s - spare_s)]) if going_s > spare_s else 0
    if end < _SHORTEST_M / _STEP_M:
        raise InvalidInputError(f"a drive of {duration_s:g} s: too short to go anywhere")
    within = stops < end - 1
    t_s, at, speed_mps = _timed(line.s_m[:end], allowed[:end], stops[within], waits[within], how)
    return _driven(line, path, t_s, at, speed_mps, duration_s, outages_s, how, alt_m)


@dataclass(frozen=True, slots=True, eq=False)
class _Line:
    """The rounded line at about equal steps: ``s_m`` along it, heading, curvature, the path's piece, (k,) each."""

    s_m: FloatArray
    heading_rad: FloatArray
    curvature: FloatArray
    piece: Indices
    lat_rad: float
    lon_rad: float

    @classmethod
    def along(cls, path: StreetPath, how: Driving) -> _Line:
        lat0 = float(path.lat_rad.mean())
        meridian, transverse = radii_m(lat0)
        scale = np.array([meridian, transverse * math.cos(lat0)])
        corner = np.column_stack([path.lat_rad, path.lon_rad]) * scale
        along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(corner, axis=0).T))])
        if not along[-1] > 2 * how.corner_m:
            raise InvalidInputError(f"a path of {along[-1]:.0f} m: expected more than {2 * how.corner_m:g} m")
        at = np.arange(0.0, along[-1], _STEP_M)
        piece = np.clip(np.searchsorted(along, at, side="right") - 1, 0, path.limit_mps.size - 1)
        points = np.column_stack([np.interp(at, along, corner[:, i]) for i in (0, 1)])
        tangent = np.gradient(_smoothed(points, how.corner_m), axis=0)
        tangent /= np.hypot(*tangent.T)[:, None]
        lane = _smoothed(path.lane_m[piece][:, None], how.lane_change_m)
        points = _smoothed(points + lane * np.column_stack([-tangent[:, 1], tangent[:, 0]]), how.corner_m)
        lat, lon = (points / scale).T
        # From here on by the ellipsoid's own measures at each point, so that the drive comes out on the line.
        radii = np.array([radii_m(one) for one in (lat[1:] + lat[:-1]) / 2])
        north = np.diff(lat) * radii[:, 0]
        east = np.diff(lon) * radii[:, 1] * np.cos((lat[1:] + lat[:-1]) / 2)
        step = np.hypot(north, east)
        s = np.concatenate([[0.0], np.cumsum(step)])
        between = np.unwrap(np.arctan2(east, north))
        middle = (s[1:] + s[:-1]) / 2
        heading = np.interp(s, middle, between)
        curvature = np.interp(s, s[1:-1], np.diff(between) / np.diff(middle))
        return cls(s, heading, curvature, piece, float(lat[0]), float(lon[0]))


def _smoothed(values: FloatArray, length_m: float) -> FloatArray:
    """Columns (n, k) averaged over a length by a Hann window, their ends held."""
    window = np.hanning(2 * round(length_m / (2 * _STEP_M)) + 3)[1:-1]
    half = window.size // 2
    padded = np.pad(values, ((half, half), (0, 0)), mode="edge")
    return np.column_stack([np.convolve(one, window / window.sum(), mode="valid") for one in padded.T])


def _shares(path: StreetPath, rng: np.random.Generator, how: Driving) -> FloatArray:
    """How much of its limit is driven on each piece: one for each run of pieces between junctions."""
    run = np.cumsum(path.junction[:-1].astype(np.int64))
    return rng.uniform(how.limit_share_low, how.limit_share_high, int(run[-1]) + 1)[run]


def _stops(path: StreetPath, line: _Line, rng: np.random.Generator, how: Driving) -> tuple[Indices, FloatArray]:
    """Indices on the line at which the car stops, and for how long."""
    first_of_piece = np.searchsorted(line.piece, np.flatnonzero(path.junction[:-1]))
    chosen = first_of_piece[rng.random(first_of_piece.size) < how.stop_share]
    chosen = np.unique(np.maximum(chosen - round(how.before_junction_m / _STEP_M), 0))
    apart = round(_APART_M / _STEP_M)
    chosen = chosen[(chosen > apart) & (chosen < line.s_m.size - apart)]
    chosen = chosen[np.diff(chosen, prepend=-apart) >= apart]
    return chosen, rng.uniform(how.wait_low_s, how.wait_high_s, chosen.size)


def _timed(
    s_m: FloatArray, allowed: FloatArray, stops: Indices, waits: FloatArray, how: Driving
) -> tuple[FloatArray, Indices, FloatArray]:
    """Times, places (indices) and speeds of the car, standing at both ends; each stop is there twice."""
    length = s_m.size
    square = allowed**2
    square[[0, -1]] = 0.0
    square[stops] = 0.0
    step = np.diff(s_m)
    for i in range(1, length):
        square[i] = min(square[i], square[i - 1] + 2 * how.accelerating_mps2 * step[i - 1])
    for i in range(length - 2, -1, -1):
        square[i] = min(square[i], square[i + 1] + 2 * how.braking_mps2 * step[i])
    speed = np.sqrt(square)
    t_s = np.concatenate([[0.0], np.cumsum(2 * step / (speed[1:] + speed[:-1]))])
    waited = np.zeros(length)
    waited[stops + 1] = waits
    t_s = t_s + np.cumsum(waited)
    again = np.sort(np.concatenate([np.arange(length), stops]))
    t_s = np.insert(t_s, stops + 1, t_s[stops] + waits)
    return t_s, again, speed[again]


def _driven(
    line: _Line,
    path: StreetPath,
    t_s: FloatArray,
    at: Indices,
    speed_mps: FloatArray,
    duration_s: float,
    outages_s: tuple[tuple[float, float], ...],
    how: Driving,
    alt_m: float,
) -> StreetDrive:
    grid_s = np.arange(0.0, duration_s + 2 * _STEP_S, _STEP_S)
    # Between the places the acceleration is constant, which this cubic meets exactly.
    s = CubicHermiteSpline(t_s, line.s_m[at], speed_mps)(np.clip(grid_s - STILL_START_S, 0.0, t_s[-1]))
    window = np.hanning(2 * round(how.easing_s / (2 * _STEP_S)) + 3)[1:-1]
    half = window.size // 2
    s = np.convolve(np.pad(s, half, mode="edge"), window / window.sum(), mode="valid")
    speed = np.gradient(s, _STEP_S)
    curvature = np.interp(s, line.s_m, line.curvature)
    piece = line.piece[np.clip(np.searchsorted(line.s_m, s, side="right") - 1, 0, line.s_m.size - 1)]
    changes = np.flatnonzero(np.diff(piece, prepend=piece[0] - 1))
    lat = line.lat_rad
    field = (_EARTH_FIELD_UT * math.cos(lat), 0.0, 2 * _EARTH_FIELD_UT * math.sin(lat))
    still = Channel(0.0, ())
    route = Route(
        duration_s=duration_s,
        forward_by_tyres=Sampled(_STEP_S, speed, np.gradient(speed, _STEP_S)),
        right_by_tyres=still,
        forward_by_impacts=still,
        right_by_impacts=still,
        heading_rad=Sampled(_STEP_S, np.interp(s, line.s_m, line.heading_rad), curvature * speed),
        grade_rad=still,
        bumps=(),
        crashes=(),
        sky=tuple(SkySpan(Sky.OUTAGE, *one) for one in outages_s) + _tunnels(path.tunnel[piece], grid_s),
    )
    return StreetDrive(route, Place(lat, line.lon_rad, alt_m, field), grid_s[changes], piece[changes])


def _tunnels(inside: Flags, grid_s: FloatArray) -> tuple[SkySpan, ...]:
    edges = np.flatnonzero(np.diff(np.concatenate([[False], inside, [False]]).astype(np.int8)))
    last = grid_s.size - 1
    return tuple(
        SkySpan(Sky.TUNNEL, float(grid_s[start]), float(grid_s[min(end, last)]))
        for start, end in zip(edges[::2], edges[1::2], strict=True)
    )
