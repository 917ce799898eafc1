"""Erasure: nothing of what was asked for is left in any table, sums follow, and the vehicle goes on."""

from __future__ import annotations

import time
from datetime import UTC, datetime

import pytest
from sqlalchemy import func, select

from core.scoring.places import places_from
from core.scoring.record import Record
from schemas.packet import encode_packet
from service.storage import records, tables
from service.storage.database import read
from service.storage.erasure import EVER_NS
from service.storage.tables import metadata
from tests.service.fleet_drives import RATE_HZ, S, seconds
from tests.service.fleet_drives import trips as drives
from tests.service.trip_harness import MOUNTED

WAIT_S = 120.0
AT_ONCE = 64
TIMES = ("t_ns", "start_ns", "start_t_ns", "valid_from_ns")
"""Columns that say when something was; others say when it was stored."""
STAYS = {"vehicles", "checkpoints", "erasure_requests"}
"""Registration, in which order packets came, and the request itself."""


def rows_about(database, pk, from_ns=None, to_ns=None):
    """How many rows of each table are about a vehicle, and a time; those that belong to such a row as well."""
    found = {}
    with read(database) as connection:
        for table in metadata.sorted_tables:
            column = next((table.c[name] for name in TIMES if name in table.c), None)
            if "vehicle_pk" in table.c:
                chosen = table.c.vehicle_pk == pk
                if from_ns is not None and column is not None:
                    chosen &= (column >= from_ns) & (column < to_ns)
                elif from_ns is not None:
                    continue
            elif table is tables.deliveries:
                chosen = table.c.event_id.in_(select(tables.events.c.id).where(tables.events.c.vehicle_pk == pk))
            else:
                continue
            found[table.name] = connection.scalar(select(func.count()).select_from(table).where(chosen))
    return {name: count for name, count in found.items() if count}


def rfc3339(t_ns):
    return datetime.fromtimestamp(t_ns / 1e9, UTC).isoformat()


def varint(value):
    return bytes([value]) if value < 0x80 else bytes([value & 0x7F | 0x80]) + varint(value >> 7)


class Car:
    """A registered car that sends over HTTP and whose trips are waited for."""

    def __init__(self, service, tenant, name):
        self.service, self.name = service, name
        self.http = service.client(tenant, "admin")
        answer = self.http.put(f"/v1/vehicles/{name}", json={"config": MOUNTED.model_dump(mode="json")})
        assert answer.status_code == 201
        self.pk = service.runtime.directory.resolve(tenant, name).pk
        self.sent = 0

    def send(self, parts):
        for first in range(0, len(parts), AT_ONCE):
            body = b""
            for part in parts[first : first + AT_ONCE]:
                self.sent += 1
                packet = encode_packet(self.name, "b", self.sent, part, period_ns=round(S / RATE_HZ), wide=True)
                message = packet.SerializeToString()
                body += varint(len(message)) + message
            headers = {"Content-Type": "application/x-protobuf"}
            answer = self.http.post("/v1/telemetry", content=body, headers=headers)
            assert answer.status_code == 202, answer.text
        assert self.service.runtime.engine.drain(WAIT_S)

    def trips(self, count):
        """Its trips, oldest first, once so many are assessed."""
        deadline = time.monotonic() + WAIT_S
        while time.monotonic() < deadline:
            rows = self.http.get(f"/v1/vehicles/{self.name}/trips").json()["trips"][::-1]
            if len(rows) == count and all(row["assessed"] for row in rows):
                return rows
            time.sleep(0.1)
        raise AssertionError(f"no {count} trips were assessed: {rows}")

    def record(self):
        with read(self.service.database) as connection:
            return records.of_period(connection, self.pk, *EVER_NS, cells=True)

    def erase(self, expected=201, key=None, **asked):
        headers = {} if key is None else {"Idempotency-Key": key}
        body = {"vehicle_id": self.name, "reason": "they asked"} | asked
        answer = self.http.post("/v1/erasure-requests", json=body, headers=headers)
        assert answer.status_code == expected, answer.text
        return answer.json()


@pytest.fixture(scope="module")
def packets():
    return [[one for part in list(drives(3))[2 * n : 2 * n + 2] for one in seconds(part)] for n in range(3)]


@pytest.fixture
def car(any_service, tenant, packets):
    """A car after two trips, one of two of a tenant."""
    neighbour = Car(any_service, tenant, "neighbour")
    neighbour.send(packets[0][:40])
    car = Car(any_service, tenant, "car")
    car.send(packets[0] + packets[1])
    car.neighbour = neighbour
    car.trips(2)
    return car


def test_all_of_a_vehicle_goes_and_it_drives_on(car, packets):
    database, others = car.service.database, rows_about(car.service.database, car.neighbour.pk)
    before = rows_about(database, car.pk)
    assert {"journal", "track_points", "trips", "trip_records", "record_rollups", "events"} <= before.keys()
    told = car.erase(key="one")
    assert rows_about(database, car.pk).keys() <= STAYS
    assert rows_about(database, car.neighbour.pk) == others
    assert told["removed"]["journal"] == before["journal"]
    assert told["removed"]["trips"] == 2
    assert told["from"] is None
    assert car.http.get(f"/v1/erasure-requests/{told['id']}").json() == told
    assert car.record() == Record()
    state = car.http.get("/v1/vehicles/car/state").json()
    assert (state["fused"], state["last_packet"]) == (None, None)
    entry = car.http.get("/v1/audit").json()["entries"][0]
    assert (entry["action"], entry["subject"]) == ("vehicle.data_erased", "vehicle/car")
    car.send(packets[2])
    (trip,) = car.trips(1)
    assert car.record().distance_m > 1000.0
    assert car.erase(key="one") == told, "repeated, it does nothing more"
    assert car.trips(1) == [trip]


