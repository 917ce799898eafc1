"""Tables of rates and masses: what they give, and what is refused with its reason."""

from __future__ import annotations

import numpy as np
import pytest

from core.errors import InvalidInputError
from core.risk.belief import mass_of, named
from core.risk.driver import Driver
from core.risk.environment import Environment, Road, calendar, solar_offset_s
from core.risk.lookup import DRIVER, ENVIRONMENT, crossfade, tables_of
from service.risk.loading import PRESETS, preset_tables

NODES = {"LR": 0.8, "LR|MR": 1.1, "MR": 1.5, "MR|HR": 2.0, "HR": 2.6}
SEX = {"name": "sex", "entity": "driver", "source": "a choice", "rows": [{"when": {"sex": "F"}, "mass": {"LR": 1.0}}]}


def at(when_ns=1_463_414_400_000_000_000, **road):
    """One instant: Monday 2016-05-16, 16 h UTC, in Montréal unless said otherwise."""
    known = {"limit_kmh": np.nan, "kind": "", "surroundings": "", "district": "", "position_sd_m": 0.0} | road
    return Environment(
        np.array([when_ns]), 0.0, np.radians([45.5]), np.radians([-73.6]),
        Road(**{name: np.array([value]) for name, value in known.items()}),
    )  # fmt: skip


def only(tables, name):
    return next(table for table in tables.tables if table.name == name)


def test_relative_rates_fade_from_node_to_node():
    masses = crossfade(np.array([0.2, 0.8, 0.95, 1.1, 1.3, 2.3, 9.0, np.nan]), list(NODES.values()))
    told = [{name: round(mass, 9) for name, mass in named(row).items() if mass} for row in masses]
    assert told == [
        {"LR": 1.0},
        {"LR": 1.0},
        {"LR": 0.5, "LR|MR": 0.5},
        {"LR|MR": 1.0},
        {"LR|MR": 0.5, "MR": 0.5},
        {"MR|HR": 0.5, "HR": 0.5},
        {"HR": 1.0},
        {"LR|MR|HR": 1.0},
    ]


def test_the_papers_five_look_ups():
    tables = preset_tables("paper")
    (mass,), (known,) = only(tables, "age_sex").look_up(Driver(32, "M").values())
    assert known
    assert mass == pytest.approx(mass_of({"MR": 0.3, "LR|MR": 0.7}))
    values = at(district="Ville-Marie").values()
    expected = {"district": "MR", "hour": "HR", "month": "HR", "weekday": "MR|HR"}
    for table in tables.of(ENVIRONMENT):
        (mass,), (known,) = table.look_up(values)
        assert known
        assert mass == pytest.approx(mass_of({expected[table.name]: 1.0}))
    assert not only(tables, "age_sex").look_up(Driver(33, "M").values())[1].any()
    assert not only(tables, "age_sex").look_up(Driver(32, "F").values())[1].any()


@pytest.mark.parametrize("name", PRESETS)
def test_every_shipped_table_says_its_source_and_its_masses_sum(name):
    for table in preset_tables(name).tables:
        assert len(table.source) > 10
        for row in table.rows:
            assert row.mass.sum() == pytest.approx(1.0, abs=1e-12)


def test_default_tables_know_every_driver_hour_day_month_and_road():
    tables = preset_tables("default")
    for age in range(16, 111):
        for table in ("age", "age_2017"):
            assert only(tables, table).look_up(Driver(age).values())[1].all()
    for years in (0.0, 1.0, 30.0):
        assert only(tables, "experience").look_up(Driver(60, None, years).values())[1].all()
    year_ns = np.arange(0, 366 * 24, 7) * 3_600_000_000_000 + 1_704_067_200_000_000_000
    values = at().values()
    hour, weekday, month = calendar(year_ns, 0.0)
    assert {len(set(column)) for column in (hour, weekday, month)} == {24, 7, 12}
    for when in year_ns[::29]:
        values = at(int(when), kind="primary", surroundings="rural").values()
        assert all(table.look_up(values)[1].all() for table in tables.of(ENVIRONMENT))


def test_young_and_old_drivers_are_worse_than_those_between():
    table = only(preset_tables("default"), "age")
    risk = [table.look_up(Driver(age).values())[0][0] for age in (18, 45, 82)]
    assert [named(mass)["HR"] for mass in risk] == [1.0, 0.0, 1.0]


def test_local_calendar_of_an_offset():
    """2016-05-16T23:30Z is the 17th at 01:30 in Helsinki's winter offset, and the 16th at 19:30 in Montréal."""
    t_ns = np.array([1_463_441_400_000_000_000])
    assert [int(x[0]) for x in calendar(t_ns, 7200.0)] == [1, 1, 5]
    assert [int(x[0]) for x in calendar(t_ns, -4 * 3600.0)] == [19, 0, 5]
    assert [int(x[0]) for x in calendar(np.array([-1]), 0.0)] == [23, 2, 12]
    assert solar_offset_s(np.radians(24.94)) == 7200.0
    assert solar_offset_s(np.radians(-73.6)) == -5 * 3600.0


