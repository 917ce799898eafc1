"""Scores over HTTP: what they are made of, over which period, and what a key may know."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from decimal import Decimal

import pytest

from core.driving.exposure import Driven, Exposure, Facet
from core.scoring.places import places_from
from core.scoring.products import scores
from core.scoring.record import BeliefSums, Evidence, Record, SpeedingSums, total
from service.cli import main
from service.scoring.loading import shipped_model
from service.storage import vehicles
from service.storage.database import write
from service.storage.records import TripRecord
from tests.service.trip_records import put_all

FIRST = datetime(2026, 1, 10, 8, tzinfo=UTC)
CELLS = ("881f1d4887fffff", "881f1d4889fffff")


@pytest.fixture(scope="module")
def service(any_service):
    return any_service


@pytest.fixture
def insurer(service, tenant):
    with service.client(tenant, "scores:read") as client:
        yield client


def ns(moment):
    return int(moment.timestamp()) * 1_000_000_000


def a_record(trip_id, *, braking=0, km=20):
    driven = Driven(km * 10**6, km * 90_000)
    by = {
        Facet.HOUR: {"08": driven},
        Facet.ROAD_CLASS: {"primary": driven},
        Facet.DISTRICT: {"Kallio": driven},
    }
    return Record(
        trips=1,
        exposure=Exposure(driven, by),
        cells=dict.fromkeys(CELLS, Driven(driven.distance_mm // 2, driven.time_ms // 2)),
        manoeuvres={"braking": braking} if braking else {},
        speeding=SpeedingSums(known_ms=km * 90_000, certain_ms=km * 90_000),
        belief={
            "fused": BeliefSums(2, (0, 10**9, 0, 0, 0, 0, 0, 10**9)),
            "vehicle": BeliefSums(1, (0, 10**9) + (0,) * 6),
        },
        coverage={"vehicle.speed": 2 * 10**9},
        evidence={"braking": (Evidence(500, "manoeuvre", f"m-{trip_id}"),)} if braking else {},
    )


@pytest.fixture
def driven(service, tenant):
    """A vehicle with a trip a day for 100 days, every tenth with a harsh braking."""
    with service.client(tenant, "admin") as admin:
        assert admin.put("/v1/vehicles/v1", json={}).status_code == 201
    made = [(FIRST + timedelta(days=day), a_record(f"{tenant}-{day}", braking=day % 10 == 0)) for day in range(100)]
    with write(service.database) as connection:
        pk = vehicles.find(connection, tenant, "v1").ref.pk
        rows = [
            TripRecord(f"{tenant}-{day}"[-36:], pk, ns(begin), record, b"", "0" * 64, 1)
            for day, (begin, record) in enumerate(made)
        ]
        put_all(connection, rows)
    return made


def test_all_scores_by_default_end_with_the_last_trip(insurer, driven):
    told = insurer.get("/v1/vehicles/v1/scores").json()["scores"]
    assert set(told) == {"payd", "phyd", "pwyd"}
    last = driven[-1][0].replace(hour=0) + timedelta(days=1)
    for product, one in told.items():
        assert one["product"] == product
        assert one["period"]["end_at"] == last.strftime("%Y-%m-%dT00:00:00.000000Z")
        assert one["period"]["observed_from"] == "2026-01-10T00:00:00.000000Z"
        assert (one["period"]["days"], one["trips"], one["distance_m"]) == (100.0, 100, 2_000_000.0)
        low, high = one["interval95"]
        assert 0.0 <= low <= one["score"] <= high <= 100.0
        assert math.fsum(part["points"] for part in one["contributions"]) == one["score"]
        assert all(part["sentence"].endswith(".") for part in one["contributions"])
    assert told["phyd"]["belief"]["fused"]["LR"] == pytest.approx(0.5)
    assert told["payd"]["belief"] is None


def test_a_score_is_that_of_the_plain_sum_of_its_trips(insurer, driven):
    """The same figures to the bit, whether trips are summed one by one here or by days, months and years there."""
    asked = {"from": "2026-01-15", "to": "2026-04-02T12:00:00Z"}
    wanted = [record for begin, record in driven if ns(datetime(2026, 1, 15, tzinfo=UTC)) <= ns(begin)]
    wanted = wanted[: (datetime(2026, 4, 2, 12, tzinfo=UTC) - datetime(2026, 1, 15, tzinfo=UTC)).days + 1]
    whole = replace(total(wanted), days=len(wanted))
    plain = scores(whole, 77.5, shipped_model())
    for product, score in plain.items():
        told = insurer.get(f"/v1/vehicles/v1/scores/{product}", params=asked).json()
        assert (told["score"], told["relativity"]) == (score.score, score.relativity)
        assert told["interval95"] == list(score.interval95)
        assert told["model"]["sha256"] == score.model_sha256


def test_a_contribution_names_what_it_rests_on(insurer, driven):
    told = insurer.get("/v1/vehicles/v1/scores/phyd").json()
    braking = next(one for one in told["contributions"] if one["name"] == "braking")
    assert (braking["count"], braking["unit"]) == (10, "1/(100 km)")
    assert len(braking["evidence"]) == 5
    assert {piece["kind"] for piece in braking["evidence"]} == {"manoeuvre"}
    assert "10 harsh brakings in 2000 km" in braking["sentence"]


def test_months_and_windows(insurer, driven):
    february = insurer.get("/v1/vehicles/v1/scores/payd", params={"month": "2026-02"}).json()
    assert (february["trips"], february["period"]["days"]) == (28, 28.0)
    window = insurer.get("/v1/vehicles/v1/scores/payd", params={"days": 30}).json()
    assert (window["trips"], window["period"]["days"]) == (30, 30.0)
    again = insurer.get("/v1/vehicles/v1/scores/payd", params={"days": 30})
    assert (
        insurer.get(
            "/v1/vehicles/v1/scores/payd", params={"days": 30}, headers={"if-none-match": again.headers["etag"]}
        ).status_code
        == 304
    )


def test_a_longer_record_is_surer(insurer, driven):
    def width(days):
        low, high = insurer.get("/v1/vehicles/v1/scores/phyd", params={"days": days}).json()["interval95"]
        return high - low

    assert width(100) < width(30) < width(3)


def test_a_period_without_trips_has_no_score_and_says_why(insurer, driven):
    for product in ("payd", "phyd", "pwyd"):
        empty = insurer.get(f"/v1/vehicles/v1/scores/{product}", params={"from": "2025-01-01", "to": "2025-02-01"})
        assert (empty.status_code, empty.json()["score"], empty.json()["interval95"]) == (200, None, None)
        assert "nothing was driven" in empty.json()["reason"]


def test_a_vehicle_that_never_drove(service, tenant, insurer):
    with service.client(tenant, "admin") as admin:
        admin.put("/v1/vehicles/new", json={})
    told = insurer.get("/v1/vehicles/new/scores").json()["scores"]
    assert {one["score"] for one in told.values()} == {None}
    assert told["payd"]["period"]["observed_from"] is None


@pytest.mark.parametrize(
    ("query", "said"),
    [
        ({"from": "2026-03-01", "to": "2026-02-01"}, "ends before it begins"),
        ({"from": "2026-03-01", "to": "2026-03-01"}, "ends before it begins"),
        ({"from": "yesterday"}, "is not an RFC 3339 time"),
        ({"from": "2026-02-30"}, "is no date"),
        ({"month": "2026-13"}, "is no date"),
        ({"month": "March"}, "is no month"),
        ({"month": "2026-02", "days": 3}, "is a period by itself"),
        ({"from": "2026-02-01", "days": 3}, "either from or days"),
        ({"days": 0}, "days"),
        ({"from": "1800-01-01"}, "1970 to 2261"),
    ],
)
def test_a_period_that_is_none_is_said(insurer, driven, query, said):
    refused = insurer.get("/v1/vehicles/v1/scores/phyd", params=query)
    assert (refused.status_code, refused.headers["content-type"]) == (422, "application/problem+json")
    assert said in refused.json()["detail"]


def test_no_such_product_or_vehicle(insurer, driven):
    assert insurer.get("/v1/vehicles/v1/scores/luck").status_code in (404, 422)
    assert insurer.get("/v1/vehicles/v2/scores/payd").status_code == 404


def test_a_key_needs_the_scope(service, tenant, driven):
    with service.client(tenant, "vehicles:read") as reader:
        assert reader.get("/v1/vehicles/v1/scores").status_code == 403


def test_cells_are_for_keys_that_may_know_places(service, tenant, insurer, driven):
    exposure = {cell: Driven(10**9, 10**6) for cell in CELLS}
    risk = places_from(exposure, {CELLS[0]: 12, CELLS[1]: 1})
    with service.client(tenant, "admin") as admin:
        put = admin.put("/v1/rating/places", json=risk.to_json())
        assert put.status_code == 200, put.text
        seen = admin.get("/v1/vehicles/v1/scores/pwyd").json()
    blind = insurer.get("/v1/vehicles/v1/scores/pwyd").json()
    assert seen["model"]["places_sha256"] == risk.sha256
    assert [one["name"] for one in seen["contributions"] if CELLS[0] in one["name"]]
    assert CELLS[0] not in str(blind)
    assert (blind["score"], blind["interval95"]) == (seen["score"], seen["interval95"])
    assert math.fsum(one["points"] for one in blind["contributions"]) == blind["score"]
    (places,) = [one for one in blind["contributions"] if one["name"] == "places"]
    cells = [one for one in seen["contributions"] if one["name"].startswith("cell:")]
    trips = {piece["id"] for one in cells for piece in one["evidence"]}
    assert len(cells) == 2
    assert all(len(one["evidence"]) == 5 for one in (*cells, places))
    assert {piece["id"] for piece in places["evidence"]} <= trips
    some = insurer.get("/v1/vehicles/v1/scores/pwyd", params={"month": "2026-02"}).json()["contributions"]
    in_february = {f"{tenant}-{day}"[-36:] for day in range(22, 50)}
    assert {piece["id"] for one in some for piece in one["evidence"] if one["name"] == "places"} <= in_february


def test_ones_own_model_scores_at_once(service, tenant, insurer, driven):
    before = insurer.get("/v1/vehicles/v1/scores/phyd").json()
    with service.client(tenant, "admin") as admin:
        text = admin.get("/v1/rating/score-model").text
        own = text.replace('version = "1"', 'version = "mine"').replace(
            "base = { value = 70.0", "base = { value = 60.0"
        )
        put = admin.put("/v1/rating/score-model", content=own, headers={"content-type": "application/toml"})
        assert put.status_code == 200, put.text
        bad = own.replace("base = { value = 60.0", "base = { value = -1.0")
        assert (
            admin.put("/v1/rating/score-model", content=bad, headers={"content-type": "application/toml"}).status_code
            == 422
        )
    after = insurer.get("/v1/vehicles/v1/scores/phyd").json()
    assert (after["model"]["version"], after["score"]) == ("mine", before["score"] - 10.0)


def test_a_quote_says_every_step(service, tenant, insurer, driven):
    told = insurer.get("/v1/vehicles/v1/quote").json()
    assert [one["name"] for one in told["steps"]][:5] == ["base", "period", "payd", "phyd", "pwyd"]
    assert sum(Decimal(one["change"]) for one in told["steps"]) == Decimal(told["premium"])
    assert (told["currency"], told["premium_minor"]) == ("EUR", int(Decimal(told["premium"]) * 100))
    half = insurer.get("/v1/vehicles/v1/quote", params={"premium_days": 182.5}).json()
    assert 2 * half["premium_minor"] == pytest.approx(told["premium_minor"], abs=2)
    with service.client(tenant, "admin") as admin:
        own = admin.get("/v1/rating/tariff").text.replace('"EUR"', '"CHF"').replace("value = 600.00", "value = 1200")
        toml = {"content-type": "application/toml"}
        assert admin.put("/v1/rating/tariff", content=own, headers=toml).status_code == 200
        bad = admin.put("/v1/rating/tariff", content=own.replace("value = 1200", "value = -1"), headers=toml)
        assert (bad.status_code, "premium.base" in bad.json()["detail"]) == (422, True)
    dearer = insurer.get("/v1/vehicles/v1/quote").json()
    assert (dearer["currency"], dearer["premium_minor"]) == ("CHF", pytest.approx(2 * told["premium_minor"], abs=2))


def test_who_never_drove_pays_the_base(service, tenant, insurer):
    with service.client(tenant, "admin") as admin:
        admin.put("/v1/vehicles/new", json={})
    told = insurer.get("/v1/vehicles/new/quote").json()
    assert told["premium"] == "600.00"
    assert "nothing was driven" in next(one["text"] for one in told["steps"] if one["name"] == "phyd")
    assert insurer.get("/v1/vehicles/new/quote", params={"premium_days": 0}).status_code == 422


def test_the_record_of_a_period_makes_the_same_scores_offline(service, tenant, insurer, driven, tmp_path, capsys):
    asked = {"from": "2026-02-01", "to": "2026-03-05"}
    with service.client(tenant, "admin") as admin:
        told = admin.get("/v1/vehicles/v1/record", params=asked).json()
    path = tmp_path / "record.json"
    path.write_text(json.dumps(told["record"]))
    assert main(["scores", "score", str(path), "--days", str(told["days"])]) == 0
    offline = json.loads(capsys.readouterr().out)["scores"]
    online = insurer.get("/v1/vehicles/v1/scores", params=asked).json()["scores"]
    assert {name: one["score"] for name, one in offline.items()} == {name: one["score"] for name, one in online.items()}
    assert set(told["record"]["cells"]) == set(CELLS)
    blind = insurer.get("/v1/vehicles/v1/record", params=asked).json()["record"]
    assert blind | {"cells": told["record"]["cells"]} == told["record"]


def test_a_model_with_ones_own_districts_is_taken(service, tenant, insurer, driven, tmp_path, capsys):
    rates = tmp_path / "rates.csv"
    rates.write_text("district,rate,exposure\nKallio,3,1\nelsewhere,1,3\n")
    assert main(["scores", "districts", str(rates)]) == 0
    model = capsys.readouterr().out
    with service.client(tenant, "admin") as admin:
        put = admin.put("/v1/rating/score-model", content=model, headers={"content-type": "application/json"})
        assert put.status_code == 200, put.text
        assert admin.get("/v1/rating/score-model").headers["content-type"].startswith("application/json")
    told = insurer.get("/v1/vehicles/v1/scores/pwyd").json()
    kallio = next(one for one in told["contributions"] if one["name"] == "district:Kallio")
    assert kallio["points"] < -1.0
    assert told["coverage"]["district"] == 1.0
