"""``telefuse bench --accidents``: that it scores what it says, and refuses what it cannot do.

How good a detector is decides no test here; a few cases stand for the hundreds.
"""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from core.accident.events import Candidate, FeltImpact, Impact, NoAccident, Severity, Status
from core.accident.weights import JudgementThresholds
from core.simulation.collisions import Truth
from core.simulation.corpus import accident_case, quiet_case
from core.simulation.disturbances import NonAccident
from core.simulation.handling import SOURCES
from service.bench import (
    accident_classes,
    accident_corpus,
    accident_drives,
    accident_long,
    accident_recordings,
    accident_reliability,
    accident_scoring,
    accidents,
    processes,
)
from service.bench.accident_report import tables
from service.bench.accident_scoring import (
    NAMES,
    OURS,
    accident_figures,
    accident_record,
    listen,
    quiet_figures,
    quiet_record,
    rate,
    reliability,
    share,
    stories,
)
from service.bench.accident_targets import TARGETS
from service.bench.targets import judged
from tests.commands import call
from tests.recordings import recording

T_NS = 1_000_000_000_000


def untold(done: float, total: float) -> None:
    assert 0 <= done <= total


def impact(t_ns: int = T_NS, **changes) -> Impact:
    told = Impact(
        t_ns=t_ns,
        decided_t_ns=t_ns + 100_000_000,
        detector=OURS,
        severity=Severity.LOW_SPEED,
        confidence=0.9,
        delta_v_mps=4.0,
        delta_v_sd_mps=0.2,
        delta_v_b_mps=(-4.0, 0.0),
        pdof_deg=350.0,
        peak_mps2=60.0,
        duration_s=0.1,
        clipped=False,
        speed_before_mps=8.0,
        paper_agrees=False,
        delta_v_interval_mps=(3.6, 4.4),
    )
    return replace(told, **changes)


def candidate(reason: NoAccident, t_ns: int = T_NS, probability: float = 0.1) -> Candidate:
    return Candidate(t_ns, t_ns, reason, probability, 0.5, 1.0, 20.0, 0.1, 8.0, False)


def truth(delta_v: float = 4.2, **changes) -> Truth:
    one = {"t_s": 10.0, "delta_v_mps": delta_v, "pdof_deg": 5.0, "duration_s": 0.1, "peak_mps2": 60.0}
    fields = {"name": "frontal", "kind": "collision", "speed_mps": 8.0, "impacts": (one,), "ignition": True}
    return Truth(**(one | fields | {"roll_deg": 0.0} | changes))


def test_an_accident_told_in_steps_is_one_story_judged_by_its_last_step_and_timed_by_its_first():
    told = stories([impact(), impact(revision=1, delta_v_mps=4.1, decided_t_ns=T_NS + 600_000_000)])
    record = accident_record(truth(), T_NS + 10_000_000, False, told, [])
    assert record["found"]
    assert record["delay_s"] == pytest.approx(0.09)
    assert record["delta_v_error_mps"] == pytest.approx(-0.1)
    assert record["direction_error_deg"] == pytest.approx(15.0)  # 350 against 5 degrees
    assert record["in_interval"] is True
    figures = accident_figures([record])
    assert figures["recall"]["all"]["share"] == 1.0
    assert figures["delta_v_unclipped"]["outside_10_percent_and_1_kmh"] == 0.0
    assert figures["direction"]["beyond_15_deg"] == 0.0


def test_of_an_accident_of_several_impacts_each_is_judged_by_what_was_told_of_itself():
    true = [
        {"t_s": 10.0 + at, "delta_v_mps": 4.0, "pdof_deg": pdof_deg, "duration_s": 0.1, "peak_mps2": 60.0}
        for at, pdof_deg in ((0.0, 5.0), (1.0, 90.0), (2.0, 180.0))
    ]
    each = tuple(
        FeltImpact(T_NS + round(at * 1e9), 0.1, 4.4, interval, (0.0, 0.0), pdof_deg, 5.0, 60.0, clipped)
        for at, pdof_deg, interval, clipped in ((0.0, 355.0, (3.9, 4.9), False), (1.1, 120.0, (4.1, 4.7), True))
    )
    one = impact(each=each, pdof_deg=355.0, pdof_sd_deg=5.0)
    figures = accident_figures([accident_record(truth(impacts=true), T_NS, False, stories([one]), [])])
    of_each = figures["each_impact"]
    assert (of_each["accidents"], of_each["count"], of_each["told"]["share"]) == (1, 3, pytest.approx(2 / 3))
    assert (of_each["unclipped"]["beyond_15_deg"], of_each["clipped"]["beyond_15_deg"]) == (0.0, 1.0)  # 10 and 30 deg
    assert (of_each["unclipped"]["interval_coverage"], of_each["clipped"]["interval_coverage"]) == (1.0, 0.0)
    assert of_each["clipped"]["relative_error"]["median"] == pytest.approx(0.1)
    assert figures["direction"]["interval_coverage"] == 0.0  # 10 deg off, 1.96 times 5 deg told


