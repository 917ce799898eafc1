"""The simulated portfolio: whole records, true rates that claims follow, and the same again from the same seed."""

from __future__ import annotations

import numpy as np
import pytest

from core.driving.exposure import Facet
from core.errors import InvalidInputError
from core.scoring.record import total
from core.simulation.portfolio import MONTH_DAYS, PortfolioTuning, a_year, drivers, long_run, others_accidents
from core.tunables import describe


def test_records_are_whole_and_add_up() -> None:
    generator = np.random.default_rng(7)
    portfolio = drivers(generator, 30)
    year = a_year(generator, portfolio)
    assert [len(months) for months in year] == [len(MONTH_DAYS)] * 30
    for months in year:
        for month, days in zip(months, MONTH_DAYS, strict=True):
            whole = month.exposure.total
            for facet in month.exposure.by:
                assert sum(one.distance_mm for one in month.exposure.by[facet].values()) == whole.distance_mm
            assert sum(one.distance_mm for one in month.cells.values()) == whole.distance_mm
            assert month.days <= min(days, month.trips)
            assert month.speeding.certain_over_ms <= month.speeding.certain_ms <= month.speeding.known_ms
    km = np.array([total(months).distance_m * 1e-3 for months in year])
    # A month's distance has an sd of 41 % of its mean, so a year's of 12 %; of 30 drivers' mean 2 %.
    assert (km / portfolio.annual_km).mean() == pytest.approx(1.0, abs=0.08)


def test_the_same_seed_makes_the_same_portfolio() -> None:
    one, other = (drivers(np.random.default_rng(3), 5) for _ in range(2))
    assert a_year(np.random.default_rng(4), one) == a_year(np.random.default_rng(4), other)


def test_claims_follow_the_true_rates_and_are_overdispersed() -> None:
    generator = np.random.default_rng(2)
    portfolio = drivers(generator, 20_000, PortfolioTuning(claims_per_year=1.0))
    assert portfolio.claims_per_year.mean() == pytest.approx(1.0)
    claims = portfolio.claims(generator)
    risky = portfolio.claims_per_year > np.median(portfolio.claims_per_year)
    for part in (risky, ~risky):
        # 10 000 claims or so have an sd of some 1.5 %, luck among them.
        assert claims[part].mean() == pytest.approx(portfolio.claims_per_year[part].mean(), rel=0.06)
    left = claims - portfolio.claims_per_year
    rate = portfolio.claims_per_year
    assert (left**2).mean() == pytest.approx((rate + rate**2 / 2.0).mean(), rel=0.15)


def test_the_long_run_is_what_records_are_drawn_about() -> None:
    portfolio = drivers(np.random.default_rng(1), 3)
    for i, record in enumerate(long_run(portfolio, 100.0)):
        assert record.distance_m == pytest.approx(1e5 * portfolio.annual_km[i], rel=1e-9)
        assert record.exposure.share(Facet.HOUR, "08") == pytest.approx(portfolio.hour_share[i, 8], abs=1e-6)
        speeding = record.speeding
        assert speeding.certain_over_ms / speeding.certain_ms == pytest.approx(portfolio.over_share[i], rel=1e-6)


def test_others_have_more_accidents_where_it_is_riskier() -> None:
    generator = np.random.default_rng(1)
    portfolio = drivers(generator, 200)
    exposure, accidents = others_accidents(generator, portfolio, 1e6)
    per_mm = np.array([accidents[cell] / driven.distance_mm for cell, driven in exposure.items()])
    assert np.corrcoef(per_mm, portfolio.cell_risk)[0, 1] > 0.98
    assert sum(accidents.values()) == pytest.approx(1e5, rel=0.2)


def test_nobody_is_no_portfolio_and_tunables_say_what_they_are() -> None:
    with pytest.raises(InvalidInputError, match="0 drivers: expected one or more"):
        drivers(np.random.default_rng(0), 0)
    assert len(describe(PortfolioTuning)) == 7
