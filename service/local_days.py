"""Days by a vehicle's own clock, and what they are summed by, as spans of time."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, date, datetime, timedelta
from enum import StrEnum
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


class Period(StrEnum):
    """By what days are summed, the longest first; a third of a month is from its 1st, 11th or 21st on."""

    YEAR = "year"
    MONTH = "month"
    THIRD = "third"
    DAY = "day"

    def begin_of(self, day: date) -> date:
        """The first day of the period in which a day lies."""
        if self is Period.YEAR:
            return date(day.year, 1, 1)
        if self is Period.MONTH:
            return day.replace(day=1)
        return day.replace(day=1 + 10 * min((day.day - 1) // 10, 2)) if self is Period.THIRD else day

    def next_of(self, day: date) -> date:
        """The first day of the period after."""
        if self is Period.YEAR:
            return date(day.year + 1, 1, 1)
        if self is Period.THIRD and day.day <= 20:
            return self.begin_of(day) + 10 * _DAY
        return day + _DAY if self is Period.DAY else (day.replace(day=1) + 32 * _DAY).replace(day=1)


Span = tuple[date, date]
"""Days from one up to another."""


@dataclass(frozen=True, slots=True)
class Cover:
    """A span of time as whole periods, each as long as can be, and what is left at its ends."""

    periods: tuple[tuple[Period, Span], ...]
    edges_ns: tuple[tuple[int, int], ...]


def cover(from_ns: int, to_ns: int, zone: str = DEFAULT_ZONE) -> Cover:
    """What makes up the time from one instant up to another."""
    if from_ns >= to_ns:
        return Cover((), ())
    first, last = day_of(from_ns, zone), day_of(to_ns, zone)
    if begin_ns(first, zone) < from_ns:
        first += _DAY
    if first >= last:
        return Cover((), ((from_ns, to_ns),))
    periods: list[tuple[Period, Span]] = []
    left: list[Span] = [(first, last)]
    for period in Period:
        outside: list[Span] = []
        for span in left:
            begin = span[0] if period.begin_of(span[0]) == span[0] else period.next_of(span[0])
            end = period.begin_of(span[1])
            if begin < end:
                periods.append((period, (begin, end)))
                outside += [(span[0], begin), (end, span[1])]
            else:
                outside.append(span)
        left = [span for span in outside if span[0] < span[1]]
    edges = ((from_ns, begin_ns(first, zone)), (begin_ns(last, zone), to_ns))
    return Cover(tuple(periods), tuple(edge for edge in edges if edge[0] < edge[1]))
