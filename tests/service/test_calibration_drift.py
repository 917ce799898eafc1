"""What trips make of a calibration's biases, through the engine: stored with their events, the same when repeated."""

from __future__ import annotations

import math

import pytest
from sqlalchemy import select

from schemas.calibration import Calibration, GyroscopeCalibration, SensorCalibration, TriadSd
from schemas.packet import encode_packet
from schemas.vehicles import VehicleConfig
from service.calibrations import giving
from service.engine.shard import EngineConfig
from service.engine.worker import Engine
from service.ingest.journal_rows import insert_rows
from service.observability import Metrics
from service.storage import calibrations, schema
from service.storage.calibrations import EVER_NS, NewCalibration
from service.storage.database import open_database, read, write
from service.storage.tables import calibrations as table
from service.storage.tables import checkpoints, events, track_points
from service.storage.vehicles import VehicleDirectory
from tests.service.fleet_drives import BETWEEN_NS, RATE_HZ, S, drive, seconds, trips

WAIT_S = 120.0
ERRORS = drive().truth["sensor_errors"]
TRUE = Calibration(
    accelerometer=SensorCalibration(**ERRORS["accelerometer"], sd=TriadSd(bias=(0.01, 0.01, 0.01))),
    gyroscope=GyroscopeCalibration(**ERRORS["gyroscope"], sd=TriadSd(bias=(2e-4, 2e-4, 2e-4))),
)
MOUNTED = VehicleConfig(mounting_rpy_deg=tuple(math.degrees(angle) for angle in drive().mounting_rpy_rad))
DRIFTED_FROM = 1
TRIPS = 3


class Fleet:
    """One vehicle with its calibration, packets of its trips in the journal, and engines over them."""

    def __init__(self, database) -> None:
        self.database = database
        self.directory = VehicleDirectory(database, open_registration=True)
        self.ref = self.directory.register("default", "car", MOUNTED).ref
        self.put(TRUE, EVER_NS)
        self.told = []

    def put(self, calibration, valid_from_ns):
        with write(self.database) as connection:
            given = giving.give(connection, self.ref, NewCalibration(calibration, valid_from_ns, "put"))
        self.ref = given.ref
        self.directory.changed(given.ref)

    def journal(self, parts):
        rows = []
        for number, part in enumerate(parts, 1):
            packet = encode_packet(
                "car", "b", number, part, period_ns=round(S / RATE_HZ), wide=True
            ).SerializeToString()
            rows.append((self.ref.pk, "b", number, int(part.imu_t_ns[0]), int(part.imu_t_ns[-1]) + S, packet))
        with write(self.database) as connection:
            return insert_rows(connection, rows)

    def engine(self, **changes):
        return Engine(
            self.database,
            self.directory,
            Metrics(),
            config=EngineConfig(**{"workers": 1, "idle_s": 3600.0, **changes}),
            on_event=lambda _ref, event: self.told.append(event),
        )

    def run(self, entries, **changes):
        engine = self.engine(**changes)
        engine.recover()
        engine.start()
        engine.submit(entries)
        assert engine.drain(WAIT_S)
        engine.stop()
        assert engine.health().quarantined == ()

    def killed_after(self, entries, **changes):
        """As far as a process goes that is killed: no stop, no last checkpoint."""
        engine = self.engine(**changes)
        engine.recover()
        engine.start()
        engine.submit(entries)
        assert engine.drain(WAIT_S)

    def stored(self):
        """What trips have left, without the times at which it was stored."""
        with read(self.database) as connection:
            field = select(table.c.id, table.c.version, table.c.base, table.c.valid_from_ns, table.c.calibration)
            drifts = select(events.c.id, events.c.body).where(events.c.type == "calibration.drifted")
            return {
                "calibrations": [tuple(row) for row in connection.execute(field.where(table.c.origin == "field"))],
                "drifts": sorted((row.id, str(row.body)) for row in connection.execute(drifts)),
                "track": [tuple(row) for row in connection.execute(select(track_points).order_by("t_ns"))],
            }


def packets():
    return [second for part in trips(TRIPS, more_from=DRIFTED_FROM) for second in seconds(part)]


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    """What three trips leave behind that nobody disturbs; the box drifts between the first and the second."""
    database = open_database(f"sqlite:///{tmp_path_factory.mktemp('undisturbed') / 'telefuse.db'}")
    schema.upgrade(database)
    fleet = Fleet(database)
    fleet.run(fleet.journal(packets()))
    yield fleet
    database.dispose()


