"""Vehicles over HTTP: registering, changing, paging, removing, state."""

from __future__ import annotations

import zlib
from concurrent.futures import ThreadPoolExecutor

import httpx
import pytest
from sqlalchemy import func, insert, select

from core.navigation.sensor_noise import matched_tuning
from core.navigation.tuning import Tuning
from core.sensors import TriadNoise
from service.engine.sessions import session_config
from service.storage import tables, vehicles
from service.storage.database import read, write
from tests.service.stored_rows import NS, T0, point_row


@pytest.fixture(scope="module")
def service(any_service):
    return any_service


@pytest.fixture
def admin(service, tenant):
    with service.client(tenant, "admin") as client:
        yield client


def pk_of(service, tenant, vehicle_id):
    with read(service.database) as connection:
        return vehicles.find(connection, tenant, vehicle_id).ref.pk


def test_registering_returns_the_keys_that_the_box_writes_to(admin, tenant):
    answer = admin.put("/v1/vehicles/WVWZZZ1KZAW000001", json={})
    assert answer.status_code == 201
    assert answer.headers["location"] == "/v1/vehicles/WVWZZZ1KZAW000001"
    bucket = f"{zlib.crc32(f'{tenant}/WVWZZZ1KZAW000001'.encode()) & 0xFF:02x}"
    assert answer.json()["zenoh_prefix"] == f"telefuse/v1/{tenant}/{bucket}/WVWZZZ1KZAW000001"
    assert admin.get("/v1/vehicles/WVWZZZ1KZAW000001").json() == answer.json()


def test_changing_replaces_the_settings_and_reaches_the_running_service(service, admin, tenant):
    admin.put("/v1/vehicles/a", json={"config": {"detector": "paper", "mounting_rpy_deg": [0, 0, 90]}})
    changed = admin.put("/v1/vehicles/a", json={"config": {"gnss_time_offset_s": 0.1}})
    assert changed.status_code == 200
    assert changed.json()["config"]["detector"] == "telefuse"
    assert changed.json()["config"]["mounting_rpy_deg"] is None
    assert service.runtime.directory.resolve(tenant, "a").config.gnss_time_offset_s == 0.1


@pytest.mark.parametrize(
    ("body", "location"),
    [
        ({"config": {"detector": "magic"}}, "body.config.detector"),
        ({"config": {"mounting_rpy_deg": [0, 0]}}, "body.config.mounting_rpy_deg.2"),
        ({"config": {"imu_lever_arm_m": [0, 0, 1e9]}}, "body.config.imu_lever_arm_m.2"),
        ({"config": {"accel_full_scale_mps2": -1}}, "body.config.accel_full_scale_mps2"),
        ({"config": {"colour": "red"}}, "body.config.colour"),
        (
            {"config": {"noise": {"gyroscope": {"random_walk": [0.3, 0.3, 0.3]}}}},
            "body.config.noise.gyroscope.random_walk.0",
        ),
        (
            {"config": {"noise": {"gyroscope": {"random_walk": [1e-4, 0, 1e-4]}}}},
            "body.config.noise.gyroscope.random_walk.1",
        ),
        ({"config": {"noise": {"gyroscope": {"random_walk": 1e-4}}}}, "body.config.noise.gyroscope.random_walk"),
        (
            {"config": {"noise": {"accelerometer": {"bias_instability": [1]}}}},
            "body.config.noise.accelerometer.bias_instability.1",
        ),
        ({"config": {"noise": {"magnetometer": {}}}}, "body.config.noise.magnetometer"),
        ({"name": "x"}, "body.name"),
        ([], "body"),
    ],
)
def test_wrong_settings_are_refused_by_name(admin, body, location):
    answer = admin.put("/v1/vehicles/a", json=body)
    assert answer.status_code == 422
    problem = answer.json()
    assert problem["code"] == "invalid_request"
    assert location in [error["location"] for error in problem["errors"]]
    assert admin.get("/v1/vehicles/a").status_code == 404


