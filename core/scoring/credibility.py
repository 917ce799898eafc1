"""Credibility: what a driver's own figures are worth beside the portfolio's, and how sure the two together are.

A relative rate r, of which the portfolio's mean is 1, is Gamma with shape and rate ``shape`` between drivers; counts
are Poisson. What is believed after ``count`` where the portfolio's mean driver has ``expected`` is Gamma(shape + count,
shape + expected), whose mean is Buehlmann's: Z count / expected + 1 - Z, with Z = expected / (shape + expected). What
is no count (a distance, a share of time) takes part by how many counts it tells as much as.

References: Buehlmann & Gisler, *A Course in Credibility Theory* (2005), 2.4; Cornish & Fisher (1938).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

from scipy.special import gammaincinv

TAILS: Final = (0.025, 0.975)
"""Of an interval of 95 %."""
FLATTEST: Final = 1e4
"""Shape beyond which there is no difference: 1 % of sd."""
STEEPEST: Final = 0.25
"""Least shape: few counts would have it that nearly all of it is in a row or two. A choice."""
NORMAL_95: Final = 1.959963984540054
"""The normal's quantile there."""
_BEND: Final = 3.0 / (NORMAL_95**2 - 1.0)


class Estimate(NamedTuple):
    """A figure with its interval of 95 %, which holds it."""

    value: float
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class Shrunk:
    """A relative rate after ``count``, where the portfolio's mean driver has ``expected``; both 0 or more.

    Parameters
    ----------
    shape : of the portfolio's Gamma: 1 / spread^2, where spread is the sd between drivers over the mean
    """

    shape: float
    count: float
    expected: float

    @property
    def mean(self) -> float:
        """Posterior mean."""
        return (self.shape + self.count) / (self.shape + self.expected)

    @property
    def credibility(self) -> float:
        """Buehlmann's Z, from 0 to 1."""
        return self.expected / (self.shape + self.expected)

    @property
    def estimate(self) -> Estimate:
        """Posterior mean and exact quantiles."""
        shape, rate = self.shape + self.count, self.shape + self.expected
        low, high = (float(gammaincinv(shape, tail)) / rate for tail in TAILS)
        return Estimate(self.mean, min(low, self.mean), max(high, self.mean))


def shape_of(spread: float) -> float:
    """The Gamma's shape by the sd between drivers over the mean."""
    return 1.0 / (spread * spread)


def poisson_interval(count: int) -> tuple[float, float]:
    """The exact interval of 95 % of a mean of which so many were counted (Garwood 1936)."""
    low = float(gammaincinv(count, TAILS[0])) if count else 0.0
    return low, float(gammaincinv(count + 1, TAILS[1]))


def shape_by_moments(counts: Sequence[float], expected: Sequence[float]) -> float:
    """The Gamma's shape between rows, from their counts and what each would have at the mean rate.

    The variance of relative rates is (sum (n - E)^2 - sum E) / sum E^2 (Marshall 1991; Clayton & Kaldor 1987), E
    brought to as many as there were; within ``FLATTEST`` and ``STEEPEST``, the first where nothing was counted.
    """
    all_counts, all_expected = math.fsum(counts), math.fsum(expected)
    if not (all_counts > 0.0 and all_expected > 0.0):
        return FLATTEST
    means = [all_counts / all_expected * one for one in expected]
    squares = math.fsum((count - mean) ** 2 for count, mean in zip(counts, means, strict=True))
    variance = (squares - all_counts) / math.fsum(mean * mean for mean in means)
    return FLATTEST if variance <= 1.0 / FLATTEST else max(1.0 / variance, STEEPEST)


def summed(parts: Iterable[Estimate], correlation: float = 0.0) -> Estimate:
    """The sum of estimates, whose skewness it keeps; exact for one.

    By Cornish & Fisher's first term an interval is value + sd (-+z + skewness (z^2 - 1) / 6), so that an estimate tells
    its own sd and third cumulant, which add. The interval of the sum of six exponentials, as of drivers whose spread is
    1 before anything is known, comes out as 2.37 to 11.34 where 2.20 to 11.67 is exact; the more is known, the nearer.

    Parameters
    ----------
    correlation : between the errors of any two, 0 to 1
    """
    listed = list(parts)
    if len(listed) == 1:
        return listed[0]
    value = math.fsum(part.value for part in listed)
    sds = [(part.high - part.low) / (2.0 * NORMAL_95) for part in listed]
    # The third root of the third cumulant, which scales as the part does.
    roots = [
        math.cbrt(_BEND * (part.high + part.low - 2.0 * part.value) * sd * sd)
        for part, sd in zip(listed, sds, strict=True)
    ]
    sd = math.sqrt((1.0 - correlation) * math.fsum(one**2 for one in sds) + correlation * math.fsum(sds) ** 2)
    if sd == 0.0:
        return Estimate(value, value, value)
    third = (1.0 - correlation) * math.fsum(one**3 for one in roots) + correlation * math.fsum(roots) ** 3
    bend = third / (2.0 * _BEND * sd * sd)
    return Estimate(value, min(value, value + bend - NORMAL_95 * sd), max(value, value + bend + NORMAL_95 * sd))
