"""What a smoother needs of each instant at which the filter propagated its covariance: one row of a table.

A row holds the interval that ends there (the parts of Phi and Q), the nominal state as mechanised up to it and as
the aids left it, and the covariance after them.
"""

from __future__ import annotations

from typing import Final

from core.compiled import compiled
from core.measurements import FloatArray, TimeArray
from core.navigation.kalman import Nine
from core.navigation.state import (
    N_STATES,
    T_BROKEN,
    X_ALT,
    X_BARO_BIAS,
    X_BG,
    X_DECAY,
    X_DECAY_VAR,
    X_DR,
    X_EXCHANGED,
    X_GNSS_DELAY,
    X_GNSS_ERROR,
    X_GYRO_SCALE,
    X_LAT,
    X_LON,
    X_M_PER_RAD,
    X_MOUNT_YAW,
    X_OPENED,
    X_OPENED_TILT,
    X_Q,
    X_UNSEEN,
    X_V,
)

# The nominal state in a row.
S_Q: Final = 0  # q_n_from_b, 4
S_V: Final = 4  # v_n, 3
S_LAT: Final = 7  # rad, rad, m, 3
S_SLOW: Final = 10  # the slow states in the order of the error states from GYRO_BIAS on, 15
N_NOMINAL: Final = 25

# A row.
N_DT: Final = 0  # s since the row before
N_DV: Final = 1  # integral of the specific force in n, 3
N_C: Final = 4  # mean C_n_from_b, 9
N_TURN: Final = 13  # integral of the rate about b's z axis, rad
N_ADDED: Final = 14  # variances that the interval added, N_STATES
N_DECAY: Final = N_ADDED + N_STATES  # factor on the fixes' slow error
N_DECAY_VAR: Final = N_DECAY + 1  # variances that were added to it, 3
N_OPENED: Final = N_DECAY_VAR + 3  # variances that aids added, see X_OPENED and X_OPENED_TILT, 6
N_EXCHANGED: Final = N_OPENED + 6  # see X_EXCHANGED, 2
N_BROKEN: Final = N_EXCHANGED + 2  # if the position was reset here, s since the last fused one, else 0
N_UNSEEN: Final = N_BROKEN + 1  # variance of what fixes err by and none shows, horizontal and vertical, 2
N_BEFORE: Final = N_UNSEEN + 2
N_AFTER: Final = N_BEFORE + N_NOMINAL
N_P: Final = N_AFTER + N_NOMINAL  # upper triangle of the covariance, by rows
NODE_WIDTH: Final = N_P + N_STATES * (N_STATES + 1) // 2


@compiled()
def _put_nominal(x: FloatArray, row: FloatArray, at: int) -> None:
    for i in range(4):
        row[at + S_Q + i] = x[X_Q + i]
    for i in range(3):
        row[at + S_V + i] = x[X_V + i]
    row[at + S_LAT] = x[X_LAT] + x[X_DR] / x[X_M_PER_RAD]
    row[at + S_LAT + 1] = x[X_LON] + x[X_DR + 1] / x[X_M_PER_RAD + 1]
    row[at + S_LAT + 2] = x[X_ALT] - x[X_DR + 2]
    slow = at + S_SLOW
    for i in range(X_MOUNT_YAW + 1 - X_BG):
        row[slow + i] = x[X_BG + i]
    slow += X_MOUNT_YAW + 1 - X_BG
    for i in range(3):
        row[slow + i] = x[X_GNSS_ERROR + i]
    row[slow + 3], row[slow + 4], row[slow + 5] = x[X_GNSS_DELAY], x[X_BARO_BIAS], x[X_GYRO_SCALE]


@compiled()
def open_node(
    x: FloatArray, row: FloatArray, dt: float, dv: tuple[float, float, float], c: Nine, turn: float, added: FloatArray
) -> None:
    """Write the interval and the state before any aid."""
    row[N_DT] = dt
    row[N_DV], row[N_DV + 1], row[N_DV + 2] = dv
    for i in range(9):
        row[N_C + i] = c[i]
    row[N_TURN] = turn
    for i in range(N_STATES):
        row[N_ADDED + i] = added[i]
    _put_nominal(x, row, N_BEFORE)


@compiled()
def close_node(x: FloatArray, ti: TimeArray, p: FloatArray, row: FloatArray) -> None:
    """Write the state and the covariance as the aids left them."""
    row[N_DECAY] = x[X_DECAY]
    for i in range(3):
        row[N_DECAY_VAR + i] = x[X_DECAY_VAR + i]
    for i in range(5):
        row[N_OPENED + i] = x[X_OPENED + i]
    row[N_OPENED + 5] = x[X_OPENED_TILT]
    row[N_EXCHANGED], row[N_EXCHANGED + 1] = x[X_EXCHANGED], x[X_EXCHANGED + 1]
    row[N_BROKEN] = ti[T_BROKEN] * 1e-9
    row[N_UNSEEN], row[N_UNSEEN + 1] = x[X_UNSEEN], x[X_UNSEEN + 1]
    _put_nominal(x, row, N_AFTER)
    at = N_P
    for i in range(N_STATES):
        for j in range(i, N_STATES):
            row[at] = p[i * N_STATES + j]
            at += 1
