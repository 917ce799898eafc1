"""Fewer points for a plot, with its extremes kept: what stands out in all rows stands out in those drawn."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from core.measurements import FloatArray

LINE_POINTS: Final = 4_000
"""Points of a drawn line: twice the pixels of a wide screen, so that thinning is not seen until one zooms in."""

IndexArray = npt.NDArray[np.intp]


def extremes(values: FloatArray, limit: int = LINE_POINTS) -> IndexArray:
    """Indices of some ``limit`` values of a series (n,), in order: each stretch's first, smallest and greatest.

    The first of each run of NaN stays, so that a gap of the line is still one.
    """
    n = len(values)
    if n <= limit:
        return np.arange(n)
    size = -(-n // max(limit // 3, 1))
    padded = np.full(-(-n // size) * size, np.nan)
    padded[:n] = values
    stretches = padded.reshape(-1, size)
    starts = np.arange(len(stretches)) * size
    unknown = np.isnan(values)
    gaps = np.flatnonzero(unknown & ~np.concatenate([[False], unknown[:-1]]))
    lowest = starts + np.where(np.isnan(stretches), np.inf, stretches).argmin(axis=1)
    highest = starts + np.where(np.isnan(stretches), -np.inf, stretches).argmax(axis=1)
    kept = np.unique(np.concatenate([starts, lowest, highest, gaps, [n - 1]]))
    return np.asarray(kept[kept < n])


def evenly(count: int, limit: int) -> IndexArray:
    """Indices of at most ``limit`` of ``count`` rows, the first and the last among them."""
    if count <= limit:
        return np.arange(count)
    return np.unique(np.linspace(0, count - 1, limit).round().astype(np.intp))
