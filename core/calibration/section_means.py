"""Means of sections of a recording and how sure they are, of noise that is correlated and of rounded readings."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from core.measurements import FloatArray

IntArray = npt.NDArray[np.int64]


def section_means(
    values: FloatArray, parts: list[IntArray], blocks: int, pooled_blocks: float
) -> tuple[FloatArray, FloatArray]:
    """Means (k, 3) of parts of ``values`` (n, 3), and the covariances (k, 3, 3) of these means.

    A part is cut into so many ``blocks``, whose means scatter by noise that may be correlated within a block; as a
    variance out of few blocks is itself uncertain, that of all parts counts as ``pooled_blocks`` more.
    """
    means = np.stack([values[part].mean(axis=0) for part in parts])
    sizes = np.array([part.size for part in parts])[:, None, None]
    own, freedom = np.empty((len(parts), 3, 3)), np.empty((len(parts), 1, 1))
    for i, part in enumerate(parts):
        count = min(blocks, part.size)
        m = part.size // count
        of_blocks = values[part[: count * m]].reshape(count, m, 3).mean(axis=1)
        own[i] = m * np.cov(of_blocks, rowvar=False)  # of one sample, were the noise white
        freedom[i] = count - 1
    pooled = np.sum(freedom * own, axis=0) / freedom.sum()
    shared = (freedom * own + pooled_blocks * pooled) / (freedom + pooled_blocks)
    covariance = shared / sizes
    sds = np.stack([values[part].std(axis=0) for part in parts])
    diagonal = np.arange(3)
    covariance[:, diagonal, diagonal] += _rounding_variance(sds, converter_steps(values))
    return means, covariance


def _rounding_variance(sds: FloatArray, steps: FloatArray) -> FloatArray:
    """Of a mean of rounded samples whose noise is ``sds``: the first harmonic of the rounding's bias, squared.

    Noise of half a step averages rounding away; without noise it stays as large as a single sample's (Widrow &
    Kollar 2008, ch. 5 and app. G).
    """
    # However little noise there is, between two codes it shows as half a step.
    noise_sq = np.maximum(sds**2 - steps**2 / 4.0, 0.0)
    ratio = np.divide(noise_sq, steps**2, out=np.full_like(noise_sq, np.inf), where=steps > 0.0)
    return np.asarray(0.5 * (steps / np.pi) ** 2 * np.exp(-4.0 * np.pi**2 * np.minimum(ratio, 10.0)))


def converter_steps(values: FloatArray) -> FloatArray:
    """Least difference between different values of each axis (3,): the converter's step, or next to nothing."""
    steps = np.zeros(3)
    for axis in range(3):
        column = values[:, axis]
        ratio = 1e-9 * max(float(np.ptp(column)), 1e-300)
        different = np.diff(np.unique(np.rint((column - column.min()) / ratio)))
        steps[axis] = float(different.min()) * ratio if different.size else 0.0
    return steps
