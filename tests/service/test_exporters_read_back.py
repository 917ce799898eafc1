"""Exported tracks in the hands of those who use them: gpxpy, fastkml with the KML schema, shapely, pandas, arrow."""

from __future__ import annotations

import json
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import fastkml
import fastkml.validator
import gpxpy
import numpy as np
import pandas
import pytest
import shapely
import shapely.geometry

from core.navigation.track import TRACK, TRACK_COLUMNS, Mode, Track
from service.recordings.exporters import TrackFile, export_track

START_NS = 1_714_984_200_000_000_000
START = datetime(2024, 5, 6, 8, 30, tzinfo=UTC)
STEP_NS = 9_615_385
"""104 Hz, as a phone samples: no time falls on a millisecond."""
MM_DEG = 1e-3 / 111_000.0
ROWS = 400


@pytest.fixture
def content() -> TrackFile:
    """Aligning without a place, then aided, coasting and aided again, with a hole of a minute; a name with markup."""
    values = np.full((ROWS, len(TRACK_COLUMNS)), np.nan)
    mode = np.full(ROWS, Mode.AIDED)
    mode[:20], mode[150:200] = Mode.ALIGNING, Mode.COASTING
    i = np.arange(20, ROWS)
    values[20:, TRACK["lat_rad"]] = np.radians(40.0 + 1.234567e-6 * i)
    values[20:, TRACK["lon_rad"]] = np.radians(-3.7 + 2.345678e-6 * i)
    values[20:, TRACK["alt_m"]] = 640.0 + 0.01 * i
    values[20:, TRACK["vn_mps"]] = 12.5
    values[20:, TRACK["yaw_rad"]] = np.radians(-90.0)
    values[:, TRACK["gnss_used"]] = (np.arange(ROWS) % 104 == 0).astype(float)
    values[:, TRACK["mode"]] = mode
    t_ns = START_NS + STEP_NS * np.arange(ROWS, dtype=np.int64)
    t_ns[300:] += 60_000_000_000
    return TrackFile(Track(t_ns, values), START_NS, "Ring & <b>\x00road</b>")


def columns(content: TrackFile, rows: slice) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    values = content.track.values[rows]
    return np.degrees(values[:, TRACK["lon_rad"]]), np.degrees(values[:, TRACK["lat_rad"]]), values[:, TRACK["alt_m"]]


PIECES = (slice(20, 151), slice(150, 201), slice(200, 300), slice(300, 400))
"""Each reaches to the next one's first row, but not over the hole."""


def write(folder: Path, content: TrackFile, ending: str) -> Path:
    export_track(folder / f"track.{ending}", content)
    return folder / f"track.{ending}"


