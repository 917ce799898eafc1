"""``telefuse bench --navigation``: that it measures what it says, tells what was missed, and refuses what it cannot do.

How good the filter is decides no test here; one simulated drive with one outage stands for the sixteen.
"""

from __future__ import annotations

import json
import math
from functools import partial

import numpy as np
import pytest

from core.simulation.scenarios import simulate
from service.bench import calibration_gain, consistency, mobile_mapping, navigation, recorded_outages, simulated_outages
from service.bench.navigation_report import tables
from service.bench.targets import TARGETS, judged
from service.cli import main
from service.recordings.drive_folder import read_drive
from service.recordings.fusing import Outage, figures, fuse, fuse_config, vehicle_config
from service.recordings.simulated import drive_of
from tests.recordings import recording

ONE = {"seeds": (2,), "duration_s": 260.0}
START_S = 150.0  # of its one outage


def untold(done: float, total: float) -> None:
    assert 0 <= done <= total


@pytest.fixture(scope="module")
def synthetic():
    return simulated_outages.measure(untold, **ONE)


@pytest.fixture(scope="module")
def calibration():
    return calibration_gain.measure(untold, **ONE, draws=2)


def test_an_exact_drive_is_measured_by_every_aiding(synthetic):
    assert synthetic["outages"] == [{"seed": 2, "start_s": START_S}]
    assert list(synthetic["aidings"]) == ["constrained", "velocity", "position_only", "wheel"]
    for aiding in synthetic["aidings"].values():
        for instant in ("at_30_s", "at_60_s"):
            one = aiding[instant]
            assert one["rms_m"] == one["median_m"] == one["max_m"] == pytest.approx(one["errors_m"][0])
            assert one["stated_rms_m"] > 0.0


def test_errors_are_those_that_fuse_tells_for_the_same_outage(synthetic):
    drive = drive_of(simulate("exact_outages", 2, 260.0))
    without_wheel = simulated_outages.given(drive, simulated_outages.AIDINGS["constrained"])
    outages = [Outage(START_S, 30.0), Outage(START_S, 60.0)]
    told = figures(drive, fuse(without_wheel, fuse_config(vehicle_config(drive))), outages)
    found = synthetic["aidings"]["constrained"]
    for instant, one in zip(("at_30_s", "at_60_s"), told["outages"], strict=True):
        # Fuse takes the median offset of the whole drive off, which white fixes leave at some decimetres.
        assert found[instant]["rms_m"] == pytest.approx(one["end_m"], abs=math.hypot(*told["offset_ned_m"][:2]))


def test_what_an_aiding_may_not_use_is_kept_from_the_filter():
    drive = drive_of(simulate("exact_outages", 2, 60.0))
    for name, aiding in simulated_outages.AIDINGS.items():
        m = simulated_outages.given(drive, aiding).measurements
        assert (m.speed_t_ns.size > 0) == (name == "wheel")
        velocity = m.gnss[:, [3, 4, 5]]
        assert np.isnan(velocity).all() if name == "position_only" else np.isfinite(velocity).all()
    assert np.isfinite(drive.measurements.gnss[:, 3]).all()


def test_without_a_wheel_speed_that_aiding_is_left_out():
    found = simulated_outages.measure(untold, simulated_outages.ON_THE_ROAD, **ONE)
    assert "wheel" not in found["aidings"]


def test_nees_has_the_band_of_its_samples_and_shares_are_shares():
    found = consistency.measure(untold, **ONE)
    for settings in ("nees", "nees_stated"):
        assert list(found[settings]) == ["position", "velocity", "attitude"]
    assert list(found["nis_stated"]) == ["GNSS position", "GNSS height", "GNSS velocity"]
    for one in (*found["nees"].values(), *found["nees_stated"].values(), *found["nis_stated"].values()):
        low, high = one["band"]
        assert 0.0 < low < one["expected"] < high
        assert one["mean"] > 0.0
        assert one["inside"] is (low < one["mean"] < high)
    for one in found["nis_stated"].values():
        # White fixes of what they state, some 130 in this drive: an axis' mean square is known to 12 %.
        assert one["drawn"] == pytest.approx(1.0, abs=0.36)
        # And a filter that is told all that is true errs with them: its innovations are mostly theirs.
        assert one["mean"] == pytest.approx(one["drawn"], abs=0.2)
    # Five instants from 70 s on but those in the outage and soon after it; a single drive's attitude counts once.
    assert found["nees"]["position"]["band"][0] > found["nees"]["attitude"]["band"][0]
    for shares in found["within_3_sd"].values():
        assert list(shares) == ["north", "east", "down", "yaw"]
        assert all(0.0 <= share <= 1.0 for share in shares.values())


def test_integrated_and_calibrated_is_compared_with_gnss_alone(calibration):
    (outage,) = calibration["outages"]
    assert outage.keys() == {"seed", "start_s", *calibration_gain.SOLUTIONS}
    for name in calibration_gain.SOLUTIONS:
        assert 0.0 < outage[name]["rms_m"] <= outage[name]["max_m"]
    # Half a kilometre driven without a fix: a held one is left behind by hundreds of metres.
    assert outage["gnss_held"]["max_m"] > 100.0
    assert calibration["calibrated_worse_beyond_chance"] <= calibration["calibrated_not_better"]
    assert calibration["calibrated_not_better"] == int(outage["calibrated"]["rms_m"] >= outage["uncalibrated"]["rms_m"])


