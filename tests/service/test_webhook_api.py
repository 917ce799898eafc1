"""Webhooks over REST, in the running service: set up, secret, test, deliveries, replay, and who may."""

from __future__ import annotations

import itertools

import pytest
from starlette.testclient import TestClient

from service.app import create_app
from service.runtime import Runtime
from service.settings import Settings
from service.storage import keys, tenants
from service.storage.database import write
from tests.service.webhook_harness import Outbox, eventually
from tests.service.webhook_receiver import Answer

PATH = "/v1/webhook-endpoints"

_numbers = itertools.count(1)


@pytest.fixture(scope="module")
def app(tmp_path_factory, migrated_sqlite_file):
    """The whole service without its Zenoh router; private targets allowed, as the receivers are on loopback."""
    settings = Settings(
        data_dir=tmp_path_factory.mktemp("data"), zenoh_mode="off", dangerous_allow_private_webhook_targets=True
    )
    app = create_app(settings, Runtime(settings))
    with TestClient(app):
        yield app


@pytest.fixture
def api_of(app):
    """A client for a tenant with scopes; each tenant sees its own."""

    def make(tenant_id, *scopes):
        with write(app.state.runtime.database) as connection:
            tenants.ensure(connection, tenant_id)
            _, token = keys.create(connection, tenant_id, "test", scopes)
        return TestClient(app, headers={"Authorization": f"Bearer {token}"})

    return make


@pytest.fixture
def tenant_id():
    return f"tenant-{next(_numbers)}"


@pytest.fixture
def api(api_of, tenant_id):
    return api_of(tenant_id, "webhooks:*")


@pytest.fixture
def outbox(app, tenant_id):
    return Outbox(app.state.runtime.database, tenant_id=tenant_id)


def create(api, url="https://example.com/hooks", **settings):
    response = api.post(PATH, json={"url": url, **settings})
    assert response.status_code == 201, response.text
    return response.json()


def deliveries(api, endpoint, **query):
    response = api.get(f"{PATH}/{endpoint['id']}/deliveries", params=query)
    assert response.status_code == 200, response.text
    return response.json()["deliveries"]


def problem(response, status, code):
    assert response.status_code == status, response.text
    assert response.headers["content-type"] == "application/problem+json"
    assert response.json()["code"] == code
    return response.json()["detail"]


def test_endpoint_is_made_with_a_secret_that_is_shown_once(api):
    response = api.post(PATH, json={"url": "https://example.com/hooks", "types": ["accident.detected"]})
    made = response.json()
    assert response.headers["location"] == f"{PATH}/{made['id']}"
    assert response.headers["cache-control"] == "no-store"
    assert made.pop("secret").startswith("whsec_")
    assert made["types"] == ["accident.detected"]
    assert made["status"] == "enabled"
    assert api.get(f"{PATH}/{made['id']}").json() == made
    assert api.get(PATH).json() == {"endpoints": [made], "next_cursor": None}


def test_repeated_creation_with_its_key_makes_one_endpoint(api):
    first = api.post(PATH, json={"url": "https://example.com/"}, headers={"Idempotency-Key": "k1"})
    again = api.post(PATH, json={"url": "https://example.com/"}, headers={"Idempotency-Key": "k1"})
    assert again.status_code == 201
    assert again.json() == first.json()
    assert len(api.get(PATH).json()["endpoints"]) == 1


def test_endpoints_come_in_pages(api):
    made = [create(api, f"https://example.com/{number}")["id"] for number in range(5)]
    seen, url = [], f"{PATH}?limit=2"
    while url:
        response = api.get(url)
        seen += [endpoint["id"] for endpoint in response.json()["endpoints"]]
        url = response.links.get("next", {}).get("url")
    assert seen == made


def test_endpoint_is_changed_in_part_or_replaced(api):
    endpoint = create(api, types=["trip.completed"], description="ours")
    path = f"{PATH}/{endpoint['id']}"
    changed = api.patch(path, json={"description": "theirs"}).json()
    assert (changed["description"], changed["types"], changed["url"]) == ("theirs", ["trip.completed"], endpoint["url"])
    replaced = api.put(path, json={"url": "https://example.org/"}).json()
    assert (replaced["url"], replaced["description"], replaced["types"]) == ("https://example.org/", "", [])
    assert api.get(path).json() == replaced


