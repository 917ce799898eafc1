"""Distance and time by H3 cell as bytes: a year of them is read and added up in a millisecond.

n cells are 24 n bytes, little-endian: their indices (uint64, increasing; 0 where the cell is not known), then
millimetres, then milliseconds (int64).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from core.driving.exposure import UNKNOWN, Driven

_Columns = tuple[npt.NDArray[np.uint64], npt.NDArray[np.int64]]


def packed(cells: Mapping[str, Driven]) -> bytes:
    """Bytes of what was driven in cells."""
    index = np.array([int(cell or "0", 16) for cell in cells], np.uint64)
    driven = np.array([tuple(one) for one in cells.values()], np.int64).reshape(-1, 2)
    return _bytes(*_summed(index, driven.T))


def added(parts: Sequence[bytes]) -> bytes:
    """Bytes of the sum."""
    return _bytes(*_sum_of(parts))


def unpacked(parts: Sequence[bytes]) -> dict[str, Driven]:
    """The sum, by cell."""
    index, driven = _sum_of(parts)
    names = [f"{one:x}" if one else UNKNOWN for one in index.tolist()]
    return dict(zip(names, map(Driven, *driven.tolist()), strict=True)) if names else {}


def distances_mm(part: bytes) -> dict[int, int]:
    """By a cell's index how far was driven in it, but for what is in none that is known."""
    index, distance_mm, _ = np.frombuffer(part, "<i8").reshape(3, -1).tolist()
    return {cell: mm for cell, mm in zip(index, distance_mm, strict=True) if cell and mm}


def _sum_of(parts: Sequence[bytes]) -> _Columns:
    columns = [np.frombuffer(part, "<i8").reshape(3, -1) for part in parts]
    if not columns:
        return np.empty(0, np.uint64), np.empty((2, 0), np.int64)
    every = np.concatenate(columns, axis=1)
    return _summed(every[0].astype(np.uint64), every[1:])


def _summed(index: npt.NDArray[np.uint64], driven: npt.NDArray[np.int64]) -> _Columns:
    order = np.argsort(index, kind="stable")
    index, driven = index[order], driven[:, order]
    first = np.flatnonzero(np.diff(index, prepend=index[:1] + np.uint64(1)) != 0)
    return index[first], np.add.reduceat(driven, first, axis=1) if first.size else driven


def _bytes(index: npt.NDArray[np.uint64], driven: npt.NDArray[np.int64]) -> bytes:
    return index.astype("<u8").tobytes() + driven.astype("<i8").tobytes()