def test_recorded_drives_have_an_outage_every_45_s_after_the_first_minute():
    folder = recording("drives")
    for name in recorded_outages.SWEPT:
        drive = read_drive(folder / name)
        first_s, last_s = drive.t_s(drive.measurements.imu_t_ns[[0, -1]])
        outages = recorded_outages.placed(drive)
        starts = [outage.start_s for outage in outages]
        assert starts[0] == pytest.approx(first_s + 60.0)
        assert np.diff(starts) == pytest.approx(45.0)
        assert last_s - 45.0 < starts[-1] + 30.0 < last_s
        assert {outage.duration_s for outage in outages} == {30.0}


def test_recorded_drives_are_measured_in_each_outage_by_each_method(monkeypatch):
    folder = recording("drives")
    monkeypatch.setattr(recorded_outages, "EVERY_S", 500.0)  # one outage or two stand for the twenty
    monkeypatch.setattr(recorded_outages, "LEFT_OUT_EVERY", 2)
    found = recorded_outages.measure(folder, untold)
    for name in recorded_outages.SWEPT:
        planned = [outage.start_s for outage in recorded_outages.placed(read_drive(folder / name))]
        for method in recorded_outages.METHODS:
            sweep = found[name]["sweep"][method]
            assert [run["start_s"] for run in sweep["outages"]] == planned
            assert sum(run["end_m"] is None for run in sweep["outages"]) == sweep["without_position"]
    for name, outage in recorded_outages.NAMED.items():
        assert found[name]["outage"]["start_s"] == outage.start_s
        assert found[name]["outage"]["causal"]["rms_m"] > 0.0
    # One outage lasts until the drive ends: there is nothing after it that a smoother could use.
    assert found["kth_stockholm"]["outage"]["fixes_after"] == 0 < found["comma2k19_segment"]["outage"]["fixes_after"]
    asked = judged({"real": found})
    assert len(asked) == 8  # four figures, each causal and smoothed
    assert [one["floor"] for one in asked[4:]] == [
        *(found["kth_stockholm"][what]["limit"][key] for what, key in (("outage", "rms_m"), ("sweep", "median_end_m"))),
        found["boston_vn100"]["sweep"]["limit"]["median_end_m"],
        found["comma2k19_segment"]["outage"]["limit"]["rms_m"],
    ]
    told = tables({"real": found, "targets": asked})
    assert "median end" in told
    assert "0 fixes after it" in told
    assert "with all but what it is compared with" in told


def test_an_outage_without_a_position_counts_as_the_worst():
    def ends(*values):
        return [{"end_m": value} for value in values]

    assert recorded_outages.median_end_m(ends(3.0, 1.0, None)) == 3.0
    assert recorded_outages.median_end_m(ends(3.0, None, None)) is None


def test_an_outage_is_told_over_the_draws_of_its_noise():
    each = [calibration_gain.measure(untold, **ONE, draws=n)["outages"][0]["calibrated"] for n in (1, 2)]
    second = 2 * each[1]["rms_m"] ** 2 - each[0]["rms_m"] ** 2
    assert second > 0
    assert second != pytest.approx(each[0]["rms_m"] ** 2)  # other noise, other error
    assert each[1]["max_m"] >= each[0]["max_m"]


def test_targets_are_judged_by_what_was_measured(synthetic, calibration):
    rows = judged({"synthetic": synthetic, "calibration": calibration})
    assert len(rows) == sum(one.figure.split("/")[0] in ("synthetic", "calibration") for one in TARGETS)
    for row in rows:
        assert row["met"] is (row["value"] <= row["at_most"])
    wheel = next(row for row in rows if "wheel" in row["text"])
    assert wheel["at_most"] == synthetic["aidings"]["constrained"]["at_30_s"]["rms_m"]


def test_a_figure_that_could_not_be_had_is_missed():
    lost = {name: {"at_30_s": {"rms_m": None}, "at_60_s": {"rms_m": 1.0}} for name in simulated_outages.AIDINGS}
    rows = judged({"synthetic": {"aidings": lost}})
    assert [row["met"] for row in rows] == [False, True] * 3


@pytest.fixture
def one_drive(monkeypatch):
    """The parts as they are, over a single drive."""
    small = {name: partial(part, **ONE) for name, part in navigation.PARTS.items()}
    monkeypatch.setattr(navigation, "PARTS", small)


def test_figures_are_one_json_object_or_a_table_a_part(one_drive, capsys):
    chosen = ["bench", "--navigation", "--part", "synthetic", "--part", "calibration"]
    assert main([*chosen, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert list(found) == ["synthetic", "calibration", "targets"]
    assert main(chosen) == 0
    printed = capsys.readouterr().out
    assert "seed 2 at 150 s" in printed
    assert printed.count("met") + printed.count("missed") >= len(found["targets"])


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--navigation", "--part", "moon"], "--part moon: expected one of synthetic, road, consistency"),
        (["--navigation", "--drives", "/nowhere"], "no drive folder"),
        (["--part", "synthetic"], "are for --navigation"),
        (["--drives", "/nowhere"], "are for --navigation"),
        (["--kernel", "--navigation"], "not allowed with"),
    ],
)
def test_what_cannot_be_measured_is_refused_in_one_line(words, message, capsys):
    try:
        status = main(["bench", *words])
    except SystemExit as stopped:
        status = stopped.code
    assert status == 2
    told = capsys.readouterr().err
    assert message in told
    assert told.count("\n") == 1


def test_without_recorded_drives_that_part_is_left_out_unless_asked_for(one_drive, monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(navigation, "DRIVES", tmp_path)
    monkeypatch.setattr(mobile_mapping, "SEEDS", (1,))
    assert main(["bench", "--navigation", "--part", "real"]) == 2
    assert f"{tmp_path}: no drive folder" in capsys.readouterr().err
    found = navigation.measure([], None, lambda part, done, total: None)
    assert "real" not in found
    assert found["targets"]
