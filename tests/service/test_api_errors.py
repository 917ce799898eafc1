"""What callers get when something is wrong, and what every answer carries."""

from __future__ import annotations

import json
import logging
import re

import httpx
import pytest
from fastapi import APIRouter

from service.api.middleware import MAX_BODY_BYTES
from service.api.problems import FOREIGN_ERRORS
from service.errors import ServiceError
from service.settings import Settings
from service.storage.database import write
from tests.conftest import run_service
from tests.service.webhook_harness import eventually

JSON = {"Content-Type": "application/json"}


@pytest.fixture
def admin(service, tenant):
    with service.client(tenant, "admin") as client:
        yield client


def check_problem(answer, status, code):
    assert answer.status_code == status, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    problem = answer.json()
    assert (problem["status"], problem["code"]) == (status, code)
    assert problem["title"]
    assert problem["detail"]
    assert problem["request_id"] == answer.headers["x-request-id"]
    return problem


def test_unknown_paths_and_methods_are_problems_too(admin):
    check_problem(admin.get("/v2/vehicles"), 404, "not_found")
    check_problem(admin.get("/v1/vehicles/none"), 404, "not_found")
    refused = admin.patch("/v1/vehicles/a")
    check_problem(refused, 405, "method_not_allowed")
    assert set(refused.headers["allow"].split(", ")) == {"GET", "PUT", "DELETE"}


@pytest.mark.parametrize(
    ("content", "status", "code"),
    [
        (b"{", 400, "invalid_json"),
        (b"\xff\xff", 400, "bad_request"),
        (b"", 422, "invalid_request"),
        (b"[" * 100_000, 400, "bad_request"),
        (b'{"config": ' + b"1" * 10_000 + b"}", 400, "bad_request"),
        (b'{"config": {"detector": "\\ud800"}}', 422, "invalid_request"),
    ],
)
def test_a_body_that_cannot_be_read_is_the_callers_mistake(admin, content, status, code):
    check_problem(admin.put("/v1/vehicles/a", content=content, headers=JSON), status, code)


def test_every_thing_wrong_is_named(admin):
    body = {"config": {"detector": "x", "gnss_time_offset_s": 99}, "more": 1}
    problem = check_problem(admin.put("/v1/vehicles/a", json=body), 422, "invalid_request")
    assert {error["location"] for error in problem["errors"]} == {
        "body.config.detector",
        "body.config.gnss_time_offset_s",
        "body.more",
    }
    assert "2 more" in problem["detail"]


@pytest.mark.parametrize("declared", [True, False])
def test_a_body_is_read_no_further_than_it_may_be_long(admin, declared):
    content = b" " * (MAX_BODY_BYTES + 1)

    def chunks():
        for start in range(0, len(content), 65536):
            yield content[start : start + 65536]

    answer = admin.put("/v1/vehicles/a", content=content if declared else chunks(), headers=JSON)
    check_problem(answer, 413, "body_too_large")
    fits = admin.put("/v1/vehicles/a", content=b"{}".ljust(MAX_BODY_BYTES), headers=JSON)
    assert fits.status_code == 201


def test_a_request_id_is_taken_over_if_it_is_one(service):
    def told(given):
        return httpx.get(f"{service.url}/livez", headers={"X-Request-Id": given}).headers["x-request-id"]

    assert told("my-request.1") == "my-request.1"
    for other in ("", "x" * 65, "a b", "<script>"):
        assert re.fullmatch(r"[0-9a-f]{32}", told(other))


@pytest.mark.parametrize("path", ["/livez", "/v1/vehicles", "/nowhere", "/docs", "/openapi.json"])
def test_every_answer_protects_whoever_shows_it(service, path):
    headers = httpx.get(service.url + path).headers
    assert headers["x-content-type-options"] == "nosniff"
    assert "default-src 'none'" in headers["content-security-policy"]
    assert "frame-ancestors 'none'" in headers["content-security-policy"]
    assert headers["cache-control"]
    assert "server" not in headers


def test_an_answer_for_one_key_is_kept_by_no_shared_cache(admin):
    admin.put("/v1/vehicles/a", json={})
    headers = admin.get("/v1/vehicles/a").headers
    assert (headers["cache-control"], headers["vary"]) == ("private, no-cache", "Authorization")


def test_the_reference_needs_nothing_from_elsewhere(service):
    page = httpx.get(f"{service.url}/docs").text
    assert "/v1/vehicles/{vehicle_id}/trips" in page
    assert "<script" not in page
    assert not re.findall(r"""(?:src|href)=['"]?https?:""", page)


def test_codes_are_stable_words_and_statuses_are_errors():
    def classes(base):
        return {base}.union(*(classes(each) for each in base.__subclasses__()))

    for error in classes(ServiceError):
        assert re.fullmatch(r"[a-z][a-z_]*", error.code), error
        assert 400 <= error.status < 600, error
    for status, code, _ in FOREIGN_ERRORS.values():
        assert re.fullmatch(r"[a-z][a-z_]*", code)
        assert 400 <= status < 600


# --- operation --------------------------------------------------------------------------------------


def test_ready_while_everything_works_and_counted(service):
    assert httpx.get(f"{service.url}/livez").json() == {"status": "ok"}
    ready = httpx.get(f"{service.url}/readyz")
    assert (ready.status_code, ready.json()["status"]) == (200, "ready")
    assert ready.json()["checks"]["database"] == ready.json()["checks"]["engine"] == "ok"
    metrics = httpx.get(f"{service.url}/metrics")
    assert metrics.headers["content-type"].startswith("text/plain")
    counted = 'telefuse_http_request_seconds_count{operation="get_readiness",status="200"}'
    eventually(lambda: counted in httpx.get(f"{service.url}/metrics").text)
    for name in ("packets_accepted_total", "journal_queue", "engine_backlog", "vehicles_active"):
        assert f"telefuse_{name}" in metrics.text


