"""The scores' figures over a simulated portfolio with known claim rates: a year is scored, the next year has claims."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from core.errors import InvalidInputError
from core.measurements import FloatArray
from core.scoring.model import Regressor, ScoreModel
from core.scoring.phyd import phyd
from core.scoring.places import Places, places_from, places_of
from core.scoring.products import scores
from core.scoring.record import Record
from core.scoring.score import Product, Score
from core.simulation.portfolio import MONTH_DAYS, Drivers, a_year, cell_names, drivers, long_run, others_accidents
from service.bench.score_statistics import (
    RESAMPLES,
    auc,
    calibration_slope,
    gini,
    interval95,
    percentiles,
    rank_correlation,
    reliability,
)
from service.bench.simulated_outages import Tell
from service.scoring.loading import shipped_model

DRIVERS: Final = 2000
FEWEST, MOST = 50, 100_000
SEED: Final = 20_261
YEAR_DAYS: Final = 365.0
PLACES_YEARS: Final = 20_000.0
"""Other driver-years that the relativities of cells are learnt from."""
LONG_YEARS: Final = 100.0
PERIODS: Final = (1, 3, 6, 12)
"""Months after which intervals and scores are looked at."""
_LOUD: Final = 3.0
_HARDLY: Final = 0.01
"""Of a Gamma so wide that the portfolio counts for nothing."""
_BLOCK: Final = 100
_TOGETHER: Final = "all"

IntArray = npt.NDArray[np.int64]
PhaseTell = Callable[[str, float, float], None]


@dataclass(frozen=True, slots=True, eq=False)
class Scored:
    """A portfolio with its year of months scored: ``by_period`` has scores of the first so many months, by driver."""

    portfolio: Drivers
    model: ScoreModel
    places: Places
    months: list[list[Record]]
    by_month: list[list[Mapping[Product, Score]]]
    by_period: Mapping[int, list[Mapping[Product, Score]]]
    year: list[Record]
    claims: IntArray


def simulated(count: int, tell: Tell, *, monthly: bool = True) -> Scored:
    """A portfolio, its records and scores, and the claims of the year after; raises InvalidInputError."""
    if not FEWEST <= count <= MOST:
        raise InvalidInputError(f"{count} drivers: expected {FEWEST} to {MOST}")
    generator = np.random.default_rng(SEED)
    model = shipped_model()
    portfolio = drivers(generator, count)
    places = places_from(*others_accidents(generator, portfolio, PLACES_YEARS))
    claims = portfolio.claims(generator)
    records = a_year(generator, portfolio)
    by_month: list[list[Mapping[Product, Score]]] = []
    by_period: dict[int, list[Mapping[Product, Score]]] = {months: [] for months in PERIODS}
    year = []
    for done, months in enumerate(records):
        if done % _BLOCK == 0:
            tell(done, count)
        sums = _running(months)
        year.append(sums[-1])
        if monthly:
            by_month.append([scores(one, days, model, places) for one, days in zip(months, MONTH_DAYS, strict=True)])
        for months_in in PERIODS if monthly else PERIODS[-1:]:
            days = float(sum(MONTH_DAYS[:months_in]))
            by_period[months_in].append(scores(sums[months_in - 1], days, model, places))
    return Scored(portfolio, model, places, records, by_month, by_period, year, claims)


def measure(count: int, tell: PhaseTell) -> dict[str, Any]:
    """Calibration, lift, stability, interval coverage, and what wrong models would show."""
    run = simulated(count, lambda done, total: tell("a year of drivers", done, total))
    generator = np.random.default_rng(SEED + 1)
    relativity = relativities(run.by_period[12])
    tell("intervals", 0, 1)
    long = long_run(run.portfolio, LONG_YEARS)
    true_places = _true_places(run.portfolio)
    truth = [scores(record, YEAR_DAYS * LONG_YEARS, run.model, true_places) for record in long]
    found: dict[str, Any] = {
        "drivers": count,
        "claims": int(run.claims.sum()),
        "model": {"name": run.model.name, "version": run.model.version, "sha256": run.model.sha256},
        "balance": {name: float(one.mean()) for name, one in relativity.items()},
        "lift": _lift(run, relativity, generator),
        "calibration": {name: _calibration(one, run, generator) for name, one in relativity.items()},
        "stability": _stability(run),
        "coverage": _coverage(run, truth),
        "wrong_models": _wrong(run, long, generator, tell),
    }
    return found


def relativities(scored: Sequence[Mapping[Product, Score]]) -> dict[str, FloatArray]:
    """By product, and all together as their product, (n,); who did not drive counts as the portfolio."""
    found = {product.value: _column(scored, product, lambda one: one.relativity, 1.0) for product in Product}
    return found | {_TOGETHER: reduce(np.multiply, found.values())}


def predicted_claims(relativity: FloatArray, claims: IntArray) -> FloatArray:
    """Claims by relativity, brought to the portfolio's number: an insurer sets the base rate by that."""
    return np.asarray(relativity * (claims.sum() / relativity.sum()))


