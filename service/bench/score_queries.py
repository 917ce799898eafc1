"""How long a score of any period takes over HTTP, and its record alone, of a vehicle with many trips over years.

Trips go between a home, a place of work and others, so that cells, districts and hours repeat as a vehicle's do.
"""

from __future__ import annotations

import gc
import json
import random
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import h3
import httpx
import numpy as np
from sqlalchemy import Connection, Engine, insert

from core.driving.exposure import WEEKDAYS, Driven, Exposure, Facet, Light
from core.driving.manoeuvres import Manoeuvre
from core.risk.assessment import ENTITIES
from core.risk.belief import N_SETS
from core.scoring.places import places_from
from core.scoring.record import BeliefSums, Evidence, Record, SpeedingSums
from core.scoring.score import Product
from schemas.notifications import rfc3339
from schemas.vehicles import VehicleConfig
from service.bench.target import TargetFailedError
from service.cells import RESOLUTION
from service.demo.service_process import ServiceProcess, free_port
from service.local_days import day_of
from service.rating.parts import Part
from service.storage import cell_sums, rating, record_sums, records, schema, tenants, trip_cells, vehicles
from service.storage.database import open_database, read, write
from service.storage.rating import RatingRow
from service.storage.tables import trip_records, trips

TRIPS: Final = 10_000
YEARS: Final = 5
QUERIES: Final = 1000
AT_MOST_MS: Final = 20.0
"""What a score over HTTP may take at its 99th percentile."""
VEHICLE: Final = "many-trips"
BEGIN_NS: Final = 1_577_836_800_000_000_000
_SPAN_NS: Final = YEARS * 365 * 86_400_000_000_000
_TIMELINE_BYTES: Final = 2_000
_CLASSES: Final = ("motorway", "primary", "secondary", "tertiary", "residential", "service", "")
_COVERAGE: Final = ("driver.age", "driver.sex", "environment.light", "environment.road", "vehicle.speed", "vehicle.g")
_CHUNK: Final = 500


