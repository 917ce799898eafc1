"""Trips, tracks, accidents and the event feed over HTTP."""

from __future__ import annotations

import time
from uuid import uuid4

import pytest
from sqlalchemy import insert

from schemas.notifications import EventType, rfc3339
from service.storage import tables
from service.storage.database import write
from service.webhooks import outbox
from service.webhooks.outbox import NewEvent
from tests.service.stored_rows import NS, T0, accident_row, point_row, trip_row


@pytest.fixture(scope="module")
def service(any_service):
    return any_service


@pytest.fixture
def admin(service, tenant):
    with service.client(tenant, "admin") as client:
        yield client


@pytest.fixture
def pk(service, tenant):
    return service.runtime.directory.register(tenant, "car").ref.pk


def add(service, table, rows):
    with write(service.database) as connection:
        connection.execute(insert(table), rows)


# --- trips ------------------------------------------------------------------------------------------


def test_trips_that_touch_the_time_newest_first(service, admin, pk):
    add(service, tables.trips, [trip_row(pk, 0, 100), trip_row(pk, 200, 300), trip_row(pk, 400, 500, ended=False)])

    def starts(**params):
        trips = admin.get("/v1/vehicles/car/trips", params=params).json()["trips"]
        return [trip["start_at"] for trip in trips]

    at = [rfc3339(T0 + second * NS) for second in (0, 200, 400)]
    assert starts() == at[::-1]
    assert starts(**{"from": rfc3339(T0 + 250 * NS)}) == [at[2], at[1]]
    assert starts(to="2027-01-15T09:03:20.5+01:00") == [at[1], at[0]]
    assert starts(**{"from": rfc3339(T0 + 101 * NS), "to": rfc3339(T0 + 199 * NS)}) == []
    first = admin.get("/v1/vehicles/car/trips?limit=2")
    assert [trip["start_at"] for trip in admin.get(first.links["next"]["url"]).json()["trips"]] == at[:1]


@pytest.mark.parametrize("text", ["yesterday", "2027-01-15", "2027-13-01T00:00:00Z", "2027-01-15T08:00:00", "1e9"])
def test_a_time_that_is_none_is_refused_by_name(admin, pk, text):
    answer = admin.get("/v1/vehicles/car/trips", params={"from": text})
    assert answer.status_code == 422
    assert "query.from" in answer.json()["detail"]


def test_a_track_is_geojson_with_time_and_spread_at_each_position(service, admin, pk):
    trip = trip_row(pk, 0, 2)
    add(service, tables.trips, [trip])
    add(service, tables.track_points, [point_row(pk, s, 57.7 + s / 1000, 11.97) for s in (-1, 0, 1, 2, 3)])
    answer = admin.get(f"/v1/trips/{trip['id']}/track")
    assert answer.headers["content-type"] == "application/geo+json"
    (feature,) = answer.json()["features"]
    assert feature["geometry"] == {
        "type": "LineString",
        "coordinates": [[11.97, 57.7, 40.0], [11.97, 57.701, 40.0], [11.97, 57.702, 40.0]],
    }
    properties = feature["properties"]
    assert properties["times"] == [rfc3339(T0 + s * NS) for s in (0, 1, 2)]
    assert properties["mode"] == ["aided"] * 3
    assert properties["sd_n_m"] == [0.8] * 3
    assert {len(values) for values in properties.values() if isinstance(values, list)} == {3}


@pytest.mark.parametrize(("seconds", "kind"), [([], None), ([1], "Point")])
def test_a_track_of_less_than_two_positions_is_no_line(service, admin, pk, seconds, kind):
    trip = trip_row(pk, 0, 2)
    add(service, tables.trips, [trip])
    if seconds:
        add(service, tables.track_points, [point_row(pk, second) for second in seconds])
    geometry = admin.get(f"/v1/trips/{trip['id']}/track").json()["features"][0]["geometry"]
    assert (geometry and geometry["type"]) == kind


# --- accidents --------------------------------------------------------------------------------------


def found(admin, **params):
    answer = admin.get("/v1/accidents", params=params)
    assert answer.status_code == 200, answer.text
    assert answer.headers["content-type"] == "application/geo+json"
    return [feature["id"] for feature in answer.json()["features"]]


def test_an_accident_says_where_how_hard_and_how_sure(service, admin, tenant, pk):
    row = accident_row(tenant, pk, 5)
    add(service, tables.accidents, [row])
    feature = admin.get(f"/v1/accidents/{row['id']}").json()
    assert feature["geometry"] == {"type": "Point", "coordinates": [11.97, 57.7, 40.0]}
    properties = feature["properties"]
    assert properties["vehicle_id"] == "car"
    assert properties["time"] == "2027-01-15T08:00:05.000000Z"
    assert (properties["sd_n_m"], properties["mode"]) == (1.5, "coasting")
    assert (properties["delta_v_mps"], properties["delta_v_b_mps"]) == (9.0, [-9.0, 0.4])
    assert admin.get("/v1/accidents").json()["features"] == [feature]


