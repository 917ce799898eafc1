"""Records add up to the same whatever is added first, and come back from JSON as they were."""

from __future__ import annotations

import json
from itertools import permutations

from hypothesis import given
from hypothesis import strategies as st

from core.driving.exposure import Driven, Exposure, Facet
from core.scoring.record import MOST_EVIDENCE, BeliefSums, Evidence, Record, SpeedingSums, total

COUNTS = st.integers(0, 10**12)
DRIVEN = st.builds(Driven, COUNTS, COUNTS)
NAMES = st.sampled_from(["a", "b/ms/b", "n", ""])
SUMS = st.dictionaries(NAMES, COUNTS, max_size=3)
RECORDS = st.builds(
    Record,
    trips=COUNTS,
    days=COUNTS,
    exposure=st.builds(
        Exposure,
        DRIVEN,
        st.dictionaries(st.sampled_from(Facet), st.dictionaries(NAMES, DRIVEN, min_size=1, max_size=3)),
    ),
    cells=st.dictionaries(NAMES, DRIVEN, max_size=3),
    coasting_ms=COUNTS,
    manoeuvres=SUMS,
    excused=SUMS,
    speeding=st.builds(SpeedingSums, *[COUNTS] * 8),
    belief=st.dictionaries(NAMES, st.builds(BeliefSums, COUNTS, st.tuples(*[COUNTS] * 8)), max_size=3),
    coverage=SUMS,
    accidents=SUMS,
    evidence=st.dictionaries(
        NAMES,
        st.lists(st.builds(Evidence, st.integers(0, 3), st.just("trip"), NAMES), max_size=MOST_EVIDENCE).map(
            lambda pieces: (Record(evidence={"x": tuple(pieces)}) + Record(evidence={"x": ()})).evidence["x"]
        ),
        max_size=2,
    ),
)


@given(st.lists(RECORDS, min_size=3, max_size=3))
def test_the_order_of_adding_changes_nothing(parts: list[Record]) -> None:
    one, two, three = parts
    whole = total(parts)
    assert all(total(order) == whole for order in permutations(parts))
    assert one + (two + three) == (one + two) + three == whole


@given(RECORDS)
def test_a_record_comes_back_from_json(record: Record) -> None:
    assert Record.from_json(json.loads(json.dumps(record.to_json()))) == record


def test_the_heaviest_evidence_stays() -> None:
    pieces = [Record(evidence={"braking": (Evidence(weight, "manoeuvre", f"m{weight}"),)}) for weight in range(9)]
    kept = total(pieces).evidence["braking"]
    assert [one.weight for one in kept] == [8, 7, 6, 5, 4]


def test_mean_masses_and_coverage() -> None:
    half = 500_000_000
    sums = BeliefSums(2, (0, 2 * half, 0, 0, 0, 0, 0, 2 * half))
    record = Record(belief={"fused": sums}, coverage={"driver.age": half})
    assert sums.mean() == (0, 0.5, 0, 0, 0, 0, 0, 0.5)
    assert record.mean_coverage() == {"driver.age": 0.25}
    assert BeliefSums().mean() is None
    assert Record().mean_coverage() == {}
