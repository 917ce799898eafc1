"""Exported tracks, read back by other parsers."""

from __future__ import annotations

import builtins
import csv
import gzip
import io
import json
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pyarrow.parquet
import pytest

from core.navigation.track import TRACK, TRACK_COLUMNS, Mode, Track
from service.errors import UsageError
from service.recordings.exporters import TrackFile, check_ending, export_track

START_NS = 1_714_984_200_000_000_000
COLUMNS = [
    "t_s",
    "lat_deg",
    "lon_deg",
    "alt_ellipsoid_m",
    "vn_mps",
    "ve_mps",
    "vd_mps",
    "roll_deg",
    "pitch_deg",
    "yaw_deg",
    "sd_n_m",
    "sd_e_m",
    "sd_d_m",
    "sd_yaw_deg",
    "gnss_used",
    "mode",
]


@pytest.fixture
def content() -> TrackFile:
    """Ten rows: two aligning without a position, four aided, four coasting."""
    values = np.full((10, len(TRACK_COLUMNS)), np.nan)
    values[:, TRACK["mode"]] = [Mode.ALIGNING] * 2 + [Mode.AIDED] * 4 + [Mode.COASTING] * 4
    values[:, TRACK["gnss_used"]] = 0.0
    values[2:6, TRACK["gnss_used"]] = 1.0
    values[2:, TRACK["lat_rad"]] = np.radians(40.0 + 1e-4 * np.arange(8))
    values[2:, TRACK["lon_rad"]] = np.radians(-3.7)
    values[2:, TRACK["alt_m"]] = 640.5
    values[2:, TRACK["yaw_rad"]] = np.radians(-12.5)
    values[2:, TRACK["sd_n_m"]] = 1.25
    return TrackFile(Track(START_NS + 100_000_000 * np.arange(10), values), START_NS, "Tunnel & <crash>")


@pytest.mark.parametrize("ending", [".csv", ".csv.gz"])
def test_csv_has_the_columns_of_the_interface(tmp_path: Path, content: TrackFile, ending: str) -> None:
    path = tmp_path / f"track{ending}"
    export_track(path, content)
    data = gzip.decompress(path.read_bytes()) if ending.endswith("gz") else path.read_bytes()
    rows = list(csv.DictReader(io.StringIO(data.decode())))
    assert list(rows[0]) == COLUMNS
    assert [row["mode"] for row in rows] == ["aligning"] * 2 + ["aided"] * 4 + ["coasting"] * 4
    assert rows[0]["lat_deg"] == ""
    assert float(rows[3]["lat_deg"]) == pytest.approx(40.0001, abs=1e-10)
    assert (rows[3]["t_s"], rows[3]["gnss_used"], rows[3]["yaw_deg"]) == ("0.300", "1", "-12.50000")


def test_geojson_is_a_line_for_each_mode_with_times(tmp_path: Path, content: TrackFile) -> None:
    export_track(tmp_path / "track.geojson", content)
    document = json.loads((tmp_path / "track.geojson").read_text())
    aided, coasting = document["features"]
    assert [aided["properties"]["mode"], coasting["properties"]["mode"]] == ["aided", "coasting"]
    assert aided["geometry"]["type"] == "LineString"
    assert aided["geometry"]["coordinates"][0] == [-3.7, 40.0, 640.5]
    assert aided["geometry"]["coordinates"][-1] == coasting["geometry"]["coordinates"][0]
    assert aided["properties"]["coordTimes"][0] == "2024-05-06T08:30:00.200Z"
    assert len(coasting["properties"]["coordTimes"]) == len(coasting["geometry"]["coordinates"]) == 4


def test_gpx_is_a_track_with_a_segment_for_each_mode(tmp_path: Path, content: TrackFile) -> None:
    export_track(tmp_path / "track.gpx", content)
    root = ElementTree.parse(tmp_path / "track.gpx").getroot()
    ns = {"g": "http://www.topografix.com/GPX/1/1"}
    assert root.findtext("g:trk/g:name", namespaces=ns) == "Tunnel & <crash>"
    segments = root.findall("g:trk/g:trkseg", ns)
    assert [len(segment) for segment in segments] == [5, 4]
    point = segments[0][0]
    assert (float(point.attrib["lat"]), float(point.attrib["lon"])) == (40.0, -3.7)
    assert point.findtext("g:ele", namespaces=ns) == "640.500"
    assert point.findtext("g:time", namespaces=ns) == "2024-05-06T08:30:00.200Z"


def test_kml_is_a_coloured_line_for_each_mode(tmp_path: Path, content: TrackFile) -> None:
    export_track(tmp_path / "track.kml", content)
    root = ElementTree.parse(tmp_path / "track.kml").getroot()
    ns = {"k": "http://www.opengis.net/kml/2.2"}
    marks = root.findall("k:Document/k:Placemark", ns)
    assert [mark.findtext("k:styleUrl", namespaces=ns) for mark in marks] == ["#aided", "#coasting"]
    lines = marks[1].findtext("k:LineString/k:coordinates", namespaces=ns).split()
    assert [float(x) for x in lines[-1].split(",")] == pytest.approx([-3.7, 40.0007, 640.5])
    assert root.findtext("k:Document/k:name", namespaces=ns) == "Tunnel & <crash>"


def test_parquet_keeps_every_row_in_full_precision(tmp_path: Path, content: TrackFile) -> None:
    export_track(tmp_path / "track.parquet", content)
    table = pyarrow.parquet.read_table(tmp_path / "track.parquet")
    assert table.column_names == ["t_ns", *COLUMNS]
    assert table["t_ns"].to_pylist() == content.track.t_ns.tolist()
    assert table["lat_deg"].to_pylist()[3] == pytest.approx(40.0001, abs=1e-13)
    assert table["gnss_used"].to_pylist() == [False] * 2 + [True] * 4 + [False] * 4
    assert table["mode"].to_pylist()[-1] == "coasting"


def test_a_track_without_positions_is_an_empty_collection(tmp_path: Path, content: TrackFile) -> None:
    nothing = TrackFile(Track(content.track.t_ns[:2], content.track.values[:2]), START_NS, "n")
    export_track(tmp_path / "track.geojson", nothing)
    assert json.loads((tmp_path / "track.geojson").read_text()) == {"type": "FeatureCollection", "features": []}
    export_track(tmp_path / "track.gpx", nothing)
    ElementTree.parse(tmp_path / "track.gpx")


def test_an_unknown_ending_is_refused_with_those_known(tmp_path: Path, content: TrackFile) -> None:
    with pytest.raises(UsageError, match=r"unknown file ending; expected one of \.csv, \.csv\.gz, \.geojson"):
        check_ending(tmp_path / "track.shp")
    with pytest.raises(UsageError, match="unknown file ending"):
        export_track(tmp_path / "track", content)
    assert list(tmp_path.iterdir()) == []


def test_parquet_without_pyarrow_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def without_pyarrow(name: str, *rest: object) -> object:
        if name.startswith("pyarrow"):
            raise ImportError(name)
        return real(name, *rest)

    monkeypatch.setattr(builtins, "__import__", without_pyarrow)
    with pytest.raises(UsageError, match=r"install telefuse\[parquet\]"):
        check_ending(tmp_path / "track.parquet")


def test_a_place_that_cannot_be_written_is_refused(tmp_path: Path, content: TrackFile) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(UsageError, match="cannot be written"):
        export_track(tmp_path / "file" / "track.csv", content)
