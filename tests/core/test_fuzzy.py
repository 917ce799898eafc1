"""Mamdani's inference: by hand, and what cannot be a system."""

from __future__ import annotations

import copy
import math

import numpy as np
import pytest

from core.errors import InvalidInputError
from core.risk.fuzzy import FuzzySet, system_of

THERMOSTAT = {
    "span": [0.0, 1.0],
    "inputs": {"cold": {"no": [-math.inf, -math.inf, 0.0, 1.0], "yes": [0.0, 1.0, math.inf, math.inf]}},
    "output": {"off": [0.0, 0.0, 0.0, 1.0], "on": [0.0, 1.0, 1.0, 1.0]},
    "rules": [{"when": {"cold": "no"}, "then": "off"}, {"when": {"cold": "yes"}, "then": "on"}],
}


def test_degrees_of_a_trapezoid_and_its_shoulders():
    straight = FuzzySet(0.0, 1.0, 2.0, 4.0)
    x = np.array([-1.0, 0.25, 1.0, 1.5, 3.0, 4.0, np.nan])
    assert straight.degree(x) == pytest.approx([0.0, 0.25, 1.0, 1.0, 0.5, 0.0, np.nan], nan_ok=True)
    shoulder = FuzzySet(1.0, 2.0, math.inf, math.inf)
    assert shoulder.degree(np.array([0.0, 1.5, 1e9])) == pytest.approx([0.0, 0.5, 1.0])
    wall = FuzzySet(1.0, 1.0, 2.0, 2.0)
    assert wall.degree(np.array([0.999, 1.0, 2.0, 2.001])).tolist() == [0.0, 1.0, 1.0, 0.0]


def test_rounded_flanks_have_no_kink():
    rounded = FuzzySet(0.0, 1.0, 2.0, 4.0, rounded=True)
    x = np.array([0.25, 0.5, 0.75, 3.0, 3.5])
    assert rounded.degree(x) == pytest.approx([0.125, 0.5, 0.875, 0.5, 0.125])
    tiny = 1e-4
    assert rounded.degree(np.array([tiny]))[0] == pytest.approx(2.0 * tiny**2)
    assert 1.0 - rounded.degree(np.array([1.0 - tiny]))[0] == pytest.approx(2.0 * tiny**2)


def test_centroids_by_hand():
    """One triangle alone has its centroid at a third. Both cut at a half: symmetric about the middle."""
    system = system_of("thermostat", THERMOSTAT)
    # 201 points give a triangle that ends on points exactly.
    assert system.infer(cold=np.array([-5.0, 0.5, 7.0])) == pytest.approx([1 / 3, 0.5, 2 / 3], abs=1e-12)
    assert np.isnan(system.infer(cold=np.array([np.nan]))).all()


def test_where_no_rule_applies_there_is_no_answer():
    table = copy.deepcopy(THERMOSTAT)
    table["inputs"]["cold"]["yes"] = [2.0, 3.0, math.inf, math.inf]
    assert np.isnan(system_of("gap", table).infer(cold=np.array([1.5]))).all()


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (
            lambda t: t["rules"].append({"when": {"cold": "no"}, "then": "boil"}),
            "a rule concludes 'boil'; expected off, on",
        ),
        (lambda t: t["rules"].append({"when": {"wet": "no"}, "then": "on"}), "a rule asks 'wet'; expected cold"),
        (lambda t: t["rules"].append({"when": {"cold": "so"}, "then": "on"}), "asks cold for 'so'; expected no, yes"),
        (lambda t: t["rules"].append({"when": {"cold": "no"}}), "'then' is missing"),
        (lambda t: t["rules"].clear(), "expected rules"),
        (lambda t: t.pop("span"), "'span' is missing"),
        (lambda t: t.update(span=[1.0, 1.0]), "over a range that is not empty"),
        (lambda t: t["output"].update(off=[1.0, 0.0, 2.0, 3.0]), "four numbers that do not fall"),
        (lambda t: t["output"].update(off=[1.0, 0.0]), "expected 4 numbers"),
        (lambda t: t.update(inputs=3), "is no fuzzy system"),
    ],
)
def test_what_is_no_system_is_refused(change, complaint):
    table = copy.deepcopy(THERMOSTAT)
    change(table)
    with pytest.raises(InvalidInputError, match=complaint):
        system_of("thermostat", table)


def test_other_inputs_than_its_own_are_refused():
    with pytest.raises(InvalidInputError, match="given heat; expected cold"):
        system_of("thermostat", THERMOSTAT).infer(heat=np.zeros(1))
