"""Risk of places: relativities of H3 cells by empirical Bayes from a portfolio's own accidents and exposure."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from core.driving.exposure import UNKNOWN, Driven
from core.errors import InvalidInputError
from core.scoring.credibility import Shrunk, shape_by_moments
from core.scoring.numbers import digest, is_number


@dataclass(frozen=True, slots=True)
class Places:
    """Relativities of cells and their sd, by the portfolio's mean; with the digest of what they are.

    Parameters
    ----------
    shape : of the Gamma of relativities between cells
    """

    shape: float
    relativity: Mapping[str, float]
    sd: Mapping[str, float]
    sha256: str

    def to_json(self) -> dict[str, Any]:
        """As plain numbers, from which ``places_of`` makes the same."""
        cells = {cell: [self.relativity[cell], self.sd[cell]] for cell in sorted(self.relativity)}
        return {"shape": self.shape, "cells": cells}


def places_from(exposure: Mapping[str, Driven], accidents: Mapping[str, int]) -> Places:
    """Relativities of cells from what a portfolio drove in each, and how many accidents it had there.

    A cell's accidents are Poisson with mean E r, E by its share of the distance, r Gamma between cells with mean 1. The
    Gamma's variance is by moments (``shape_by_moments``), so cells without an accident are believed as far as they were
    driven in. Without an accident all cells are alike.

    Raises
    ------
    InvalidInputError
        If there is an accident in a cell where nothing was driven, or a number is below 0.
    """
    driven = {cell: one.distance_mm for cell, one in sorted(exposure.items()) if cell != UNKNOWN and one.distance_mm}
    counts = {cell: count for cell, count in accidents.items() if cell != UNKNOWN and count}
    for cell, number in (*driven.items(), *counts.items()):
        if number < 0:
            raise InvalidInputError(f"cell '{cell}' has {number}: expected distance and accidents of 0 or more")
    if strange := sorted(cell for cell in counts if cell not in driven):
        raise InvalidInputError(f"{counts[strange[0]]} accidents in cell '{strange[0]}', where nothing was driven")
    total, distance_mm = sum(counts.values()), sum(driven.values())
    expected = {cell: total * mm / distance_mm for cell, mm in driven.items()}
    shape = shape_by_moments([counts.get(cell, 0) for cell in expected], list(expected.values()))
    shrunk = {cell: Shrunk(shape, float(counts.get(cell, 0)), mean) for cell, mean in expected.items()}
    return _places(
        shape,
        {cell: one.mean for cell, one in shrunk.items()},
        {cell: math.sqrt(one.mean / (shape + one.expected)) for cell, one in shrunk.items()},
    )


def places_of(told: Mapping[str, Any]) -> Places:
    """What ``to_json`` told; raises InvalidInputError that names the cell."""
    cells, shape = told.get("cells"), told.get("shape", math.nan)
    if not isinstance(cells, Mapping) or not is_number(shape) or not shape > 0.0:
        raise InvalidInputError("no places: expected shape, above 0, and cells: {cell: [relativity, sd], …}")
    for cell, pair in cells.items():
        good = isinstance(pair, list) and len(pair) == 2 and all(is_number(one) and one >= 0.0 for one in pair)
        if not good or not pair[0] > 0.0:
            raise InvalidInputError(f"cell '{cell}' is {pair!r}: expected [relativity above 0, sd]")
    return _places(
        float(shape),
        {cell: float(pair[0]) for cell, pair in cells.items()},
        {cell: float(pair[1]) for cell, pair in cells.items()},
    )


def _places(shape: float, relativity: Mapping[str, float], sd: Mapping[str, float]) -> Places:
    content = {"shape": shape, "cells": {cell: [relativity[cell], sd[cell]] for cell in relativity}}
    return Places(shape, relativity, sd, digest(content))
