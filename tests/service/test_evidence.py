"""Evidence of accidents: what it holds, when it is built, and that its replay is what the live session made."""

from __future__ import annotations

import io
import shutil
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sqlalchemy import Engine as Database
from sqlalchemy import func, select, update

from core.navigation.records import RECORD_COLUMNS
from core.navigation.track import TRACK_COLUMNS
from core.session import Session
from schemas.packet import measurements_from_packet
from service.cli import main
from service.engine.sessions import session_config
from service.evidence.bundle import BundleError, from_bytes, to_bytes
from service.evidence.replaying import check_replay
from service.storage import retention, tables
from service.storage.database import open_database, read, write
from service.storage.evidence import AFTER_NS, BEFORE_NS
from tests.service.evidence_harness import NOW_NS, NS, Story, crash_packets

LAST = len(crash_packets()) - 1
HOUR_S = 3600.0


@pytest.fixture
def story(database: Database) -> Story:
    """A vehicle that has sent nothing yet."""
    return Story(database)


@pytest.fixture(scope="module")
def told_file(tmp_path_factory: pytest.TempPathFactory, migrated_sqlite_file: Path) -> Path:
    """A database in which the whole drive was folded."""
    path = tmp_path_factory.mktemp("told") / "telefuse.db"
    shutil.copyfile(migrated_sqlite_file, path)
    database = open_database(f"sqlite:///{path}")
    Story(database).send(LAST)
    database.dispose()
    return path


@pytest.fixture
def told_database(told_file: Path, tmp_path: Path) -> Iterator[Database]:
    shutil.copyfile(told_file, tmp_path / "told.db")
    database = open_database(f"sqlite:///{tmp_path / 'told.db'}")
    yield database
    database.dispose()


@pytest.fixture
def told(told_database: Database) -> Story:
    """A vehicle that has sent all of it, with the evidence still to be built."""
    story = Story(told_database, begun=True)
    story.now_ns += len(story.packets) * NS
    return story


def bits(values: Any) -> Any:
    return np.ascontiguousarray(values).view(np.uint8)


def matrix(table: Any, names: Any) -> Any:
    return np.column_stack([table[name] for name in names])


def test_evidence_is_all_that_the_live_session_worked_with_to_the_bit(any_database: Database) -> None:
    story = Story(any_database)
    story.send(LAST)
    row, bundle = story.turn(), story.bundle()
    assert (row.status, row.reason, row.sha256) == ("complete", None, bundle.sha256)
    manifest = bundle.manifest
    t_ns = manifest["accident"]["t_ns"]
    assert manifest["replay"] == {"from": "checkpoint", "same": True, "differences": [], "positions_compared": 90}
    assert manifest["covered"]["whole"]
    assert manifest["accident"]["revisions"]

    # The same drive through a session of one's own, from its first packet on.
    live = Session(session_config(story.ref.config))
    heard: list[Any] = []

    class Listener:
        def measured(self, measurements: Any) -> None:
            heard.append([measurements, []])

        def fused(self, samples: Any, output: Any) -> None:
            heard[-1][1].append((samples, output))

    live.tape = Listener()
    rows = [live.step(measurements_from_packet(packet)).track for packet in story.packets]

    def inside(times: Any) -> Any:
        return (times >= t_ns - BEFORE_NS) & (times <= t_ns + AFTER_NS)

    samples = bundle.table("samples")
    raw_t_ns = np.concatenate([m.imu_t_ns for m, _ in heard])
    raw = np.concatenate([np.hstack([m.f_s, m.omega_s]) for m, _ in heard])
    body = np.concatenate([np.hstack([s.f_b, s.omega_b, o.epochs]) for _, parts in heard for s, o in parts])
    kept = inside(raw_t_ns)
    assert len(samples) == kept.sum() == 90 * 200 + 1, "every sample of a minute and a half at 200 Hz"
    names = samples.dtype.names
    np.testing.assert_array_equal(samples["t_ns"], raw_t_ns[kept])
    np.testing.assert_array_equal(bits(matrix(samples, names[1:7])), bits(raw[kept]))
    np.testing.assert_array_equal(bits(matrix(samples, names[7:17])), bits(body[kept]))

    told = bundle.table("innovations")
    record_t_ns = np.concatenate([o.records.t_ns for _, parts in heard for _, o in parts])
    records = np.concatenate([o.records.values for _, parts in heard for _, o in parts])[inside(record_t_ns)]
    np.testing.assert_array_equal(bits(matrix(told, RECORD_COLUMNS)), bits(records))
    assert len(set(told["aid"])) > 3

    states = bundle.table("states")
    assert len(states) == len(samples), "a fused state at every sample"
    rows_t_ns = np.concatenate([track.t_ns for track in rows])
    rows_kept = inside(rows_t_ns)
    same = np.searchsorted(states["t_ns"], rows_t_ns[rows_kept])
    columns = [name for name in TRACK_COLUMNS if name != "gnss_used"]  # says: since the row before, which is nearer
    told_rows = matrix(states[same], columns)
    wanted = np.concatenate([track.values for track in rows])[rows_kept]
    np.testing.assert_array_equal(bits(told_rows), bits(wanted[:, [TRACK_COLUMNS.index(c) for c in columns]]))

    first = next(bundle.packets())
    sent = {packet.sequence: packet for packet in story.packets}
    wanted_packets = [sent[n] for n in range(first.sequence, first.sequence + len(manifest["packets"]))]
    assert list(bundle.packets()) == wanted_packets
    assert first.start_time_ns <= t_ns - BEFORE_NS < first.start_time_ns + NS, "no more of the past than is kept"
    check_replay(bundle)


