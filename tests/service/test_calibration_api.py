"""Calibrations over HTTP: versions by their time, recordings uploaded, computed, accepted or refused."""

from __future__ import annotations

import functools
import gzip
import io
import time

import httpx
import numpy as np
import pytest
from sqlalchemy import select, update

from core.sensors import TriadCalibration
from core.simulation.calibration_recording import simulate_recording
from schemas.notifications import rfc3339
from service.settings import Settings
from service.storage import calibration_runs, schema, tables
from service.storage.calibration_runs import RunOptions, RunRow
from service.storage.database import open_database, read, write
from service.storage.vehicles import VehicleDirectory
from tests.conftest import run_service
from tests.service.stored_rows import NS, T0
from tests.service.webhook_harness import eventually

SENSOR = {"scale": [1.01, 0.99, 1.0], "misalignment": [0.001, 0.0, -0.002], "bias": [0.1, -0.2, 0.05]}
PATH = "/v1/vehicles/car/calibration"
RUNS = "/v1/vehicles/car/calibration-runs"
CSV = {"Content-Type": "text/csv"}
TRUE_ACCELEROMETER = TriadCalibration((1.01, 0.99, 1.005), (0.01, -0.01, 0.005), (0.1, -0.2, 0.15))
TRUE_GYROSCOPE = TriadCalibration((1.01, 0.98, 1.0), (0.01, -0.01, 0.005), (0.01, -0.02, 0.015))
WAIT_S = 400.0  # a run yields to everything else: on busy cores ten seconds of work have taken more than 60
DAY_NS = 86_400 * NS


@functools.cache
def recording():
    """A simulated box held in 24 positions, as a CSV file."""
    made = simulate_recording(
        np.random.default_rng(1), accelerometer=TRUE_ACCELEROMETER, gyroscope=TRUE_GYROSCOPE, rate_hz=50.0
    ).recording
    assert made.gyroscope is not None
    rows = np.column_stack([made.t_s, made.accelerometer, made.gyroscope])
    text = io.StringIO()
    names = "t_s,ax_mps2,ay_mps2,az_mps2,gx_radps,gy_radps,gz_radps"
    np.savetxt(text, rows, delimiter=",", header=names, comments="", fmt="%.6f")
    return text.getvalue().encode()


@pytest.fixture
def car(any_service, tenant):
    with any_service.client(tenant, "admin") as client:
        assert client.put("/v1/vehicles/car", json={}).status_code == 201
        yield client


@pytest.fixture
def vehicle(service, tenant):
    """The same on SQLite alone, where the database makes no difference."""
    with service.client(tenant, "admin") as client:
        assert client.put("/v1/vehicles/car", json={}).status_code == 201
        yield client


def events_of(client, kind):
    return [one["data"] for one in client.get("/v1/events").json()["events"] if one["type"] == kind]


def finished(client, run):
    eventually(lambda: client.get(f"{RUNS}/{run}").json()["status"] in ("done", "failed"), WAIT_S)
    return client.get(f"{RUNS}/{run}").json()


# Versions


def test_a_box_never_calibrated_says_so(car):
    found = car.get(PATH).json()
    assert found["version"] == 0
    assert found["accelerometer"] is found["gyroscope"] is found["magnetometer"] is None
    assert found["valid_from"] is found["valid_to"] is None
    assert car.get("/v1/vehicles/none/calibration").status_code == 404


def test_one_that_is_put_holds_from_now_on_and_the_one_before_until_then(any_service, car, tenant):
    first = car.put(PATH, json={"accelerometer": SENSOR}).json()
    assert (first["version"], first["origin"], first["valid_to"]) == (1, "put", None)
    assert first["accelerometer"]["bias"] == SENSOR["bias"]
    second = car.put(PATH, json={"gyroscope": SENSOR}).json()
    assert car.get(PATH).json() == second
    assert car.get(PATH, params={"at": first["valid_from"]}).json()["version"] == 1
    assert car.get(PATH, params={"at": "2001-01-01T00:00:00Z"}).json()["version"] == 0
    history = car.get("/v1/vehicles/car/calibrations").json()["calibrations"]
    assert [one["version"] for one in history] == [2, 1]
    assert history[1]["valid_to"] == history[0]["valid_from"]
    assert history[0]["created_by"] is not None
    assert [one.version for one in any_service.runtime.directory.resolve(tenant, "car").calibrations] == [1, 2]
    changed = events_of(car, "calibration.changed")
    assert [(one["calibration_version"], one["origin"]) for one in changed] == [(1, "put"), (2, "put")]


