"""``telefuse fuse`` and ``telefuse detect`` as a caller sees them: files, figures, and one line on what is wrong."""

from __future__ import annotations

import csv
import gzip
import io
import json
import math
from dataclasses import replace

import numpy as np
import pytest

from core.measurements import GNSS
from core.simulation.scenarios import simulate
from schemas.vehicles import SensorNoise
from service.cli import main
from service.recordings.drive_folder import read_drive, write_drive
from service.recordings.simulated import drive_of
from tests.commands import call, figures

FIGURES = {
    "epochs",
    "duration_s",
    "ns_per_epoch",
    "position_rms_m",
    "yaw_rms_deg",
    "outages",
    "outage_rms_m",
    "outage_max_m",
    "aids",
}
"""INTERFACES, section 8."""
OUTAGE_FIGURES = {"start_s", "duration_s", "against", "rms_m", "end_m", "max_m", "distance_m"}
REFERENCE_COLUMNS = [
    "t_s", "lat_deg", "lon_deg", "alt_ellipsoid_m", "vn_mps", "ve_mps", "vd_mps", "roll_deg", "pitch_deg", "yaw_deg",
]  # fmt: skip
FUSED_COLUMNS = [*REFERENCE_COLUMNS, "sd_n_m", "sd_e_m", "sd_d_m", "sd_yaw_deg", "gnss_used", "mode"]
"""INTERFACES, section 2."""


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """Drive folders: streets with their reference, the same without it or without fixes, and two with crashes."""
    root = tmp_path_factory.mktemp("drives")
    city = drive_of(simulate("city", 1, 200.0, 50.0))
    m = city.measurements
    no_fix = replace(m, gnss_t_ns=m.gnss_t_ns[:0], gnss=m.gnss[:0])
    drives = {
        "city": city,
        "no_reference": replace(city, reference=None),
        "no_fix": replace(city, measurements=no_fix),
        "crash": drive_of(simulate("tunnel_crash", 1, 430.0, 100.0)),
        "spin": drive_of(simulate("crash_series", 2, 400.0, 100.0)),
    }
    for name, drive in drives.items():
        write_drive(root / name, drive)
    return root


def test_figures_have_the_keys_of_the_contract(folders, capsys):
    found = figures(capsys, folders / "city", "--outage", "100:20", "--outage", "140:10")
    assert found.keys() >= FIGURES
    assert [outage.keys() >= OUTAGE_FIGURES for outage in found["outages"]] == [True, True]
    assert [(o["start_s"], o["duration_s"], o["against"]) for o in found["outages"]] == [
        (100.0, 20.0, "reference"), (140.0, 10.0, "reference"),
    ]  # fmt: skip
    assert found["epochs"] == 200 * 50 + 1
    assert found["duration_s"] == pytest.approx(200.0)
    assert found["position_rms_m"] < 3.0  # the receiver's own errors, 1.3 m an axis, and two short outages
    assert found["yaw_rms_deg"] < 3.0
    assert 0 < found["outage_rms_m"] <= found["outage_max_m"] < 15.0
    assert found["outage_max_m"] == max(o["max_m"] for o in found["outages"])
    withheld = 30
    assert found["aids"]["gnss_position"]["fused"] == pytest.approx(199 - withheld, abs=3)
    assert 100.0 < found["outages"][0]["distance_m"] < 300.0


def test_without_a_reference_outages_are_held_against_the_withheld_fixes(folders, capsys):
    found = figures(capsys, folders / "no_reference", "--outage", "100:20")
    assert found["position_rms_m"] is None
    assert found["yaw_rms_deg"] is None
    (outage,) = found["outages"]
    assert outage["against"] == "gnss"
    assert 0.0 < outage["rms_m"] < 15.0


def test_a_drive_that_never_aligns_still_has_its_figures(folders, capsys):
    found = figures(capsys, folders / "no_fix", "--outage", "100:20")
    assert found.keys() >= FIGURES
    assert found["aligned_after_s"] is None
    assert found["position_rms_m"] is found["outage_rms_m"] is None
    assert [outage["rms_m"] for outage in found["outages"]] == [None]
    status, out, err = call(capsys, "fuse", folders / "no_fix")
    assert (status, err) == (0, "")
    assert "never aligned" in out


