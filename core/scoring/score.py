"""A score and what it is made of: pieces of ln relativity become points that sum to it exactly."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from enum import StrEnum
from typing import Any, Final

from core.errors import InvalidInputError
from core.scoring.credibility import Estimate, summed
from core.scoring.model import ScoreModel
from core.scoring.record import Evidence, Record

LOWEST, HIGHEST = 0.0, 100.0
GRAIN: Final = 2.0**-16
"""Points are whole multiples of this, 0.000015, so that they sum exactly in any order."""
LONGEST_DAYS: Final = 36_600.0


class Product(StrEnum):
    """What is priced: how much, how, where."""

    PAYD = "payd"
    PHYD = "phyd"
    PWYD = "pwyd"


@dataclass(frozen=True, slots=True)
class Contribution:
    """What one thing adds to a score.

    Parameters
    ----------
    name : key, such as ``braking``, ``night``, ``road_class:motorway``; ``base`` and ``limit`` are no driver's doing
    label : for people
    points : multiple of ``GRAIN``; below 0 it costs
    relativity : factor of the expected claims that it makes; 1 of base and limit
    value : as driven, in ``unit``; None where it is not known; a share is of what is known
    counted : as it counts, after credibility and cap
    portfolio : the portfolio's
    count : of manoeuvres and the like; None where nothing is counted
    evidence : heaviest first
    """

    name: str
    label: str
    points: float
    relativity: float = 1.0
    value: float | None = None
    counted: float | None = None
    portfolio: float | None = None
    unit: str = ""
    count: int | None = None
    evidence: tuple[Evidence, ...] = ()


@dataclass(frozen=True, slots=True)
class Score:
    """A product's score of a period; where there is nothing to go by, ``score`` is None and ``reason`` says why.

    Parameters
    ----------
    score : 0 to 100, the sum of the contributions' points, exactly
    relativity : expected claims over the portfolio's
    interval95, relativity_interval95 : of what is not known of the driver, as the model has it; they hold the value
    credibility : 0 to 1: how far this is the driver's own, and not the portfolio's
    coverage : by input, 0 to 1: how far it was known
    """

    product: Product
    score: float | None
    interval95: tuple[float, float] | None
    relativity: float | None
    relativity_interval95: tuple[float, float] | None
    credibility: float
    contributions: tuple[Contribution, ...]
    coverage: Mapping[str, float]
    days: float
    distance_m: float
    trips: int
    model: str
    model_version: str
    model_sha256: str
    places_sha256: str | None = None
    reason: str | None = None

    def to_json(self) -> dict[str, Any]:
        """As plain numbers, lists and maps."""
        told = asdict(self) | {"product": self.product.value, "coverage": dict(self.coverage)}
        told["contributions"] = [
            asdict(one) | {"evidence": [piece._asdict() for piece in one.evidence]} for one in self.contributions
        ]
        return told


@dataclass(frozen=True, slots=True)
class Part:
    """One piece of ln relativity, and the contributions that make it up.

    Parameters
    ----------
    ln : with its interval
    shares : contributions without points, each with its share of ``ln.value``
    prior_var : how much this piece differs between drivers, of ln: its weight in the credibility of the whole
    """

    ln: Estimate
    shares: Sequence[tuple[Contribution, float]]
    prior_var: float
    credibility: float


@dataclass(frozen=True, slots=True)
class Basis:
    """What a score is of."""

    product: Product
    record: Record
    days: float
    model: ScoreModel
    places_sha256: str | None = None
    coverage: Mapping[str, float] = field(default_factory=dict)

    def scored(self, parts: Sequence[Part], correlation: float = 0.0) -> Score:
        """The score of these parts, whose errors have this correlation with one another."""
        scale = self.model.scale
        ln = summed((part.ln for part in parts), correlation)
        made = [Contribution("base", "portfolio's mean driver", _grained(scale.base))]
        for part in parts:
            for share, share_ln in part.shares:
                points = _grained(scale.points(share_ln))
                made.append(replace(share, points=points, relativity=math.exp(share_ln)))
        raw = math.fsum(one.points for one in made)
        score = min(max(raw, LOWEST), HIGHEST)
        if score != raw:
            made.append(Contribution("limit", "no score is below 0 or above 100", score - raw))
        ends = (_grained(scale.base + scale.points(end)) for end in (ln.high, ln.low))
        low, high = (min(max(end, LOWEST), HIGHEST) for end in ends)
        between = math.fsum(part.prior_var for part in parts)
        known = math.fsum(part.prior_var * part.credibility for part in parts)
        return self._score(
            score=score,
            # Points are rounded one by one, so that the ends, rounded once, may miss the score by some grains.
            interval95=(min(low, score), max(high, score)),
            relativity=math.exp(ln.value),
            relativity_interval95=(math.exp(ln.low), math.exp(ln.high)),
            credibility=known / between if between > 0.0 else 0.0,
            contributions=tuple(made),
            reason=None,
        )

    def unscored(self, reason: str) -> Score:
        """No score, and why."""
        return self._score(
            score=None,
            interval95=None,
            relativity=None,
            relativity_interval95=None,
            credibility=0.0,
            contributions=(),
            reason=reason,
        )

    def _score(self, **figures: Any) -> Score:
        return Score(
            product=self.product,
            coverage=self.coverage,
            days=self.days,
            distance_m=self.record.distance_m,
            trips=self.record.trips,
            model=self.model.name,
            model_version=self.model.version,
            model_sha256=self.model.sha256,
            places_sha256=self.places_sha256,
            **figures,
        )


def checked_days(record: Record, days: float) -> float:
    """The period in days; raises InvalidInputError where it is none, or shorter than the days that were driven on."""
    if not 0.0 < days <= LONGEST_DAYS:
        raise InvalidInputError(f"a period of {days!r} days: expected more than 0, to {LONGEST_DAYS:.0f}")
    if record.days > math.ceil(days) + 1:
        raise InvalidInputError(
            f"driven on {record.days} days of a period of {days:g}: expected a period that holds them"
        )
    if record.exposure.total.distance_mm < 0 or record.exposure.total.time_ms < 0:
        raise InvalidInputError("a record of less than nothing: expected distance and time of 0 or more")
    return float(days)


def nothing_driven(record: Record) -> str | None:
    """Why there is nothing to go by, where nothing was driven."""
    if record.distance_m > 0.0:
        return None
    return "nothing was driven" if not record.trips else f"no distance in {record.trips} trips"


def evidence_of(record: Record, about: str) -> tuple[Evidence, ...]:
    """What a record keeps about something."""
    return tuple(record.evidence.get(about, ()))


def _grained(points: float) -> float:
    return round(points / GRAIN) * GRAIN
