"""Legal limits: what mappers write, what it means in either direction, and what is assumed where they wrote nothing."""

import math
import tomllib
from importlib import resources

import pytest

from service.errors import UsageError
from service.roads.limits import CountryLimits, assumed_rule, parse_maxspeed, stated_limits, stated_surroundings
from service.roads.protocol import RoadClass, Surroundings

DEFAULTS = CountryLimits.read()


@pytest.mark.parametrize(
    ("text", "kmh"),
    [
        ("50", 50.0),
        ("50 km/h", 50.0),
        ("30 mph", 48.28),
        ("30mph", 48.28),
        ("20 knots", 37.04),
        ("walk", 7.0),
        ("none", math.inf),
        ("80;100", 100.0),
        ("80|100|120", 120.0),
        ("5", 5.0),
    ],
)
def test_signs_are_read_in_their_units(text, kmh):
    assert parse_maxspeed(text) == pytest.approx(kmh)


@pytest.mark.parametrize(
    "text", ["0", "999", "-30", "fast", "", "signals", "variable", "1e9", "30 furlongs", "٣٠ mph?"]
)
def test_what_no_sign_can_say_is_no_limit(text):
    assert math.isnan(parse_maxspeed(text))


@pytest.mark.parametrize(
    ("tags", "forward", "backward"),
    [
        ({"maxspeed": "50"}, 50, 50),
        ({"maxspeed": "50", "maxspeed:backward": "30"}, 50, 30),
        ({"maxspeed:forward": "40", "maxspeed:backward": "20"}, 40, 20),
        ({"maxspeed": "RO:urban"}, 50, 50),
        ({"maxspeed": "RO:rural"}, 90, 90),
        ({"maxspeed": "DE:motorway"}, math.inf, math.inf),
        ({"maxspeed": "DE:zone30"}, 30, 30),
        ({"maxspeed": "DE:zone:30"}, 30, 30),
        ({"maxspeed": "GB:nsl_single"}, 96.56, 96.56),
        ({"source:maxspeed": "FI:rural"}, 80, 80),
        ({"maxspeed:type": "FR:urban", "maxspeed": "30"}, 30, 30),
        ({"zone:traffic": "FI:urban"}, 50, 50),
        ({"maxspeed": "999", "source:maxspeed": "FI:urban"}, 50, 50),
        ({"maxspeed": "XX:urban"}, math.nan, math.nan),
        ({}, math.nan, math.nan),
    ],
)
def test_tags_say_a_limit_in_either_direction(tags, forward, backward):
    assert stated_limits(tags, DEFAULTS) == pytest.approx((forward, backward), nan_ok=True)


@pytest.mark.parametrize(
    ("tags", "surroundings"),
    [
        ({"maxspeed": "RO:urban"}, Surroundings.URBAN),
        ({"zone:traffic": "FI:rural"}, Surroundings.RURAL),
        ({"maxspeed": "DE:zone30"}, Surroundings.UNKNOWN),
        ({"maxspeed": "50"}, Surroundings.UNKNOWN),
    ],
)
def test_a_rule_says_where_the_road_lies(tags, surroundings):
    assert stated_surroundings(tags) is surroundings


def test_nothing_is_assumed_of_a_road_that_lies_nobody_knows_where():
    assert assumed_rule(RoadClass.PRIMARY, False, Surroundings.UNKNOWN) is None
    assert assumed_rule(RoadClass.PRIMARY, False, Surroundings.RURAL) == "rural"
    assert assumed_rule(RoadClass.TRUNK, True, Surroundings.URBAN) == "expressway"
    assert assumed_rule(RoadClass.MOTORWAY, True, Surroundings.UNKNOWN) == "motorway"
    assert assumed_rule(RoadClass.LIVING_STREET, False, Surroundings.RURAL) == "living_street"
    assert math.isnan(DEFAULTS.of(None, "urban"))
    assert math.isnan(DEFAULTS.of("ES", "urban"))


def test_every_country_says_where_its_figures_are_from():
    table = tomllib.loads(resources.files("service.roads").joinpath("limits.toml").read_text("utf-8"))
    assert len(table) > 20
    for country, rules in table.items():
        assert len(rules.pop("source")) > 10, country
        assert rules, country
        if {"urban", "rural"} <= rules.keys():
            assert rules["urban"] <= rules["rural"], country


def test_a_table_of_ones_own_goes_before_ours(tmp_path):
    own = tmp_path / "limits.toml"
    own.write_text('[FI]\nsource = "me"\nurban = 40\n[QQ]\nurban = 25\n')
    table = CountryLimits.read(own)
    assert (table.of("FI", "urban"), table.of("QQ", "urban"), table.of("LI", "rural")) == (40, 25, 80)
    assert math.isnan(table.of("FI", "rural"))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[FI]\nurbane = 40\n", "urbane"),
        ("[FI]\nurban = 0\n", "urban = 0"),
        ("[FI]\nurban = 999\n", "999"),
        ('[FI]\nurban = "fast"\n', "fast"),
        ("[FI]\nurban = true\n", "True"),
        ("[Finland]\nurban = 40\n", "Finland"),
        ("FI = 3\n", "FI"),
        ("[FI\n", "no table of limits"),
    ],
)
def test_a_table_that_cannot_be_says_what_is_wrong(tmp_path, text, said):
    own = tmp_path / "limits.toml"
    own.write_text(text)
    with pytest.raises(UsageError, match=said) as raised:
        CountryLimits.read(own)
    assert str(own) in str(raised.value)


def test_a_table_that_is_not_there_is_named(tmp_path):
    with pytest.raises(UsageError, match=r"nowhere\.toml"):
        CountryLimits.read(tmp_path / "nowhere.toml")
