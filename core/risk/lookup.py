"""Tables that turn what is known of driver and environment into masses: validated once, looked up over arrays."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from core.errors import InvalidInputError
from core.measurements import FloatArray
from core.risk.belief import N_SETS, PROPOSITIONS, mass_of, vacuous

BoolArray = npt.NDArray[np.bool_]
Values = Mapping[str, npt.NDArray[Any]]
"""What is known at n instants, by input: numbers, NaN where unknown, or words, "" where unknown; (n,) each."""

WEEKDAYS: Final = ("monday", "tuesday", "wednesday", "thursday", "friday", "saturday", "sunday")
LIGHTS: Final = ("day", "twilight", "night")
SURROUNDINGS: Final = ("urban", "rural")
ROADS: Final = (
    "motorway",
    "trunk",
    "primary",
    "secondary",
    "tertiary",
    "unclassified",
    "residential",
    "living_street",
    "service",
    "track",
)
"""OpenStreetMap's classes of roads for cars."""

DRIVER, ENVIRONMENT = "driver", "environment"
_NUMBERS: Final = {"age": DRIVER, "experience": DRIVER, "hour": ENVIRONMENT, "month": ENVIRONMENT}
_WORDS: Final[Mapping[str, tuple[str, tuple[str, ...] | None]]] = {
    "sex": (DRIVER, ("M", "F")),
    "weekday": (ENVIRONMENT, WEEKDAYS),
    "light": (ENVIRONMENT, LIGHTS),
    "road": (ENVIRONMENT, ROADS),
    "surroundings": (ENVIRONMENT, SURROUNDINGS),
    "district": (ENVIRONMENT, None),
}
_NODES: Final = ("LR", "LR|MR", "MR", "MR|HR", "HR")
_OF_RANGE: Final = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Nodes of a flat table, over its own range from its least to its greatest rate."""


def crossfade(values: FloatArray, nodes: Sequence[float]) -> FloatArray:
    """Masses (n, 8) of values: all on LR, LR|MR, MR, MR|HR or HR at its node, linear between neighbours, flat beyond.

    A value of NaN gives Theta.
    """
    mass = np.zeros((len(values), N_SETS))
    for place, name in enumerate(_NODES):
        peak = np.zeros(len(nodes))
        peak[place] = 1.0
        mass[:, PROPOSITIONS.index(name)] = np.interp(values, nodes, peak)
    mass[np.isnan(values)] = vacuous()
    return mass


@dataclass(frozen=True, slots=True)
class Row:
    """A row of a table: what each of its inputs must be, and the mass then."""

    when: Mapping[str, tuple[float, float] | frozenset[str]]
    mass: FloatArray

    def holds(self, values: Values) -> BoolArray:
        """Where all its conditions hold, (n,); not where an input is unknown."""
        met: BoolArray = np.ones(len(next(iter(values.values()))), np.bool_)
        for name, wanted in self.when.items():
            given = values[name]
            if isinstance(wanted, frozenset):
                met = met & np.isin(given, sorted(wanted))
            else:
                met = met & (given >= wanted[0]) & (given < wanted[1])
        return met


@dataclass(frozen=True, slots=True)
class RiskTable:
    """One source of an entity: a table of rows, of which the first that holds gives the mass."""

    name: str
    entity: str
    source: str
    rows: tuple[Row, ...]
    used: bool = True

    @property
    def words(self) -> tuple[str, ...]:
        """Words that its rows ask for, each once."""
        asked = (wanted for row in self.rows for wanted in row.when.values() if isinstance(wanted, frozenset))
        return tuple(dict.fromkeys(word for words in asked for word in sorted(words)))

    @property
    def inputs(self) -> tuple[str, ...]:
        """What it asks for."""
        return tuple(dict.fromkeys(name for row in self.rows for name in row.when))

    def look_up(self, values: Values) -> tuple[FloatArray, BoolArray]:
        """Masses (n, 8) and where the table knows the answer, (n,); Theta where it does not."""
        n = len(next(iter(values.values())))
        mass, known = vacuous(n), np.zeros(n, np.bool_)
        for row in self.rows:
            here = row.holds(values) & ~known
            mass[here] = row.mass
            known |= here
        return mass, known


@dataclass(frozen=True, slots=True)
class RiskTables:
    """A preset, or a user's own tables."""

    name: str
    text: str
    nodes: Mapping[str, float] | None
    tables: tuple[RiskTable, ...]

    def of(self, entity: str) -> tuple[RiskTable, ...]:
        """The tables in use for an entity, in their order."""
        return tuple(table for table in self.tables if table.entity == entity and table.used)


