"""Records as they are stored come back as they were, and add up as records do."""

from __future__ import annotations

import json
from dataclasses import replace

from hypothesis import given
from hypothesis import strategies as st

from core.scoring.record import Record, total
from service.storage import record_sums
from tests.core.test_score_record import RECORDS


@given(RECORDS)
def test_a_record_comes_back(record: Record) -> None:
    told = json.loads(json.dumps(record_sums.told_of(record)))
    assert record_sums.record_of([told], record.cells) == record


@given(st.lists(RECORDS, max_size=4))
def test_what_is_told_adds_up_to_the_same(parts: list[Record]) -> None:
    told = [json.loads(json.dumps(record_sums.told_of(one))) for one in parts]
    assert record_sums.record_of(told) == replace(total(parts), cells={})
    assert record_sums.record_of([record_sums.added(told)]) == record_sums.record_of(told)
