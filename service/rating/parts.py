"""The parts that rating goes by, and how each is read from its text."""

from __future__ import annotations

import hashlib
import json
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Final

from sqlalchemy import Connection

from core.errors import InvalidInputError
from core.scoring.model import score_model_of
from core.scoring.places import Places, places_of
from core.scoring.premium import tariff_of
from service.risk import loading as risk
from service.scoring import loading as scoring
from service.storage import rating

TOML: Final = "application/toml"
JSON: Final = "application/json"


class Part(StrEnum):
    """What a tenant may have of its own."""

    RISK_TABLES = "risk-tables"
    SCORE_MODEL = "score-model"
    TARIFF = "tariff"
    PLACES = "places"


@dataclass(frozen=True, slots=True)
class Kind:
    """How a part is shipped and read; ``read`` raises InvalidInputError that says what is wrong and where."""

    media_type: str
    shipped: Callable[[], str]
    read: Callable[[str], Any]


def is_json(text: str) -> bool:
    """Whether a text is meant as JSON: ``telefuse scores fit`` prints a model so, and no TOML begins like it."""
    return text.lstrip().startswith(("{", "null"))


def _toml(read: Callable[[Mapping[str, Any]], Any], like: str) -> Callable[[str], Any]:
    def of(text: str) -> Any:
        try:
            document = json.loads(text) if is_json(text) else tomllib.loads(text)
        except ValueError as error:
            raise InvalidInputError(f"is no TOML or JSON: {error}; expected what 'telefuse {like}' prints") from error
        if not isinstance(document, Mapping):
            raise InvalidInputError(f"is {text.strip()[:20]!r}; expected what 'telefuse {like}' prints")
        return read(document)

    return of


def _places(text: str) -> Places | None:
    try:
        told = json.loads(text)
    except ValueError as error:
        raise InvalidInputError(f"is no JSON: {error}; expected shape and cells") from error
    if told is None:
        return None
    if not isinstance(told, Mapping):
        raise InvalidInputError("no places: expected shape and cells, or null")
    return places_of(told)


KINDS: Final[Mapping[Part, Kind]] = {
    Part.RISK_TABLES: Kind(TOML, lambda: risk.shipped_text(risk.PRESETS[0]), risk.tables_from),
    Part.SCORE_MODEL: Kind(TOML, lambda: scoring.shipped_text("scores"), _toml(score_model_of, "scores model --show")),
    Part.TARIFF: Kind(TOML, lambda: scoring.shipped_text("tariff"), _toml(tariff_of, "scores tariff")),
    Part.PLACES: Kind(JSON, lambda: "null\n", _places),
}
"""Nothing is shipped of places: what is risky where, a portfolio's own accidents say."""


@dataclass(frozen=True, slots=True)
class Holding:
    """The version of a part that holds for a tenant: 0, and as shipped, where it has none of its own."""

    part: Part
    version: int
    text: str
    own: bool
    created_ns: int | None = None
    created_by: str | None = None

    @property
    def sha256(self) -> str:
        """Of the text."""
        return hashlib.sha256(self.text.encode()).hexdigest()

    def read(self) -> Any:
        """What the text says: risk tables, a score model, a tariff, risk of places."""
        return KINDS[self.part].read(self.text)


def holding(connection: Connection, tenant_id: str, part: Part, version: int | None = None) -> Holding | None:
    """What a tenant rates by, now or as of a version; None where it never had that version."""
    row = (
        rating.newest(connection, tenant_id, part)
        if version is None
        else rating.find(connection, tenant_id, part, version)
    )
    if row is None:
        return None if version else Holding(part, 0, KINDS[part].shipped(), own=False)
    text = KINDS[part].shipped() if row.text is None else row.text
    return Holding(part, row.version, text, row.text is not None, row.created_ns, row.created_by)
