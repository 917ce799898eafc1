"""PAYD, how much: expected claims of a year by annual distance and by the hours that it is driven at."""

from __future__ import annotations

import math
from typing import Final

from core.driving.exposure import Facet as Exposed
from core.scoring.credibility import Estimate, Shrunk
from core.scoring.facets import Facet, facet_part, known_share
from core.scoring.model import ScoreModel
from core.scoring.record import Record
from core.scoring.score import Basis, Contribution, Part, Product, Score, checked_days, evidence_of, nothing_driven

DAYS_PER_YEAR: Final = 365.25


def payd(record: Record, days: float, model: ScoreModel) -> Score:
    """PAYD score of a period of so many days, driven or not.

    The distance a year is believed as far as the days observed tell it (``Shrunk``: a day's distance varies), the mean
    relativity over the hours as far as the distance tells it; both factors multiply. It is all that counts of time:
    PHYD has no night.

    Raises
    ------
    InvalidInputError
        If the period is none, or the record is of more days than it has.
    """
    days = checked_days(record, days)
    hours = record.exposure.by.get(Exposed.HOUR, {})
    if reason := nothing_driven(record):
        return Basis(Product.PAYD, record, days, model).unscored(reason)
    coverage = {"hour": known_share(hours, model.hour.relativity, record.exposure.total.distance_mm)}
    basis = Basis(Product.PAYD, record, days, model, coverage=coverage)
    facet = Facet(
        name="hour",
        label="hours",
        relativity=model.hour.relativity,
        sd={},
        share=model.hour.share,
        group=model.hour.groups.__getitem__,
        named=lambda hours: (hours, hours),
        shape=model.hour.shape,
        count_km=model.hour.count_km,
        told=len(model.hour.relativity),
    )
    return basis.scored([_mileage(record, days, model), facet_part(facet, hours, record)])


def _mileage(record: Record, days: float, model: ScoreModel) -> Part:
    mileage = model.mileage
    usual_km = mileage.annual_km * days / DAYS_PER_YEAR
    km = record.distance_m * 1e-3
    shrunk = Shrunk(mileage.shape, km / mileage.count_km, usual_km / mileage.count_km)
    annual = Estimate(*(mileage.annual_km * relative for relative in shrunk.estimate))
    ln = Estimate(*(math.log(mileage.relativity(one)) for one in annual))
    contribution = Contribution(
        "mileage",
        "distance",
        0.0,
        value=km * DAYS_PER_YEAR / days,
        counted=annual.value,
        portfolio=mileage.annual_km,
        unit="km/year",
        evidence=evidence_of(record, "mileage"),
    )
    far = math.log(mileage.relativity(mileage.annual_km * (1.0 + mileage.shape**-0.5)))
    return Part(ln, [(contribution, ln.value)], far * far, shrunk.credibility)
