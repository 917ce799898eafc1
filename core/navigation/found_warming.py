"""How fast a box warms up that does not say so: the gyroscopes' biases tell, by how far corrections move them.

From one second to the next a filter that is right about its biases moves them by corrections whose variance is what
the covariance shrank by, P + Q before less P after, and those of different seconds are independent (innovations are
white; Mehra 1970, IEEE Trans. Automat. Contr. 15 (2)). Biases that drift are moved the same way second after second.

One axis may be moved so by what its model leaves out, as on a real drive the level ones are by turns and slopes. A
box that warms up moves all three: the middle one of them has to be moved beyond its spread, and says by how much.
Its rate is then that of everything that follows the temperature, by the data sheets' coefficients (``Tuning``).
"""

from __future__ import annotations

import math

from core.compiled import compiled
from core.measurements import FloatArray, TimeArray
from core.navigation.state import (
    GYRO_BIAS,
    N_STATES,
    T_BIAS,
    T_GNSS,
    T_NOW,
    X_BG,
    X_BIAS_MOVED,
    X_BIAS_SCORE,
    X_BIAS_SCORE_VAR,
    X_BIAS_SECONDS,
    X_BIAS_THEN,
    X_BIAS_VAR_THEN,
    X_WARMING,
)
from core.navigation.tuning import PARAMETER

_P_SEEN = PARAMETER["warming_seen_s"]
_P_GATE = PARAMETER["gate_warming"]
_P_LEAST = PARAMETER["warming_least_kps"]
_P_FADES = PARAMETER["warming_fades_s"]
_P_PER_K = PARAMETER["gyro_bias_radps_per_k"]
_P_COASTING = PARAMETER["coasting_after_s"]

MOST_SD = 4.0
"""What a second moves a bias by counts for no more: a blow is no drift. A choice, 3 to 10."""
LEAST_SHRUNK = 1e-6
"""A covariance that shrinks by less is one that nothing was learnt of: 1e-3 of its sd. A choice."""


@compiled()
def _middle(a: float, b: float, c: float) -> float:
    return float(max(min(a, b), min(max(a, b), c)))


@compiled()
def learn_warming(x: FloatArray, ti: TimeArray, p: FloatArray, par: FloatArray) -> None:
    """Take in what corrections did to the biases since the call before; to be called once a whole second.

    What was found fades while fixes come that would show it again, and lasts while there are none.
    """
    if ti[T_BIAS] > 0:
        since_s = (ti[T_NOW] - ti[T_BIAS]) * 1e-9
        kept = math.exp(-since_s / par[_P_SEEN])
        for i in range(3):
            variance = p[(GYRO_BIAS + i) * (N_STATES + 1)]
            shrunk = max(x[X_BIAS_VAR_THEN + i] - variance, LEAST_SHRUNK * variance)
            moved = x[X_BG + i] - x[X_BIAS_THEN + i]
            # A bias that is given, and walks not at all, is not moved.
            score = min(max(moved / math.sqrt(shrunk), -MOST_SD), MOST_SD) if shrunk > 0.0 else 0.0
            x[X_BIAS_MOVED + i] = kept * x[X_BIAS_MOVED + i] + moved
            # Each second counts alike, so that the wide moves of an alignment hide no drift for long.
            x[X_BIAS_SCORE + i] = kept * x[X_BIAS_SCORE + i] + score
        x[X_BIAS_SECONDS] = kept * x[X_BIAS_SECONDS] + since_s
        x[X_BIAS_SCORE_VAR] = kept * kept * x[X_BIAS_SCORE_VAR] + 1.0
        if (ti[T_NOW] - ti[T_GNSS]) * 1e-9 <= par[_P_COASTING]:
            x[X_WARMING] *= math.exp(-since_s / par[_P_FADES])
        score = _middle(abs(x[X_BIAS_SCORE]), abs(x[X_BIAS_SCORE + 1]), abs(x[X_BIAS_SCORE + 2]))
        if score * score > par[_P_GATE] * x[X_BIAS_SCORE_VAR] and par[_P_PER_K] > 0.0:
            moved = _middle(abs(x[X_BIAS_MOVED]), abs(x[X_BIAS_MOVED + 1]), abs(x[X_BIAS_MOVED + 2]))
            rate_kps = moved / (x[X_BIAS_SECONDS] * par[_P_PER_K])
            x[X_WARMING] = max(x[X_WARMING], max(rate_kps, par[_P_LEAST]))
    ti[T_BIAS] = ti[T_NOW]
    for i in range(3):
        x[X_BIAS_THEN + i] = x[X_BG + i]
        x[X_BIAS_VAR_THEN + i] = p[(GYRO_BIAS + i) * (N_STATES + 1)]
