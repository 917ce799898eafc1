"""What a recording of static positions cannot tell of a triad, and which positions would: in numbers and in words."""

from __future__ import annotations

import itertools
import math
from typing import Final

import numpy as np
import numpy.typing as npt

from core.calibration.fit import PARAMETERS, Observability
from core.measurements import FloatArray
from core.sensors import AXES, Triple, triple

WEAK: Final = 0.2
"""Share of a parameter's prior sd that is left when it is called weak. Calibrating was hardly worth the trouble: of
the accelerometer's prior it is 1 % of scale, 6 mrad and 0.2 m/s2."""

ENOUGH: Final = 0.5
"""Positions are asked for until a parameter would be left with that share of what is weak: noise may be greater."""

ABSURD_SD: Final = 3.0
"""Prior standard deviations off which a value is called absurd, however well the fit says to know it."""

MOST_ADDED: Final = 9
"""Positions that are asked for at most: as many as there are parameters."""

_DIRECTIONS: Final = [
    np.array(signs) / math.sqrt(sum(abs(sign) for sign in signs))
    for signs in itertools.product((1, 0, -1), repeat=3)
    if any(signs)
]
CANDIDATES: Final = np.array(sorted(_DIRECTIONS, key=lambda up: float(np.count_nonzero(up))))
"""Directions of up (26, 3) that a hand finds without a tool: a box's faces, then its edges, then its corners."""


def is_weak(sd: FloatArray, prior_sd: FloatArray) -> npt.NDArray[np.bool_]:
    """Which parameters (p,) a recording tells hardly better than was known before; of what was known for sure none."""
    return np.asarray((sd > WEAK * prior_sd) & (prior_sd > 0.0))


def judge(
    prior_sd: FloatArray,
    deviation: FloatArray,
    information: FloatArray,
    posterior: FloatArray,
    candidate_rows: FloatArray,
    names: tuple[str, ...] = PARAMETERS,
) -> Observability:
    """Which parameters are weak, and which of ``CANDIDATES`` to add.

    Parameters
    ----------
    prior_sd : (p,) of the parameters, dimensionless
    deviation : (p,) of the values that were found from what was expected, in the same
    information : (p, p) that the recording alone gives
    posterior : (p, p) covariance, prior and recording together
    candidate_rows : (26, p) derivative of the residual of a position in each of ``CANDIDATES``, over its sd
    """
    absurd = np.abs(deviation) > ABSURD_SD * prior_sd
    weak = absurd | is_weak(np.sqrt(np.diag(posterior)), prior_sd)
    added = _additions(posterior, prior_sd, candidate_rows, absurd) if weak.any() else []
    found = tuple(name for name, one in zip(names, weak, strict=True) if one)
    add = tuple(triple(CANDIDATES[i]) for i in added)
    return Observability(found, _condition(information), add, _advice(found, absurd, add, names))


def describe_up(up: Triple) -> str:
    """How to lay a box so that this direction (unit, sensor axes) is up, in words."""
    sides = [f"{axis} {'up' if part > 0.0 else 'down'}" for axis, part in zip(AXES, up, strict=True) if part != 0.0]
    if len(sides) == 1:
        axis, way = sides[0].split()
        return f"the {axis} axis {way}"
    if len(sides) == 2:
        return f"{sides[0]} and {sides[1]}, on the edge at 45 degrees"
    return f"{sides[0]}, {sides[1]} and {sides[2]}, on the corner"


def _additions(
    posterior: FloatArray, prior_sd: FloatArray, rows: FloatArray, absurd: npt.NDArray[np.bool_]
) -> list[int]:
    """Greedily the position of the greatest information gain, 1/2 log(1 + j P j'), until nothing would be weak."""
    covariance, added = posterior, list[int]()
    while len(added) < MOST_ADDED:
        unclear = np.sqrt(np.diag(covariance)) > ENOUGH * WEAK * prior_sd
        if not unclear.any() and len(added) >= np.count_nonzero(absurd):
            break
        seen = np.einsum("ip,pq,iq->i", rows, covariance, rows)
        best = int(np.argmax(seen.round(9)))  # of equals the first: faces before edges before corners
        gain = covariance @ rows[best]
        covariance = covariance - np.outer(gain, gain) / (1.0 + seen[best])
        added.append(best)
    return added


def _condition(information: FloatArray) -> float:
    """Ratio of the greatest to the least eigenvalue; of a singular matrix what doubles can tell."""
    values = np.linalg.eigvalsh(information)
    return float(values[-1] / max(values[0], values[-1] * np.finfo(float).eps, 1e-300))


def _advice(
    weak: tuple[str, ...], absurd: npt.NDArray[np.bool_], add: tuple[Triple, ...], names: tuple[str, ...]
) -> str:
    if not weak:
        return ""
    strange = [name for name, one in zip(names, absurd, strict=True) if one]
    off = f" ({_list(strange)} came out absurd)" if strange else ""
    places = ", then with ".join(describe_up(up) for up in dict.fromkeys(add))
    return f"These positions do not tell {_list(list(weak))}{off}: record again and hold it also with {places}."


def _list(names: list[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
