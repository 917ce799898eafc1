"""Whether the vehicle stands: a statistical test over one second of means, not a speed threshold alone."""

from __future__ import annotations

import math

from core.compiled import compiled
from core.earth import STANDARD_GRAVITY_MPS2
from core.measurements import FloatArray, TimeArray
from core.navigation.mechanization import matrix_of
from core.navigation.state import (
    ATT,
    GYRO_BIAS,
    I_BLOCK,
    I_BLOCKS,
    I_STATIONARY,
    N_BLOCKS,
    N_STATES,
    T_NOW,
    T_QUIET,
    VEL,
    X_BA,
    X_BG,
    X_BLOCK,
    X_BLOCK_SUMS,
    X_HEAVE,
    X_NEWEST,
    X_Q,
    X_RING,
    X_RISING,
    X_RISING_N,
    X_STILL_F,
    X_STILL_W,
    X_V,
    X_VERTICAL,
)
from core.navigation.tuning import PARAMETER

LEARN_SHARE = 0.05
"""Share by which the level of a standing vehicle's spread follows each block: some 2 s."""

_STILL_ACCEL = PARAMETER["still_accel_sd_mps2"]
_STILL_GYRO = PARAMETER["still_gyro_sd_radps"]
_STILL_FACTOR = PARAMETER["still_factor"]
_STILL_MEAN = PARAMETER["still_mean_accel_mps2"]
_STILL_RATE = PARAMETER["still_mean_gyro_radps"]
_STILL_PATIENCE = PARAMETER["still_patience_s"]
_STILL_LEAVING = PARAMETER["still_leaving"]
_GATE_VELOCITY = PARAMETER["gate_velocity"]
_STILL_ROLLING = PARAMETER["still_rolling_mps"]
_STILL_LONGEST = PARAMETER["still_longest_patience_s"]
_ZUPT = PARAMETER["zupt_sd_mps"]
_STILL_SPEED = PARAMETER["still_max_speed_mps"]


@compiled()
def _moments(x: FloatArray, at: int, step: int) -> tuple[float, float]:
    """Mean and variance of N_BLOCKS numbers, ``step`` apart from ``at`` on."""
    total, squares = 0.0, 0.0
    first = x[at]
    for j in range(N_BLOCKS):
        d = x[at + step * j] - first
        total += d
        squares += d * d
    return first + total / N_BLOCKS, max(squares / N_BLOCKS - (total / N_BLOCKS) ** 2, 0.0)


@compiled()
def _speed_sd(p: FloatArray) -> float:
    """The larger sd of the horizontal velocity."""
    i0 = VEL * N_STATES + VEL
    return math.sqrt(max(p[i0], p[i0 + N_STATES + 1]))


@compiled()
def _moving_ratio(x: FloatArray, p: FloatArray, par: FloatArray) -> float:
    """The square of the horizontal velocity over its variance, and over that of a standing car: chi-squared of two."""
    i0 = VEL * N_STATES + VEL
    rocking = par[_ZUPT] ** 2
    snn, see, sne = p[i0] + rocking, p[i0 + N_STATES + 1] + rocking, p[i0 + 1]
    vn, ve = x[X_V], x[X_V + 1]
    return float((see * vn * vn - 2.0 * sne * vn * ve + snn * ve * ve) / (snn * see - sne * sne))


@compiled()
def _as_when_standing(x: FloatArray, par: FloatArray, spread_f: float, spread_w: float) -> bool:
    """Whether it is about as quiet as was learnt of this vehicle when it surely stood; not before it was learnt."""
    factor = par[_STILL_FACTOR]
    return bool(spread_f <= factor * x[X_STILL_F] and spread_w <= factor * x[X_STILL_W])


