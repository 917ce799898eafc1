"""A table of districts from a user's own CSV of rates, as TOML that the risk tables read."""

from __future__ import annotations

import csv
import io
import json
import math
from pathlib import Path
from typing import Final

from service.errors import UsageError

_EXPECTED: Final = "expected CSV with columns district and rate, and if there is one, exposure"


def district_table(path: Path, source: str) -> str:
    """Tables of one's own, in TOML: the default ones, and for each district of the CSV its rate.

    A rate is relative to the mean over the districts: weighed by exposure where there is such a column. Raises
    UsageError that names the bad line.
    """
    rates, mean = _read(path)
    lines = [
        'extends = "default"',
        f'name = "districts of {path.name}"',
        "",
        "[[table]]",
        'name = "district"',
        'entity = "environment"',
        f"source = {_quoted(source)}",
        f"mean = {mean!r}",
        "rows = [",
        *(f"    {{ when = {{ district = {_quoted(name)} }}, rate = {rate!r} }}," for name, rate in rates.items()),
        "]",
        "",
    ]
    return "\n".join(lines)


def district_relativities(path: Path) -> dict[str, float]:
    """Each district's rate over the mean, for the score model; raises UsageError that names the bad line."""
    rates, mean = _read(path)
    if nothing := [name for name, rate in rates.items() if not rate > 0.0]:
        raise UsageError(f"{path}: {nothing[0]} has a rate of 0; expected more, as no place is without risk")
    return {name: rate / mean for name, rate in rates.items()}


def _read(path: Path) -> tuple[dict[str, float], float]:
    """Rates by district, and their mean by exposure."""
    try:
        text = path.read_text("utf-8-sig")
    except OSError as error:
        raise UsageError(f"{path}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise UsageError(f"{path}: is no UTF-8 text; {_EXPECTED}") from error
    rows = csv.DictReader(io.StringIO(text))
    columns = rows.fieldnames or ()
    if missing := {"district", "rate"} - set(columns):
        raise UsageError(f"{path}: no column {' or '.join(sorted(missing))}; {_EXPECTED}")
    rates: dict[str, float] = {}
    weights: dict[str, float] = {}
    for row in rows:
        where, name = f"{path}, line {rows.line_num}", (row["district"] or "").strip()
        if not name:
            raise UsageError(f"{where}: no district; {_EXPECTED}")
        if name in rates:
            raise UsageError(f"{where}: {name} is there twice; expected each district once")
        rates[name] = _number(where, "rate", row["rate"])
        weights[name] = _number(where, "exposure", row["exposure"]) if "exposure" in columns else 1.0
    if not rates or not math.fsum(weights.values()) > 0.0:
        raise UsageError(f"{path}: no district with an exposure; {_EXPECTED}")
    mean = math.fsum(rate * weights[name] for name, rate in rates.items()) / math.fsum(weights.values())
    if not mean > 0.0:
        raise UsageError(f"{path}: the mean rate is 0; expected a district with a rate above 0")
    return rates, mean


def _number(where: str, column: str, text: str | None) -> float:
    try:
        value = float(text or "")
    except ValueError:
        value = math.nan
    if not 0.0 <= value < math.inf:
        raise UsageError(f"{where}: {column} is {text!r}; expected a number of 0 or more")
    return value


def _quoted(text: str) -> str:
    """A basic string of TOML, which writes what JSON does the same way, but for DEL."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