def test_nothing_is_built_before_what_follows_has_come_and_once_it_is_not_again(story: Story) -> None:
    story.send(story.crash + 2)
    assert story.turn().status == "pending"
    story.send(story.crash + 29)
    assert story.turn().status == "pending"
    story.send(story.crash + 33)
    built = story.turn()
    assert built.status == "complete"
    story.send(LAST)
    assert story.turn(HOUR_S) == built


def test_a_vehicle_that_falls_silent_has_evidence_of_what_there_is_and_of_the_rest_once_it_comes(story: Story) -> None:
    story.send(story.crash + 9)
    assert story.turn(100.0).status == "pending", "a box may be slow"
    assert story.turn(30.0).status == "partial"
    covered = story.bundle().manifest["covered"]
    assert not covered["whole"]
    assert 8.0 < (covered["to_ns"] - story.bundle().manifest["accident"]["t_ns"]) * 1e-9 < 11.0
    built = story.evidence()
    assert story.turn(500.0) == built, "nothing new came"
    story.send(LAST)
    assert story.turn().status == "complete"
    assert story.bundle().manifest["covered"]["whole"]


def test_what_stays_partial_is_done_with_after_a_day(story: Story) -> None:
    story.send(story.crash + 9)
    assert story.turn(130.0).status == "partial"
    assert story.turn(25 * HOUR_S).status == "final"
    assert story.bundle().manifest["covered"]["from_ns"] is not None


def test_an_accident_whose_packets_are_gone_has_evidence_that_says_so_and_is_looked_at_once(told: Story) -> None:
    with write(told.database) as connection:
        connection.execute(tables.journal.delete())
    assert told.turn(60.0 - len(told.packets)).status == "pending", "the service has just begun"
    row = told.turn(100.0)
    assert row.status == "partial"
    assert told.bundle().manifest["covered"]["from_ns"] is None
    assert told.turn(HOUR_S) == row
    assert told.turn(25 * HOUR_S).status == "final"


def test_packets_that_are_missing_are_waited_for_and_then_said_to_be_missing(story: Story) -> None:
    story.send(story.crash + 33, skipped=frozenset({story.crash + 25, story.crash + 26}))
    assert story.turn().status == "pending", "the two may still come"
    story.send(LAST)
    assert story.turn().status == "complete"
    (gap,) = story.bundle().manifest["covered"]["gaps"]
    assert 2.0 <= (gap[1] - gap[0]) * 1e-9 <= 2.01
    assert not story.bundle().manifest["covered"]["whole"]
    assert story.bundle().manifest["replay"]["same"], "the live session had the same gap"


