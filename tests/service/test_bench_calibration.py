"""``telefuse bench --calibration``: that it measures what it says, and refuses what it cannot do.

How good a calibration is decides no test here; a few simulated units stand for the five hundred.
"""

from __future__ import annotations

import json

import pytest

from core.calibration.fit import PARAMETERS
from service.bench import calibration, minimiser
from service.bench.calibration_report import tables
from service.bench.calibration_targets import SEED1_TABLE_2, TARGETS
from service.bench.targets import judged
from tests.commands import call


def untold(done: float, total: float) -> None:
    assert 0 <= done <= total


def test_units_and_repetitions_are_told_by_parameter():
    found = {"units": calibration.against_truth(untold, 3), "repeated": calibration.repeated(untold, 2)}
    assert list(found["units"]["outside_3_sd"]) == list(PARAMETERS)
    assert found["units"]["wrong_positions"] == 0
    assert list(found["repeated"]["variances"]) == list(SEED1_TABLE_2)
    assert all(one["mean"] <= one["largest"] for one in found["repeated"]["variances"].values())
    rows = judged(found, TARGETS)
    assert len(rows) == sum(target.figure.startswith(("units/", "repeated/")) for target in TARGETS)
    told = tables(found | {"targets": rows})
    assert "3 simulated units, 24 positions of 5 s" in told
    assert all(target in told for target in ("bias_z outside 3 sd", "variance of SFx My"))


def test_a_target_that_was_missed_is_told():
    found = {"recordings": {"xsens": {"off_factory": 0.1, "off_imu_tk": None, "residual_rms_mps2": 1e-4}}}
    targets = [target for target in TARGETS if target.figure.startswith("recordings/xsens/")]
    rows = judged(found, targets)
    assert [row["met"] for row in rows] == [False, False, True]
    assert "missed" in tables({"targets": rows})


def test_the_accelerometer_is_among_the_problems_and_all_minimisers_find_it():
    known = minimiser.accelerometer_problem()
    row = minimiser._compared(known)["minimisers"]
    assert list(row) == ["dogleg", *minimiser.PEERS]
    assert all(one["found"] for one in row.values())
    assert row["dogleg"]["iterations"] <= 15


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--calibration", "--part", "units2"], "expected one of minimiser, units, repeated, recordings"),
        (["--calibration", "--recordings", "/nowhere"], "no 'calib_xsens_imu_tk'"),
        (["--recordings", "/nowhere"], "--recordings is for --calibration"),
    ],
)
def test_what_it_cannot_do_is_one_line(arguments, message, capsys):
    status, out, err = call(capsys, "bench", *arguments)
    assert (status, out) == (2, "")
    assert message in err
    assert err.count("\n") == 1


def test_figures_as_json(monkeypatch, capsys):
    monkeypatch.setitem(calibration.PARTS, "repeated", lambda tell: calibration.repeated(tell, 1))
    status, out, err = call(capsys, "bench", "--calibration", "--part", "repeated", "--json")
    assert (status, err) == (0, "")
    assert set(json.loads(out)) == {"repeated", "targets"}
