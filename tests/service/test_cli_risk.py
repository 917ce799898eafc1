"""``telefuse risk`` as its callers see it: what it prints, what it refuses, and the paper's table I on real inputs."""

from __future__ import annotations

import csv
import gzip
import json
import shutil

import numpy as np
import pytest

from core.risk.belief import PROPOSITIONS
from core.simulation.scenarios import simulate
from service.recordings.drive_folder import write_drive
from service.recordings.simulated import drive_of
from service.risk.loading import shipped_text
from tests.commands import call
from tests.recordings import recording

ALIKE = 1e-3
"""Asked for: fused against reference in every mean mass."""
SCENARIO_1 = {"sources": [{"MR": 0.3, "LR|MR": 0.7}, {"MR": 0.25, "HR": 0.5, "MR|HR": 0.25}, {"LR|MR|HR": 1.0}]}


@pytest.fixture(scope="module")
def city(tmp_path_factory):
    """Streets with a tunnel of their own, four minutes."""
    folder = tmp_path_factory.mktemp("drives") / "city"
    write_drive(folder, drive_of(simulate("city", seed=3, duration_s=240.0, rate_hz=100.0)))
    return folder


def combined(capsys, tmp_path, document, *words):
    file = tmp_path / "masses.json"
    file.write_text(document if isinstance(document, str) else json.dumps(document), encoding="utf-8")
    return call(capsys, "risk", "combine", file, *words)


def assessed(capsys, *words):
    status, out, err = call(capsys, "risk", "assess", *words, "--json")
    assert (status, err) == (0, "")
    return json.loads(out)


def test_combining_scenario_1(capsys, tmp_path):
    status, out, err = combined(capsys, tmp_path, SCENARIO_1)
    assert (status, err) == (0, "")
    told = json.loads(out)
    assert list(told["mass"]) == list(PROPOSITIONS)
    assert {k: round(v, 4) for k, v in told["mass"].items() if v} == {
        "MR": 0.5250, "LR|MR": 0.1114, "HR": 0.1212, "LR|MR|HR": 0.2424,
    }  # fmt: skip
    assert told["conflict"] == pytest.approx(0.5, abs=1e-12)
    assert sum(told["pignistic"].values()) == pytest.approx(1.0)
    for name in PROPOSITIONS[1:]:
        assert told["belief"][name] <= told["plausibility"][name]
    assert told["decision"] == {"belief": "MR", "plausibility": "MR", "pignistic": "MR", "sure": "MR"}


def test_a_list_gives_a_list_each_by_its_own_rule_or_the_one_asked_for(capsys, tmp_path):
    conflicting = {"name": "zadeh", "sources": [{"LR": 0.9, "MR": 0.1}, {"HR": 0.9, "MR": 0.1}]}
    document = [SCENARIO_1, conflicting, conflicting | {"rule": "dempster"}]
    _, out, _ = combined(capsys, tmp_path, document)
    first, second, third = json.loads(out)
    assert round(first["mass"]["MR"], 4) == 0.5250
    assert (second["name"], second["conflict"]) == ("zadeh", pytest.approx(0.99))
    assert second["mass"]["LR"] == pytest.approx(0.486)
    assert third["mass"]["MR"] == pytest.approx(1.0)
    _, out, _ = combined(capsys, tmp_path, document, "--rule", "smets")
    assert [round(one["mass"][""], 9) for one in json.loads(out)] == [0.5, 0.99, 0.99]


def test_where_a_rule_is_undefined_the_mass_is_null(capsys, tmp_path):
    document = {"sources": [{"LR": 1}, {"HR": 1}]}
    status, out, _ = combined(capsys, tmp_path, document, "--rule", "dempster")
    told = json.loads(out)
    assert (status, told["mass"], told["pignistic"], told["conflict"]) == (0, None, None, 1.0)


def test_explaining_adds_what_each_source_contributes(capsys, tmp_path):
    _, out, _ = combined(capsys, tmp_path, SCENARIO_1, "--explain")
    told = json.loads(out)
    for name in ("LR", "MR", "HR"):
        total = sum(share[name] for share in told["attribution"])
        assert total == pytest.approx(told["pignistic"][name] - 1 / 3, abs=1e-12)


