"""``telefuse bench --scores`` and the fairness report: figures that are what they say, on a small portfolio."""

from __future__ import annotations

import json

import numpy as np
import pytest

from service.bench.score_statistics import auc, calibration_slope, gini, rank_correlation, reliability
from tests.commands import call


def test_statistics_against_their_definitions() -> None:
    generator = np.random.default_rng(1)
    true = generator.gamma(2.0, 0.05, 400)
    claims = generator.poisson(true)
    had, none = true[claims > 0], true[claims == 0]
    pairs = np.sign(had[:, None] - none[None, :])
    assert auc(true, claims) == pytest.approx((pairs + 1).mean() / 2)
    order = np.argsort(true)
    lorenz = np.concatenate([[0.0], np.cumsum(claims[order]) / claims.sum()])
    area = ((lorenz[1:] + lorenz[:-1]) / 2).mean()
    assert gini(true, claims) == pytest.approx(1.0 - 2.0 * area)
    assert gini(np.ones(400), claims) == pytest.approx(0.0, abs=1e-12)
    assert np.isnan(gini(true, np.zeros(400, np.int64)))
    # Of rates that are a power of what is predicted, the slope is the power.
    assert calibration_slope(true, true**0.5) == pytest.approx(0.5)
    rows = reliability(true, claims, true)
    assert sum(row["drivers"] for row in rows) == 400
    assert [row["predicted"] for row in rows] == sorted(row["predicted"] for row in rows)
    assert rank_correlation(true, -(true**3)) == pytest.approx(-1.0)


def test_scores_of_a_portfolio_say_what_wrong_models_do_not(capsys) -> None:
    status, out, err = call(capsys, "bench", "--scores", "--drivers", "120", "--json")
    assert (status, err) == (0, "")
    found = json.loads(out)
    # True rates have no chance in them, so that 120 drivers tell as much as that.
    lift = {name: one["gini_of_true_rates"] for name, one in found["lift"].items()}
    assert lift["truth"] > lift["all"] > lift["mileage"] > 0.0
    assert lift["phyd"] > 0.05
    wrong = {name: one["slope_of_true_rates"] for name, one in found["wrong_models"].items()}
    assert wrong["weights_3_times"] < 0.6 * wrong["as_shipped"]
    assert abs(wrong["shuffled"]) < 0.7 < wrong["as_shipped"]
    for product in found["coverage"].values():
        for months in product.values():
            # 120 drivers: an sd of 2 % about 95 %.
            assert months["model"] >= 0.88
        assert product["1_months"]["median_width_ln"] > product["12_months"]["median_width_ln"]
    for product in found["stability"].values():
        change = [one["median_points"] for one in product["change_to_12_months"].values()]
        assert change == sorted(change, reverse=True)
        assert product["month_to_month_rank_correlation"] > 0.4


def test_tables_are_for_people(capsys) -> None:
    status, out, _ = call(capsys, "bench", "--scores", "--drivers", "50")
    assert status == 0
    for part in ("lift", "calibration", "reliability", "stability", "intervals", "wrong on purpose"):
        assert part in out


def test_fairness_of_a_portfolio(capsys) -> None:
    status, out, err = call(capsys, "scores", "fairness", "--drivers", "400", "--json")
    assert (status, err) == (0, "")
    found = json.loads(out)
    phyd = found["phyd"]
    assert 0.05 < phyd["unknown_share"]["age"] < 0.15
    young, *_ = phyd["groups"]["age"]
    # The young drive wilder here, and are scored by that and not by their age.
    assert (young["group"], young["gap"]["interval95"][1] < 0.0) == ("14-24", True)
    status, out, _ = call(capsys, "scores", "fairness", "--drivers", "60")
    assert status == 0
    assert "gap at equal risk" in out


def test_options_that_do_not_belong_are_one_line(capsys) -> None:
    for words, message in (
        (("--drivers", "100"), "--drivers is for --scores"),
        (("--scores", "--drivers", "3"), "3 drivers: expected 50 to 100000"),
    ):
        status, out, err = call(capsys, "bench", *words)
        assert (status, out, err.count("\n")) == (2, "", 1)
        assert message in err
