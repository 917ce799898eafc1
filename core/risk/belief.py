"""The frame {LR, MR, HR}: propositions by name, and what a mass says: belief, plausibility, pignistic, decision.

Every function takes one mass (8,) or an array of them (..., 8) and works element-wise.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np
import numpy.typing as npt

from core.errors import InvalidInputError
from core.measurements import FloatArray

SINGLETONS: Final = ("LR", "MR", "HR")
"""Low, medium, high risk; the bit of each is 1 << its place here."""
LR, MR, HR = 1, 2, 4
EMPTY, THETA = 0, 7
N_SETS: Final = 8

PROPOSITIONS: Final = tuple(
    "|".join(name for bit, name in enumerate(SINGLETONS) if proposition >> bit & 1) for proposition in range(N_SETS)
)
"""Name of each proposition by its bit mask: ``""`` the empty set, ``LR|MR``, …, ``LR|MR|HR`` Theta."""
_INDEX: Final = {name: index for index, name in enumerate(PROPOSITIONS)}

CARDINALITY: Final = np.array([index.bit_count() for index in range(N_SETS)])

SUM_TOLERANCE: Final = 1e-6
"""How far the masses of one source may be from summing to 1: what six written decimals leave; a choice."""

ABSTAINED: Final = -1
"""What a decision is where none can be made."""
_TIE: Final = 1e-12
"""Values that differ by less are equal: what rounding leaves of sums of 8."""

# Columns of what is summed: IN[x] are the propositions within x (the empty one apart), HITS[x] those that meet x.
_IN: Final = np.array([[float(y != 0 and y & ~x == 0) for x in range(N_SETS)] for y in range(N_SETS)])
_HITS: Final = np.array([[float(y & x != 0) for x in range(N_SETS)] for y in range(N_SETS)])
_SHARES: Final = np.array([[float(y >> bit & 1) / max(y.bit_count(), 1) for bit in range(3)] for y in range(N_SETS)])


def vacuous(*shape: int) -> FloatArray:
    """Masses that say nothing, all on Theta, (*shape, 8)."""
    mass = np.zeros((*shape, N_SETS))
    mass[..., THETA] = 1.0
    return mass


def mass_of(named: Mapping[str, float]) -> FloatArray:
    """A mass (8,) from its propositions by name.

    Raises
    ------
    InvalidInputError
        If a name is unknown, a value is no number from 0 to 1, or the sum is not 1.
    """
    mass = np.zeros(N_SETS)
    for name, value in named.items():
        if name not in _INDEX:
            raise InvalidInputError(
                f"unknown proposition '{name}': expected one of {', '.join(PROPOSITIONS[1:])},"
                ' or "" for the empty set'
            )
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 <= value <= 1.0 + SUM_TOLERANCE:
            raise InvalidInputError(f"mass of '{name}' is {value!r}: expected a number from 0 to 1")
        mass[_INDEX[name]] = value
    total = float(mass.sum())
    if abs(total - 1.0) > SUM_TOLERANCE:
        raise InvalidInputError(f"masses sum to {total:.9g}: expected 1")
    return mass


def named(mass: FloatArray) -> dict[str, float]:
    """A mass, or another figure of each proposition, (8,), by name."""
    return {name: float(value) for name, value in zip(PROPOSITIONS, mass, strict=True)}


def belief(mass: FloatArray) -> FloatArray:
    """Bel of each proposition, (..., 8): all mass within it but that of the empty set (eq. 9)."""
    return _summed(mass, _IN)


def plausibility(mass: FloatArray) -> FloatArray:
    """Pl of each proposition, (..., 8): all mass that does not contradict it."""
    return _summed(mass, _HITS)


def pignistic(mass: FloatArray) -> FloatArray:
    """BetP of LR, MR, HR, (..., 3): each mass in equal parts to its members (Smets & Kennes 1994).

    NaN where all mass is on the empty set, or the mass itself is NaN.
    """
    there = 1.0 - mass[..., EMPTY, None]
    shared = _summed(mass, _SHARES)
    return np.asarray(np.divide(shared, there, out=np.full(shared.shape, np.nan), where=there > 0.0))


def decision(scores: FloatArray) -> npt.NDArray[np.int64]:
    """Place in ``SINGLETONS`` of the greatest of three scores (..., 3); ``ABSTAINED`` in a tie or for NaN."""
    ordered = np.sort(scores, axis=-1)
    clear = ordered[..., 2] - ordered[..., 1] > _TIE
    return np.where(clear, np.argmax(scores, axis=-1), ABSTAINED)


def decide(mass: FloatArray, by: str = "pignistic", *, abstain: bool = True) -> npt.NDArray[np.int64]:
    """Decide for LR, MR or HR, by its place in ``SINGLETONS``, or ``ABSTAINED``.

    Parameters
    ----------
    mass : (..., 8)
    by : ``belief`` (credibility), ``plausibility`` or ``pignistic``
    abstain : whether to abstain where the interval [Bel, Pl] of the one chosen overlaps another's: then some
        probability that the mass allows would decide otherwise. Without it only ties are left undecided.
    """
    lower, upper = belief(mass)[..., [LR, MR, HR]], plausibility(mass)[..., [LR, MR, HR]]
    choices = {"belief": lower, "plausibility": upper, "pignistic": pignistic(mass)}
    if by not in choices:
        raise InvalidInputError(f"decision by '{by}': expected one of {', '.join(choices)}")
    chosen = decision(choices[by])
    if not abstain:
        return chosen
    place = np.maximum(chosen, 0)[..., None]
    others = np.where(np.arange(3) == place, -np.inf, upper).max(axis=-1)
    clear = np.take_along_axis(lower, place, axis=-1)[..., 0] > others + _TIE
    return np.where(clear, chosen, ABSTAINED)


def _summed(mass: FloatArray, table: FloatArray) -> FloatArray:
    """Sums over propositions, in their order for any number of masses (BLAS would change the order with it)."""
    out = np.zeros((*mass.shape[:-1], table.shape[1]))
    for proposition in range(N_SETS):
        out += mass[..., proposition, None] * table[proposition]
    return out