@pytest.mark.parametrize(
    ("document", "complaint"),
    [
        ("{", "is no JSON"),
        ("", "is no JSON"),
        ("[]", "the list is empty"),
        ("3", "holds a number"),
        ('{"sources": []}', "'sources' is an empty list"),
        ('{"masses": [{"LR": 1}]}', "unknown key 'masses'"),
        ("{}", "there is no 'sources'"),
        ('{"sources": {"LR": 1}}', "'sources' is an object"),
        ('{"sources": [3]}', "source 1 is a number"),
        ('{"sources": [{"LR": 1}, {"XR": 1}]}', "source 2: unknown proposition 'XR'"),
        ('{"sources": [{"LR": -0.5, "MR": 1.5}]}', "source 1: mass of 'LR' is -0.5"),
        ('{"sources": [{"LR": 0.5}]}', "source 1: masses sum to 0.5: expected 1"),
        ('{"sources": [{}]}', "source 1: masses sum to 0: expected 1"),
        ('{"sources": [{"LR": NaN}]}', "NaN is no JSON number"),
        ('{"sources": [{"LR": 1e999}]}', "mass of 'LR' is inf"),
        ('{"sources": [{"LR": 0.5, "LR": 0.5}]}', "key 'LR' stands twice"),
        ('{"sources": [{"LR": 1}], "rule": "best"}', "unknown rule 'best'"),
        ('[{"sources": [{"LR": 1}]}, {"sources": [{"LR": 2}]}]', "case 2: source 1: mass of 'LR' is 2"),
        ("[" * 100_000, "is no JSON"),
    ],
)
def test_bad_masses_end_with_one_line(capsys, tmp_path, document, complaint):
    status, out, err = combined(capsys, tmp_path, document)
    assert (status, out) == (2, "")
    assert complaint in err
    assert err.count("\n") == 1


def test_bad_files_and_rules_end_with_one_line(capsys, tmp_path):
    binary = tmp_path / "binary"
    binary.write_bytes(b"\xff\xfe\x00")
    for words, complaint in (
        ((tmp_path / "none.json",), "cannot be read"),
        ((binary,), "is no UTF-8"),
        ((binary, "--rule", "best"), "unknown rule 'best'; expected one of pcr6"),
    ):
        status, out, err = call(capsys, "risk", "combine", *words)
        assert (status, out) == (2, "")
        assert complaint in err


def test_table_1_on_a_simulated_drive(capsys, city):
    told = assessed(capsys, city, "--outage", "60:45", "--outage", "150:60", "--table")
    reference, raw, fused = (told["columns"][name] for name in ("reference", "raw", "fused"))
    assert {reference["instants"], raw["instants"], fused["instants"]} == {241}
    assert told["difference"] < ALIKE
    for column in (reference, fused):
        assert round(column["mean"]["LR|MR|HR"], 4) == 0.0
    assert raw["mean"]["LR|MR|HR"] > 0.02
    assert raw["max_theta"] > 0.1
    for column in (reference, raw, fused):
        assert column["conflict"] == 0.0
        assert sum(column["mean"].values()) == pytest.approx(1.0)
    assert raw["coverage"]["vehicle.motion"] < 0.7 < fused["coverage"]["vehicle.motion"]


def test_table_1_on_a_recorded_drive(capsys):
    folder = recording("drives", "comma2k19_segment")
    outages = ("--outage", "15:10", "--outage", "38:12")
    told = assessed(capsys, folder, *outages, "--driver-age", "32", "--driver-sex", "M", "--table")
    assert told["difference"] < ALIKE
    fused, raw = told["columns"]["fused"], told["columns"]["raw"]
    assert round(fused["mean"]["LR|MR|HR"], 4) == 0.0
    assert raw["max_theta"] > 0.1
    assert raw["max_theta_outside_outages"] == 0.0
    assert (fused["conflict"], raw["conflict"]) == (0.0, 0.0)


def test_raw_is_on_theta_in_its_outages_alone(capsys, city, tmp_path):
    """The outage asked for, and the tunnels of the drive's own."""
    timeline = tmp_path / "risk.csv"
    truth = json.loads((city / "truth.json").read_text())
    spans = [(span["start_s"], span["start_s"] + span["duration_s"]) for span in truth["outages"]] + [(60.0, 105.0)]
    told = assessed(capsys, city, "--source", "raw", "--outage", "60:45", "--timeline", timeline)
    with timeline.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 241
    for row in rows:
        t_s, theta = float(row["t_s"]), float(row["mass_LR|MR|HR"])
        masses = [float(row[f"mass_{name or 'empty'}"]) for name in PROPOSITIONS]
        assert sum(masses) == pytest.approx(1.0, abs=1e-7)
        if row["in_outage"] == "1":
            assert any(start - 1.0 <= t_s <= end + 1.0 for start, end in spans)
            assert theta > 0.05
            assert row["speed_mps"] == ""
        else:
            assert theta == 0.0
    assert (told["max_theta_outside_outages"], told["max_theta"] > 0.1) == (0.0, True)


