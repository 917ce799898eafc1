"""PHYD, how: log-linear relativities of manoeuvres per 100 km, of speeding, and of how near to limits one drives."""

from __future__ import annotations

import math
from typing import Final

from core.driving.speeding import HIGHEST_LIMIT_MPS
from core.risk.belief import EMPTY, HR, LR, MR, THETA
from core.scoring.credibility import Estimate, Shrunk
from core.scoring.model import Regressor, ScoreModel
from core.scoring.record import BeliefSums, Record, SpeedingSums
from core.scoring.score import Basis, Contribution, Part, Product, Score, checked_days, evidence_of, nothing_driven

_KMH: Final = 3.6
LABELS: Final = {
    "braking": "harsh braking",
    "acceleration": "harsh acceleration",
    "cornering": "harsh cornering",
    "lane_change": "aggressive change of lane",
    "speeding_share": "time above the limit",
    "speeding_excess": "excess over the limit",
    "vehicle": "driving near the limits",
}
_RISK: Final = {MR: 0.5, HR: 1.0, LR | MR: 0.25, MR | HR: 0.75, LR | HR: 0.5}
"""Pignistic probability of high risk plus half of that of medium risk, of a mass all on one proposition."""


def phyd(record: Record, days: float, model: ScoreModel) -> Score:
    """PHYD score of a period.

    What is excused counts nothing, and of a thing that is not known (limits without a map) the portfolio's mean counts,
    with its spread between drivers in the interval. Night and places are not here: PAYD and PWYD have them. Accidents
    of the vehicle itself do not enter, as nobody says whose fault they were.

    Raises
    ------
    InvalidInputError
        If the period is none, or the record is of more days than it has.
    """
    days = checked_days(record, days)
    if reason := nothing_driven(record):
        return Basis(Product.PHYD, record, days, model).unscored(reason)
    speeding = record.speeding
    moving_ms = speeding.known_ms + speeding.unknown_ms
    risk, known = mean_risk(record.belief.get(model.entity, BeliefSums()))
    coverage = {
        "limits": speeding.known_ms / moving_ms if moving_ms else 0.0,
        "limits_certain": speeding.certain_ms / moving_ms if moving_ms else 0.0,
        model.entity: known,
    }
    parts = [_manoeuvre(record, kind, model.manoeuvres[kind]) for kind in model.manoeuvres]
    parts += [_speeding(record, model), _vehicle(record, model, risk, known)]
    return Basis(Product.PHYD, record, days, model, coverage=coverage).scored(parts, model.correlation)


def mean_risk(belief: BeliefSums) -> tuple[float | None, float]:
    """Mean risk from 0 to 1 by the masses that say something, and their share; Theta says nothing, and no risk."""
    mass = belief.mean()
    if mass is None:
        return None, 0.0
    known = math.fsum(mass[one] for one in range(len(mass)) if one not in (EMPTY, THETA))
    if known <= 0.0:
        return None, 0.0
    return math.fsum(_RISK[one] * mass[one] for one in _RISK) / known, min(known, 1.0)


def mean_excess_kmh(speeding: SpeedingSums) -> float | None:
    """Mean excess while above, no more than cars can do; None where never above."""
    if not speeding.over_ms:
        return None
    return _KMH * min(speeding.excess_mm / speeding.over_ms, HIGHEST_LIMIT_MPS)


def _manoeuvre(record: Record, kind: str, regressor: Regressor) -> Part:
    count, km = record.manoeuvres.get(kind, 0), record.distance_m * 1e-3
    shrunk = Shrunk(regressor.shape, count / regressor.dispersion, km / regressor.exposure)
    contribution = Contribution(
        kind,
        LABELS[kind],
        0.0,
        value=100.0 * count / km,
        counted=_counted(regressor, shrunk),
        portfolio=regressor.portfolio,
        unit="1/(100 km)",
        count=count,
        evidence=evidence_of(record, kind),
    )
    ln = _ln(regressor, shrunk)
    return _part(regressor, shrunk, ln, [(contribution, ln.value)])


def _speeding(record: Record, model: ScoreModel) -> Part:
    """Share of the time above, times mean excess then: counts once, as their product, and is told as both.

    ``certain`` weighs each instant by how sure its limit is. The product's change is split over both factors in equal
    parts of what they change together: s e - s0 e0 = (s - s0) (e + e0) / 2 + (e - e0) (s + s0) / 2.
    """
    regressor, speeding = model.speeding, record.speeding
    share = speeding.certain_over_ms / speeding.certain_ms if speeding.certain_ms else None
    excess_kmh = mean_excess_kmh(speeding)
    hours = speeding.certain_ms / 3.6e6 / regressor.exposure
    observed = (share or 0.0) * (excess_kmh or 0.0) / regressor.portfolio
    shrunk = Shrunk(regressor.shape, hours * observed, hours)
    usual_share = model.speeding_share
    usual_excess = regressor.portfolio / usual_share
    own_share = usual_share * Shrunk(regressor.shape, hours * (share or 0.0) / usual_share, hours).mean
    ln = _ln(regressor, shrunk)
    counted = _counted(regressor, shrunk)
    own_excess = counted / own_share
    ln_share = regressor.weight * (own_share - usual_share) * 0.5 * (own_excess + usual_excess)
    evidence = evidence_of(record, "speeding")
    return _part(
        regressor,
        shrunk,
        ln,
        [
            (
                Contribution(
                    "speeding_share",
                    LABELS["speeding_share"],
                    0.0,
                    value=share,
                    counted=own_share,
                    portfolio=usual_share,
                    unit="1",
                    count=speeding.episodes,
                    evidence=evidence,
                ),
                ln_share,
            ),
            (
                Contribution(
                    "speeding_excess",
                    LABELS["speeding_excess"],
                    0.0,
                    value=excess_kmh if share else None,
                    counted=own_excess,
                    portfolio=usual_excess,
                    unit="km/h",
                    evidence=evidence,
                ),
                ln.value - ln_share,
            ),
        ],
    )


def _vehicle(record: Record, model: ScoreModel, risk: float | None, known: float) -> Part:
    regressor = model.vehicle
    expected = known * record.distance_m * 1e-3 / regressor.exposure
    shrunk = Shrunk(regressor.shape, expected * (risk or 0.0) / regressor.portfolio, expected)
    ln = _ln(regressor, shrunk)
    contribution = Contribution(
        "vehicle",
        LABELS["vehicle"],
        0.0,
        value=risk,
        counted=_counted(regressor, shrunk),
        portfolio=regressor.portfolio,
        unit="1",
        evidence=evidence_of(record, "vehicle"),
    )
    return _part(regressor, shrunk, ln, [(contribution, ln.value)])


def _counted(regressor: Regressor, shrunk: Shrunk) -> float:
    return min(shrunk.mean * regressor.portfolio, regressor.cap)


def _ln(regressor: Regressor, shrunk: Shrunk) -> Estimate:
    return Estimate(*(regressor.ln(relative) for relative in shrunk.estimate))


def _part(regressor: Regressor, shrunk: Shrunk, ln: Estimate, shares: list[tuple[Contribution, float]]) -> Part:
    prior_var = (regressor.weight * regressor.portfolio) ** 2 / regressor.shape
    return Part(ln, shares, prior_var, shrunk.credibility)
