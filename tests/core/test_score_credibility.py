"""Credibility and intervals, against what they are by definition: draws from a portfolio as the model has it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import gamma

from core.driving.exposure import Driven, Exposure
from core.scoring.credibility import Estimate, Shrunk, shape_of, summed
from core.scoring.phyd import phyd
from core.scoring.record import Record
from service.scoring.loading import shipped_model

MODEL = shipped_model()


def test_shrunk_is_buehlmanns_and_its_quantiles_the_gammas() -> None:
    shrunk = Shrunk(shape_of(0.5), 7.0, 12.0)
    z = 12.0 / (4.0 + 12.0)
    assert shrunk.credibility == z
    assert shrunk.mean == pytest.approx(z * 7.0 / 12.0 + 1.0 - z, rel=1e-15)
    exact = gamma(4.0 + 7.0, scale=1.0 / (4.0 + 12.0)).ppf([0.025, 0.975])
    assert shrunk.estimate[1:] == pytest.approx(exact, rel=1e-12)


def test_after_nothing_the_portfolio_is_believed() -> None:
    assert Shrunk(1.0, 0.0, 0.0).estimate == pytest.approx([1.0, *gamma(1.0).ppf([0.025, 0.975])])
    assert Shrunk(1.0, 0.0, 0.0).credibility == 0.0


def test_a_sum_of_one_is_itself_and_of_more_lies_between_independent_and_together() -> None:
    one, other = Estimate(1.0, 0.5, 2.0), Estimate(-1.0, -2.0, 1.0)
    assert summed([one]) == one
    assert summed([one], 0.7) == pytest.approx(one, abs=1e-15)
    apart, together = summed([one, other]), summed([one, other], 1.0)
    assert together == pytest.approx((0.0, -1.5, 3.0))
    assert -1.5 < apart.low < -1.0
    assert 2.0 < apart.high < 3.0


def test_the_sum_of_gammas_is_nearly_theirs() -> None:
    exponential = Shrunk(1.0, 0.0, 0.0).estimate
    # As the docstring of summed says.
    assert summed([exponential] * 6) == pytest.approx((6.0, 2.37, 11.34), abs=0.01)
    assert gamma(6.0).ppf([0.025, 0.975]) == pytest.approx([2.20, 11.67], abs=0.01)
    known = Shrunk(1.0, 9.0, 9.0).estimate
    exact = gamma(60.0, scale=0.1).ppf([0.025, 0.975])
    assert summed([known] * 6)[1:] == pytest.approx(exact, rel=0.005)


@pytest.mark.parametrize("km", [50.0, 500.0, 5000.0])
def test_intervals_hold_the_truth_as_often_as_they_say(km: float) -> None:
    """Drivers and counts as the model assumes them; what is not known (limits, the vehicle) is drawn from its prior."""
    generator = np.random.default_rng(3)
    model = replace(MODEL, correlation=0.0)
    n, inside = 1000, 0
    for _ in range(n):
        true = {name: generator.gamma(one.shape, 1.0 / one.shape) for name, one in model.manoeuvres.items()}
        counts = {
            name: round(one.dispersion * generator.poisson(true[name] * km / one.exposure))
            for name, one in model.manoeuvres.items()
        }
        ln = sum(one.ln(true[name]) for name, one in model.manoeuvres.items())
        ln += sum(one.ln(generator.gamma(one.shape, 1.0 / one.shape)) for one in (model.speeding, model.vehicle))
        one = phyd(Record(trips=1, exposure=Exposure(Driven(round(km * 1e6), 1)), manoeuvres=counts), 30.0, model)
        low, high = one.relativity_interval95
        inside += low <= np.exp(ln) <= high
    # 95 % of 1000 has an sd of 0.7 %; the sum of the parts is an approximation.
    assert 0.92 <= inside / n <= 0.98
