"""Every rule of combination against its definition in exact rationals, and the figures of the papers."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from core.errors import InvalidInputError
from core.risk.belief import mass_of, named, vacuous
from core.risk.combination import RULES, combine
from tests import belief_definitions as definitions

AGREES = 1e-12
"""Asked for; a sum of some hundred products of floats keeps some 1e-15."""

EXAMPLE_PCR6_PLUS = [
    {"LR": 0.6, "MR": 0.1, "LR|MR|HR": 0.3},
    {"LR": 0.5, "MR": 0.3, "LR|MR|HR": 0.2},
    {"LR": 0.4, "MR": 0.1, "LR|MR|HR": 0.5},
]


def masses(n, k, focal, seed, empty=False):
    """Random sources with that many focal elements each; the empty set among them if asked for."""
    rng = np.random.default_rng(seed)
    out = np.zeros((n, k, 8))
    for source in out.reshape(-1, 8):
        chosen = rng.choice(np.arange(0 if empty else 1, 8), focal, replace=False)
        source[chosen] = rng.dirichlet(np.ones(focal))
    return out


def fused(sources, rule="pcr6"):
    return combine(np.array([mass_of(source) for source in sources]), rule)


def assert_agrees(batch, rule):
    found, conflict = combine(batch, rule)
    for row, k, sources in zip(found, conflict, batch, strict=True):
        exact = [definitions.exact(source) for source in sources]
        expected = definitions.RULES[rule](exact)
        assert k == pytest.approx(float(definitions.conflict(exact)), abs=AGREES)
        if expected is None:
            assert np.isnan(row).all()
        else:
            assert row == pytest.approx(definitions.listed(expected), abs=AGREES)


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("shape", [(20, 1, 4), (20, 2, 7), (20, 3, 3), (10, 3, 7), (10, 4, 3), (5, 5, 3), (3, 6, 2)])
def test_rule_is_its_definition(rule, shape):
    assert_agrees(masses(*shape, seed=sum(shape)), rule)


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("shape", [(10, 1, 3), (20, 2, 8), (10, 3, 4), (5, 4, 3)])
def test_rule_is_its_definition_with_mass_on_the_empty_set(rule, shape):
    assert_agrees(masses(*shape, seed=sum(shape), empty=True), rule)


@pytest.mark.parametrize("rule", RULES)
def test_certain_and_contradicting_sources(rule):
    certain = [mass_of({name: 1.0}) for name in ("LR", "MR", "HR", "LR|MR", "MR|HR", "LR|HR", "LR|MR|HR", "")]
    assert_agrees(np.array([[a, b, c] for a in certain for b in certain for c in certain]), rule)


def test_every_rule_has_a_definition():
    assert set(definitions.RULES) == set(RULES)


def test_scenario_1_of_the_paper_to_its_digits():
    """Man of 32, 16 h, a Monday in May, Ville-Marie, in a tunnel. The paper prints .5 for MR|HR of the environment,
    with which its masses would sum to 1.25."""
    environment, _ = fused([{"MR": 1.0}, {"HR": 1.0}, {"HR": 1.0}, {"MR|HR": 1.0}])
    assert environment == pytest.approx(mass_of({"MR": 0.25, "HR": 0.5, "MR|HR": 0.25}), abs=AGREES)
    driver = mass_of({"MR": 0.3, "LR|MR": 0.7})
    whole, _ = combine(np.array([driver, environment, vacuous()]))
    told = {name: round(mass, 4) for name, mass in named(whole).items() if mass}
    assert told == {"MR": 0.5250, "HR": 0.1212, "LR|MR": 0.1114, "LR|MR|HR": 0.2424}


def test_n_ary_pcr6_is_not_pairwise():
    sources = np.array([mass_of({"LR": 1.0}), mass_of({"MR": 1.0}), mass_of({"MR": 1.0})])
    pairwise, _ = combine(np.array([combine(sources[:2])[0], sources[2]]))
    assert combine(sources)[0][[1, 2]] == pytest.approx([1 / 3, 2 / 3])
    assert pairwise[[1, 2]] == pytest.approx([1 / 6, 5 / 6])


def test_pcr6_plus_gives_the_figures_of_its_paper():
    """Dezert, Dezert & Smarandache 2021, example 2, printed to six digits; {A, B} taken for LR and MR."""
    printed = {"pcr6": (0.743496, 0.162245, 0.094259), "pcr6+": (0.788847, 0.181153, 0.03)}
    for rule, figures in printed.items():
        whole, _ = fused(EXAMPLE_PCR6_PLUS, rule)
        assert whole[[1, 2, 7]] == pytest.approx(figures, abs=5e-7)


def test_pcr5_gives_the_figures_of_its_paper():
    """Smarandache & Dezert 2004, example 12.1: {A .6 B .3 C .1} with {A .4 B .4 C .2}."""
    whole, _ = fused([{"LR": 0.6, "MR": 0.3, "HR": 0.1}, {"LR": 0.4, "MR": 0.4, "HR": 0.2}], "pcr5")
    assert whole[[1, 2, 4]] == pytest.approx([0.574571, 0.335429, 0.09], abs=1e-6)


def test_dempster_is_undefined_under_total_conflict_alone():
    tiny = 1e-200
    nothing, k = fused([{"LR": 1.0}, {"HR": 1.0}], "dempster")
    assert np.isnan(nothing).all()
    assert k == 1.0
    almost, _ = combine(np.array([mass_of({"LR": 1.0}), [0, tiny, 0, 0, 1.0, 0, 0, 0]]), "dempster")
    assert almost == pytest.approx(mass_of({"LR": 1.0}))


def test_an_instant_is_fused_alike_alone_and_among_others():
    batch = masses(50, 3, 4, seed=7)
    for rule in RULES:
        whole = combine(batch, rule)[0]
        alone = np.array([combine(one, rule)[0] for one in batch])
        assert (whole == alone).all()


@pytest.mark.parametrize(
    ("sources", "rule", "complaint"),
    [
        (np.zeros((0, 8)), "pcr6", "expected .* 1 source or more"),
        (np.zeros((2, 7)), "pcr6", "shape"),
        (vacuous(2), "pcr7", "unknown rule 'pcr7': expected one of pcr6, pcr6"),
        (np.full((10, 8), 0.125), "pcr6", "combine fewer sources"),
    ],
)
def test_what_cannot_be_combined_is_refused(sources, rule, complaint):
    with pytest.raises(InvalidInputError, match=complaint):
        combine(sources, rule)


def test_many_sources_are_no_matter_where_products_need_not_be_gone_through():
    whole, conflict = combine(np.full((40, 8), 0.125), "smets")
    assert whole.sum() == pytest.approx(1.0)
    assert conflict == pytest.approx(whole[0])


numbers = st.lists(st.floats(0.0, 1.0), min_size=8, max_size=8).filter(lambda values: sum(values[1:]) > 1e-3)
a_mass = numbers.map(lambda values: np.array([0.0, *values[1:]]) / sum(values[1:]))
some = st.lists(a_mass, min_size=1, max_size=4).map(np.array)


@settings(max_examples=60, deadline=None)
@given(sources=some, rule=st.sampled_from(RULES))
def test_masses_stay_masses(sources, rule):
    whole, conflict = combine(sources, rule)
    if not np.isnan(whole).any():
        assert whole.sum() == pytest.approx(1.0, abs=1e-9)
        assert (whole >= 0.0).all()
    assert -1e-12 <= conflict <= 1.0 + 1e-9
    if rule not in ("smets",):
        assert np.isnan(whole).any() or whole[0] == 0.0


@settings(max_examples=60, deadline=None)
@given(sources=some, rule=st.sampled_from(RULES), seed=st.integers(0, 1000))
def test_the_order_of_sources_is_no_matter(sources, rule, seed):
    order = np.random.default_rng(seed).permutation(len(sources))
    one, other = combine(sources, rule)[0], combine(sources[order], rule)[0]
    assert one == pytest.approx(other, abs=1e-12, nan_ok=True)


@settings(max_examples=60, deadline=None)
@given(sources=some, rule=st.sampled_from(("pcr6+", "dempster", "smets", "yager")))
def test_a_vacuous_source_changes_nothing(sources, rule):
    """Not so in pcr6 and pcr5 of three sources or more, where Theta takes its share of conflicts."""
    more = np.vstack([sources, vacuous(1)])
    assert combine(more, rule)[0] == pytest.approx(combine(sources, rule)[0], abs=1e-12, nan_ok=True)


@settings(max_examples=40, deadline=None)
@given(pair=st.lists(a_mass, min_size=2, max_size=2).map(np.array))
def test_pcr5_and_pcr6_are_one_rule_for_two_sources(pair):
    assert combine(pair, "pcr5")[0] == pytest.approx(combine(pair, "pcr6")[0], abs=1e-12)
