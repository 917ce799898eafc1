"""How a receiver's fixes err, as far as innovations tell: how much of it is white, and how fast the rest drifts.

A fix errs in two ways: a white part, new with every fix, and one that hangs together over a minute (multipath,
ionosphere, the receiver's own smoothing). What the receiver states is taken as the whole; how much of it is white
is learnt from the innovations, and the rest is a state of the filter (first-order Gauss-Markov; Groves 2013,
sec. 14.2.6), so that many fixes do not promise more than they can hold.

Innovations see only what changes between fixes. Where fixes drift less against the path than that state would, it is
made as small as their drift, and what is stated beyond is an offset that no fix shows: it moves nothing, and is told
in the spread of positions. Where innovations are larger than all of that allows, the receiver states too little, and
its variances are taken for larger as long as they are.
"""

from __future__ import annotations

import math

from core.compiled import compiled
from core.measurements import FloatArray, TimeArray
from core.navigation.state import (
    GNSS_ERROR,
    POS,
    T_ANCHOR,
    T_DECAY,
    T_NOW,
    X_ANCHOR,
    X_DECAY,
    X_DECAY_VAR,
    X_DRIFT,
    X_DRIFTS,
    X_EXCHANGED,
    X_GNSS_DELAY,
    X_GNSS_ERROR,
    X_MOVED,
    X_MOVING,
    X_SLOW_VAR,
    X_V,
    X_WHITE_FIXES,
    X_WHITE_SHARE,
    X_WORSE,
)
from core.navigation.tuning import PARAMETER

_P_CORRELATION = PARAMETER["gnss_correlation_s"]
_P_DRIFT = PARAMETER["gnss_drift_s"]
_P_DRIFT_LEARN = PARAMETER["gnss_drift_learn"]
_P_DRIFT_CHANGE = PARAMETER["gnss_drift_change"]
_P_FLOOR = PARAMETER["gnss_sd_floor_m"]
_P_LEARN = PARAMETER["gnss_learn_fixes"]
_P_MARGIN = PARAMETER["gnss_share_margin"]
_P_WORSE_MARGIN = PARAMETER["gnss_worse_margin"]
_P_WORSE_GAIN = PARAMETER["gnss_worse_gain"]
_P_WORSE_MOST = PARAMETER["gnss_worse_most"]

DRIVING_MPS = 1.0
"""Below this a receiver may hold its fix, and reflections stay: it drifts less than it errs. A choice."""

WILD_RATIO = 9.0
"""An innovation this many times its variance says nothing of the white part: it is an outlier."""


@compiled()
def slow_share(x: FloatArray, par: FloatArray) -> float:
    """Share of a fix's stated variance that hangs together in time."""
    return float(max(0.0, 1.0 - x[X_WHITE_SHARE] - par[_P_MARGIN]))


@compiled()
def _drift_at_most(x: FloatArray) -> float:
    """The drift of fixes that is above the true one with 95 %: chi-squared of two axes (Wilson & Hilferty 1931)."""
    n = x[X_DRIFTS]
    return float(x[X_DRIFT] / (1.0 - 1.0 / (9.0 * n) - 1.645 / (3.0 * math.sqrt(n))) ** 3)


@compiled()
def moving_share(x: FloatArray, stated: float, par: FloatArray) -> float:
    """Share of the slow error that drifts with ``gnss_correlation_s``; the rest stays, and no fix shows it.

    A first-order Gauss-Markov error of variance v drifts by 2 v / T in a second. Learnt is that; that the receiver is
    as good as it drifts little is not: what is stated beyond remains an offset which all of its fixes share.
    """
    slow = slow_share(x, par)
    if x[X_DRIFTS] < 1.0 or slow <= 0.0:
        return 1.0
    least = par[_P_FLOOR] * par[_P_FLOOR] / stated
    return float(min(1.0, max(_drift_at_most(x) * par[_P_CORRELATION], least) / slow))


@compiled()
def learn_drift(
    x: FloatArray, ti: TimeArray, t_ns: int, away_n: float, away_e: float, stated: float, par: FloatArray
) -> None:
    """Learn from how far fixes move against the path as it runs between corrections.

    Of white errors, and of the path's own, that has more than there is: the drift is not underrated.

    Parameters
    ----------
    away_n, away_e : fix against the path now, m, with the receiver's delay as known now
    stated : variance of the fix, m2
    """
    if x[X_V] ** 2 + x[X_V + 1] ** 2 < DRIVING_MPS**2:
        ti[T_ANCHOR] = 0
        return
    since_s = (t_ns - ti[T_ANCHOR]) * 1e-9
    if ti[T_ANCHOR] > 0 and since_s < par[_P_DRIFT]:
        return
    # What a delay makes is taken off, so that it is the same at both ends also where it was learnt between.
    delay_s = x[X_GNSS_DELAY]
    away_n -= delay_s * x[X_V]
    away_e -= delay_s * x[X_V + 1]
    if ti[T_ANCHOR] > 0 and since_s < 2.0 * par[_P_DRIFT]:
        n = away_n + x[X_MOVED] - x[X_ANCHOR] + delay_s * (x[X_V] - x[X_ANCHOR + 2])
        e = away_e + x[X_MOVED + 1] - x[X_ANCHOR + 1] + delay_s * (x[X_V + 1] - x[X_ANCHOR + 3])
        drift = min((n * n + e * e) / (4.0 * stated * since_s), WILD_RATIO / par[_P_CORRELATION])
        if x[X_DRIFTS] >= 1.0 and drift > par[_P_DRIFT_CHANGE] * _drift_at_most(x):
            x[X_DRIFTS] = 0.0  # elsewhere, as between houses, what was learnt does not hold
        x[X_DRIFTS] = min(x[X_DRIFTS] + 1.0, par[_P_DRIFT_LEARN])
        x[X_DRIFT] += (drift - x[X_DRIFT]) / x[X_DRIFTS]
    ti[T_ANCHOR] = t_ns
    x[X_ANCHOR], x[X_ANCHOR + 1], x[X_ANCHOR + 2], x[X_ANCHOR + 3] = away_n, away_e, x[X_V], x[X_V + 1]
    x[X_MOVED], x[X_MOVED + 1] = 0.0, 0.0


