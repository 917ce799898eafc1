"""Overlapping Allan deviation of a sensor at rest, and how sure it is, by the covariance that known noises give it.

The signal y is taken as averages over the sampling interval; times are in samples here and in seconds at the border.
A noise is known by the generalised autocovariance s(t) of its integral (Greenhall & Riley, *Uncertainty of
stability variances based on finite differences*, PTTI 2003), from which every second moment of the second
differences follows, and with them the variance of an estimate and its covariance with another averaging time's.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.stats import chi2

from core.errors import InvalidInputError
from core.measurements import FloatArray
from core.sensors import ALLAN_FLOOR

IndexArray = npt.NDArray[np.int64]

TERMS: Final = ("quantisation", "random_walk", "bias_instability", "rate_random_walk")
"""Order of the noises Q, N, B, K (IEEE Std 952-1997, annex C) in arrays."""
MIN_SAMPLES: Final = 100
"""Below it there are not four octaves of averaging times to fit anything to."""
LONGEST_SHARE: Final = 0.2
"""Longest averaging time over the recording's length; at 0.2 some 3 degrees of freedom are left of a random walk."""
_SECOND_DIFFERENCE: Final = ((0, 1.0), (1, -2.0), (2, 1.0))
_FINE: Final = 8
"""Lags in a shorter averaging time at which products of covariances are summed near where they bend."""


def averaging_counts(samples: int, per_octave: int = 1) -> IndexArray:
    """Averaging times, in samples, from one to ``LONGEST_SHARE`` of so many samples."""
    octaves = np.log2(max(LONGEST_SHARE * samples, 1.0))
    return np.unique(np.rint(2.0 ** (np.arange(int(octaves * per_octave) + 1) / per_octave)).astype(np.int64))


def allan_variance(signal: FloatArray, counts: IndexArray) -> FloatArray:
    """Overlapping Allan variance of ``signal`` (n,) at averaging times ``counts`` (k,) in samples; (k,), signal^2.

    Raises
    ------
    InvalidInputError
        If the signal has too few samples for one of the counts.
    """
    if signal.size < 2 * int(counts.max()):
        raise InvalidInputError(f"{signal.size} samples; averaging over {counts.max()} needs twice as many")
    # Without its mean, the integral of a long recording keeps its digits.
    integral = np.concatenate([[0.0], np.cumsum(signal - signal.mean())])
    found = np.empty(counts.size)
    for index, m in enumerate(counts):
        second = integral[2 * m :] - 2.0 * integral[m:-m]
        second += integral[: -2 * m]
        found[index] = np.dot(second, second) / second.size / (2.0 * m * m)
    return found


def term_variances(counts: npt.ArrayLike) -> FloatArray:
    """Allan variance of each of ``TERMS`` at unit strength and a sampling interval of 1; (k, 4)."""
    m = np.asarray(counts, dtype=np.float64)
    return np.column_stack([3.0 / m**2, 1.0 / m, np.full(m.shape, ALLAN_FLOOR**2), m / 3.0])


def in_seconds(interval_s: float) -> FloatArray:
    """Squared strengths of ``TERMS`` for a sampling interval, over those for an interval of 1; (4,).

    Q is signal s, N is signal/sqrt(Hz), B is signal, K is signal/sqrt(s).
    """
    return np.array([interval_s**2, interval_s, 1.0, 1.0 / interval_s])


class AllanMoments:
    """Covariance of overlapping Allan variances of one length of recording, for any strengths of ``TERMS``.

    Parameters
    ----------
    samples : length of the recording
    counts : (k,) averaging times, samples, increasing
    pairs : without it only variances are worked out, no covariances

    Notes
    -----
    For a Gaussian signal cov(V_i, V_j) = 2 / (M_i M_j) sum_l w(l) R_ij(l)^2, where R_ij is the cross-covariance of
    the second differences and w the number of pairs with that lag. R is linear in the squared strengths, so the sums
    are kept for each pair of terms, and a covariance is a quadratic form.
    """

    def __init__(self, samples: int, counts: IndexArray, *, pairs: bool = True) -> None:
        k = counts.size
        self.counts = counts
        self._forms = np.zeros((k, k, len(TERMS), len(TERMS)))
        for j in range(k):
            for i in range(0 if pairs else j, j + 1):
                form = _form(samples, int(counts[i]), int(counts[j]))
                self._forms[i, j] = self._forms[j, i] = form

    def covariance(self, strengths: FloatArray) -> FloatArray:
        """Of the Allan variances, (k, k), for squared strengths (4,) at a sampling interval of 1."""
        return np.asarray(np.einsum("p,ijpq,q->ij", strengths, self._forms, strengths))

    def freedom(self, strengths: FloatArray) -> FloatArray:
        """Equivalent degrees of freedom of each Allan variance, (k,): 2 mean^2 / variance, 1 or more."""
        mean = term_variances(self.counts) @ strengths
        return np.asarray(np.maximum(2.0 * mean**2 / np.diag(self.covariance(strengths)), 1.0))


