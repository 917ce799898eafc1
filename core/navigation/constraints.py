"""What a vehicle on wheels cannot do: slide sideways, rise, roll faster than its wheels turn, turn while it stands.

Innovations are z - h(x). Past its gate a constraint still pulls, with the variance under which it would just pass;
far past it (a skid, a leap) it is refused.
"""

from __future__ import annotations

from core.compiled import compiled
from core.earth import STANDARD_GRAVITY_MPS2
from core.measurements import FloatArray, TimeArray
from core.navigation.correction import Work, correct, count, record
from core.navigation.kalman import Nine, along_nine, decorrelate, project_axis, project_nine, update, update_pair
from core.navigation.mechanization import matrix_of
from core.navigation.state import (
    A_NHC,
    A_SPEED,
    A_ZARU,
    A_ZUPT,
    ATT,
    FUSED,
    GYRO_BIAS,
    I_BLOCKS,
    MOUNT_PITCH,
    MOUNT_YAW,
    N_BLOCKS,
    N_STATES,
    REJECTED_GATE,
    REJECTED_RANGE,
    SPEED_SCALE,
    T_NOW,
    T_READING,
    T_REPEATED,
    VEL,
    X_BA,
    X_BG,
    X_GAINED,
    X_HEAVE,
    X_MOUNT_SC,
    X_NEWEST,
    X_Q,
    X_READING,
    X_RING,
    X_RISING_N,
    X_SCALE,
    X_SQUAT,
    X_SQUAT_VAR,
    X_V,
    X_W,
)
from core.navigation.tuning import PARAMETER

_P_GATE = PARAMETER["gate_scalar"]
_P_NHC = PARAMETER["nhc_sd_mps"]
_P_NHC_LEVER = PARAMETER["nhc_lever_m"]
_P_NHC_SPEED = PARAMETER["nhc_min_speed_mps"]
_P_HEAVE = PARAMETER["heave_radps"]
_P_SQUAT_SHARE = PARAMETER["squat_share"]
_P_SPEED = PARAMETER["speed_sd_mps"]
_P_REVERSE_ODDS = PARAMETER["reverse_log_odds"]
_P_ZUPT = PARAMETER["zupt_sd_mps"]
_P_ZARU = PARAMETER["zaru_sd_radps"]

ROBUST_LIMIT = 25.0
"""A constraint or wheel speed this far beyond its gate (five times the innovation) is refused: a skid."""

HUNG_MPS = 0.5
"""By so much the speed has to change while its reading stays, 0.3 to 2: a speedometer's steps are 0.28 m/s."""
HUNG_MPS2 = 0.1
"""And by this for each second, 0.02 to 0.5: half a degree of tilt, 10 mg of bias."""

_Vector = tuple[float, float, float]
_STATES = (VEL, VEL + 1, VEL + 2, ATT, ATT + 1, ATT + 2, MOUNT_PITCH, MOUNT_YAW, SPEED_SCALE)
"""What a speed along an axis of the vehicle depends on."""


@compiled()
def _row_along(
    c: Nine, v_n: _Vector, v_b: _Vector, u: _Vector, du_pitch: _Vector, du_yaw: _Vector, gain: float, ninth: float
) -> tuple[float, Nine]:
    """The speed along an axis ``u`` of b, and the row of gain times it by ``_STATES``, the last factor as given.

    d(u . C' v) = (C u) . dv + ((C u) x v) . phi + (du . v_b): from C(true) = (I + [phi x]) C.
    """
    vn, ve, vd = v_n
    wn = gain * (c[0] * u[0] + c[1] * u[1] + c[2] * u[2])
    we = gain * (c[3] * u[0] + c[4] * u[1] + c[5] * u[2])
    wd = gain * (c[6] * u[0] + c[7] * u[1] + c[8] * u[2])
    return u[0] * v_b[0] + u[1] * v_b[1] + u[2] * v_b[2], (
        wn,
        we,
        wd,
        we * vd - wd * ve,
        wd * vn - wn * vd,
        wn * ve - we * vn,
        gain * (du_pitch[0] * v_b[0] + du_pitch[1] * v_b[1] + du_pitch[2] * v_b[2]),
        gain * (du_yaw[0] * v_b[0] + du_yaw[1] * v_b[1] + du_yaw[2] * v_b[2]),
        ninth,
    )


@compiled()
def _velocity_b(c: Nine, v_n: _Vector) -> _Vector:
    vn, ve, vd = v_n
    return (
        c[0] * vn + c[3] * ve + c[6] * vd,
        c[1] * vn + c[4] * ve + c[7] * vd,
        c[2] * vn + c[5] * ve + c[8] * vd,
    )


