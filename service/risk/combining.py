"""Masses of sources as JSON, combined, and what comes out as JSON: what ``telefuse risk combine`` takes and tells."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from core.errors import InvalidInputError
from core.measurements import FloatArray
from core.risk.attribution import MAX_SOURCES, attribute
from core.risk.belief import (
    ABSTAINED,
    SINGLETONS,
    belief,
    decide,
    mass_of,
    named,
    pignistic,
    plausibility,
)
from core.risk.combination import RULES, combine
from service.errors import UsageError

_MEMBERS: Final = ("sources", "rule", "name", "id", "comment")
_EXPECTED: Final = 'expected {"sources": [{"MR": 0.3, "LR|MR": 0.7}, …]} or a list of such'


def combined(text: str, where: str, rule: str | None = None, *, explain: bool = False) -> Any:
    """Combine every case of a document; one object for one case, a list for a list.

    ``rule`` goes before a case's own; neither means pcr6. ``explain`` adds what each source contributes.
    Raises UsageError that says which case and source, and what was expected.
    """
    document = _parsed(text, where)
    if isinstance(document, dict):
        return _case(document, where, rule, explain)
    if not isinstance(document, list):
        raise UsageError(f"{where}: holds {_kind(document)}; {_EXPECTED}")
    if not document:
        raise UsageError(f"{where}: the list is empty; {_EXPECTED}")
    return [_case(case, f"{where}: case {i}", rule, explain) for i, case in enumerate(document, 1)]


def told(mass: FloatArray, conflict: float) -> dict[str, Any]:
    """A fused mass with all that it says; null where the rule is undefined or there is none."""
    by = ("belief", "plausibility", "pignistic")
    if np.isnan(mass).any():
        nothing = dict.fromkeys(("mass", *by, "decision"))
        return nothing | {"conflict": float(conflict)}
    chances = pignistic(mass)
    return {
        "mass": named(mass),
        "belief": named(belief(mass)),
        "plausibility": named(plausibility(mass)),
        "pignistic": _by_singleton(chances),
        "conflict": float(conflict),
        "decision": {name: _choice(decide(mass, name, abstain=False)) for name in by}
        | {"sure": _choice(decide(mass, "pignistic"))},
    }


def _case(case: Any, where: str, rule: str | None, explain: bool) -> dict[str, Any]:
    if not isinstance(case, dict):
        raise UsageError(f"{where}: is {_kind(case)}; {_EXPECTED}")
    if unknown := [name for name in case if name not in _MEMBERS]:
        raise UsageError(f"{where}: unknown key '{unknown[0]}'; expected 'sources', or beside it 'rule', 'name'")
    sources = case.get("sources")
    if not isinstance(sources, list) or not sources:
        found = "there is no 'sources'" if sources is None else f"'sources' is {_kind(sources)}"
        raise UsageError(f"{where}: {found}; expected a list of at least one source, each an object of masses")
    chosen = rule if rule is not None else case.get("rule", RULES[0])
    masses = _masses(sources, where)
    try:
        fused, conflict = combine(masses, chosen)
        result = told(fused, float(conflict))
        if explain:
            if len(masses) > MAX_SOURCES:
                raise InvalidInputError(f"{len(masses)} sources: expected at most {MAX_SOURCES} to explain")
            result["attribution"] = [_by_singleton(share) for share in attribute(masses, chosen)]
    except InvalidInputError as error:
        raise UsageError(f"{where}: {error}") from None
    return {name: case[name] for name in ("name", "id") if name in case} | result


def _masses(sources: Sequence[Any], where: str) -> FloatArray:
    rows = []
    for i, source in enumerate(sources, 1):
        if not isinstance(source, Mapping):
            raise UsageError(f'{where}: source {i} is {_kind(source)}; expected masses such as {{"MR": 1.0}}')
        try:
            rows.append(mass_of(source))
        except InvalidInputError as error:
            raise UsageError(f"{where}: source {i}: {error}") from None
    return np.array(rows)


def _parsed(text: str, where: str) -> Any:
    def unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        names = [name for name, _ in pairs]
        for name in names:
            if names.count(name) > 1:
                raise UsageError(f"{where}: key '{name}' stands twice in one object; expected each once")
        return dict(pairs)

    def refuse(constant: str) -> Any:
        raise UsageError(f"{where}: {constant} is no JSON number; expected masses from 0 to 1")

    try:
        return json.loads(text, object_pairs_hook=unique, parse_constant=refuse)
    except (ValueError, RecursionError) as error:
        raise UsageError(f"{where}: is no JSON: {error}; {_EXPECTED}") from None


def _choice(place: Any) -> str | None:
    return None if int(place) == ABSTAINED else SINGLETONS[int(place)]


def _by_singleton(values: FloatArray) -> dict[str, float | None]:
    return {name: None if np.isnan(v) else float(v) for name, v in zip(SINGLETONS, values, strict=True)}


def _kind(value: Any) -> str:
    kinds = {list: "a list", dict: "an object", str: "text", bool: "true or false", type(None): "null"}
    return "an empty list" if value == [] else kinds.get(type(value), "a number")