def test_the_driver_may_be_left_out_and_that_is_said(capsys, city, tmp_path):
    nobody = tmp_path / "nobody"
    shutil.copytree(city, nobody)
    header = (nobody / "drive.toml").read_text(encoding="utf-8")
    (nobody / "drive.toml").write_text(header.split("[driver]")[0], encoding="utf-8")
    told = assessed(capsys, nobody, "--source", "reference")
    assert "driver" not in told["entities"]
    assert "driver.age: age not given (--driver-age)" in told["left_out"]
    assert told["coverage"]["driver.sex"] == 0.0
    known = assessed(capsys, nobody, "--source", "reference", "--driver-age", "20", "--driver-sex", "F")
    assert known["coverage"]["driver.age"] == 1.0
    assert known["entities"]["driver"] != told["entities"]


def test_the_start_moves_the_drive_to_another_hour_and_zone(capsys, city):
    paper = ("--source", "reference", "--preset", "paper", "--driver-age", "32", "--driver-sex", "M")
    there = assessed(capsys, city, *paper, "--start", "2016-05-16T16:00:00-04:00")
    assert there["entities"]["environment"]["HR"] > 0.5
    assert there["utc_offset_s"] == -4 * 3600.0
    assert any("district: table 'district' is for Ville-Marie" in line or "district: roads" in line
               for line in there["left_out"])  # fmt: skip
    elsewhen = assessed(capsys, city, *paper, "--start", "2016-06-14T10:00:00Z")
    assert "environment" not in elsewhen["entities"]
    assert "environment.hour: table 'hour' of paper has nothing for this drive's hour" in elsewhen["left_out"]


def test_own_tables_are_used_and_bad_ones_refused(capsys, city, tmp_path):
    own = tmp_path / "own.toml"
    own.write_text(
        'extends = "default"\nname = "mine"\nwithout = ["age", "experience"]\n'
        '[[table]]\nname = "sex"\nentity = "driver"\nsource = "a choice"\n'
        'rows = [{ when = { sex = "M" }, mass = { HR = 1.0 } }]\n',
        encoding="utf-8",
    )
    told = assessed(capsys, city, "--source", "reference", "--tables", own)
    assert (told["preset"], told["entities"]["driver"]["HR"]) == ("mine", 1.0)
    own.write_text(own.read_text().replace("HR = 1.0", "HR = 0.7"), encoding="utf-8")
    status, _, err = call(capsys, "risk", "assess", city, "--tables", own)
    assert status == 2
    assert "own.toml: table 'sex', row 1: masses sum to 0.7: expected 1" in err
    for text, complaint in (("a = ", "is no TOML"), ('extends = "best"', "extends 'best'; expected one of default")):
        own.write_text(text, encoding="utf-8")
        status, _, err = call(capsys, "risk", "assess", city, "--tables", own)
        assert (status, complaint in err) == (2, True)


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (("--driver-age", "7"), "driver's age is 7: expected 14 to 110"),
        (("--driver-age", "old"), "invalid int value"),
        (("--driver-sex", "X"), "invalid choice: 'X'"),
        (("--start", "yesterday"), "--start 'yesterday' is not an RFC 3339 time"),
        (("--outage", "999:10"), "outage 999:10 begins after the drive's end at 240 s"),
        (("--outage=-50:10",), "ends before the drive's first sample"),
        (("--outage", "ten"), "expected START:DURATION"),
        (("--timeline", "risk.txt"), "unknown file ending; expected .csv"),
        (("--table", "--timeline", "risk.csv"), "--timeline is of one source"),
        (("--tables", "none.toml"), "none.toml: cannot be read"),
    ],
)
def test_bad_questions_end_with_one_line(capsys, city, words, complaint):
    status, out, err = call(capsys, "risk", "assess", city, *words)
    assert (status, out) == (2, "")
    assert complaint in err
    assert err.count("\n") == 1