def test_accidents_by_place_also_across_the_antimeridian(service, admin, tenant, pk):
    gothenburg, fiji, tonga, pole = rows = [
        accident_row(tenant, pk, 0, 57.7, 11.97),
        accident_row(tenant, pk, 1, -17.0, 179.5),
        accident_row(tenant, pk, 2, -20.0, -175.2),
        accident_row(tenant, pk, 3, 90.0, 0.0),
    ]
    add(service, tables.accidents, rows)
    assert found(admin, bbox="11,57,12,58") == [gothenburg["id"]]
    assert found(admin, bbox="11,57,-100,12,58,100") == [gothenburg["id"]], "heights are not looked at"
    assert found(admin, bbox="177,-21,-175,-16") == [tonga["id"], fiji["id"]]
    assert found(admin, bbox="-175,-21,177,-16") == []
    assert found(admin, bbox="-180,-90,180,90") == [row["id"] for row in (pole, tonga, fiji, gothenburg)]
    assert found(admin, bbox="11.97,57.7,11.97,57.7") == [gothenburg["id"]], "edges are included"


@pytest.mark.parametrize(
    "bbox", ["", "1,2,3", "1,2,3,4,5", "a,b,c,d", "0,10,1,9", "0,0,181,1", "0,-91,1,0", "nan,0,1,1", "0,0,inf,1"]
)
def test_a_box_that_is_none_is_refused(admin, bbox):
    answer = admin.get("/v1/accidents", params={"bbox": bbox})
    assert (answer.status_code, answer.json()["code"]) == (422, "invalid_request")
    assert "query.bbox" in answer.json()["detail"]


def test_accidents_by_time_severity_and_vehicle(service, admin, tenant, pk):
    other = service.runtime.directory.register(tenant, "other").ref.pk
    low, severe, airbag = rows = [
        accident_row(tenant, pk, 0, severity="low_speed"),
        accident_row(tenant, pk, 60, severity="severe"),
        accident_row(tenant, other, 120, severity="airbag"),
    ]
    add(service, tables.accidents, rows)
    at = [rfc3339(T0 + second * NS) for second in (0, 60, 120)]
    assert found(admin, datetime=at[1]) == [severe["id"]]
    assert found(admin, datetime=f"{at[0]}/{at[1]}") == [severe["id"], low["id"]]
    assert found(admin, datetime=f"{at[1]}/..") == [airbag["id"], severe["id"]]
    assert found(admin, datetime=f"../{at[0]}") == found(admin, datetime=f"/{at[0]}") == [low["id"]]
    assert found(admin, severity=["severe", "airbag"]) == [airbag["id"], severe["id"]]
    assert found(admin, vehicle="other") == [airbag["id"]]
    assert found(admin, vehicle="car", severity="airbag") == []
    for wrong in ("../..", f"{at[1]}/{at[0]}", "now", f"{at[0]}/{at[1]}/{at[2]}"):
        assert admin.get("/v1/accidents", params={"datetime": wrong}).status_code == 422
    assert admin.get("/v1/accidents", params={"severity": "total"}).status_code == 422


def test_pages_of_accidents_keep_the_filter_and_split_what_happened_at_once(service, admin, tenant, pk):
    add(service, tables.accidents, [accident_row(tenant, pk, 0) for _ in range(5)])
    add(service, tables.accidents, [accident_row(tenant, pk, 0, severity="airbag")])
    url, seen = "/v1/accidents?severity=severe&limit=2", []
    while url:
        answer = admin.get(url)
        body = answer.json()
        assert body["numberReturned"] == len(body["features"])
        seen += [feature["id"] for feature in body["features"]]
        url = next((link["href"] for link in body["links"] if link["rel"] == "next"), None)
        assert answer.links.get("next", {}).get("url") == url
    assert len(seen) == len(set(seen)) == 5


# --- events -----------------------------------------------------------------------------------------


def publish(service, tenant, pk, kind, second=0):
    event = NewEvent(str(uuid4()), tenant, pk, kind, T0 + second * NS, time.time_ns(), {"n": second})
    with write(service.database) as connection:
        outbox.publish(connection, event)
    return event.id


def test_the_feed_goes_on_from_its_cursor_and_waits_at_its_end(service, admin, tenant, pk):
    ids = [publish(service, tenant, pk, EventType.TRIP_COMPLETED, second) for second in range(3)]
    page = admin.get("/v1/events?limit=2").json()
    assert [event["id"] for event in page["events"]] == ids[:2]
    assert page["more"] is True
    assert page["cursor"] == page["events"][-1]["cursor"]
    end = admin.get("/v1/events", params={"after": page["cursor"]}).json()
    assert [event["id"] for event in end["events"]] == ids[2:]
    assert end["more"] is False
    assert end["events"][0]["vehicle_id"] == "car"
    assert end["events"][0]["data"] == {"n": 2}
    nothing = admin.get("/v1/events", params={"after": end["cursor"]}).json()
    assert nothing == {"events": [], "cursor": end["cursor"], "more": False}
    late = publish(service, tenant, pk, EventType.ACCIDENT_DETECTED)
    again = admin.get("/v1/events", params={"after": nothing["cursor"]}).json()
    assert [event["id"] for event in again["events"]] == [late]


def test_a_key_sees_the_events_that_its_scopes_are_about(service, tenant, pk):
    accident = publish(service, tenant, pk, EventType.ACCIDENT_DETECTED)
    trip = publish(service, tenant, pk, EventType.TRIP_COMPLETED)
    publish(service, tenant, None, EventType.PING)
    for scopes, expected in [
        (["accidents:read"], [accident]),
        (["vehicles:read"], [trip]),
        (["accidents:read", "vehicles:*"], [accident, trip]),
        (["scores:read"], []),
    ]:
        with service.client(tenant, *scopes) as client:
            events = client.get("/v1/events").json()["events"]
            assert [event["id"] for event in events] == expected
    with service.client(tenant, "telemetry:write") as client:
        assert client.get("/v1/events").status_code == 403