def tables_of(document: Mapping[str, Any], base: RiskTables | None = None) -> RiskTables:
    """Tables from what a TOML document says; ``base`` is what it extends.

    Its own tables replace those of the same name; ``use`` and ``without`` switch tables on and off.

    Raises
    ------
    InvalidInputError
        That names table and row: masses that do not sum to 1, an unknown input, a rate without a mean, and so on.
    """
    known = ("name", "text", "extends", "use", "without", "nodes", "table")
    if unknown := [key for key in document if key not in known]:
        raise InvalidInputError(f"unknown key '{unknown[0]}': expected {', '.join(known)}")
    nodes = base.nodes if base is not None else None
    if "nodes" in document:
        nodes = _nodes(document["nodes"])
    listed = document.get("table", [])
    if not isinstance(listed, list) or not all(isinstance(one, Mapping) for one in listed):
        raise InvalidInputError("'table' is no list of tables: expected [[table]] sections")
    found = {table.name: table for table in (base.tables if base is not None else ())}
    for entry in listed:
        table = _table(entry, nodes)
        found[table.name] = table
    for key, used in (("use", True), ("without", False)):
        for name in _strings(document, key):
            if name not in found:
                raise InvalidInputError(f"{key} names table '{name}': expected one of {', '.join(found)}")
            old = found[name]
            found[name] = RiskTable(old.name, old.entity, old.source, old.rows, used)
    if not found:
        raise InvalidInputError('no table: expected [[table]] sections, or extends = "default"')
    name, text = document.get("name", "own"), document.get("text", "")
    return RiskTables(str(name), str(text), nodes, tuple(found.values()))


def _table(entry: Mapping[str, Any], nodes: Mapping[str, float] | None) -> RiskTable:
    name = entry.get("name")
    if not isinstance(name, str) or not name:
        raise InvalidInputError('a table has no name: expected name = "…" in each [[table]]')
    where = f"table '{name}'"
    allowed = ("name", "entity", "source", "unit", "mean", "scale", "used", "note", "rows")
    if unknown := [key for key in entry if key not in allowed]:
        raise InvalidInputError(f"{where}: unknown key '{unknown[0]}': expected {', '.join(allowed)}")
    entity, source, rows = entry.get("entity"), entry.get("source"), entry.get("rows")
    if entity not in (DRIVER, ENVIRONMENT):
        raise InvalidInputError(f"{where}: entity is {entity!r}: expected '{DRIVER}' or '{ENVIRONMENT}'")
    if not isinstance(source, str) or not source:
        raise InvalidInputError(f"{where}: no source: expected where its numbers come from, or that they are a choice")
    if not isinstance(rows, list) or not rows:
        raise InvalidInputError(f"{where}: no rows: expected rows = [{{ when = {{…}}, rate or mass = … }}, …]")
    made = []
    for i, row in enumerate(rows, 1):
        try:
            conditions = _conditions(row, entity)
            value = _mass_or_rate(row)
        except InvalidInputError as error:
            raise InvalidInputError(f"{where}, row {i}: {error}") from None
        made.append((conditions, value))
    masses = _masses(where, entry, [value for _, value in made], nodes)
    return RiskTable(
        name,
        entity,
        source,
        tuple(Row(when, mass) for (when, _), mass in zip(made, masses, strict=True)),
        bool(entry.get("used", True)),
    )


