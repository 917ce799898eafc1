"""Building roads of an extract: ways with their limits, districts, and folders that are whole or not there."""

import json
import math
import os
import shutil

import numpy as np
import pytest

from service.errors import UsageError
from tests.commands import call
from tests.road_map import (
    BORDER,
    FOOTWAY,
    MAIN,
    MOTORWAY,
    MPH,
    NONSENSE,
    PARALLEL,
    RURAL,
    SERVICE,
    STREETS,
    TUNNEL,
    TWO_LIMITS,
    WALK,
    at,
    write_map,
)

pytest.importorskip("osmium", reason="the extra 'roads' is not installed")
pytest.importorskip("valhalla", reason="the extra 'roads' is not installed")
pytest.importorskip("shapely", reason="the extra 'roads' is not installed")

from service.roads.build import build
from service.roads.districts import Districts
from service.roads.folder import RoadFolder
from service.roads.matching import RoadService
from service.roads.network import RoadNetwork
from service.roads.protocol import Certainty, RoadClass, Surroundings

URBAN, RURAL_LAND = Surroundings.URBAN, Surroundings.RURAL
TAGGED, ASSUMED = Certainty.TAGGED, Certainty.ASSUMED


def quiet(*_):
    """Hears how far a build is."""


@pytest.fixture(scope="module")
def network(built_roads):
    return RoadNetwork.read(RoadFolder(built_roads).ways)


@pytest.mark.parametrize(
    ("way", "road_class", "limits", "certainty", "surroundings"),
    [
        (MAIN, RoadClass.PRIMARY, (50, 50), TAGGED, URBAN),
        (MPH, RoadClass.RESIDENTIAL, (48.28, 48.28), TAGGED, URBAN),
        (PARALLEL, RoadClass.RESIDENTIAL, (50, 50), ASSUMED, URBAN),
        (MOTORWAY, RoadClass.MOTORWAY, (120, 120), ASSUMED, RURAL_LAND),
        (TWO_LIMITS, RoadClass.TERTIARY, (40, 20), TAGGED, URBAN),
        (TUNNEL, RoadClass.SECONDARY, (50, 50), TAGGED, URBAN),
        (WALK, RoadClass.LIVING_STREET, (7, 7), TAGGED, URBAN),
        (NONSENSE, RoadClass.TERTIARY, (80, 80), ASSUMED, RURAL_LAND),
        (SERVICE, RoadClass.SERVICE, (50, 50), ASSUMED, URBAN),
    ],
)
def test_a_way_has_its_class_and_limit(network, way, road_class, limits, certainty, surroundings):
    (row,) = network.rows_of(np.array([way]))
    assert network.road_class[row] == road_class
    assert tuple(network.limit_kmh[row]) == pytest.approx(limits)
    assert (network.limit_certainty[row] == certainty).all()
    assert network.surroundings[row] == surroundings
    assert network.tunnel[row] == (way == TUNNEL)


def test_outside_the_countries_whose_borders_are_there_nothing_is_assumed(network, map_file, tmp_path):
    # The way's middle lies 500 m beyond the border.
    (row,) = network.rows_of(np.array([RURAL]))
    assert math.isnan(network.limit_kmh[row, 0])
    assert network.limit_certainty[row, 0] == Certainty.UNKNOWN
    build(map_file, tmp_path / "swiss", quiet, country="CH")
    swiss = RoadNetwork.read(RoadFolder(tmp_path / "swiss").ways)
    (row,) = swiss.rows_of(np.array([RURAL]))
    assert (swiss.limit_kmh[row, 0], swiss.limit_certainty[row, 0]) == (80, ASSUMED)


def test_only_roads_for_cars_are_kept(network):
    assert network.rows_of(np.array([FOOTWAY])).tolist() == [-1]
    assert set(network.way_id.tolist()) == set(STREETS) - {FOOTWAY}


def test_the_manifest_says_what_was_built(built_roads, map_file):
    manifest = RoadService(built_roads).manifest
    assert manifest.ways == len(STREETS) - 1
    assert manifest.countries == ("FI",)
    assert (manifest.district_level, manifest.districts) == (9, 3)
    assert manifest.extract == map_file.name
    assert len(manifest.extract_sha256) == 64
    assert "OpenStreetMap" in manifest.attribution
    assert manifest.box_deg == pytest.approx((*at(-1000, -1500), *at(6500, 1500)), abs=1e-6)


def test_districts_are_areas_also_where_the_extract_cuts_them(built_roads):
    districts = Districts.read(RoadFolder(built_roads).districts)

    def district(x_m, y_m):
        (index,) = districts.within(np.array([at(x_m, y_m)]))
        return None if index < 0 else districts.names[index]

    assert district(200, 300) == "Westviertel"
    assert district(1800, 300) == "Ostviertel"
    # Its line leaves the map at both ends; the place of its name is east of it.
    assert district(5500, -200) == "Fernviertel"
    assert district(4000, 0) is None
    features = json.loads(RoadFolder(built_roads).districts.read_text())["features"]
    assert {one["geometry"]["type"] for one in features} <= {"Polygon", "MultiPolygon"}


