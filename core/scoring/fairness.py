"""Fairness: what scores are by age and sex, where these are known, and whether claims bear the differences out."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Final

from core.errors import InvalidInputError
from core.risk.driver import OLDEST, Driver
from core.scoring.credibility import NORMAL_95, poisson_interval

AGE_BANDS: Final = ((14, 25), (25, 45), (45, 65), (65, OLDEST + 1))
"""From, and up to; as US 2016-17 tells fatal crashes (PMC7403895, table 2)."""
UNKNOWN: Final = "unknown"
_FEWEST: Final = 2
"""With fewer in a group there is no spread to tell."""


@dataclass(frozen=True, slots=True)
class Scored:
    """One driver: who, where known, his score, the claims that it predicts, the claims that there were.

    Parameters
    ----------
    true_claims : the expected claims, where one knows them as in a simulation

    Raises
    ------
    InvalidInputError
        If the age is no driver's, the sex neither M nor F, or a number is no finite one of 0 or more.
    """

    age: int | None
    sex: str | None
    score: float
    predicted: float
    claims: int
    true_claims: float | None = None

    def __post_init__(self) -> None:
        Driver(self.age, self.sex)
        for name in ("score", "predicted", "claims", "true_claims"):
            value = getattr(self, name)
            if value is not None and not 0.0 <= value < math.inf:
                raise InvalidInputError(f"{name} is {value!r}: expected a number of 0 or more")


def fairness(rows: Iterable[Scored]) -> dict[str, Any]:
    """By age band, by sex and by both: scores, claims actual over predicted, and the gap that risk does not explain.

    ``gap`` is the group's mean score less that of all the others. ``controlled_gap`` is the same of what is left of the
    score after a straight line in the log of the true rate (None where that is not known): what a group has beyond what
    its risk explains. ``actual_over_predicted`` has the exact interval of a Poisson count (Garwood 1936).

    Raises
    ------
    InvalidInputError
        If there is nobody.
    """
    listed = list(rows)
    if not listed:
        raise InvalidInputError("nobody is scored: expected one driver or more")
    left = _residuals(listed)
    keys: dict[str, Callable[[Scored], str]] = {
        "age": _age_band,
        "sex": lambda row: row.sex or UNKNOWN,
        "age_and_sex": lambda row: f"{_age_band(row)} {row.sex or UNKNOWN}",
    }
    return {
        "drivers": len(listed),
        "unknown_share": {
            "age": sum(row.age is None for row in listed) / len(listed),
            "sex": sum(row.sex is None for row in listed) / len(listed),
        },
        "groups": {name: _groups(listed, [key(row) for row in listed], left) for name, key in keys.items()},
    }


def _age_band(row: Scored) -> str:
    if row.age is None:
        return UNKNOWN
    low, high = next(band for band in AGE_BANDS if band[0] <= row.age < band[1])
    return f"{low}+" if high > OLDEST else f"{low}-{high - 1}"


def _groups(rows: Sequence[Scored], groups: Sequence[str], left: Sequence[float] | None) -> list[dict[str, Any]]:
    told = []
    for group in sorted(set(groups), key=lambda one: (UNKNOWN in one, one)):
        inside = [i for i, one in enumerate(groups) if one == group]
        outside = [i for i, one in enumerate(groups) if one != group]
        claims = sum(rows[i].claims for i in inside)
        predicted = math.fsum(rows[i].predicted for i in inside)
        ratio = None if predicted <= 0.0 else claims / predicted
        told.append(
            {
                "group": group,
                "drivers": len(inside),
                "mean_score": math.fsum(rows[i].score for i in inside) / len(inside),
                "claims": claims,
                "predicted": predicted,
                "actual_over_predicted": ratio,
                "actual_over_predicted_interval95": (
                    None if ratio is None else [end / predicted for end in poisson_interval(claims)]
                ),
                "gap": _gap([row.score for row in rows], inside, outside),
                "controlled_gap": None if left is None else _gap(left, inside, outside),
            }
        )
    return told


def _gap(values: Sequence[float], inside: Sequence[int], outside: Sequence[int]) -> dict[str, Any] | None:
    """Difference of means with its interval (Welch); None where a side has too few."""
    if min(len(inside), len(outside)) < _FEWEST:
        return None
    (mean, var), (other, other_var) = (_mean([values[i] for i in side]) for side in (inside, outside))
    half = NORMAL_95 * math.sqrt(var / len(inside) + other_var / len(outside))
    return {"points": mean - other, "interval95": [mean - other - half, mean - other + half]}


def _mean(values: Sequence[float]) -> tuple[float, float]:
    mean = math.fsum(values) / len(values)
    return mean, math.fsum((value - mean) ** 2 for value in values) / (len(values) - 1)


def _residuals(rows: Sequence[Scored]) -> list[float] | None:
    """Scores less their straight line in the log of the true rate; None where a rate is not known."""
    rates = [row.true_claims for row in rows if row.true_claims]
    if len(rates) != len(rows):
        return None
    ln = [math.log(rate) for rate in rates]
    middle, score = math.fsum(ln) / len(ln), math.fsum(row.score for row in rows) / len(rows)
    spread = math.fsum((one - middle) ** 2 for one in ln)
    together = math.fsum((one - middle) * (row.score - score) for one, row in zip(ln, rows, strict=True))
    slope = together / spread if spread > 0.0 else 0.0
    return [row.score - score - slope * (one - middle) for one, row in zip(ln, rows, strict=True)]
