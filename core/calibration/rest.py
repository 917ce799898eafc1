"""What a gyroscope tells at rest: its white noise, the path of its bias, and how gravity moves that."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.stats import f as fisher

from core.calibration.section_means import converter_steps
from core.errors import InvalidInputError
from core.measurements import FloatArray

IntArray = npt.NDArray[np.int64]

BLOCK_S: Final = 1.0
"""Length of the means whose scatter tells the noise: about that of a turn, which is what it is needed for."""
SURE: Final = 2.0
"""Standard errors by which the bias must move more than expected before its path is let move more."""
BY_CHANCE: Final = 1e-3
"""Probability below which means that follow the box's attitude are taken to do so by gravity, not by chance."""
LEAST_FREE: Final = 4
"""Positions beyond the four that bias and sensitivity take up, for a scatter to judge them by."""


def g_sensitivity(means: FloatArray, forces: FloatArray) -> tuple[FloatArray, FloatArray]:
    """How specific force moves the biases (3, 3), and the standard deviations of that (Groves 2013, eq. 4.17).

    Zero where an F test sees no effect: an unneeded correction would add its noise to every turn. The part of the
    Earth's rate along up looks the same; a MEMS gyroscope's sensitivity is ten times that where it is seen at all.

    Parameters
    ----------
    means : (k, 3) of the gyroscope in each position, as shown
    forces : (k, 3) specific force there, m/s2
    """
    free = len(means) - 4
    design = np.column_stack([np.ones(len(means)), forces])
    none = np.zeros((3, 3))
    if free < LEAST_FREE or np.linalg.matrix_rank(design, tol=0.1) < 4:
        return none, none
    found = np.linalg.lstsq(design, means, rcond=None)[0]
    left = np.sum((means - design @ found) ** 2, axis=0)
    before = np.sum((means - means.mean(axis=0)) ** 2, axis=0)
    if not left.all():
        return none, none
    ratio = float(np.mean((before - left) / 3.0 / (left / free)))
    if fisher.sf(ratio, 9, 3 * free) > BY_CHANCE:
        return none, none
    variance = np.outer(left / free, np.diag(np.linalg.inv(design.T @ design))[1:])
    return np.asarray(found[1:].T), np.sqrt(variance)


@dataclass(frozen=True, slots=True, eq=False)
class Rest:
    """A gyroscope at rest, in the unit that it shows.

    Parameters
    ----------
    noise : (3,) density of the white noise, unit/sqrt(Hz)
    path : (k, 3) bias in each position
    path_variance : (k, 3) of it
    bias : (3,) mean of the path
    bias_variance : (3,) of that
    """

    noise: FloatArray
    path: FloatArray
    path_variance: FloatArray
    bias: FloatArray
    bias_variance: FloatArray

    @classmethod
    def of(cls, t_s: FloatArray, shown: FloatArray, start: IntArray, end: IntArray, walk: float, earth: float) -> Rest:
        """From the samples ``start`` to ``end`` (k,), end exclusive.

        Parameters
        ----------
        walk : random walk of the bias that is expected, unit/sqrt(s); where the means wander more, theirs
        earth : rate of the Earth in the unit shown: each mean holds a part of it that hangs on how the box lies

        Raises
        ------
        InvalidInputError
            If the positions are too short to tell noise from bias.
        """
        interval_s = float(np.median(np.diff(t_s)))
        noise = _density(shown, start, end, interval_s)
        means = np.array([shown[a:b].mean(axis=0) for a, b in zip(start, end, strict=True)])
        middle_s = 0.5 * (t_s[start] + t_s[end - 1])
        variances = noise**2 / ((end - start) * interval_s)[:, None] + earth**2 / 3.0
        path, path_variance = np.empty_like(means), np.empty_like(means)
        bias, bias_variance = np.empty(3), np.empty(3)
        for axis in range(3):
            mean, variance = means[:, axis], variances[:, axis]
            wander = max(walk**2, _surely_wandered(mean, variance, middle_s))
            information = np.diag(1.0 / variance)
            if len(mean) > 1 and wander > 0.0:
                step = np.diff(np.eye(len(mean)), axis=0)
                information += step.T @ np.diag(1.0 / (wander * np.diff(middle_s))) @ step
                covariance = np.linalg.inv(information)
                path[:, axis] = covariance @ (mean / variance)
            else:
                covariance = np.full((len(mean), len(mean)), 1.0 / np.sum(1.0 / variance))
                path[:, axis] = covariance[0, 0] * np.sum(mean / variance)
            share = (end - start) / np.sum(end - start)
            path_variance[:, axis] = np.diag(covariance)
            bias[axis], bias_variance[axis] = share @ path[:, axis], share @ covariance @ share
        return cls(noise, path, path_variance, bias, bias_variance)


def _density(shown: FloatArray, start: IntArray, end: IntArray, interval_s: float) -> FloatArray:
    """White noise by the scatter of means of a second within positions: filters and vibration at high rates count
    for no more than they do over a turn."""
    for block_s in (BLOCK_S, 0.5 * BLOCK_S):  # positions of 2 s, less what may be motion at their ends, hold no two
        length = max(1, round(block_s / interval_s))
        squares, freedom = np.zeros(3), 0
        for a, b in zip(start, end, strict=True):
            blocks = (b - a) // length
            if blocks >= 2:
                means = shown[a : a + blocks * length].reshape(blocks, length, 3).mean(axis=1)
                # Half the squared differences of neighbours: a bias that drifts is no noise (Allan variance).
                squares += np.sum(np.diff(means, axis=0) ** 2, axis=0) / 2.0
                freedom += blocks - 1
        if freedom >= 3:
            break
    else:
        raise InvalidInputError(
            "the static positions are too short to tell the gyroscope's noise from its bias; "
            "record again and leave the box in each for 3 s or longer"
        )
    # A converter's step spreads values evenly over it: even where all show the same, that much is not known.
    step = converter_steps(shown)
    return np.asarray(np.sqrt(squares / freedom * length * interval_s + step**2 / 12.0 * interval_s))


def _surely_wandered(mean: FloatArray, variance: FloatArray, middle_s: FloatArray) -> float:
    """Variance a second of the walk that the means' scatter beyond their noise stands for, less its standard error.

    A walk of q a second for T s scatters about its own mean by q T / 6.
    """
    span_s = float(middle_s[-1] - middle_s[0])
    if len(mean) < 3 or span_s <= 0.0:
        return 0.0
    excess = float(np.var(mean, ddof=1) - variance.mean() - SURE * variance.mean() * np.sqrt(2.0 / (len(mean) - 1)))
    return max(0.0, 6.0 * excess / span_s)