def test_an_accident_that_was_retracted_was_not_found():
    told = stories([impact(), impact(revision=1, status=Status.RETRACTED)])
    record = accident_record(truth(), T_NS, False, told, [])
    assert not record["found"]
    assert record["withdrawn"]


def test_what_is_told_long_before_an_accident_is_not_it():
    told = stories([impact(T_NS - 4_000_000_000)])
    record = accident_record(truth(), T_NS, False, told, [])
    assert not record["found"]
    assert record["elsewhere"] == 1
    assert accident_figures([record])["precision"]["share"] == 0.0


def test_recall_is_told_by_the_bands_that_are_asked_for():
    records = [
        accident_record(truth(delta_v), T_NS, False, stories([impact()]) if found else [], [])
        for delta_v, found in ((1.6, False), (2.0, True), (2.3, True), (6.0, False), (9.0, True))
    ]
    recall = {name: (one["count"], one["share"]) for name, one in accident_figures(records)["recall"].items()}
    assert recall["from_8_kmh"] == (3, pytest.approx(2 / 3))
    assert recall["low_speed"] == (4, 0.5)
    assert recall["below_8_kmh"] == (2, 0.5)
    assert recall["severe"] == (1, 1.0)


@pytest.mark.parametrize(("count", "low", "high"), [(0, 0.0, 3.689), (1, 0.0253, 5.572), (10, 4.795, 18.39)])
def test_a_rate_has_its_exact_poisson_interval(count, low, high):
    # Table of Garwood's intervals, for one 100 000 km.
    found = rate(count, 100_000.0)
    assert (found["low"], found["high"]) == (pytest.approx(low, rel=1e-3), pytest.approx(high, rel=1e-3))
    assert rate(count, 50_000.0)["per_100000_km"] == 2 * count


def test_a_share_has_its_exact_binomial_interval():
    found = share([True] * 9 + [False])
    assert (found["low"], found["high"]) == (pytest.approx(0.5550, abs=1e-4), pytest.approx(0.9975, abs=1e-4))
    assert share([])["share"] is None
    assert share([False] * 5)["low"] == 0.0


def test_the_reliability_of_probabilities_is_that_of_what_came_true():
    rng = np.random.default_rng(1)
    said = rng.uniform(0.0, 1.0, 4000)
    records = [{"probabilities": [(float(p), float(p), bool(rng.random() < p))]} for p in said]
    honest = reliability(records)["last"]
    assert honest["brier"] == pytest.approx(1 / 6, abs=0.01)  # mean of p (1 - p)
    for part in honest["bins"]:
        # An honest bin's true share lies in its exact interval but once in twenty; half as much room beside it.
        room = 0.5 * (part["accidents"]["high"] - part["accidents"]["low"])
        assert part["accidents"]["low"] - room <= part["said"] <= part["accidents"]["high"] + room
    boasting = [{"probabilities": [(0.95, 0.95, k % 2 == 0)]} for k in range(100)]
    (part,) = reliability(boasting)["last"]["bins"]
    assert part["accidents"]["share"] == 0.5


def test_a_non_accident_is_named_by_its_likeliest_candidate_or_cried_wolf_over():
    begin, end = T_NS - 500_000_000, T_NS + 500_000_000
    near = [candidate(NoAccident.KERB, probability=0.05), candidate(NoAccident.POTHOLE, probability=0.3)]
    far = candidate(NoAccident.FERRY, T_NS + 60_000_000_000)
    named = quiet_record(NonAccident.POTHOLE, begin, end, [], [*near, far])
    assert (named["named"], named["right"], named["false_alarms"]) == ("pothole", True, 0)
    alarm = quiet_record(NonAccident.KERB, begin, end, stories([impact()]), [])
    silent = quiet_record(NonAccident.KERB, begin, end, [], [])
    back = stories([impact(), impact(revision=1, status=Status.RETRACTED)])
    withdrawn = quiet_record(NonAccident.KERB, begin, end, back, [])
    figures = quiet_figures([named, alarm, silent, withdrawn])
    assert figures["false_alarms"] == 1
    assert figures["withdrawn"] == 1
    assert figures["kinds"]["kerb"]["taken_for"] == {"nothing": 2, "accident": 1}