@compiled()
def _forward_mps2(x: FloatArray, c: Nine) -> float:
    """What the accelerometers say of the last block along b's x axis, without gravity."""
    if x[X_RISING_N] == 0.0:
        return 0.0
    return float(x[X_NEWEST] - x[X_BA] + STANDARD_GRAVITY_MPS2 * c[6])


@compiled()
def fuse_non_holonomic(x: FloatArray, ti: TimeArray, p: FloatArray, par: FloatArray, work: Work) -> None:
    """A car goes where its wheels point: no lateral and no vertical speed in the vehicle's own axes.

    Sideways the box moves with the yaw rate times its distance from the rear axle, which is not known. Upwards the
    body moves on its springs, the more the harder it is shaken. Both widen the spread. It squats and dives while the
    road stays, for as long as it accelerates or brakes: how much is learnt, or it would be taken for slope.
    """
    n, dx, ph, ph2 = work[0], work[1], work[2], work[3]
    t_ns = ti[T_NOW]
    if x[X_V] ** 2 + x[X_V + 1] ** 2 < par[_P_NHC_SPEED] ** 2:
        count(ti, A_NHC, REJECTED_RANGE)
        return
    c = matrix_of(x[X_Q], x[X_Q + 1], x[X_Q + 2], x[X_Q + 3])
    v_n = (x[X_V], x[X_V + 1], x[X_V + 2])
    v_b = _velocity_b(c, v_n)
    sp, cp, sy, cy = x[X_MOUNT_SC], x[X_MOUNT_SC + 1], x[X_MOUNT_SC + 2], x[X_MOUNT_SC + 3]
    yaw_rate = x[X_W + 2] - x[X_BG + 2]
    forward_mps2 = _forward_mps2(x, c)
    slip = par[_P_NHC_LEVER] * yaw_rate
    heave = x[X_HEAVE] / par[_P_HEAVE]
    rising = forward_mps2 * v_b[0]
    squat = x[X_SQUAT] * rising
    squat_var = x[X_SQUAT_VAR] * rising * rising
    base = par[_P_NHC] * par[_P_NHC]

    lateral, row = _row_along(c, v_n, v_b, (-sy, cy, 0.0), (0.0, 0.0, 0.0), (-cy, -sy, 0.0), 1.0, 0.0)
    s1 = project_nine(p, n, _STATES, row, ph) + base + slip * slip
    nu1 = -lateral
    ratio1 = nu1 * nu1 / (par[_P_GATE] * s1)
    inverse1 = 0.0 if ratio1 > ROBUST_LIMIT else 1.0 / (s1 * max(ratio1, 1.0))

    vertical, row = _row_along(
        c, v_n, v_b, (cy * sp, sy * sp, cp), (cy * cp, sy * cp, -sp), (-sy * sp, cy * sp, 0.0), 1.0, 0.0
    )
    s2 = project_nine(p, n, _STATES, row, ph2) + base + heave * heave + squat_var
    cross = along_nine(_STATES, row, ph)
    decorrelate(n, ph, ph2, cross * inverse1)
    s2 -= cross * cross * inverse1
    nu2 = squat - vertical - cross * inverse1 * nu1
    ratio2 = nu2 * nu2 / (par[_P_GATE] * s2)
    inverse2 = 0.0 if ratio2 > ROBUST_LIMIT else 1.0 / (s2 * max(ratio2, 1.0))

    # Learnt beside the filter: a state of its own would cost every propagation, and the errors of the others are small.
    gain = par[_P_SQUAT_SHARE] * x[X_SQUAT_VAR] * rising * inverse2
    x[X_SQUAT] -= gain * nu2
    x[X_SQUAT_VAR] *= 1.0 - gain * rising
    update_pair(p, n, ph, inverse1, nu1, ph2, inverse2, nu2, dx)
    correct(x, dx)
    outcome1 = FUSED if inverse1 > 0.0 else REJECTED_GATE
    outcome2 = FUSED if inverse2 > 0.0 else REJECTED_GATE
    count(ti, A_NHC, outcome1)
    count(ti, A_NHC, outcome2)
    record(ti, work, t_ns, A_NHC, 0, nu1, s1, ratio1, outcome1)
    record(ti, work, t_ns, A_NHC, 1, nu2, s2, ratio2, outcome2)


