"""Without roads everything runs, and says that they are unknown."""

import numpy as np
import pytest

from service.errors import UsageError
from service.roads import extra
from service.roads.matching import RoadService
from service.roads.protocol import NO_WAY, MatchedPoints, NullMatcher, RoadClass, RoadPlace
from tests.commands import call

T_NS = np.arange(3, dtype=np.int64) * 1_000_000_000
PLACE = np.full(3, 47.0), np.full(3, 9.5), np.full(3, 2.0)


def test_no_folder_is_no_roads():
    with RoadService(None) as roads:
        assert not roads.known
        matched = roads.match(T_NS, *PLACE)
        place = roads.place(47.0, 9.5, (4.0, 4.0, 0.0))
    assert len(matched) == 3
    assert (matched.way_id == NO_WAY).all()
    assert np.isnan(matched.limit_kmh).all()
    assert matched.street(0) is None
    assert place.json() == {
        "way_id": None,
        "street": None,
        "district": None,
        "road_class": "unknown",
        "surroundings": "unknown",
        "limit_kmh": None,
        "limit_certainty": "unknown",
        "tunnel": False,
        "distance_m": None,
        "confidence": 0.0,
    }


def test_the_null_matcher_answers_as_much_as_it_is_asked():
    assert len(NullMatcher().match(T_NS, *PLACE)) == 3
    assert len(NullMatcher().match(T_NS[:0], *(one[:0] for one in PLACE))) == 0


def test_a_folder_that_is_none_is_said_at_once(tmp_path):
    with pytest.raises(UsageError, match="roads"):
        RoadService(tmp_path)


def test_a_missing_extra_is_named(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(extra, "find_spec", lambda name: None if name == "valhalla" else object())
    assert not extra.installed()
    with pytest.raises(UsageError, match="valhalla"):
        RoadService(tmp_path)
    for words in (("roads", "build", "a.osm.pbf", tmp_path / "o"), ("simulate", tmp_path / "d", "--roads", tmp_path)):
        status, _, err = call(capsys, *words)
        assert (status, err.count("\n")) == (2, 1)
        assert "valhalla" in err
        assert "make setup" in err


def test_parts_joined_keep_their_names():
    def part(street):
        one = MatchedPoints.unknown(2)
        return type(one)(
            **{name: getattr(one, name) for name in one.__slots__ if name not in ("street_index", "streets")},
            street_index=np.array([0, -1]),
            streets=(street,),
        )

    joined = MatchedPoints.joined([part("Am Rain"), part("Am Hang"), part("Am Rain")])
    assert [joined.street(i) for i in range(6)] == ["Am Rain", None, "Am Hang", None, "Am Rain", None]
    assert joined.streets == ("Am Rain", "Am Hang")
    assert [joined.at(np.array([2, 2, 1])).street(i) for i in range(3)] == ["Am Hang", "Am Hang", None]
    assert RoadPlace.of(joined, 0).road_class is RoadClass.UNKNOWN
