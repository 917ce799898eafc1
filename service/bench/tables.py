"""Tables of figures for people: aligned columns, and what was asked beside what was measured."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any


def aligned(rows: Sequence[Sequence[str]], left: Sequence[int] = (0,)) -> Iterable[str]:
    """Rows of cells in columns, numbers to the right."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    for row in rows:
        cells = (
            f"{cell:<{width}}" if i in left else f"{cell:>{width}}"
            for i, (cell, width) in enumerate(zip(row, widths, strict=True))
        )
        yield ("  " + "  ".join(cells)).rstrip()


def verdicts(found: Sequence[Mapping[str, Any]]) -> Iterable[str]:
    """Each target with its measured value and its limit."""
    yield "asked and measured:"
    rows = [("figure", "measured", "at most", "")]
    for one in found:
        verdict = "met" if one["met"] else "missed"
        if (floor := one.get("floor")) is not None:
            verdict += f"; {_value(floor, one['unit'])} with all but what it is compared with"
        rows.append((one["text"], _value(one["value"], one["unit"]), _value(one["at_most"], one["unit"]), verdict))
    yield from aligned(rows, left=(0, 3))


def _value(value: float | None, unit: str) -> str:
    if value is None:
        return "none"
    if unit == "m":
        return f"{value:.2f}"
    return f"{value:.3g} {unit}".rstrip()
