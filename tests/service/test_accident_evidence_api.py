"""Evidence over HTTP: who may have what of it, in which form, and what is said while it is not there."""

from __future__ import annotations

import csv
import io
import time

import httpx
import numpy as np
import pytest
from sqlalchemy import insert, update

from service.evidence.bundle import from_bytes
from service.storage import tables
from service.storage.database import write
from tests.documented import conforms
from tests.service.evidence_harness import VEHICLE, crash_drive, crash_packets
from tests.service.stored_rows import T0, accident_row, point_row

TENANT = "insurer"
WAIT_S = 60.0


@pytest.fixture(scope="module")
def crashed(any_service):
    """The id of an accident whose packets came over HTTP, once its evidence is complete."""
    with any_service.client(TENANT, "admin") as client:
        config = {"mounting_rpy_deg": list(crash_drive()[0].imu.mounting_rpy_deg), "vin": "WVWZZZ1KZAW000001"}
        client.put(f"/v1/vehicles/{VEHICLE}", json={"config": config}).raise_for_status()
        url, headers = f"/v1/vehicles/{VEHICLE}/telemetry", {"Content-Type": "application/x-protobuf"}
        for packet in crash_packets():
            client.post(url, content=packet.SerializeToString(), headers=headers).raise_for_status()
        deadline = time.monotonic() + WAIT_S
        while True:
            found = client.get("/v1/accidents", params={"status": ["suspected", "confirmed", "retracted"]}).json()
            if found["features"] and found["features"][0]["properties"]["evidence"] == "complete":
                return found["features"][0]["id"]
            assert time.monotonic() < deadline, found
            time.sleep(0.2)


@pytest.fixture
def reader(any_service):
    """An insurer's key: accidents, and no places."""
    with any_service.client(TENANT, "accidents:read") as client:
        yield client


@pytest.fixture
def placed(any_service):
    with any_service.client(TENANT, "accidents:read", "positions:read") as client:
        yield client


def test_a_trace_has_every_sample_and_all_that_was_made_of_it(crashed, placed):
    answer = placed.get(f"/v1/accidents/{crashed}/trace")
    body = answer.json()
    conforms("Trace", body)
    assert body["replay"]["same"], body["replay"]
    assert (body["status"], body["covered"]["whole"]) == ("complete", True)
    samples, states, told = (body["parts"][name] for name in ("samples", "states", "innovations"))
    assert (samples["t_s"][0], samples["t_s"][-1]) == (-60.0, 30.0)
    assert len(samples["t_s"]) == len(samples["az_b_mps2"]) == 90 * 200 + 1
    assert len(states["lat_deg"]) == 90 * 200 + 1
    assert np.mean(samples["az_s_mps2"]) == pytest.approx(-9.8, abs=0.3)  # the simulated sensor has a bias
    assert {"gnss_position", "nhc"} <= set(told["aid"])
    assert set(states["mode"]) <= {"aligning", "aided", "coasting"}
    assert set(body["parts"]) == {
        "samples", "states", "innovations", "gnss", "magnetometer", "wheel_speed", "barometer",
    }  # fmt: skip
    again = placed.get(f"/v1/accidents/{crashed}/trace", headers={"If-None-Match": answer.headers["ETag"]})
    assert again.status_code == 304


def test_a_key_without_positions_gets_no_way(crashed, reader):
    body = reader.get(f"/v1/accidents/{crashed}/trace").json()
    conforms("Trace", body)
    assert "gnss" not in body["parts"]
    for columns in body["parts"].values():
        assert not {"lat_deg", "lon_deg", "alt_m", "vn_mps", "ve_mps", "yaw_deg", "course_deg"} & set(columns)
    assert body["parts"]["samples"]["speed_mps"][0] is not None
    for path in ("trace?part=gnss", "evidence"):
        refused = reader.get(f"/v1/accidents/{crashed}/{path}")
        assert (refused.status_code, refused.json()["code"]) == (403, "forbidden")
        assert refused.json()["scope"] == "positions:read"


def test_a_trace_as_csv_is_one_table(crashed, placed, reader):
    answer = placed.get(f"/v1/accidents/{crashed}/trace", headers={"Accept": "text/csv"})
    assert answer.headers["Content-Type"].startswith("text/csv")
    assert "attachment" in answer.headers["Content-Disposition"]
    rows = list(csv.DictReader(io.StringIO(answer.text)))
    assert len(rows) == 90 * 200 + 1
    body = placed.get(f"/v1/accidents/{crashed}/trace?part=samples").json()["parts"]["samples"]
    assert [float(row["ax_b_mps2"]) for row in rows[:50]] == body["ax_b_mps2"][:50]
    states = placed.get(f"/v1/accidents/{crashed}/trace?part=states&format=csv")
    assert "lat_deg" in states.text.partition("\n")[0]
    assert "lat_deg" not in reader.get(f"/v1/accidents/{crashed}/trace?part=states&format=csv").text.partition("\n")[0]
    two = placed.get(f"/v1/accidents/{crashed}/trace?part=states&part=samples&format=csv")
    assert (two.status_code, two.json()["code"]) == (422, "invalid_request")
    assert placed.get(f"/v1/accidents/{crashed}/trace?part=everything").status_code == 422


