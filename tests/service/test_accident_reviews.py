"""A person has the last word on what was an accident: told, kept and audited."""

from __future__ import annotations

import pytest
from sqlalchemy import insert, select

from schemas.notifications import rfc3339
from service.storage import accidents, tables
from service.storage.accidents import AccidentRow
from service.storage.database import read, write
from tests.documented import conforms
from tests.service.stored_rows import NS, T0, accident_row, candidate_row


@pytest.fixture
def service(any_service):
    return any_service


@pytest.fixture
def pk(service, tenant):
    return service.runtime.directory.register(tenant, "car").ref.pk


@pytest.fixture
def admin(service, tenant):
    with service.client(tenant, "admin") as client:
        yield client


def add(service, table, row):
    with write(service.database) as connection:
        connection.execute(insert(table), [row])
    return row["id"]


def events(client):
    return [(one["type"], one["data"]["status"]) for one in client.get("/v1/events").json()["events"]]


def listed(client, **asked):
    return [one["id"] for one in client.get("/v1/accidents", params=asked).json()["features"]]


def test_a_false_one_is_retracted_and_no_longer_listed_and_the_last_verdict_counts(service, admin, tenant, pk):
    accident = add(service, tables.accidents, accident_row(tenant, pk, 0, status="suspected"))
    url = f"/v1/accidents/{accident}/reviews"
    first = admin.post(url, json={"verdict": "false", "note": "A speed bump."})
    assert first.status_code == 201
    review = first.json()
    conforms("Review", review)
    assert (review["before"], review["after"], review["note"]) == ("suspected", "false", "A speed bump.")
    assert review["reviewer"]
    assert listed(admin) == []
    assert listed(admin, status="false") == [accident]
    second = admin.post(url, json={"verdict": "confirmed"}).json()
    assert (second["before"], second["after"]) == ("false", "confirmed")
    assert listed(admin) == [accident]
    assert admin.get(f"/v1/accidents/{accident}").json()["properties"]["verdict"] == "confirmed"
    kept = admin.get(url).json()["reviews"]
    assert [one["verdict"] for one in kept] == ["confirmed", "false"]
    assert events(admin) == [("accident.retracted", "false"), ("accident.updated", "confirmed")]
    told = [one["data"]["review_id"] for one in admin.get("/v1/events").json()["events"]]
    assert told == [first.json()["id"], second["id"]]


def test_every_verdict_is_audited_without_what_was_noted(service, admin, tenant, pk):
    accident = add(service, tables.accidents, accident_row(tenant, pk, 0))
    for verdict in ("false", "confirmed"):
        admin.post(f"/v1/accidents/{accident}/reviews", json={"verdict": verdict, "note": "Mr X says"})
    page = admin.get("/v1/audit?limit=1").json()
    rest = admin.get("/v1/audit", params={"cursor": page["next_cursor"]}).json()
    trail = page["entries"] + rest["entries"]
    assert [one["detail"]["verdict"] for one in trail] == ["confirmed", "false"]
    assert {one["action"] for one in trail} == {"accident.reviewed"}
    assert {one["subject"] for one in trail} == {f"accident/{accident}"}
    assert all(one["actor"] for one in trail)
    assert "Mr X" not in str(trail)
    with service.client("somebody-else", "admin") as other:
        assert other.get("/v1/audit").json()["entries"] == []
    with service.client(tenant, "accidents:*", "vehicles:*") as client:
        assert client.get("/v1/audit").status_code == 403


def test_whoever_reads_may_not_judge_and_judging_has_a_scope_of_its_own(service, tenant, pk):
    accident = add(service, tables.accidents, accident_row(tenant, pk, 0))
    candidate = add(service, tables.accident_candidates, candidate_row(tenant, pk, 0))
    posts = [
        (f"/v1/accidents/{accident}/reviews", {"verdict": "false"}),
        (f"/v1/accident-candidates/{candidate}/reviews", {"verdict": "accident"}),
    ]
    for url, body in posts:
        with service.client(tenant, "accidents:read", "positions:read", "vehicles:*") as client:
            refused = client.post(url, json=body)
            assert (refused.status_code, refused.json()["scope"]) == (403, "accidents:review")
        with service.client("somebody-else", "admin") as client:
            assert client.post(url, json=body).status_code == 404
            assert client.get(url).status_code == 404
        with service.client(tenant, "accidents:review") as client:
            assert client.post(url, json=body).status_code == 201


def test_a_review_repeated_with_its_key_is_made_once(service, admin, tenant, pk):
    accident = add(service, tables.accidents, accident_row(tenant, pk, 0))
    url, headers = f"/v1/accidents/{accident}/reviews", {"Idempotency-Key": "k1"}
    answers = [admin.post(url, json={"verdict": "false"}, headers=headers).json() for _ in range(2)]
    assert answers[0] == answers[1]
    assert len(admin.get(url).json()["reviews"]) == len(events(admin)) == 1


@pytest.mark.parametrize("body", [{}, {"verdict": "maybe"}, {"verdict": "false", "note": "x" * 4001}, {"verdict": 1}])
def test_a_verdict_that_is_none_is_refused(service, admin, tenant, pk, body):
    accident = add(service, tables.accidents, accident_row(tenant, pk, 0))
    assert admin.post(f"/v1/accidents/{accident}/reviews", json=body).status_code == 422


