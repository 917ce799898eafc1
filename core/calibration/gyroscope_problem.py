"""The residual of a gyroscope's calibration: how far each turn misses gravity, weighted by what its noise allows."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from core.calibration.fit import TriadFit
from core.calibration.rest import Rest
from core.calibration.static_intervals import StaticPositions
from core.calibration.turns import Turns, integrate
from core.earth import EARTH_RATE_RADPS
from core.errors import InvalidInputError
from core.measurements import FloatArray
from core.rotation import skew
from core.sensors import triple
from core.tunables import Tunables, tunable

IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]

LEAST_TURNS: Final = 5
"""Each tells two of the nine numbers of scale, misalignment and alignment; the bias is told at rest."""
OUTLIER: Final = 6.0
"""A turn that misses gravity by so many times what the others do was not seen whole, and is left out."""
CLIPPED_SD: Final = 20.0
"""An extreme that stands still is the end of the range where it is so many sd at rest off; a choice: any turn is."""
GAP_SAMPLES: Final = 2.5
"""An interval so many samples long lacks one; jitter is less."""


@dataclass(frozen=True, slots=True)
class GyroscopePrior(Tunables):
    """What is known of a gyroscope before it is calibrated, standard deviations."""

    scale_sd: float = tunable(
        0.04, unit="1", low=1e-4, high=1.0, source="L3GD20 data sheet: sensitivity +-4 %; of counts: against other axes"
    )
    axes_sd_rad: float = tunable(
        0.05, unit="rad", low=1e-4, high=0.5, source="choice: 3 deg; soldering, die and cross-axis sensitivity"
    )
    instability_radps: float = tunable(
        1.05e-4,
        unit="rad/s",
        low=0.0,
        high=0.1,
        source="20 deg/h, floor of consumer MEMS: by how much a bias is another a while later",
    )
    instability_s: float = tunable(300.0, unit="s", low=1.0, high=1e5, source="choice: minutes, as in Allan plots")
    gap_s: float = tunable(
        0.05, unit="s", low=1e-3, high=1.0, source="choice: samples lost for longer hide 3 deg at 1 rad/s"
    )


@dataclass(frozen=True, slots=True, eq=False)
class Ups:
    """Unit up (k, 3) in each position in the accelerometer's axes, its covariance (k, 3, 3) by noise, and its
    derivative by the accelerometer's parameters (k, 3, 9), which all positions share."""

    up: FloatArray
    covariance: FloatArray
    by_accelerometer: FloatArray

    @classmethod
    def of(cls, positions: StaticPositions, fit: TriadFit, gravity_mps2: float) -> Ups:
        triad = fit.calibration
        up = _normed(triad.correct(positions.mean_accelerometer))
        offset = triad.correct(np.zeros((1, 3)))
        inverse = (triad.correct(np.eye(3)) - offset).T / gravity_mps2
        covariance = inverse @ positions.cov_accelerometer @ inverse.T
        # Where gravity is missed by more than noise, up is no surer than that.
        beyond = (fit.residual_rms / gravity_mps2) ** 2 - float(np.mean(np.trace(covariance, axis1=1, axis2=2))) / 3.0
        covariance = covariance + max(beyond, 0.0) * np.eye(3)
        by = np.empty((len(up), 3, 9))
        for at, sd in enumerate(fit.sd):
            step = np.zeros((3, 3))
            step.flat[at] = sd
            moved = replace(
                triad,
                scale=triple(np.array(triad.scale) + step[0]),
                misalignment=triple(np.array(triad.misalignment) + step[1]),
                bias=triple(np.array(triad.bias) + step[2]),
            )
            by[:, :, at] = (_normed(moved.correct(positions.mean_accelerometer)) - up) / sd if sd > 0.0 else 0.0
        return cls(up, covariance, by)

    def of_turns(self, spans: Spans) -> tuple[FloatArray, FloatArray]:
        return self.up[spans.before], self.up[spans.before + 1]


