"""The risk tables that ship with the core, and a user's own, read from TOML: the core itself reads no file."""

from __future__ import annotations

import hashlib
import tomllib
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any, Final

from core.errors import InvalidInputError
from core.risk.assessment import RiskModel
from core.risk.combination import RULES
from core.risk.lookup import RiskTables, tables_of
from core.risk.vehicle import VehicleModel, vehicle_of
from service.errors import UsageError

PRESETS: Final = ("default", "paper")


def risk_model(preset: str = PRESETS[0], own: Path | None = None, rule: str = RULES[0]) -> RiskModel:
    """The model by a preset, or by a user's own tables; raises UsageError that says what is wrong in them."""
    return RiskModel(preset_tables(preset) if own is None else own_tables(own), vehicle_model(), rule)


@dataclass(frozen=True, slots=True)
class RiskBasis:
    """A model with the digest of every file that it is made of."""

    model: RiskModel
    sha256: str


def risk_basis(text: str, tables: RiskTables) -> RiskBasis:
    """The model of tables, which were read from ``text``, with the vehicle's systems and the rule."""
    model = RiskModel(tables, vehicle_model(), RULES[0])
    told = "".join((text, shipped_text("vehicle"), model.rule))
    return RiskBasis(model, hashlib.sha256(told.encode()).hexdigest())


@cache
def preset_tables(name: str) -> RiskTables:
    """The tables of a preset."""
    return tables_of(_shipped(name))


@cache
def vehicle_model() -> VehicleModel:
    """The vehicle's three fuzzy systems."""
    return vehicle_of(_shipped("vehicle"))


def own_tables(path: Path) -> RiskTables:
    """A user's tables in a file; raises UsageError that names it."""
    try:
        return tables_from(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise UsageError(f"{path}: cannot be read: {error.strerror}") from error
    except (ValueError, InvalidInputError) as error:
        raise UsageError(f"{path}: {error}") from None


def tables_from(text: str) -> RiskTables:
    """A user's tables in TOML: on their own, or with ``extends`` on top of a preset; raises InvalidInputError."""
    try:
        document = tomllib.loads(text)
    except ValueError as error:
        raise InvalidInputError(f"is no TOML: {error}; expected tables as in 'telefuse risk tables'") from error
    base = document.get("extends")
    if base is not None and base not in PRESETS:
        raise InvalidInputError(f"extends {base!r}; expected one of {', '.join(PRESETS)}")
    return tables_of(document, None if base is None else preset_tables(base))


def shipped_text(name: str) -> str:
    """A shipped file as it is written, with its sources."""
    return (resources.files("core.risk") / "tables" / f"{name}.toml").read_text(encoding="utf-8")


def _shipped(name: str) -> dict[str, Any]:
    return tomllib.loads(shipped_text(name))
