"""``telefuse scores``: the same scores as JSON, sentences for drivers, and one line for what is wrong."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any

import pytest

from core.driving.exposure import Driven
from core.scoring.places import places_from
from core.scoring.products import scores
from core.scoring.record import Record
from service.scoring.loading import shipped_model, shipped_text
from tests.commands import call

MM = 840_000_000
RECORD: dict[str, Any] = {
    "trips": 40,
    "days": 20,
    "total": [MM, 70_000_000],
    "by": {
        "hour": {"08": [MM - 1000, 0], "23": [1000, 0]},
        "road_class": {"motorway": [MM // 2, 0], "": [MM // 2, 0]},
        "district": {"nowhere": [MM, 0]},
    },
    "cells": {"881f1d4887fffff": [MM, 0]},
    "manoeuvres": {"braking": 12},
    "speeding": {"known_ms": 50_000_000, "certain_ms": 40_000_000, "over_ms": 4_000_000, "certain_over_ms": 3_000_000},
    "evidence": {"braking": [[61, "manoeuvre", "m1"]]},
}


@pytest.fixture
def record(tmp_path: Path) -> Path:
    path = tmp_path / "record.json"
    path.write_text(json.dumps(RECORD))
    return path


def test_scores_of_a_record_are_those_of_the_core(record: Path, capsys) -> None:
    status, out, err = call(capsys, "scores", "score", record, "--days", 30)
    assert (status, err) == (0, "")
    told = json.loads(out)["scores"]
    core = scores(Record.from_json(RECORD), 30.0, shipped_model())
    for product, one in core.items():
        explained = told[product.value].pop("explained")
        assert told[product.value] == json.loads(json.dumps(one.to_json()))
        assert len(explained) == len(one.contributions)
    braking = next(one for one in told["phyd"]["contributions"] if one["name"] == "braking")
    assert braking["evidence"] == [{"weight": 61, "kind": "manoeuvre", "id": "m1"}]


def test_one_product_with_places(record: Path, tmp_path: Path, capsys) -> None:
    cell = "881f1d4887fffff"
    places = places_from({cell: Driven(MM, 0), "other": Driven(MM, 0)}, {cell: 40, "other": 10})
    path = tmp_path / "places.json"
    path.write_text(json.dumps(places.to_json()))
    status, out, _ = call(capsys, "scores", "score", record, "--days", 30, "--product", "pwyd", "--places", path)
    told = json.loads(out)["scores"]
    assert (status, list(told), told["pwyd"]["places_sha256"]) == (0, ["pwyd"], places.sha256)
    assert told["pwyd"]["coverage"]["cell"] == 1.0


def test_a_premium_by_ones_own_tariff(record: Path, tmp_path: Path, capsys) -> None:
    status, out, _ = call(capsys, "scores", "tariff")
    assert status == 0
    path = tmp_path / "tariff.toml"
    path.write_text(out.replace("value = 600.00", "value = 1200.00"))
    status, out, _ = call(capsys, "scores", "score", record, "--days", 30, "--tariff", path)
    quoted = json.loads(out)["quote"]
    assert (status, quoted["currency"], quoted["steps"][0]["amount"]) == (0, "EUR", "1200.0")
    status, out, _ = call(capsys, "scores", "score", record, "--days", 30, "--tariff", path, "--explain")
    assert status == 0
    assert "12 harsh brakings in 840 km: 1.4 per 100 km, others 0.6" in out
    assert f"premium {quoted['premium']} EUR:" in out


def test_the_model_is_shown_as_it_is_written(tmp_path: Path, capsys) -> None:
    status, shown, _ = call(capsys, "scores", "model", "--show")
    assert (status, shown) == (0, shipped_text("scores"))
    status, out, _ = call(capsys, "scores", "model")
    assert (status, out) == (0, f"telefuse 1 sha256 {shipped_model().sha256}\n")
    path = tmp_path / "mine.toml"
    path.write_text(shown.replace('name = "telefuse"', 'name = "mine"'))
    status, out, _ = call(capsys, "scores", "model", "--model", path)
    assert (status, out[:5]) == (0, "mine ")
    assert tomllib.loads(shown)["version"] == "1"


def test_a_model_with_a_portfolios_own_values(record: Path, tmp_path: Path, capsys) -> None:
    path = tmp_path / "portfolio.jsonl"
    calm = RECORD | {"manoeuvres": {}}
    path.write_text("".join(json.dumps({"days": 30, "record": one}) + "\n" for one in (RECORD, calm)) + "\n")
    status, out, err = call(capsys, "scores", "fit", path)
    assert (status, err) == (0, "")
    mine = tmp_path / "mine.json"
    mine.write_text(out)
    status, out, _ = call(
        capsys, "scores", "score", record, "--days", 30, "--product", "phyd", "--model", mine, "--explain"
    )
    assert status == 0
    assert "12 harsh brakings in 840 km: 1.4 per 100 km, others 0.7" in out
    for line, message in (
        ("{}", 'line 1: expected {"days": N, "record": {…}}'),
        ("{", "line 1: "),
        (json.dumps({"days": 30, "record": {"trips": -1}}), "line 1: trips is -1"),
        ("", "0 drivers with a distance: expected 2 or more"),
    ):
        path.write_text(line)
        assert message in _refused(capsys, "fit", path)
    mine.write_text("[]")
    assert "is no JSON: no object" in _refused(capsys, "model", "--model", mine)


def _with(**changes: Any) -> dict[str, Any]:
    return RECORD | changes


@pytest.mark.parametrize(
    ("record", "message"),
    [
        ("{", "is no JSON"),
        ("[]", "is no JSON: no object; expected a record"),
        (_with(trip=1), "unknown key 'trip'"),
        (_with(trips=-1), "trips is -1: expected a whole number"),
        (_with(trips=True), "trips is True"),
        (_with(total=[10**30, 0]), "total is 1000000"),
        (_with(total=[1.5, 0]), "total is 1.5"),
        (_with(by={"colour": {}}), "by.colour: expected one of hour"),
        (_with(by={"hour": []}), "by.hour is []"),
        (_with(by={"hour": {"08": [2 * MM, 0]}}), "by.hour sums to"),
        (_with(cells=[1]), "cells is [1]"),
        (_with(manoeuvres={"honking": 1}), "manoeuvres.honking: expected one of braking"),
        (_with(speeding={"over_ms": 5}), "speeding.over_ms is 5: expected known_ms, 0, at most"),
        (_with(speeding={"over": 5}), "speeding.over: expected one of known_ms"),
        (_with(belief={"vehicle": [1, 2]}), "belief.vehicle is [1, 2]: expected 9 whole numbers"),
        (_with(evidence={"braking": [[1, "trip"]]}), "expected [weight, kind, id]"),
    ],
)
def test_a_bad_record_is_one_line(record: Any, message: str, tmp_path: Path, capsys) -> None:
    path = tmp_path / "record.json"
    path.write_text(record if isinstance(record, str) else json.dumps(record))
    assert message in _refused(capsys, "score", path, "--days", 30)


def test_other_bad_input_is_one_line(record: Path, tmp_path: Path, capsys) -> None:
    assert "a period of 0.0 days: expected more than 0" in _refused(capsys, "score", record, "--days", 0)
    assert "driven on 20 days of a period of 3" in _refused(capsys, "score", record, "--days", 3)
    assert "invalid choice: 'pays'" in _refused(capsys, "score", record, "--days", 30, "--product", "pays")
    assert "cannot be read" in _refused(capsys, "score", tmp_path / "none.json", "--days", 30)
    bad = tmp_path / "bad.toml"
    bad.write_bytes(b"\xff")
    assert "is no UTF-8" in _refused(capsys, "model", "--model", bad)
    bad.write_text("a = ")
    assert "is no TOML" in _refused(capsys, "tariff", "--tariff", bad)
    bad.write_text(
        shipped_text("tariff").replace("value = 0.70", "value = 0.99").replace("value = 1.30", "value = 1.00")
    )
    assert _refused(capsys, "tariff", "--tariff", bad, expected=0) == ""
    bad.write_text(shipped_text("tariff").replace("[products.phyd]", "[products.honk]"))
    assert "products.honk is no product" in _refused(capsys, "tariff", "--tariff", bad)
    assert "--tariff needs all products" in _refused(
        capsys, "score", record, "--days", 30, "--tariff", bad, "--product", "payd"
    )
    places = tmp_path / "places.json"
    places.write_text("{}")
    assert "no places: expected shape" in _refused(capsys, "score", record, "--days", 30, "--places", places)
    assert "3 drivers: expected 50 to" in _refused(capsys, "fairness", "--drivers", 3)


def test_an_empty_record_and_a_trip_of_one_fix_have_a_reason(tmp_path: Path, capsys) -> None:
    path = tmp_path / "record.json"
    for record, reason in (({}, "nothing was driven"), ({"trips": 1, "days": 1}, "no distance in 1 trips")):
        path.write_text(json.dumps(record))
        status, out, _ = call(capsys, "scores", "score", path, "--days", 30)
        assert status == 0
        assert {one["reason"] for one in json.loads(out)["scores"].values()} == {reason}
        status, out, _ = call(capsys, "scores", "score", path, "--days", 30, "--explain")
        assert f"No score for this period: {reason}." in out


def _refused(capsys, *words: Any, expected: int = 2) -> str:
    status, _, err = call(capsys, "scores", *words)
    assert (status, err.count("\n")) == (expected, 1 if expected else 0)
    return err
