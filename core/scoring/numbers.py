"""Numbers with unit, range and source, out of what a TOML document says; errors name the number."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from typing import Any

from core.errors import InvalidInputError

_FACTS = ("value", "unit", "range", "source", "memory")


def digest(document: Mapping[str, Any]) -> str:
    """SHA-256 of a document's content, however it is written; raises InvalidInputError where a number is not finite."""
    try:
        text = json.dumps(
            document, sort_keys=True, separators=(",", ":"), allow_nan=False, ensure_ascii=False, default=str
        )
    except ValueError as error:
        raise InvalidInputError("a number is infinite or NaN: expected finite ones") from error
    return hashlib.sha256(text.encode()).hexdigest()


def is_number(value: Any) -> bool:
    """Whether it is a finite number, and no bool."""
    return not isinstance(value, bool) and isinstance(value, int | float) and math.isfinite(value)


def text_of(section: Mapping[str, Any], key: str, where: str) -> str:
    """A text that has to be there."""
    value = section.get(key)
    if not isinstance(value, str) or not value:
        raise InvalidInputError(f"{where}{key} is {value!r}: expected a text")
    return value


class Section:
    """One table of a document, by its path in it, such as ``payd.mileage``; ``keys`` are all that it may have."""

    def __init__(self, document: Mapping[str, Any], path: str, keys: Sequence[str]) -> None:
        self.path = path
        found: Any = document
        for key in path.split("."):
            found = found.get(key) if isinstance(found, Mapping) else None
        if not isinstance(found, Mapping):
            raise InvalidInputError(f"[{path}] is missing: expected a section with {', '.join(keys)}")
        if unknown := [key for key in found if key not in keys]:
            raise InvalidInputError(f"[{path}]: unknown key '{unknown[0]}': expected {', '.join(keys)}")
        self.content: Mapping[str, Any] = found

    def number(self, key: str) -> float:
        """A number within the range that stands with it."""
        where, fact = f"{self.path}.{key}", self.content.get(key)
        if not isinstance(fact, Mapping):
            raise InvalidInputError(f"{where} is {fact!r}: expected {{ value, unit, range, source }}")
        if unknown := [one for one in fact if one not in _FACTS]:
            raise InvalidInputError(f"{where}: unknown key '{unknown[0]}': expected {', '.join(_FACTS)}")
        low, high = self._facts(fact, where)
        if not is_number(fact.get("value")):
            raise InvalidInputError(f"{where} has the value {fact.get('value')!r}: expected a number")
        value = float(fact["value"])
        if not low <= value <= high:
            raise InvalidInputError(f"{where} is {value:g}: expected {low:g} to {high:g} {fact['unit']}")
        return value

    def numbers(self, key: str, values: Any) -> tuple[float, ...]:
        """Numbers of a list, within the section's own range."""
        low, high = self._facts(self.content, f"[{self.path}]")
        if not isinstance(values, list) or not values or not all(is_number(value) for value in values):
            raise InvalidInputError(f"{self.path}.{key} is {values!r}: expected a list of numbers")
        for value in values:
            if not low <= value <= high:
                raise InvalidInputError(f"{self.path}.{key} has {value:g}: expected {low:g} to {high:g}")
        return tuple(float(value) for value in values)

    @staticmethod
    def _facts(fact: Mapping[str, Any], where: str) -> tuple[float, float]:
        """The range, where unit, range and source are there as they should."""
        for key in ("unit", "source"):
            if not isinstance(fact.get(key), str) or not fact[key]:
                raise InvalidInputError(f'{where} has no {key}: expected {key} = "…"; a choice says that it is one')
        bounds = fact.get("range")
        if not (isinstance(bounds, list) and len(bounds) == 2 and all(is_number(b) for b in bounds)):
            raise InvalidInputError(f"{where} has the range {bounds!r}: expected [least, most]")
        if not bounds[0] <= bounds[1]:
            raise InvalidInputError(f"{where} has the range {bounds!r}: expected the least first")
        return float(bounds[0]), float(bounds[1])
