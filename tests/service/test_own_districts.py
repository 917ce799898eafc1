"""Districts of one's own: polygons that take the place of the map's, and a CSV of rates that becomes risk tables."""

from __future__ import annotations

import json
import tomllib

import numpy as np
import pytest

from core.risk.belief import named
from service.risk.loading import own_tables
from tests.commands import call

BOX = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [0.0, 0.0]]
BOW_TIE = [[0.0, 0.0], [1.0, 1.0], [1.0, 0.0], [0.0, 1.0], [0.0, 0.0]]


def feature(name, ring=None, kind="Polygon"):
    geometry = None if ring is None else {"type": kind, "coordinates": [ring] if kind == "Polygon" else ring}
    return {"type": "Feature", "properties": {"name": name}, "geometry": geometry}


def geojson(*features):
    return json.dumps({"type": "FeatureCollection", "features": list(features)})


def test_rates_become_a_table_relative_to_the_mean_by_exposure(tmp_path, capsys):
    rates = tmp_path / "rates.csv"
    rates.write_text('\ufeffdistrict,rate,exposure\n"Kallio ""K""",3,1\nTöölö,1,3\n', encoding="utf-8")
    status, out, _ = call(capsys, "risk", "districts", rates, "--source", "claims of 2025")
    own = tmp_path / "own.toml"
    own.write_text(out, encoding="utf-8")
    assert status == 0
    assert tomllib.loads(out)["table"][0]["mean"] == 1.5
    tables = own_tables(own)
    district = next(one for one in tables.of("environment") if one.name == "district")
    mass, known = district.look_up({"district": np.array(['Kallio "K"', "Töölö", "elsewhere", ""])})
    assert known.tolist() == [True, True, False, False]
    # 3 of a mean of 1.5 is at the node of MR|HR, 1 below that of LR: the nodes of the default tables.
    assert named(mass[0])["MR|HR"] == pytest.approx(1.0)
    assert named(mass[1])["LR"] == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("name,rate\na,1\n", "no column district"),
        ("district,rate\na,1\na,2\n", "line 3: a is there twice"),
        ("district,rate\na,many\n", "line 2: rate is 'many'"),
        ("district,rate\na,-1\n", "rate is '-1'"),
        ("district,rate\na,nan\n", "rate is 'nan'"),
        ("district,rate\n,1\n", "line 2: no district"),
        ("district,rate\n", "no district"),
        ("district,rate\na,0\n", "the mean rate is 0"),
        ("district,rate,exposure\na,1\n", "exposure is None"),
        ("district,rate,exposure\na,1,0\n", "no district with an exposure"),
    ],
)
def test_rates_that_say_nothing_are_refused(tmp_path, capsys, text, said):
    rates = tmp_path / "rates.csv"
    rates.write_text(text, encoding="utf-8")
    status, out, err = call(capsys, "risk", "districts", rates)
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert said in err


class TestPolygons:
    """They need shapely, of the extra ``roads``."""

    @pytest.fixture(autouse=True)
    def _needs_shapely(self):
        pytest.importorskip("shapely", reason="the extra 'roads' is not installed")

    def test_points_are_in_the_polygons_by_name(self, tmp_path):
        from service.roads.own_districts import read_districts

        path = tmp_path / "areas.geojson"
        path.write_text(geojson(feature("west", BOX), feature("east", [[x + 2.0, y] for x, y in BOX])))
        table = tmp_path / "areas.csv"
        table.write_text('name,wkt\nwest,"POLYGON((0 0,1 0,1 1,0 1,0 0))"\neast,"POLYGON((2 0,3 0,3 1,2 1,2 0))"\n')
        for districts in (read_districts(path), read_districts(table)):
            assert districts.names == ("west", "east")
            assert districts.within(np.array([[0.5, 0.5], [2.5, 0.5], [1.5, 0.5]])).tolist() == [0, 1, -1]

    @pytest.mark.parametrize(
        ("name", "text", "said"),
        [
            ("a.geojson", "{", "is no GeoJSON"),
            ("a.geojson", geojson(), "no district"),
            ("a.geojson", geojson(feature("", BOX)), "feature 1: no name"),
            ("a.geojson", geojson(feature("a", BOX), feature("b")), "feature 2 (b): no polygon"),
            ("a.geojson", geojson(feature("a", BOX[:2], "LineString")), "feature 1 (a): no polygon"),
            ("a.geojson", geojson(feature("a", BOW_TIE)), "Self-intersection"),
            ("a.geojson", geojson(feature("a", [[x, y + 100.0] for x, y in BOX])), "in this order"),
            ("a.csv", "name,shape\na,b\n", "no column wkt"),
            ("a.csv", "name,wkt\na,POLYGON(nowhere)\n", "line 2 (a): no polygon"),
        ],
    )
    def test_what_is_no_district_is_refused(self, tmp_path, name, text, said):
        from service.errors import UsageError
        from service.roads.own_districts import read_districts

        path = tmp_path / name
        path.write_text(text)
        with pytest.raises(UsageError) as refused:
            read_districts(path)
        assert said in str(refused.value)
