"""Measurement updates: GNSS, constraints, standstill, wheel speed. Each counts its outcome.

Innovations are z - h(x). A refused aid changes nothing but counters (and, for positions, the memory from
which a run of refused fixes that agree with each other is recognised as the truth: recovery; a refused height
widens the spread of the filter's own, for the same end).
"""

from __future__ import annotations

import math

from numba import njit

from core.measurements import GNSS, FloatArray, TimeArray
from core.navigation.admission import position_sd_m
from core.navigation.kalman import along, project, project_axis, update
from core.navigation.mechanization import fold_position, matrix_of, turn_mounting
from core.navigation.state import (
    A_HEIGHT,
    A_NHC,
    A_POSITION,
    A_SPEED,
    A_VELOCITY,
    A_ZARU,
    A_ZUPT,
    ACCEL_BIAS,
    ATT,
    FUSED,
    GYRO_BIAS,
    I_GNSS_USED,
    I_REFUSED,
    I_REJECTED,
    I_RESETS,
    MOUNT_PITCH,
    MOUNT_YAW,
    N_STATES,
    POS,
    REJECTED_GATE,
    REJECTED_RANGE,
    REJECTED_TIME,
    RESET,
    SPEED_SCALE,
    T_GNSS,
    T_NOW,
    T_REFUSED,
    T_REJECTED,
    T_SPEED,
    VEL,
    X_ALT,
    X_BA,
    X_BG,
    X_DR,
    X_LAT,
    X_LON,
    X_M_PER_RAD,
    X_MOUNT_SC,
    X_Q,
    X_REJECTED_N,
    X_SCALE,
    X_V,
    X_W,
)
from core.navigation.tuning import PARAMETER

_LAT, _LON, _ALT = GNSS["lat_rad"], GNSS["lon_rad"], GNSS["alt_m"]
_VN, _VE, _VD = GNSS["vn_mps"], GNSS["ve_mps"], GNSS["vd_mps"]
_SPEED, _COURSE = GNSS["speed_mps"], GNSS["course_rad"]
_SD_VEL = GNSS["sd_v_mps"]

_P_SD_VEL = PARAMETER["gnss_sd_v_mps"]
_P_FLOOR_V = PARAMETER["gnss_sd_v_floor_mps"]
_P_AGE = PARAMETER["gnss_max_age_s"]
_P_GATE_POS = PARAMETER["gate_position"]
_P_GATE_VEL = PARAMETER["gate_velocity"]
_P_GATE = PARAMETER["gate_scalar"]
_P_RECOVERY = PARAMETER["recovery_s"]
_P_RECOVERY_FIXES = PARAMETER["recovery_fixes"]
_P_LOST_RESETS = PARAMETER["resets_until_lost"]
_P_LOST_S = PARAMETER["refused_until_lost_s"]
_P_AGREE = PARAMETER["recovery_agreement_m"]
_P_RECOVERY_ATT = PARAMETER["recovery_attitude_sd_rad"]
_P_NHC = PARAMETER["nhc_sd_mps"]
_P_NHC_LEVER = PARAMETER["nhc_lever_m"]
_P_NHC_SPEED = PARAMETER["nhc_min_speed_mps"]
_P_SPEED = PARAMETER["speed_sd_mps"]
_P_REVERSE_ODDS = PARAMETER["reverse_log_odds"]
_P_ZUPT = PARAMETER["zupt_sd_mps"]
_P_ZARU = PARAMETER["zaru_sd_radps"]

Work = tuple[int, FloatArray, FloatArray]
"""Scratch of one call: number of states, error estimate dx (n,), P H' (n,).

The number of states comes at run time on purpose: of a constant the compiler makes slower, unrolled loops.
"""

COURSE_MIN_SPEED_MPS = 1.0
"""Below this a receiver's course is noise; its speed alone then says little more than the position."""

ROBUST_LIMIT = 25.0
"""A constraint or wheel speed this far beyond its gate (five times the innovation) is refused: a skid."""


@njit(cache=True, nogil=True)
def correct(x: FloatArray, dx: FloatArray) -> None:
    """Close the loop: bring the error estimate ``dx`` into the nominal state and clear it."""
    x[X_DR] += dx[POS]
    x[X_DR + 1] += dx[POS + 1]
    x[X_DR + 2] += dx[POS + 2]
    for i in range(3):
        x[X_V + i] += dx[VEL + i]
        x[X_BG + i] += dx[GYRO_BIAS + i]
        x[X_BA + i] += dx[ACCEL_BIAS + i]
    x[X_SCALE] += dx[SPEED_SCALE]
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