def test_one_may_be_planned_or_put_for_a_time_past(car):
    later = rfc3339(time.time_ns() + DAY_NS)
    car.put(PATH, json={"accelerometer": SENSOR}, params={"valid_from": later})
    assert car.get(PATH).json()["version"] == 0
    assert car.get(PATH).json()["valid_to"] == later
    assert car.get(PATH, params={"at": later}).json()["version"] == 1
    car.put(PATH, json={"gyroscope": SENSOR}, params={"valid_from": "2020-01-01T00:00:00Z"})
    assert car.get(PATH).json()["version"] == 2
    assert car.get(PATH).json()["valid_to"] == later
    assert car.put(PATH, json={}, params={"valid_from": "tomorrow"}).status_code == 422
    assert car.get(PATH, params={"at": "2020"}).status_code == 422


def test_the_same_put_again_is_no_other_version_and_a_change_meets_what_its_author_knew(car):
    body = {"accelerometer": SENSOR}
    tag = car.put(PATH, json=body).headers["etag"]
    assert car.put(PATH, json=body, headers={"If-Match": tag}).json()["version"] == 1
    assert car.get(PATH, headers={"If-None-Match": tag}).status_code == 304
    assert car.put(PATH, json={"gyroscope": SENSOR}, headers={"If-Match": tag}).json()["version"] == 2
    lost = car.put(PATH, json={}, headers={"If-Match": tag})
    assert (lost.status_code, lost.json()["code"]) == (412, "precondition_failed")
    assert car.get(PATH).json()["version"] == 2


def test_one_of_raw_counts_is_refused_since_packets_are_in_units(car):
    counts = {"accelerometer": SENSOR | {"scale": [1670.0, 1660.0, 1680.0]}}
    for answer in (car.put(PATH, json=counts), car.put("/v1/vehicles/car", json={"config": {"calibration": counts}})):
        assert (answer.status_code, answer.json()["code"]) == (422, "invalid_request")
        assert "as of raw counts" in answer.json()["detail"]
    assert car.get(PATH).json()["version"] == 0


def test_history_comes_in_pages(car):
    for number in range(5):
        car.put(PATH, json={"accelerometer": SENSOR | {"bias": [number, 0, 0]}})
    url, seen = "/v1/vehicles/car/calibrations?limit=2", []
    while url:
        answer = car.get(url)
        seen += [one["version"] for one in answer.json()["calibrations"]]
        url = answer.links.get("next", {}).get("url")
    assert seen == [5, 4, 3, 2, 1]


def test_one_that_comes_with_the_registration_holds_for_all_packets(car):
    config = {"detector": "paper", "calibration": {"accelerometer": SENSOR}}
    made = car.put("/v1/vehicles/new", json={"config": config})
    assert made.status_code == 201
    assert "calibration" not in made.json()["config"], "it has one home"
    first = car.get("/v1/vehicles/new/calibration", params={"at": "1980-01-01T00:00:00Z"}).json()
    assert (first["version"], first["origin"], first["valid_from"]) == (1, "registration", None)
    car.put("/v1/vehicles/new", json={"config": config})
    car.put("/v1/vehicles/new", json={"config": {"detector": "telefuse"}})
    assert car.get("/v1/vehicles/new/calibration").json()["version"] == 1, "left out or repeated it stays"
    config["calibration"] = {"gyroscope": SENSOR}
    car.put("/v1/vehicles/new", json={"config": config})
    assert car.get("/v1/vehicles/new/calibration").json()["version"] == 2
    assert car.get("/v1/vehicles/new/calibration", params={"at": "1980-01-01T00:00:00Z"}).json()["version"] == 1


@pytest.mark.parametrize(
    ("body", "location"),
    [
        ({"accelerometer": SENSOR | {"scale": [1, 0, 1]}}, "body.accelerometer.scale.1"),
        ({"accelerometer": SENSOR | {"bias": [1, 2]}}, "body.accelerometer.bias.2"),
        ({"gyroscope": SENSOR | {"sd": {"bias": [-1, 0, 0]}}}, "body.gyroscope.sd.bias.0"),
        ({"magnetometer": {"soft_iron": [[1, 0, 0], [0, 1, 0], [0, 0, 0]]}}, "body.magnetometer"),
        ({"thermometer": {}}, "body.thermometer"),
    ],
)
def test_what_no_sensor_has_is_refused_by_name_and_nothing_is_stored(vehicle, body, location):
    answer = vehicle.put(PATH, json=body)
    assert answer.status_code == 422
    assert location in [error["location"] for error in answer.json()["errors"]]
    assert vehicle.get(PATH).json()["version"] == 0