@dataclass(frozen=True, slots=True, eq=False)
class Spans:
    """Turns from position ``before`` (k,) to the one after it: samples ``begin`` to ``end``, both included."""

    before: IntArray
    begin: IntArray
    end: IntArray
    left_out: int

    @classmethod
    def of(cls, t_s: FloatArray, shown: FloatArray, positions: StaticPositions, prior: GyroscopePrior) -> Spans:
        interval_s = float(np.median(np.diff(t_s)))
        # The detector has left out what may be motion at the ends of a hold: it is part of the turn.
        begin, end = (positions.end - 1)[:-1], positions.start[1:]
        clipped = _clipped(shown, positions)
        gaps = np.diff(t_s) > max(prior.gap_s, GAP_SAMPLES * interval_s)
        whole = np.array(
            [not (clipped[a : b + 1].any() or gaps[a:b].any()) for a, b in zip(begin, end, strict=True)], dtype=bool
        )
        if whole.sum() < LEAST_TURNS:
            cut = f" ({int((~whole).sum())} more are clipped or have gaps)" if not whole.all() else ""
            raise InvalidInputError(
                f"{int(whole.sum())} turns between static positions{cut}; expected {LEAST_TURNS} or more: record "
                "again, turning the box by 90 to 180 degrees about another axis each time, slower than its full scale"
            )
        return cls(np.flatnonzero(whole), begin[whole], end[whole], int((~whole).sum()))