def test_the_event_recorders_elements_are_named_as_the_regulation_does(crashed, reader):
    form = reader.get(f"/v1/accidents/{crashed}/edr").json()
    conforms("Edr", form)
    named = {element["element"]: element for element in form["elements"]}
    assert named["Delta-V, longitudinal"]["t_s"][:3] == [0.0, 0.01, 0.02]
    assert len(named["Speed, vehicle indicated"]["values"]) == 11
    assert len(named["Speed, vehicle indicated (20 s)"]["values"]) == 201
    assert named["Complete file recorded"]["value"] == "yes"
    assert named["Service brake, on/off"] == {"element": "Service brake, on/off", "recorded": False}
    assert named["Maximum delta-V, resultant"]["value"] > 5.0
    rows = list(csv.DictReader(io.StringIO(reader.get(f"/v1/accidents/{crashed}/edr?format=csv").text)))
    assert len([row for row in rows if row["element"] == "Speed, vehicle indicated (20 s)"]) == 201
    (brake,) = [row for row in rows if row["element"] == "Service brake, on/off"]
    assert (brake["recorded"], brake["value"]) == ("no", "")


def test_the_ecall_data_are_there_and_recent_places_need_positions(crashed, reader, placed):
    for client, told in ((reader, False), (placed, True)):
        body = client.get(f"/v1/accidents/{crashed}/msd").json()
        conforms("Msd", body)
        said = body["msd"]["msdStructure"]
        assert (said["recentVehicleLocationN1"] is not None) is told
        assert (said["recentVehicleLocationN2"] is not None) is told
        assert said["vehicleIdentificationNumber"]["isowmi"] == "WVW"
        assert said["control"]["automaticActivation"] is True


def test_the_bundle_is_what_the_manifest_says(crashed, placed):
    answer = placed.get(f"/v1/accidents/{crashed}/evidence")
    bundle = from_bytes(answer.content)
    assert answer.headers["Evidence-SHA256"] == bundle.sha256
    assert placed.get(f"/v1/accidents/{crashed}/trace?part=gnss").json()["sha256"] == bundle.sha256
    assert bundle.manifest["accident"]["id"] == crashed


def test_the_dossier_is_a_page_that_may_do_nothing_and_shows_no_way_without_positions(crashed, reader, placed):
    for client, told in ((reader, False), (placed, True)):
        page = client.get(f"/v1/accidents/{crashed}/dossier")
        assert page.headers["Content-Type"] == "text/html; charset=utf-8"
        assert page.headers["Content-Security-Policy"].startswith("sandbox")
        assert ("Metres east and north" in page.text) is told
        assert VEHICLE in page.text


@pytest.mark.parametrize("path", ["trace", "edr", "msd", "dossier", "evidence", "reviews", ""])
def test_another_tenants_accident_is_not_there_and_a_key_without_the_scope_gets_nothing(any_service, crashed, path):
    url = f"/v1/accidents/{crashed}/{path}".rstrip("/")
    with any_service.client("other", "admin") as other:
        assert other.get(url).status_code == 404
    with any_service.client(TENANT, "vehicles:*", "scores:read", "positions:read") as client:
        assert client.get(url).status_code == 403
    assert httpx.get(any_service.url + url).status_code == 401


def test_what_is_not_built_yet_says_when_to_come_again(any_service, crashed, tenant):
    pk = any_service.runtime.directory.register(tenant, "car").ref.pk
    row = accident_row(tenant, pk, 0)
    with write(any_service.database) as connection:
        connection.execute(insert(tables.accidents), [row])
        connection.execute(insert(tables.track_points), [point_row(pk, -5)])
    with any_service.client(tenant, "admin") as client:
        for path in ("trace", "edr", "dossier", "evidence"):
            assert client.get(f"/v1/accidents/{row['id']}/{path}").status_code == 404, "of the time before evidence"
        assert client.get(f"/v1/accidents/{row['id']}/msd").status_code == 200
        asked = {"accident_id": row["id"], "vehicle_pk": pk, "t_ns": T0, "status": "building", "config": {}}
        with write(any_service.database) as connection:  # a status that the worker leaves alone
            connection.execute(insert(tables.evidence), [asked | {"created_ns": T0}])
        for path in ("trace", "edr", "dossier", "evidence"):
            answer = client.get(f"/v1/accidents/{row['id']}/{path}")
            assert (answer.status_code, answer.json()["code"]) == (409, "evidence_pending")
            assert int(answer.headers["Retry-After"]) > 0
        with write(any_service.database) as connection:
            failed = update(tables.evidence).where(tables.evidence.c.accident_id == row["id"])
            connection.execute(failed.values(status="failed", reason="PacketError: damaged"))
        answer = client.get(f"/v1/accidents/{row['id']}/edr")
        assert (answer.status_code, answer.json()["code"]) == (409, "evidence_failed")
        assert "PacketError: damaged" in answer.json()["detail"]


def test_erasing_the_vehicle_takes_its_evidence_and_leaves_a_trace_of_that(any_service, crashed):
    with any_service.client(TENANT, "admin") as client:
        assert client.delete(f"/v1/vehicles/{VEHICLE}").status_code == 204
        assert client.get(f"/v1/accidents/{crashed}/evidence").status_code == 404
        (entry,) = client.get("/v1/audit").json()["entries"]
        assert (entry["action"], entry["subject"]) == ("vehicle.erased", f"vehicle/{VEHICLE}")