@njit(cache=True, nogil=True)
def _reset_position(
    x: FloatArray, ti: TimeArray, p: FloatArray, n: int, nu: tuple[float, float], sd_h: float, par: FloatArray
) -> None:
    """Take the position from the fixes that agree against us; open velocity and heading for what follows."""
    for i in range(2):
        x[X_DR + i] += nu[i]
        for j in range(n):
            p[(POS + i) * n + j] = 0.0
            p[j * n + POS + i] = 0.0
        p[(POS + i) * n + POS + i] = sd_h * sd_h
        # The drift that made the offset: it grew over the run of refusals at least.
        run_s = max(1.0, (ti[T_NOW] - ti[T_GNSS]) * 1e-9)
        p[(VEL + i) * n + VEL + i] += (nu[i] / run_s) ** 2 + 0.25
    p[(ATT + 2) * n + ATT + 2] += par[_P_RECOVERY_ATT] ** 2


@njit(cache=True, nogil=True)
def fuse_position(
    x: FloatArray,
    ti: TimeArray,
    p: FloatArray,
    t_ns: int,
    fix: FloatArray,
    lever_b: FloatArray,
    par: FloatArray,
    work: Work,
    counts: TimeArray,
) -> bool:
    """GNSS position: horizontal by one gate of two dimensions, height by its own. True if fused.

    ``fix`` is one that is usable; ``lever_b`` is the antenna against the inertial sensor, body axes, m.
    """
    n, dx, ph = work
    fold_position(x, ti)
    lag_s = (ti[T_NOW] - t_ns) * 1e-9
    c = matrix_of(x[X_Q], x[X_Q + 1], x[X_Q + 2], x[X_Q + 3])
    ln = c[0] * lever_b[0] + c[1] * lever_b[1] + c[2] * lever_b[2]
    le = c[3] * lever_b[0] + c[4] * lever_b[1] + c[5] * lever_b[2]
    ld = c[6] * lever_b[0] + c[7] * lever_b[1] + c[8] * lever_b[2]
    d_lon = fix[_LON] - x[X_LON]
    if d_lon > math.pi:
        d_lon -= 2.0 * math.pi
    elif d_lon < -math.pi:
        d_lon += 2.0 * math.pi
    nu_n = (fix[_LAT] - x[X_LAT]) * x[X_M_PER_RAD] + lag_s * x[X_V] - ln
    nu_e = d_lon * x[X_M_PER_RAD + 1] + lag_s * x[X_V + 1] - le
    nu_d = -(fix[_ALT] - x[X_ALT]) + lag_s * x[X_V + 2] - ld
    sd_h, sd_v = position_sd_m(fix, par)

    rr = sd_h * sd_h
    snn, see, sne = p[0] + rr, p[n + 1] + rr, p[1]
    determinant = snn * see - sne * sne
    ratio = (see * nu_n * nu_n - 2.0 * sne * nu_n * nu_e + snn * nu_e * nu_e) / determinant
    fused = ratio <= par[_P_GATE_POS]
    if not fused:
        counts[A_POSITION, REJECTED_GATE] += 1
        if ti[I_REFUSED] == 0:
            ti[T_REFUSED] = t_ns
        ti[I_REFUSED] += 1
        away_n, away_e = nu_n - x[X_REJECTED_N], nu_e - x[X_REJECTED_N + 1]
        agreement = par[_P_AGREE] + 3.0 * sd_h
        agrees = away_n * away_n + away_e * away_e <= agreement * agreement
        if ti[I_REJECTED] == 0 or not agrees:
            ti[T_REJECTED] = t_ns
            ti[I_REJECTED] = 0
        ti[I_REJECTED] += 1
        x[X_REJECTED_N], x[X_REJECTED_N + 1] = nu_n, nu_e
        long_enough = (t_ns - ti[T_REJECTED]) * 1e-9 >= par[_P_RECOVERY]
        if not (long_enough and ti[I_REJECTED] >= par[_P_RECOVERY_FIXES]):
            return False
        _reset_position(x, ti, p, n, (nu_n, nu_e), sd_h, par)
        counts[A_POSITION, RESET] += 1
        ti[I_RESETS] += 1
    else:
        # z - h = dr + (phi x l)
        groups = (POS, ATT, SPEED_SCALE)
        row_n = (1.0, 0.0, 0.0, 0.0, ld, -le, 0.0, 0.0, 0.0)
        row_e = (0.0, 1.0, 0.0, -ld, 0.0, ln, 0.0, 0.0, 0.0)
        s = project(p, n, groups, row_n, ph) + rr
        update(p, n, ph, s, nu_n - along(groups, row_n, dx), dx)
        s = project(p, n, groups, row_e, ph) + rr
        update(p, n, ph, s, nu_e - along(groups, row_e, dx), dx)
        counts[A_POSITION, FUSED] += 1
        ti[I_RESETS] = 0
    ti[I_REJECTED] = 0
    ti[I_REFUSED] = 0
    ti[T_GNSS] = ti[T_NOW]
    ti[I_GNSS_USED] = 1

    if math.isfinite(nu_d):
        s = project_axis(p, n, POS + 2, ph) + sd_v * sd_v
        innovation = nu_d - dx[POS + 2]
        if innovation * innovation <= par[_P_GATE] * s or not fused:
            update(p, n, ph, s, innovation, dx)
            counts[A_HEIGHT, FUSED] += 1
        else:
            counts[A_HEIGHT, REJECTED_GATE] += 1
            # A height that stays wrong must not stay refused: a quarter of its excess is believed next time.
            p[(POS + 2) * n + POS + 2] += 0.25 * innovation * innovation / par[_P_GATE]
    correct(x, dx)
    return True