def test_each_trip_brings_the_biases_up_to_date_and_a_drift_is_told_once(undisturbed):
    stored = undisturbed.stored()
    assert len(stored["calibrations"]) == TRIPS
    with read(undisturbed.database) as connection:
        rows = sorted(calibrations.page(connection, undisturbed.ref.pk, None, 10), key=lambda row: row.version)
    assert [(row.version, row.base, row.origin) for row in rows] == [
        (1, None, "put"), (2, 1, "field"), (3, 1, "field"), (4, 1, "field")
    ]  # fmt: skip
    last = rows[-1].calibration
    for sensor, more in (("accelerometer", (0.3, 0.0, 0.0)), ("gyroscope", (0.0, 0.0, 0.01))):
        known, found = getattr(TRUE, sensor), getattr(last, sensor)
        assert (found.scale, found.misalignment) == (known.scale, known.misalignment)
        for axis in range(3):
            # Within three of its own spread, however it was told.
            error = found.bias[axis] - known.bias[axis] - more[axis]
            assert abs(error) < 3.0 * found.sd.bias[axis], (sensor, axis)
    drifts = [event["data"] for event in undisturbed.told if event["type"] == "calibration.drifted"]
    assert [(one["sensor"], one["axis"]) for one in drifts] == [("accelerometer", "x"), ("gyroscope", "z")]
    assert drifts[0].keys() >= {"vehicle_id", "calibration_version", "was", "is", "sd"}
    # It is told once it is beyond doubt. A step is no walk: the filter may be under way to all of it yet, see above.
    assert 0.15 < drifts[0]["is"] - drifts[0]["was"] < 0.3 + 3 * drifts[0]["sd"]
    assert [one["calibration_version"] for one in drifts] == [3, 3]


@pytest.mark.parametrize("share", [0.3, 0.6, 0.95])
def test_killed_anywhere_and_repeated_nothing_differs(undisturbed, database, share):
    fleet = Fleet(database)
    entries = fleet.journal(packets())
    fleet.killed_after(entries[: int(share * len(entries))], checkpoint_interval_s=97.0)
    fleet.run([], checkpoint_interval_s=97.0)
    assert fleet.stored() == undisturbed.stored()


def test_postgresql_holds_the_same(undisturbed, postgres_database):
    fleet = Fleet(postgres_database)
    fleet.run(fleet.journal(packets()))
    expected, found = undisturbed.stored(), fleet.stored()
    assert found["calibrations"] == expected["calibrations"]
    assert [drift_id for drift_id, _ in found["drifts"]] == [drift_id for drift_id, _ in expected["drifts"]]


def test_a_calibration_put_on_the_way_is_repeated_where_it_came_in(database, tmp_path):
    """Also one for a time past: packets that were folded without it are folded again without it."""
    other = Calibration(accelerometer=SensorCalibration(bias=(0.2, 0.0, 0.1)))
    first_ns = drive().start_t_ns
    found = []
    for killed in (False, True):
        engine = open_database(f"sqlite:///{tmp_path / str(killed)}.db")
        schema.upgrade(engine)
        fleet = Fleet(engine)
        one_trip = [second for part in trips(1) for second in seconds(part)]
        before = fleet.journal(one_trip[:120])
        if killed:
            fleet.killed_after(before, checkpoint_interval_s=50.0)
        else:
            fleet.run(before)
        fleet.put(other, first_ns)  # from the drive's beginning on
        rows = [part for number, part in enumerate(one_trip, 1) if number > 120]
        with write(engine) as connection:
            journaled = [
                (fleet.ref.pk, "b", number, int(part.imu_t_ns[0]), int(part.imu_t_ns[-1]) + S,
                 encode_packet("car", "b", number, part, period_ns=round(S / RATE_HZ), wide=True).SerializeToString())
                for number, part in enumerate(rows, 121)
            ]  # fmt: skip
            insert_rows(connection, journaled)
        fleet.run([])
        found.append(fleet.stored()["track"])
        engine.dispose()
    assert found[0] == found[1]


def test_a_vehicle_whose_state_is_lost_goes_on_with_what_trips_had_found(database):
    fleet = Fleet(database)
    one_trip = [second for part in trips(1) for second in seconds(part)]
    fleet.run(fleet.journal(one_trip))
    with write(database) as connection:
        connection.execute(checkpoints.update().values(session=b"of a version that nobody reads any more"))
    fresh = VehicleDirectory(database, open_registration=False)
    (known,) = fresh.by_pk(fleet.ref.pk).calibrations
    assert known.learnt.version == 2
    assert known.learnt.calibration.accelerometer.bias != TRUE.accelerometer.bias
    fleet.directory = fresh
    later = [second for part in trips(2) for second in seconds(part) if second.imu_t_ns[0] > BETWEEN_NS + S]
    assert later
    fleet.run([])
