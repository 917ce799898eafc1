"""The driver: age, sex and experience, each of which may be left out, as the law demands in places."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from core.errors import InvalidInputError
from core.risk.lookup import Values

YOUNGEST, OLDEST = 14, 110
"""Ages of drivers: from the youngest with a permit anywhere (parts of the USA) to older than any."""
SEXES: Final = ("M", "F")


@dataclass(frozen=True, slots=True)
class Driver:
    """What is known of a driver; None is left out and nothing is made of it.

    Raises
    ------
    InvalidInputError
        If the age is no driver's, the sex neither M nor F, or the experience longer than the age allows.
    """

    age: int | None = None
    sex: str | None = None
    experience_years: float | None = None

    def __post_init__(self) -> None:
        if self.age is not None and not YOUNGEST <= self.age <= OLDEST:
            raise InvalidInputError(f"driver's age is {self.age}: expected {YOUNGEST} to {OLDEST}, or none at all")
        if self.sex is not None and self.sex not in SEXES:
            raise InvalidInputError(f"driver's sex is '{self.sex}': expected M or F, or none at all")
        if self.experience_years is not None:
            most = (OLDEST if self.age is None else self.age) - YOUNGEST
            if not 0.0 <= self.experience_years <= most:
                raise InvalidInputError(
                    f"driver's experience is {self.experience_years:g} years: expected 0 to {most}, or none at all"
                )

    def values(self) -> Values:
        """As inputs of the driver's tables, one instant: they are the same for a whole drive."""
        return {
            "age": np.array([np.nan if self.age is None else float(self.age)]),
            "experience": np.array([np.nan if self.experience_years is None else self.experience_years]),
            "sex": np.array([self.sex or ""]),
        }