def test_gpxpy_reads_places_times_and_segments(tmp_path: Path, content: TrackFile) -> None:
    with write(tmp_path, content, "gpx").open(encoding="utf-8") as file:
        gpx = gpxpy.parse(file)
    (track,) = gpx.tracks
    assert (gpx.version, gpx.creator) == ("1.1", "telefuse")
    assert track.name == "Ring & <b>\ufffdroad</b>"
    assert track.description == "heights above the WGS-84 ellipsoid"
    assert [len(segment.points) for segment in track.segments] == [p.stop - p.start for p in PIECES]
    for segment, rows in zip(track.segments, PIECES, strict=True):
        lon, lat, alt = columns(content, rows)
        assert [p.longitude for p in segment.points] == pytest.approx(lon, abs=0.1 * MM_DEG)
        assert [p.latitude for p in segment.points] == pytest.approx(lat, abs=0.1 * MM_DEG)
        assert [p.elevation for p in segment.points] == pytest.approx(alt, abs=0.6e-3)
        # To the microsecond, which is all that Python's datetime holds.
        expected = [START + timedelta(microseconds=int(t - START_NS) // 1000) for t in content.track.t_ns[rows]]
        assert [p.time for p in segment.points] == expected
    assert track.length_3d() == pytest.approx(ROWS * 0.23, rel=0.1)  # 0.24 m a row, less what aligning left out


def test_kml_follows_its_schema_and_fastkml_reads_it(tmp_path: Path, content: TrackFile) -> None:
    path = write(tmp_path, content, "kml")
    assert fastkml.validator.validate(file_to_validate=path) is True
    document = fastkml.KML.parse(path).features[0]
    assert document.name == "Ring & <b>\ufffdroad</b>"
    marks = list(document.features)
    assert [mark.name for mark in marks] == ["aided", "coasting", "aided", "aided"]
    assert {mark.style_url.url for mark in marks} <= {f"#{style.id}" for style in document.styles}
    for mark, rows in zip(marks, PIECES, strict=True):
        expected = np.column_stack(columns(content, rows))
        assert np.array(mark.geometry.coords) == pytest.approx(expected, abs=0.6e-3)  # m in height
        assert np.array(mark.geometry.coords)[:, :2] == pytest.approx(expected[:, :2], abs=0.1 * MM_DEG)
        assert mark.time_stamp is None
        begin = START + timedelta(microseconds=int(content.track.t_ns[rows.start] - START_NS) // 1000)
        assert abs(mark.times.begin.dt - begin) <= timedelta(microseconds=1)  # fastkml rounds to what a datetime holds


def test_shapely_reads_geojson(tmp_path: Path, content: TrackFile) -> None:
    path = write(tmp_path, content, "geojson")
    text = path.read_text(encoding="utf-8")
    lines = shapely.from_geojson(text)
    assert shapely.is_valid(lines).all()
    assert shapely.get_num_geometries(lines) == len(PIECES)
    document = json.loads(text)
    west, south, low, east, north, high = document["bbox"]
    assert lines.bounds == (west, south, east, north)
    assert (low, high) == (pytest.approx(640.2), pytest.approx(643.99))
    for feature, rows in zip(document["features"], PIECES, strict=True):
        line = shapely.geometry.shape(feature["geometry"])
        expected = np.column_stack(columns(content, rows))
        got = shapely.get_coordinates(line, include_z=True)
        assert got[:, :2] == pytest.approx(expected[:, :2], abs=0.1 * MM_DEG)
        assert got[:, 2] == pytest.approx(expected[:, 2], abs=0.6e-3)
        times = pandas.to_datetime(feature["properties"]["coordTimes"])
        assert times.as_unit("ns").asi8.tolist() == content.track.t_ns[rows].tolist()  # to the nanosecond


def test_pandas_reads_csv(tmp_path: Path, content: TrackFile) -> None:
    for ending in ("csv", "csv.gz"):
        table = pandas.read_csv(write(tmp_path, content, ending))
        assert len(table) == ROWS
        t_ns = START_NS + np.rint(table["t_s"].to_numpy() * 1e9).astype(np.int64)
        assert t_ns.tolist() == content.track.t_ns.tolist()
        lon, lat, alt = columns(content, slice(None))
        assert table["lat_deg"].to_numpy() == pytest.approx(lat, abs=0.1 * MM_DEG, nan_ok=True)
        assert table["lon_deg"].to_numpy() == pytest.approx(lon, abs=0.1 * MM_DEG, nan_ok=True)
        assert table["alt_ellipsoid_m"].to_numpy() == pytest.approx(alt, abs=1e-4, nan_ok=True)
        assert table["lat_deg"].isna().sum() == 20
        assert set(table["mode"]) == {"aligning", "aided", "coasting"}
        assert table["yaw_deg"].dropna().unique().tolist() == [-90.0]


def test_pandas_reads_parquet_with_types_and_nulls(tmp_path: Path, content: TrackFile) -> None:
    pyarrow_parquet = pytest.importorskip("pyarrow.parquet")
    path = write(tmp_path, content, "parquet")
    table = pandas.read_parquet(path)
    assert table["t_ns"].dtype == np.int64
    assert pandas.to_datetime(table["t_ns"], utc=True).iloc[0] == pandas.Timestamp("2024-05-06T08:30:00Z")
    assert table["t_ns"].tolist() == content.track.t_ns.tolist()
    assert table["gnss_used"].dtype == np.bool_
    lon, _, _ = columns(content, slice(None))
    assert np.array_equal(table["lon_deg"].to_numpy(), lon, equal_nan=True)  # to the bit
    file = pyarrow_parquet.ParquetFile(path)
    assert file.metadata.metadata[b"heights"] == b"heights above the WGS-84 ellipsoid"
    column = file.schema_arrow.get_field_index("lat_deg")
    assert file.metadata.row_group(0).column(column).statistics.null_count == 20  # unknown is null, not NaN


@pytest.fixture(params=[1.0, -1.0], ids=["eastwards", "westwards"])
def over_the_antimeridian(request: pytest.FixtureRequest) -> TrackFile:
    """Over Taveuni in Fiji, at 10 m/s each second, crossing 180 degrees halfway between two rows."""
    i = np.arange(11)
    values = np.zeros((11, len(TRACK_COLUMNS)))
    values[:, TRACK["lat_rad"]] = np.radians(-16.8 + 1e-5 * i)
    # As a filter counts on: beyond 180 degrees.
    values[:, TRACK["lon_rad"]] = request.param * np.radians(180.0 + 1e-4 * (i - 4.5))
    values[:, TRACK["mode"]] = Mode.AIDED
    return TrackFile(Track(START_NS + 1_000_000_000 * i, values), START_NS, "Taveuni")


def test_a_line_over_the_antimeridian_is_cut_there(tmp_path: Path, over_the_antimeridian: TrackFile) -> None:
    text = write(tmp_path, over_the_antimeridian, "geojson").read_text()
    first, second = json.loads(text)["features"]
    side = 180.0 if first["geometry"]["coordinates"][0][0] > 0 else -180.0
    assert first["geometry"]["coordinates"][-1] == [side, pytest.approx(-16.799955), 0.0]
    assert second["geometry"]["coordinates"][0] == [-side, pytest.approx(-16.799955), 0.0]
    assert first["properties"]["coordTimes"][-1] == "2024-05-06T08:30:04.500Z"
    assert second["properties"]["coordTimes"][0] == "2024-05-06T08:30:04.500Z"
    west, _, _, east, _, _ = json.loads(text)["bbox"]
    assert west > 179.9  # RFC 7946, 5.2: a box over the antimeridian begins in the east
    assert east < -179.9
    assert shapely.from_geojson(text).length == pytest.approx(10 * np.hypot(1e-4, 1e-5), rel=1e-6)


def test_no_longitude_leaves_its_range(tmp_path: Path, over_the_antimeridian: TrackFile) -> None:
    with write(tmp_path, over_the_antimeridian, "gpx").open() as file:
        track = gpxpy.parse(file).tracks[0]
    lon = [p.longitude for segment in track.segments for p in segment.points]
    assert min(lon) >= -180.0
    assert max(lon) < 180.0
    assert track.length_2d() == pytest.approx(107.0, abs=2.0)  # not once around the Earth
    table = pandas.read_csv(write(tmp_path, over_the_antimeridian, "csv"))
    assert table["lon_deg"].abs().max() <= 180.0
    assert fastkml.validator.validate(file_to_validate=write(tmp_path, over_the_antimeridian, "kml")) is True


def test_heights_above_the_sea_are_not_called_ellipsoidal(tmp_path: Path, content: TrackFile) -> None:
    content = replace(content, heights_are_msl=True)
    for ending in ("gpx", "kml", "geojson"):
        text = write(tmp_path, content, ending).read_text(encoding="utf-8")
        assert "mean sea level" in text
        assert "ellipsoid" not in text


def test_one_row_of_a_mode_and_one_row_alone_are_no_line(tmp_path: Path, content: TrackFile) -> None:
    alone = replace(content, track=Track(content.track.t_ns[20:21], content.track.values[20:21]))
    assert json.loads(write(tmp_path, alone, "geojson").read_text())["features"] == []
    two = replace(content, track=Track(content.track.t_ns[149:151], content.track.values[149:151]))
    (feature,) = json.loads(write(tmp_path, two, "geojson").read_text())["features"]
    assert len(feature["geometry"]["coordinates"]) == 2
