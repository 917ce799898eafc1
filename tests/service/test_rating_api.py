"""What a tenant rates by, over HTTP: as shipped, its own, wrong ones, versions and who changed what."""

from __future__ import annotations

import tomllib

import h3
import pytest
from sqlalchemy import insert

from core.driving.exposure import Driven, Exposure
from core.scoring.record import Record
from service.storage import records, tables, vehicles
from service.storage.database import write
from service.storage.records import TripRecord
from tests.service.stored_rows import T0, accident_row
from tests.service.trip_records import a_trip

OWN = """extends = "default"
name = "mine"
[[table]]
name = "sex"
entity = "driver"
source = "a choice"
rows = [{ when = { sex = "M" }, mass = { HR = 1.0 } }]
"""
TOML = {"content-type": "application/toml"}


@pytest.fixture(scope="module")
def service(any_service):
    return any_service


@pytest.fixture
def admin(service, tenant):
    with service.client(tenant, "admin") as client:
        yield client


@pytest.fixture
def insurer(service, tenant):
    with service.client(tenant, "scores:read") as client:
        yield client


def test_what_is_shipped_holds_until_one_has_ones_own(insurer):
    listed = {one["part"]: one for one in insurer.get("/v1/rating").json()["parts"]}
    assert set(listed) == {"risk-tables", "score-model", "tariff", "places"}
    assert insurer.get("/v1/rating/places").json() is None
    listed.pop("places")
    for part, one in listed.items():
        assert (one["version"], one["own"], one["created_at"]) == (0, False, None)
        shipped = insurer.get(f"/v1/rating/{part}")
        assert shipped.headers["content-type"].startswith("application/toml")
        assert "source" in shipped.text
        assert tomllib.loads(shipped.text)
        assert insurer.get(f"/v1/rating/{part}", headers={"if-none-match": shipped.headers["etag"]}).status_code == 304


def test_a_part_of_ones_own_holds_until_it_is_taken_back(admin, insurer):
    put = admin.put("/v1/rating/risk-tables", content=OWN, headers=TOML)
    assert (put.status_code, put.json()["version"], put.json()["own"]) == (200, 1, True)
    assert admin.put("/v1/rating/risk-tables", content=OWN, headers=TOML).json()["version"] == 1
    told = insurer.get("/v1/rating/risk-tables")
    assert (told.text, told.headers["x-rating-version"]) == (OWN, "1")
    shipped = insurer.get("/v1/rating/risk-tables", params={"version": 0}).text
    back = admin.delete("/v1/rating/risk-tables")
    assert (back.json()["version"], back.json()["own"]) == (2, False)
    assert insurer.get("/v1/rating/risk-tables").text == shipped
    assert insurer.get("/v1/rating/risk-tables", params={"version": 1}).text == OWN
    versions = insurer.get("/v1/rating/risk-tables/versions", params={"limit": 1}).json()
    assert [one["version"] for one in versions["versions"]] == [2]
    rest = insurer.get("/v1/rating/risk-tables/versions", params={"cursor": versions["next_cursor"]}).json()
    assert [(one["version"], one["own"]) for one in rest["versions"]] == [(1, True)]
    actions = [one["action"] for one in admin.get("/v1/audit").json()["entries"]]
    assert actions.count("rating.changed") == 2


def test_another_tenant_has_its_own(service, admin, tenant):
    admin.put("/v1/rating/risk-tables", content=OWN, headers=TOML)
    with service.client(f"{tenant}-other", "admin") as stranger:
        assert stranger.get("/v1/rating").json()["parts"][0]["version"] == 0
        assert "mine" not in stranger.get("/v1/rating/risk-tables").text


@pytest.mark.parametrize(
    ("content", "headers", "status", "said"),
    [
        (OWN.replace("HR = 1.0", "HR = 0.7"), TOML, 422, "table 'sex', row 1: masses sum to 0.7"),
        ("a = ", TOML, 422, "is no TOML"),
        ("", TOML, 422, "no table"),
        (b"\xff", TOML, 422, "is no UTF-8"),
        ("<a/>", {"content-type": "application/xml"}, 415, "expected application/toml"),
        ("#" * 5_000_000, TOML, 413, "larger than"),
        (OWN, TOML | {"if-match": '"old"'}, 412, "changed meanwhile"),
    ],
)
def test_what_cannot_be_rated_by_changes_nothing(admin, content, headers, status, said):
    refused = admin.put("/v1/rating/risk-tables", content=content, headers=headers)
    assert (refused.status_code, refused.headers["content-type"]) == (status, "application/problem+json")
    assert said in refused.json()["detail"]
    assert admin.get("/v1/rating").json()["parts"][0]["version"] == 0


def test_who_may_not_and_what_is_not_there(insurer):
    assert insurer.put("/v1/rating/risk-tables", content=OWN, headers=TOML).status_code == 403
    assert insurer.delete("/v1/rating/risk-tables").status_code == 403
    assert insurer.get("/v1/rating/astrology").status_code in (404, 422)
    missing = insurer.get("/v1/rating/risk-tables", params={"version": 9})
    assert (missing.status_code, "no version 9" in missing.json()["detail"]) == (404, True)


def test_places_are_worked_out_from_ones_own_accidents(service, admin, tenant):
    """Twice the distance in one cell, all accidents in the other: that one is the riskier."""
    often, seldom = "881f1d4887fffff", "881f1d4889fffff"
    admin.put("/v1/vehicles/v1", json={})
    lat_deg, lon_deg = h3.cell_to_latlng(seldom)
    with write(service.database) as connection:
        pk = vehicles.find(connection, tenant, "v1").ref.pk
        driven = {often: Driven(2_000_000, 1), seldom: Driven(1_000_000, 1)}
        record = Record(trips=1, exposure=Exposure(Driven(3_000_000, 2)), cells=driven)
        a_trip(connection, pk, tenant[-36:], T0)
        records.put(connection, TripRecord(tenant[-36:], pk, T0, record, b"", "0" * 64, 1))
        placed = {"lat_deg": lat_deg, "lon_deg": lon_deg}
        for number, change in enumerate([placed, placed, {"lat_deg": None, "lon_deg": None}, {"lat_deg": 0.0}]):
            row = accident_row(tenant, pk, number) | change
            connection.execute(insert(tables.accidents), [row])
    built = admin.post("/v1/rating/places:build")
    assert (built.status_code, built.json()["accidents"], built.json()["accidents_left_out"]) == (201, 2, 2)
    assert (built.json()["cells"], built.json()["vehicles"], built.json()["distance_m"]) == (2, 1, 3000.0)
    told = admin.get("/v1/rating/places").json()["cells"]
    assert told[seldom][0] > 1.0 > told[often][0]
    with service.client(f"{tenant}-other", "admin") as stranger:
        assert stranger.get("/v1/rating/places").json() is None
        assert stranger.post("/v1/rating/places:build").json()["cells"] == 0