# Runs


@pytest.fixture(scope="module")
def done(service):
    """A run of a good recording, its client and vehicle's tenant."""
    with service.client("workshop", "admin") as client:
        client.put("/v1/vehicles/car", json={})
        made = client.post(RUNS, content=gzip.compress(recording()), headers={**CSV, "Content-Encoding": "gzip"})
        assert made.status_code == 202, made.text
        assert made.headers["location"] == f"{RUNS}/{made.json()['id']}"
        assert made.json()["status"] == "queued"
        yield client, finished(client, made.json()["id"])


def test_a_recording_is_calibrated_and_its_report_is_one_page(done):
    client, run = done
    assert (run["status"], run["progress"], run["problem"]) == ("done", 1.0, None)
    for sensor, true in (("accelerometer", TRUE_ACCELEROMETER), ("gyroscope", TRUE_GYROSCOPE)):
        found = run["result"][sensor]
        for name in ("scale", "misalignment", "bias"):
            error, sd = np.array(found[name]) - getattr(true, name), np.array(found["sd"][name])
            if (sensor, name) != ("gyroscope", "bias"):  # which wanders while it is recorded
                # Eighteen parameters of one unit: four of their sd.
                assert (np.abs(error) < 4.0 * sd).all(), (sensor, name)
    report = client.get(f"{RUNS}/{run['id']}/report")
    assert report.status_code == 200
    assert report.headers["content-type"].startswith("text/html")
    assert "default-src 'none'" in report.headers["content-security-policy"]
    assert b"accelerometer" in report.content.lower()
    unchanged = client.get(f"{RUNS}/{run['id']}/report", headers={"If-None-Match": report.headers["etag"]})
    assert unchanged.status_code == 304
    assert client.get(PATH).json()["version"] == 0, "nothing is used that nobody has accepted"


def test_what_a_run_found_is_accepted_once_and_put_as_it_is(done):
    client, run = done
    assert client.put("/v1/vehicles/other", json={}).status_code in (200, 201)
    taken_as_is = client.put("/v1/vehicles/other/calibration", json=run["result"])
    assert taken_as_is.status_code == 200, taken_as_is.text
    key = {"Idempotency-Key": "accept-1"}
    made = client.post(f"{RUNS}/{run['id']}:accept", headers=key)
    assert made.status_code == 201, made.text
    assert (made.json()["origin"], made.json()["run_id"]) == ("run", run["id"])
    again = client.post(f"{RUNS}/{run['id']}:accept", headers=key)
    assert (again.json(), again.headers["idempotency-replayed"]) == (made.json(), "true")
    assert client.post(f"{RUNS}/{run['id']}:accept").status_code == 409
    assert client.post(f"{RUNS}/{run['id']}:refuse").status_code == 409
    assert client.get(PATH).json()["accelerometer"] == run["result"]["accelerometer"]
    shown = client.get(f"{RUNS}/{run['id']}").json()
    assert (shown["decision"], shown["version"]) == ("accepted", made.json()["version"])
    (told,) = [one for one in events_of(client, "calibration.changed") if one["origin"] == "run"]
    assert (told["run_id"], told["vehicle_id"]) == (run["id"], "car")


def stored_run(service, tenant, status="done", **changes):
    """A run in the database, as if it had come so far."""
    pk = service.runtime.directory.resolve(tenant, "car").pk
    run = RunRow(
        id=changes.pop("id", f"run-{time.monotonic_ns()}"),
        vehicle_pk=pk,
        status=status,
        progress=0.0,
        options=RunOptions(),
        recording_bytes=1,
        recording_sha256="0" * 64,
        created_ns=changes.pop("created_ns", T0),
        **changes,
    )
    with write(service.database) as connection:
        calibration_runs.add(connection, run)
        if status == "done":
            values = {"result": {"accelerometer": SENSOR}, "finished_ns": T0}
            connection.execute(
                update(tables.calibration_runs).where(tables.calibration_runs.c.id == run.id).values(**values)
            )
    return run.id


