"""The period that a score is of: what was asked for, and how much of it was observed."""

from __future__ import annotations

import re
from dataclasses import dataclass
from datetime import date, timedelta
from typing import Final

from schemas.times import parse_time
from service.errors import InvalidParameterError
from service.local_days import Period as Calendar
from service.local_days import begin_ns, day_of

DAY_NS: Final = 86_400_000_000_000
DEFAULT_DAYS: Final = 365
_ONE: Final = timedelta(days=1)
_DATE: Final = re.compile(r"\d{4}-\d\d-\d\d", re.ASCII)
_MONTH: Final = re.compile(r"\d{4}-\d\d", re.ASCII)


@dataclass(frozen=True, slots=True)
class Period:
    """From one instant up to another; ``observed_ns`` is the part of it in which a box could tell of trips."""

    from_ns: int
    to_ns: int
    zone: str
    observed_ns: tuple[int, int] | None

    @property
    def days(self) -> float:
        """Observed, in days; 0 where nothing was."""
        return 0.0 if self.observed_ns is None else (self.observed_ns[1] - self.observed_ns[0]) / DAY_NS

    @property
    def length_days(self) -> float:
        """What distance is related to: as observed; the whole where nothing was, as that has a length all the same."""
        return self.days or (self.to_ns - self.from_ns) / DAY_NS


@dataclass(frozen=True, slots=True)
class Asked:
    """What a caller says of the period: its ends, or a month, or how many days up to its end; all may be left out."""

    from_: str | None = None
    to: str | None = None
    month: str | None = None
    days: int | None = None


def period_of(asked: Asked, zone: str, trips_ns: tuple[int, int] | None, now_ns: int) -> Period:
    """The period asked for, of a vehicle whose first and last trips began at ``trips_ns``.

    Left out, it ends with the day of the last trip and is a year long. Observed it is from the day of the first trip to
    the end of today. Raises InvalidParameterError.
    """
    from_ns, to_ns = _ends(asked, zone, now_ns if trips_ns is None else trips_ns[1])
    if from_ns >= to_ns:
        raise InvalidParameterError("query.from: the period ends before it begins; expected from before to")
    if trips_ns is None:
        return Period(from_ns, to_ns, zone, None)
    first = max(from_ns, begin_ns(day_of(trips_ns[0], zone), zone))
    last = min(to_ns, begin_ns(day_of(max(now_ns, trips_ns[1]), zone) + _ONE, zone))
    return Period(from_ns, to_ns, zone, (first, last) if first < last else None)


def _ends(asked: Asked, zone: str, last_ns: int) -> tuple[int, int]:
    if asked.month is not None:
        if asked.from_ is not None or asked.to is not None or asked.days is not None:
            raise InvalidParameterError("query.month: is a period by itself; expected no from, to or days beside it")
        begin = _month(asked.month)
        return begin_ns(begin, zone), begin_ns(Calendar.MONTH.next_of(begin), zone)
    to_ns = begin_ns(day_of(last_ns, zone) + _ONE, zone) if asked.to is None else _instant("to", asked.to, zone)
    if asked.from_ is not None:
        if asked.days is not None:
            raise InvalidParameterError("query.days: counts back from the end; expected either from or days")
        return _instant("from", asked.from_, zone), to_ns
    # The day that holds the last instant before the end, and those before it.
    back = (DEFAULT_DAYS if asked.days is None else asked.days) - 1
    return begin_ns(day_of(max(to_ns - 1, 0), zone) - back * _ONE, zone), to_ns


def _instant(name: str, text: str, zone: str) -> int:
    """An RFC 3339 time, or a date: the beginning of that day by the vehicle's clock."""
    if _DATE.fullmatch(text.strip()):
        return begin_ns(_day(name, text.strip()), zone)
    try:
        return parse_time(text)
    except ValueError as error:
        raise InvalidParameterError(f"query.{name}: {error}, nor a date such as 2026-01-31") from None


def _month(text: str) -> date:
    if not _MONTH.fullmatch(text.strip()):
        raise InvalidParameterError(f"query.month: '{text}' is no month; expected such as 2026-10")
    return _day("month", text.strip() + "-01")


def _day(name: str, text: str) -> date:
    try:
        day = date.fromisoformat(text)
    except ValueError as error:
        raise InvalidParameterError(f"query.{name}: '{text}' is no date: {error}") from None
    if not 1970 <= day.year <= 2261:
        raise InvalidParameterError(f"query.{name}: {text} is beyond what can be told; expected 1970 to 2261")
    return day
