"""Times at the border: RFC 3339 outside, UTC nanoseconds inside."""

from __future__ import annotations

import re
from datetime import UTC, datetime, timedelta
from typing import Annotated, Final

from pydantic import PlainSerializer, WithJsonSchema

from schemas.notifications import rfc3339

Time = Annotated[
    int, PlainSerializer(rfc3339, return_type=str), WithJsonSchema({"type": "string", "format": "date-time"})
]
"""UTC nanoseconds that go out as RFC 3339 with microseconds."""

_EPOCH: Final = datetime(1970, 1, 1, tzinfo=UTC)
_LAST_NS: Final = 2**63 - 1
_RFC3339: Final = re.compile(
    r"(\d{4}-\d\d-\d\d)[Tt ](\d\d:\d\d):(\d\d)(?:\.(\d{1,9})\d*)?([Zz]|[+-]\d\d:\d\d)", flags=re.ASCII
)


def parse_time(text: str) -> int:
    """UTC nanoseconds of an RFC 3339 time, ValueError where it is none; what no event can lie beyond (1970, 2262) is
    taken as that limit."""
    match = _RFC3339.fullmatch(text.strip())
    if match is None:
        raise ValueError(f"'{text}' is not an RFC 3339 time such as 2026-01-31T12:00:00Z")
    day, clock, second, fraction, zone = match.groups()
    if int(second) > 60:
        raise ValueError(f"'{text}' is not a time: second must be in 0..60")
    try:
        minute = datetime.fromisoformat(f"{day}T{clock}:00{'+00:00' if zone in 'Zz' else zone}")
    except ValueError as error:
        raise ValueError(f"'{text}' is not a time: {error}") from None
    seconds = (minute - _EPOCH) // timedelta(seconds=1) + int(second)
    return min(max(0, seconds * 1_000_000_000 + int((fraction or "").ljust(9, "0"))), _LAST_NS)


def parse_interval(text: str) -> tuple[int | None, int | None]:
    """First and last instant, both included, of ``A``, ``A/B``, ``../B`` or ``A/..`` (as OGC API Features has it);
    None is open."""
    first_text, slash, last_text = text.partition("/")
    if not slash:
        instant = parse_time(text)
        return instant, instant
    first, last = (None if part.strip() in ("", "..") else parse_time(part) for part in (first_text, last_text))
    if first is None and last is None:
        raise ValueError("an interval needs a time on one side at least: A/B, A/.. or ../B")
    if first is not None and last is not None and first > last:
        raise ValueError("the interval ends before it begins")
    return first, last