@njit(cache=True, nogil=True)
def lost(ti: TimeArray, par: FloatArray) -> bool:
    """Whether fixes have contradicted the state for so long that it has to be found anew."""
    if ti[I_RESETS] >= par[_P_LOST_RESETS]:
        return True
    refused_s = (ti[T_NOW] - ti[T_REFUSED]) * 1e-9
    return bool(ti[I_REFUSED] >= par[_P_RECOVERY_FIXES] and refused_s >= par[_P_LOST_S])


@njit(cache=True, nogil=True)
def fuse_velocity(
    x: FloatArray,
    ti: TimeArray,
    p: FloatArray,
    fix: FloatArray,
    lever_b: FloatArray,
    par: FloatArray,
    work: Work,
    counts: TimeArray,
) -> None:
    """GNSS velocity, or speed with course: horizontal by one gate of two dimensions, vertical by its own."""
    n, dx, ph = work
    vn, ve, vd = fix[_VN], fix[_VE], fix[_VD]
    if not (math.isfinite(vn) and math.isfinite(ve)):
        if not (math.isfinite(fix[_SPEED]) and math.isfinite(fix[_COURSE])):
            return
        if fix[_SPEED] < COURSE_MIN_SPEED_MPS:
            return
        vn, ve = fix[_SPEED] * math.cos(fix[_COURSE]), fix[_SPEED] * math.sin(fix[_COURSE])
    sd = max(fix[_SD_VEL], par[_P_FLOOR_V]) if fix[_SD_VEL] > 0.0 else par[_P_SD_VEL]
    c = matrix_of(x[X_Q], x[X_Q + 1], x[X_Q + 2], x[X_Q + 3])
    wx, wy, wz = x[X_W] - x[X_BG], x[X_W + 1] - x[X_BG + 1], x[X_W + 2] - x[X_BG + 2]
    bx = wy * lever_b[2] - wz * lever_b[1]
    by = wz * lever_b[0] - wx * lever_b[2]
    bz = wx * lever_b[1] - wy * lever_b[0]
    nu_n = vn - x[X_V] - (c[0] * bx + c[1] * by + c[2] * bz)
    nu_e = ve - x[X_V + 1] - (c[3] * bx + c[4] * by + c[5] * bz)
    nu_d = vd - x[X_V + 2] - (c[6] * bx + c[7] * by + c[8] * bz)
    rr = sd * sd
    i0 = VEL * n + VEL
    snn, see, sne = p[i0] + rr, p[i0 + n + 1] + rr, p[i0 + 1]
    determinant = snn * see - sne * sne
    ratio = (see * nu_n * nu_n - 2.0 * sne * nu_n * nu_e + snn * nu_e * nu_e) / determinant
    if ratio > par[_P_GATE_VEL]:
        counts[A_VELOCITY, REJECTED_GATE] += 1
        return
    counts[A_VELOCITY, FUSED] += 1
    for i in range(3):
        nu = nu_n if i == 0 else (nu_e if i == 1 else nu_d)
        s = project_axis(p, n, VEL + i, ph) + rr
        innovation = nu - dx[VEL + i]
        if i < 2 or (math.isfinite(nu) and innovation * innovation <= par[_P_GATE] * s):
            update(p, n, ph, s, innovation, dx)
    correct(x, dx)


