"""What all aids share: closing the loop into the nominal state, and the record and count of what became of them."""

from __future__ import annotations

import math

from core.compiled import compiled
from core.measurements import FloatArray, TimeArray
from core.navigation.mechanization import turn_mounting
from core.navigation.state import (
    ACCEL_BIAS,
    ATT,
    BARO_BIAS,
    GNSS_DELAY,
    GNSS_ERROR,
    GYRO_BIAS,
    GYRO_SCALE,
    I_COUNTS,
    I_RECORDS,
    MOUNT_PITCH,
    MOUNT_YAW,
    N_STATES,
    OUTCOMES,
    POS,
    SPEED_SCALE,
    VEL,
    X_BA,
    X_BARO_BIAS,
    X_BG,
    X_DR,
    X_GNSS_DELAY,
    X_GNSS_ERROR,
    X_GYRO_SCALE,
    X_MOVED,
    X_Q,
    X_SCALE,
    X_V,
)

Work = tuple[int, FloatArray, FloatArray, FloatArray, TimeArray, FloatArray]
"""Scratch of one call: number of states, error estimate dx (n,), two P H' (n,); times and rows of the records.

The number of states comes at run time on purpose: of a constant the compiler makes slower, unrolled loops.
"""

_OUTCOMES = len(OUTCOMES)


@compiled()
def correct(x: FloatArray, dx: FloatArray) -> None:
    """Close the loop: bring the error estimate ``dx`` into the nominal state and clear it."""
    x[X_DR] += dx[POS]
    x[X_DR + 1] += dx[POS + 1]
    x[X_DR + 2] += dx[POS + 2]
    x[X_MOVED] += dx[POS]
    x[X_MOVED + 1] += dx[POS + 1]
    for i in range(3):
        x[X_V + i] += dx[VEL + i]
        x[X_BG + i] += dx[GYRO_BIAS + i]
        x[X_BA + i] += dx[ACCEL_BIAS + i]
        x[X_GNSS_ERROR + i] += dx[GNSS_ERROR + i]
    x[X_SCALE] += dx[SPEED_SCALE]
    x[X_GNSS_DELAY] += dx[GNSS_DELAY]
    x[X_BARO_BIAS] += dx[BARO_BIAS]
    x[X_GYRO_SCALE] += dx[GYRO_SCALE]
    turn_mounting(x, dx[MOUNT_PITCH], dx[MOUNT_YAW])
    hx, hy, hz = 0.5 * dx[ATT], 0.5 * dx[ATT + 1], 0.5 * dx[ATT + 2]
    w, qx, qy, qz = x[X_Q], x[X_Q + 1], x[X_Q + 2], x[X_Q + 3]
    nw = w - hx * qx - hy * qy - hz * qz
    nx = qx + hx * w + hy * qz - hz * qy
    ny = qy - hx * qz + hy * w + hz * qx
    nz = qz + hx * qy - hy * qx + hz * w
    k = 1.0 / math.sqrt(nw * nw + nx * nx + ny * ny + nz * nz)
    x[X_Q], x[X_Q + 1], x[X_Q + 2], x[X_Q + 3] = nw * k, nx * k, ny * k, nz * k
    for i in range(N_STATES):
        dx[i] = 0.0


@compiled()
def count(ti: TimeArray, aid: int, outcome: int) -> None:
    """Count what became of an aid."""
    ti[I_COUNTS + aid * _OUTCOMES + outcome] += 1


@compiled()
def record(
    ti: TimeArray,
    work: Work,
    t_ns: int,
    aid: int,
    axis: int,
    innovation: float,
    variance: float,
    ratio: float,
    outcome: int,
) -> None:
    """Write an aid's record (see ``records``); what no longer fits is dropped."""
    log_t_ns, log = work[4], work[5]
    row = ti[I_RECORDS]
    if row >= log_t_ns.shape[0]:
        return
    log_t_ns[row] = t_ns
    log[row, 0], log[row, 1], log[row, 2] = aid, axis, innovation
    log[row, 3], log[row, 4], log[row, 5] = variance, ratio, outcome
    ti[I_RECORDS] = row + 1