def test_the_noise_of_the_sensors_reaches_the_session(service, admin, tenant):
    interval = [[9e-4, 1.1e-3]] * 3
    noise = {
        "accelerometer": {"random_walk": [1e-3, 2e-3, 1e-3], "interval95": {"random_walk": interval}},
        "gyroscope": {"random_walk": [1e-4] * 3, "rate_random_walk": [0] * 3, "turn_on_bias_sd": [0.001, 5e-4, 1e-3]},
    }
    answer = admin.put("/v1/vehicles/a", json={"config": {"noise": noise}})
    assert answer.status_code == 201
    stored = answer.json()["config"]["noise"]
    assert stored["gyroscope"]["turn_on_bias_sd"] == [0.001, 5e-4, 1e-3]
    assert admin.put("/v1/vehicles/a", json={"config": {"noise": stored}}).json()["config"]["noise"] == stored
    tuning = session_config(service.runtime.directory.resolve(tenant, "a").config).filter.tuning
    expected = matched_tuning(Tuning(), TriadNoise(random_walk=2e-3), TriadNoise(1e-4, None, 0.0, 0.001))
    assert tuning == expected
    assert tuning.gyro_noise_radps_rts < Tuning().gyro_noise_radps_rts


@pytest.mark.parametrize("vehicle_id", ["-a", "a b", "ä", "a*", "x" * 129, "%00"])
def test_an_id_that_could_not_be_a_key_is_refused(admin, vehicle_id):
    assert admin.put(f"/v1/vehicles/{vehicle_id}", json={}).status_code == 422


def test_not_a_number_is_no_setting(admin):
    answer = admin.put(
        "/v1/vehicles/a",
        content=b'{"config": {"gnss_time_offset_s": NaN}}',
        headers={"Content-Type": "application/json"},
    )
    assert answer.status_code == 422


def test_pages_hold_each_vehicle_once_while_others_are_added(admin):
    for number in range(7):
        admin.put(f"/v1/vehicles/car-{number}", json={})
    url, seen = "/v1/vehicles?limit=3", []
    while url:
        answer = admin.get(url)
        seen += [vehicle["vehicle_id"] for vehicle in answer.json()["vehicles"]]
        if len(seen) == 3:
            admin.put("/v1/vehicles/car-0a", json={})  # before the cursor: is on no later page, shifts none
        url = answer.links.get("next", {}).get("url")
        assert (url is None) == (answer.json()["next_cursor"] is None)
    assert seen == [f"car-{number}" for number in range(7)]


@pytest.mark.parametrize("cursor", ["x", "WzFd", "bnVsbA", "e30", "WyJhIiwiYiJd", "Wy" * 30, "ÿ", "WyJcdTAwMDAiXQ"])
def test_a_cursor_of_ones_own_making_is_refused(admin, cursor):
    answer = admin.get("/v1/vehicles", params={"cursor": cursor})
    assert (answer.status_code, answer.json()["code"]) == (422, "invalid_cursor")


def test_a_repeated_read_costs_no_body_until_something_changes(admin):
    tag = admin.put("/v1/vehicles/a", json={}).headers["etag"]
    unchanged = admin.get("/v1/vehicles/a", headers={"If-None-Match": f'"other", W/{tag}'})
    assert (unchanged.status_code, unchanged.content) == (304, b"")
    assert unchanged.headers["etag"] == tag
    admin.put("/v1/vehicles/a", json={"config": {"detector": "paper"}})
    assert admin.get("/v1/vehicles/a", headers={"If-None-Match": tag}).status_code == 200