def test_without_a_state_of_then_a_session_is_begun_anew_and_that_is_said(told: Story) -> None:
    with write(told.database) as connection:  # as a newer version finds it
        connection.execute(update(tables.older_checkpoints).values(session=b"TFS1 of another version"))
    row = told.turn()
    manifest = told.bundle().manifest
    assert row.status == "complete"
    assert manifest["replay"]["from"] == "anew"
    assert not manifest["replay"]["same"], "its filter has learnt from less"
    assert len(told.bundle().table("samples")) == 90 * 200 + 1, "what was measured is whole all the same"


def test_evidence_says_where_the_replay_is_not_what_was_stored(told: Story) -> None:
    with write(told.database) as connection:
        connection.execute(update(tables.accidents).values(confidence=0.123, lat_deg=1.0))
    told.turn()
    replay = told.bundle().manifest["replay"]
    assert (replay["same"], replay["differences"]) == (False, ["confidence", "lat_deg"])


def test_evidence_that_cannot_be_built_says_why_and_keeps_nobody_waiting(told: Story) -> None:
    with write(told.database) as connection:
        connection.execute(
            update(tables.journal).where(tables.journal.c.sequence == told.crash).values(payload=b"\xff\xff")
        )
    row = told.turn()
    assert row.status == "failed"
    assert row.reason is not None
    assert "PacketError" in row.reason
    assert row.bundle is None


def test_settings_of_today_do_not_change_what_was(told: Story) -> None:
    changed = told.ref.config.model_copy(update={"mounting_rpy_deg": (0.0, 0.0, 90.0)})
    told.directory.register("default", told.ref.vehicle_id, changed)
    told.turn()
    assert told.bundle().manifest["replay"]["same"]
    assert told.bundle().manifest["settings"] == told.ref.config.model_dump(mode="json")


def test_who_knows_the_roads_is_asked_for_the_street_with_the_way_there(told_database: Database) -> None:
    asked: list[Any] = []

    def street_of(*way: Any) -> str:
        asked.append(way)
        return "Calle Mayor"

    story = Story(told_database, street_of, begun=True)
    story.now_ns += len(story.packets) * NS
    story.turn()
    (t_ns, lat_deg, lon_deg, sd_m) = asked[0]
    accident_ns = story.bundle().manifest["accident"]["t_ns"]
    assert len(t_ns) == len(lat_deg) == len(lon_deg) == len(sd_m) >= 30
    assert abs(int(t_ns[-1]) - accident_ns) < 0.01 * NS
    assert 40.3 < lat_deg[-1] < 40.5
    with read(told_database) as connection:
        assert connection.execute(select(tables.accidents.c.street)).scalars().all() == ["Calle Mayor"]


def test_packets_stay_while_evidence_is_open_and_it_goes_by_its_own_time_and_with_its_vehicle(told: Story) -> None:
    day_ns = retention.DAY_NS

    def prune(days: int) -> retention.Removed:
        forever = {"track_days": 0, "events_days": 0, "candidates_days": 0}
        return retention.prune(told.database, NOW_NS + days * day_ns, journal_days=30, evidence_days=90, **forever)

    def count(table: Any) -> int:
        with read(told.database) as connection:
            return int(connection.execute(select(func.count()).select_from(table)).scalar_one())

    assert prune(31).packets == 0
    told.turn()
    assert prune(31).packets == LAST
    assert (prune(89).evidence, count(tables.evidence)) == (0, 1)
    assert (prune(91).evidence, count(tables.evidence), count(tables.accidents)) == (1, 0, 1)
    told.directory.remove("default", told.ref.vehicle_id)
    assert count(tables.accidents) == count(tables.older_checkpoints) == 0


def test_evidence_goes_with_its_vehicle(told: Story) -> None:
    told.turn()
    told.directory.remove("default", told.ref.vehicle_id)
    with read(told.database) as connection:
        assert connection.execute(select(func.count()).select_from(tables.evidence)).scalar_one() == 0


