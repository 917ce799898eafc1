"""Trips with records made up at random, for tests of what is stored of them."""

from __future__ import annotations

import random

from sqlalchemy import insert

from core.driving.exposure import WEEKDAYS, Driven, Exposure, Facet
from core.scoring.record import BeliefSums, Evidence, Record, SpeedingSums
from schemas.vehicles import VehicleConfig
from service.local_days import day_of
from service.storage import cell_sums, record_sums, records, tenants, trip_cells, vehicles
from service.storage.records import TripRecord
from service.storage.tables import trip_records, trips

DAY_NS = 86_400_000_000_000


def a_vehicle(connection, name="v1"):
    """A registered vehicle's key."""
    tenants.ensure(connection, "t")
    return vehicles.put(connection, "t", name, VehicleConfig()).ref.pk


def a_trip(connection, vehicle_pk, trip_id, start_ns):
    """A trip's row alone."""
    figures = dict.fromkeys(("start_lat_deg", "start_lon_deg", "end_lat_deg", "end_lon_deg"), 0.0)
    figures |= dict.fromkeys(("distance_m", "moving_s", "coasting_s", "max_speed_mps"), 1.0)
    row = {"id": trip_id, "vehicle_pk": vehicle_pk, "start_ns": start_ns, "end_ns": start_ns + 1, "ended": True}
    connection.execute(insert(trips), [row | figures])


def a_record(rng: random.Random, trip_id="t") -> Record:
    """A record with something under each heading."""
    driven = Driven(rng.randrange(10**7), rng.randrange(10**6))
    by = {
        Facet.HOUR: {f"{rng.randrange(24):02d}": driven},
        Facet.WEEKDAY: {rng.choice(WEEKDAYS): driven},
        Facet.ROAD_CLASS: {rng.choice(["primary", "residential", ""]): driven},
    }
    return Record(
        trips=1,
        exposure=Exposure(driven, by),
        cells={f"88{rng.randrange(40):013x}": driven},
        coasting_ms=rng.randrange(1000),
        manoeuvres={rng.choice(["braking", "cornering"]): 1},
        speeding=SpeedingSums(*(rng.randrange(1000) for _ in range(8))),
        belief={"fused": BeliefSums(1, tuple(rng.randrange(10**9) for _ in range(8)))},
        coverage={"driver.age": rng.randrange(10**9)},
        evidence={"distance": (Evidence(driven.distance_mm, "trip", trip_id),)},
    )


def a_trip_record(rng, vehicle_pk, trip_id, start_ns) -> TripRecord:
    """A trip's record as it is stored."""
    return TripRecord(trip_id, vehicle_pk, start_ns, a_record(rng, trip_id), b"", "0" * 64, 1)


def put(connection, row: TripRecord, zone="UTC"):
    """Store a trip with its record."""
    a_trip(connection, row.vehicle_pk, row.trip_id, row.start_ns)
    records.put(connection, row, zone=zone)


def put_all(connection, rows, zone="UTC"):
    """Store many trips of a vehicle with their records, summed up once."""
    for row in rows:
        a_trip(connection, row.vehicle_pk, row.trip_id, row.start_ns)
    values = [
        {
            "trip_id": row.trip_id,
            "vehicle_pk": row.vehicle_pk,
            "start_ns": row.start_ns,
            "day": day_of(row.start_ns, zone),
            "model_sha256": row.model_sha256,
            "assessed_ns": row.assessed_ns,
            "record": record_sums.told_of(row.record),
            "cells": cell_sums.packed(row.record.cells),
            "timeline": row.timeline,
        }
        for row in rows
    ]
    connection.execute(insert(trip_records), values)
    trip_cells.replace(connection, rows[0].vehicle_pk, [], [(one["start_ns"], one["cells"]) for one in values])
    records.rebuild(connection, rows[0].vehicle_pk, zone=zone)
