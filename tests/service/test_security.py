"""Keys, scopes and tenants: who gets in, what they may do, and that nothing of another tenant shows."""

from __future__ import annotations

import hashlib
import time

import httpx
import pytest
from sqlalchemy import insert, select
from starlette.requests import HTTPConnection

from service.api.security import REVOCATION_DELAY_S, SCOPES, Authenticator, Principal, authenticate
from service.errors import UnauthenticatedError
from service.storage import keys, tables, tenants
from service.storage.database import read, write
from tests.service.stored_rows import NS, accident_row, point_row, trip_row


def make_key(engine, *scopes, tenant="acme", expires_ns=None):
    with write(engine) as connection:
        tenants.ensure(connection, tenant)
        return keys.create(connection, tenant, "test", scopes or ["admin"], expires_ns)


# --- keys -------------------------------------------------------------------------------------------


def test_a_key_opens_its_tenant_with_its_scopes(any_database):
    key, token = make_key(any_database, "vehicles:read", "accidents:read")
    assert token.startswith(f"tf_{key.id}_")
    assert authenticate(any_database, token) == Principal(
        "acme", key.id, frozenset({"vehicles:read", "accidents:read"})
    )


def test_only_a_hash_is_stored(any_database):
    key, token = make_key(any_database)
    with read(any_database) as connection:
        row = connection.execute(select(tables.api_keys)).one()
    assert row.key_sha256 == hashlib.sha256(token.encode()).hexdigest()
    assert token.removeprefix(f"tf_{key.id}_") not in str(row)  # the whole secret, in which _ may stand


@pytest.mark.parametrize(
    "spoil", [lambda t: t[:-1], lambda t: t + "x", str.upper, lambda t: "tf_" + t, lambda t: t[3:]]
)
def test_a_key_that_is_not_quite_right_opens_nothing(any_database, spoil):
    _, token = make_key(any_database)
    with pytest.raises(UnauthenticatedError):
        authenticate(any_database, spoil(token))


@pytest.mark.parametrize("token", ["", "tf_", "tf__", "tf_x_y", "tf_\0_y", "a_b_c", "tf_ä_ö", "'; DROP TABLE api_keys"])
def test_what_is_no_key_opens_nothing(any_database, token):
    with pytest.raises(UnauthenticatedError):
        authenticate(any_database, token)


def test_expired_and_revoked_keys_open_nothing(any_database):
    _, expired = make_key(any_database, expires_ns=time.time_ns() - 1)
    key, revoked = make_key(any_database, expires_ns=time.time_ns() + 3600 * NS)
    authenticate(any_database, revoked)
    with write(any_database) as connection:
        assert keys.revoke(connection, key.id)
        assert not keys.revoke(connection, "none")
    for token in (expired, revoked):
        with pytest.raises(UnauthenticatedError):
            authenticate(any_database, token)


def test_scopes_by_name_by_star_and_as_admin():
    def may(*scopes):
        return {scope for scope in SCOPES if Principal("t", "k", frozenset(scopes)).may(scope)}

    assert may("vehicles:read") == {"vehicles:read"}
    assert may("vehicles:*", "scores:read") == {"vehicles:read", "vehicles:write", "scores:read"}
    assert may("admin") == set(SCOPES)
    assert may() == may("*") == may(":*") == set()


# --- over HTTP --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "headers",
    [
        {},
        {"Authorization": "Bearer tf_0123456789ab_none"},
        {"Authorization": "Basic dTpw"},
        {"Authorization": "Bearer"},
    ],
)
def test_without_a_good_key_nothing_under_v1_answers(service, headers):
    document = httpx.get(f"{service.url}/openapi.json").json()
    asked = 0
    for path, operations in document["paths"].items():
        if not path.startswith("/v1/"):
            continue
        for method in operations:
            url = service.url + path.replace("{delivery_id}", "1").replace("{", "").replace("}", "")
            answer = httpx.request(method, url, headers={**headers, "Content-Type": "application/json"}, content=b"{}")
            assert (answer.status_code, answer.json()["code"]) == (401, "unauthenticated"), (method, path)
            assert answer.headers["www-authenticate"] == "Bearer"
            asked += 1
    assert asked > 15


