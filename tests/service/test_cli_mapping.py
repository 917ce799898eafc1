"""Mobile mapping by ``telefuse fuse``: the paper's filter, poses at given instants, the road's profile."""

from __future__ import annotations

import csv
import gzip
import json
import math
from dataclasses import replace

import numpy as np
import pytest
import shapely
from scipy.spatial.transform import Rotation

from core.measurements import GNSS
from core.simulation.scenarios import simulate
from core.simulation.sensors import gauss_markov
from service.recordings.drive_folder import AttitudeSeries, write_drive
from service.recordings.simulated import drive_of
from tests.commands import call, figures

POSE_COLUMNS = [
    "t_s",
    "lat_deg",
    "lon_deg",
    "alt_ellipsoid_m",
    "qw",
    "qx",
    "qy",
    "qz",
    "roll_deg",
    "pitch_deg",
    "yaw_deg",
]


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """Streets with the sensor's own attitude, the same without it, and one without fixes."""
    root = tmp_path_factory.mktemp("drives")
    simulated = simulate("outages", 1, 150.0, 50.0)
    city, truth = drive_of(simulated), simulated.trajectory
    m = city.measurements
    rng = np.random.default_rng(5)
    turn = np.column_stack([gauss_markov(len(m.imu_t_ns), math.radians(1.0), 60.0, 0.02, rng) for _ in range(3)])
    q = Rotation.from_rotvec(turn) * Rotation.from_euler("ZYX", truth.rpy_rad[:, ::-1])
    attitude = AttitudeSeries(m.imu_t_ns, q.as_quat(scalar_first=True))
    write_drive(root / "ahrs", replace(city, attitude=attitude))
    write_drive(root / "city", city)
    write_drive(root / "no_fix", replace(city, measurements=replace(m, gnss_t_ns=m.gnss_t_ns[:0], gnss=m.gnss[:0])))
    few = m.gnss.copy()
    few[:, GNSS["satellites"]] = 3.0
    write_drive(root / "three_satellites", replace(city, attitude=attitude, measurements=replace(m, gnss=few)))
    return root


def rows_of(path):
    with path.open() as file:
        return list(csv.DictReader(file))


def test_the_papers_filter_with_the_sensors_attitude_and_with_ours(folders, capsys, tmp_path):
    with_ahrs = figures(capsys, folders / "ahrs", "--filter", "ecef", "--outage", "100:10", "--out", tmp_path / "a.csv")
    with_ours = figures(capsys, folders / "city", "--filter", "ecef", "--outage", "100:10")
    for found in (with_ahrs, with_ours):
        assert found["position_rms_m"] < 10.0  # white fixes of 1.5 m, and an outage at a tilt error of a degree
        assert found["aids"].keys() == {"gnss_position", "gnss_velocity"}
    assert with_ahrs["yaw_rms_deg"] < 2.5
    assert {row["mode"] for row in rows_of(tmp_path / "a.csv")} == {"aided", "coasting"}
    assert len(rows_of(tmp_path / "a.csv")) == pytest.approx(150 * 50, rel=0.05)


def test_figures_of_a_drive_with_three_satellites(folders, capsys):
    found = figures(capsys, folders / "three_satellites", "--filter", "ecef")
    assert found["rows"] == 0
    assert found["aids"]["gnss_position"].keys() == {"rejected_range"}


def test_poses_lie_where_the_car_was(folders, capsys, tmp_path):
    times = tmp_path / "frames.csv"
    instants = [-1.0, *np.round(np.arange(40.0, 140.0, 0.0333), 4), 149.0, 1000.0]
    times.write_text("frame,t_s\n" + "".join(f"{i},{t}\n" for i, t in enumerate(instants)))
    found = figures(capsys, folders / "city", "--poses", times, "--outage", "100:10")
    out = tmp_path / "frames_poses.csv"
    assert found["poses"]["out"] == str(out)
    assert found["poses"]["outside"] == 2
    assert found["poses"]["aided"] + found["poses"]["coasting"] == len(instants) - 2
    assert found["poses"]["coasting"] > 100
    rows = rows_of(out)
    assert list(rows[0])[: len(POSE_COLUMNS)] == POSE_COLUMNS
    covariances = [name for name in rows[0] if name.startswith("cov_")]
    assert len(covariances) == 21
    assert covariances[0] == "cov_n_n_m2"
    assert covariances[-1] == "cov_rot_d_rot_d_rad2"
    assert [float(row["t_s"]) for row in rows] == instants
    assert rows[0]["status"] == rows[-1]["status"] == "outside"
    assert {rows[0][name] for name in rows[0] if name not in ("t_s", "status")} == {""}
    with gzip.open(folders / "city" / "reference.csv.gz", "rt") as file:
        reference = {round(float(row["t_s"]), 2): row for row in csv.DictReader(file)}
    compared = [(row, reference[float(row["t_s"])]) for row in rows[1:-1] if float(row["t_s"]) in reference]
    assert len(compared) > 10
    for row, true in compared:
        assert float(row["lat_deg"]) == pytest.approx(float(true["lat_deg"]), abs=2e-4)
        q = Rotation.from_quat([float(row[name]) for name in ("qw", "qx", "qy", "qz")], scalar_first=True)
        angles = np.degrees(q.as_euler("ZYX"))[::-1]
        assert angles == pytest.approx([float(row[name]) for name in ("roll_deg", "pitch_deg", "yaw_deg")], abs=1e-4)
        assert float(row["cov_n_n_m2"]) > 0.0
    chosen = tmp_path / "chosen.csv.gz"
    status, out_text, _ = call(capsys, "fuse", folders / "city", "--poses", times, "--poses-out", chosen)
    assert status == 0
    assert "warning: no pose at 2 instants outside" in out_text
    assert gzip.decompress(chosen.read_bytes()).startswith(b"t_s,lat_deg")