@njit(cache=True, nogil=True)
def _fuse_body_velocity(
    x: FloatArray,
    p: FloatArray,
    u: tuple[float, float, float],
    du_pitch: tuple[float, float, float],
    du_yaw: tuple[float, float, float],
    reading: float,
    gain: float,
    scale_factor: float,
    variance: float,
    gate: float,
    work: Work,
) -> bool:
    """Fuse ``reading`` = gain (u . v_b) with the axis ``u`` in b and its derivatives by the mounting angles.

    ``scale_factor`` is 1 where the gain holds the wheel speed's scale, else 0. The loop is left open.

    d(u . C' v) = (C u) . dv + ((C u) x v) . phi + (du . v_b): from C(true) = (I + [phi x]) C.
    """
    n, dx, ph = work
    c = matrix_of(x[X_Q], x[X_Q + 1], x[X_Q + 2], x[X_Q + 3])
    vn, ve, vd = x[X_V], x[X_V + 1], x[X_V + 2]
    bx = c[0] * vn + c[3] * ve + c[6] * vd
    by = c[1] * vn + c[4] * ve + c[7] * vd
    bz = c[2] * vn + c[5] * ve + c[8] * vd
    wn = gain * (c[0] * u[0] + c[1] * u[1] + c[2] * u[2])
    we = gain * (c[3] * u[0] + c[4] * u[1] + c[5] * u[2])
    wd = gain * (c[6] * u[0] + c[7] * u[1] + c[8] * u[2])
    projected = u[0] * bx + u[1] * by + u[2] * bz
    groups = (VEL, ATT, SPEED_SCALE)
    row = (
        wn,
        we,
        wd,
        we * vd - wd * ve,
        wd * vn - wn * vd,
        wn * ve - we * vn,
        scale_factor * projected,
        gain * (du_pitch[0] * bx + du_pitch[1] * by + du_pitch[2] * bz),
        gain * (du_yaw[0] * bx + du_yaw[1] * by + du_yaw[2] * bz),
    )
    innovation = reading - gain * projected - along(groups, row, dx)
    s = project(p, n, groups, row, ph) + variance
    excess = innovation * innovation / (gate * s)
    if excess > ROBUST_LIMIT:
        return False
    # Past the gate the reading still pulls, with the variance under which it would just pass.
    s *= max(excess, 1.0)
    update(p, n, ph, s, innovation, dx)
    return True


@njit(cache=True, nogil=True)
def fuse_non_holonomic(
    x: FloatArray,
    p: FloatArray,
    par: FloatArray,
    work: Work,
    counts: TimeArray,
) -> None:
    """A car goes where its wheels point: no lateral and no vertical speed in the vehicle's own axes.

    The lateral spread grows with the yaw rate, since the box is not at the rear axle.
    """
    dx = work[1]
    speed_sq = x[X_V] ** 2 + x[X_V + 1] ** 2
    if speed_sq < par[_P_NHC_SPEED] ** 2:
        counts[A_NHC, REJECTED_RANGE] += 1
        return
    sp, cp, sy, cy = x[X_MOUNT_SC], x[X_MOUNT_SC + 1], x[X_MOUNT_SC + 2], x[X_MOUNT_SC + 3]
    yaw_rate = x[X_W + 2] - x[X_BG + 2]
    base = par[_P_NHC] * par[_P_NHC]
    slip = par[_P_NHC_LEVER] * yaw_rate
    none = (0.0, 0.0, 0.0)
    lateral = _fuse_body_velocity(
        x, p, (-sy, cy, 0.0), none, (-cy, -sy, 0.0), 0.0, 1.0, 0.0, base + slip * slip, par[_P_GATE], work
    )
    vertical = _fuse_body_velocity(
        x,
        p,
        (cy * sp, sy * sp, cp),
        (cy * cp, sy * cp, -sp),
        (-sy * sp, cy * sp, 0.0),
        0.0,
        1.0,
        0.0,
        base,
        par[_P_GATE],
        work,
    )
    correct(x, dx)
    counts[A_NHC, FUSED if lateral else REJECTED_GATE] += 1
    counts[A_NHC, FUSED if vertical else REJECTED_GATE] += 1


