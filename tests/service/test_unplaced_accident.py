"""A crash that a box feels without ever having had a fix: stored, told, and served without a place."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from sqlalchemy import select

from core.accident.events import Impact, Severity
from core.accident.placing import place_at
from core.measurements import GNSS_COLUMNS, Measurements
from core.navigation.track import TRACK_COLUMNS, Mode, Track
from core.session import Outputs, Session, SessionConfig
from core.simulation.scenarios import simulate
from service.engine.effects import Effects
from service.ingest.journal_rows import JournalEntry
from service.storage.database import read, write
from service.storage.tables import accidents, events
from service.storage.vehicles import VehicleDirectory


@pytest.fixture(scope="module")
def blind_crash() -> Measurements:
    """Half a minute around a crash, from a box without GNSS."""
    drive = simulate("tunnel_crash", seed=1)
    crash_ns = drive.start_t_ns + round(drive.truth["accidents"][0]["t_s"] * 1e9)
    around = drive.measurements.between(crash_ns - 15_000_000_000, crash_ns + 5_000_000_000)
    return replace(around, gnss_t_ns=np.empty(0, np.int64), gnss=np.empty((0, len(GNSS_COLUMNS))))


def test_a_session_without_a_fix_finds_the_crash_and_says_that_its_place_is_unknown(blind_crash: Measurements) -> None:
    revisions = Session(SessionConfig()).step(blind_crash).accidents
    assert [one.impact.revision for one in revisions] == list(range(len(revisions)))
    assert len({one.impact.t_ns for one in revisions}) == 1
    for accident in revisions:
        assert np.isnan(accident.place.lat_rad)
        assert accident.place.mode == Mode.ALIGNING


def test_it_is_stored_and_told_all_the_same(any_database, blind_crash: Measurements) -> None:
    directory = VehicleDirectory(any_database, open_registration=True)
    ref = directory.resolve("default", "blind")
    assert ref is not None
    effects = Effects(ref, 1_000_000_000)
    entry = JournalEntry(1, ref.pk, "boot", 1, 1, 1, b"x")
    effects.add(Session(SessionConfig()).step(blind_crash), entry)
    with write(any_database) as connection:
        told = effects.store(connection, stored_ns=2)
    assert {one.body["lat_deg"] for one in told} == {None}
    assert effects.counts["accident.no_position"] == 1
    with read(any_database) as connection:
        assert connection.execute(select(accidents.c.lat_deg)).scalars().all() == [None]
        kinds = connection.execute(select(events.c.type).order_by(events.c.cursor)).scalars().all()
    assert kinds[0] == "accident.detected"
    assert set(kinds[1:]) <= {"accident.updated"}
    assert len(kinds) == len(told)


def test_an_old_place_is_kept_with_a_spread_that_says_how_old() -> None:
    impact = Impact(
        t_ns=100_000_000_000,
        decided_t_ns=100_200_000_000,
        detector="telefuse",
        severity=Severity.SEVERE,
        confidence=0.9,
        delta_v_mps=8.0,
        delta_v_sd_mps=0.5,
        delta_v_b_mps=(-8.0, 0.0),
        pdof_deg=0.0,
        peak_mps2=90.0,
        duration_s=0.1,
        clipped=False,
        speed_before_mps=10.0,
        paper_agrees=False,
    )
    row = np.zeros((1, len(TRACK_COLUMNS)))
    row[0, 3] = 20.0  # northwards
    fresh = place_at(impact.t_ns, Track(np.array([99_500_000_000]), row))
    old = place_at(impact.t_ns, Track(np.array([40_000_000_000]), row))
    assert fresh.lat_rad * 6.37e6 == pytest.approx(10.0, rel=0.01)  # half a second at 20 m/s; sphere against ellipsoid
    assert old.lat_rad == 0.0
    assert old.sd_n_m == pytest.approx(60 * 20.0)


def test_a_vehicle_whose_detector_is_changed_goes_on_from_its_snapshot() -> None:
    drive = simulate("tunnel_crash", seed=1)
    start = drive.start_t_ns
    before = Session(SessionConfig())
    before.step(drive.measurements.between(0, start + 60_000_000_000))
    changed = Session.restore(SessionConfig(detector="paper"), before.snapshot())
    same = Session.restore(SessionConfig(), before.snapshot())
    after = drive.measurements.between(start + 60_000_000_000, start + 70_000_000_000)
    outputs: list[Outputs] = [changed.step(after), same.step(after), before.step(after)]
    np.testing.assert_array_equal(outputs[0].track.values, outputs[1].track.values)
    np.testing.assert_array_equal(outputs[1].track.values, outputs[2].track.values)
