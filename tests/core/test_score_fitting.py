"""A model fitted to a portfolio has its values and spreads, and keeps what it cannot know."""

from __future__ import annotations

import copy
import tomllib

import numpy as np
import pytest

from core.errors import InvalidInputError
from core.scoring.fitting import fitted
from core.scoring.model import score_model_of
from core.scoring.products import scores
from core.scoring.record import Record, total
from core.scoring.score import Product
from core.simulation.portfolio import KINDS, a_year, drivers
from service.scoring.loading import shipped_text

DOCUMENT = tomllib.loads(shipped_text("scores"))
GENERATOR = np.random.default_rng(11)
PORTFOLIO = drivers(GENERATOR, 250)
YEARS = [(total(months), 365.0) for months in a_year(GENERATOR, PORTFOLIO)]
FITTED = fitted(DOCUMENT, YEARS)
MODEL = score_model_of(FITTED)


def test_values_and_spreads_are_the_portfolios() -> None:
    # 250 drivers whose annual distance has a spread of 0.55 tell its mean to 4 %, and the spread of rates to 10 %.
    assert MODEL.mileage.annual_km == pytest.approx(PORTFOLIO.annual_km.mean(), rel=0.05)
    km = PORTFOLIO.annual_km
    for place, kind in enumerate(KINDS):
        rate = PORTFOLIO.rate[:, place]
        assert MODEL.manoeuvres[kind].portfolio == pytest.approx(km @ rate / km.sum(), rel=0.06)
        assert MODEL.manoeuvres[kind].shape ** -0.5 == pytest.approx(rate.std() / rate.mean(), rel=0.3)
    assert MODEL.vehicle.portfolio == pytest.approx(km @ PORTFOLIO.risk / km.sum(), rel=0.05)
    assert MODEL.hour.share["08"] == pytest.approx(km @ PORTFOLIO.hour_share[:, 8] / km.sum(), rel=0.05)
    assert MODEL.version == "1+fitted"
    assert FITTED["phyd"]["braking"]["rate"]["source"].startswith("fitted: 250 drivers, ")


def test_the_mean_relativity_is_then_about_one() -> None:
    for product in Product:
        mean = np.mean([scores(record, days, MODEL)[product].relativity for record, days in YEARS])
        # The mean of exponentials is above that of what stands in them.
        assert mean == pytest.approx(1.0, abs=0.05)


def test_what_no_record_knows_stays_and_the_document_given_is_not_changed() -> None:
    before = copy.deepcopy(DOCUMENT)
    bare = [
        (Record(trips=1, exposure=record.exposure.__class__(record.exposure.total)), days) for record, days in YEARS
    ]
    made = fitted(DOCUMENT, bare)
    assert before == DOCUMENT
    for section in ("speeding", "vehicle"):
        assert made["phyd"][section] == DOCUMENT["phyd"][section]
    assert made["payd"]["hour"]["labels"] == DOCUMENT["payd"]["hour"]["labels"]
    assert made["phyd"]["braking"]["rate"]["value"] == DOCUMENT["phyd"]["braking"]["rate"]["range"][0], "none was done"


def test_one_driver_is_no_portfolio() -> None:
    with pytest.raises(InvalidInputError, match="1 drivers with a distance: expected 2 or more"):
        fitted(DOCUMENT, [YEARS[0], (Record(), 365.0)])
    with pytest.raises(InvalidInputError, match="a period of 0"):
        fitted(DOCUMENT, [(record, 0.0) for record, _ in YEARS])