def test_what_is_refused_changes_nothing(any_service, car, tenant):
    run = stored_run(any_service, tenant)
    refused = car.post(f"{RUNS}/{run}:refuse")
    assert (refused.status_code, refused.json()["decision"]) == (200, "refused")
    assert car.post(f"{RUNS}/{run}:accept").status_code == 409
    assert car.get(PATH).json()["version"] == 0
    assert car.post(f"{RUNS}/none:refuse").status_code == 404


def test_what_is_not_done_cannot_be_accepted(any_service, car, tenant):
    run = stored_run(any_service, tenant, "failed")
    answer = car.post(f"{RUNS}/{run}:accept")
    assert (answer.status_code, answer.json()["code"]) == (409, "conflict")
    assert "failed" in answer.json()["detail"]
    assert car.get(f"{RUNS}/{run}/report").status_code == 404


def test_runs_come_in_pages_newest_first(any_service, car, tenant):
    made = [stored_run(any_service, tenant, created_ns=T0 + number // 2) for number in range(5)]
    url, seen = f"{RUNS}?limit=2", []
    while url:
        answer = car.get(url)
        seen += [one["id"] for one in answer.json()["runs"]]
        url = answer.links.get("next", {}).get("url")
    assert sorted(seen) == sorted(made)
    assert seen[0] == made[4]


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (
            b"t_s,ax_mps2,ay_mps2,az_mps2\n" + b"".join(b"%d,0,0,9.8\n" % n for n in range(400)),
            "x axis shows 0 throughout",
        ),
        (
            b"t_s,ax_mps2,ay_mps2,az_mps2\n"
            + b"".join(b"%d,0.0%d,0.0%d,9.80%d\n" % (n, 4 * n % 9, 7 * n % 5, 3 * n % 7) for n in range(400)),
            "position",
        ),
        (b"not a recording at all", "header"),
    ],
    ids=["dead axes", "one position", "no recording"],
)
def test_a_recording_that_cannot_be_used_says_what_to_record_and_stores_nothing(vehicle, content, says):
    made = vehicle.post(RUNS, content=content, headers=CSV)
    assert made.status_code == 202
    run = finished(vehicle, made.json()["id"])
    assert (run["status"], run["result"]) == ("failed", None)
    assert says in run["problem"]["detail"]
    assert "/" not in run["problem"]["detail"].split(":")[0], "where the service keeps it is nobody's business"
    assert vehicle.get(PATH).json()["version"] == 0
    assert vehicle.post(f"{RUNS}/{run['id']}:accept").status_code == 409


@pytest.mark.parametrize(
    ("content", "headers", "status", "code"),
    [
        (b"{}", {"Content-Type": "application/json"}, 415, "unsupported_media_type"),
        (b"t_s", {**CSV, "Content-Encoding": "br"}, 415, "unsupported_media_type"),
        (b"", CSV, 400, "bad_request"),
        (b"t_s,ax_mps2\n", {**CSV, "Content-Encoding": "gzip"}, 400, "bad_request"),
    ],
)
def test_what_is_no_recording_by_its_kind_is_refused_at_once(vehicle, service, content, headers, status, code):
    answer = vehicle.post(RUNS, content=content, headers=headers)
    assert (answer.status_code, answer.json()["code"]) == (status, code)
    assert vehicle.get(RUNS).json()["runs"] == []
    assert not list(service.runtime.run_files.directory.glob("*.part"))


@pytest.mark.parametrize("gzipped", [False, True])
def test_too_much_is_refused_however_small_it_was_packed(tmp_path, gzipped):
    settings = Settings(data_dir=tmp_path, zenoh_mode="off", workers=1, max_recording_mib=1)
    with run_service(settings) as small, small.client("a", "admin") as client:
        client.put("/v1/vehicles/car", json={})
        content, headers = b"0," * (1 << 20), dict(CSV)
        if gzipped:
            content, headers["Content-Encoding"] = gzip.compress(content), "gzip"
            assert len(content) < 10_000
        answer = client.post(RUNS, content=content, headers=headers)
        assert (answer.status_code, answer.json()["code"]) == (413, "body_too_large")
        assert not list((tmp_path / "calibration-runs").iterdir())
        assert client.get(RUNS).json()["runs"] == []


