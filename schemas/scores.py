"""Scores as insurers and drivers read them: the figure, how sure it is, what it is made of, and what that rests on."""

from __future__ import annotations

from typing import Any

from pydantic import Field

from schemas.model import Model, VehicleId
from schemas.times import Time

Interval = tuple[float, float]
Masses = dict[str, float]


class EvidencePiece(Model):
    """What a figure rests on, to be looked at."""

    kind: str = Field(description="trip, manoeuvre or accident")
    id: str = Field(description="As in GET /v1/trips/{id}, GET /v1/trips/{id}/manoeuvres, GET /v1/accidents/{id}")


class ScoreContribution(Model):
    """What one thing adds to a score."""

    name: str = Field(description="base, limit, mileage, night, braking, speeding_share, road_class:motorway, …")
    label: str
    sentence: str = Field(description="The same for a driver to read.")
    points: float = Field(description="The points of all contributions sum to the score exactly.")
    relativity: float = Field(description="Factor of the expected claims that it makes.")
    value: float | None = Field(description="As driven, in the unit; null where it is not known.")
    counted: float | None = Field(description="As it counts, after credibility and cap.")
    portfolio: float | None = Field(description="The portfolio's mean.")
    unit: str
    count: int | None = Field(description="Of manoeuvres and the like.")
    evidence: list[EvidencePiece] = Field(description="What weighs most, first.")


class ScorePeriod(Model):
    """What was asked for, and how much of it was observed."""

    start_at: Time
    end_at: Time = Field(description="Trips count that began before it.")
    observed_from: Time | None = Field(
        description="The day of the vehicle's first trip, if that is later. Null without one."
    )
    observed_to: Time | None = Field(description="The end of today, if that is earlier.")
    days: float = Field(description="Observed, to which distance is related.")
    time_zone: str = Field(description="By which days begin.")


class ModelUsed(Model):
    """What a score went by."""

    name: str
    version: str
    sha256: str
    places_sha256: str | None = Field(description="Of the risk of cells; null where there is none.")


class ProductScore(Model):
    """How good one of the three products has it."""

    product: str = Field(description="payd: how much was driven; phyd: how; pwyd: where")
    vehicle_id: VehicleId
    period: ScorePeriod
    score: float | None = Field(description="0 to 100, higher is better; null where nothing was driven.")
    interval95: Interval | None = Field(description="Of what the score says of the driver.")
    relativity: float | None = Field(description="Expected claims over those of the portfolio's mean driver.")
    relativity_interval95: Interval | None
    credibility: float = Field(description="0 to 1: how far this is the driver's own record, not the portfolio's.")
    contributions: list[ScoreContribution]
    coverage: dict[str, float] = Field(description="By input, 0 to 1: how far it was known.")
    belief: dict[str, Masses] | None = Field(
        description="Mean masses by entity and fused, by proposition: low, medium, high risk. phyd alone."
    )
    distance_m: float
    trips: int
    model: ModelUsed
    reason: str | None = Field(description="Why there is no score.")


class ProductScores(Model):
    """All three products over one period."""

    vehicle_id: VehicleId
    scores: dict[str, ProductScore]


class DrivenRecord(Model):
    """What a vehicle drove in a period, as scores take it."""

    vehicle_id: VehicleId
    period: ScorePeriod
    days: float = Field(description="The period's length, to which distance is related.")
    record: dict[str, Any] = Field(
        description="Trips, days driven on; distance in mm and time in ms in all, by hour, light, weekday, month, road "
        "class and district, and by H3 cell; manoeuvres that count and that are excused; speeding; masses and coverage "
        "in units of 1e-9, summed over instants; accidents; evidence. What is nothing is left out."
    )


class QuoteStep(Model):
    """One step from the base to the premium; amounts are exact decimals."""

    name: str = Field(description="base, period, payd, phyd, pwyd, floor, cap or rounding")
    text: str
    factor: str | None = Field(description="By what it multiplies, where it does.")
    change: str = Field(description="What it adds; the changes of all steps sum to the premium exactly.")
    amount: str = Field(description="After it.")


class QuotedScore(Model):
    """The score that a quote went by."""

    score: float | None
    relativity: float | None
    relativity_interval95: Interval | None
    reason: str | None


class PremiumQuote(Model):
    """A premium for as many days as the period has, by what was driven in it."""

    vehicle_id: VehicleId
    period: ScorePeriod
    premium: str = Field(description="An exact decimal in the currency.")
    premium_minor: int = Field(description="In the currency's smallest unit.")
    currency: str = Field(description="ISO 4217")
    days: float = Field(description="That the premium is for.")
    steps: list[QuoteStep]
    scores: dict[str, QuotedScore]
    tariff: str
    tariff_version: str
    tariff_sha256: str
    model: ModelUsed