def test_night_is_told_by_the_sun():
    assert at().values()["light"][0] == "day"  # 11 h in Montréal
    assert at(1_463_371_200_000_000_000).values()["light"][0] == "night"  # 23 h the evening before
    lost = at()
    lost.lat_rad[0] = np.nan
    assert lost.values()["light"][0] == ""


@pytest.mark.parametrize(
    ("age", "sex", "experience", "complaint"),
    [
        (7, None, None, "driver's age is 7: expected 14 to 110"),
        (111, None, None, "driver's age is 111"),
        (40, "X", None, "driver's sex is 'X': expected M or F"),
        (20, None, 10.0, "experience is 10 years: expected 0 to 6"),
        (None, None, -1.0, "experience is -1 years"),
    ],
)
def test_who_can_be_no_driver_is_refused(age, sex, experience, complaint):
    with pytest.raises(InvalidInputError, match=complaint):
        Driver(age, sex, experience)


def test_own_tables_extend_a_preset():
    own = {"use": ["hour_counts"], "without": ["hour"], "table": [SEX]}
    tables = tables_of(own, preset_tables("default"))
    assert [table.name for table in tables.of(DRIVER)] == ["age", "sex", "experience"]
    assert {"hour_counts", "hour"} & {table.name for table in tables.of(ENVIRONMENT)} == {"hour_counts"}
    assert only(tables, "sex").look_up(Driver(sex="F").values())[0][0] == pytest.approx(mass_of({"LR": 1.0}))
    assert not only(tables, "sex").look_up(Driver(sex="M").values())[1].any()


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"rows": [{"when": {"sex": "F"}, "mass": {"LR": 0.6}}]}, "table 'sex', row 1: masses sum to 0.6: expected 1"),
        ({"rows": [{"when": {"sex": "F"}, "mass": {"LOW": 1}}]}, "row 1: unknown proposition 'LOW'"),
        ({"rows": [{"when": {"sex": "F"}, "mass": 1}]}, "row 1: mass is 1: expected such as"),
        ({"rows": [{"when": {"sex": "F"}}]}, "row 1: expected either a mass or a rate"),
        ({"rows": [{"when": {"sex": "F"}, "rate": -1}]}, "row 1: rate is -1"),
        ({"rows": [{"when": {"sex": "F"}, "rate": 1}], "mean": 0}, "table 'sex': mean is 0"),
        ({"rows": [{"when": {"sex": "F"}, "rate": 1}], "scale": "range"}, "all rates are 1"),
        ({"rows": [{"when": {"sex": "F"}, "rate": 1}], "scale": "odd"}, "scale is 'odd'"),
        ({"rows": [{"when": {"sex": "X"}, "mass": {"LR": 1}}]}, "sex = 'X': expected one of M, F"),
        ({"rows": [{"when": {"hour": 3}, "mass": {"LR": 1}}]}, "unknown input 'hour' of the driver: expected age"),
        ({"rows": [{"when": {"age": [9]}, "mass": {"LR": 1}}]}, r"age = \[9\]: expected a whole number, or"),
        ({"rows": [{"when": {"age": [9, 5]}, "mass": {"LR": 1}}]}, r"age = \[9, 5\]: expected"),
        ({"rows": [{"when": {}, "mass": {"LR": 1}}]}, "row 1: no condition"),
        ({"rows": [{"if": {}, "mass": {"LR": 1}}]}, "row 1: no condition"),
        ({"rows": [{"when": {"age": 9}, "mass": {"LR": 1}, "why": 1}]}, "row 1: unknown key 'why'"),
        ({"rows": []}, "no rows"),
        ({"entity": "car"}, "entity is 'car'"),
        ({"source": ""}, "no source"),
        ({"name": ""}, "a table has no name"),
        ({"color": "red"}, "table 'sex': unknown key 'color'"),
    ],
)
def test_what_is_no_table_is_refused_with_table_and_row(change, complaint):
    with pytest.raises(InvalidInputError, match=complaint):
        tables_of({"nodes": NODES, "table": [SEX | change]})


@pytest.mark.parametrize(
    ("document", "complaint"),
    [
        ({}, "no table"),
        ({"tables": []}, "unknown key 'tables'"),
        ({"table": {"name": "x"}}, "no list of tables"),
        ({"table": [SEX], "without": ["age"]}, "without names table 'age': expected one of sex"),
        ({"table": [SEX], "use": "sex"}, "use is 'sex'"),
        ({"table": [SEX], "nodes": {"LR": 1}}, "nodes: expected a relative rate for each of"),
        ({"table": [SEX], "nodes": NODES | {"HR": 0.1}}, "expected rates that rise"),
        ({"table": [SEX | {"rows": [{"when": {"sex": "F"}, "rate": 1}], "mean": 1}]}, "there are no nodes"),
    ],
)
def test_what_is_no_document_of_tables_is_refused(document, complaint):
    with pytest.raises(InvalidInputError, match=complaint):
        tables_of(document)
