"""The filter's loop over samples, compiled: mechanise, and on a fixed grid of time propagate, aid, put out.

The grid is absolute time, not the packet: blocks of 0.1 s, constraints at 5 Hz, rows at 10 Hz fall on the
same samples however the stream is cut.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from core.earth import STANDARD_GRAVITY_MPS2
from core.measurements import FloatArray, TimeArray
from core.navigation.admission import MAX_LATITUDE_RAD
from core.navigation.aiding import (
    fuse_non_holonomic,
    fuse_position,
    fuse_speed,
    fuse_standstill,
    fuse_velocity,
    lost,
    too_old,
)
from core.navigation.error_model import propagate
from core.navigation.kalman import symmetrise
from core.navigation.mechanization import fold_position, matrix_of, renew_mounting, turned
from core.navigation.state import (
    A_IMU,
    A_POSITION,
    A_SPEED,
    ACCEL_BIAS,
    ATT,
    GYRO_BIAS,
    I_BLOCK,
    I_BLOCKS,
    I_GNSS_USED,
    I_STATIONARY,
    MOUNT_PITCH,
    MOUNT_YAW,
    N_BLOCKS,
    N_STATES,
    POS,
    REJECTED_TIME,
    SPEED_SCALE,
    T_COV,
    T_GNSS,
    T_NEXT_BLOCK,
    T_NEXT_CONSTRAINT,
    T_NEXT_OUTPUT,
    T_NOW,
    T_SPEED,
    VEL,
    X_ALT,
    X_BA,
    X_BG,
    X_BLOCK,
    X_BRIDGED_S,
    X_C0,
    X_DR,
    X_DV,
    X_F,
    X_G,
    X_LAT,
    X_LON,
    X_M_PER_RAD,
    X_MOUNT_SC,
    X_Q,
    X_SATURATED_S,
    X_STILL_F,
    X_STILL_W,
    X_V,
    X_W,
)
from core.navigation.track import TRACK, Mode
from core.navigation.tuning import PARAMETER

STOPPED_END, STOPPED_GAP, STOPPED_LOST, STOPPED_DIVERGED = 0, 1, 2, 3
"""Why the loop came back: samples used up; or to align anew, after a gap before the next sample, because fixes
contradict the state, or because the state is none that a vehicle can have."""

MOST_MPS, MOST_HEIGHT_M, MOST_SD_M = 300.0, 50_000.0, 100_000.0
MOST_ACCEL_BIAS_MPS2, MOST_GYRO_BIAS_RADPS = 5.0, 1.0
"""Beyond any of these the state is made of damaged samples: no vehicle and no bias is so fast or so far off."""

SCRATCH = 3 * N_STATES + N_STATES**2
"""Numbers that ``run`` works in: error estimate, P H', variances added, Phi P."""

USE_NHC, USE_ZUPT = 1, 2
"""Switches of the constraints, as bits."""

LEARN_SHARE = 0.05
"""Share by which the level of a standing vehicle's spread follows each block: some 2 s."""

_GYRO_NOISE = PARAMETER["gyro_noise_radps_rts"]
_ACCEL_NOISE = PARAMETER["accel_noise_mps2_rts"]
_BG_WALK = PARAMETER["gyro_bias_walk_radps2_rts"]
_BA_WALK = PARAMETER["accel_bias_walk_mps3_rts"]
_SCALE_WALK = PARAMETER["speed_scale_walk_rts"]
_MOUNT_WALK = PARAMETER["mount_angle_walk_rad_rts"]
_STILL_ACCEL = PARAMETER["still_accel_sd_mps2"]
_STILL_GYRO = PARAMETER["still_gyro_sd_radps"]
_STILL_FACTOR = PARAMETER["still_factor"]
_STILL_MEAN = PARAMETER["still_mean_accel_mps2"]
_STILL_RATE = PARAMETER["still_mean_gyro_radps"]
_STILL_SPEED = PARAMETER["still_max_speed_mps"]
_CONSTRAINT_S = PARAMETER["constraint_interval_s"]
_COVARIANCE_S = PARAMETER["covariance_interval_s"]
_OUTPUT_S = PARAMETER["output_interval_s"]
_BRIDGE_S = PARAMETER["bridge_s"]
_BRIDGE_ACCEL = PARAMETER["bridge_accel_sd_mps2"]
_BRIDGE_TILT = PARAMETER["bridge_tilt_sd_radps"]
_BRIDGE_YAW = PARAMETER["bridge_yaw_sd_radps"]
_GAP_S = PARAMETER["max_gap_s"]
_SATURATED = PARAMETER["saturated_accel_sd_mps2"]
_COASTING_S = PARAMETER["coasting_after_s"]
_SPEED_S = PARAMETER["speed_interval_s"]

