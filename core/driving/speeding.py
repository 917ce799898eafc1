"""Speeding: how much of a drive was above the limit, by how much and for how long, as far as limits are known."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from core.errors import InvalidInputError
from core.measurements import FloatArray, TimeArray
from core.tunables import Tunables, tunable

HIGHEST_LIMIT_MPS: Final = 300.0 / 3.6
"""No road has a higher one; 999 and the like stand for none or unknown."""


@dataclass(frozen=True, slots=True)
class SpeedingThresholds(Tunables):
    """What counts as above a limit."""

    tolerance_mps: float = tunable(
        5.0 / 3.6, unit="m/s", low=0.0, high=20.0, source="MR at +5 km/h in towns (SOURCES); below it is no episode"
    )
    least_s: float = tunable(
        3.0, unit="s", low=0.0, high=600.0, source="choice: shorter is a downhill, or a limit that ends"
    )
    merge_s: float = tunable(
        3.0, unit="s", low=0.0, high=600.0, source="choice: below the tolerance for less goes on as the same episode"
    )
    moving_mps: float = tunable(
        1.0, unit="m/s", low=0.0, high=10.0, source="as a trip's moving_mps; standing has no share"
    )
    gap_s: float = tunable(
        2.0, unit="s", low=0.1, high=60.0, source="choice: a row stands for no longer; rows come every 0.1 to 1 s"
    )


@dataclass(frozen=True, slots=True)
class SpeedingEpisode:
    """A span above limit and tolerance; excess is over the limit, certainty the limit's, by time."""

    start_t_ns: int
    end_t_ns: int
    duration_s: float
    distance_m: float
    mean_excess_mps: float
    max_excess_mps: float
    limit_mps: float
    certainty: float


@dataclass(frozen=True, slots=True)
class Speeding:
    """What a drive's rows say; times and distances are of moving and add up across drives.

    Parameters
    ----------
    known_s, unknown_s : with and without a limit; a limit of 0 or above 300 km/h is none
    over_s, over_m : above the limit and the tolerance; ``certain_over_s`` of it weighed by certainty
    certain_s : known time weighed by certainty
    excess_m : integral of the excess over time, m: what was driven beyond the limit
    """

    known_s: float = 0.0
    unknown_s: float = 0.0
    known_m: float = 0.0
    unknown_m: float = 0.0
    over_s: float = 0.0
    over_m: float = 0.0
    certain_s: float = 0.0
    certain_over_s: float = 0.0
    excess_m: float = 0.0
    max_excess_mps: float = 0.0
    episodes: tuple[SpeedingEpisode, ...] = ()

    @property
    def share(self) -> float:
        """Share of the time with a known limit that is above it; NaN where none is known."""
        return self.over_s / self.known_s if self.known_s > 0.0 else math.nan

    @property
    def certain_share(self) -> float:
        """The same, each row weighed by its limit's certainty."""
        return self.certain_over_s / self.certain_s if self.certain_s > 0.0 else math.nan

    @property
    def unknown_share(self) -> float:
        """Share of the moving time without a known limit; NaN where nothing moved."""
        moving_s = self.known_s + self.unknown_s
        return self.unknown_s / moving_s if moving_s > 0.0 else math.nan

    @property
    def mean_excess_mps(self) -> float:
        """Mean excess while above; NaN where never."""
        return self.excess_m / self.over_s if self.over_s > 0.0 else math.nan

    def __add__(self, other: Speeding) -> Speeding:
        return Speeding(
            self.known_s + other.known_s,
            self.unknown_s + other.unknown_s,
            self.known_m + other.known_m,
            self.unknown_m + other.unknown_m,
            self.over_s + other.over_s,
            self.over_m + other.over_m,
            self.certain_s + other.certain_s,
            self.certain_over_s + other.certain_over_s,
            self.excess_m + other.excess_m,
            max(self.max_excess_mps, other.max_excess_mps),
            self.episodes + other.episodes,
        )


