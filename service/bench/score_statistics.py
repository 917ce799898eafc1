"""Statistics of predicted against actual claims: reliability, calibration slope, lift, and bootstrap intervals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from scipy.stats import rankdata

from core.measurements import FloatArray
from core.scoring.credibility import poisson_interval

IntArray = npt.NDArray[np.int64]
Claims = IntArray | FloatArray

RESAMPLES: Final = 200
_STEPS: Final = 25


def interval95(
    generator: np.random.Generator, statistic: Callable[[IntArray], float], n: int, resamples: int = RESAMPLES
) -> list[float]:
    """Percentiles of a statistic of rows, over resampled drivers."""
    found = [statistic(generator.integers(0, n, n)) for _ in range(resamples)]
    return percentiles(found)


def percentiles(found: Sequence[float]) -> list[float]:
    """The middle 95 % of resampled values."""
    return [float(end) for end in np.percentile(found, [2.5, 97.5])]


def gini(predicted: FloatArray, claims: Claims) -> float:
    """Of claims, or of true rates, by the order of predicted: 0 where the order says nothing."""
    mean_rank = rankdata(predicted) - 0.5
    total = claims.sum()
    return float(2.0 * (mean_rank @ claims) / (len(claims) * total) - 1.0) if total else float("nan")


def auc(predicted: FloatArray, claims: IntArray) -> float:
    """Chance that who had a claim was predicted more than who had none."""
    had = claims > 0
    n, m = int(had.sum()), int((~had).sum())
    if not n or not m:
        return float("nan")
    return float((rankdata(predicted)[had].sum() - 0.5 * n * (n + 1)) / (n * m))


def calibration_slope(predicted: FloatArray, claims: Claims) -> float:
    """b of log E[claims] = a + b log(predicted), by Poisson likelihood: 1 where the spread is right."""
    x = np.log(predicted)
    x = x - x.mean()
    a, b = np.log(max(claims.mean(), 1e-9)), 1.0
    for _ in range(_STEPS):
        mean = np.exp(a + b * x)
        left = claims - mean
        gradient = np.array([left.sum(), (left * x).sum()])
        hessian = np.array([[mean.sum(), (mean * x).sum()], [(mean * x).sum(), (mean * x * x).sum()]])
        step = np.linalg.lstsq(hessian, gradient, rcond=None)[0]
        a, b = a + step[0], b + step[1]
        if np.abs(step).max() < 1e-10:
            break
    return float(b)


def reliability(predicted: FloatArray, claims: IntArray, true: FloatArray, groups: int = 10) -> list[dict[str, Any]]:
    """By tenths of predicted: what was predicted, what came (with a Poisson count's exact interval), the true rate."""
    order = np.argsort(predicted, kind="stable")
    rows = []
    for part in np.array_split(order, groups):
        count, expected = int(claims[part].sum()), float(predicted[part].sum())
        low, high = poisson_interval(count)
        rows.append(
            {
                "drivers": len(part),
                "predicted": expected / len(part),
                "actual": count / len(part),
                "interval95": [low / len(part), high / len(part)],
                "true": float(true[part].mean()),
                "inside": low <= expected <= high,
            }
        )
    return rows


def rank_correlation(one: FloatArray, other: FloatArray) -> float:
    """Spearman's."""
    return float(np.corrcoef(rankdata(one), rankdata(other))[0, 1])