def test_what_the_detector_says_later_does_not_overrule_a_person(service, admin, tenant, pk):
    row = accident_row(tenant, pk, 0, revision=0, status="suspected")
    accident = add(service, tables.accidents, row)
    admin.post(f"/v1/accidents/{accident}/reviews", json={"verdict": "false"})
    later = AccidentRow(
        **row | {"revision": 1, "status": "confirmed", "confidence": 0.999}, vehicle_id="car", trip_id=None
    )
    with write(service.database) as connection:
        assert accidents.put(connection, later).status == "false"
    properties = admin.get(f"/v1/accidents/{accident}").json()["properties"]
    assert (properties["status"], properties["revision"], properties["confidence"]) == ("false", 1, 0.999)


# --- What was taken for none --------------------------------------------------------------------------


def test_candidates_are_found_by_place_time_reason_and_vehicle(service, admin, tenant, pk):
    other = service.runtime.directory.register(tenant, "other").ref.pk
    pothole = add(service, tables.accident_candidates, candidate_row(tenant, pk, 0))
    bump = add(service, tables.accident_candidates, candidate_row(tenant, pk, 60, 10.0, 20.0, reason="speed_bump"))
    kerb = add(service, tables.accident_candidates, candidate_row(tenant, other, 120, reason="kerb", lat_deg=None))

    def found(**asked):
        body = admin.get("/v1/accident-candidates", params=asked).json()
        conforms("CandidateCollection", body)
        return [one["id"] for one in body["features"]]

    assert found() == [kerb, bump, pothole]
    assert found(bbox="11,57,12,58") == [pothole]
    assert found(datetime=f"{rfc3339(T0 + 60 * NS)}/..") == [kerb, bump]
    assert found(reason=["pothole", "kerb"]) == [kerb, pothole]
    assert found(vehicle="other") == [kerb]
    first = admin.get("/v1/accident-candidates?limit=2")
    assert [one["id"] for one in first.json()["features"]] == [kerb, bump]
    assert [one["id"] for one in admin.get(first.links["next"]["url"]).json()["features"]] == [pothole]
    feature = admin.get(f"/v1/accident-candidates/{pothole}").json()
    conforms("CandidateFeature", feature)
    assert feature["geometry"]["coordinates"] == [11.97, 57.7, 40.0]
    assert feature["properties"]["reason"] == "pothole"
    assert admin.get(f"/v1/accident-candidates/{kerb}").json()["geometry"] is None
    assert admin.get("/v1/accident-candidates?reason=moose").status_code == 422
    with service.client("somebody-else", "admin") as client:
        assert client.get(f"/v1/accident-candidates/{pothole}").status_code == 404
        assert client.get("/v1/accident-candidates").json()["features"] == []
    with service.client(tenant, "vehicles:read") as client:
        assert client.get("/v1/accident-candidates").status_code == 403


def test_a_candidate_that_was_an_accident_becomes_one_and_a_later_verdict_takes_it_back(service, admin, tenant, pk):
    candidate = add(service, tables.accident_candidates, candidate_row(tenant, pk, 0))
    url = f"/v1/accident-candidates/{candidate}/reviews"
    assert admin.post(url, json={"verdict": "no_accident"}).json()["accident_id"] is None
    assert listed(admin) == events(admin) == []
    said = admin.post(url, json={"verdict": "accident", "note": "A deer."}).json()
    assert (said["before"], said["after"]) == ("no_accident", "accident")
    (accident,) = listed(admin)
    assert said["accident_id"] == accident
    properties = admin.get(f"/v1/accidents/{accident}").json()["properties"]
    assert (properties["status"], properties["detector"], properties["pdof_deg"]) == ("confirmed", "reviewer", None)
    assert properties["delta_v_mps"] == 1.6
    assert properties["evidence"] in ("pending", "partial", "failed")
    admin.post(url, json={"verdict": "no_accident"})
    assert listed(admin) == []
    assert listed(admin, status="false") == [accident]
    assert events(admin) == [("accident.detected", "confirmed"), ("accident.retracted", "false")]
    kept = admin.get(url).json()["reviews"]
    assert [one["verdict"] for one in kept] == ["no_accident", "accident", "no_accident"]
    assert kept[0]["accident_id"] == accident
    with read(service.database) as connection:
        assert connection.scalar(select(tables.accident_candidates.c.verdict)) in ("no_accident", "accident")


def test_reviews_go_with_their_vehicle_and_the_audit_stays(service, admin, tenant, pk):
    accident = add(service, tables.accidents, accident_row(tenant, pk, 0))
    admin.post(f"/v1/accidents/{accident}/reviews", json={"verdict": "false", "note": "gone soon"})
    assert admin.delete("/v1/vehicles/car").status_code == 204
    with read(service.database) as connection:
        mine = select(tables.reviews.c.id).where(tables.reviews.c.tenant_id == tenant)
        assert connection.execute(mine).all() == []
    actions = [one["action"] for one in admin.get("/v1/audit").json()["entries"]]
    assert actions == ["vehicle.erased", "accident.reviewed"]