@compiled()
def _quiet(x: FloatArray, ti: TimeArray, p: FloatArray, par: FloatArray, speed_sd: float) -> tuple[bool, float, float]:
    """Whether over one second the means hardly move (they hide the engine's shaking, not the body's on its springs).

    And what is left of them is gravity and biases alone, and the filter does not hold a speed far above its own
    uncertainty. With the spreads of force (m/s2) and rate (rad/s).
    """
    limit = par[_STILL_SPEED] + 3.0 * speed_sd
    if x[X_V] ** 2 + x[X_V + 1] ** 2 > limit * limit:
        return False, 0.0, 0.0
    mean_0, variance_0 = _moments(x, X_RING, 6)
    mean_1, variance_1 = _moments(x, X_RING + 1, 6)
    mean_2, variance_2 = _moments(x, X_RING + 2, 6)
    spread_f = variance_0 + variance_1 + variance_2
    spread_w, turning_sq, rate_var = 0.0, 0.0, 0.0
    for i in range(3):
        mean, variance = _moments(x, X_RING + 3 + i, 6)
        spread_w += variance
        turning_sq += (mean - x[X_BG + i]) ** 2
        rate_var = max(rate_var, p[(GYRO_BIAS + i) * (N_STATES + 1)])
    # A bend driven evenly is as quiet as standing, but for its rate.
    limit = par[_STILL_RATE] + 3.0 * math.sqrt(rate_var)
    if turning_sq > limit * limit:
        return False, 0.0, 0.0
    if spread_f > par[_STILL_ACCEL] ** 2 or spread_w > par[_STILL_GYRO] ** 2:
        return False, 0.0, 0.0
    spread_f, spread_w = math.sqrt(spread_f), math.sqrt(spread_w)
    # A gentle pull-away hides in the second's spread until it has gained some 0.1 m/s, and would be taken for tilt.
    newest = X_RING + ((ti[I_BLOCKS] - 1) % N_BLOCKS) * 6
    leaving_sq = (x[newest] - mean_0) ** 2 + (x[newest + 1] - mean_1) ** 2 + (x[newest + 2] - mean_2) ** 2
    if x[X_STILL_F] > 0.0 and leaving_sq > (par[_STILL_LEAVING] * x[X_STILL_F]) ** 2:
        return False, 0.0, 0.0
    # Where the filter's own speed is no witness, it has to be as quiet as this vehicle is when it stands.
    uncertain = speed_sd > par[_STILL_SPEED]
    if uncertain and x[X_STILL_F] > 0.0 and not _as_when_standing(x, par, spread_f, spread_w):
        return False, 0.0, 0.0
    # Pulling away evenly is smooth too: what gravity and bias leave must be nothing.
    left_0, left_1, left_2 = mean_0 - x[X_BA], mean_1 - x[X_BA + 1], mean_2 - x[X_BA + 2]
    c0, c1, c2, c3, c4, c5, _, _, _ = matrix_of(x[X_Q], x[X_Q + 1], x[X_Q + 2], x[X_Q + 3])
    an = c0 * left_0 + c1 * left_1 + c2 * left_2
    ae = c3 * left_0 + c4 * left_1 + c5 * left_2
    i0 = ATT * N_STATES + ATT
    tilt = math.sqrt(max(p[i0], p[i0 + N_STATES + 1]))
    limit = par[_STILL_MEAN] + 3.0 * STANDARD_GRAVITY_MPS2 * tilt
    if an * an + ae * ae > limit * limit:
        return False, 0.0, 0.0
    return True, spread_f, spread_w


@compiled()
def close_block(x: FloatArray, ti: TimeArray, p: FloatArray, par: FloatArray) -> None:
    """Put means over the last two blocks into the ring and decide whether the vehicle stands.

    They are weighted by a hat, which leaves a hundredth of an engine's shaking at 27 Hz where a plain mean of one block
    leaves a tenth: of 2 m/s2 that would be no rest.

    It has to be quiet, and the longer, the surer the filter is that it moves: an even creep on a smooth road feels
    like standing, but does not last.
    """
    count = ti[I_BLOCK]
    ti[I_STATIONARY] = 0
    if count == 0:
        x[X_RISING_N] = 0.0
        ti[I_BLOCKS] = 0
        ti[T_QUIET] = 0
        return
    row = X_RING + (ti[I_BLOCKS] % N_BLOCKS) * 6
    before = x[X_RISING_N]
    for i in range(3):
        x[X_NEWEST + i] = x[X_BLOCK + i] / count
    x[X_VERTICAL + ti[I_BLOCKS] % N_BLOCKS] = x[X_NEWEST + 2]
    for i in range(6):
        # Of sample k of n the sums of sums have n - k + 1.
        falling = (x[X_BLOCK_SUMS + i] - 0.5 * x[X_BLOCK + i]) / count
        x[row + i] = (x[X_RISING + i] + falling) / (0.5 * (before + count))
        x[X_RISING + i] = x[X_BLOCK + i] - falling
        x[X_BLOCK + i], x[X_BLOCK_SUMS + i] = 0.0, 0.0
    x[X_RISING_N] = count
    ti[I_BLOCK] = 0
    if before == 0.0:
        return
    ti[I_BLOCKS] += 1
    if ti[I_BLOCKS] < N_BLOCKS:
        return
    x[X_HEAVE] = math.sqrt(_moments(x, X_VERTICAL, 1)[1])
    speed_sd = _speed_sd(p)
    quiet, spread_f, spread_w = _quiet(x, ti, p, par, speed_sd)
    if not quiet:
        ti[T_QUIET] = 0
        return
    if ti[T_QUIET] == 0:
        ti[T_QUIET] = ti[T_NOW]
    ratio = _moving_ratio(x, p, par)
    patience_s = par[_STILL_PATIENCE] * ratio
    # As quiet as this vehicle is when it stands, and by the filter either no wonder if it did, or faster than any creep
    # is: then the filter is wrong.
    rolling_sq = x[X_V] ** 2 + x[X_V + 1] ** 2
    wrong = ratio <= par[_GATE_VELOCITY] or rolling_sq > par[_STILL_ROLLING] ** 2
    if wrong and _as_when_standing(x, par, spread_f, spread_w):
        patience_s = min(patience_s, par[_STILL_LONGEST])
    if (ti[T_NOW] - ti[T_QUIET]) * 1e-9 < patience_s:
        return
    ti[I_STATIONARY] = 1
    if speed_sd <= par[_STILL_SPEED]:
        share = LEARN_SHARE if x[X_STILL_F] > 0.0 else 1.0
        x[X_STILL_F] += share * (spread_f - x[X_STILL_F])
        x[X_STILL_W] += share * (spread_w - x[X_STILL_W])
