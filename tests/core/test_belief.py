"""What a mass says: belief, plausibility, pignistic probability, decisions, discounting and attribution."""

from __future__ import annotations

import math
from itertools import permutations

import numpy as np
import pytest

from core.errors import InvalidInputError
from core.risk import attribution, belief, discounting
from core.risk.belief import PROPOSITIONS, SINGLETONS, decide, mass_of, named, pignistic, vacuous
from core.risk.combination import combine

MASS = {"LR": 0.1, "MR": 0.3, "LR|MR": 0.2, "MR|HR": 0.25, "LR|MR|HR": 0.15}


def test_propositions_are_named_in_the_order_lr_mr_hr():
    assert PROPOSITIONS == ("", "LR", "MR", "LR|MR", "HR", "LR|HR", "MR|HR", "LR|MR|HR")
    assert named(mass_of(MASS)) == dict.fromkeys(PROPOSITIONS, 0.0) | MASS


@pytest.mark.parametrize(
    ("masses", "complaint"),
    [
        ({"XX": 1.0}, "unknown proposition 'XX'"),
        ({"MR|LR": 1.0}, r"unknown proposition 'MR\|LR'"),
        ({"LR": -0.1, "MR": 1.1}, "mass of 'LR' is -0.1: expected a number from 0 to 1"),
        ({"LR": 0.5}, "masses sum to 0.5: expected 1"),
        ({"LR": math.nan}, "is nan"),
        ({"LR": "1"}, "expected a number"),
        ({"LR": True}, "expected a number"),
        ({"LR": 10**400}, "expected a number"),
        ({}, "masses sum to 0: expected 1"),
    ],
)
def test_what_is_no_mass_is_refused_with_its_reason(masses, complaint):
    with pytest.raises(InvalidInputError, match=complaint):
        mass_of(masses)


def test_belief_plausibility_and_pignistic_by_hand():
    mass = mass_of(MASS)
    bel, pl = named(belief.belief(mass)), named(belief.plausibility(mass))
    assert bel["LR|MR"] == pytest.approx(0.6, abs=1e-15)
    assert pl["LR|MR"] == pytest.approx(1.0, abs=1e-15)
    assert (bel["HR"], pl["HR"]) == pytest.approx((0.0, 0.4), abs=1e-15)
    assert (bel[""], pl[""]) == (0.0, 0.0)
    assert pignistic(mass) == pytest.approx([0.1 + 0.1 + 0.05, 0.3 + 0.1 + 0.125 + 0.05, 0.125 + 0.05], abs=1e-15)


def test_conflict_is_no_belief_and_is_divided_away_from_the_pignistic():
    mass = mass_of({"": 0.5, "LR": 0.2, "MR|HR": 0.3})
    assert named(belief.belief(mass))["LR|MR|HR"] == pytest.approx(0.5)
    assert pignistic(mass) == pytest.approx([0.4, 0.3, 0.3])
    assert np.isnan(pignistic(mass_of({"": 1.0}))).all()


def test_a_decision_abstains_where_intervals_overlap():
    clear, doubtful = mass_of({"HR": 0.6, "MR|HR": 0.1, "MR": 0.3}), mass_of({"HR": 0.4, "LR|MR|HR": 0.6})
    both = np.array([clear, doubtful])
    for by in ("belief", "plausibility", "pignistic"):
        assert decide(clear, by) == SINGLETONS.index("HR")
        assert decide(both, by).tolist() == [2, belief.ABSTAINED]
    assert decide(doubtful, "pignistic", abstain=False) == 2
    assert decide(vacuous(), abstain=False) == belief.ABSTAINED
    with pytest.raises(InvalidInputError, match="decision by 'luck'"):
        decide(clear, "luck")


def test_rules_may_decide_otherwise():
    mass = mass_of({"LR": 0.35, "MR": 0.3, "MR|HR": 0.35})
    chosen = [SINGLETONS[int(decide(mass, by, abstain=False))] for by in ("belief", "plausibility", "pignistic")]
    assert chosen == ["LR", "MR", "MR"]


