"""A quote's steps sum to the premium exactly, stay within caps and floors, and a wrong tariff says what is wrong."""

from __future__ import annotations

import copy
import json
import math
import tomllib
from dataclasses import replace
from decimal import ROUND_HALF_EVEN, Decimal
from functools import reduce
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from core.driving.exposure import Driven, Exposure
from core.errors import InvalidInputError
from core.scoring.premium import Tariff, quote, tariff_of
from core.scoring.products import scores
from core.scoring.record import Record
from core.scoring.score import Product, Score
from service.scoring.loading import shipped_model, shipped_tariff, shipped_text

DOCUMENT = tomllib.loads(shipped_text("tariff"))
TARIFF = shipped_tariff()
SCORED = scores(Record(trips=1, exposure=Exposure(Driven(10**9, 10**8))), 30.0, shipped_model())


def scored(**relativities: float | None) -> dict[Product, Score]:
    return {
        Product(name): replace(
            SCORED[Product.PAYD], product=Product(name), relativity=value, reason="nothing was driven"
        )
        for name, value in relativities.items()
    }


RELATIVITY = st.none() | st.floats(1e-6, 1e6)


@given(RELATIVITY, RELATIVITY, RELATIVITY, st.floats(0.001, 3000.0))
def test_steps_sum_and_multiply_to_the_premium_exactly(
    payd: float | None, phyd: float | None, pwyd: float | None, days: float
) -> None:
    quoted = quote(TARIFF, scored(payd=payd, phyd=phyd, pwyd=pwyd), days)
    told = json.loads(json.dumps(quoted.to_json()))
    # Read back from its own JSON, in plain decimal arithmetic of enough digits.
    assert sum((Decimal(step["change"]) for step in told["steps"]), Decimal(0)) == Decimal(told["premium"])
    assert Decimal(told["premium"]) == Decimal(told["premium_minor"]).scaleb(-2)
    amount = Decimal(0)
    for step in told["steps"]:
        if step["factor"] is not None:
            assert amount * Decimal(step["factor"]) == Decimal(step["amount"])
        assert amount + Decimal(step["change"]) == Decimal(step["amount"])
        amount = Decimal(step["amount"])
    period = next(step.amount for step in quoted.steps if step.name == "period")
    before = next(step.amount for step in reversed(quoted.steps) if step.name != "rounding")
    assert TARIFF.floor * period <= before <= TARIFF.cap * period


def test_a_premium_by_hand() -> None:
    quoted = quote(TARIFF, scored(payd=1.1, phyd=0.9, pwyd=1.0), 365.0)
    powered = Decimal(math.pow(0.9, 0.8)).quantize(Decimal("0.000001"))
    by_hand = reduce(lambda amount, factor: amount * factor, [Decimal("1.1"), powered], Decimal(600))
    assert quoted.premium == by_hand.quantize(Decimal("0.01"), ROUND_HALF_EVEN) == Decimal("606.65")
    assert [step.name for step in quoted.steps] == ["base", "period", "payd", "phyd", "pwyd", "rounding"]


def test_floors_and_caps_hold_for_each_and_for_all() -> None:
    dear = quote(TARIFF, scored(payd=50.0, phyd=1.0, pwyd=1.0), 365.0)
    assert next(step.factor for step in dear.steps if step.name == "payd") == Decimal("1.3")
    assert dear.premium == Decimal("660.00")
    cheap = quote(TARIFF, scored(payd=0.01, phyd=0.01, pwyd=0.01), 365.0)
    assert cheap.premium == Decimal("390.00")


def test_without_scores_the_base_is_paid_and_the_step_says_why() -> None:
    quoted = quote(TARIFF, scored(payd=None), 30.0)
    # 600 * 30 / 365 = 49.315
    assert quoted.premium == Decimal("49.32")
    told = {step.name: step.text for step in quoted.steps}
    assert "nothing was driven" in told["payd"]
    assert "not asked for" in told["phyd"]


def test_a_product_left_out_counts_nothing() -> None:
    document = copy.deepcopy(DOCUMENT)
    del document["products"]["pwyd"]
    tariff = tariff_of(document)
    assert quote(tariff, scored(payd=1.0, phyd=1.0, pwyd=9.0), 365.0).premium == Decimal("600.00")


@pytest.mark.parametrize(("rounding", "premium"), [("down", "49.31"), ("up", "49.32"), ("half_up", "49.32")])
def test_rounding_is_the_tariffs(rounding: str, premium: str) -> None:
    assert quote(replace(TARIFF, rounding=rounding), {}, 30.0).premium == Decimal(premium)


def test_yen_have_no_minor_unit() -> None:
    quoted = quote(replace(TARIFF, currency="JPY", minor_units=0), {}, 30.0)
    assert (quoted.premium_minor, f"{quoted.premium:f}") == (49, "49")


@pytest.mark.parametrize(
    ("steps", "value", "message"),
    [
        (("premium", "base", "value"), -600.0, "premium.base is -600: expected 0.01 to 1e"),
        (
            ("premium", "base"),
            {"value": 0, "unit": "x", "range": [0, 1], "source": "x"},
            "premium.base is 0.0: expected more",
        ),
        (("premium", "minor_units", "value"), 1.5, "premium.minor_units is 1.5: expected a whole number"),
        (("premium", "rounding"), "nearest", "premium.rounding is 'nearest': expected one of half_even"),
        (("currency",), "euro", "currency is 'euro': expected three letters"),
        (("products", "pays"), {}, "products.pays is no product: expected payd, phyd, pwyd"),
        (("products",), [], "products is .*: expected sections"),
        (("products", "payd", "exponent", "value"), -1.0, "products.payd.exponent is -1: expected 0 to 2"),
        (("change", "floor"), None, "change.floor is None"),
        (("extra",), 1, "unknown key 'extra'"),
    ],
)
def test_a_wrong_tariff_says_what_is_wrong(steps: tuple[str, ...], value: Any, message: str) -> None:
    with pytest.raises(InvalidInputError, match=message):
        _changed(steps, value)


def test_a_cap_below_its_floor_is_refused() -> None:
    low = {"value": 0.5, "unit": "1", "range": [0.0, 1.0], "source": "choice"}
    with pytest.raises(InvalidInputError, match=r"products.payd.cap is 0.5, below its floor 0.7"):
        _changed(("products", "payd", "cap"), low)


@pytest.mark.parametrize("days", [0.0, -3.0, math.nan, math.inf])
def test_a_premium_for_no_days_is_refused(days: float) -> None:
    with pytest.raises(InvalidInputError, match="a premium for"):
        quote(TARIFF, {}, days)


def _changed(steps: tuple[str, ...], value: Any) -> Tariff:
    document = copy.deepcopy(DOCUMENT)
    place = document
    for step in steps[:-1]:
        place = place[step]
    place[steps[-1]] = value
    return tariff_of(document)
