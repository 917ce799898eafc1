"""Discounting: what a mass is worth when its source may be wrong.

Successive instants are dependent evidence: they are averaged (``aged`` lets older ones fade), never combined.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.special import erfc

from core.errors import InvalidInputError
from core.measurements import FloatArray
from core.risk.belief import N_SETS, SINGLETONS, THETA

_CONTEXTS: Final = tuple(1 << bit for bit in range(len(SINGLETONS)))


def discount(mass: FloatArray, alpha: npt.ArrayLike) -> FloatArray:
    """Shafer's discounting, (..., 8): the share ``alpha``, 0 to 1, of every mass goes to Theta (Shafer 1976)."""
    rate = _rate(alpha)[..., None]
    out = (1.0 - rate) * mass
    out[..., THETA] += rate[..., 0] * mass.sum(axis=-1)
    return np.asarray(out)


def discount_contextual(mass: FloatArray, alpha: npt.ArrayLike) -> FloatArray:
    """Contextual discounting, (..., 8) (Mercier, Quost & Denoeux 2008, eq. 32, for the contexts LR, MR, HR).

    Parameters
    ----------
    mass : (..., 8)
    alpha : (..., 3), how likely the source is wrong where the truth is LR, MR, HR, each 0 to 1: a mass is combined
        disjunctively with {empty: 1 - alpha_c, c: alpha_c} of each context c.
    """
    rates = _rate(alpha)
    if rates.shape[-1:] != (len(SINGLETONS),):
        raise InvalidInputError(f"rates of shape {rates.shape}: expected one each for {', '.join(SINGLETONS)}")
    out = np.broadcast_to(mass, (*np.broadcast_shapes(mass.shape[:-1], rates.shape[:-1]), N_SETS)).copy()
    for place, context in enumerate(_CONTEXTS):
        rate = rates[..., place]
        for proposition in range(N_SETS):
            if not proposition & context:
                moved = rate * out[..., proposition]
                out[..., proposition | context] += moved
                out[..., proposition] -= moved
    return out


def chance_of_exceeding(half_width: npt.ArrayLike, sd: npt.ArrayLike) -> FloatArray:
    """P(\\|error\\| > half a class width) of a normal error: 0 where the sd is 0, 1 where it is not known (NaN)."""
    sd_, half = np.broadcast_arrays(np.asarray(sd, float), np.asarray(half_width, float))
    ratio = np.divide(half, sd_, out=np.full(sd_.shape, np.inf), where=sd_ > 0.0)
    return np.where(np.isnan(sd_), 1.0, erfc(ratio / math.sqrt(2.0)))


def aged(age_s: npt.ArrayLike, half_life_s: float) -> FloatArray:
    """How much a mass of that age is to be discounted, 0 to 1, when half of what it says fades in a half-life."""
    if not half_life_s > 0.0:
        raise InvalidInputError(f"half-life of {half_life_s:g} s: expected more than 0")
    return np.asarray(1.0 - 0.5 ** (np.maximum(np.asarray(age_s, float), 0.0) / half_life_s))


def _rate(alpha: npt.ArrayLike) -> FloatArray:
    rate = np.asarray(alpha, float)
    if not ((rate >= 0.0) & (rate <= 1.0)).all():
        raise InvalidInputError("a discount rate is outside 0 to 1")
    return rate
