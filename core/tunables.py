"""Tunable numbers: each a field of a frozen dataclass with its unit, its range and where it comes from."""

from __future__ import annotations

import dataclasses
import math
from typing import Any, TypeVar

from core.errors import InvalidInputError

_Number = TypeVar("_Number", int, float)


@dataclasses.dataclass(frozen=True, slots=True)
class Tunable:
    """What is known of one tunable: its name, default, unit, allowed range (inclusive) and source."""

    name: str
    default: float
    unit: str
    low: float
    high: float
    source: str


def tunable(default: _Number, *, unit: str, low: float, high: float, source: str) -> _Number:
    """Field of a ``Tunables`` dataclass.

    Parameters
    ----------
    default : int or float
        Must lie in the range.
    unit : str
        As in ``m/s2``; ``1`` for a pure number.
    low, high : float
        Range within which a value makes sense, both ends allowed.
    source : str
        Where the default comes from; a choice says that it is one, and why.
    """
    metadata = {"unit": unit, "low": low, "high": high, "source": source}
    field: _Number = dataclasses.field(default=default, metadata=metadata)
    return field


class Tunables:
    """Base of frozen dataclasses of tunables: refuses values outside their range when built.

    A subclass that has checks of its own across fields calls ``self.check_ranges()`` first in its
    ``__post_init__``.
    """

    __slots__ = ()

    def __post_init__(self) -> None:
        self.check_ranges()

    def check_ranges(self) -> None:
        """Raise InvalidInputError that names the first value outside its range."""
        for known in describe(type(self)):
            value = getattr(self, known.name)
            if not (math.isfinite(value) and known.low <= value <= known.high):
                raise InvalidInputError(
                    f"{type(self).__name__}.{known.name} is {value!r}: expected {known.low:g} to {known.high:g}"
                    f" {known.unit} (default {known.default:g}; {known.source})"
                )


def describe(tunables: type[Tunables]) -> tuple[Tunable, ...]:
    """All tunables of a dataclass, in their order. Fields that are ``Tunables`` themselves are left to their own class.

    Raises
    ------
    InvalidInputError
        If a field was not made by ``tunable``, says no unit or source, or its default is out of its range.
    """
    fields: tuple[dataclasses.Field[Any], ...] = dataclasses.fields(tunables)  # type: ignore[arg-type]
    found = []
    for field in fields:
        if isinstance(field.default, Tunables):
            continue
        facts = field.metadata
        where = f"{tunables.__name__}.{field.name}"
        if not {"unit", "low", "high", "source"} <= facts.keys():
            raise InvalidInputError(f"{where} has no unit, range and source: make it with tunable()")
        if not facts["unit"] or not facts["source"]:
            raise InvalidInputError(f"{where} says no unit or no source")
        default: Any = field.default
        known = Tunable(field.name, default, facts["unit"], facts["low"], facts["high"], facts["source"])
        if not known.low <= known.default <= known.high:
            raise InvalidInputError(f"{where}: its default {known.default:g} is outside its own range")
        found.append(known)
    return tuple(found)
