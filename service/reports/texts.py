"""Numbers as a reader wants them."""

from __future__ import annotations

import math


def number(value: float | None, unit: str = "", decimals: int = 2) -> str:
    """A value with its unit; a dash where there is none."""
    if value is None or not math.isfinite(value):
        return "–"
    joined = "" if unit in ("", "°", "%") else " "
    return f"{value:.{decimals}f}{joined}{unit}"


def percent(share: float, decimals: int = 1) -> str:
    """A share in per cent, never rounded up to all of it."""
    if not math.isfinite(share):
        return "–"
    shown = 100.0 * share
    if share < 1.0:
        shown = min(shown, 100.0 - 10.0**-decimals)
    return f"{shown:.{decimals}f} %"
