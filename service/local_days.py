"""Days, months and years by a vehicle's own clock, as spans of time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, date, datetime, timedelta
from typing import Final
from zoneinfo import ZoneInfo

DEFAULT_ZONE: Final = "UTC"
"""Of vehicles that do not say theirs."""

_DAY: Final = timedelta(days=1)
_LAST: Final = date(9990, 1, 1)


def day_of(t_ns: int, zone: str = DEFAULT_ZONE) -> date:
    """The day in which an instant lies: days follow each other without a gap or an overlap, whatever clocks do."""
    at = datetime.fromtimestamp(t_ns // 1_000_000_000, UTC)
    day = min(at.astimezone(ZoneInfo(zone)).date(), _LAST)
    while t_ns < begin_ns(day, zone):
        day -= _DAY
    while t_ns >= begin_ns(day + _DAY, zone):
        day += _DAY
    return day


def begin_ns(day: date, zone: str = DEFAULT_ZONE) -> int:
    """The first instant of a day; where clocks skip midnight, that to which they skip."""
    midnight = datetime(day.year, day.month, day.day, tzinfo=ZoneInfo(zone))
    return int(midnight.timestamp()) * 1_000_000_000


def month_of(day: date) -> date:
    """The first day of its month."""
    return day.replace(day=1)


def year_of(day: date) -> date:
    """The first day of its year."""
    return day.replace(month=1, day=1)


def next_month(day: date) -> date:
    """The first day of the month after."""
    return (day.replace(day=1) + 32 * _DAY).replace(day=1)


def next_year(day: date) -> date:
    """The first day of the year after."""
    return date(day.year + 1, 1, 1)


@dataclass(frozen=True, slots=True)
class Cover:
    """A span of time as whole years, months and days and what is left at its ends; each from one up to the other."""

    years: tuple[tuple[date, date], ...]
    months: tuple[tuple[date, date], ...]
    days: tuple[tuple[date, date], ...]
    edges_ns: tuple[tuple[int, int], ...]


def cover(from_ns: int, to_ns: int, zone: str = DEFAULT_ZONE) -> Cover:
    """What makes up the time from one instant up to another."""
    if from_ns >= to_ns:
        return Cover((), (), (), ())
    first, last = day_of(from_ns, zone), day_of(to_ns, zone)
    if begin_ns(first, zone) < from_ns:
        first += _DAY
    if first >= last:
        return Cover((), (), (), ((from_ns, to_ns),))
    years, outside_years = _whole(first, last, year_of, next_year)
    months: list[tuple[date, date]] = []
    days: list[tuple[date, date]] = []
    for begin, end in outside_years:
        inside, outside = _whole(begin, end, month_of, next_month)
        months += inside
        days += outside
    edges = ((from_ns, begin_ns(first, zone)), (begin_ns(last, zone), to_ns))
    return Cover(tuple(years), tuple(months), tuple(days), tuple(edge for edge in edges if edge[0] < edge[1]))


def _whole(
    first: date, last: date, begin_of: Callable[[date], date], next_of: Callable[[date], date]
) -> tuple[list[tuple[date, date]], list[tuple[date, date]]]:
    """What of the days from first up to last makes whole periods, and what is before and after those."""
    begin = first if begin_of(first) == first else next_of(first)
    end = begin_of(last)
    if begin >= end:
        return [], [(first, last)]
    return [(begin, end)], [span for span in ((first, begin), (end, last)) if span[0] < span[1]]
