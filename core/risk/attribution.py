"""How much each source has to do with a result: exact Shapley values over all 2^n coalitions of sources."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from core.errors import InvalidInputError
from core.measurements import FloatArray
from core.risk.belief import pignistic, vacuous
from core.risk.combination import combine

MAX_SOURCES: Final = 12
"""4096 fusions."""


def shapley(values: FloatArray) -> FloatArray:
    """Shapley values (n, ...) of n players from the value of each coalition, (2^n, ...).

    A coalition is the bit mask of its players. The values of the players sum to that of all less that of none
    (Shapley 1953).
    """
    n = len(values).bit_length() - 1
    if len(values) != 1 << n:
        raise InvalidInputError(f"{len(values)} coalitions: expected a power of 2")
    weight = [math.factorial(size) * math.factorial(n - size - 1) / math.factorial(n) for size in range(n)]
    out = np.zeros((n, *values.shape[1:]))
    for player in range(n):
        for coalition in range(1 << n):
            if not coalition >> player & 1:
                gain = values[coalition | 1 << player] - values[coalition]
                out[player] += weight[coalition.bit_count()] * gain
    return out


def attribute(masses: FloatArray, rule: str = "pcr6") -> FloatArray:
    """What each source adds to the pignistic probabilities of LR, MR, HR over knowing nothing (1/3 each).

    Parameters
    ----------
    masses : (k, 8) or (n, k, 8), at most ``MAX_SOURCES`` sources
    rule : by which coalitions are combined

    Returns
    -------
    (k, 3) or (k, n, 3); sums over the sources to the fused probabilities less 1/3. NaN where a coalition's fusion is
    undefined.
    """
    k = masses.shape[-2]
    if k > MAX_SOURCES:
        raise InvalidInputError(f"{k} sources: expected at most {MAX_SOURCES} for exact attribution")
    values = [pignistic(vacuous(*masses.shape[:-2]))]
    for coalition in range(1, 1 << k):
        members = [source for source in range(k) if coalition >> source & 1]
        values.append(pignistic(combine(masses[..., members, :], rule)[0]))
    return shapley(np.array(values))
