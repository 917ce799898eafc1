"""Records of trips: any period is the plain sum over its trips, whatever was put, put again or removed."""

from __future__ import annotations

import random
from collections import defaultdict
from dataclasses import replace
from datetime import UTC, date, datetime, timedelta
from itertools import pairwise
from zoneinfo import ZoneInfo

import pytest
from hypothesis import given
from hypothesis import strategies as st

from core.scoring.record import Record, total
from service.local_days import Period, begin_ns, cover, day_of
from service.storage import records
from service.storage.database import read, write
from service.storage.tables import trip_records
from tests.service.trip_records import DAY_NS, a_record, a_trip, a_trip_record, a_vehicle, put

BEGIN_NS = 1_700_000_000_000_000_000
ZONES = ("UTC", "Europe/Helsinki", "America/Los_Angeles", "Asia/Kathmandu", "America/Havana")


def plain(rows, from_ns, to_ns, zone, cells):
    """The sum by its definition: trip by trip, a day counting once."""
    by_day = defaultdict(list)
    for row in rows:
        if from_ns <= row.start_ns < to_ns:
            record = row.record if cells else replace(row.record, cells={})
            by_day[datetime.fromtimestamp(row.start_ns / 1e9, ZoneInfo(zone)).date()].append(record)
    return total(replace(total(one), days=1) for one in by_day.values())


@pytest.mark.parametrize("zone", ["UTC", "America/Los_Angeles"])
def test_any_period_is_the_plain_sum_over_its_trips(any_database, zone):
    rng = random.Random(1)
    with write(any_database) as connection:
        pk, other = a_vehicle(connection), a_vehicle(connection, "v2")
        rows = [
            a_trip_record(rng, pk, f"trip-{k}", BEGIN_NS + rng.randrange(800) * DAY_NS + rng.randrange(DAY_NS))
            for k in range(70)
        ]
        rows[1] = replace(rows[1], start_ns=begin_ns(day_of(rows[0].start_ns, zone), zone))  # at the very midnight
        for row in rows:
            put(connection, row, zone)
        put(connection, a_trip_record(rng, other, "other", rows[0].start_ns), zone)
    with read(any_database) as connection:
        for _ in range(40):
            ends = sorted(BEGIN_NS + rng.randrange(-20, 820) * DAY_NS + rng.randrange(DAY_NS) for _ in range(2))
            days = [begin_ns(day_of(end, zone), zone) for end in ends]
            for from_ns, to_ns in (ends, days, (rows[1].start_ns, ends[1])):
                cells = rng.random() < 0.5
                found = records.of_period(connection, pk, from_ns, to_ns, zone=zone, cells=cells)
                assert found == plain(rows, from_ns, to_ns, zone, cells)
        assert records.bounds_ns(connection, pk) == (
            min(row.start_ns for row in rows),
            max(row.start_ns for row in rows),
        )


def test_what_changes_or_goes_is_exact(any_database):
    rng = random.Random(2)
    with write(any_database) as connection:
        pk = a_vehicle(connection)
        rows = [a_trip_record(rng, pk, f"trip-{k}", BEGIN_NS + k * 9 * DAY_NS // 10) for k in range(60)]
        for row in rows:
            put(connection, row)
        for k in (3, 30):
            rows[k] = replace(rows[k], record=a_record(rng))
            records.put(connection, rows[k])
        gone = {rows[k].trip_id for k in (0, 7, 8, 59)}
        assert records.remove(connection, pk, trip_records.c.trip_id.in_(gone)) == 4
        rows = [row for row in rows if row.trip_id not in gone]
        ends = 0, 2**62
        assert records.of_period(connection, pk, *ends, cells=True) == plain(rows, *ends, "UTC", True)
        assert records.remove(connection, pk) == len(rows)
        assert records.of_period(connection, pk, *ends, cells=True) == Record()
        assert records.bounds_ns(connection, pk) is None
        assert records.zones(connection) == []


def test_another_time_zone_holds_at_once_and_after_rebuilding(any_database):
    rng = random.Random(3)
    far = "Asia/Kathmandu"
    with write(any_database) as connection:
        pk = a_vehicle(connection)
        rows = [a_trip_record(rng, pk, f"trip-{k}", BEGIN_NS + k * DAY_NS // 5) for k in range(60)]
        for row in rows:
            put(connection, row)
        ends = BEGIN_NS + DAY_NS // 3, BEGIN_NS + 11 * DAY_NS
        expected = plain(rows, *ends, far, True)
        assert records.of_period(connection, pk, *ends, zone=far, cells=True) == expected
        assert records.zones(connection) == [(pk, "UTC")]
        records.rebuild(connection, pk, zone=far)
        assert records.of_period(connection, pk, *ends, zone=far, cells=True) == expected
        assert records.zones(connection) == [(pk, far)]


def test_a_record_comes_back_as_it_was_put(any_database):
    row = None
    with write(any_database) as connection:
        pk = a_vehicle(connection)
        row = replace(a_trip_record(random.Random(4), pk, "one", BEGIN_NS), timeline=b"\x00\x01")
        put(connection, row)
        a_trip(connection, pk, "none", BEGIN_NS)
        assert records.find(connection, "one") == row
        assert records.find(connection, "none") is None


@given(st.sampled_from(ZONES), st.integers(0, 2**61), st.integers(0, 10**9 * 86400 * 3000))
def test_a_cover_is_whole_and_nowhere_double(zone, from_ns, length_ns):
    to_ns = from_ns + length_ns
    parts = cover(from_ns, to_ns, zone)
    spans = list(parts.edges_ns)
    spans += [(begin_ns(first, zone), begin_ns(last, zone)) for _, (first, last) in parts.periods]
    spans.sort()
    assert [span for span in spans if span[0] >= span[1]] == []
    if not length_ns:
        assert spans == []
        return
    assert spans[0][0] == from_ns
    assert spans[-1][1] == to_ns
    assert all(one[1] == following[0] for one, following in pairwise(spans))
    for period, dates in parts.periods:
        assert all(period.begin_of(day) == day for day in dates)
    # No more than a few of each but the longest: days of two thirds, thirds of two months, months of two years.
    for period, most in ((Period.DAY, 2 * 10), (Period.THIRD, 2 * 2), (Period.MONTH, 2 * 11)):
        counts = [len(list(periods_of(period, dates))) for one, dates in parts.periods if one is period]
        assert sum(counts) <= most


def periods_of(period, dates):
    begin, end = dates
    while begin < end:
        yield begin
        begin = period.next_of(begin)
    assert begin == end


@given(st.sampled_from((*ZONES, "Pacific/Apia", "Africa/Cairo", "Asia/Beirut")), st.integers(0, 2**61))
def test_each_instant_is_in_one_day(zone, t_ns):
    day = day_of(t_ns, zone)
    assert begin_ns(day, zone) <= t_ns < begin_ns(day + timedelta(days=1), zone)


def test_a_day_without_midnight_begins_where_clocks_skip_it():
    assert begin_ns(date(2023, 4, 28), "Africa/Cairo") == int(datetime(2023, 4, 27, 22, tzinfo=UTC).timestamp()) * 10**9
    assert day_of(begin_ns(date(2023, 4, 28), "Africa/Cairo"), "Africa/Cairo") == date(2023, 4, 28)
