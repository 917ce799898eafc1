"""Fairness tells gaps that are there, and none where there is none; what is not known is a group of its own."""

from __future__ import annotations

import numpy as np
import pytest

from core.errors import InvalidInputError
from core.scoring.fairness import Scored, fairness


def portfolio(extra: float) -> list[Scored]:
    """Scores that follow the true rate alike, but for some points that men have too few; men have the greater rates."""
    generator = np.random.default_rng(5)
    rows = []
    for i in range(4000):
        sex = ("M", "F", None)[i % 3]
        rate = 0.1 * float(generator.lognormal(0.3 if sex == "M" else 0.0, 0.4))
        score = 70.0 - 20.0 * np.log(rate / 0.1) - (extra if sex == "M" else 0.0) + generator.normal(0.0, 3.0)
        rows.append(
            Scored(40 if i % 2 else None, sex, min(max(score, 0.0), 100.0), rate, int(generator.poisson(rate)), rate)
        )
    return rows


def groups(extra: float) -> dict:
    return {one["group"]: one for one in fairness(portfolio(extra))["groups"]["sex"]}


def test_a_gap_that_risk_explains_is_none_at_equal_risk() -> None:
    men = groups(0.0)["M"]
    assert men["gap"]["interval95"][1] < 0.0
    assert abs(men["controlled_gap"]["points"]) < 0.5


def test_a_gap_beyond_risk_is_found() -> None:
    men = groups(4.0)["M"]
    low, high = men["controlled_gap"]["interval95"]
    # The line through all scores takes some of it up, as men have the greater rates.
    assert -4.5 < low < high < -2.5


def test_actual_over_predicted_holds_one_where_predictions_are_true() -> None:
    told = fairness(portfolio(0.0))
    for one in told["groups"]["sex"]:
        low, high = one["actual_over_predicted_interval95"]
        assert low < 1.0 < high
    assert told["unknown_share"] == {"age": 0.5, "sex": pytest.approx(1 / 3, abs=1e-3)}
    assert [one["group"] for one in told["groups"]["age"]] == ["25-44", "unknown"]
    assert sum(one["drivers"] for one in told["groups"]["age_and_sex"]) == 4000


def test_without_true_rates_nothing_is_controlled_for() -> None:
    one = Scored(30, "F", 60.0, 0.1, 0)
    told = fairness([one, Scored(80, "M", 50.0, 0.0, 0)])
    assert [group["group"] for group in told["groups"]["age"]] == ["25-44", "65+"]
    assert told["groups"]["sex"][0]["controlled_gap"] is None
    assert told["groups"]["sex"][0]["gap"] is None, "of one there is no spread"
    assert told["groups"]["sex"][1]["actual_over_predicted"] is None


def test_bad_rows_are_refused() -> None:
    with pytest.raises(InvalidInputError, match="driver's age is 7: expected 14 to 110"):
        Scored(7, None, 50.0, 0.1, 0)
    with pytest.raises(InvalidInputError, match="predicted is nan"):
        Scored(30, None, 50.0, float("nan"), 0)
    with pytest.raises(InvalidInputError, match="nobody is scored"):
        fairness([])
