"""Times in queries."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, TypeVar

from fastapi import Query

from schemas.times import parse_interval, parse_time
from service.errors import InvalidParameterError

T = TypeVar("T")

_TIME = {"format": "date-time"}
FromTime = Annotated[
    str | None, Query(alias="from", description="From this time on, RFC 3339.", json_schema_extra=_TIME)
]
ToTime = Annotated[str | None, Query(alias="to", description="Up to this time, RFC 3339.", json_schema_extra=_TIME)]
AtTime = Annotated[str | None, Query(alias="at", description="As of this time, RFC 3339.", json_schema_extra=_TIME)]
ValidFrom = Annotated[
    str | None,
    Query(description="From this time on, RFC 3339; left out, from now on.", json_schema_extra=_TIME),
]


def time_ns(name: str, text: str | None) -> int | None:
    """A time given in the query parameter ``name``, as UTC nanoseconds."""
    return None if text is None else _parsed(parse_time, name, text)


def interval_ns(name: str, text: str | None) -> tuple[int | None, int | None]:
    """The first and the last instant of an interval given in the query parameter ``name``."""
    return (None, None) if text is None else _parsed(parse_interval, name, text)


def _parsed(parse: Callable[[str], T], name: str, text: str) -> T:
    try:
        return parse(text)
    except ValueError as error:
        raise InvalidParameterError(f"query.{name}: {error}") from None
