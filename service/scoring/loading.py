"""The score model and tariff that ship with the core, or a user's own, from TOML; records and places from JSON."""

from __future__ import annotations

import tomllib
from decimal import Decimal
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any, Final

from core.errors import InvalidInputError
from core.scoring.model import ScoreModel, score_model_of
from service.errors import UsageError

SHIPPED: Final = ("scores", "tariff")


@cache
def shipped_model() -> ScoreModel:
    """The model that ships."""
    return score_model_of(tomllib.loads(shipped_text("scores")))


def score_model(own: Path | None = None) -> ScoreModel:
    """The model by a user's file, or the shipped one; raises UsageError that says what is wrong in it."""
    if own is None:
        return shipped_model()
    document = _read_toml(own, "scores model --show")
    try:
        return score_model_of(document)
    except InvalidInputError as error:
        raise UsageError(f"{own}: {error}") from None


def shipped_text(name: str) -> str:
    """A shipped file as it is written, with its sources."""
    return (resources.files("core.scoring") / "tables" / f"{name}.toml").read_text(encoding="utf-8")


def _read_toml(path: Path, like: str, *, decimals: bool = False) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"), parse_float=Decimal if decimals else float)
    except OSError as error:
        raise UsageError(f"{path}: cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise UsageError(f"{path}: is no TOML: {error}; expected a file as 'telefuse {like}' prints") from error