def speeding(
    t_ns: TimeArray,
    speed_mps: FloatArray,
    limit_mps: FloatArray,
    certainty: FloatArray,
    thresholds: SpeedingThresholds | None = None,
) -> Speeding:
    """Judge a drive's rows (n,), in time order, each of which stands for the time until the next.

    Parameters
    ----------
    speed_mps : NaN where unknown: such rows count for nothing
    limit_mps : NaN where unknown
    certainty : 0 to 1, of the limit: 1 signed, less where it is assumed from the road's class

    Raises
    ------
    InvalidInputError
        If the lengths differ, times do not increase, or a certainty is outside 0 to 1 where there is a limit.
    """
    limits = thresholds or SpeedingThresholds()
    count = t_ns.size
    if not count == speed_mps.size == limit_mps.size == certainty.size:
        raise InvalidInputError(
            f"{count} times, {speed_mps.size} speeds, {limit_mps.size} limits, {certainty.size} certainties; "
            "expected as many of each"
        )
    if count and not (np.diff(t_ns) > 0).all():
        raise InvalidInputError("times do not increase; expected rows in the order of time, each once")
    known = np.isfinite(limit_mps) & (limit_mps > 0.0) & (limit_mps <= HIGHEST_LIMIT_MPS)
    if not ((certainty[known] >= 0.0) & (certainty[known] <= 1.0)).all():
        raise InvalidInputError("a certainty is not from 0 to 1; expected 1 for a limit that is sure")
    until_next = np.append(np.diff(t_ns) * 1e-9, 0.0)
    dt_s = np.where(until_next <= limits.gap_s, until_next, 0.0)
    moving = np.isfinite(speed_mps) & (speed_mps >= limits.moving_mps)
    excess = np.where(known & moving, speed_mps - limit_mps, -np.inf)
    over = excess > limits.tolerance_mps
    sure = np.where(known, certainty, 0.0)

    def total(rows: npt.NDArray[np.bool_], weight: FloatArray) -> float:
        return math.fsum((weight[rows] * dt_s[rows]).tolist())

    ones, heard = np.ones(count), moving & known
    return Speeding(
        known_s=total(heard, ones),
        unknown_s=total(moving & ~known, ones),
        known_m=total(heard, speed_mps),
        unknown_m=total(moving & ~known, speed_mps),
        over_s=total(over, ones),
        over_m=total(over, speed_mps),
        certain_s=total(heard, sure),
        certain_over_s=total(over, sure),
        excess_m=total(over, excess),
        max_excess_mps=float(excess[over].max()) if over.any() else 0.0,
        episodes=_episodes(t_ns, speed_mps, limit_mps, sure, excess, over, dt_s, known & moving, limits),
    )


def _episodes(
    t_ns: TimeArray,
    speed_mps: FloatArray,
    limit_mps: FloatArray,
    certainty: FloatArray,
    excess: FloatArray,
    over: npt.NDArray[np.bool_],
    dt_s: FloatArray,
    heard: npt.NDArray[np.bool_],
    limits: SpeedingThresholds,
) -> tuple[SpeedingEpisode, ...]:
    """Runs above the tolerance, joined across short ones below it where the limit stays known."""
    found: list[SpeedingEpisode] = []
    runs: list[list[int]] = []
    for row in np.flatnonzero(over).tolist():
        if runs:
            last = runs[-1][1]
            between = (int(t_ns[row]) - int(t_ns[last])) * 1e-9 - dt_s[last]
            bridged = between <= limits.merge_s and bool((heard[last:row] & (dt_s[last:row] > 0.0)).all())
            if (row == last + 1 and dt_s[last] > 0.0) or bridged:
                runs[-1][1] = row
                continue
        runs.append([row, row])
    for first, last in runs:
        rows = slice(first, last + 1)
        duration_s = math.fsum(dt_s[rows].tolist())
        if duration_s < limits.least_s or duration_s <= 0.0:
            continue
        weight = dt_s[rows] / duration_s
        worst = first + int(np.argmax(excess[rows]))
        found.append(
            SpeedingEpisode(
                start_t_ns=int(t_ns[first]),
                end_t_ns=int(t_ns[last]) + round(1e9 * float(dt_s[last])),
                duration_s=duration_s,
                distance_m=math.fsum((speed_mps[rows] * dt_s[rows]).tolist()),
                mean_excess_mps=math.fsum((excess[rows] * weight).tolist()),
                max_excess_mps=float(excess[worst]),
                limit_mps=float(limit_mps[worst]),
                certainty=math.fsum((certainty[rows] * weight).tolist()),
            )
        )
    return tuple(found)
