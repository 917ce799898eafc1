"""Exposure: whole drives and parts of them add up to the same, each facet to the whole, at the local hour and light."""

from __future__ import annotations

import functools
import itertools
import operator

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from core.driving.exposure import UNKNOWN, Exposure, Facet, exposure
from core.errors import InvalidInputError

HELSINKI = np.radians(60.17), np.radians(24.94)


def trip(start, seconds, speed_mps, offset_s=7200, labels=None, step_ms=500):
    count = seconds * 1000 // step_ms + 1
    t_ns = np.datetime64(start, "ns").astype(np.int64) + np.arange(count) * step_ms * 1_000_000
    lat, lon = (np.full(count, angle) for angle in HELSINKI)
    speed = np.full(count, float(speed_mps))
    return t_ns, lat, lon, speed, np.full(count, offset_s), labels


def test_hours_days_and_months_are_local():
    # 22:30 UTC on the last of February, a Thursday: 00:30 on Friday, 1 March, in Helsinki.
    found = exposure(*trip("2024-02-29T22:30", 600, 10))
    assert found.total.distance_m == pytest.approx(6000.0)
    assert found.total.time_s == pytest.approx(600.0)
    assert {facet: list(labels) for facet, labels in found.by.items()} == {
        Facet.HOUR: ["00"],
        Facet.LIGHT: ["night"],
        Facet.WEEKDAY: ["friday"],
        Facet.MONTH: ["03"],
    }


def test_an_hour_that_passes_is_parted():
    found = exposure(*trip("2024-06-03T05:50", 1200, 10, 10800))
    assert found.by[Facet.HOUR]["08"].time_s == pytest.approx(600.0)
    assert found.by[Facet.HOUR]["09"].time_s == pytest.approx(600.0)
    assert found.by[Facet.LIGHT]["day"] == found.total


def test_light_is_the_suns_not_the_clocks():
    # At 22:00 local time it is day in June, and at 16:00 twilight and then night in December.
    assert list(exposure(*trip("2024-06-21T19:00", 60, 10)).by[Facet.LIGHT]) == ["day"]
    evening = exposure(*trip("2024-12-21T13:00", 3 * 3600, 10, step_ms=1000))
    assert list(evening.by[Facet.LIGHT]) == ["day", "night", "twilight"]
    assert evening.share(Facet.LIGHT, "night", "twilight") == pytest.approx(1.0 - evening.share(Facet.LIGHT, "day"))


def test_given_labels_are_taken_and_unknown_ones_told():
    count = 121
    classes = ["primary"] * 60 + [UNKNOWN] * 61
    found = exposure(*trip("2024-06-03T05:50", 60, 10, labels={Facet.ROAD_CLASS: classes, Facet.CELL: ["a"] * count}))
    assert found.by[Facet.ROAD_CLASS]["primary"].distance_m == pytest.approx(300.0)
    assert found.share(Facet.ROAD_CLASS, UNKNOWN) == pytest.approx(0.5)
    assert found.by[Facet.CELL] == {"a": found.total}


def test_standing_silence_and_missing_rows_count_for_nothing():
    t_ns, lat, lon, speed, offset, _ = trip("2024-06-03T05:50", 60, 10)
    speed[:20], lat[20:40] = 0.5, np.nan
    apart = t_ns + (np.arange(t_ns.size) > 60) * 600_000_000_000
    assert exposure(apart, lat, lon, speed, offset).total.time_ms == 20 * 500 + 59 * 500
    assert exposure(*trip("2024-06-03T05:50", 60, 0)).share(Facet.HOUR, "08") == 0.0


@given(cuts=st.lists(st.integers(1, 239), max_size=6), order=st.randoms(use_true_random=False))
def test_parts_in_any_order_make_up_the_whole(cuts, order):
    t_ns, lat, lon, _, offset, _ = trip("2024-06-03T05:59", 120, 0)
    speed = 12.0 + 5.0 * np.sin(np.arange(t_ns.size))
    classes = [f"class {k % 3}" for k in range(t_ns.size)]

    def part(first, last):  # with the row that ends it
        rows = slice(first, last + 1)
        labels = {Facet.ROAD_CLASS: classes[rows]}
        return exposure(t_ns[rows], lat[rows], lon[rows], speed[rows], offset[rows], labels)

    ends = sorted({0, *cuts, t_ns.size - 1})
    parts = [part(a, b) for a, b in itertools.pairwise(ends)]
    order.shuffle(parts)
    whole = functools.reduce(operator.add, parts, Exposure())
    assert whole == part(0, t_ns.size - 1)
    for labels in whole.by.values():
        assert sum(driven.distance_mm for driven in labels.values()) == whole.total.distance_mm
        assert sum(driven.time_ms for driven in labels.values()) == whole.total.time_ms


@pytest.mark.parametrize(
    ("labels", "message"),
    [
        ({Facet.HOUR: ["00"] * 121}, "expected road_class, district or cell alone"),
        ({Facet.DISTRICT: ["a"]}, "expected as many of each"),
    ],
)
def test_labels_that_do_not_fit_are_refused(labels, message):
    with pytest.raises(InvalidInputError, match=message):
        exposure(*trip("2024-06-03T05:50", 60, 10, labels=labels))


def test_times_have_to_increase():
    t_ns, lat, lon, speed, offset, _ = trip("2024-06-03T05:50", 60, 10)
    with pytest.raises(InvalidInputError, match="times do not increase"):
        exposure(t_ns[::-1], lat, lon, speed, offset)
    with pytest.raises(InvalidInputError, match="speeds"):
        exposure(t_ns, lat, lon, speed[1:], offset)