_C_LAT, _C_VN, _C_ROLL, _C_SD_N, _C_SD_YAW, _C_USED, _C_MODE = (
    TRACK["lat_rad"],
    TRACK["vn_mps"],
    TRACK["roll_rad"],
    TRACK["sd_n_m"],
    TRACK["sd_yaw_rad"],
    TRACK["gnss_used"],
    TRACK["mode"],
)
_COASTING, _AIDED = int(Mode.COASTING), int(Mode.AIDED)


@njit(cache=True, nogil=True)
def _catch_up(
    x: FloatArray, ti: TimeArray, p: FloatArray, n: int, m: FloatArray, q: FloatArray, par: FloatArray
) -> None:
    """Bring the covariance up to the newest sample."""
    dt = (ti[T_NOW] - ti[T_COV]) * 1e-9
    if dt <= 0.0:
        return
    c0, c1, c2, c3, c4, c5, c6, c7, c8 = matrix_of(x[X_Q], x[X_Q + 1], x[X_Q + 2], x[X_Q + 3])
    mean = (
        0.5 * (x[X_C0] + c0),
        0.5 * (x[X_C0 + 1] + c1),
        0.5 * (x[X_C0 + 2] + c2),
        0.5 * (x[X_C0 + 3] + c3),
        0.5 * (x[X_C0 + 4] + c4),
        0.5 * (x[X_C0 + 5] + c5),
        0.5 * (x[X_C0 + 6] + c6),
        0.5 * (x[X_C0 + 7] + c7),
        0.5 * (x[X_C0 + 8] + c8),
    )
    x[X_C0], x[X_C0 + 1], x[X_C0 + 2] = c0, c1, c2
    x[X_C0 + 3], x[X_C0 + 4], x[X_C0 + 5] = c3, c4, c5
    x[X_C0 + 6], x[X_C0 + 7], x[X_C0 + 8] = c6, c7, c8
    bridged = x[X_BRIDGED_S]
    clipped = par[_SATURATED] * x[X_SATURATED_S]
    attitude = par[_GYRO_NOISE] ** 2 * dt
    velocity = par[_ACCEL_NOISE] ** 2 * dt + (par[_BRIDGE_ACCEL] * bridged) ** 2 + clipped * clipped
    for i in range(3):
        q[POS + i] = velocity * dt * dt / 3.0
        q[VEL + i] = velocity
        q[ATT + i] = attitude
        q[GYRO_BIAS + i] = par[_BG_WALK] ** 2 * dt
        q[ACCEL_BIAS + i] = par[_BA_WALK] ** 2 * dt
    q[ATT] += (par[_BRIDGE_TILT] * bridged) ** 2
    q[ATT + 1] += (par[_BRIDGE_TILT] * bridged) ** 2
    q[ATT + 2] += (par[_BRIDGE_YAW] * bridged) ** 2
    q[SPEED_SCALE] = par[_SCALE_WALK] ** 2 * dt
    q[MOUNT_PITCH] = par[_MOUNT_WALK] ** 2 * dt
    q[MOUNT_YAW] = par[_MOUNT_WALK] ** 2 * dt
    propagate(p, m, n, dt, (x[X_DV], x[X_DV + 1], x[X_DV + 2]), mean, q)
    x[X_DV], x[X_DV + 1], x[X_DV + 2] = 0.0, 0.0, 0.0
    x[X_SATURATED_S], x[X_BRIDGED_S] = 0.0, 0.0
    ti[T_COV] = ti[T_NOW]


