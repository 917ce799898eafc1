"""Noises of a sensor from its Allan variance: random walk, bias instability and rate random walk, with 95 % intervals.

Generalised least squares on the logarithm of the Allan variance at octaves of the averaging time, with the covariance
that the fitted noises themselves give (the idea of Guerrier et al., *Wavelet-variance-based estimation for composite
stochastic processes*, JASA 2013); squared strengths are not negative; intervals are profiles of the misfit.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.optimize import brentq, nnls
from scipy.special import polygamma, psi
from scipy.stats import chi2

from core.calibration.allan import (
    MIN_SAMPLES,
    TERMS,
    AllanCurve,
    AllanMoments,
    allan_curve,
    allan_variance,
    averaging_counts,
    in_seconds,
    term_variances,
)
from core.errors import InvalidInputError
from core.measurements import FloatArray
from core.tunables import Tunables, tunable

_PROFILE: Final = float(chi2.ppf(0.95, 1))
_MIN_POINTS: Final = 6
"""Octaves that are always left to the fit: two more than there are terms."""


@dataclass(frozen=True, slots=True)
class AllanSettings(Tunables):
    """What the fit does where a sensor is not made of the four noises alone."""

    misfit_probability: float = tunable(
        0.01, unit="1", low=1e-6, high=0.5, source="choice: a misfit less likely than this widens all intervals"
    )
    excess_sd: float = tunable(
        0.1,
        unit="1",
        low=0.0,
        high=1.0,
        source="choice: 5 % of the deviation; beyond it the shortest times go, where the sensor's own filter cuts",
    )
    filter_s: float = tunable(
        0.1, unit="s", low=0.0, high=10.0, source="choice: no box's sensors are filtered below 5 Hz; longer times stay"
    )


@dataclass(frozen=True, slots=True)
class NoiseTerm:
    """Strength of a noise with its 95 % interval; ``value`` is 0 where the recording is explained without it."""

    value: float
    low: float
    high: float

    @property
    def resolved(self) -> bool:
        """Whether the recording shows it; otherwise ``high`` says what it could hide."""
        return self.value > 0.0


@dataclass(frozen=True, slots=True, eq=False)
class AllanFit:
    """Noise of one axis at rest, in the signal's unit and seconds.

    Parameters
    ----------
    quantisation, random_walk, bias_instability, rate_random_walk : Q, N, B, K of IEEE Std 952-1997
    floor : smallest Allan deviation with its interval at ``floor_tau_s``; None where it falls to the last
    curve : the Allan deviation, four averaging times an octave
    fitted_tau_s : (k,) averaging times that the fit went through
    excess_sd : of the logarithm of the variance, what the four noises leave beyond chance; 0 where nothing
    """

    quantisation: NoiseTerm
    random_walk: NoiseTerm
    bias_instability: NoiseTerm
    rate_random_walk: NoiseTerm
    floor: NoiseTerm | None
    floor_tau_s: float | None
    curve: AllanCurve
    fitted_tau_s: FloatArray
    excess_sd: float

    def deviations(self, tau_s: FloatArray) -> FloatArray:
        """Allan deviation of each of ``TERMS`` as fitted, (k, 4)."""
        strengths = np.array([getattr(self, name).value for name in TERMS])
        return np.asarray(strengths * np.sqrt(term_variances(tau_s)))


class AllanAnalysis:
    """Fits of signals of one length and rate: what the length alone decides is worked out once.

    Raises
    ------
    InvalidInputError
        If the length is below ``MIN_SAMPLES``.
    """

    def __init__(self, samples: int, interval_s: float, settings: AllanSettings | None = None) -> None:
        if samples < MIN_SAMPLES:
            raise InvalidInputError(f"{samples} samples at rest; expected at least {MIN_SAMPLES}: record longer")
        self._settings = AllanSettings() if settings is None else settings
        self._samples, self._interval_s = samples, interval_s
        self._moments = AllanMoments(samples, averaging_counts(samples))
        self._dense = AllanMoments(samples, averaging_counts(samples, per_octave=4), pairs=False)

    def fit(self, signal: FloatArray) -> AllanFit:
        """Noises of one axis, ``signal`` (n,).

        Raises
        ------
        InvalidInputError
            If the signal has another length, or does not change at all.
        """
        if signal.shape != (self._samples,):
            raise InvalidInputError(f"signal has shape {signal.shape}; expected {(self._samples,)}")
        if not np.ptp(signal) > 0.0:
            raise InvalidInputError("the signal never changes: a dead axis, or a step too coarse to show any noise")
        variance = allan_variance(signal, self._moments.counts)
        problem = self._problem(variance)
        strengths = problem.strengths
        curve = allan_curve(allan_variance(signal, self._dense.counts), self._dense, strengths, self._interval_s)
        seconds = np.sqrt(in_seconds(self._interval_s))
        chosen = problem.fewest_terms()
        terms = {}
        for index, name in enumerate(TERMS):
            low, high = problem.interval(index)
            terms[name] = NoiseTerm(*(float(v * seconds[index]) for v in (np.sqrt(chosen[index]), low, high)))
        floor, floor_tau_s = _floor(curve, terms)
        return AllanFit(
            **terms,
            floor=floor,
            floor_tau_s=floor_tau_s,
            curve=curve,
            fitted_tau_s=np.asarray(self._moments.counts[problem.first :] * self._interval_s),
            excess_sd=problem.excess_sd,
        )

    def _problem(self, variance: FloatArray) -> _Problem:
        """The fit from the shortest averaging time from which the four noises explain it; else the best of all."""
        tried: list[_Problem] = []
        counts = self._moments.counts
        filtered = int(np.count_nonzero(counts * self._interval_s < self._settings.filter_s))
        for first in range(min(filtered, max(counts.size - _MIN_POINTS, 0)) + 1):
            tried.append(_Problem(variance, self._moments, first, self._settings))
            if tried[-1].excess_sd <= self._settings.excess_sd:
                return tried[-1]
        return min(tried, key=lambda one: one.excess_sd)


class _Problem:
    """Fit of squared strengths, not negative, to log variances; the sampling interval is 1."""

    def __init__(self, variance: FloatArray, moments: AllanMoments, first: int, settings: AllanSettings) -> None:
        self.first = first
        self._log = np.log(variance[first:])
        # In units of the variance itself all numbers are near 1.
        self._terms = term_variances(moments.counts)[first:] / variance[first:, None]
        self._scale = 1.0 / self._terms.max(axis=0)
        self._terms = self._terms * self._scale
        points, all_terms = self._log.size, np.arange(len(TERMS))
        self.excess_sd = 0.0
        self._offset, self._whiten = np.zeros(points), np.eye(points)
        x, _ = self._solve(all_terms)
        for _ in range(4):
            self._weigh(x, moments)
            x, misfit = self._solve(all_terms)
        freedom = max(points - int(np.count_nonzero(x)), 1)
        if misfit > chi2.ppf(1.0 - settings.misfit_probability, freedom):
            self.excess_sd = self._find_excess(moments, x, freedom)
            x, misfit = self._solve(all_terms)
        self._x, self._misfit = x, misfit

    @property
    def strengths(self) -> FloatArray:
        """Squared strengths of the best fit, (4,)."""
        return np.asarray(self._x * self._scale)

    def fewest_terms(self) -> FloatArray:
        """Squared strengths, (4,), of the fit with the fewest terms that is within the best one's 95 % region."""
        kept, x = list(range(len(TERMS))), self._x
        while len(kept) > 1:
            without = []
            for term in kept:
                rest = np.array([t for t in kept if t != term])
                without.append((*self._solve(rest), term))
            fewer, misfit, term = min(without, key=lambda one: one[1])
            if misfit > self._misfit + _PROFILE:
                break
            x = fewer
            kept.remove(term)
        return np.asarray(x * self._scale)

    def interval(self, term: int) -> tuple[float, float]:
        """95 % interval of a strength (not squared): where its profile of the misfit is 3.84 above the best."""
        best = self._x[term]
        rest = np.array([t for t in range(len(TERMS)) if t != term])

        def above(root: float) -> float:
            return self._solve(rest, (term, root * root))[1] - self._misfit - _PROFILE

        low = 0.0
        if above(0.0) > 0.0:
            low = brentq(above, 0.0, np.sqrt(best), xtol=1e-6)
        high = max(np.sqrt(best), 1e-3)
        while above(high) < 0.0:
            high *= 2.0
        high = brentq(above, max(np.sqrt(best), 0.0), high, xtol=1e-6)
        return low * float(np.sqrt(self._scale[term])), high * float(np.sqrt(self._scale[term]))

    def _weigh(self, x: FloatArray, moments: AllanMoments) -> None:
        """Mean and covariance of the log variances, as of chi-square with the freedom that these noises give."""
        strengths = x * self._scale
        mean = (term_variances(moments.counts) @ strengths)[self.first :]
        freedom = moments.freedom(strengths)[self.first :]
        self._offset = psi(0.5 * freedom) - np.log(0.5 * freedom)
        covariance = moments.covariance(strengths)[self.first :, self.first :] / np.outer(mean, mean)
        wider = np.sqrt(polygamma(1, 0.5 * freedom) / np.diag(covariance))
        covariance = covariance * np.outer(wider, wider) + self.excess_sd**2 * np.eye(freedom.size)
        self._whiten = np.linalg.inv(np.linalg.cholesky(covariance))

    def _find_excess(self, moments: AllanMoments, x: FloatArray, freedom: int) -> float:
        """Sd to be added to each log variance so that the misfit is what chance gives (Paule & Mandel 1982)."""

        def beyond(log_sd: float) -> float:
            self.excess_sd = float(np.exp(log_sd))
            self._weigh(x, moments)
            return self._solve(np.arange(len(TERMS)))[1] - freedom

        low, high = np.log(1e-4), np.log(10.0)
        if beyond(low) <= 0.0:
            return float(np.exp(low))
        found = float(np.exp(brentq(beyond, low, high, xtol=1e-3)))
        beyond(float(np.log(found)))
        return found

    def _solve(self, terms: npt.NDArray[np.int64], fixed: tuple[int, float] | None = None) -> tuple[FloatArray, float]:
        """Gauss-Newton with non-negative least squares in each step: strengths of ``terms`` and the misfit."""
        x = np.zeros(len(TERMS))
        x[terms] = 1.0
        if fixed is not None:
            x[fixed[0]] = fixed[1]
        misfit = self._misfit_of(x)
        for _ in range(50):
            model = self._terms @ x
            rhs = 1.0 - np.log(model) - self._offset
            if fixed is not None:
                rhs = rhs - self._terms[:, fixed[0]] * fixed[1] / model
            columns = self._whiten @ (self._terms[:, terms] / model[:, None])
            wanted = np.zeros(len(TERMS))
            wanted[terms] = nnls(columns, self._whiten @ rhs)[0]
            if fixed is not None:
                wanted[fixed[0]] = fixed[1]
            share, better, trial = 1.0, misfit, x
            while share > 1e-4:
                trial = x + share * (wanted - x)
                better = self._misfit_of(trial)
                if better < misfit:
                    break
                share *= 0.5
            if not better < misfit:
                break
            settled = misfit - better < 1e-6
            x, misfit = trial, better
            if settled:
                break
        return x, misfit

    def _misfit_of(self, x: FloatArray) -> float:
        model = self._terms @ x
        if not (model > 0.0).all():
            return float("inf")
        residual = self._whiten @ (np.log(model) + self._offset)
        return float(residual @ residual)


def _floor(curve: AllanCurve, terms: dict[str, NoiseTerm]) -> tuple[NoiseTerm | None, float | None]:
    """Smallest deviation of those known to a quarter; none where only falling noises are seen."""
    if not (terms["bias_instability"].resolved or terms["rate_random_walk"].resolved):
        return None, None
    known = np.flatnonzero(curve.high - curve.low < 0.5 * curve.deviation)
    if not known.size:
        return None, None
    at = known[np.argmin(curve.deviation[known])]
    return NoiseTerm(*(float(v[at]) for v in (curve.deviation, curve.low, curve.high))), float(curve.tau_s[at])
