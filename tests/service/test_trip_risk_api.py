"""A trip's risk over time and its manoeuvres over HTTP: assessed on real roads, told, reviewed."""

from __future__ import annotations

import time

import numpy as np
import pytest
from sqlalchemy import insert

from core.driving.exposure import Facet
from core.driving.manoeuvres import Episode, Manoeuvre
from schemas.vehicles import VehicleConfig
from service.roads.matching import RoadService
from service.settings import Settings
from service.stable_ids import stable_id
from service.storage import manoeuvres, records, tables
from service.storage.database import read, write
from service.trips.manoeuvres import store_episode
from service.trips.timeline import Timeline
from tests.conftest import run_service
from tests.documented import conforms
from tests.road_map import at
from tests.service.stored_rows import NS, T0, candidate_row, manoeuvre_row, point_row, trip_row
from tests.service.trip_harness import Driver

WAIT_S = 60.0
SPEED_MPS = 20.0
SECONDS = 75
"""Along the main street, where 50 km/h are allowed, at 72."""


@pytest.fixture(scope="module")
def service(built_roads, tmp_path_factory):
    chosen = Settings(data_dir=tmp_path_factory.mktemp("roads"), zenoh_mode="off", workers=1, roads=built_roads)
    with run_service(chosen) as running:
        yield running


def driven(pk):
    """A trip of which the whole way, and a braking in its midst, are stored."""
    points = []
    for second in range(-2, SECONDS + 3):
        lon, lat = at(100.0 + SPEED_MPS * second, 0.0)
        points.append(
            point_row(pk, second, lat, lon, vn_mps=0.0, ve_mps=SPEED_MPS, yaw_deg=90.0)
            | {"sd_v_h_mps": 0.05, "sd_tilt_deg": 0.05, "sd_accel_bias_mps2": 0.01}
        )
    trip = trip_row(pk, 0, SECONDS, distance_m=SPEED_MPS * SECONDS, moving_s=float(SECONDS), coasting_s=0.0)
    return trip | {"due_ns": 1}, points


def a_braking(ref):
    t_ns = T0 + 40 * NS
    return manoeuvre_row(ref.tenant_id, ref.pk, 40, id=stable_id(ref, t_ns, "manoeuvre/braking"))


@pytest.fixture
def ref(service, tenant):
    config = VehicleConfig(driver={"age": 30, "sex": "F"}, time_zone="Europe/Helsinki")
    return service.runtime.directory.register(tenant, "car", config).ref


@pytest.fixture
def trip(service, ref):
    trip, points = driven(ref.pk)
    with write(service.database) as connection:
        connection.execute(insert(tables.track_points), points)
        connection.execute(insert(tables.manoeuvres), [a_braking(ref)])
        connection.execute(insert(tables.trips), [trip])
    return trip["id"]


@pytest.fixture
def admin(service, tenant):
    with service.client(tenant, "admin") as client:
        yield client


def assessed(client, trip_id):
    deadline = time.monotonic() + WAIT_S
    while not (row := client.get(f"/v1/trips/{trip_id}").json())["assessed"]:
        assert time.monotonic() < deadline, row
        time.sleep(0.05)
    return row


def test_risk_over_time_knows_the_limit_and_the_driver(service, admin, trip):
    row = assessed(admin, trip)
    conforms("Trip", row)
    assert row["night_share"] == 0.0, "ten in the morning"
    answer = admin.get(f"/v1/trips/{trip}/risk")
    risk = answer.json()
    conforms("TripRisk", risk)
    assert admin.get(f"/v1/trips/{trip}/risk", headers={"If-None-Match": answer.headers["etag"]}).status_code == 304
    assert len(risk["times"]) == SECONDS + 1
    middle = SECONDS // 2
    assert risk["speed_kmh"][middle] == pytest.approx(72.0, abs=0.1)
    assert (risk["limit_kmh"][middle], risk["limit_certainty"][middle]) == (50.0, "tagged")
    assert set(risk["entities"]) == {"driver", "environment", "vehicle"}
    for masses in (risk["fused"], *risk["entities"].values()):
        sums = np.sum([masses[name] for name in masses], axis=0)
        assert sums == pytest.approx(1.0, abs=4e-4)  # seven masses, each told to 1e-4
    # 22 km/h above the limit: nothing of the vehicle is low.
    assert risk["entities"]["vehicle"]["LR"][middle] == 0.0
    assert risk["coverage"]["driver.age"][middle] == 1.0
    tenth = admin.get(f"/v1/trips/{trip}/risk?every=10").json()
    assert tenth["times"] == risk["times"][::10]
    assert tenth["mean"] == risk["mean"]


def test_the_same_track_on_the_same_roads_gives_the_same_record(built_roads, database):
    with RoadService(built_roads, processes=2) as roads:
        driver = Driver(database, VehicleConfig(), roads)
        trip, points = driven(driver.ref.pk)
        with write(database) as connection:
            connection.execute(insert(tables.track_points), points)
            connection.execute(insert(tables.trips), [trip])
        driver.turn()
        first = driver.stored()
        for again in range(3):
            with write(database) as connection:
                connection.execute(tables.trips.update().values(due_ns=2 + again))
            driver.turn()
            assert driver.stored() == first
    (row,) = first
    assert "Hauptweg" not in row[1], "a record knows no streets"
    with read(database) as connection:
        by = records.find(connection, row[0]).record.exposure.by
    assert set(by[Facet.ROAD_CLASS]) == {"primary"}
    assert set(by[Facet.DISTRICT]) == {"Westviertel", "Ostviertel"}
    assert (Timeline.unpacked(row[3]).limit_kmh == 50.0).mean() > 0.9
    assert len(driver.scored) == 1, "told once, as it stayed the same"