def test_switches_do_what_they_say(folders, capsys):
    usual = figures(capsys, folders / "city")
    assert usual["aids"]["zupt"]["fused"] > 0
    assert usual["aids"]["nhc"]["fused"] > 0
    assert "zupt" not in figures(capsys, folders / "city", "--no-zupt")["aids"]
    assert "nhc" not in figures(capsys, folders / "city", "--no-nhc")["aids"]


def test_the_same_drive_gives_the_same_file(folders, capsys, tmp_path):
    for name in ("a.csv", "b.csv"):
        assert call(capsys, "fuse", folders / "city", "--out", tmp_path / name)[0] == 0
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes()


def test_a_csv_has_the_contracts_columns_and_a_row_a_sample(folders, capsys, tmp_path):
    found = figures(capsys, folders / "city", "--out", tmp_path / "fused.csv")
    with (tmp_path / "fused.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == FUSED_COLUMNS
    navigating = [row for row in rows if row["mode"] != "aligning"]
    assert len(navigating) == pytest.approx(50 * (200.0 - found["aligned_after_s"]), abs=2)
    assert {row["mode"] for row in rows} <= {"aligning", "aided", "coasting"}
    times = [float(row["t_s"]) for row in rows]
    assert times == sorted(times)
    with gzip.open(folders / "city" / "reference.csv.gz", "rt") as file:
        last = list(csv.DictReader(file))[-1]
    for column, off in (("lat_deg", 1e-4), ("lon_deg", 1e-4), ("alt_ellipsoid_m", 15.0)):
        assert float(rows[-1][column]) == pytest.approx(float(last[column]), abs=off)


@pytest.mark.parametrize("every_s", [0.5, 2.0])
def test_rows_are_thinned(folders, capsys, tmp_path, every_s):
    figures(capsys, folders / "city", "--out", tmp_path / "fused.csv", "--every", every_s)
    with (tmp_path / "fused.csv").open() as file:
        times = [float(row["t_s"]) for row in csv.DictReader(file) if row["mode"] != "aligning"]
    assert np.diff(times) == pytest.approx(np.full(len(times) - 1, every_s), abs=0.03)  # on the samples' own times


def test_figures_are_of_all_rows_however_few_are_written(folders, capsys):
    outage = ("--outage", "100:20")
    all_rows = figures(capsys, folders / "city", *outage)
    assert figures(capsys, folders / "city", *outage, "--every", 2)["outages"] == all_rows["outages"]


@pytest.mark.parametrize("ending", ["csv", "csv.gz", "geojson", "gpx", "kml", "parquet"])
def test_every_ending_is_written(folders, capsys, tmp_path, ending):
    if ending == "parquet":
        pytest.importorskip("pyarrow")
    out = tmp_path / f"fused.{ending}"
    status, said, err = call(capsys, "fuse", folders / "city", "--out", out, "--every", 1)
    assert (status, err) == (0, "")
    assert f"written: {out}" in said
    assert out.stat().st_size > 1000
    assert list(tmp_path.iterdir()) == [out]  # nothing half-written beside it
    if ending == "geojson":
        assert json.loads(out.read_text())["type"] in ("Feature", "FeatureCollection")


def test_a_report_is_one_page_and_named_in_the_figures(folders, capsys, tmp_path):
    path = tmp_path / "report.html"
    assert figures(capsys, folders / "city", "--outage", "100:20", "--report", path)["report"] == str(path)
    text = path.read_text(encoding="utf-8")
    assert text.startswith("<!DOCTYPE html>")
    assert "simulated city, seed 1" in text
    assert list(tmp_path.iterdir()) == [path]  # nothing half-written beside it
    assert figures(capsys, folders / "city")["report"] is None
    status, out, err = call(capsys, "fuse", folders / "city", "--report", folders / "city" / "drive.toml" / "r.html")
    assert (status, out) == (2, "")
    assert err.count("\n") == 1
    assert "cannot be written" in err


class Terminal(io.StringIO):
    """Where a bar is drawn."""

    def isatty(self) -> bool:
        return True


def test_reading_fusing_and_writing_show_a_bar_on_a_terminal(folders, capsys, tmp_path, monkeypatch):
    terminal = Terminal()
    monkeypatch.setattr("sys.stderr", terminal)
    words = ["fuse", folders / "city", "--out", tmp_path / "fused.csv", "--report", tmp_path / "report.html"]
    assert main([str(word) for word in words]) == 0
    for label in ("reading", "fusing", "writing fused.csv", "writing report.html"):
        assert f"{label} [" in terminal.getvalue()
    assert terminal.getvalue().endswith("\r\x1b[K")  # and leaves no trace


BAD_FUSE = {
    "no such folder": (["nowhere"], "nowhere"),
    "no drive folder": (["."], "drive.toml"),
    "outage without a duration": (["city", "--outage", "100"], "START:DURATION"),
    "outage that is no number": (["city", "--outage", "a:b"], "START:DURATION"),
    "outage of no length": (["city", "--outage", "100:0"], "above 0"),
    "outage after the end": (["city", "--outage", "900:10"], "200"),
    "rows a minute and more apart": (["city", "--every", "61"], "60"),
    "rows back in time": (["city", "--every", "-1"], "--every"),
    "rows at no number": (["city", "--every", "nan"], "--every"),
    "an unknown ending": (["city", "--out", "track.xlsx"], ".csv"),
    "a report that is no page": (["city", "--report", "report.pdf"], ".html"),
    "no calibration": (["city", "--calibration", "missing.json"], "missing.json"),
    "an unknown switch": (["city", "--turbo"], "--turbo"),
    "no drive": ([], "DRIVE"),
}


@pytest.mark.parametrize(("words", "named"), BAD_FUSE.values(), ids=BAD_FUSE.keys())
def test_bad_input_ends_with_two_and_one_line(folders, capsys, tmp_path, monkeypatch, words, named):
    monkeypatch.chdir(tmp_path)
    words = [folders / "city" if word == "city" else word for word in words]
    status, out, err = call(capsys, "fuse", *words)
    assert status == 2
    assert out == ""
    assert err.count("\n") == 1
    assert err.startswith("telefuse")
    assert named in err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "text", ["{", "[]", '{"accelerometer": {"scale": [1, 1]}}', '{"accelerometer": {"bias": "x"}}']
)
def test_a_calibration_that_is_none_is_refused_by_name(folders, capsys, tmp_path, text):
    path = tmp_path / "calibration.json"
    path.write_text(text)
    for command in ("fuse", "detect"):
        status, out, err = call(capsys, command, folders / "city", "--calibration", path)
        assert (status, out) == (2, "")
        assert err.count("\n") == 1
        assert "calibration.json" in err