def test_a_drive_without_what_is_asked_for_is_refused(capsys, city, tmp_path):
    bare = tmp_path / "bare"
    shutil.copytree(city, bare)
    (bare / "reference.csv.gz").unlink()
    status, _, err = call(capsys, "risk", "assess", bare, "--source", "reference")
    assert (status, "has no reference.csv" in err) == (2, True)
    (bare / "gnss.csv.gz").unlink()
    for source in ("raw", "fused"):
        status, _, err = call(capsys, "risk", "assess", bare, "--source", source)
        assert (status, "has no gnss.csv" in err) == (2, True)
    status, _, err = call(capsys, "risk", "assess", tmp_path / "nowhere")
    assert (status, "no such folder" in err) == (2, True)


def test_positions_alone_tell_speeds(capsys, city, tmp_path):
    """A receiver without velocities: speeds come from its positions, and masses are near those by velocity."""
    plain = tmp_path / "plain"
    shutil.copytree(city, plain)
    with gzip.open(city / "gnss.csv.gz", "rt", encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    (plain / "gnss.csv.gz").unlink()
    with (plain / "gnss.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, ["t_s", "lat_deg", "lon_deg", "alt_ellipsoid_m"], extrasaction="ignore")
        writer.writeheader()
        writer.writerows(rows)
    by_position = assessed(capsys, plain, "--source", "raw")
    by_velocity = assessed(capsys, city, "--source", "raw")
    difference = [abs(by_position["mean"][name] - by_velocity["mean"][name]) for name in PROPOSITIONS]
    assert max(difference) < 0.1  # metres of noise a second are some m/s2
    assert by_position["coverage"]["vehicle.motion"] > 0.5


def test_the_tables_can_be_printed_to_begin_ones_own_with(capsys):
    for name in ("default", "paper", "vehicle"):
        status, out, _ = call(capsys, "risk", "tables", name)
        assert (status, out) == (0, shipped_text(name))
    assert np.all([word in shipped_text("default") for word in ("PMC7403895", "Farmer & Williams")])


@pytest.fixture(scope="module")
def on_roads(built_roads, tmp_path_factory):
    """Five minutes on the streets of a map."""
    from service.roads.simulated import simulate_on_roads

    folder = tmp_path_factory.mktemp("drives") / "streets"
    write_drive(folder, drive_of(simulate_on_roads(built_roads, seed=4, duration_s=300.0, rate_hz=50.0)))
    return folder


def test_with_roads_limits_classes_and_districts_are_known(capsys, on_roads, built_roads, tmp_path):
    timeline, own = tmp_path / "risk.csv", tmp_path / "own.toml"
    _, out, _ = call(capsys, "risk", "assess", on_roads, "--roads", built_roads, "--timeline", timeline, "--json")
    told = json.loads(out)
    assert told["coverage"]["environment.road_class"] > 0.8
    assert 0.5 < told["coverage"]["vehicle.speed"] < 1.0  # one street of that map has a limit of 999
    assert not any("roads are unknown" in line for line in told["left_out"])
    with timeline.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    districts = {row["district"] for row in rows} - {""}
    assert districts
    assert {row["limit_kmh"] for row in rows} & {"30", "40", "50", "80", "120"}
    table = 'name = "district"\nentity = "environment"\nsource = "a choice"\n'
    for district, known in ((sorted(districts)[0], True), ("Ville-Marie", False)):
        row = f'rows = [{{ when = {{ district = "{district}" }}, mass = {{ HR = 1.0 }} }}]\n'
        own.write_text(f'extends = "default"\n[[table]]\n{table}{row}', encoding="utf-8")
        told = assessed(capsys, on_roads, "--source", "reference", "--roads", built_roads, "--tables", own)
        assert (told["coverage"]["environment.district"] > 0.0) == known
        said = [line for line in told["left_out"] if line.startswith("environment.district")]
        assert bool(said) != known
    assert "table 'district' is for Ville-Marie, not for " in said[0]
    assert sorted(districts)[0] in said[0]


def test_what_are_no_roads_is_refused(capsys, city, tmp_path):
    pytest.importorskip("valhalla")
    status, _, err = call(capsys, "risk", "assess", city, "--roads", tmp_path)
    assert (status, "no built roads" in err) == (2, True)