def test_discounting_of_the_vehicle_as_worked_out_in_the_sources():
    """Vehicle {HR .8, MR|HR .2} in scenario 1 at five rates; figures of the project's sources, to their digits."""
    driver = mass_of({"MR": 0.3, "LR|MR": 0.7})
    environment = mass_of({"MR": 0.25, "HR": 0.5, "MR|HR": 0.25})
    vehicle = mass_of({"HR": 0.8, "MR|HR": 0.2})
    high, theta = [], []
    for alpha in (0.0, 0.25, 0.5, 0.75, 1.0):
        fused, _ = combine(np.array([driver, environment, discounting.discount(vehicle, alpha)]))
        high.append(round(float(pignistic(fused)[2]), 3))
        theta.append(round(float(fused[7]), 3))
    assert high == [0.542, 0.433, 0.332, 0.250, 0.202]
    assert theta == [0.0, 0.024, 0.080, 0.155, 0.242]


def test_contextual_discounting_is_a_disjunction_with_each_context():
    mass, rates = mass_of(MASS), (0.4, 0.1, 0.25)
    sources = [mass] + [mass_of({"": 1.0 - a, name: a}) for name, a in zip(SINGLETONS, rates, strict=True)]
    expected, _ = combine(np.array(sources), "disjunctive")
    assert discounting.discount_contextual(mass, rates) == pytest.approx(expected, abs=1e-15)
    assert discounting.discount_contextual(mass, (0.0, 0.0, 0.0)) == pytest.approx(mass, abs=0.0)
    assert named(discounting.discount_contextual(mass, (1.0, 1.0, 1.0)))["LR|MR|HR"] == pytest.approx(1.0)


def test_a_discount_rate_is_a_probability():
    with pytest.raises(InvalidInputError, match="outside 0 to 1"):
        discounting.discount(vacuous(), 1.1)
    with pytest.raises(InvalidInputError, match="outside 0 to 1"):
        discounting.discount(vacuous(), math.nan)


def test_chance_of_an_error_beyond_half_a_class():
    assert discounting.chance_of_exceeding(1.0, 1.0) == pytest.approx(0.3173105, abs=1e-7)
    assert discounting.chance_of_exceeding([1.0, 1.0, 1.0], [0.0, math.nan, 1e9]).tolist() == pytest.approx([0, 1, 1])


def test_what_is_old_fades_by_half_lives():
    assert discounting.aged([0.0, 10.0, 20.0, -1.0], 10.0) == pytest.approx([0.0, 0.5, 0.75, 0.0])


def test_shapley_values_are_the_mean_over_all_orders():
    masses = np.array([mass_of(MASS), mass_of({"HR": 0.7, "MR|HR": 0.3}), mass_of({"LR": 0.5, "LR|MR|HR": 0.5})])
    found = attribution.attribute(masses)
    mean = np.zeros((3, 3))
    for order in permutations(range(3)):
        before = np.full(3, 1 / 3)
        for place, player in enumerate(order):
            now = pignistic(combine(masses[sorted(order[: place + 1])])[0])
            mean[player] += (now - before) / 6
            before = now
    assert found == pytest.approx(mean, abs=1e-14)
    assert found.sum(axis=0) == pytest.approx(pignistic(combine(masses)[0]) - 1 / 3, abs=1e-14)


def test_a_vacuous_source_has_no_part_in_pcr6_plus():
    masses = np.array([[mass_of(MASS), mass_of({"HR": 1.0}), vacuous()]] * 2)
    found = attribution.attribute(masses, "pcr6+")
    assert found.shape == (3, 2, 3)
    assert found[2] == pytest.approx(np.zeros((2, 3)), abs=1e-15)


def test_too_many_sources_for_exact_attribution_are_refused():
    with pytest.raises(InvalidInputError, match="13 sources: expected at most 12"):
        attribution.attribute(vacuous(13))