def test_a_calibration_is_used(folders, capsys, tmp_path):
    path = tmp_path / "calibration.json"
    # Half of each turn: unlike a bias, which standing shows, a wrong scale cannot be made up for.
    path.write_text(json.dumps({"gyroscope": {"scale": [1.0, 1.0, 2.0]}}))
    usual = figures(capsys, folders / "city")
    assert figures(capsys, folders / "city", "--calibration", path)["yaw_rms_deg"] > 5.0 * usual["yaw_rms_deg"]


def test_a_damaged_table_is_named_with_its_line(folders, capsys, tmp_path):
    damaged = tmp_path / "damaged"
    damaged.mkdir()
    for file in (folders / "city").iterdir():
        (damaged / file.name).write_bytes(file.read_bytes())
    rows = gzip.decompress((damaged / "imu.csv.gz").read_bytes()).decode().splitlines()
    rows[700] = rows[700].replace(",", ",x", 1)
    (damaged / "imu.csv.gz").write_bytes(gzip.compress("\n".join(rows).encode()))
    for command in ("fuse", "detect"):
        status, out, err = call(capsys, command, damaged)
        assert (status, out) == (2, "")
        assert err.count("\n") == 1
        assert "imu.csv" in err
        assert "701" in err


def lines(capsys, *words):
    status, out, err = call(capsys, "detect", *words)
    assert (status, err) == (0, "")
    return [json.loads(line) for line in out.splitlines()]


