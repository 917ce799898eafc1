"""Roads by the command line: simulate on them, match a drive, and what a wrong word is answered."""

import csv
import json

import pytest

from service.settings import load_settings
from tests.commands import call
from tests.road_map import STREETS


@pytest.fixture(scope="module")
def drive_folder(built_roads, tmp_path_factory):
    from service.recordings.drive_folder import write_drive
    from service.recordings.simulated import drive_of
    from service.roads.simulated import simulate_on_roads

    out = tmp_path_factory.mktemp("drives") / "drive"
    write_drive(out, drive_of(simulate_on_roads(built_roads, seed=4, duration_s=300.0, rate_hz=50.0)))
    return out


def test_a_simulated_drive_says_its_ways(drive_folder):
    truth = json.loads((drive_folder / "truth.json").read_text())
    roads = truth["roads"]
    minutes = [one for one in truth["outages"] if one["duration_s"] == 60.0]
    assert [one["start_s"] for one in minutes] == [90, 195]
    assert roads["t_s"] == list(range(301))
    assert all(len(roads[name]) == 301 for name in ("way_id", "road_class", "limit_kmh", "district", "street"))
    assert len(set(roads["way_id"])) >= 3
    assert set(roads["way_id"]) <= set(STREETS)
    assert any(roads["tunnel"])
    assert len(truth["outages"]) == 3  # the tunnel, too
    assert "OpenStreetMap" in roads["attribution"]


def test_a_drive_is_matched_and_written(capsys, drive_folder, built_roads, tmp_path):
    out = tmp_path / "roads.csv"
    status, said, err = call(
        capsys, "roads", "match", drive_folder, "--roads", built_roads, "--out", out, "--source", "reference", "--json"
    )
    assert (status, err) == (0, "")
    found = json.loads(said)
    assert found["matched_km"] == pytest.approx(found["distance_km"], rel=0.01)
    # Its positions are exact, and lie beside the line by half a lane: a way's end may come some metres early or late.
    assert found["truth"]["right_way_with_gnss"] > 0.98
    assert found["truth"]["right_way_in_outages"] > 0.98
    assert found["truth"]["right_limit_on_right_way"] == 1.0
    assert found["truth"]["right_district"] == 1.0
    with out.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == found["points"]
    names = {tags.get("name", tags.get("ref", "")) for _, tags in STREETS.values()}
    assert {row["street"] for row in rows} <= names | {""}
    assert float(rows[50]["road_lat_deg"]) == pytest.approx(float(rows[50]["lat_deg"]), abs=1e-4)


def test_the_fused_track_is_matched_through_outages(capsys, drive_folder, built_roads, tmp_path):
    out = tmp_path / "roads.geojson"
    status, said, _ = call(capsys, "roads", "match", drive_folder, "--roads", built_roads, "--out", out)
    assert status == 0
    assert "right way in outages" in said
    document = json.loads(out.read_text())
    assert document["features"]
    for one in document["features"]:
        assert one["geometry"]["type"] == "LineString"
        assert len(one["geometry"]["coordinates"]) >= 2
        assert one["properties"]["way_id"] in STREETS


def test_the_receiver_alone_can_be_matched(capsys, drive_folder, built_roads):
    status, said, _ = call(capsys, "roads", "match", drive_folder, "--roads", built_roads, "--source", "raw", "--json")
    assert status == 0
    assert json.loads(said)["points"] < 181  # 301 seconds less two outages of a minute


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ((), "give --roads"),
        (("--roads", "nowhere"), "no built roads"),
        (("--roads", "ROADS", "--out", "roads.txt"), "roads.txt"),
        (("--roads", "ROADS", "--source", "raw", "--smooth"), "--smooth"),
        (("--roads", "ROADS", "--outage", "soon"), "soon"),
    ],
)
def test_a_wrong_word_is_one_line(capsys, drive_folder, built_roads, words, said):
    words = [built_roads if one == "ROADS" else one for one in words]
    status, _, err = call(capsys, "roads", "match", drive_folder, *words)
    assert (status, err.count("\n")) == (2, 1)
    assert said in err


def test_the_folder_may_be_a_setting(capsys, drive_folder, built_roads, monkeypatch):
    monkeypatch.setenv("TELEFUSE_ROADS", str(built_roads))
    assert load_settings().settings.roads == built_roads
    status, said, _ = call(capsys, "roads", "match", drive_folder, "--source", "reference", "--json")
    assert status == 0
    assert json.loads(said)["ways"] >= 3


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--roads", "ROADS", "--scenario", "city"), "--scenario"),
        (("--roads", "nowhere"), "no built roads"),
        (("--roads", "ROADS", "--duration", "10"), "30 s"),
        (("--roads", "ROADS", "--seed", "-1"), "seed"),
    ],
)
def test_a_drive_that_cannot_be_simulated_says_why(capsys, built_roads, tmp_path, words, said):
    words = [built_roads if one == "ROADS" else one for one in words]
    status, _, err = call(capsys, "simulate", tmp_path / "drive", *words)
    assert (status, err.count("\n")) == (2, 1)
    assert said in err
    assert not (tmp_path / "drive").exists()


@pytest.mark.parametrize("drives", ["0", "many", "1001"])
def test_the_bench_wants_a_number_of_drives(capsys, built_roads, drives):
    status, _, err = call(capsys, "bench", "--roads", built_roads, "--drives", drives)
    assert (status, err.count("\n")) == (2, 1)
    assert "--drives" in err