@dataclass(frozen=True, slots=True, eq=False)
class AllanCurve:
    """Allan deviation (k,) over averaging times ``tau_s`` (k,), with the 95 % interval ``low`` to ``high`` of each."""

    tau_s: FloatArray
    deviation: FloatArray
    low: FloatArray
    high: FloatArray


def allan_curve(variance: FloatArray, moments: AllanMoments, strengths: FloatArray, interval_s: float) -> AllanCurve:
    """Deviations with chi-square intervals whose degrees of freedom are those of noises of these strengths."""
    freedom = moments.freedom(strengths)
    deviation = np.sqrt(variance)
    low = deviation * np.sqrt(freedom / chi2.ppf(0.975, freedom))
    high = deviation * np.sqrt(freedom / chi2.ppf(0.025, freedom))
    return AllanCurve(np.asarray(moments.counts * interval_s), deviation, low, high)


def _power_law(power: Callable[[FloatArray], FloatArray]) -> Callable[[FloatArray, int, int], FloatArray]:
    def cross(lags: FloatArray, m_i: int, m_j: int) -> FloatArray:
        total = np.zeros(lags.shape)
        for a, c_a in _SECOND_DIFFERENCE:
            for b, c_b in _SECOND_DIFFERENCE:
                total += c_a * c_b * power(np.abs(lags + b * m_j - a * m_i))
        return total

    return cross


def _flicker(t: FloatArray) -> FloatArray:
    return np.asarray(t**2 * np.log(np.maximum(t, 1.0)) / (2.0 * np.pi))


# Cross-covariances of second differences of the integral: delta, -|t|/2, t^2 ln|t| / 2 pi, |t|^3 / 12.
_CROSS: Final = (
    _power_law(lambda t: np.asarray(t == 0.0, dtype=np.float64)),
    _power_law(lambda t: -0.5 * t),
    _power_law(_flicker),
    _power_law(lambda t: t**3 / 12.0),
)


def _form(samples: int, m_i: int, m_j: int) -> FloatArray:
    """Quadratic form (4, 4) of the covariance of two Allan variances, m_i <= m_j."""
    starts_i, starts_j = samples + 1 - 2 * m_i, samples + 1 - 2 * m_j
    scale = 2.0 / (float(starts_i) * starts_j) / (4.0 * float(m_i) ** 2 * float(m_j) ** 2)

    def cross(lags: FloatArray) -> FloatArray:
        return np.array([one(lags, m_i, m_j) for one in _CROSS])

    def pairs(lags: FloatArray) -> FloatArray:
        return np.asarray(np.maximum(np.minimum(starts_i, starts_j - lags) - np.maximum(0.0, -lags), 0.0))

    lags = _lags(m_i, m_j)
    smooth = cross(lags)
    smooth[0] = 0.0
    spacing = np.diff(lags)
    weights = 0.5 * (np.append(spacing, 1.0) + np.insert(spacing, 0, 1.0)) * pairs(lags)
    form = (smooth * weights) @ smooth.T
    # Quantisation is correlated at single lags only: they are summed one by one.
    single = np.unique([float(a * m_i - b * m_j) for a in range(3) for b in range(3)])
    at = cross(single)
    with_all = (at[0] * pairs(single)) @ at.T
    form[0, :] = form[:, 0] = with_all
    return np.asarray(scale * form)


def _lags(m_i: int, m_j: int) -> FloatArray:
    """Lags close together where the covariance bends and ever farther apart between and beyond."""
    step = max(m_i // _FINE, 1)
    near = step * np.arange(0, 4 * _FINE + 1)
    far = near[-1] * 1.08 ** np.arange(1, int(np.log(8.0 * m_j / near[-1] + 1.0) / np.log(1.08)) + 2)
    offsets = np.rint(np.concatenate([-far[::-1], -near[::-1], near, far]))
    bends = np.unique([a * m_i - b * m_j for a in range(3) for b in range(3)])
    return np.asarray(np.unique((bends[:, None] + offsets[None, :]).ravel()), dtype=np.float64)
