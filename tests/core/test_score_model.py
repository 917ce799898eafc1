"""A model says what is wrong in it, number by number, and its digest is of its content."""

from __future__ import annotations

import copy
import tomllib
from collections.abc import Iterator
from typing import Any

import pytest

from core.errors import InvalidInputError
from core.scoring.model import score_model_of
from service.scoring.loading import shipped_model, shipped_text

DOCUMENT = tomllib.loads(shipped_text("scores"))


def numbers(section: dict[str, Any], path: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    for key, value in section.items():
        if isinstance(value, dict):
            yield from [(*path, key)] if "value" in value else numbers(value, (*path, key))


NUMBERS = sorted(numbers(DOCUMENT))


def changed(*steps: str, to: Any) -> dict[str, Any]:
    document = copy.deepcopy(DOCUMENT)
    place = document
    for step in steps[:-1]:
        place = place[step]
    if to is None:
        del place[steps[-1]]
    else:
        place[steps[-1]] = to
    return document


def test_the_shipped_model_is_found_whole() -> None:
    assert len(NUMBERS) > 40
    model = score_model_of(DOCUMENT)
    assert model == shipped_model()
    assert len(model.sha256) == 64


def test_the_digest_is_of_the_content_and_not_of_how_it_is_written() -> None:
    turned = dict(reversed(list(DOCUMENT.items())))
    assert score_model_of(turned).sha256 == score_model_of(DOCUMENT).sha256
    other = changed("scale", "base", "value", to=71.0)
    assert score_model_of(other).sha256 != score_model_of(DOCUMENT).sha256


@pytest.mark.parametrize("path", NUMBERS, ids=".".join)
def test_each_number_needs_value_unit_range_and_source(path: tuple[str, ...]) -> None:
    where = ".".join(path)
    most = DOCUMENT
    for step in path:
        most = most[step]
    for fact, value in (("unit", ""), ("source", None), ("range", [1.0]), ("value", "1")):
        with pytest.raises(InvalidInputError, match=where.replace(".", r"\.")):
            score_model_of(changed(*path, fact, to=value))
    with pytest.raises(InvalidInputError, match=f"{where} is .*: expected .* to "):
        score_model_of(changed(*path, "value", to=2.0 * most["range"][1] + 1.0))
    with pytest.raises(InvalidInputError, match=where):
        score_model_of(changed(*path, to=None))


@pytest.mark.parametrize(
    ("steps", "value", "message"),
    [
        (("name",), None, "name is None: expected a text"),
        (("extra",), 1, "unknown key 'extra'"),
        (("payd",), None, r"\[payd\] is missing"),
        (("phyd", "honking"), {}, r"\[phyd\]: unknown section 'honking'"),
        (("scale", "extra"), 1, r"\[scale\]: unknown key 'extra'"),
        (("scale", "base"), 70.0, "scale.base is 70.0: expected { value, unit, range, source }"),
        (("payd", "mileage", "bands", "from_km"), [0.0, 5.0], "expected a start for each of 3 slopes"),
        (("payd", "mileage", "bands", "from_km"), [0.0, 9.0, 5.0], "expected starts that rise from 0"),
        (("payd", "mileage", "bands", "slope"), [0.0, 0.1, 99.0], "slope has 99: expected 0 to 10"),
        (("phyd", "braking", "cap", "value"), 0.5, "phyd.braking.cap is 0.5: expected more than the portfolio's 0.6"),
        (("phyd", "vehicle", "entity"), "car", "phyd.vehicle.entity is 'car': expected one of driver"),
        (("payd", "hour", "labels", "03"), [22.5, 0.5], "shares sum to 1.4"),
        (("payd", "hour", "labels", "03"), 22.5, "some have a share"),
        (("payd", "hour", "labels", "03"), [0.0, 0.0008], "expected a rate above 0"),
        (("payd", "hour", "groups", "night"), ["22", "22"], "groups.night has '22': expected each label once"),
        (("payd", "hour", "groups", "night"), ["25"], "groups.night has '25'"),
        (("pwyd", "district", "labels"), {"here": 500.0}, "labels.here has 500: expected 0 to 100"),
    ],
)
def test_what_does_not_fit_together_is_said(steps: tuple[str, ...], value: Any, message: str) -> None:
    with pytest.raises(InvalidInputError, match=message):
        score_model_of(changed(*steps, to=value))


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_numbers_are_finite(value: float) -> None:
    with pytest.raises(InvalidInputError, match="a number is infinite or NaN"):
        score_model_of(changed("scale", "base", "value", to=value))


def test_relativities_are_by_the_portfolios_mean() -> None:
    model = shipped_model()
    for facet in (model.hour, model.road_class):
        assert sum(facet.relativity[label] * share for label, share in facet.share.items()) == pytest.approx(1.0)
    assert model.hour.relativity["03"] == pytest.approx(model.hour.relativity["02"]), "the night is capped"
    assert model.mileage.relativity(model.mileage.annual_km) == 1.0


def test_districts_of_ones_own() -> None:
    document = changed("pwyd", "district", "labels", to={"Ville-Marie": 1.4, "Anjou": 0.9})
    assert score_model_of(document).district.relativity == {"Ville-Marie": 1.4, "Anjou": 0.9}