def test_every_simulated_non_accident_has_a_right_name():
    assert set(NAMES) == set(NonAccident)


def test_the_corpus_is_scored_the_same_in_processes_of_its_own(monkeypatch):
    first = accident_corpus.measure(untold, 2, 1)
    monkeypatch.setattr(processes, "MOST", 1)
    again = accident_corpus.measure(untold, 2, 1)
    assert first == again
    ours = first[OURS]
    assert ours["accidents"] == 26
    assert ours["quiet"]["count"] == len(SOURCES)
    assert ours["recall"]["severe"]["share"] > 0.7  # what any detector must find
    told = tables({"corpus": first, "targets": judged({"corpus": first}, TARGETS)})
    assert "corpus: 26 accidents and 18 non-accidents" in told
    assert "missed from 8 km/h up" in told


def test_what_a_case_holds_is_what_a_detector_is_scored_by():
    case = accident_case("frontal", 3, full_scale_g=100.0, rate_hz=200.0)
    record = accident_record(case.truth, case.t_ns, case.clipped, *listen(OURS, [case.motion]))
    assert record["found"]
    assert abs(record["delta_v_error_mps"]) < 0.15 * case.truth.delta_v_mps + 0.3
    quiet = quiet_case(NonAccident.POTHOLE, 3)
    assert quiet_record(quiet.kind, quiet.begin_ns, quiet.end_ns, *listen(OURS, [quiet.motion]))["kind"] == "pothole"


def test_5000_km_of_non_accidents_are_driven_without_a_false_alarm():
    found = accident_long.measure(untold, 5000.0)
    assert found["km"] >= 5000.0
    assert found["non_accidents"] > 4000
    assert found[OURS]["false_alarms"]["count"] == 0
    # The same drives are no easy ones: the paper's rule errs on them.
    assert found["paper"]["false_alarms"]["count"] > 0
    assert found["non_accidents"] == sum(one["count"] for one in found[OURS]["quiet"]["kinds"].values())
    for name in accident_scoring.DETECTORS:
        assert found[name]["false_alarms"]["count"] == len(found[name]["shown"])
    assert "km in" in tables({"long": found})


def test_seed_1_s_drive_is_told_accident_by_accident():
    found = accident_drives.seed1(untold, (2,), 700.0)
    ours = found[OURS]
    assert ours["drives"][0]["accidents"] == 1
    assert ours["missed"] == len(ours["drives"][0]["missed_at_s"])
    if ours["missed"] == 0:
        assert max(one["max"] or 0.0 for one in ours["place_error_m"].values()) < 25.0
    assert "places off by" in tables({"seed1": found})


def test_the_barrier_test_is_found_at_the_end_of_a_drive():
    data = recording("data", accident_recordings.BARRIER).parent
    found = accident_recordings.barrier(data, "FLLR_XG_93", 100.0, 200.0)
    assert found["found"]
    assert found["false_alarms"] == 0
    assert found["delta_v_kmh"] == pytest.approx(65.4, rel=0.03)
    assert min(found["pdof_deg"], 360.0 - found["pdof_deg"]) < 5.0


@pytest.mark.parametrize("placement", [one for one in accident_recordings.PLACEMENTS if not one.turns])
def test_a_recorded_blow_that_no_gyroscope_felt_is_found_though_it_clips(placement):
    data = recording("data", accident_recordings.BARRIER).parent
    found = accident_recordings.barrier(data, "FLLR_XG_93", 2.0, 100.0, placement)
    assert found["found"]
    assert found["covered"], found


def test_recorded_shocks_and_trips_are_all_given():
    data = recording("data", accident_recordings.SHOCKS).parent
    names = {name for name, _ in accident_recordings.shocks(data)}
    assert len(names) == 500
    assert [name for name, _ in accident_recordings.trips(data)] == ["17", "17", "20", "20"]
    upward = [-motion.f_b[:, 2].mean() for _, motion in accident_recordings.shocks(data)]
    assert np.median(upward) == pytest.approx(9.8, abs=0.5)  # phones, whose scale is off by some percent


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ["--accidents", "--part", "moon"],
            "expected one of seed1, corpus, errors, classes, reliability, long, recordings",
        ),
        (["--accidents", "--km", "0"], "--km 0: expected above 0"),
        (["--accidents", "--part", "recordings", "--recordings", "/nowhere"], "no 'crash_nhtsa_10146"),
        (["--km", "10"], "--km is for --accidents"),
        (["--accidents", "--km", "nan"], "--km nan: expected above 0"),
    ],
)
def test_what_it_cannot_do_is_one_line(arguments, message, capsys):
    status, out, err = call(capsys, "bench", *arguments)
    assert (status, out) == (2, "")
    assert message in err
    assert err.count("\n") == 1