def _masses(
    where: str, entry: Mapping[str, Any], values: list[float | FloatArray], nodes: Mapping[str, float] | None
) -> list[FloatArray]:
    """Masses as given, and of rates by the table's mean or over its own range."""
    rates = [value for value in values if isinstance(value, float)]
    if not rates:
        return [value for value in values if not isinstance(value, float)]
    scale, mean = entry.get("scale", "mean"), entry.get("mean")
    if scale == "range":
        low, high = min(rates), max(rates)
        if not low < high:
            raise InvalidInputError(f'{where}: scale = "range" and all rates are {low:g}: expected different ones')
        at, over, first = list(_OF_RANGE), high - low, low
    elif scale == "mean":
        if nodes is None:
            raise InvalidInputError(f"{where}: has rates and there are no nodes: expected a [nodes] section")
        if isinstance(mean, bool) or not isinstance(mean, int | float) or not 0.0 < mean < math.inf:
            raise InvalidInputError(f"{where}: mean is {mean!r}: expected the mean rate, above 0")
        at, over, first = [nodes[name] for name in _NODES], float(mean), 0.0
    else:
        raise InvalidInputError(f'{where}: scale is {scale!r}: expected "mean" or "range"')
    return [
        crossfade(np.array([(value - first) / over]), at)[0] if isinstance(value, float) else value for value in values
    ]


def _mass_or_rate(row: Mapping[str, Any]) -> float | FloatArray:
    if ("mass" in row) == ("rate" in row):
        raise InvalidInputError("expected either a mass or a rate")
    if "mass" in row:
        if not isinstance(row["mass"], Mapping):
            raise InvalidInputError(f'mass is {row["mass"]!r}: expected such as {{ MR = 0.3, "LR|MR" = 0.7 }}')
        return mass_of(row["mass"])
    rate = row["rate"]
    if isinstance(rate, bool) or not isinstance(rate, int | float) or not 0.0 <= rate < math.inf:
        raise InvalidInputError(f"rate is {rate!r}: expected a number of 0 or more")
    return float(rate)


def _conditions(row: Any, entity: str) -> dict[str, tuple[float, float] | frozenset[str]]:
    when = row.get("when") if isinstance(row, Mapping) else None
    if not isinstance(when, Mapping) or not when:
        raise InvalidInputError("no condition: expected when = { … }")
    if unknown := [key for key in row if key not in ("when", "mass", "rate")]:
        raise InvalidInputError(f"unknown key '{unknown[0]}': expected when, and mass or rate")
    conditions: dict[str, tuple[float, float] | frozenset[str]] = {}
    for name, wanted in when.items():
        if _NUMBERS.get(name) == entity:
            conditions[name] = _range(name, wanted)
        elif name in _WORDS and _WORDS[name][0] == entity:
            conditions[name] = _words(name, wanted)
        else:
            fit = [n for n, e in _NUMBERS.items() if e == entity] + [n for n, (e, _) in _WORDS.items() if e == entity]
            raise InvalidInputError(f"unknown input '{name}' of the {entity}: expected {', '.join(fit)}")
    return conditions


def _range(name: str, wanted: Any) -> tuple[float, float]:
    """A number, or from one up to another."""
    bounds = wanted if isinstance(wanted, list) else [wanted, wanted + 1 if isinstance(wanted, int) else None]
    if len(bounds) == 2 and all(isinstance(b, int | float) and not isinstance(b, bool) for b in bounds):
        low, high = float(bounds[0]), float(bounds[1])
        if low < high:
            return low, high
    raise InvalidInputError(f"{name} = {wanted!r}: expected a whole number, or [from, up to]")


def _words(name: str, wanted: Any) -> frozenset[str]:
    words = [wanted] if isinstance(wanted, str) else wanted
    known = _WORDS[name][1]
    if not isinstance(words, list) or not words or not all(isinstance(word, str) and word for word in words):
        raise InvalidInputError(f"{name} = {wanted!r}: expected a word or a list of words")
    for word in words:
        if known is not None and word not in known:
            raise InvalidInputError(f"{name} = '{word}': expected one of {', '.join(known)}")
    return frozenset(words)


def _nodes(given: Any) -> dict[str, float]:
    if not isinstance(given, Mapping) or not all(isinstance(given.get(name), int | float) for name in _NODES):
        raise InvalidInputError(f"nodes: expected a relative rate for each of {', '.join(_NODES)}")
    nodes = {name: float(given[name]) for name in _NODES}
    rates = list(nodes.values())
    if not all(low < high for low, high in itertools.pairwise(rates)):
        raise InvalidInputError(f"nodes: {rates}: expected rates that rise from LR to HR")
    return nodes


def _strings(document: Mapping[str, Any], key: str) -> list[str]:
    names = document.get(key, [])
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise InvalidInputError(f"{key} is {names!r}: expected a list of tables' names")
    return names