def test_made_up_paths_do_not_grow_the_metrics(service):
    for number in range(3):
        httpx.get(f"{service.url}/made-up-{number}")
        httpx.get(f"{service.url}/v1/vehicles/made-up-{number}")
    assert "made-up" not in httpx.get(f"{service.url}/metrics").text


@pytest.fixture
def own(tmp_path):
    """A service of the test's own, to be broken."""
    with run_service(Settings(data_dir=tmp_path, auth="off", zenoh_mode="off", workers=1)) as running:
        yield running


def test_not_ready_when_the_database_is_not_what_it_should_be(own):
    with write(own.database) as connection:
        connection.exec_driver_sql("UPDATE alembic_version SET version_num = '0000'")
    answer = httpx.get(own.url + "/readyz")
    assert (answer.status_code, answer.json()["status"]) == (503, "not_ready")
    assert answer.json()["checks"]["database"] == "failed"


def test_a_database_that_fails_is_a_problem_to_be_tried_again(own):
    with write(own.database) as connection:
        connection.exec_driver_sql("ALTER TABLE accidents RENAME TO elsewhere")
    answer = httpx.get(own.url + "/v1/accidents")
    check_problem(answer, 503, "database_unavailable")
    assert answer.headers["retry-after"] == "1"
    assert "elsewhere" not in answer.text
    assert "SELECT" not in answer.text


def test_a_mistake_of_ours_tells_the_caller_nothing_but_an_id_to_quote(own, caplog):
    broken = APIRouter()

    @broken.get("/broken")
    def fail():
        raise RuntimeError("hunter2")

    own.app.include_router(broken)
    with caplog.at_level(logging.ERROR):
        answer = httpx.get(own.url + "/broken")
    problem = check_problem(answer, 500, "internal_error")
    assert "hunter2" not in answer.text
    assert "Traceback" not in answer.text
    (record,) = [record for record in caplog.records if record.exc_info]
    assert record.fields["request_id"] == problem["request_id"]


def test_the_log_names_caller_and_path_but_nothing_secret(service, tenant, caplog):
    token = service.token(tenant, "vehicles:read")

    def lines():
        return [record for record in caplog.records if record.name == "telefuse.access"]

    with caplog.at_level(logging.DEBUG, logger="telefuse.access"):
        for count, url in enumerate(("/v1/vehicles?cursor=hidden", "/livez"), start=1):
            httpx.get(service.url + url, headers={"Authorization": f"Bearer {token}"})
            eventually(lambda count=count: len(lines()) == count)  # a line comes after its answer
    first, second = lines()
    assert (first.levelno, second.levelno) == (logging.INFO, logging.DEBUG)
    assert first.fields["tenant"] == tenant
    assert first.fields["key"] == token.split("_")[1]
    assert (first.fields["path"], first.fields["status"]) == ("/v1/vehicles", 422)
    written = json.dumps([record.__dict__ for record in caplog.records], default=str)
    assert token.split("_", 2)[2] not in written
    assert "hidden" not in json.dumps(first.fields)


# --- requests that are repeated ---------------------------------------------------------------------


def test_a_repeated_post_makes_one_thing_and_gets_the_same_answer(admin):
    body = {"url": "https://hooks.example.com/telefuse"}
    key = {"Idempotency-Key": "once-1"}
    first = admin.post("/v1/webhook-endpoints", json=body, headers=key)
    assert first.status_code == 201, first.text
    again = admin.post("/v1/webhook-endpoints", json=body, headers=key)
    assert (again.status_code, again.json()) == (201, first.json())
    assert again.headers["location"] == first.headers["location"]
    assert (again.headers["idempotency-replayed"], "idempotency-replayed" in first.headers) == ("true", False)
    assert len(admin.get("/v1/webhook-endpoints").json()["endpoints"]) == 1


def test_a_key_is_for_one_request_of_one_tenant(service, admin, tenant):
    body = {"url": "https://hooks.example.com/telefuse"}
    key = {"Idempotency-Key": "once-2"}
    admin.post("/v1/webhook-endpoints", json=body, headers=key)
    other = admin.post("/v1/webhook-endpoints", json={"url": "https://hooks.example.com/other"}, headers=key)
    check_problem(other, 422, "idempotency_key_reused")
    with service.client(f"not-{tenant}", "admin") as stranger:
        answer = stranger.post("/v1/webhook-endpoints", json=body, headers=key)
        assert answer.status_code == 201
        assert "idempotency-replayed" not in answer.headers


def test_a_post_that_failed_may_be_sent_again_with_its_key(admin):
    key = {"Idempotency-Key": "once-3"}
    assert admin.post("/v1/webhook-endpoints", json={"url": "http://127.0.0.1"}, headers=key).status_code == 422
    answer = admin.post("/v1/webhook-endpoints", json={"url": "https://hooks.example.com/x"}, headers=key)
    assert answer.status_code == 201


@pytest.mark.parametrize("key", ["", "x" * 256, "a b"])
def test_a_key_that_is_none_is_refused(admin, key):
    answer = admin.post("/v1/webhook-endpoints", json={"url": "https://x.example"}, headers={"Idempotency-Key": key})
    check_problem(answer, 422, "invalid_request")