def test_an_upload_repeated_with_its_key_makes_one_run(vehicle):
    headers = {**CSV, "Idempotency-Key": "one"}
    first = vehicle.post(RUNS, content=b"t_s\n", headers=headers)
    again = vehicle.post(RUNS, content=b"t_s\n", headers=headers)
    assert again.json()["id"] == first.json()["id"]
    assert again.headers["idempotency-replayed"] == "true"
    assert again.headers["location"] == first.headers["location"]
    assert vehicle.post(RUNS, content=b"t_s,a\n", headers=headers).status_code == 422
    assert len(vehicle.get(RUNS).json()["runs"]) == 1


def test_a_tenants_runs_wait_in_a_queue_of_limited_length(service, vehicle, tenant):
    for number in range(20):
        stored_run(service, tenant, "queued", id=f"wait-{tenant}-{number}", created_ns=2**62)
    answer = vehicle.post(RUNS, content=b"t_s\n", headers=CSV)
    assert (answer.status_code, answer.json()["code"]) == (409, "conflict")
    with write(service.database) as connection:
        connection.execute(tables.calibration_runs.delete().where(tables.calibration_runs.c.id.like(f"wait-{tenant}%")))


def test_reading_does_not_let_upload_or_decide_and_strangers_find_nothing(service, vehicle, tenant):
    run = stored_run(service, tenant)
    with service.client(tenant, "vehicles:read") as reader:
        assert reader.get(f"{RUNS}/{run}").status_code == 200
        for path in (RUNS, f"{RUNS}/{run}:accept", f"{RUNS}/{run}:refuse"):
            assert reader.post(path, content=b"x", headers=CSV).status_code == 403, path
        assert reader.put(PATH, json={}).status_code == 403
    with service.client(f"not-{tenant}", "admin") as stranger:
        for path in (PATH, "/v1/vehicles/car/calibrations", RUNS, f"{RUNS}/{run}", f"{RUNS}/{run}/report"):
            assert stranger.get(path).status_code == 404, path
        stranger.put("/v1/vehicles/car", json={})
        assert stranger.get(f"{RUNS}/{run}").status_code == 404, "the run is another car's"
        assert stranger.post(f"{RUNS}/{run}:accept").status_code == 404
    assert httpx.get(f"{service.url}{RUNS}").status_code == 401


def test_removing_a_vehicle_removes_its_runs_with_their_files(service, vehicle):
    run = vehicle.post(RUNS, content=b"t_s\n", headers=CSV).json()["id"]
    files = service.runtime.run_files
    assert files.recording(run) is not None
    assert vehicle.delete("/v1/vehicles/car").status_code == 204
    assert files.recording(run) is None


# The migration


@pytest.mark.parametrize("kind", ["sqlite", "postgresql"])
def test_a_calibration_among_the_settings_moves_to_its_own_table_and_back(request, tmp_path, kind):
    url = f"sqlite:///{tmp_path / 'old.db'}" if kind == "sqlite" else request.getfixturevalue("empty_postgres_url")
    engine = open_database(url)
    schema.upgrade(engine, "0001")
    old = {"detector": "paper", "calibration": {"accelerometer": SENSOR, "gyroscope": None}}
    with write(engine) as connection:
        connection.execute(tables.tenants.insert().values(id="acme", name="acme", created_ns=0))
        for name, config in (("with", old), ("without", {"detector": "paper", "calibration": None}), ("bare", {})):
            connection.execute(
                tables.vehicles.insert().values(
                    tenant_id="acme", vehicle_id=name, config=config, registered_ns=0, updated_ns=0
                )
            )
    schema.upgrade(engine)
    directory = VehicleDirectory(engine, open_registration=False)
    (moved,) = directory.resolve("acme", "with").calibrations
    assert (moved.version, moved.valid_from_ns) == (1, 0)
    assert moved.calibration.accelerometer.scale == tuple(SENSOR["scale"])
    assert directory.resolve("acme", "without").calibrations == directory.resolve("acme", "bare").calibrations == ()
    schema.downgrade(engine, "0001")
    with read(engine) as connection:
        configs = dict(connection.execute(select(tables.vehicles.c.vehicle_id, tables.vehicles.c.config)).all())
    assert configs["with"]["calibration"]["accelerometer"] == SENSOR
    assert "calibration" not in configs["without"]
    engine.dispose()