def test_a_street_along_a_border_is_in_one_district(built_roads, network):
    districts = Districts.read(RoadFolder(built_roads).districts)
    (row,) = network.rows_of(np.array([BORDER]))
    own = network.district_index[row]
    wander = np.array([at(1000 + offset, y) for y, offset in zip(range(50, 550, 10), [-6, 6] * 25, strict=True)])
    assert set(districts.within(wander).tolist()) == {0, 1}
    assert set(districts.along(wander, np.full(50, own)).tolist()) == {int(own)}


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "EXTRACT.osm.pbf|cannot be read"),
        (b"hello, this is no map", "cannot be read"),
        (b"<osm version='0.6'></osm>", "cannot be read"),
    ],
)
def test_what_is_no_extract_is_refused(tmp_path, content, said):
    path = tmp_path / "wrong.osm.pbf"
    path.write_bytes(content)
    with pytest.raises(UsageError, match=said):
        build(path, tmp_path / "out", quiet)
    assert not (tmp_path / "out").exists()


def test_an_extract_that_was_cut_short_is_refused(tmp_path, map_file):
    path = tmp_path / "short.osm.pbf"
    path.write_bytes(map_file.read_bytes()[:-40])
    with pytest.raises(UsageError, match="whole"):
        build(path, tmp_path / "out", quiet)


def test_an_extract_without_roads_is_refused(tmp_path):
    path = write_map(tmp_path / "paths.osm.pbf", {FOOTWAY: STREETS[FOOTWAY]})
    with pytest.raises(UsageError, match="no roads"):
        build(path, tmp_path / "out", quiet)
    assert sorted(one.name for one in tmp_path.iterdir()) == ["paths.osm.pbf"]


def test_a_folder_that_holds_something_else_is_left_alone(tmp_path, map_file, capsys):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "letter.txt").write_text("dear")
    status, _, err = call(capsys, "roads", "build", map_file, tmp_path / "mine")
    assert (status, err.count("\n")) == (2, 1)
    assert "choose a new or an empty folder" in err
    assert (tmp_path / "mine" / "letter.txt").read_text() == "dear"


def test_a_build_that_fails_leaves_what_was_built_before(tmp_path, built_roads, map_file, monkeypatch):
    out = tmp_path / "roads"
    shutil.copytree(built_roads, out)
    before = (out / "manifest.json").read_bytes()

    def fails(*_):
        raise OSError(28, os.strerror(28))

    monkeypatch.setattr(RoadNetwork, "write", fails)
    with pytest.raises(UsageError, match="No space left"):
        build(map_file, out, quiet)
    assert (out / "manifest.json").read_bytes() == before
    assert [one.name for one in tmp_path.iterdir()] == ["roads"]
    monkeypatch.undo()
    build(map_file, out, quiet, district_level=2)
    assert RoadFolder(out).manifest().district_level == 2


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--country", "ZZ"), "ZZ"),
        (("--district-level", "5"), "it has 2, 9"),
        (("--limits", "nowhere.toml"), "nowhere.toml"),
    ],
)
def test_a_wrong_option_is_one_line(capsys, tmp_path, map_file, words, said):
    status, _, err = call(capsys, "roads", "build", map_file, tmp_path / "out", *words)
    assert (status, err.count("\n")) == (2, 1)
    assert said in err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda out: (out / "manifest.json").unlink(), "no built roads"),
        (lambda out: (out / "manifest.json").write_text("{}"), "no built roads"),
        (lambda out: (out / "manifest.json").write_text('{"format": 99}'), "build it again"),
        (lambda out: shutil.rmtree(out / "tiles"), "tiles missing"),
    ],
)
def test_a_folder_that_is_not_whole_is_refused(tmp_path, built_roads, change, said):
    out = tmp_path / "roads"
    shutil.copytree(built_roads, out)
    change(out)
    with pytest.raises(UsageError, match=said):
        RoadService(out)


def test_own_polygons_take_the_place_of_the_maps_districts(capsys, tmp_path, built_roads, map_file):
    west, south, east, north = RoadFolder(built_roads).manifest().box_deg
    middle = 0.5 * (west + east)
    areas = tmp_path / "zones.csv"
    areas.write_text(
        f'name,wkt\nA,"POLYGON(({west} {south},{middle} {south},{middle} {north},{west} {north},{west} {south}))"\n'
    )
    status, out, _ = call(capsys, "roads", "build", map_file, tmp_path / "out", "--districts", areas)
    assert (status, "1 districts, of " in out) == (0, True)
    built = Districts.read(RoadFolder(tmp_path / "out").districts)
    points = np.array([[0.5 * (west + middle), 0.5 * (south + north)], [0.5 * (middle + east), 0.5 * (south + north)]])
    assert (built.names, built.within(points).tolist()) == (("A",), [0, -1])