def test_detect_prints_a_line_an_accident_with_its_place(folders, capsys):
    truth = json.loads((folders / "crash" / "truth.json").read_text())["accidents"]
    told = lines(capsys, folders / "crash")
    assert {event["type"] for event in told} >= {"accident", "harsh_braking"}
    assert [event["t_s"] for event in told] == sorted(event["t_s"] for event in told)
    found = [event for event in told if event["type"] == "accident"]
    assert len(found) == len(truth) == 2
    for event, true in zip(found, truth, strict=True):
        assert event.keys() >= {
            "type", "t_s", "lat_deg", "lon_deg", "severity", "confidence", "delta_v_mps", "pdof_deg",
        }  # fmt: skip
        assert event["t_s"] == pytest.approx(true["t_s"], abs=0.1)
        metres = math.hypot(
            (event["lat_deg"] - true["lat_deg"]) * 111_000,
            (event["lon_deg"] - true["lon_deg"]) * 111_000 * math.cos(math.radians(true["lat_deg"])),
        )
        assert metres < 15.0  # also 20 s into the tunnel
        assert 0.0 < event["confidence"] <= 1.0


def test_detect_on_a_drive_without_one_prints_nothing(folders, capsys):
    assert lines(capsys, folders / "city") == []


def test_detect_by_the_papers_rule(folders, capsys):
    # It asks for a turn as tight as only a spin is, so of these crashes it finds the one that spins the car.
    by_paper, ours = (
        [event for event in lines(capsys, folders / "spin", *chosen) if event["type"] == "accident"]
        for chosen in (["--detector", "paper"], [])
    )
    assert [event["detector"] for event in by_paper] == ["paper"]
    assert len(ours) > 1
    status, _, err = call(capsys, "detect", folders / "crash", "--detector", "guess")
    assert status == 2
    assert err.count("\n") == 1
    assert "guess" in err


def test_an_accident_that_nobody_can_place_is_told_without_a_place(folders, capsys, tmp_path):
    crash = drive_of(simulate("tunnel_crash", 1, 430.0, 100.0))
    m = crash.measurements
    rows = np.full((0, len(GNSS)), np.nan)
    write_drive(tmp_path / "no_fix", replace(crash, measurements=replace(m, gnss_t_ns=m.gnss_t_ns[:0], gnss=rows)))
    found = [event for event in lines(capsys, tmp_path / "no_fix") if event["type"] == "accident"]
    assert len(found) == 2
    assert [(event["lat_deg"], event["lon_deg"], event["sd_n_m"]) for event in found] == [(None, None, None)] * 2


NOISE = {"gyroscope": {"random_walk": [8.7e-5] * 3}, "accelerometer": {"random_walk": [1e-3] * 3}}


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ('{"gyroscope": {"random_walk": [0.3, 0.3, 0.3]}}', "gyroscope.random_walk.0"),
        ('{"gyroscope": {"random_walk": [1e-4]}}', "gyroscope.random_walk.1"),
        ('{"gyro": {}}', "gyro: Extra inputs"),
        ("[]", "the document"),
        ("{", "the document"),
    ],
)
def test_a_noise_block_that_is_none_is_refused_by_name(folders, capsys, tmp_path, text, expected):
    path = tmp_path / "noise.json"
    path.write_text(text)
    for command in ("fuse", "detect"):
        status, out, err = call(capsys, command, folders / "city", "--noise", path)
        assert (status, out, err.count("\n")) == (2, "", 1)
        assert f"noise.json: {expected}" in err
        assert "SI units" in err


def test_stated_noise_is_used_from_a_file_or_the_folder(folders, capsys, tmp_path):
    (tmp_path / "noise.json").write_text(json.dumps(NOISE))
    drive = read_drive(folders / "city")
    write_drive(tmp_path / "unknown", replace(drive, imu=replace(drive.imu, noise=None)))
    write_drive(tmp_path / "stated", replace(drive, imu=replace(drive.imu, noise=SensorNoise.model_validate(NOISE))))

    def row(*words):
        assert call(capsys, "fuse", *words, "--out", tmp_path / "fused.csv", "--every", "10")[0] == 0
        return (tmp_path / "fused.csv").read_bytes()

    from_folder = row(tmp_path / "stated")
    assert row(tmp_path / "unknown", "--noise", tmp_path / "noise.json") == from_folder
    assert row(tmp_path / "unknown") != from_folder
    assert row(folders / "city", "--noise", tmp_path / "noise.json") == from_folder  # before what the folder says