def test_change_meets_what_its_author_knew(api):
    path = f"{PATH}/{create(api)['id']}"
    tag = api.get(path).headers["etag"]
    assert api.patch(path, json={"description": "one"}, headers={"If-Match": tag}).status_code == 200
    problem(api.patch(path, json={"description": "two"}, headers={"If-Match": tag}), 412, "precondition_failed")


def test_removed_endpoint_is_gone(api):
    path = f"{PATH}/{create(api)['id']}"
    assert api.delete(path).status_code == 204
    problem(api.get(path), 404, "not_found")
    problem(api.delete(path), 404, "not_found")
    problem(api.post(f"{path}:test"), 404, "not_found")


@pytest.mark.parametrize("url", ["ftp://example.com/", "https://user:pw@example.com/", "example.com", "https://"])
def test_url_that_cannot_work_is_refused_with_a_reason(api, url):
    assert "webhook URL" in problem(api.post(PATH, json={"url": url}), 422, "webhook_target_refused")
    problem(api.patch(f"{PATH}/{create(api)['id']}", json={"url": url}), 422, "webhook_target_refused")


@pytest.mark.parametrize(
    "body",
    [
        {},
        {"url": ""},
        {"url": "https://example.com/" + "x" * 2048},
        {"url": "https://example.com/", "types": ["accident.invented"]},
        {"url": "https://example.com/", "types": ["ping"]},
        {"url": "https://example.com/", "description": "x" * 501},
        {"url": "https://example.com/", "description": "a\u0000b"},
        {"url": "https://example.com/", "status": "paused"},
        {"url": "https://example.com/", "secret": "whsec_mine"},
    ],
)
def test_wrong_body_is_refused(api, body):
    problem(api.post(PATH, json=body), 422, "invalid_request")


def test_ping_arrives_verified_and_its_delivery_tells_so(api, receiver):
    endpoint = create(api, receiver.url(), types=["trip.completed"])
    response = api.post(f"{PATH}/{endpoint['id']}:test")
    assert response.status_code == 202
    assert (response.json()["event_type"], response.json()["status"]) == ("ping", "pending")
    (request,) = receiver.wait_for(1)
    message = request.verify(endpoint["secret"])
    assert (message["type"], message["data"]["endpoint_id"]) == ("ping", endpoint["id"])
    (delivery,) = eventually(lambda: deliveries(api, endpoint, status="delivered"))
    assert delivery["id"] == response.json()["id"]
    assert (delivery["event_id"], delivery["attempts"], delivery["last_status_code"]) == (request.id, 1, 204)
    (attempt,) = delivery["history"]
    assert (attempt["status_code"], attempt["error"]) == (204, None)
    assert attempt["duration_ms"] > 0


def test_both_secrets_verify_while_one_takes_over(api, receiver):
    endpoint = create(api, receiver.url())
    rotated = api.post(f"{PATH}/{endpoint['id']}:rotate-secret")
    assert rotated.status_code == 200
    assert rotated.headers["cache-control"] == "no-store"
    api.post(f"{PATH}/{endpoint['id']}:test")
    (request,) = receiver.wait_for(1)
    assert request.verify(endpoint["secret"]) == request.verify(rotated.json()["secret"])

    at_once = api.post(f"{PATH}/{endpoint['id']}:rotate-secret", json={"overlap_s": 0}).json()["secret"]
    api.post(f"{PATH}/{endpoint['id']}:test")
    request = receiver.wait_for(2)[1]
    assert request.verify(at_once)
    assert len(request.headers["webhook-signature"].split(" ")) == 1