def seed(connection: Connection, vehicle_pk: int, count: int = TRIPS, *, rng: random.Random | None = None) -> None:
    """Give a vehicle so many trips with records, evenly over the years; the same for the same ``rng``."""
    rng = rng or random.Random(1)
    places = _places(rng)
    rows, told, driven = [], [], []
    for number in range(count):
        start_ns = BEGIN_NS + number * (_SPAN_NS // count) + rng.randrange(_SPAN_NS // count)
        trip_id = f"{vehicle_pk}-{number}"
        record = _record(rng, trip_id, start_ns, rng.choice(places))
        rows.append(_trip(vehicle_pk, trip_id, start_ns, record))
        driven.append((start_ns, cell_sums.packed(record.cells)))
        told.append(
            {
                "trip_id": trip_id,
                "vehicle_pk": vehicle_pk,
                "start_ns": start_ns,
                "day": day_of(start_ns),
                "model_sha256": "0" * 64,
                "assessed_ns": start_ns,
                "record": record_sums.told_of(record),
                "cells": driven[-1][1],
                "timeline": bytes(_TIMELINE_BYTES),
            }
        )
    for begin in range(0, count, _CHUNK):
        connection.execute(insert(trips), rows[begin : begin + _CHUNK])
        connection.execute(insert(trip_records), told[begin : begin + _CHUNK])
    trip_cells.replace(connection, vehicle_pk, [], driven)
    records.rebuild(connection, vehicle_pk)


def periods(count: int, rng: random.Random | None = None) -> Iterator[tuple[int, int]]:
    """Periods that somebody may ask for: any from a day to all the years, some on the borders of months and years."""
    rng = rng or random.Random(2)
    for number in range(count):
        if number % 4 == 0:
            yield BEGIN_NS, BEGIN_NS + _SPAN_NS
            continue
        length_ns = int(86_400e9 * YEARS ** (4.66 * rng.random()))  # a day to all of it, evenly by logarithm
        from_ns = BEGIN_NS + rng.randrange(max(1, _SPAN_NS - length_ns))
        yield from_ns, from_ns + length_ns


def measure(
    url: str | None = None,
    tell: Callable[[int, int], None] | None = None,
    *,
    trips_in_all: int = TRIPS,
    queries: int = QUERIES,
) -> dict[str, Any]:
    """Milliseconds of a score over HTTP, of a service of its own on a loopback connection that is kept, and of reading
    the record alone; ``url`` is an empty database, by default a SQLite file."""
    with TemporaryDirectory(prefix="telefuse-bench-") as directory:
        url = url or f"sqlite:///{Path(directory) / 'scores.db'}"
        tell = tell or (lambda done, of: None)
        found = _of_storage(url, trips_in_all, queries, lambda done: tell(done, 3 * queries))
        return found | _over_http(Path(directory), url, queries, lambda done: tell(2 * queries + done, 3 * queries))


def _over_http(directory: Path, url: str, queries: int, tell: Callable[[int], None]) -> dict[str, Any]:
    service = ServiceProcess(directory / "service", free_port(), free_port(), zenoh_mode="off", database_url=url)
    service.start()
    try:
        with httpx.Client(base_url=service.http_url, trust_env=False) as client:
            figures: dict[str, Any] = {"http_floor_ms": _percentiles([_ms(client, "/livez") for _ in range(queries)])}
            spent: dict[str, list[float]] = {product: [] for product in Product}
            for number, (from_ns, to_ns) in enumerate(periods(queries, random.Random(4))):
                product = list(Product)[number % len(Product)]
                path = f"/v1/vehicles/{VEHICLE}/scores/{product}"
                spent[product].append(_ms(client, path, {"from": rfc3339(from_ns), "to": rfc3339(to_ns)}))
                tell(number)
    finally:
        service.stop()
    figures["http_ms"] = _percentiles([one for of_product in spent.values() for one in of_product])
    return figures | {f"http_{product}_ms": _percentiles(of_product) for product, of_product in spent.items()}


def _ms(client: httpx.Client, path: str, query: dict[str, str] | None = None) -> float:
    begin = time.perf_counter()
    response = client.get(path, params=query)
    spent = 1e3 * (time.perf_counter() - begin)
    if response.is_error:
        raise TargetFailedError(f"{path} answers {response.status_code}: {response.text}")
    return spent


def _of_storage(url: str, trips_in_all: int, queries: int, tell: Callable[[int], None]) -> dict[str, Any]:
    with _database(url) as engine:
        schema.upgrade(engine)
        with write(engine) as connection:
            tenants.ensure(connection, tenants.DEFAULT_TENANT)
            pk = vehicles.put(connection, tenants.DEFAULT_TENANT, VEHICLE, VehicleConfig()).ref.pk
            begin = time.perf_counter()
            seed(connection, pk, trips_in_all)
            rating.add(connection, tenants.DEFAULT_TENANT, _risk_of_places())
            seeded_s = time.perf_counter() - begin
        gc.freeze()  # as the service does: see service.cli.serve
        found: dict[str, Any] = {
            "database": engine.dialect.name,
            "trips": trips_in_all,
            "years": YEARS,
            "queries": queries,
        }
        for cells in (False, True):
            spent = []
            for number, (from_ns, to_ns) in enumerate(periods(queries)):
                begin = time.perf_counter()
                with read(engine) as connection:
                    records.of_period(connection, pk, from_ns, to_ns, cells=cells)
                spent.append(1e3 * (time.perf_counter() - begin))
                tell(number + cells * queries)
            name = "with_cells_ms" if cells else "ms"
            found[name] = _percentiles(spent)
        found["put_ms"] = _putting_ms(engine, pk, trips_in_all)
        return found | {"at_most_ms": AT_MOST_MS, "seeded_s": round(seeded_s, 1)}


def _putting_ms(engine: Engine, vehicle_pk: int, trips_in_all: int) -> dict[str, float]:
    rng, spent = random.Random(3), []
    for number in rng.sample(range(trips_in_all), 50):
        with write(engine) as connection:
            row = records.find(connection, f"{vehicle_pk}-{number}")
            assert row is not None
            begin = time.perf_counter()
            records.put(connection, row)
            spent.append(1e3 * (time.perf_counter() - begin))
    return _percentiles(spent)


def _percentiles(spent_ms: list[float]) -> dict[str, float]:
    return {f"p{share}": float(np.percentile(spent_ms, share)) for share in (50, 99)}


def lines(found: dict[str, Any]) -> str:
    """The figures for people."""
    text = [f"{found['database']}, {found['trips']} trips over {found['years']} years, {found['queries']} periods:"]
    told = {
        "http_ms": "score over HTTP",
        **{f"http_{product}_ms": f"  {product}" for product in Product},
        "http_floor_ms": "/livez over HTTP",
        "ms": "record alone",
        "with_cells_ms": "  with cells",
        "put_ms": "put with sums",
    }
    for name, what in told.items():
        text.append(f"  {what:16} p50 {found[name]['p50']:6.2f} ms, p99 {found[name]['p99']:6.2f} ms")
    return "\n".join([*text, f"  asked of a score over HTTP: p99 within {found['at_most_ms']:g} ms"])


@contextmanager
def _database(url: str) -> Iterator[Engine]:
    engine = open_database(url)
    try:
        yield engine
    finally:
        engine.dispose()


def _places(rng: random.Random) -> list[list[str]]:
    """Ways by their cells: a few that are driven daily, many that are driven once or twice a year."""
    home = h3.latlng_to_cell(60.2, 24.9, RESOLUTION)
    around = sorted(h3.grid_disk(home, 25))
    ways = [h3.grid_path_cells(home, rng.choice(around)) for _ in range(150)]
    return [*ways, *ways[:4] * 60]


def _risk_of_places() -> RatingRow:
    """A tenant's own, of every cell that is driven in, so that PWYD has all of them to tell about."""
    rng = random.Random(5)
    cells = sorted({cell for way in _places(random.Random(1)) for cell in way})
    risk = places_from(dict.fromkeys(cells, Driven(10**9, 10**8)), {cell: rng.randrange(4) for cell in cells})
    return RatingRow(Part.PLACES, 1, json.dumps(risk.to_json()), BEGIN_NS, None)


def _record(rng: random.Random, trip_id: str, start_ns: int, way: list[str]) -> Record:
    at = datetime.fromtimestamp(start_ns // 1_000_000_000, UTC)
    parts = [Driven(rng.randrange(200_000, 900_000), rng.randrange(20_000, 90_000)) for _ in way]
    total = Driven(sum(one.distance_mm for one in parts), sum(one.time_ms for one in parts))
    kinds = {_CLASSES[rng.randrange(len(_CLASSES))]: total, "residential": parts[0]}
    by: dict[Facet, dict[str, Driven]] = {
        Facet.HOUR: {f"{at.hour:02d}": total},
        Facet.LIGHT: {rng.choice(list(Light)): total},
        Facet.WEEKDAY: {WEEKDAYS[at.weekday()]: total},
        Facet.MONTH: {f"{at.month:02d}": total},
        Facet.ROAD_CLASS: kinds,
        Facet.DISTRICT: {f"district {rng.randrange(60)}": total},
    }
    instants = total.time_ms // 1000
    masses = {
        name: BeliefSums(instants, tuple(rng.randrange(10**12) for _ in range(N_SETS))) for name in (*ENTITIES, "fused")
    }
    trip = (Evidence(total.distance_mm, "trip", trip_id),)
    facets = (Facet.HOUR, Facet.ROAD_CLASS, Facet.DISTRICT)
    about = [f"{facet}:{label}" for facet in facets for label in by[facet] if label]
    manoeuvres = [str(kind) for kind in Manoeuvre if rng.random() < 0.1]
    return Record(
        trips=1,
        exposure=Exposure(total, by),
        cells=dict(zip(way, parts, strict=True)),
        coasting_ms=rng.randrange(60_000),
        manoeuvres=dict.fromkeys(manoeuvres, 1),
        speeding=SpeedingSums(*(rng.randrange(100_000) for _ in range(8))),
        belief=masses,
        coverage={name: rng.randrange(10**12) for name in _COVERAGE},
        evidence=dict.fromkeys(("mileage", "speeding", "vehicle", *about), trip)
        | {kind: (Evidence(rng.randrange(4000, 9000), "manoeuvre", f"{kind}-{trip_id}"),) for kind in manoeuvres},
    )


def _trip(vehicle_pk: int, trip_id: str, start_ns: int, record: Record) -> dict[str, Any]:
    driven = record.exposure.total
    return {
        "id": trip_id,
        "vehicle_pk": vehicle_pk,
        "start_ns": start_ns,
        "end_ns": start_ns + driven.time_ms * 1_000_000,
        "ended": True,
        "start_lat_deg": 60.2,
        "start_lon_deg": 24.9,
        "end_lat_deg": 60.2,
        "end_lon_deg": 24.9,
        "distance_m": driven.distance_m,
        "moving_s": driven.time_s,
        "coasting_s": 0.0,
        "max_speed_mps": 25.0,
        "assessed_ns": start_ns,
        "model_sha256": "0" * 64,
    }