def test_a_change_meets_what_its_author_knew_or_nothing(admin):
    tag = admin.put("/v1/vehicles/a", json={}, headers={"If-None-Match": "*"}).headers["etag"]
    assert admin.put("/v1/vehicles/a", json={}, headers={"If-None-Match": "*"}).status_code == 412
    paper = {"config": {"detector": "paper"}}
    assert admin.put("/v1/vehicles/a", json=paper, headers={"If-Match": tag}).status_code == 200
    lost = admin.put("/v1/vehicles/a", json={}, headers={"If-Match": tag})
    assert (lost.status_code, lost.json()["code"]) == (412, "precondition_failed")
    assert admin.get("/v1/vehicles/a").json()["config"]["detector"] == "paper"
    assert admin.put("/v1/vehicles/b", json={}, headers={"If-Match": "*"}).status_code == 412


@pytest.mark.parametrize("first", ["register", "change"])
def test_of_many_at_once_with_the_same_condition_one_wins(service, tenant, first):
    headers = {"Authorization": f"Bearer {service.token(tenant, 'admin')}", "If-None-Match": "*"}
    url = f"{service.url}/v1/vehicles/a"
    if first == "change":
        headers["If-Match"] = httpx.put(url, json={}, headers=headers).headers["etag"]
        del headers["If-None-Match"]

    def put(number):
        return httpx.put(url, json={"config": {"gnss_time_offset_s": number / 10}}, headers=headers).status_code

    with ThreadPoolExecutor(8) as threads:
        statuses = sorted(threads.map(put, range(1, 9)))
    assert statuses == [201 if first == "register" else 200] + [412] * 7


def test_state_before_anything_came(admin):
    admin.put("/v1/vehicles/a", json={})
    assert admin.get("/v1/vehicles/a/state").json() == {
        "vehicle_id": "a",
        "last_seen_at": None,
        "last_packet": None,
        "durable_sequence": None,
        "fused": None,
    }


def test_state_is_the_newest_of_everything(service, admin, tenant):
    admin.put("/v1/vehicles/a", json={})
    pk = pk_of(service, tenant, "a")
    packet = {"vehicle_pk": pk, "boot_id": "b1", "start_t_ns": T0, "received_ns": T0 + NS}
    with write(service.database) as connection:
        rows = [packet | {"sequence": number, "payload": b"p"} for number in (1, 2, 4)]
        connection.execute(insert(tables.journal), rows)
        connection.execute(insert(tables.track_points), [point_row(pk, 0), point_row(pk, 1, mode=2)])
    state = admin.get("/v1/vehicles/a/state").json()
    assert state["last_packet"]["sequence"] == 4
    assert state["durable_sequence"] == 2, "packet 3 is missing: the box must still keep it"
    assert state["fused"]["time"] == "2027-01-15T08:00:01.000000Z"
    assert state["fused"]["mode"] == "coasting"
    assert state["fused"]["speed_mps"] == pytest.approx(5.0)
    assert state["fused"]["sd_n_m"] == 0.8


def test_removing_a_vehicle_leaves_no_row_about_it(service, admin, tenant):
    admin.put("/v1/vehicles/a", json={})
    admin.put("/v1/vehicles/b", json={})
    pks = [pk_of(service, tenant, name) for name in ("a", "b")]
    with write(service.database) as connection:
        for pk in pks:
            packet = {"vehicle_pk": pk, "boot_id": "b", "start_t_ns": T0, "received_ns": T0, "payload": b"p"}
            connection.execute(insert(tables.journal), [packet | {"sequence": number} for number in range(1, 2500)])
            connection.execute(insert(tables.track_points), [point_row(pk, second) for second in range(2500)])
    assert admin.delete("/v1/vehicles/a").status_code == 204
    assert admin.delete("/v1/vehicles/a").status_code == 404
    assert service.runtime.directory.resolve(tenant, "a") is None
    with read(service.database) as connection:
        for table in (tables.journal, tables.track_points):
            counts = (
                select(table.c.vehicle_pk, func.count()).where(table.c.vehicle_pk.in_(pks)).group_by(table.c.vehicle_pk)
            )
            assert [row.vehicle_pk for row in connection.execute(counts)] == [pks[1]], table.name