def test_a_scope_that_lacks_is_named(service, tenant):
    with service.client(tenant, "scores:read") as client:
        answer = client.get("/v1/vehicles")
    assert answer.status_code == 403
    assert answer.json()["code"] == "forbidden"
    assert answer.json()["scope"] == "vehicles:read"


def test_reading_does_not_let_write(service, tenant):
    with service.client(tenant, "vehicles:read", "webhooks:read") as client:
        for method, path in [
            ("PUT", "/v1/vehicles/a"),
            ("DELETE", "/v1/vehicles/a"),
            ("PUT", "/v1/vehicles/a/calibration"),
            ("POST", "/v1/webhook-endpoints"),
        ]:
            assert client.request(method, path, json={"url": "https://example.com"}).status_code == 403, (method, path)


@pytest.fixture
def history(service, tenant):
    """A vehicle of the tenant with a trip, its track and an accident."""
    pk = service.runtime.directory.register(tenant, "car").ref.pk
    trip, accident = trip_row(pk, 0, 2), accident_row(tenant, pk, 1)
    with write(service.database) as connection:
        connection.execute(insert(tables.trips), [trip])
        connection.execute(insert(tables.accidents), [accident])
        connection.execute(insert(tables.track_points), [point_row(pk, second) for second in range(3)])
    return {"trip": trip["id"], "accident": accident["id"]}


def test_an_insurer_without_positions_sees_figures_and_accidents_but_never_a_track(service, tenant, history):
    with service.client(tenant, "vehicles:read", "accidents:read", "scores:read") as insurer:
        assert insurer.get(f"/v1/trips/{history['trip']}/track").status_code == 403
        assert insurer.get("/v1/vehicles/car/state").json()["fused"] is None
        for trip in (
            insurer.get(f"/v1/trips/{history['trip']}").json(),
            *insurer.get("/v1/vehicles/car/trips").json()["trips"],
        ):
            assert trip["distance_m"] == 1650.5
            assert trip["start"] is trip["end"] is None
        assert insurer.get(f"/v1/accidents/{history['accident']}").json()["geometry"]["type"] == "Point"
    with service.client(tenant, "vehicles:read", "positions:read") as fleet:
        assert fleet.get(f"/v1/trips/{history['trip']}/track").status_code == 200
        assert fleet.get(f"/v1/trips/{history['trip']}").json()["start"] == {"lat_deg": 57.7, "lon_deg": 11.97}
        assert fleet.get("/v1/vehicles/car/state").json()["fused"]["lat_deg"] == 57.7


def test_another_tenant_finds_nothing_there(service, tenant, history):
    with service.client(f"not-{tenant}", "admin") as stranger:
        for path in (
            "/v1/vehicles/car",
            "/v1/vehicles/car/state",
            "/v1/vehicles/car/trips",
            "/v1/vehicles/car/calibration",
            f"/v1/trips/{history['trip']}",
            f"/v1/trips/{history['trip']}/track",
            f"/v1/accidents/{history['accident']}",
        ):
            there, nowhere = stranger.get(path), stranger.get(path.replace("car", "nocar").replace("-", "0"))
            assert there.status_code == nowhere.status_code == 404, path
            assert there.json()["code"] == nowhere.json()["code"] == "not_found"
        assert stranger.get("/v1/vehicles").json()["vehicles"] == []
        assert stranger.get("/v1/accidents").json()["features"] == []
        assert stranger.get("/v1/events").json()["events"] == []
        assert stranger.delete("/v1/vehicles/car").status_code == 404
        assert stranger.put("/v1/vehicles/car", json={}).status_code == 201, "names are a tenant's own"
    assert service.runtime.directory.resolve(tenant, "car") is not None


def test_a_revoked_key_is_shut_out_once_its_grace_is_over(database):
    now_s = [1000.0]
    authenticator = Authenticator(database, required=True, monotonic_s=lambda: now_s[0])
    key, token = make_key(database)
    asked = HTTPConnection({"type": "http", "headers": [(b"authorization", f"Bearer {token}".encode())]})
    assert authenticator.remembered(asked) is None
    assert authenticator.principal(asked).key_id == key.id
    with write(database) as connection:
        keys.revoke(connection, key.id)
    now_s[0] += REVOCATION_DELAY_S - 0.1
    assert authenticator.remembered(asked) is not None
    now_s[0] += 0.2
    assert authenticator.remembered(asked) is None
    with pytest.raises(UnauthenticatedError):
        authenticator.principal(asked)
