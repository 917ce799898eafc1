"""``telefuse bench --calibration``: that it measures what it says, and refuses what it cannot do.

How good a calibration is decides no test here; a few simulated units stand for the five hundred.
"""

from __future__ import annotations

import json

import numpy as np
import pytest

from core.calibration.fit import PARAMETERS
from core.calibration.gyroscope import GYROSCOPE_PARAMETERS
from core.calibration.gyroscope_problem import across
from core.calibration.turns import integrate
from core.rotation import skew
from core.simulation.sensors import GYROSCOPE
from service.bench import calibration, calibration_gyroscope, calibration_noise, calibration_recordings, minimiser
from service.bench.calibration_report import tables
from service.bench.calibration_targets import SEED1_TABLE_2, SEED1_TABLE_3, TARGETS
from service.bench.targets import judged
from tests.commands import call
from tests.recordings import recording


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


def test_the_gyroscope_is_told_by_parameter_and_what_is_out_of_reach_is_said():
    units = calibration_gyroscope.against_truth(untold, 2)
    repeated = calibration_gyroscope.repeated(untold, 1)
    assert list(units["outside_3_sd"]) == list(GYROSCOPE_PARAMETERS)
    assert list(repeated["variances"]) == ["straight", "twice_round"]
    for variances in repeated["variances"].values():
        assert list(variances) == list(SEED1_TABLE_3)
        beyond = {name for name, one in variances.items() if one["cramer_rao"] and one["cramer_rao"] > one["seed1"]}
        assert beyond >= set(calibration_gyroscope.MISALIGNMENT_PRODUCTS)
    least = {"-SFy Mx": calibration_gyroscope.least_turns(1.28e-11)}
    found = {"gyroscope": {"units": units, "repeated": repeated, "least_turns": least}}
    rows = judged(found, TARGETS)
    assert len(rows) == sum(target.figure.startswith("gyroscope/") for target in TARGETS)
    told = tables(found | {"targets": rows})
    assert "the gyroscope turned straight; variances over 5 recordings" in told
    assert told.count("out of reach") >= 2 * len(calibration_gyroscope.MISALIGNMENT_PRODUCTS)


def test_no_turn_tells_misalignment_better_than_the_least_that_is_stated():
    # The products of a triad, by turns at the full scale about the axis between two of the box's own that is level.
    limit, w = 2.28e-10, GYROSCOPE.full_scale
    angle = 2.0 * np.pi * calibration_gyroscope.least_turns(limit)
    t_s = np.linspace(0.0, angle / w, 4001)
    axis = np.array([1.0, 1.0, 0.0]) / np.sqrt(2.0)
    noise = np.full(3, GYROSCOPE.random_walk)
    ends = np.array([0]), np.array([t_s.size - 1])
    turns = integrate(t_s, np.tile(w * axis, (t_s.size, 1)), *ends, np.eye(3), np.zeros((1, 3)), noise)
    up = turns.C_a_from_e[0].T @ np.array([0.0, 0.0, 1.0])
    lever = across(up).T @ skew(up)
    row = lever @ turns.by_inverse[0][:, 0, 1]
    told = row @ np.linalg.solve(lever @ turns.covariance[0] @ lever.T, row)
    best = 1.0 / ((calibration_gyroscope.POSITIONS - 1) * told)
    # A turn that is not whole adds what does not grow with its angle, at most 2 rad of 24.
    assert best == pytest.approx(limit, rel=0.2)


def test_the_noise_of_a_real_gyroscope_is_what_was_found_of_it_before():
    place = recording("data", calibration_noise.ADIS).parent
    found = {"noise": calibration_noise.measure(place, untold)}
    rows = judged(found, TARGETS)
    walk, floor, side_by_side = rows
    assert walk["met"]
    assert side_by_side["met"]
    # By the overlapping estimator no axis has its floor where the page has it; but the intervals allow for it.
    assert (floor["met"], floor["value"]) == (False, 3)
    assert found["noise"]["floor_intervals_outside"] == 0
    # Its page has these three digits at 1 s: so it is by the non-overlapping estimator that it has its floors, too.
    signal = np.rad2deg(calibration_noise.adis16405(place).recording.gyroscope)
    at_1_s = [60.0 * calibration_noise.non_overlapping(axis, 100) for axis in signal.T]
    assert np.round(at_1_s, 2).tolist() == [2.44, 2.61, 2.34]
    assert "(23.0 to 28.2)" in tables(found)


def test_parts_whose_recordings_are_missing_are_left_out_visibly(tmp_path, monkeypatch):
    monkeypatch.setattr(calibration_recordings, "PLACE", tmp_path)
    monkeypatch.setattr(calibration, "PARTS", {})
    monkeypatch.setattr(calibration, "PART_NAMES", tuple(calibration.RECORDED))
    found = calibration.measure([], None, lambda part, done, total: None)
    assert found == {
        "left_out": {"recordings": calibration_recordings.XSENS, "noise": calibration_noise.ADIS},
        "targets": [],
    }
    assert "noise: left out, as there is no 'static_adis16405_2h8'" in tables(found)


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
        (
            ["--calibration", "--part", "units2"],
            "minimiser, units, repeated, gyroscope, recordings, noise",
        ),
        (["--calibration", "--recordings", "/nowhere"], "no 'calib_xsens_imu_tk'"),
        (["--calibration", "--part", "noise", "--recordings", "/nowhere"], "no 'static_adis16405_2h8'"),
        (["--recordings", "/nowhere"], "--recordings is for --calibration, --accidents and --driving"),
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