@njit(cache=True, nogil=True)
def _close_block(x: FloatArray, ti: TimeArray, p: FloatArray, ring: FloatArray, par: FloatArray) -> None:
    """Put the open block's means into the ring and decide whether the vehicle stands.

    Standing: over one second the 0.1 s means hardly move (block means hide the engine's shaking, not the
    road's), and the filter does not hold a speed well above its own uncertainty.
    """
    count = ti[I_BLOCK]
    if count == 0:
        ti[I_BLOCKS] = 0
        ti[I_STATIONARY] = 0
        return
    row = (ti[I_BLOCKS] % N_BLOCKS) * 6
    for i in range(6):
        ring[row + i] = x[X_BLOCK + i] / count
        x[X_BLOCK + i] = 0.0
    ti[I_BLOCK] = 0
    ti[I_BLOCKS] += 1
    ti[I_STATIONARY] = 0
    if ti[I_BLOCKS] < N_BLOCKS:
        return
    i0 = VEL * N_STATES + VEL
    speed_sd = math.sqrt(max(p[i0], p[i0 + N_STATES + 1]))
    limit = par[_STILL_SPEED] + 3.0 * speed_sd
    if x[X_V] ** 2 + x[X_V + 1] ** 2 > limit * limit:
        return
    spread_f, spread_w = 0.0, 0.0
    mean_0, mean_1, mean_2, turning_sq, rate_var = 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(6):
        total, squares = 0.0, 0.0
        first = ring[i]
        for j in range(N_BLOCKS):
            d = ring[6 * j + i] - first
            total += d
            squares += d * d
        variance = squares / N_BLOCKS - (total / N_BLOCKS) ** 2
        if i == 0:
            mean_0 = first + total / N_BLOCKS
        elif i == 1:
            mean_1 = first + total / N_BLOCKS
        elif i == 2:
            mean_2 = first + total / N_BLOCKS
        if i < 3:
            spread_f += variance
        else:
            spread_w += variance
            turning_sq += (first + total / N_BLOCKS - x[X_BG + i - 3]) ** 2
            i0 = (GYRO_BIAS + i - 3) * N_STATES + GYRO_BIAS + i - 3
            rate_var = max(rate_var, p[i0])
    # A bend driven evenly is as quiet as standing, but for its rate.
    limit = par[_STILL_RATE] + 3.0 * math.sqrt(rate_var)
    if turning_sq > limit * limit:
        return
    if spread_f > par[_STILL_ACCEL] ** 2 or spread_w > par[_STILL_GYRO] ** 2:
        return
    spread_f, spread_w = math.sqrt(spread_f), math.sqrt(spread_w)
    # Where the filter's own speed is no witness, it has to be as quiet as this vehicle is when it stands.
    uncertain = speed_sd > par[_STILL_SPEED]
    if uncertain and x[X_STILL_F] > 0.0:
        factor = par[_STILL_FACTOR]
        if spread_f > factor * x[X_STILL_F] or spread_w > factor * x[X_STILL_W]:
            return
    # Pulling away evenly is smooth too: what gravity and bias leave must be nothing.
    mean = (mean_0 - x[X_BA], mean_1 - x[X_BA + 1], mean_2 - x[X_BA + 2])
    c0, c1, c2, c3, c4, c5, _, _, _ = matrix_of(x[X_Q], x[X_Q + 1], x[X_Q + 2], x[X_Q + 3])
    an = c0 * mean[0] + c1 * mean[1] + c2 * mean[2]
    ae = c3 * mean[0] + c4 * mean[1] + c5 * mean[2]
    i0 = ATT * N_STATES + ATT
    tilt = math.sqrt(max(p[i0], p[i0 + N_STATES + 1]))
    limit = par[_STILL_MEAN] + 3.0 * STANDARD_GRAVITY_MPS2 * tilt
    if an * an + ae * ae > limit * limit:
        return
    ti[I_STATIONARY] = 1
    if not uncertain:
        share = LEARN_SHARE if x[X_STILL_F] > 0.0 else 1.0
        x[X_STILL_F] += share * (spread_f - x[X_STILL_F])
        x[X_STILL_W] += share * (spread_w - x[X_STILL_W])