def test_figures_as_json_and_as_tables(monkeypatch, capsys):
    monkeypatch.setattr(processes, "MOST", 1)
    chosen = ["--accidents", "--part", "long", "--km", "20"]
    status, out, _ = call(capsys, "bench", *chosen, "--json")
    found = json.loads(out)
    assert status == 0
    assert list(found) == ["long", "targets"]
    assert math.isfinite(found["long"][OURS]["false_alarms"]["high"])
    status, out, _ = call(capsys, "bench", *chosen)
    assert status == 0
    assert "false alarms in 100 000 km of non-accidents" in out


def test_without_recordings_that_part_is_left_out_unless_asked_for(monkeypatch, tmp_path):
    monkeypatch.setattr(accidents, "PLACE", tmp_path)
    monkeypatch.setattr(accidents, "PARTS", dict.fromkeys(accidents.PARTS, lambda told: {}))
    monkeypatch.setattr(accident_long, "measure", lambda told, km: {})
    monkeypatch.setattr(accidents, "judged", lambda found, targets: [])
    found = accidents.measure([], 10.0, None, None, lambda part, done, total: None)
    assert found["left_out"] == {"recordings": accident_recordings.BARRIER}


def test_a_class_of_vehicle_is_scored_with_its_own_profile(monkeypatch):
    monkeypatch.setattr(processes, "MOST", 1)
    monkeypatch.setattr(accident_classes, "CLASSES", ("motorcycle",))
    monkeypatch.setattr(accident_classes, "CLASSES_BY_VEHICLE", {"motorcycle": ("rear", "lowside")})
    found = accident_classes.measure(untold, 1, 1, 5.0)
    (bike,) = found.values()
    assert bike["accidents"] == 1
    assert bike["falls"]["count"] == 1
    assert bike["km"] >= 5.0
    assert bike["quiet"]["count"] == len(accident_classes.SOURCES_BY_CLASS["motorcycle"])
    assert bike["quiet"]["kinds"]["fall_at_rest"]["taken_for"] == {"fell_over": 1}
    assert "motorcycle" in tables({"classes": found})


def test_the_line_through_what_came_true_is_the_one_that_made_it():
    rng = np.random.default_rng(2)
    limits = JudgementThresholds()
    odds = rng.normal(0.0, 2.0, 20_000)
    true = rng.random(odds.size) < 1.0 / (1.0 + np.exp(-(0.9 * odds - 0.4)))
    said = 1.0 / (1.0 + np.exp(-(limits.told_slope * odds + limits.told_shift)))
    rows = [(float(p), bool(came), 1.0) for p, came in zip(said, true, strict=True)]
    fit = accident_reliability.line(rows)
    assert fit["slope"] == pytest.approx(0.9, abs=4.0 * 0.02)  # four of the spread of 20 000 rows
    assert fit["shift"] == pytest.approx(-0.4, abs=4.0 * 0.02)
    drawn = accident_reliability.diagram(rows)
    assert sum(one["count"] for one in drawn["bins"]) == drawn["count"] == odds.size
    assert drawn["ece"] > 0.05
    honest = accident_reliability.diagram([(p, bool(rng.random() < p), 1.0) for p, _, _ in rows])
    assert honest["ece"] < 0.01  # 20 000 rows


def test_rows_that_stand_for_more_count_for_more():
    (part,) = accident_reliability.diagram([(0.6, True, 3.0), (0.6, False, 1.0)])["bins"]
    assert part["accidents"]["share"] == pytest.approx(0.75)
    assert part["accidents"]["low"] < 0.05  # of 1.6 even rows
    (whole,) = accident_reliability.diagram([(0.6, k < 75, 1.0) for k in range(100)])["bins"]
    exact = share([k < 75 for k in range(100)])
    assert (whole["accidents"]["low"], whole["accidents"]["high"]) == pytest.approx((exact["low"], exact["high"]))


def test_weak_accidents_and_what_is_hard_to_tell_from_them_make_the_diagram(monkeypatch):
    monkeypatch.setattr(processes, "MOST", 1)
    monkeypatch.setattr(accident_reliability, "WEAK_CLASSES", ("rear",))
    monkeypatch.setattr(accident_reliability, "CLASSES", ("frontal",))
    found = accident_reliability.measure(untold, 4, 2, 25.0)
    assert set(found["from"]) == {"weak", "accident", "drive"}
    assert "asks for a slope" in tables({"reliability": found})