def test_failed_delivery_is_shown_and_replayed(api, receiver, outbox):
    endpoint = create(api, receiver.url())
    receiver.default = Answer(500)
    api.post(f"{PATH}/{endpoint['id']}:test")
    (failed,) = eventually(lambda: [d for d in deliveries(api, endpoint, status="pending") if d["last_error"]])
    assert failed["last_error"] == "HTTP 500"
    assert failed["next_attempt_at"] is not None
    receiver.default = Answer()
    replayed = api.post(f"{PATH}/{endpoint['id']}/deliveries/{failed['id']}:replay")
    assert replayed.status_code == 202
    (delivered,) = eventually(lambda: deliveries(api, endpoint, status="delivered"))
    assert delivered["id"] == failed["id"]
    assert [attempt["status_code"] for attempt in delivered["history"]][-1] == 204
    assert len({request.id for request in receiver.requests}) == 1


def test_deliveries_come_in_pages_newest_first(api, outbox, receiver):
    endpoint = create(api, receiver.url())
    events = [outbox.publish() for _ in range(5)]
    first = api.get(f"{PATH}/{endpoint['id']}/deliveries?limit=3")
    second = api.get(first.links["next"]["url"])
    found = [delivery["event_id"] for page in (first, second) for delivery in page.json()["deliveries"]]
    assert found == events[::-1]
    assert second.json()["next_cursor"] is None


def test_disabling_cancels_what_waits_and_replay_brings_it_back(api, outbox, receiver):
    endpoint = create(api, receiver.url())
    path = f"{PATH}/{endpoint['id']}"
    receiver.default = Answer(503, {"Retry-After": "3600"})
    outbox.publish()
    eventually(lambda: [d for d in deliveries(api, endpoint) if d["attempts"] == 1 and d["last_error"]])
    assert api.patch(path, json={"status": "disabled"}).json()["status"] == "disabled"
    (cancelled,) = deliveries(api, endpoint, status="cancelled")
    replay = f"{path}/deliveries/{cancelled['id']}:replay"
    assert "enable it" in problem(api.post(replay), 409, "conflict")
    assert "enable it" in problem(api.post(f"{path}:test"), 409, "conflict")
    receiver.default = Answer()
    api.patch(path, json={"status": "enabled"})
    assert api.post(replay).status_code == 202
    eventually(lambda: deliveries(api, endpoint, status="delivered"))


def test_another_tenants_endpoint_does_not_exist(api, api_of, tenant_id, outbox, receiver):
    endpoint = create(api, receiver.url())
    other = api_of(f"{tenant_id}-other", "admin")
    path = f"{PATH}/{endpoint['id']}"
    assert other.get(PATH).json()["endpoints"] == []
    for response in (
        other.get(path),
        other.patch(path, json={}),
        other.put(path, json={"url": "https://example.com/"}),
        other.delete(path),
        other.post(f"{path}:test"),
        other.post(f"{path}:rotate-secret"),
        other.get(f"{path}/deliveries"),
        other.post(f"{path}/deliveries/1:replay"),
    ):
        problem(response, 404, "not_found")


def test_delivery_of_another_endpoint_is_not_replayed(api, outbox, receiver):
    one, two = create(api, receiver.url("/1")), create(api, receiver.url("/2"))
    outbox.publish()
    (delivery,) = deliveries(api, one)
    problem(api.post(f"{PATH}/{two['id']}/deliveries/{delivery['id']}:replay"), 404, "not_found")


def test_scopes_decide(app, api_of, tenant_id):
    reader = api_of(tenant_id, "webhooks:read")
    assert reader.get(PATH).status_code == 200
    problem(reader.post(PATH, json={"url": "https://example.com/"}), 403, "forbidden")
    problem(api_of(tenant_id, "vehicles:*").get(PATH), 403, "forbidden")
    problem(TestClient(app).get(PATH), 401, "unauthenticated")


def test_a_tenant_has_a_bounded_number_of_endpoints(api):
    for number in range(50):
        create(api, f"https://example.com/{number}")
    problem(api.post(PATH, json={"url": "https://example.com/"}), 409, "conflict")


@pytest.mark.parametrize("path", ["nothing", "0b5cd8e4-93f3-5f5a-8f0c-6e9b8f0f2c11", "a/deliveries"])
def test_unknown_endpoint_is_not_found(api, path):
    problem(api.get(f"{PATH}/{path}"), 404, "not_found")
