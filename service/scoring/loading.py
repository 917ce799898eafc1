"""The score model and tariff that ship with the core, or a user's own, from TOML; records and places from JSON."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any, TypeVar

from core.errors import InvalidInputError
from core.scoring.model import ScoreModel, score_model_of
from core.scoring.numbers import is_number
from core.scoring.places import Places, places_of
from core.scoring.premium import Tariff, tariff_of
from core.scoring.record import Record
from service.errors import UsageError
from service.scoring.checking import record_of

_Made = TypeVar("_Made")


@cache
def shipped_model() -> ScoreModel:
    """The model that ships."""
    return score_model_of(tomllib.loads(shipped_text("scores")))


def score_model(own: Path | None = None) -> ScoreModel:
    """The model by a user's file, or the shipped one; raises UsageError that says what is wrong in it."""
    return shipped_model() if own is None else _made(own, score_model_of, model_document(own))


def model_document(own: Path | None = None) -> dict[str, Any]:
    """The model as its file says it: TOML, or JSON as 'scores fit' prints it."""
    if own is None:
        return tomllib.loads(shipped_text("scores"))
    if own.suffix.lower() == ".json":
        return _parsed(own, json.loads, "JSON: {}; expected a model as 'telefuse scores fit' prints")
    return _read_toml(own, "scores model --show")


def portfolio(path: Path) -> list[tuple[Record, float]]:
    """Records with their periods in days, one JSON object a line; raises UsageError that names the line."""
    found = []
    for number, line in enumerate(_text(path).splitlines(), 1):
        if not line.strip():
            continue
        try:
            told = json.loads(line)
            if (
                not isinstance(told, dict)
                or not is_number(told.get("days"))
                or not isinstance(told.get("record"), dict)
            ):
                raise InvalidInputError('expected {"days": N, "record": {…}}')
            found.append((record_of(told["record"]), float(told["days"])))
        except (ValueError, RecursionError, InvalidInputError) as error:
            raise UsageError(f"{path}: line {number}: {error}") from None
    return found


@cache
def shipped_tariff() -> Tariff:
    """The example that ships."""
    return tariff_of(tomllib.loads(shipped_text("tariff")))


def tariff(own: Path) -> Tariff:
    """A user's tariff; raises UsageError that says what is wrong in it."""
    return _made(own, tariff_of, _read_toml(own, "scores tariff"))


def record(path: Path) -> Record:
    """A record as ``Record.to_json`` told it; raises UsageError that says what is wrong in it."""
    return _made(path, record_of, _parsed(path, json.loads, "JSON: {}; expected a record"))


def places(path: Path) -> Places:
    """Relativities of cells as ``Places.to_json`` told them; raises UsageError that says what is wrong in them."""
    return _made(path, places_of, _parsed(path, json.loads, "JSON: {}; expected places"))


def shipped_text(name: str) -> str:
    """A shipped file as it is written, with its sources."""
    return (resources.files("core.scoring") / "tables" / f"{name}.toml").read_text(encoding="utf-8")


def _made(path: Path, make: Callable[[dict[str, Any]], _Made], document: dict[str, Any]) -> _Made:
    try:
        return make(document)
    except InvalidInputError as error:
        raise UsageError(f"{path}: {error}") from None


def _read_toml(path: Path, like: str) -> dict[str, Any]:
    return _parsed(path, tomllib.loads, f"TOML: {{}}; expected a file as 'telefuse {like}' prints")


def _parsed(path: Path, parse: Callable[[str], Any], expected: str) -> dict[str, Any]:
    text = _text(path)
    try:
        document = parse(text)
    except (ValueError, RecursionError) as error:
        raise UsageError(f"{path}: is no {expected.format(error)}") from error
    if not isinstance(document, dict):
        raise UsageError(f"{path}: is no {expected.format('no object')}")
    return document


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise UsageError(f"{path}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise UsageError(f"{path}: is no UTF-8 text: {error.reason} at byte {error.start}") from error
