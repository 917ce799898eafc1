"""Credibility: what a driver's own figures are worth beside the portfolio's, and how sure the two together are.

A relative rate r, of which the portfolio's mean is 1, is Gamma with shape and rate ``shape`` between drivers; counts
are Poisson. What is believed after ``count`` where the portfolio's mean driver has ``expected`` is Gamma(shape + count,
shape + expected), whose mean is Buehlmann's: Z count / expected + 1 - Z, with Z = expected / (shape + expected). What
is no count (a distance, a share of time) takes part by how many counts it tells as much as.

References: Buehlmann & Gisler, *A Course in Credibility Theory* (2005), 2.4; Zou & Donner, Statistics in Medicine 27
(2008), for intervals of sums from those of their parts (MOVER).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

from scipy.special import gammaincinv

TAILS: Final = (0.025, 0.975)
"""Of an interval of 95 %."""


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


def summed(parts: Iterable[Estimate], correlation: float = 0.0) -> Estimate:
    """The sum of estimates by MOVER: to either side, distances add as standard deviations do. Exact for one.

    Parameters
    ----------
    correlation : between the errors of any two, 0 to 1
    """
    listed = list(parts)
    value = math.fsum(part.value for part in listed)
    below = _together([part.value - part.low for part in listed], correlation)
    above = _together([part.high - part.value for part in listed], correlation)
    return Estimate(value, value - below, value + above)


def _together(distances: Sequence[float], correlation: float) -> float:
    apart = math.fsum(one * one for one in distances)
    return math.sqrt((1.0 - correlation) * apart + correlation * math.fsum(distances) ** 2)