@compiled()
def _reverses(p: FloatArray, row: Nine, forward_mps: float, reading_mps: float, variance: float, odds: float) -> bool:
    """Whether the vehicle rather goes backwards at the speed that its wheels say without a sign.

    The two readings of a speed r against a forward speed f of variance s differ in log-likelihood by 2 r f / s;
    ``odds`` is how much more often a vehicle goes forwards, as a logarithm.
    """
    for i in range(3):
        for j in range(3):
            variance += row[i] * p[(VEL + i) * N_STATES + VEL + j] * row[j]
    return -2.0 * reading_mps * forward_mps > odds * variance


@compiled()
def _hangs(x: FloatArray, ti: TimeArray, t_ns: int, reading_mps: float, c: Nine) -> bool:
    """Whether the wheel speed says to the last bit what it said before, while the vehicle has become faster or slower.

    That is what its accelerometers say since; they can be wrong by their tilt and bias for as long.
    """
    if reading_mps != x[X_READING] or ti[T_READING] == 0:
        x[X_READING], x[X_GAINED] = reading_mps, 0.0
        ti[T_REPEATED] = t_ns
    else:
        x[X_GAINED] += _forward_mps2(x, c) * (t_ns - ti[T_READING]) * 1e-9
    ti[T_READING] = t_ns
    return bool(abs(x[X_GAINED]) > HUNG_MPS + HUNG_MPS2 * (t_ns - ti[T_REPEATED]) * 1e-9)


@compiled()
def fuse_speed(
    x: FloatArray, ti: TimeArray, p: FloatArray, t_ns: int, reading_mps: float, par: FloatArray, work: Work
) -> None:
    """Wheel speed: (1 + scale) times the speed along the vehicle's forward axis, without its sign."""
    n, dx, ph = work[0], work[1], work[2]
    c = matrix_of(x[X_Q], x[X_Q + 1], x[X_Q + 2], x[X_Q + 3])
    if _hangs(x, ti, t_ns, reading_mps, c):
        count(ti, A_SPEED, REJECTED_RANGE)
        return
    v_n = (x[X_V], x[X_V + 1], x[X_V + 2])
    v_b = _velocity_b(c, v_n)
    sp, cp, sy, cy = x[X_MOUNT_SC], x[X_MOUNT_SC + 1], x[X_MOUNT_SC + 2], x[X_MOUNT_SC + 3]
    gain, variance = 1.0 + x[X_SCALE], par[_P_SPEED] * par[_P_SPEED]
    forward = cy * cp * v_b[0] + sy * cp * v_b[1] - sp * v_b[2]
    _, row = _row_along(
        c, v_n, v_b, (cy * cp, sy * cp, -sp), (-cy * sp, -sy * sp, -cp), (-sy * cp, cy * cp, 0.0), gain, forward
    )
    if _reverses(p, row, gain * forward, reading_mps, variance, par[_P_REVERSE_ODDS]):
        reading_mps = -reading_mps
    s = project_nine(p, n, _STATES, row, ph) + variance
    nu = reading_mps - gain * forward
    ratio = nu * nu / (par[_P_GATE] * s)
    outcome = REJECTED_GATE if ratio > ROBUST_LIMIT else FUSED
    if outcome == FUSED:
        update(p, n, ph, s * max(ratio, 1.0), nu, dx)
        correct(x, dx)
    count(ti, A_SPEED, outcome)
    record(ti, work, t_ns, A_SPEED, 0, nu, s, ratio, outcome)


@compiled()
def fuse_standstill(x: FloatArray, ti: TimeArray, p: FloatArray, par: FloatArray, work: Work) -> None:
    """Standing: velocity is zero, and what the gyroscopes read is their bias (Earth rate is below their noise)."""
    n, dx, ph = work[0], work[1], work[2]
    t_ns = ti[T_NOW]
    newest = X_RING + ((ti[I_BLOCKS] - 1) % N_BLOCKS) * 6 + 3
    gate = par[_P_GATE]
    variance = par[_P_ZUPT] ** 2
    for i in range(3):
        s = project_axis(p, n, VEL + i, ph) + variance
        nu = -x[X_V + i] - dx[VEL + i]
        update(p, n, ph, s, nu, dx)
        record(ti, work, t_ns, A_ZUPT, i, nu, s, nu * nu / (gate * s), FUSED)
    count(ti, A_ZUPT, FUSED)
    variance = par[_P_ZARU] ** 2
    for i in range(3):
        s = project_axis(p, n, GYRO_BIAS + i, ph) + variance
        nu = x[newest + i] - x[X_BG + i] - dx[GYRO_BIAS + i]
        update(p, n, ph, s, nu, dx)
        record(ti, work, t_ns, A_ZARU, i, nu, s, nu * nu / (gate * s), FUSED)
    count(ti, A_ZARU, FUSED)
    correct(x, dx)
