"""A model with a portfolio's own values in place of the shipped choices: what others do, and how much they differ."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

from core.driving.exposure import Driven
from core.driving.exposure import Facet as Exposed
from core.errors import InvalidInputError
from core.scoring.credibility import shape_by_moments
from core.scoring.facets import known_share
from core.scoring.model import FacetRisk, ScoreModel, score_model_of
from core.scoring.payd import DAYS_PER_YEAR
from core.scoring.phyd import mean_excess_kmh, mean_risk
from core.scoring.record import BeliefSums, Record, total
from core.scoring.score import checked_days

FEWEST: Final = 2
Counted = Callable[[Record], tuple[float, float]]
"""Count of a record, and what the portfolio's mean driver has of it."""


def fitted(document: Mapping[str, Any], drivers: Sequence[tuple[Record, float]]) -> dict[str, Any]:
    """The document of a model, with the portfolio values of these drivers' records, each of a period of so many days.

    Annual distance, rates, speeding, risk, shares of hours and of roads are the drivers' together; spreads are by
    moments (``shape_by_moments``). Weights, rates of hours and roads, caps, dispersions and what tells as much as a
    count stay, and so do values of what no record knows. A value is kept within the range that stands with it.

    Raises
    ------
    InvalidInputError
        If fewer than two drove, a period is none, or what comes out is no model (a rate beyond its cap, …).
    """
    driven = [(record, checked_days(record, days)) for record, days in drivers if record.distance_m > 0.0]
    if len(driven) < FEWEST:
        raise InvalidInputError(f"{len(driven)} drivers with a distance: expected {FEWEST} or more")
    made = copy.deepcopy(dict(document))
    model = score_model_of(made)
    whole = total(record for record, _ in driven)
    days = math.fsum(one for _, one in driven)
    source = f"fitted: {len(driven)} drivers, {whole.distance_m * 1e-3:.0f} km"
    made["version"] = f"{model.version}+fitted"
    _set_means(made, model, whole, days, source)
    _set_spreads(made, score_model_of(made), driven, source)
    score_model_of(made)
    return made


def _set_means(made: dict[str, Any], model: ScoreModel, whole: Record, days: float, source: str) -> None:
    km, speeding = whole.distance_m * 1e-3, whole.speeding
    _set(made["payd"]["mileage"]["annual_km"], km * DAYS_PER_YEAR / days, source)
    for kind in model.manoeuvres:
        _set(made["phyd"][kind]["rate"], 100.0 * whole.manoeuvres.get(kind, 0) / km, source)
    excess_kmh = mean_excess_kmh(speeding)
    if speeding.certain_ms and excess_kmh is not None:
        _set(made["phyd"]["speeding"]["share"], speeding.certain_over_ms / speeding.certain_ms, source)
        _set(made["phyd"]["speeding"]["excess_kmh"], excess_kmh, source)
    risk, _ = mean_risk(whole.belief.get(model.entity, BeliefSums()))
    if risk is not None:
        _set(made["phyd"]["vehicle"]["risk"], risk, source)
    _set_shares(made["payd"]["hour"], model.hour, whole.exposure.by.get(Exposed.HOUR, {}), source)
    _set_shares(made["pwyd"]["road_class"], model.road_class, whole.exposure.by.get(Exposed.ROAD_CLASS, {}), source)


def _set_spreads(made: dict[str, Any], model: ScoreModel, driven: Sequence[tuple[Record, float]], source: str) -> None:
    def spread(place: dict[str, Any], counted: Counted) -> None:
        pairs = [counted(record) for record, _ in driven]
        if any(expected > 0.0 for _, expected in pairs):
            shape = shape_by_moments([count for count, _ in pairs], [expected for _, expected in pairs])
            _set(place["spread"], shape**-0.5, source)

    mileage = model.mileage
    distances = [record.distance_m * 1e-3 / mileage.count_km for record, _ in driven]
    usual = [mileage.annual_km * days / DAYS_PER_YEAR / mileage.count_km for _, days in driven]
    _set(made["payd"]["mileage"]["spread"], shape_by_moments(distances, usual) ** -0.5, source)
    for kind, one in model.manoeuvres.items():
        spread(
            made["phyd"][kind],
            lambda record, kind=kind, one=one: (  # type: ignore[misc]
                record.manoeuvres.get(kind, 0) / one.dispersion,
                record.distance_m * 1e-3 / one.exposure,
            ),
        )
    spread(made["payd"]["hour"], lambda record: _facet_count(record, model.hour, Exposed.HOUR))
    spread(made["pwyd"]["road_class"], lambda record: _facet_count(record, model.road_class, Exposed.ROAD_CLASS))
    spread(made["phyd"]["speeding"], lambda record: _speeding_count(record, model))
    spread(made["phyd"]["vehicle"], lambda record: _vehicle_count(record, model))


def _speeding_count(record: Record, model: ScoreModel) -> tuple[float, float]:
    speeding, regressor = record.speeding, model.speeding
    hours = speeding.certain_ms / 3.6e6 / regressor.exposure
    excess_kmh = mean_excess_kmh(speeding)
    if not speeding.certain_ms or excess_kmh is None:
        return 0.0, hours
    return hours * speeding.certain_over_ms / speeding.certain_ms * excess_kmh / regressor.portfolio, hours


def _vehicle_count(record: Record, model: ScoreModel) -> tuple[float, float]:
    risk, known = mean_risk(record.belief.get(model.entity, BeliefSums()))
    expected = known * record.distance_m * 1e-3 / model.vehicle.exposure
    return expected * (risk or 0.0) / model.vehicle.portfolio, expected


def _facet_count(record: Record, risk: FacetRisk, facet: Exposed) -> tuple[float, float]:
    labels = record.exposure.by.get(facet, {})
    known = {label: driven for label, driven in sorted(labels.items()) if label in risk.relativity}
    expected = known_share(labels, risk.relativity, record.exposure.total.distance_mm)
    expected *= record.distance_m * 1e-3 / risk.count_km
    known_mm = sum(driven.distance_mm for driven in known.values())
    if not known_mm:
        return 0.0, 0.0
    mean = math.fsum(risk.relativity[label] * driven.distance_mm for label, driven in known.items()) / known_mm
    return expected * mean, expected


def _set_shares(section: dict[str, Any], risk: FacetRisk, exposed: Mapping[str, Driven], source: str) -> None:
    known_mm = sum(driven.distance_mm for label, driven in exposed.items() if label in risk.share)
    if not known_mm:
        return
    for label, told in section["labels"].items():
        told[1] = exposed.get(label, Driven()).distance_mm / known_mm
    section["source"] = f"{section['source']}; shares {source}"


def _set(number: dict[str, Any], value: float, source: str) -> None:
    low, high = number["range"]
    number["value"] = min(max(value, low), high)
    number["source"] = source
    number.pop("memory", None)