# --- The file ---------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def file(told_file: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[bytes]:
    """One bundle for the tests that only read it."""
    path = tmp_path_factory.mktemp("bundle") / "telefuse.db"
    shutil.copyfile(told_file, path)
    database = open_database(f"sqlite:///{path}")
    story = Story(database, begun=True)
    story.now_ns += len(story.packets) * NS
    found = story.turn().bundle
    assert found is not None
    yield found
    database.dispose()


def repacked(data: bytes, change: Any, compression: int = zipfile.ZIP_STORED) -> bytes:
    """The zip file with its members changed."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    change(members)
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", compression) as archive:
        for name in reversed(members):
            archive.writestr(name, members[name])
    return file.getvalue()


def test_the_hash_is_of_the_contents_not_of_how_they_are_packed(file: bytes) -> None:
    assert from_bytes(repacked(file, lambda members: None)).sha256 == from_bytes(file).sha256
    assert to_bytes(from_bytes(file)) == file, "the same contents make the same file"


def test_any_change_is_found_and_named(file: bytes) -> None:
    def flip(name: str, at: int) -> Any:
        def change(members: dict[str, bytes]) -> None:
            content = bytearray(members[name])
            content[at] ^= 1
            members[name] = bytes(content)

        return change

    def rename(members: dict[str, bytes]) -> None:
        members["manifest.json"] = members["manifest.json"].replace(b"car-1", b"car-2")

    with zipfile.ZipFile(io.BytesIO(file)) as archive:
        names = [name for name in archive.namelist() if name != "manifest.json"]
    assert len(names) == 9
    for name in names:
        with pytest.raises(BundleError, match=f"{name} was changed"):
            from_bytes(repacked(file, flip(name, -1)))
    with pytest.raises(BundleError, match="manifest"):
        from_bytes(
            repacked(file, lambda m: m.update({"manifest.json": m["manifest.json"].replace(b"car-1", b"car-2")}))
        )
    with pytest.raises(BundleError, match=r"gnss\.npy"):
        from_bytes(repacked(file, lambda members: members.pop("gnss.npy")))
    with pytest.raises(BundleError, match=r"more\.npy"):
        from_bytes(repacked(file, lambda members: members.update({"more.npy": b""})))
    for broken in (b"", b"PK", file[: len(file) // 2]):
        with pytest.raises(BundleError):
            from_bytes(broken)


def test_numpy_opens_it_by_itself(file: bytes) -> None:
    with np.load(io.BytesIO(file)) as loaded:
        assert loaded["samples"]["ax_b_mps2"].shape == (90 * 200 + 1,)
        assert set(loaded["innovations"].dtype.names) > {"innovation", "variance", "ratio"}


def test_the_command_verifies_and_replays(file: bytes, tmp_path: Any, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "evidence.npz"
    path.write_bytes(file)
    sha256 = from_bytes(file).sha256
    assert main(["evidence", "verify", str(path), "--sha256", sha256, "--replay"]) == 0
    said = capsys.readouterr().out
    assert sha256 in said
    assert "to the bit" in said
    assert main(["evidence", "verify", str(path), "--sha256", "0" * 64]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert sha256 in line
    path.write_bytes(repacked(file, lambda members: members.update({"samples.npy": b""})))
    assert main(["evidence", "verify", str(path)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "samples.npy was changed" in line
    assert main(["evidence", "verify", str(tmp_path / "none")]) == 2


def test_a_replay_finds_tables_that_were_forged_with_their_hashes(file: bytes) -> None:
    from service.evidence.bundle import CHECKPOINT, FORMAT, pack

    bundle = from_bytes(file)
    tables_of = {name[:-4]: bundle.table(name[:-4]) for name in bundle.members if name.endswith(".npy")}
    tables_of["samples"]["ax_b_mps2"][9000] *= 2.0
    said = {name: value for name, value in bundle.manifest.items() if name not in ("members", "sha256")}
    assert said["format"] == FORMAT
    packets = [packet.SerializeToString() for packet in bundle.packets()]
    forged = from_bytes(to_bytes(pack(tables_of, packets, bundle.members[CHECKPOINT], said)))
    with pytest.raises(BundleError, match="another table of samples"):
        check_replay(forged)