def _relativity(score: Score) -> float:
    return 1.0 if score.relativity is None else score.relativity


def _column(
    scored: Sequence[Mapping[Product, Score]], product: Product, value: Callable[[Score], float | None], missing: float
) -> FloatArray:
    told = (value(one[product]) for one in scored)
    return np.array([missing if one is None else one for one in told])


def _running(months: Sequence[Record]) -> list[Record]:
    sums = [months[0]]
    for month in months[1:]:
        sums.append(sums[-1] + month)
    return sums


def _lift(run: Scored, relativity: Mapping[str, FloatArray], generator: np.random.Generator) -> dict[str, Any]:
    mileage = np.array([record.distance_m for record in run.year])
    orders = {"mileage": mileage, **relativity, "truth": run.portfolio.claims_per_year}
    n = len(mileage)
    rows = [generator.integers(0, n, n) for _ in range(RESAMPLES)]
    found = {}
    for name, order in orders.items():
        ginis = [gini(order[one], run.claims[one]) for one in rows]
        aucs = [auc(order[one], run.claims[one]) for one in rows]
        # The same resamples of both, so that what they have in common drops out.
        more = [gini(order[one], run.claims[one]) - gini(mileage[one], run.claims[one]) for one in rows]
        found[name] = {
            "gini": gini(order, run.claims),
            "gini_interval95": percentiles(ginis),
            "gini_of_true_rates": gini(order, run.portfolio.claims_per_year),
            "auc": auc(order, run.claims),
            "auc_interval95": percentiles(aucs),
            "gini_over_mileage": gini(order, run.claims) - gini(mileage, run.claims),
            "gini_over_mileage_interval95": percentiles(more),
        }
    return found


def _calibration(relativity: FloatArray, run: Scored, generator: np.random.Generator) -> dict[str, Any]:
    claims = run.claims
    predicted = predicted_claims(relativity, claims)
    rows = reliability(predicted, claims, run.portfolio.claims_per_year)
    return {
        "slope": calibration_slope(predicted, claims),
        "slope_interval95": interval95(
            generator, lambda rows: calibration_slope(predicted[rows], claims[rows]), len(claims)
        ),
        # Without the chance of claims: what the slope would be of very many of them.
        "slope_of_true_rates": calibration_slope(predicted, run.portfolio.claims_per_year),
        "deciles": rows,
        "deciles_inside": sum(row["inside"] for row in rows),
    }


def _stability(run: Scored) -> dict[str, Any]:
    found: dict[str, Any] = {}
    year = run.by_period[12]
    for product in Product:
        months = [
            _column([driver[m] for driver in run.by_month], product, lambda one: one.score, np.nan)
            for m in range(len(MONTH_DAYS))
        ]
        pairs = []
        for one, other in itertools.pairwise(months):
            both = np.isfinite(one) & np.isfinite(other)
            pairs.append(rank_correlation(one[both], other[both]))
        final = _column(year, product, lambda one: one.score, np.nan)
        drift = {}
        for count in PERIODS[:-1]:
            change = np.abs(_column(run.by_period[count], product, lambda one: one.score, np.nan) - final)
            drift[f"{count}_months"] = {
                "median_points": float(np.nanmedian(change)),
                "p95_points": float(np.nanpercentile(change, 95)),
            }
        found[product.value] = {
            "month_to_month_rank_correlation": float(np.mean(pairs)),
            "sd_points": float(np.nanstd(final)),
            "change_to_12_months": drift,
        }
    return found