@njit(cache=True, nogil=True)
def _plausible(x: FloatArray, p: FloatArray) -> bool:
    """Whether a vehicle and its box can be in this state; False too where it is not a number."""
    sane = abs(x[X_ALT]) < MOST_HEIGHT_M and abs(x[X_LAT]) < MAX_LATITUDE_RAD
    for i in range(3):
        sane &= abs(x[X_V + i]) < MOST_MPS
        sane &= abs(x[X_BA + i]) < MOST_ACCEL_BIAS_MPS2
        sane &= abs(x[X_BG + i]) < MOST_GYRO_BIAS_RADPS
        sane &= p[(POS + i) * N_STATES + POS + i] < MOST_SD_M * MOST_SD_M
    return bool(sane)


@njit(cache=True, nogil=True)
def _put_row(
    x: FloatArray, ti: TimeArray, p: FloatArray, lever_b: FloatArray, par: FloatArray, row: FloatArray
) -> None:
    """One row of the track, of the vehicle's body: ``lever_b`` is the inertial sensor's place in it."""
    n = N_STATES
    c = matrix_of(x[X_Q], x[X_Q + 1], x[X_Q + 2], x[X_Q + 3])
    dn = x[X_DR] - (c[0] * lever_b[0] + c[1] * lever_b[1] + c[2] * lever_b[2])
    de = x[X_DR + 1] - (c[3] * lever_b[0] + c[4] * lever_b[1] + c[5] * lever_b[2])
    dd = x[X_DR + 2] - (c[6] * lever_b[0] + c[7] * lever_b[1] + c[8] * lever_b[2])
    row[_C_LAT] = x[X_LAT] + dn / x[X_M_PER_RAD]
    row[_C_LAT + 1] = x[X_LON] + de / x[X_M_PER_RAD + 1]
    row[_C_LAT + 2] = x[X_ALT] - dd
    for i in range(3):
        row[_C_VN + i] = x[X_V + i]
        row[_C_SD_N + i] = math.sqrt(max(p[(POS + i) * n + POS + i], 0.0))
    row[_C_SD_N + 3] = p[POS * n + POS + 1]
    # C_n_from_v = C_n_from_b C_b_from_v with C_b_from_v = Rz(mount yaw) Ry(mount pitch)
    sp, cp, sy, cy = x[X_MOUNT_SC], x[X_MOUNT_SC + 1], x[X_MOUNT_SC + 2], x[X_MOUNT_SC + 3]
    v00 = c[0] * cy * cp + c[1] * sy * cp - c[2] * sp
    v10 = c[3] * cy * cp + c[4] * sy * cp - c[5] * sp
    v20 = c[6] * cy * cp + c[7] * sy * cp - c[8] * sp
    v21 = -c[6] * sy + c[7] * cy
    v22 = c[6] * cy * sp + c[7] * sy * sp + c[8] * cp
    row[_C_ROLL] = math.atan2(v21, v22)
    row[_C_ROLL + 1] = math.asin(min(1.0, max(-1.0, -v20)))
    row[_C_ROLL + 2] = math.atan2(v10, v00)
    yaw = (ATT + 2) * n
    # The heading of the vehicle: attitude error about down plus the mounting's yaw.
    variance = p[yaw + ATT + 2] + 2.0 * p[yaw + MOUNT_YAW] + p[MOUNT_YAW * n + MOUNT_YAW]
    row[_C_SD_YAW] = math.sqrt(max(variance, 0.0))
    row[_C_USED] = ti[I_GNSS_USED]
    row[_C_MODE] = _AIDED if (ti[T_NOW] - ti[T_GNSS]) * 1e-9 <= par[_COASTING_S] else _COASTING
    ti[I_GNSS_USED] = 0