def test_what_explains_a_manoeuvre_is_named_to_who_may_know_places(service, admin, tenant, ref, trip):
    """It says where the vehicle was, as an accident's place is told to more."""
    struck = candidate_row(tenant, ref.pk, 41)
    with write(service.database) as connection:
        connection.execute(insert(tables.accident_candidates), [struck])
        connection.execute(tables.trips.update().where(tables.trips.c.id == trip).values(due_ns=1))
    assert assessed(admin, trip)["road_lookup"] == "done"
    (row,) = admin.get(f"/v1/trips/{trip}/manoeuvres").json()["manoeuvres"]
    conforms("Manoeuvre", row)
    assert (row["excused"], row["excused_by"]) == ("hazard", struck["id"])
    with service.client(tenant, "vehicles:read") as http:
        (row,) = http.get(f"/v1/trips/{trip}/manoeuvres").json()["manoeuvres"]
    assert (row["excused"], row["excused_by"]) == ("hazard", None)


def test_a_reviewer_decides_whether_a_manoeuvre_counts(service, admin, tenant, ref, trip):
    assessed(admin, trip)
    (row,) = admin.get(f"/v1/trips/{trip}/manoeuvres").json()["manoeuvres"]
    conforms("Manoeuvre", row)
    assert (row["kind"], row["peak_mps2"], row["direction"], row["excused"]) == ("braking", 6.5, None, None)
    url = f"/v1/manoeuvres/{row['id']}"
    assert admin.get(url).json() == row

    def counts():
        assessed(admin, trip)
        with read(service.database) as connection:
            record = records.find(connection, trip).record
        return record.manoeuvres, record.excused

    assert counts() == ({"braking": 1}, {})
    with service.client(tenant, "vehicles:read") as http:
        refused = http.post(f"{url}/reviews", json={"verdict": "defensive"})
        assert (refused.status_code, refused.json()["scope"]) == (403, "manoeuvres:review")
        assert http.get(url).json()["place"] is None
    with service.client(tenant, "manoeuvres:review") as http:
        given = http.post(f"{url}/reviews", json={"verdict": "defensive", "note": "A child."})
    assert given.status_code == 201
    conforms("ManoeuvreReview", given.json())
    assert (given.json()["before"], given.json()["after"]) == ("none", "defensive")
    assert counts() == ({}, {"braking": 1})
    assert admin.get(url).json()["excused"] == "reviewer"
    assert [one["note"] for one in admin.get(f"{url}/reviews").json()["reviews"]] == ["A child."]
    actions = [one["action"] for one in admin.get("/v1/audit").json()["entries"]]
    assert actions == ["trip.rescored", "manoeuvre.reviewed"]
    assert "A child." not in str(admin.get("/v1/audit").json())


def test_what_is_not_assessed_yet_and_what_is_not_there(service, admin, ref):
    trip, _ = driven(ref.pk)
    with write(service.database) as connection:
        connection.execute(insert(tables.trips), [trip | {"due_ns": None}])
    answer = admin.get(f"/v1/trips/{trip['id']}/risk")
    assert (answer.status_code, answer.json()["code"]) == (409, "not_assessed")
    assert int(answer.headers["retry-after"]) > 0
    assert admin.get(f"/v1/trips/{trip['id']}").json()["assessed"] is False
    for url in ("/v1/trips/none/risk", "/v1/trips/none/manoeuvres", "/v1/manoeuvres/none"):
        assert admin.get(url).status_code == 404
    assert admin.get(f"/v1/trips/{trip['id']}/risk?every=0").status_code == 422


@pytest.mark.parametrize(
    ("config", "says"),
    [
        ({"driver": {"age": 7}}, "age is 7; expected a driver's, 14 to 110"),
        ({"driver": {"birth_year": 2024}}, "born in 2024"),
        ({"driver": {"birth_year": 1980, "age": 40}}, "expected one of them"),
        ({"driver": {"birth_year": 1980, "licensed_year": 1985}}, "before the age of 14"),
        ({"time_zone": "Mars/Olympus"}, "no time zone; expected an IANA name"),
    ],
)
def test_settings_that_cannot_be_are_refused_clearly(admin, config, says):
    answer = admin.put("/v1/vehicles/other", json={"config": config})
    assert (answer.status_code, says in answer.text) == (422, True), answer.text


def test_a_place_of_a_manoeuvre_is_between_the_positions_around_it(service, ref):
    _, points = driven(ref.pk)
    t_ns = T0 + 10 * NS + 400_000_000
    nan = float("nan")
    episode = Episode(Manoeuvre.BRAKING, t_ns - NS, t_ns, t_ns + NS, 5.0, "", True, nan, nan, nan, 0.0, nan, 0.0, True)
    with write(service.database) as connection:
        connection.execute(insert(tables.track_points), points)
        store_episode(connection, ref, episode, 1)
        (row,) = manoeuvres.between(connection, ref.pk, t_ns - NS, t_ns)
    lon, lat = at(100.0 + SPEED_MPS * 10.4, 0.0)
    assert (row.lat_deg, row.lon_deg) == pytest.approx((lat, lon), abs=1e-9)
    assert (row.sd_n_m, row.speed_before_mps) == (0.8, None)