@compiled()
def decay(
    x: FloatArray, ti: TimeArray, p: FloatArray, n: int, slow: tuple[float, float], moving: float, par: FloatArray
) -> None:
    """Carry the slowly varying error of the fixes up to now, towards the share ``moving`` of the variances ``slow``.

    Nothing else depends on these states over time, so it is enough to do this when a fix comes.
    """
    slow_h, slow_v = moving * slow[0], moving * slow[1]
    dt = (ti[T_NOW] - ti[T_DECAY]) * 1e-9
    ti[T_DECAY] = ti[T_NOW]
    beta = math.exp(-dt / par[_P_CORRELATION])
    forgotten = 1.0 - beta * beta
    if moving < x[X_MOVING]:
        # What was taken for drift and turns out to stay is left to all fixes and to the position alike.
        beta *= math.sqrt(moving / x[X_MOVING])
    for i in range(3):
        # And where it turns out to move after all, the position is off by it, with its sign turned.
        moved = max(0.0, moving - x[X_MOVING]) * slow[i // 2]
        at, error = (POS + i) * n, (GNSS_ERROR + i) * n
        p[at + POS + i] += moved
        p[error + GNSS_ERROR + i] += moved
        p[at + GNSS_ERROR + i] -= moved
        p[error + POS + i] -= moved
        if i > 0:
            x[X_EXCHANGED + i - 1] += moved
            x[X_SLOW_VAR + i - 1] += moved
    x[X_MOVING] = moving
    # Where the receiver has become worse, its slow error may have as well, at once.
    added_h = slow_h * forgotten + max(0.0, slow_h - x[X_SLOW_VAR])
    added_v = slow_v * forgotten + max(0.0, slow_v - x[X_SLOW_VAR + 1])
    x[X_SLOW_VAR], x[X_SLOW_VAR + 1] = slow_h, slow_v
    for i in range(GNSS_ERROR, GNSS_ERROR + 3):
        for j in range(n):
            p[i * n + j] *= beta
        for j in range(n):
            p[j * n + i] *= beta
        x[X_GNSS_ERROR + i - GNSS_ERROR] *= beta
        added = added_v if i == GNSS_ERROR + 2 else added_h
        p[i * n + i] += added
        x[X_DECAY_VAR + i - GNSS_ERROR] += added
    x[X_DECAY] *= beta


@compiled()
def learn_share(x: FloatArray, nu_sq: float, own: float, stated: float, par: FloatArray) -> None:
    """Let the white share follow what an innovation's square has beyond the filter's ``own`` variance.

    All of them means of north and east. A filter that knows little itself, as after an outage, has nothing to compare.
    """
    if own > stated:
        return
    x[X_WHITE_FIXES] = min(x[X_WHITE_FIXES] + 1.0, par[_P_LEARN])
    share = min((nu_sq - own) / stated, WILD_RATIO)
    x[X_WHITE_SHARE] = max(0.0, x[X_WHITE_SHARE] + (share - x[X_WHITE_SHARE]) / x[X_WHITE_FIXES])


@compiled()
def worse(x: FloatArray, par: FloatArray) -> float:
    """By what factor a fix's horizontal variance is taken for larger than the receiver states."""
    return float(max(1.0, x[X_WORSE] / par[_P_WORSE_MARGIN]))


@compiled()
def learn_worse(x: FloatArray, nis: float, par: FloatArray) -> None:
    """Follow by an innovation's square over its variance, of mean 1 where all is as stated, how wrong a receiver is.

    Stochastic approximation of the variance at which they agree but for the margin (Robbins & Monro 1951), in its
    logarithm, and so quick that it is there within a street: between houses receivers see that the sky is bad, but
    not how bad.
    """
    margin = par[_P_WORSE_MARGIN]
    factor = x[X_WORSE] * (1.0 + par[_P_WORSE_GAIN] * (nis - margin))
    x[X_WORSE] = min(max(factor, 1.0), margin * par[_P_WORSE_MOST])
