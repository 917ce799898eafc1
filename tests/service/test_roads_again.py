"""Roads that could not be looked up, as the process that does it was killed, are looked up again, but not for ever.

Processes are real ones, and are killed.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from contextlib import contextmanager

import pytest
from sqlalchemy import insert

from core.driving.exposure import Facet
from core.scoring.pwyd import pwyd
from schemas.vehicles import VehicleConfig
from service.roads.matching import RoadService
from service.scoring.loading import shipped_model
from service.storage import records, tables, trips
from service.storage.database import read, write
from tests.service.stored_rows import NS
from tests.service.test_trip_risk_api import driven
from tests.service.trip_harness import Driver


@contextmanager
def all_killed():
    """Kill each process that looks up roads as soon as it lives; tells how many there were."""
    killed, over = set(), threading.Event()

    def kill():
        while not over.is_set():
            for process in multiprocessing.active_children():
                if process.name == "telefuse-roads" and process.pid not in killed:
                    os.kill(process.pid, signal.SIGKILL)
                    killed.add(process.pid)
            over.wait(0.005)

    thread = threading.Thread(target=kill)
    thread.start()
    try:
        yield killed
    finally:
        over.set()
        thread.join()


@pytest.fixture
def road(built_roads, database):
    """A trip that touches two minutes, and that nobody has assessed yet, and the roads under it."""
    with RoadService(built_roads, processes=1) as roads:
        driver = Driver(database, VehicleConfig(), roads)
        trip, points = driven(driver.ref.pk)
        with write(database) as connection:
            connection.execute(insert(tables.track_points), points)
            connection.execute(insert(tables.trips), [trip])
        driver.trip_id = trip["id"]
        yield driver


def row_of(driver):
    with read(driver.database) as connection:
        return trips.find(connection, "default", driver.trip_id)


def record_of(driver):
    with read(driver.database) as connection:
        return records.find(connection, driver.trip_id).record


def metric(driver, outcome):
    return driver.worker._metrics.registry.get_sample_value("telefuse_trips_unmatched_total", {"outcome": outcome})


def test_it_is_looked_up_again_and_then_is_as_if_nothing_had_been(road):
    with all_killed() as killed:
        road.worker.turn(5 * NS)
    assert len(killed) >= 2, "it was tried twice at once"
    row, record = row_of(road), record_of(road)
    assert (row.road_failures, row.due_ns, row.assessed_ns) == (1, 65 * NS, 5 * NS), "scored meanwhile"
    assert set(record.exposure.by[Facet.ROAD_CLASS]) == {""}
    assert record.mean_coverage()["environment.road_class"] == 0.0
    assert road.worker.turn(64 * NS) == 0, "not before its time"
    assert road.worker.turn(65 * NS) == 1
    row, record = row_of(road), record_of(road)
    assert (row.road_failures, row.due_ns) == (None, None)
    assert set(record.exposure.by[Facet.ROAD_CLASS]) == {"primary"}
    assert record.mean_coverage()["environment.road_class"] > 0.9
    assert (metric(road, "again"), metric(road, "given_up")) == (1.0, None)
    again = road.stored()
    with write(road.database) as connection:  # as if it had been assessed for the first time
        records.remove(connection, road.ref.pk)
        trips.mark_trip_due(connection, road.trip_id, 70 * NS)
    road.turn()
    assert road.stored() == again
    assert len(road.scored) == 3


def test_it_is_given_up_after_a_while_and_coverage_says_so(road, caplog):
    now_ns, waits_s = 5 * NS, []
    with all_killed():
        while True:
            assert road.worker.turn(now_ns) == 1
            row = row_of(road)
            if row.due_ns is None:
                break
            waits_s.append((row.due_ns - now_ns) // NS)
            now_ns = row.due_ns
    assert waits_s == sorted(waits_s)
    assert waits_s == [60, 300, 1800, 7200]
    assert row.road_failures == 5
    assert (metric(road, "again"), metric(road, "given_up")) == (4.0, 1.0)
    assert f"trip {road.trip_id}: the roads of 76 s could not be looked up and stay unknown" in caplog.text
    record = record_of(road)
    assert record.mean_coverage()["environment.road_class"] == 0.0
    assert pwyd(record, 1.0, shipped_model()).coverage["road_class"] == 0.0
    assert len(road.scored) == 1, "told once, as nothing changed"
    # What has it assessed anew later finds the roads all the same.
    with write(road.database) as connection:
        trips.mark_trip_due(connection, road.trip_id, now_ns + 1)
    road.worker.turn(now_ns + 1)
    assert (row_of(road).road_failures, row_of(road).due_ns) == (None, None)
    assert set(record_of(road).exposure.by[Facet.ROAD_CLASS]) == {"primary"}
