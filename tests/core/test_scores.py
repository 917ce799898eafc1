"""Scores: they sum to the bit, follow what is driven, are the surer the more there is, and say what is missing."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from core.driving.exposure import Driven, Exposure, Facet
from core.driving.speeding import speeding
from core.errors import InvalidInputError
from core.scoring.explaining import explain
from core.scoring.phyd import phyd
from core.scoring.places import Places, places_from, places_of
from core.scoring.products import score, scores
from core.scoring.record import BeliefSums, Evidence, Record, SpeedingSums
from core.scoring.score import Product, Score
from service.scoring.loading import shipped_model

MODEL = shipped_model()
KM = 1_000_000
"""In millimetres."""


def driven(km: float, hours: dict[str, float] | None = None, roads: dict[str, float] | None = None, **more) -> Record:
    """A record of some km, by shares of hours and roads: at noon on primary roads where nothing is said."""
    by = {
        facet: {label: Driven(round(share * km * KM), 0) for label, share in shares.items()}
        for facet, shares in ((Facet.HOUR, hours or {"12": 1.0}), (Facet.ROAD_CLASS, roads or {"primary": 1.0}))
    }
    time_ms = round(km / 40.0 * 3.6e6)
    limits = SpeedingSums(known_ms=time_ms, certain_ms=time_ms)
    return Record(
        **{"trips": 1, "exposure": Exposure(Driven(round(km * KM), time_ms), by), "speeding": limits} | more  # type: ignore[arg-type]
    )


def usual(km: float) -> Record:
    """As the portfolio's mean driver: every rate and share is the model's own."""
    hours = MODEL.hour.share
    roads = MODEL.road_class.share
    record = driven(km, dict(hours), dict(roads))
    time_ms = record.exposure.total.time_ms
    over_ms = round(time_ms * MODEL.speeding_share)
    excess_mm = round(over_ms * MODEL.speeding.portfolio / MODEL.speeding_share / 3.6)
    risk = round(1e9 * MODEL.vehicle.portfolio)
    return replace(
        record,
        manoeuvres={kind: round(km * one.portfolio / 100.0) for kind, one in MODEL.manoeuvres.items()},
        speeding=SpeedingSums(time_ms, 0, over_ms, time_ms, over_ms, excess_mm),
        belief={"vehicle": BeliefSums(1, (0, 10**9 - risk, 0, 0, risk, 0, 0, 0))},
    )


MM = st.integers(0, 10**11)
COUNTS = st.integers(0, 500)


@st.composite
def records(draw) -> Record:
    by = {}
    total_mm = draw(MM)
    for facet, labels in (
        (Facet.HOUR, [f"{hour:02d}" for hour in range(24)]),
        (Facet.ROAD_CLASS, ["motorway", "residential", "track", "", "unknown"]),
        (Facet.DISTRICT, ["somewhere", ""]),
    ):
        label, other = draw(st.sampled_from(labels)), draw(st.sampled_from(labels))
        part = draw(st.integers(0, total_mm))
        by[facet] = {label: Driven(total_mm - part, 0)}
        by[facet][other] = by[facet].get(other, Driven()).plus(Driven(part, 0))
    known, unknown = draw(MM), draw(MM)
    over = draw(st.integers(0, known))
    certain = draw(st.integers(0, known))
    masses = draw(st.tuples(*[st.integers(0, 10**9)] * 8))
    return Record(
        trips=draw(COUNTS),
        exposure=Exposure(Driven(total_mm, known + unknown), by),
        cells={"a": Driven(total_mm // 2, 0), "b": Driven(total_mm - total_mm // 2, 0)},
        manoeuvres={kind: draw(COUNTS) for kind in draw(st.sets(st.sampled_from(sorted(MODEL.manoeuvres))))},
        speeding=SpeedingSums(known, unknown, over, certain, min(over, certain), draw(MM) if over else 0),
        belief={"vehicle": BeliefSums(draw(st.integers(1, 9)), masses)},
    )


PLACES = places_from({"a": Driven(9 * KM, 0), "b": Driven(KM, 0)}, {"a": 5, "b": 9})


@given(records(), st.floats(0.01, 3000.0))
def test_contributions_sum_to_the_score_exactly_and_intervals_hold_it(record: Record, days: float) -> None:
    for one in scores(record, days, MODEL, PLACES).values():
        if one.score is None:
            assert one.reason
            assert not one.contributions
            continue
        assert math.fsum(part.points for part in one.contributions) == one.score
        assert sum(part.points for part in reversed(one.contributions)) == one.score
        assert 0.0 <= one.interval95[0] <= one.score <= one.interval95[1] <= 100.0
        assert one.relativity_interval95[0] <= one.relativity <= one.relativity_interval95[1]
        # As many roundings as there are contributions, and one of each logarithm.
        assert math.prod(part.relativity for part in one.contributions) == pytest.approx(one.relativity, rel=1e-12)
        assert 0.0 <= one.credibility <= 1.0
        assert all(0.0 <= share <= 1.0 + 1e-12 for share in one.coverage.values())
        json.dumps(one.to_json(), allow_nan=False)
        assert len(explain(one)) == len(one.contributions)


def test_points_follow_the_relativity_but_for_their_grain() -> None:
    one = score("phyd", driven(500.0, manoeuvres={"braking": 9}), 30.0, MODEL)
    exact = MODEL.scale.base + MODEL.scale.points(math.log(one.relativity))
    # Each contribution is rounded by half a grain of 2^-16 at most.
    assert abs(one.score - exact) <= len(one.contributions) * 2.0**-17


def test_equal_records_score_equal_to_the_bit_however_they_were_added() -> None:
    parts = [driven(11.0 * k + 3.0, manoeuvres={"braking": k}, days=1) for k in range(1, 20)]
    forward, backward = parts[0], parts[-1]
    for part in parts[1:]:
        forward = forward + part
    for part in reversed(parts[:-1]):
        backward = backward + part
    again = Record.from_json(json.loads(json.dumps(backward.to_json())))
    assert (
        scores(forward, 30.0, MODEL, PLACES)
        == scores(backward, 30.0, MODEL, PLACES)
        == scores(again, 30.0, MODEL, PLACES)
    )


@pytest.mark.parametrize("product", list(Product))
def test_who_drives_as_the_portfolio_has_the_base(product: Product) -> None:
    one = score(product, usual(MODEL.mileage.annual_km), 365.25, MODEL)
    # Whole milliseconds and manoeuvres are all that keeps it from exactly 70.
    assert one.score == pytest.approx(MODEL.scale.base, abs=0.02)
    assert one.relativity == pytest.approx(1.0, abs=1e-3)


def test_more_is_more() -> None:
    near = score("payd", driven(500.0), 30.0, MODEL)
    far = score("payd", driven(5000.0), 30.0, MODEL)
    assert near.relativity < far.relativity
    assert far.score < near.score
    night = score("payd", driven(500.0, {"12": 0.5, "02": 0.5}), 30.0, MODEL)
    assert night.relativity > near.relativity
    assert {one.name: one.points for one in night.contributions}["night"] < 0.0
    calm, harsh = (score("phyd", driven(1000.0, manoeuvres={"braking": n}), 30.0, MODEL) for n in (0, 40))
    assert calm.score > harsh.score
    motorway, lane = (
        score("pwyd", driven(1000.0, None, {road: 1.0}), 30.0, MODEL) for road in ("motorway", "residential")
    )
    assert motorway.score > lane.score


def test_intervals_narrow_and_credibility_grows_with_distance() -> None:
    for product in ("payd", "phyd", "pwyd"):
        wide, narrow = (score(product, usual(km), km / 33.0, MODEL) for km in (100.0, 10_000.0))
        assert _width(narrow) < 0.5 * _width(wide)
        assert narrow.credibility > wide.credibility


def test_one_quiet_kilometre_is_no_proof_of_a_calm_driver() -> None:
    little, much = (score("phyd", driven(km), 30.0, MODEL) for km in (1.0, 10_000.0))
    assert abs(little.score - MODEL.scale.base) < 0.5
    assert much.score > MODEL.scale.base + 5.0


def test_without_limits_speeding_counts_nothing_and_the_interval_is_wider() -> None:
    known = driven(2000.0)
    unknown = replace(known, speeding=SpeedingSums(unknown_ms=known.speeding.known_ms))
    with_limits, without = phyd(known, 60.0, MODEL), phyd(unknown, 60.0, MODEL)
    assert (with_limits.coverage["limits"], without.coverage["limits"]) == (1.0, 0.0)
    of = {one.name: one for one in without.contributions}
    assert of["speeding_share"].points == of["speeding_excess"].points == 0.0
    assert of["speeding_share"].value is None
    assert _width(without) > _width(with_limits)
    assert without.credibility < with_limits.credibility


@pytest.mark.parametrize("limit_kmh", [0.0, 999.0])
def test_a_limit_of_0_or_999_is_none(limit_kmh: float) -> None:
    t_ns = np.arange(100, dtype=np.int64) * 1_000_000_000
    judged = speeding(t_ns, np.full(100, 30.0), np.full(100, limit_kmh / 3.6), np.ones(100))
    sums = SpeedingSums(round(1e3 * judged.known_s), round(1e3 * judged.unknown_s), over_ms=round(1e3 * judged.over_s))
    one = phyd(replace(driven(3.0), speeding=sums), 1.0, MODEL)
    assert one.coverage["limits"] == 0.0
    assert {part.name: part.points for part in one.contributions}["speeding_share"] == 0.0


def test_theta_is_no_risk() -> None:
    belief = BeliefSums(1, (0, 5 * 10**8, 0, 0, 0, 0, 0, 5 * 10**8))
    one = phyd(replace(driven(100.0), belief={"vehicle": belief}), 10.0, MODEL)
    assert one.coverage["vehicle"] == 0.5
    assert {part.name: part.value for part in one.contributions}["vehicle"] == 0.0


def test_what_is_excused_and_the_vehicles_own_accidents_count_nothing() -> None:
    plain = driven(1000.0, manoeuvres={"braking": 3})
    more = replace(plain, excused={"braking": 50}, accidents={"severe": 2})
    assert scores(plain, 30.0, MODEL) == scores(more, 30.0, MODEL)


def test_an_unknown_road_counts_as_the_mean_and_lowers_coverage() -> None:
    known = score("pwyd", driven(1000.0, None, {"residential": 1.0}), 30.0, MODEL)
    half = score("pwyd", driven(1000.0, None, {"residential": 0.5, "": 0.5}), 30.0, MODEL)
    assert 1.0 < half.relativity < known.relativity
    assert half.coverage["road_class"] == 0.5
    assert _width(half) > _width(known)
    unknown = driven(1000.0, None, {"": 1.0})
    nothing = score("pwyd", unknown, 30.0, MODEL)
    assert (nothing.score, nothing.relativity, nothing.credibility) == (MODEL.scale.base, 1.0, 0.0)
    assert set(nothing.coverage.values()) == {0.0}
    assert _width(nothing) > _width(half)
    elsewhere = replace(unknown, cells={"zz": Driven(1000 * KM, 0)})
    assert score("pwyd", elsewhere, 30.0, MODEL, PLACES).score == MODEL.scale.base


@pytest.mark.parametrize(
    ("record", "reason"), [(Record(), "nothing was driven"), (driven(0.0), "no distance in 1 trips")]
)
def test_with_nothing_driven_there_is_no_score_but_a_reason(record: Record, reason: str) -> None:
    for one in scores(record, 30.0, MODEL).values():
        assert (one.score, one.relativity, one.interval95, one.reason) == (None, None, None, reason)
        assert reason in explain(one)[0].sentence


@pytest.mark.parametrize("days", [0.0, -1.0, math.nan, math.inf, 1e9])
def test_a_period_that_is_none_is_refused(days: float) -> None:
    with pytest.raises(InvalidInputError, match="a period of"):
        score("payd", driven(10.0), days, MODEL)


def test_a_record_of_more_days_than_the_period_and_an_unknown_product_are_refused() -> None:
    with pytest.raises(InvalidInputError, match="driven on 40 days of a period of 30"):
        score("payd", driven(10.0, days=40), 30.0, MODEL)
    with pytest.raises(InvalidInputError, match="no product 'pay': expected one of payd, phyd, pwyd"):
        score("pay", driven(10.0), 30.0, MODEL)


def test_a_driver_reads_what_costs_and_why() -> None:
    evidence = (Evidence(61, "manoeuvre", "m1"),)
    record = driven(840.0, manoeuvres={"braking": 12}, evidence={"braking": evidence})
    one = score("phyd", record, 30.0, MODEL)
    braking = next(part for part in one.contributions if part.name == "braking")
    assert (braking.count, braking.evidence) == (12, evidence)
    said = dict(explain(one))
    assert said["braking"].startswith("12 harsh brakings in 840 km: 1.4 per 100 km, others 0.6")
    assert said["braking"].endswith(f"this costs {-braking.points:.1f} points.")
    costs = [abs(part.points) for name in list(said)[1:] for part in one.contributions if part.name == name]
    assert costs == sorted(costs, reverse=True)


def test_of_what_is_not_known_the_driver_reads_that() -> None:
    record = replace(driven(500.0, None, {"": 1.0}), cells={"a": Driven(500 * KM, 0)}, speeding=SpeedingSums())
    where = [sentence for _, sentence in explain(score("pwyd", record, 30.0, MODEL, PLACES))]
    assert "Nothing is known of roads; this changes nothing." in where
    assert any(sentence.startswith("100 % of the distance in area a; this") for sentence in where)
    how = dict(explain(score("phyd", record, 30.0, MODEL)))
    assert how["speeding_share"].startswith("No limit was known")
    assert how["vehicle"] == "Nothing is known of driving near the limits; this changes nothing."


@pytest.mark.parametrize("mm", [1, 10**12, 2**63 - 1])
@pytest.mark.parametrize("days", [1e-3, 36_600.0])
@pytest.mark.parametrize("many", [0, 10**6, 2**63 - 1])
def test_absurd_numbers_stay_numbers(mm: int, days: float, many: int) -> None:
    most = 2**63 - 1
    record = Record(
        trips=1,
        exposure=Exposure(
            Driven(mm, most), {Facet.HOUR: {"03": Driven(mm, 0)}, Facet.ROAD_CLASS: {"track": Driven(mm, 0)}}
        ),
        manoeuvres={"braking": many},
        speeding=SpeedingSums(most, 0, many, most, many, most if many else 0),
        belief={"vehicle": BeliefSums(1, (0, 0, 0, 0, most, 0, 0, many))},
    )
    for one in scores(record, days, MODEL).values():
        figures = (one.score, *one.interval95, one.relativity, *one.relativity_interval95, one.credibility)
        assert all(math.isfinite(figure) for figure in figures)


def test_places_are_believed_as_far_as_they_were_driven_in() -> None:
    generator = np.random.default_rng(1)
    true = generator.gamma(2.0, 0.5, 3000)
    km = generator.gamma(1.0, 20_000.0, 3000)
    counts = generator.poisson(km * 1e-4 * true)
    names = [f"c{i}" for i in range(3000)]
    places = places_from(
        {name: Driven(round(one * KM), 0) for name, one in zip(names, km.tolist(), strict=True)},
        dict(zip(names, counts.tolist(), strict=True)),
    )
    # Gamma of shape 2 was drawn; by moments of 3000 cells its sd is some 10 %.
    assert places.shape == pytest.approx(2.0, rel=0.3)
    found = np.array([places.relativity[name] for name in names])
    raw = counts / (km * counts.sum() / km.sum())
    scale = true / (true @ km / km.sum())
    assert np.mean((found - scale) ** 2) < 0.5 * np.mean((raw - scale) ** 2)
    inside = np.abs(found - scale) <= 2.0 * np.array([places.sd[name] for name in names])
    assert inside.mean() > 0.9
    assert places_of(json.loads(json.dumps(places.to_json()))) == places


def test_without_accidents_all_places_are_alike_and_odd_ones_are_refused() -> None:
    cells = {"a": Driven(KM, 0), "b": Driven(2 * KM, 0)}
    assert set(places_from(cells, {}).relativity.values()) == {1.0}
    assert places_from({}, {}).relativity == {}
    with pytest.raises(InvalidInputError, match="1 accidents in cell 'x', where nothing was driven"):
        places_from(cells, {"x": 1})
    with pytest.raises(InvalidInputError, match="cell 'a' has -1"):
        places_from(cells, {"a": -1})
    with pytest.raises(InvalidInputError, match="cell 'a' is"):
        places_of({"shape": 1.0, "cells": {"a": [0.0, 1.0]}})


def test_a_place_counts_once() -> None:
    document_labels = {"bad": 2.0}
    model = replace(MODEL, district=replace(MODEL.district, relativity=document_labels, groups={"bad": "bad"}))
    record = driven(1000.0, None, {"": 1.0})
    record.exposure.by[Facet.DISTRICT] = {"bad": Driven(1000 * KM, 0)}  # type: ignore[index]
    record = replace(record, cells={"a": Driven(1000 * KM, 0)})
    places = Places(1.0, {"a": 1.0}, {"a": 0.0}, "")
    assert score("pwyd", record, 30.0, model).relativity > 1.4
    assert score("pwyd", record, 30.0, model, places).relativity == pytest.approx(1.0)


def _width(one: Score) -> float:
    return one.interval95[1] - one.interval95[0]