def evidence(car):
    """What is named behind everything that the scores say of the car's own driving."""
    told = car.http.get("/v1/vehicles/car/scores").json()["scores"].values()
    said = [one for score in told for one in score["contributions"] if one["name"] not in ("base", "limit")]
    # A share, a rate or a count of nothing rests on nothing.
    unfounded = [one["name"] for one in said if one["value"] and not one["evidence"]]
    assert unfounded == []
    assert [one["name"] for one in said if one["name"].startswith("cell:") and one["evidence"]]
    return {(piece["kind"], piece["id"]) for one in said for piece in one["evidence"]}


def rate_places(car):
    """Have a risk of each place, so that scores tell of cells."""
    driven = {cell: one for cell, one in car.record().cells.items() if cell}
    known = sorted(driven, key=driven.get)
    places = places_from(driven, {known[-1]: 7, known[0]: 1})
    assert car.http.put("/v1/rating/places", json=places.to_json()).status_code == 200


def test_of_a_time_whole_trips_go_and_the_others_stay(car):
    database, pk = car.service.database, car.pk
    first, second = car.trips(2)
    rate_places(car)
    with read(database) as connection:
        stored = {
            (kind, one)
            for kind, table in (
                ("trip", tables.trips),
                ("manoeuvre", tables.manoeuvres),
                ("accident", tables.accidents),
            )
            for one in connection.scalars(select(table.c.id).where(table.c.vehicle_pk == pk))
        }
    named = evidence(car)
    assert {("trip", first["id"]), ("trip", second["id"])} <= named <= stored
    with read(database) as connection:
        spans = connection.execute(
            select(tables.trips.c.start_ns, tables.trips.c.end_ns)
            .where(tables.trips.c.vehicle_pk == pk)
            .order_by(tables.trips.c.start_ns)
        ).all()
        kept = records.find(connection, second["id"]).record
    midst = (spans[0][0] + spans[0][1]) // 2
    told = car.erase(**{"from": rfc3339(midst), "to": rfc3339(spans[0][1] + 20 * S)})
    assert told["removed"]["trips"] == 1
    assert "sessions" not in told["removed"], "it ended two hours later"
    assert rows_about(database, pk, spans[0][0], spans[0][1] + 20 * S) == {}
    assert [row["id"] for row in car.trips(1)] == [second["id"]]
    newest = [one["data"] for one in car.http.get("/v1/events").json()["events"] if one["type"] == "score.updated"][-1]
    assert (newest["cause"], newest["vehicle_id"]) == ("erasure", "car"), "scores of what is left"
    named = evidence(car)
    assert ("trip", first["id"]) not in named
    assert ("trip", second["id"]) in named
    record = car.record()
    assert (record.distance_m, record.cells, record.days) == (kept.distance_m, kept.cells, 1)
    assert rows_about(database, pk)["journal"] > 200


def test_what_the_session_still_knows_goes_as_well(car, packets):
    database = car.service.database
    car.send(packets[2][:100])  # on the way
    third_ns = int(packets[2][0].imu_t_ns[0])
    told = car.erase(**{"from": rfc3339(third_ns)})
    assert told["removed"]["sessions"] == 1
    assert rows_about(database, car.pk, third_ns, EVER_NS[1]) == {}
    car.send(packets[2][100:])
    rows = car.trips(3)
    assert datetime.fromisoformat(rows[-1]["start_at"]).timestamp() * 1e9 >= packets[2][100].imu_t_ns[0]


def test_unregistered_nothing_but_the_request_is_left(car):
    told = car.erase(unregister=True)
    assert rows_about(car.service.database, car.pk) == {}
    assert told["removed"]["vehicles"] == 1
    assert car.http.get("/v1/vehicles/car").status_code == 404
    assert car.http.get(f"/v1/erasure-requests/{told['id']}").json() == told


@pytest.mark.parametrize(
    ("asked", "status", "says"),
    [
        ({"vehicle_id": "nobody"}, 404, "no vehicle 'nobody'"),
        ({"from": "2026-01-02T00:00:00Z", "to": "2026-01-01T00:00:00Z"}, 422, "not after"),
        ({"from": "yesterday"}, 422, "RFC 3339"),
        ({"from": "2026-01-01T00:00:00Z", "unregister": True}, 422, "neither from nor to"),
    ],
)
def test_what_cannot_be_erased_is_refused_clearly(service, tenant, asked, status, says):
    with service.client(tenant, "admin") as http:
        http.put("/v1/vehicles/car", json={})
        answer = http.post("/v1/erasure-requests", json={"vehicle_id": "car", "reason": ""} | asked)
        assert (answer.status_code, says in answer.text) == (status, True), answer.text
    with service.client(tenant, "vehicles:write") as http:
        assert http.post("/v1/erasure-requests", json={"vehicle_id": "car", "reason": ""}).status_code == 403
        assert http.get("/v1/erasure-requests/1").status_code == 403
