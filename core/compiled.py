"""How loops are compiled that work on their callers' arrays alone."""

from __future__ import annotations

from typing import Any

from numba import njit


def compiled(**options: Any) -> Any:
    """Decorator of a function that neither makes arrays nor gives any back; ``options`` are numba's.

    Such a function need not count references to arrays: its caller holds them as long as it runs. Counting costs
    more than the small algebra between (measured: a third of the filter's time, and most of a call's own).
    """
    settings: dict[str, Any] = {"cache": True, "nogil": True, "_nrt": False, **options}
    return njit(**settings)
