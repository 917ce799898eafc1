"""A record from outside: checked before it is believed, since the service's own always hold what these checks ask."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any, Final

from core.driving.exposure import Facet
from core.driving.manoeuvres import Manoeuvre
from core.errors import InvalidInputError
from core.risk.belief import N_SETS
from core.scoring.record import Record, SpeedingSums

_MOST: Final = 2**63 - 1
_COUNTS: Final = ("trips", "days", "coasting_ms")
_BY_NAME: Final = ("manoeuvres", "excused", "coverage", "accidents")
_PAIRS: Final = ("total", "by", "cells")
_SPEEDING: Final = tuple(one.name for one in fields(SpeedingSums))
_KEYS: Final = (*_COUNTS, *_PAIRS, *_BY_NAME, "speeding", "belief", "evidence")


def record_of(told: Mapping[str, Any]) -> Record:
    """The record of a JSON object; raises InvalidInputError that names what is wrong in it."""
    if unknown := [key for key in told if key not in _KEYS]:
        raise InvalidInputError(f"unknown key '{unknown[0]}': expected {', '.join(_KEYS)}")
    for key in _COUNTS:
        _count(told.get(key, 0), key)
    total = _numbers(told.get("total", [0, 0]), "total", 2)
    for facet, labels in _map(told, "by").items():
        if facet not in list(Facet):
            raise InvalidInputError(f"by.{facet}: expected one of {', '.join(Facet)}")
        _labels(labels, f"by.{facet}", total[0])
    _labels(_map(told, "cells"), "cells", total[0])
    for key in _BY_NAME:
        for name, value in _map(told, key).items():
            if key in ("manoeuvres", "excused") and name not in list(Manoeuvre):
                raise InvalidInputError(f"{key}.{name}: expected one of {', '.join(Manoeuvre)}")
            _count(value, f"{key}.{name}")
    _speeding(_map(told, "speeding"))
    for name, sums in _map(told, "belief").items():
        _numbers(sums, f"belief.{name}", 1 + N_SETS)
    for about, pieces in _map(told, "evidence").items():
        for piece in pieces if isinstance(pieces, list) else [pieces]:
            if not (isinstance(piece, list) and len(piece) == 3 and all(isinstance(one, str) for one in piece[1:])):
                raise InvalidInputError(f"evidence.{about} has {piece!r}: expected [weight, kind, id]")
            _count(piece[0], f"evidence.{about}")
    return Record.from_json(told)


def _speeding(told: Mapping[str, Any]) -> None:
    for name, value in told.items():
        if name not in _SPEEDING:
            raise InvalidInputError(f"speeding.{name}: expected one of {', '.join(_SPEEDING)}")
        _count(value, f"speeding.{name}")
    for part, whole in (("over_ms", "known_ms"), ("certain_ms", "known_ms"), ("certain_over_ms", "certain_ms")):
        if told.get(part, 0) > told.get(whole, 0):
            raise InvalidInputError(f"speeding.{part} is {told[part]}: expected {whole}, {told.get(whole, 0)}, at most")


def _labels(told: Any, where: str, total_mm: int) -> None:
    if not isinstance(told, Mapping):
        raise InvalidInputError(f"{where} is {told!r}: expected {{label: [mm, ms], …}}")
    distance_mm = sum(_numbers(pair, f"{where}.{label}", 2)[0] for label, pair in told.items())
    if distance_mm > total_mm:
        raise InvalidInputError(f"{where} sums to {distance_mm} mm: expected the total of {total_mm} mm at most")


def _map(told: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    value = told.get(key, {})
    if not isinstance(value, Mapping):
        raise InvalidInputError(f"{key} is {value!r}: expected an object")
    return value


def _numbers(value: Any, where: str, many: int) -> list[int]:
    if not isinstance(value, list) or len(value) != many:
        raise InvalidInputError(f"{where} is {value!r}: expected {many} whole numbers")
    for one in value:
        _count(one, where)
    return value


def _count(value: Any, where: str) -> None:
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= _MOST:
        raise InvalidInputError(f"{where} is {str(value)[:40]}: expected a whole number from 0 to 2^63 - 1")