@njit(cache=True, nogil=True)
def run(
    x: FloatArray,
    ti: TimeArray,
    p: FloatArray,
    ring: FloatArray,
    scratch: FloatArray,
    par: FloatArray,
    switches: int,
    imu_lever_b: FloatArray,
    antenna_lever_b: FloatArray,
    imu_t_ns: TimeArray,
    f_b: FloatArray,
    omega_b: FloatArray,
    saturated: FloatArray,
    gnss_t_ns: TimeArray,
    gnss: FloatArray,
    speed_t_ns: TimeArray,
    speed_mps: FloatArray,
    epochs: FloatArray,
    out_t_ns: TimeArray,
    out: FloatArray,
    counts: TimeArray,
) -> tuple[int, int, int, int, int]:
    """Fold samples into the state until they end, a gap comes, or the filter is lost.

    Parameters
    ----------
    x, ti, p, ring : state, see ``state``; changed in place
    scratch : (SCRATCH,) zeros at first; nothing in it outlives the call
    par : ``Tuning.as_array()``; ``switches`` as ``USE_NHC | USE_ZUPT``
    imu_lever_b, antenna_lever_b : (3,) inertial sensor in the body, and antenna against the sensor, m
    imu_t_ns, f_b, omega_b, saturated : (n,), (n, 3), (n, 3), (n,) calibrated samples in b
    gnss_t_ns, gnss, speed_t_ns, speed_mps : usable aids by increasing time; those after the last sample wait
    epochs : (n, 4) written: down in b and horizontal speed at each sample
    out_t_ns, out : written: track rows
    counts : (aids, outcomes) added to

    Returns
    -------
    samples used, fixes used, speeds used, rows written, why it stopped
    """
    n_samples = imu_t_ns.shape[0]
    n_gnss, n_speed = gnss_t_ns.shape[0], speed_t_ns.shape[0]
    n = round(math.sqrt(p.shape[0]))
    dx, ph, q = scratch[:n], scratch[n : 2 * n], scratch[2 * n : 3 * n]
    m = scratch[3 * n :]
    work = (n, dx, ph)
    block_ns = np.int64(round(par[_COVARIANCE_S] * 1e9))
    constraint_ns = np.int64(round(par[_CONSTRAINT_S] * 1e9))
    output_ns = np.int64(round(par[_OUTPUT_S] * 1e9))
    speed_ns = np.int64(par[_SPEED_S] * 1e9)
    bridge_s, gap_s = par[_BRIDGE_S], par[_GAP_S]
    i_gnss, i_speed, rows = 0, 0, 0

    qw, qx, qy, qz = x[X_Q], x[X_Q + 1], x[X_Q + 2], x[X_Q + 3]
    vn, ve, vd = x[X_V], x[X_V + 1], x[X_V + 2]
    bgx, bgy, bgz = x[X_BG], x[X_BG + 1], x[X_BG + 2]
    bax, bay, baz = x[X_BA], x[X_BA + 1], x[X_BA + 2]
    gn, ge, gd = x[X_G], x[X_G + 1], x[X_G + 2]
    rn, re, rd = x[X_DR], x[X_DR + 1], x[X_DR + 2]
    sn, se, sd = x[X_DV], x[X_DV + 1], x[X_DV + 2]
    fx, fy, fz = x[X_F], x[X_F + 1], x[X_F + 2]
    wx, wy, wz = x[X_W], x[X_W + 1], x[X_W + 2]
    s0, s1, s2 = x[X_BLOCK], x[X_BLOCK + 1], x[X_BLOCK + 2]
    s3, s4, s5 = x[X_BLOCK + 3], x[X_BLOCK + 4], x[X_BLOCK + 5]
    in_block = ti[I_BLOCK]
    t_prev = ti[T_NOW]
    next_event = np.int64(0)
    stopped = STOPPED_END
    used = n_samples
    for k in range(n_samples):
        t = imu_t_ns[k]
        dt = (t - t_prev) * 1e-9
        if dt <= 0.0:
            counts[A_IMU, REJECTED_TIME] += 1
            epochs[k, 0], epochs[k, 1], epochs[k, 2], epochs[k, 3] = np.nan, np.nan, np.nan, np.nan
            continue
        if dt > gap_s:
            used, stopped = k, STOPPED_GAP
            break
        nfx, nfy, nfz = f_b[k, 0], f_b[k, 1], f_b[k, 2]
        nwx, nwy, nwz = omega_b[k, 0], omega_b[k, 1], omega_b[k, 2]

        # Trapezoid over the step, rotated by half of its own turn (Titterton & Weston, sec. 11.2).
        ax, ay, az = (0.5 * (wx + nwx) - bgx) * dt, (0.5 * (wy + nwy) - bgy) * dt, (0.5 * (wz + nwz) - bgz) * dt
        ux, uy, uz = (0.5 * (fx + nfx) - bax) * dt, (0.5 * (fy + nfy) - bay) * dt, (0.5 * (fz + nfz) - baz) * dt
        px = ux + 0.5 * (ay * uz - az * uy)
        py = uy + 0.5 * (az * ux - ax * uz)
        pz = uz + 0.5 * (ax * uy - ay * ux)
        c0, c1, c2, c3, c4, c5, c6, c7, c8 = matrix_of(qw, qx, qy, qz)
        dvn = c0 * px + c1 * py + c2 * pz
        dve = c3 * px + c4 * py + c5 * pz
        dvd = c6 * px + c7 * py + c8 * pz
        sn, se, sd = sn + dvn, se + dve, sd + dvd
        dvn, dve, dvd = dvn + gn * dt, dve + ge * dt, dvd + gd * dt
        rn, re, rd = rn + (vn + 0.5 * dvn) * dt, re + (ve + 0.5 * dve) * dt, rd + (vd + 0.5 * dvd) * dt
        vn, ve, vd = vn + dvn, ve + dve, vd + dvd
        qw, qx, qy, qz = turned(qw, qx, qy, qz, ax, ay, az)
        fx, fy, fz, wx, wy, wz = nfx, nfy, nfz, nwx, nwy, nwz
        t_prev = t
        if saturated[k] != 0.0:
            x[X_SATURATED_S] += dt
        if dt > bridge_s:
            x[X_BRIDGED_S] += dt
        epochs[k, 0] = 2.0 * (qx * qz - qw * qy)
        epochs[k, 1] = 2.0 * (qy * qz + qw * qx)
        epochs[k, 2] = 1.0 - 2.0 * (qx * qx + qy * qy)
        epochs[k, 3] = math.sqrt(vn * vn + ve * ve)

        if t >= next_event:
            x[X_Q], x[X_Q + 1], x[X_Q + 2], x[X_Q + 3] = qw, qx, qy, qz
            x[X_V], x[X_V + 1], x[X_V + 2] = vn, ve, vd
            x[X_DR], x[X_DR + 1], x[X_DR + 2] = rn, re, rd
            x[X_DV], x[X_DV + 1], x[X_DV + 2] = sn, se, sd
            x[X_F], x[X_F + 1], x[X_F + 2] = fx, fy, fz
            x[X_W], x[X_W + 1], x[X_W + 2] = wx, wy, wz
            ti[T_NOW] = t
            if t >= ti[T_NEXT_BLOCK]:
                x[X_BLOCK], x[X_BLOCK + 1], x[X_BLOCK + 2] = s0, s1, s2
                x[X_BLOCK + 3], x[X_BLOCK + 4], x[X_BLOCK + 5] = s3, s4, s5
                ti[I_BLOCK] = in_block
                _close_block(x, ti, p, ring, par)
                s0, s1, s2, s3, s4, s5, in_block = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0
                _catch_up(x, ti, p, n, m, q, par)
                fold_position(x, ti)
                if not _plausible(x, p):
                    stopped = STOPPED_DIVERGED
                if t // 1_000_000_000 != ti[T_NEXT_BLOCK] // 1_000_000_000 or ti[T_NEXT_BLOCK] % 1_000_000_000 == 0:
                    symmetrise(p, n)
                    renew_mounting(x)
                ti[T_NEXT_BLOCK] = (t // block_ns + 1) * block_ns
            while i_gnss < n_gnss and gnss_t_ns[i_gnss] <= t:
                if not too_old(ti, gnss_t_ns[i_gnss], par, A_POSITION, counts):
                    _catch_up(x, ti, p, n, m, q, par)
                    if fuse_position(x, ti, p, gnss_t_ns[i_gnss], gnss[i_gnss], antenna_lever_b, par, work, counts):
                        fold_position(x, ti)
                    fuse_velocity(x, ti, p, gnss[i_gnss], antenna_lever_b, par, work, counts)
                    if stopped == STOPPED_END and lost(ti, par):
                        stopped = STOPPED_LOST
                i_gnss += 1
            while i_speed < n_speed and speed_t_ns[i_speed] <= t:
                old = too_old(ti, speed_t_ns[i_speed], par, A_SPEED, counts)
                if not old and t - ti[T_SPEED] >= speed_ns:
                    _catch_up(x, ti, p, n, m, q, par)
                    fuse_speed(x, ti, p, speed_mps[i_speed], par, work, counts)
                i_speed += 1
            if t >= ti[T_NEXT_CONSTRAINT]:
                ti[T_NEXT_CONSTRAINT] = (t // constraint_ns + 1) * constraint_ns
                _catch_up(x, ti, p, n, m, q, par)
                if ti[I_STATIONARY] != 0 and switches & USE_ZUPT:
                    newest = ((ti[I_BLOCKS] - 1) % N_BLOCKS) * 6 + 3
                    fuse_standstill(x, p, ring[newest : newest + 3], par, work, counts)
                elif switches & USE_NHC:
                    fuse_non_holonomic(x, p, par, work, counts)
            if t >= ti[T_NEXT_OUTPUT]:
                if output_ns > 0:
                    ti[T_NEXT_OUTPUT] = (t // output_ns + 1) * output_ns
                _put_row(x, ti, p, imu_lever_b, par, out[rows])
                out_t_ns[rows] = t
                rows += 1
            qw, qx, qy, qz = x[X_Q], x[X_Q + 1], x[X_Q + 2], x[X_Q + 3]
            vn, ve, vd = x[X_V], x[X_V + 1], x[X_V + 2]
            bgx, bgy, bgz = x[X_BG], x[X_BG + 1], x[X_BG + 2]
            bax, bay, baz = x[X_BA], x[X_BA + 1], x[X_BA + 2]
            gn, ge, gd = x[X_G], x[X_G + 1], x[X_G + 2]
            rn, re, rd = x[X_DR], x[X_DR + 1], x[X_DR + 2]
            sn, se, sd = x[X_DV], x[X_DV + 1], x[X_DV + 2]
            next_event = min(ti[T_NEXT_BLOCK], min(ti[T_NEXT_CONSTRAINT], ti[T_NEXT_OUTPUT]))
            if i_gnss < n_gnss:
                next_event = min(next_event, gnss_t_ns[i_gnss])
            if i_speed < n_speed:
                next_event = min(next_event, speed_t_ns[i_speed])
        s0, s1, s2 = s0 + nfx, s1 + nfy, s2 + nfz
        s3, s4, s5 = s3 + nwx, s4 + nwy, s5 + nwz
        in_block += 1
        if stopped != STOPPED_END:
            used = k + 1
            break
    x[X_Q], x[X_Q + 1], x[X_Q + 2], x[X_Q + 3] = qw, qx, qy, qz
    x[X_V], x[X_V + 1], x[X_V + 2] = vn, ve, vd
    x[X_DR], x[X_DR + 1], x[X_DR + 2] = rn, re, rd
    x[X_DV], x[X_DV + 1], x[X_DV + 2] = sn, se, sd
    x[X_F], x[X_F + 1], x[X_F + 2] = fx, fy, fz
    x[X_W], x[X_W + 1], x[X_W + 2] = wx, wy, wz
    x[X_BLOCK], x[X_BLOCK + 1], x[X_BLOCK + 2] = s0, s1, s2
    x[X_BLOCK + 3], x[X_BLOCK + 4], x[X_BLOCK + 5] = s3, s4, s5
    ti[I_BLOCK] = in_block
    ti[T_NOW] = t_prev
    return used, i_gnss, i_speed, rows, stopped