@njit(cache=True, nogil=True)
def _reverses(
    x: FloatArray,
    p: FloatArray,
    forward_b: tuple[float, float, float],
    reading_mps: float,
    variance: float,
    log_odds: float,
) -> bool:
    """Whether the vehicle rather goes backwards at the speed that its wheels say without a sign.

    The two readings of a speed r against a forward speed f of variance s differ in log-likelihood by 2 r f / s;
    ``log_odds`` is how much more often a vehicle goes forwards, as a logarithm.
    """
    c = matrix_of(x[X_Q], x[X_Q + 1], x[X_Q + 2], x[X_Q + 3])
    forward_n = (
        c[0] * forward_b[0] + c[1] * forward_b[1] + c[2] * forward_b[2],
        c[3] * forward_b[0] + c[4] * forward_b[1] + c[5] * forward_b[2],
        c[6] * forward_b[0] + c[7] * forward_b[1] + c[8] * forward_b[2],
    )
    forward_mps = 0.0
    for i in range(3):
        forward_mps += forward_n[i] * x[X_V + i]
        for j in range(3):
            variance += forward_n[i] * p[(VEL + i) * N_STATES + VEL + j] * forward_n[j]
    return -2.0 * reading_mps * forward_mps > log_odds * variance


@njit(cache=True, nogil=True)
def fuse_speed(
    x: FloatArray,
    ti: TimeArray,
    p: FloatArray,
    reading_mps: float,
    par: FloatArray,
    work: Work,
    counts: TimeArray,
) -> None:
    """Wheel speed: (1 + scale) times the speed along the vehicle's forward axis, without its sign."""
    sp, cp, sy, cy = x[X_MOUNT_SC], x[X_MOUNT_SC + 1], x[X_MOUNT_SC + 2], x[X_MOUNT_SC + 3]
    ti[T_SPEED] = ti[T_NOW]
    forward_b = (cy * cp, sy * cp, -sp)
    if _reverses(x, p, forward_b, reading_mps, par[_P_SPEED] ** 2, par[_P_REVERSE_ODDS]):
        reading_mps = -reading_mps
    fused = _fuse_body_velocity(
        x,
        p,
        forward_b,
        (-cy * sp, -sy * sp, -cp),
        (-sy * cp, cy * cp, 0.0),
        reading_mps,
        1.0 + x[X_SCALE],
        1.0,
        par[_P_SPEED] ** 2,
        par[_P_GATE],
        work,
    )
    correct(x, work[1])
    counts[A_SPEED, FUSED if fused else REJECTED_GATE] += 1


@njit(cache=True, nogil=True)
def fuse_standstill(
    x: FloatArray,
    p: FloatArray,
    mean_omega_b: FloatArray,
    par: FloatArray,
    work: Work,
    counts: TimeArray,
) -> None:
    """Standing: velocity is zero, and what the gyroscopes read is their bias (Earth rate is below their noise)."""
    n, dx, ph = work
    variance = par[_P_ZUPT] ** 2
    for i in range(3):
        s = project_axis(p, n, VEL + i, ph) + variance
        update(p, n, ph, s, -x[X_V + i] - dx[VEL + i], dx)
    counts[A_ZUPT, FUSED] += 1
    variance = par[_P_ZARU] ** 2
    for i in range(3):
        s = project_axis(p, n, GYRO_BIAS + i, ph) + variance
        update(p, n, ph, s, mean_omega_b[i] - x[X_BG + i] - dx[GYRO_BIAS + i], dx)
    counts[A_ZARU, FUSED] += 1
    correct(x, dx)


@njit(cache=True, nogil=True)
def too_old(ti: TimeArray, t_ns: int, par: FloatArray, aid: int, counts: TimeArray) -> bool:
    """Whether a sample lies too far behind the newest inertial one; counted if so."""
    if (ti[T_NOW] - t_ns) * 1e-9 > par[_P_AGE]:
        counts[aid, REJECTED_TIME] += 1
        return True
    return False