def test_a_road_is_geojson_that_others_read(folders, capsys, tmp_path):
    road = tmp_path / "road.geojson"
    found = figures(capsys, folders / "city", "--profile", road, "--profile-spacing", 10)["profile"]
    collection = shapely.from_geojson(road.read_text())
    lines = [geometry for geometry in collection.geoms if geometry.geom_type == "LineString"]
    points = [geometry for geometry in collection.geoms if geometry.geom_type == "Point"]
    assert (len(lines), len(points)) == (found["lines"], found["points"])
    assert all(geometry.has_z and geometry.is_valid for geometry in collection.geoms)
    assert shapely.get_num_coordinates(lines).sum() == len(points)
    west, south, east, north = shapely.total_bounds(points)
    assert (west, east) == pytest.approx((-3.714, -3.714), abs=0.03)
    assert (south, north) == pytest.approx((40.4105, 40.4105), abs=0.03)
    features = json.loads(road.read_text())["features"]
    profile = [f["properties"] for f in features if f["geometry"]["type"] == "Point" and f["properties"]["line"] == 1]
    assert np.diff([p["chainage_m"] for p in profile]) == pytest.approx(np.full(len(profile) - 1, 10.0))
    assert all(p["sd_grade_rad"] > 0.0 and p["sd_alt_m"] > 0.0 and p["passes"] >= 1 for p in profile)
    first = features[0]
    assert first["geometry"]["type"] == "LineString"
    assert first["properties"]["length_m"] == profile[-1]["chainage_m"]
    table = tmp_path / "road.csv"
    figures(capsys, folders / "city", "--profile", table, "--profile-spacing", 10)
    rows = rows_of(table)
    assert len(rows) == len(points)
    assert [float(row["grade_percent"]) for row in rows if row["line"] == "1"] == [p["grade_percent"] for p in profile]
    assert 100 * math.tan(float(rows[30]["grade_rad"])) == pytest.approx(float(rows[30]["grade_percent"]), abs=1e-3)


def test_a_drive_that_never_aligns_has_no_poses_and_no_road(folders, capsys, tmp_path):
    (tmp_path / "times.csv").write_text("t_s\n10\n20\n")
    road = tmp_path / "road.geojson"
    found = figures(capsys, folders / "no_fix", "--poses", tmp_path / "times.csv", "--profile", road)
    assert found["poses"]["outside"] == 2
    assert found["profile"]["points"] == 0
    assert json.loads(road.read_text()) == {"type": "FeatureCollection", "features": []}
    figures(capsys, folders / "no_fix", "--profile", tmp_path / "road.csv")
    assert (tmp_path / "road.csv").read_text().startswith("line,chainage_m,lat_deg")


BAD = {
    "an unknown filter": (["--filter", "utm"], "utm"),
    "no times": (["--poses", "missing.csv"], "missing.csv"),
    "times without their column": (["--poses", "{no_header}"], "t_s"),
    "times that go back": (["--poses", "{back}"], "increase"),
    "a time that is none": (["--poses", "{word}"], "line 3"),
    "a place for poses without instants": (["--poses-out", "poses.csv"], "--poses"),
    "poses in another form": (["--poses", "{good}", "--poses-out", "poses.json"], ".csv"),
    "a road in another form": (["--profile", "road.shp"], ".geojson"),
    "a spacing of nothing": (["--profile", "road.csv", "--profile-spacing", "0"], "--profile-spacing"),
    "a spacing that is no number": (["--profile", "road.csv", "--profile-spacing", "nan"], "--profile-spacing"),
}


@pytest.mark.parametrize(("words", "named"), BAD.values(), ids=BAD.keys())
def test_bad_usage_ends_with_two_and_one_line(folders, capsys, tmp_path_factory, monkeypatch, words, named):
    files = tmp_path_factory.mktemp("times")
    for name, text in {
        "no_header": "1\n2\n", "back": "t_s\n2\n1\n", "word": "t_s\n1\nx\n", "good": "t_s\n1\n",
    }.items():  # fmt: skip
        (files / f"{name}.csv").write_text(text)
    empty = tmp_path_factory.mktemp("empty")
    monkeypatch.chdir(empty)
    words = [word.format(**{path.stem: path for path in files.iterdir()}) for word in words]
    status, out, err = call(capsys, "fuse", folders / "city", *words)
    assert (status, out) == (2, "")
    assert err.count("\n") == 1
    assert err.startswith("telefuse")
    assert named in err
    assert list(empty.iterdir()) == []


def test_the_papers_filter_without_any_attitude_says_so(folders, capsys):
    status, out, err = call(capsys, "fuse", folders / "no_fix", "--filter", "ecef")
    assert (status, out) == (2, "")
    assert "attitude" in err