class TurnProblem:
    """Whitened residuals over x (12,): E (9) of G = (I + E) G0, and the bias' change in rad/s.

    Rows: two a turn (gravity missed, across up), three of the bias at rest, nine of the prior.
    """

    def __init__(
        self,
        t_s: FloatArray,
        shown: FloatArray,
        spans: Spans,
        ups: Ups,
        at_rest: Rest,
        inverse: FloatArray,
        prior: GyroscopePrior,
    ) -> None:
        self.t_s, self.shown, self.spans, self.ups, self.at_rest = t_s, shown, spans, ups, at_rest
        self.start_inverse, self.forward = inverse, np.linalg.inv(inverse)
        self.used = np.ones(len(spans.before), dtype=bool)
        self.across = np.array([across(up) for up in ups.up[spans.before + 1]])
        self.whitening = np.tile(np.eye(2), (len(spans.before), 1, 1))
        # The bias of a turn is the mean of those in the positions around it.
        drift = at_rest.path - at_rest.bias
        self.drift = 0.5 * (drift[spans.before] + drift[spans.before + 1])
        self.drift_variance = 0.5 * (at_rest.path_variance[spans.before] + at_rest.path_variance[spans.before + 1])
        rate_covariance = inverse @ np.diag(at_rest.bias_variance) @ inverse.T
        self.bias_whitening = np.linalg.inv(np.linalg.cholesky(rate_covariance))
        sd = np.full((3, 3), prior.axes_sd_rad)
        np.fill_diagonal(sd, prior.scale_sd)
        self.prior_sd = sd.ravel()

    def inverse(self, x: FloatArray) -> FloatArray:
        """G (3, 3), rad/s per shown unit."""
        return np.asarray((np.eye(3) + x[:9].reshape(3, 3)) @ self.start_inverse)

    def bias(self, x: FloatArray) -> FloatArray:
        return np.asarray(self.at_rest.bias + self.forward @ x[9:])

    def turns(self, x: FloatArray) -> Turns:
        spans = self.spans
        bias = self.bias(x) + self.drift
        return integrate(self.t_s, self.shown, spans.begin, spans.end, self.inverse(x), bias, self.at_rest.noise)

    def missed(self, turns: Turns) -> tuple[FloatArray, FloatArray]:
        """Up as the turns bring it to their ends (k, 3), and how far the accelerometer's lies from that, (k, 2)."""
        before, after = self.ups.of_turns(self.spans)
        brought = np.einsum("kji,kj->ki", turns.C_a_from_e, before)
        return brought, np.einsum("kia,ki->ka", self.across, brought - after)

    def weigh(self, x: FloatArray, scatter: float = 1.0) -> None:
        """Whiten by the noise of the rates over each turn, the bias' path, the Earth, and up before and after.

        Turns that scatter by more than that, as those sampled too slowly do, must not outweigh the bias at rest:
        ``scatter`` multiplies their variance.
        """
        turns, inverse = self.turns(x), self.inverse(x)
        before, after = self.spans.before, self.spans.before + 1
        drift = np.einsum("ab,kb,cb->kac", inverse, self.drift_variance, inverse)
        rate = drift + EARTH_RATE_RADPS**2 / 3.0 * np.eye(3)
        turning = turns.covariance + turns.by_rate @ rate @ turns.by_rate.transpose(0, 2, 1)
        brought, _ = self.missed(turns)
        lever = np.array([skew(up) for up in brought])
        back = turns.C_a_from_e.transpose(0, 2, 1)
        covariance = (
            lever @ turning @ lever.transpose(0, 2, 1)
            + back @ self.ups.covariance[before] @ turns.C_a_from_e
            + self.ups.covariance[after]
        )
        seen = self.across.transpose(0, 2, 1) @ covariance @ self.across
        self.whitening = np.linalg.inv(np.linalg.cholesky(scatter * seen))

    def scatter(self, x: FloatArray) -> float:
        """Variance of what the turns used miss over what ``weigh`` expects; nine parameters are theirs to fit."""
        _, missed = self.missed(self.turns(x))
        residual = np.einsum("kab,kb->ka", self.whitening, missed)[self.used]
        return float(np.sum(residual**2)) / max(1, int(residual.size) - 9)

    def leave_out_far_ones(self, x: FloatArray) -> None:
        _, missed = self.missed(self.turns(x))
        size = np.linalg.norm(np.einsum("kab,kb->ka", self.whitening, missed), axis=1)
        usual = max(1.0, float(np.median(size[self.used])) / math.sqrt(2.0 * math.log(2.0)))  # Rayleigh's median
        near = size <= OUTLIER * usual
        if near.sum() >= LEAST_TURNS:
            self.used = near

    def __call__(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        turns, inverse = self.turns(x), self.inverse(x)
        brought, missed = self.missed(turns)
        by_x = self.turning_by_x(turns, inverse)
        lever = np.array([skew(up) for up in brought])
        whiten = self.whitening @ self.across.transpose(0, 2, 1)
        rows = (whiten @ lever @ by_x)[self.used].reshape(-1, 12)
        residual = np.einsum("kab,kb->ka", self.whitening, missed)[self.used].ravel()
        rest = np.hstack([np.zeros((3, 9)), self.bias_whitening])
        known = np.hstack([np.diag(1.0 / self.prior_sd), np.zeros((9, 3))])
        return (
            np.concatenate([residual, self.bias_whitening @ x[9:], x[:9] / self.prior_sd]),
            np.vstack([rows, rest, known]),
        )

    def turning_by_x(self, turns: Turns, inverse: FloatArray) -> FloatArray:
        """(k, 3, 12): how much further the end is turned by a change of x."""
        by_matrix = np.einsum("krab,cb->krac", turns.by_inverse, self.start_inverse).reshape(-1, 3, 9)
        by_bias = -turns.by_rate @ (inverse @ self.forward)
        return np.concatenate([by_matrix, by_bias], axis=2)

    def by_accelerometer(self, x: FloatArray) -> FloatArray:
        """(rows, 9) derivative of the residual by the accelerometer's parameters."""
        turns = self.turns(x)
        before, after = self.spans.before, self.spans.before + 1
        by = turns.C_a_from_e.transpose(0, 2, 1) @ self.ups.by_accelerometer[before] - self.ups.by_accelerometer[after]
        rows = (self.whitening @ self.across.transpose(0, 2, 1) @ by)[self.used].reshape(-1, 9)
        return np.vstack([rows, np.zeros((12, 9))])


def _clipped(shown: FloatArray, positions: StaticPositions) -> BoolArray:
    """(n,) samples within three or more in a row at an axis' greatest or least value, far from that at rest."""
    clipped = np.zeros(len(shown), dtype=bool)
    resting = np.concatenate([shown[a:b] for a, b in zip(positions.start, positions.end, strict=True)])
    middle, spread = resting.mean(axis=0), resting.std(axis=0)
    for axis in range(3):
        for extreme in (shown[:, axis].max(), shown[:, axis].min()):
            if abs(extreme - middle[axis]) > CLIPPED_SD * spread[axis]:
                there = shown[:, axis] == extreme
                clipped[1:-1] |= there[:-2] & there[1:-1] & there[2:]
    return clipped


def across(up: FloatArray) -> FloatArray:
    """Two unit vectors across a unit vector, (3, 2)."""
    return np.asarray(np.linalg.svd(up[None])[2][1:].T)


def _normed(rows: FloatArray) -> FloatArray:
    return np.asarray(rows / np.linalg.norm(rows, axis=1)[:, None])
