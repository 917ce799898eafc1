"""Scores as callers see them: for a key that may not know places, cells are told together."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

import numpy as np

from core.risk.belief import named
from core.scoring.explaining import sentence
from core.scoring.premium import Quote
from core.scoring.record import Record, together
from core.scoring.score import Contribution, Product, Score
from schemas.scores import (
    DrivenRecord,
    EvidencePiece,
    ModelUsed,
    PremiumQuote,
    ProductScore,
    QuotedScore,
    QuoteStep,
    ScoreContribution,
    ScorePeriod,
)
from service.rating.period import Period
from service.rating.scoring import Scored

_CELL: Final = "cell:"
PLACES: Final = "places"


def shown(vehicle_id: str, scored: Scored, product: Product, *, places: bool) -> ProductScore:
    """A product's score; without ``places`` it names no cell."""
    score = scored.scores[product]
    made = score.contributions if places else _without_cells(score)
    return ProductScore(
        product=product.value,
        vehicle_id=vehicle_id,
        period=_period(scored.period),
        score=score.score,
        interval95=score.interval95,
        relativity=score.relativity,
        relativity_interval95=score.relativity_interval95,
        credibility=score.credibility,
        contributions=[_contribution(one, score) for one in made],
        coverage=dict(score.coverage),
        belief=_belief(scored) if product is Product.PHYD else None,
        distance_m=score.distance_m,
        trips=score.trips,
        model=_model(score),
        reason=score.reason,
    )


def quoted(vehicle_id: str, scored: Scored, premium: Quote) -> PremiumQuote:
    """A quote, with the scores that it went by."""
    scores = {
        product.value: QuotedScore(
            score=one.score,
            relativity=one.relativity,
            relativity_interval95=one.relativity_interval95,
            reason=one.reason,
        )
        for product, one in scored.scores.items()
    }
    told = premium.to_json()
    return PremiumQuote(
        **told | {"steps": [QuoteStep(**step) for step in told["steps"]]},
        vehicle_id=vehicle_id,
        period=_period(scored.period),
        scores=scores,
        model=_model(scored.scores[Product.PWYD]),
    )


def told_record(vehicle_id: str, period: Period, record: Record, *, cells: bool) -> DrivenRecord:
    """A record of a period."""
    return DrivenRecord(
        vehicle_id=vehicle_id, period=_period(period), days=period.length_days, record=record.to_json(cells=cells)
    )


def _model(score: Score) -> ModelUsed:
    return ModelUsed(
        name=score.model,
        version=score.model_version,
        sha256=score.model_sha256,
        places_sha256=score.places_sha256,
    )


def _contribution(one: Contribution, score: Score) -> ScoreContribution:
    return ScoreContribution(
        name=one.name,
        label=one.label,
        sentence=sentence(one, score),
        points=one.points,
        relativity=one.relativity,
        value=one.value,
        counted=one.counted,
        portfolio=one.portfolio,
        unit=one.unit,
        count=one.count,
        evidence=[EvidencePiece(kind=piece.kind, id=piece.id) for piece in one.evidence],
    )


def _without_cells(score: Score) -> tuple[Contribution, ...]:
    """The contributions, those of single cells added up: points are whole grains, so the sum stays what it is."""
    cells = [one for one in score.contributions if one.name.startswith(_CELL)]
    if not cells:
        return score.contributions
    known = [one.value for one in cells if one.value is not None]
    as_one = replace(
        cells[0],
        name=PLACES,
        label="the neighbourhoods driven in",
        points=math.fsum(one.points for one in cells),
        relativity=math.prod(one.relativity for one in cells),
        value=math.fsum(known) if known else None,
        counted=None,
        portfolio=None,
        evidence=together(piece for one in cells for piece in one.evidence),
    )
    first = score.contributions.index(cells[0])
    others = [one for one in score.contributions if not one.name.startswith(_CELL)]
    return (*others[:first], as_one, *others[first:])


def _belief(scored: Scored) -> dict[str, dict[str, float]]:
    means = {name: sums.mean() for name, sums in sorted(scored.record.belief.items())}
    return {name: named(np.array(mean)) for name, mean in means.items() if mean is not None}


def _period(period: Period) -> ScorePeriod:
    observed = period.observed_ns or (None, None)
    return ScorePeriod(
        start_at=period.from_ns,
        end_at=period.to_ns,
        observed_from=observed[0],
        observed_to=observed[1],
        days=period.days,
        time_zone=period.zone,
    )