def _coverage(run: Scored, long: Sequence[Mapping[Product, Score]]) -> dict[str, Any]:
    """How often the interval of relativity holds the truth, by two definitions.

    ``model``: what the model itself would say of the driver after 100 years, if it knew the cells' true risk.
    ``claims``: his true claim rate over the portfolio's mean, of which a product sees a part only.
    """
    rate = run.portfolio.claims_per_year
    found: dict[str, Any] = {}
    for product in Product:
        model = _column(long, product, lambda one: one.relativity, np.nan)
        claims = rate / rate.mean()
        by_months = {}
        for months in PERIODS:
            ends = [
                _column(
                    run.by_period[months],
                    product,
                    lambda one, end=end: one.relativity_interval95 and one.relativity_interval95[end],  # type: ignore[misc]
                    np.nan,
                )
                for end in (0, 1)
            ]
            scored = np.isfinite(ends[0])
            inside = {
                name: float(((ends[0] <= true) & (true <= ends[1]))[scored].mean())
                for name, true in (("model", model), ("claims", claims))
            }
            width = np.log(ends[1][scored] / ends[0][scored])
            by_months[f"{months}_months"] = inside | {"median_width_ln": float(np.median(width))}
        found[product.value] = by_months
    return found


def _true_places(portfolio: Drivers) -> Places:
    """The cells' true risk, by the portfolio's mean."""
    share = portfolio.annual_km @ portfolio.cell_share
    relative = portfolio.cell_risk * (share.sum() / (share @ portfolio.cell_risk))
    cells = cell_names(len(relative))
    return places_of(
        {"shape": 1.0, "cells": {cell: [one, 0.0] for cell, one in zip(cells, relative.tolist(), strict=True)}}
    )


def _wrong(run: Scored, long: Sequence[Record], generator: np.random.Generator, tell: PhaseTell) -> dict[str, Any]:
    """PHYD's figures as shipped and of models that are wrong on purpose, after a year and after a month."""
    loud = _changed(run.model, lambda one: replace(one, weight=_LOUD * one.weight))
    believing = _changed(run.model, lambda one: replace(one, shape=_HARDLY))
    models = {"as_shipped": run.model, "weights_3_times": loud, "no_credibility": believing}
    found = {}
    for done, (name, model) in enumerate(models.items()):
        tell("wrong models", done, len(models))
        year = np.array([_relativity(phyd(record, YEAR_DAYS, model)) for record in run.year])
        truth = [phyd(record, YEAR_DAYS * LONG_YEARS, model) for record in long]
        month = [phyd(months[0], float(MONTH_DAYS[0]), model) for months in run.months]
        inside = [
            one.relativity_interval95[0] <= true.relativity <= one.relativity_interval95[1]
            for one, true in zip(month, truth, strict=True)
            if one.relativity_interval95 is not None and true.relativity is not None
        ]
        after_a_month = np.array([_relativity(one) for one in month])
        found[name] = _wrong_figures(run, year, generator) | {
            "slope_1_month_of_true_rates": calibration_slope(after_a_month, run.portfolio.claims_per_year),
            "coverage_1_month": float(np.mean(inside)),
        }
        if name == "as_shipped":
            found["shuffled"] = _wrong_figures(run, generator.permutation(year), generator)
    return found


def _wrong_figures(run: Scored, relativity: FloatArray, generator: np.random.Generator) -> dict[str, Any]:
    return _calibration(relativity, run, generator) | {
        "gini": gini(relativity, run.claims),
        "gini_of_true_rates": gini(relativity, run.portfolio.claims_per_year),
    }


def _changed(model: ScoreModel, change: Callable[[Regressor], Regressor]) -> ScoreModel:
    return replace(
        model,
        manoeuvres={kind: change(one) for kind, one in model.manoeuvres.items()},
        speeding=change(model.speeding),
        vehicle=change(model.vehicle),
    )
