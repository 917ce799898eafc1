"""The filter's loop over samples, compiled: mechanise, and on a fixed grid of time propagate, aid, put out.

The grid is absolute time, not the packet: blocks of 0.1 s, constraints at 5 Hz, rows at 10 Hz fall on the
same samples however the stream is cut.
"""

from __future__ import annotations

import math

import numpy as np

from core.compiled import compiled
from core.measurements import FloatArray, TimeArray
from core.navigation.admission import MAX_LATITUDE_RAD
from core.navigation.axes import note_turn
from core.navigation.constraints import fuse_non_holonomic, fuse_speed, fuse_standstill
from core.navigation.correction import Work, count
from core.navigation.error_model import propagate
from core.navigation.field_aiding import fuse_barometer, fuse_magnetic
from core.navigation.found_warming import learn_warming
from core.navigation.gnss_aiding import fuse_position, fuse_velocity, lost, repeats, too_old
from core.navigation.kalman import symmetrise
from core.navigation.mechanization import fold_position, matrix_of, renew_mounting, turned
from core.navigation.nodes import close_node, open_node
from core.navigation.output_row import put_row
from core.navigation.state import (
    A_BAROMETER,
    A_IMU,
    A_MAGNETOMETER,
    A_POSITION,
    A_SPEED,
    ACCEL_BIAS,
    ATT,
    BARO_BIAS,
    GNSS_DELAY,
    GNSS_ERROR,
    GYRO_BIAS,
    GYRO_SCALE,
    I_BLOCK,
    I_NODES,
    I_RECORDS,
    I_STATIONARY,
    K_BARO,
    K_GNSS,
    K_MAGNETIC,
    K_SPEED,
    MOUNT_PITCH,
    MOUNT_YAW,
    N_STATES,
    NT,
    NX,
    POS,
    REJECTED_TIME,
    SPEED_SCALE,
    T_BROKEN,
    T_COV,
    T_NEXT_BLOCK,
    T_NEXT_CONSTRAINT,
    T_NEXT_COVARIANCE,
    T_NEXT_OUTPUT,
    T_NOW,
    VEL,
    X_ALT,
    X_BA,
    X_BG,
    X_BIAS_VAR_THEN,
    X_BLOCK,
    X_BLOCK_SUMS,
    X_BRIDGED_S,
    X_C0,
    X_DECAY,
    X_DECAY_VAR,
    X_DR,
    X_DV,
    X_EXCHANGED,
    X_F,
    X_G,
    X_GYRO_SCALE,
    X_HELD_RUN_S,
    X_HELD_S,
    X_LAT,
    X_OPENED,
    X_OPENED_TILT,
    X_Q,
    X_SATURATED_S,
    X_TURN,
    X_V,
    X_W,
    X_WARMING,
)
from core.navigation.stillness import close_block
from core.navigation.tuning import PARAMETER

SECOND_NS = 1_000_000_000
BLOCK_NS = SECOND_NS // 10
"""Samples are averaged by hats of two of these before they say whether the vehicle stands: it hides the engine's
shaking."""

STOPPED_END, STOPPED_GAP, STOPPED_LOST, STOPPED_DIVERGED = 0, 1, 2, 3
"""Why the loop came back: samples used up; or to align anew, after a gap before the next sample, because fixes
contradict the state, or because the state is none that a vehicle can have."""

MOST_MPS, MOST_HEIGHT_M, MOST_SD_M = 300.0, 50_000.0, 100_000.0
MOST_ACCEL_BIAS_MPS2, MOST_GYRO_BIAS_RADPS = 5.0, 1.0
"""Beyond any of these the state is made of damaged samples: no vehicle and no bias is so fast or so far off."""

SCRATCH = 4 * N_STATES
"""Numbers that ``run`` works in: error estimate, two P H', variances added."""

CLIPPED, HELD = 1, 2
"""What may be wrong with a sample, as bits: the accelerometer read its full scale; the gyroscope hangs."""

USE_NHC, USE_ZUPT = 1, 2
"""Switches of the constraints, as bits."""

KEPT_SECONDS = 4
"""States kept, one a second, for aids that come late."""

KEPT_WIDTH = NX + N_STATES**2
"""A kept state: x, then p."""

_GYRO_NOISE = PARAMETER["gyro_noise_radps_rts"]
_ACCEL_NOISE = PARAMETER["accel_noise_mps2_rts"]
_BG_WALK = PARAMETER["gyro_bias_walk_radps2_rts"]
_BA_WALK = PARAMETER["accel_bias_walk_mps3_rts"]
_BG_PER_K = PARAMETER["gyro_bias_radps_per_k"]
_BA_PER_K = PARAMETER["accel_bias_mps2_per_k"]
_WARMING_S = PARAMETER["warming_s"]
_SCALE_WALK = PARAMETER["speed_scale_walk_rts"]
_MOUNT_WALK = PARAMETER["mount_angle_walk_rad_rts"]
_BARO_WALK = PARAMETER["baro_bias_walk_m_rts"]
_CONSTRAINT_S = PARAMETER["constraint_interval_s"]
_COVARIANCE_S = PARAMETER["covariance_interval_s"]
_OUTPUT_S = PARAMETER["output_interval_s"]
_BRIDGE_S = PARAMETER["bridge_s"]
_BRIDGE_ACCEL = PARAMETER["bridge_accel_sd_mps2"]
_BRIDGE_TILT = PARAMETER["bridge_tilt_sd_radps"]
_BRIDGE_YAW = PARAMETER["bridge_yaw_sd_radps"]
_HELD_RATE = PARAMETER["held_rate_sd_radps"]
_GAP_S = PARAMETER["max_gap_s"]
_SATURATED = PARAMETER["saturated_accel_sd_mps2"]


@compiled()
def _catch_up(
    x: FloatArray,
    ti: TimeArray,
    p: FloatArray,
    q: FloatArray,
    par: FloatArray,
    node_t_ns: TimeArray,
    nodes: FloatArray,
) -> None:
    """Bring the covariance up to the newest sample, and note how, for a smoother."""
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
    warmed = x[X_WARMING] ** 2 * par[_WARMING_S]
    for i in range(3):
        q[POS + i] = velocity * dt * dt / 3.0
        q[VEL + i] = velocity
        q[ATT + i] = attitude
        q[GYRO_BIAS + i] = (par[_BG_WALK] ** 2 + par[_BG_PER_K] ** 2 * warmed) * dt
        q[ACCEL_BIAS + i] = (par[_BA_WALK] ** 2 + par[_BA_PER_K] ** 2 * warmed) * dt
        x[X_BIAS_VAR_THEN + i] += q[GYRO_BIAS + i]
    tilted = (par[_BRIDGE_TILT] * bridged) ** 2 + note_turn(x, dt, x[X_TURN], par)
    q[ATT] += tilted
    q[ATT + 1] += tilted
    q[ATT + 2] += (par[_BRIDGE_YAW] * bridged) ** 2
    if x[X_HELD_S] > 0.0 and ti[I_STATIONARY] == 0:
        # The rate that is not seen lasts: its angle grows with the time, not with the root of it.
        run = max(x[X_HELD_RUN_S], x[X_HELD_S])
        held = run * run - (run - x[X_HELD_S]) ** 2
        q[ATT] += par[_BRIDGE_TILT] ** 2 * held
        q[ATT + 1] += par[_BRIDGE_TILT] ** 2 * held
        q[ATT + 2] += par[_HELD_RATE] ** 2 * held
    q[SPEED_SCALE] = par[_SCALE_WALK] ** 2 * dt
    q[MOUNT_PITCH] = par[_MOUNT_WALK] ** 2 * dt
    q[MOUNT_YAW] = par[_MOUNT_WALK] ** 2 * dt
    q[GNSS_DELAY], q[GYRO_SCALE] = 0.0, 0.0
    q[BARO_BIAS] = par[_BARO_WALK] ** 2 * dt
    for i in range(3):
        q[GNSS_ERROR + i] = 0.0
    if ti[I_NODES] < node_t_ns.shape[0]:
        node_t_ns[ti[I_NODES]] = ti[T_NOW]
        open_node(x, nodes[ti[I_NODES]], dt, (x[X_DV], x[X_DV + 1], x[X_DV + 2]), mean, x[X_TURN], q)
        ti[I_NODES] += 1
    x[X_DECAY], x[X_DECAY_VAR], x[X_DECAY_VAR + 1], x[X_DECAY_VAR + 2] = 1.0, 0.0, 0.0, 0.0
    x[X_OPENED : X_OPENED + 5] = 0.0
    x[X_OPENED_TILT] = 0.0
    x[X_EXCHANGED], x[X_EXCHANGED + 1] = 0.0, 0.0
    ti[T_BROKEN] = 0
    propagate(p, dt, (x[X_DV], x[X_DV + 1], x[X_DV + 2]), mean, x[X_TURN], q)
    x[X_DV], x[X_DV + 1], x[X_DV + 2], x[X_TURN] = 0.0, 0.0, 0.0, 0.0
    x[X_SATURATED_S], x[X_BRIDGED_S], x[X_HELD_S] = 0.0, 0.0, 0.0
    ti[T_COV] = ti[T_NOW]


@compiled()
def _plausible(x: FloatArray, p: FloatArray) -> bool:
    """Whether a vehicle and its box can be in this state; False too where it is not a number."""
    sane = abs(x[X_ALT]) < MOST_HEIGHT_M and abs(x[X_LAT]) < MAX_LATITUDE_RAD
    for i in range(3):
        sane &= abs(x[X_V + i]) < MOST_MPS
        sane &= abs(x[X_BA + i]) < MOST_ACCEL_BIAS_MPS2
        sane &= abs(x[X_BG + i]) < MOST_GYRO_BIAS_RADPS
        sane &= p[(POS + i) * N_STATES + POS + i] < MOST_SD_M * MOST_SD_M
    return bool(sane)


@compiled()
def _fuse(
    x: FloatArray,
    ti: TimeArray,
    p: FloatArray,
    t_ns: int,
    aid: FloatArray,
    antenna_lever_b: FloatArray,
    par: FloatArray,
    work: Work,
) -> None:
    """Let in one aid, whatever its kind."""
    kind = round(aid[0])
    if kind == K_GNSS:
        if not too_old(ti, t_ns, par, A_POSITION) and not repeats(x, ti, p, aid[1:], par):
            fuse_position(x, ti, p, t_ns, aid[1:], antenna_lever_b, par, work)
            fuse_velocity(x, ti, p, t_ns, aid[1:], antenna_lever_b, par, work)
    elif kind == K_SPEED:
        if not too_old(ti, t_ns, par, A_SPEED):
            fuse_speed(x, ti, p, t_ns, aid[1], par, work)
    elif kind == K_MAGNETIC:
        if not too_old(ti, t_ns, par, A_MAGNETOMETER):
            fuse_magnetic(x, ti, p, t_ns, (aid[1], aid[2], aid[3]), par, work)
    elif kind == K_BARO and not too_old(ti, t_ns, par, A_BAROMETER):
        fuse_barometer(x, ti, p, t_ns, aid[1], par, work)


@compiled()
def keep(x: FloatArray, ti: TimeArray, p: FloatArray, kept: FloatArray, kept_ti: TimeArray) -> None:
    """Keep the whole state, in the place of the oldest."""
    slot = (ti[T_NOW] // SECOND_NS) % kept.shape[0]
    for i in range(NX):
        kept[slot, i] = x[i]
    for i in range(p.shape[0]):
        kept[slot, NX + i] = p[i]
    for i in range(NT):
        kept_ti[slot, i] = ti[i]
    kept_ti[slot, I_RECORDS], kept_ti[slot, I_NODES] = 0, 0  # of this call, not of the state


@compiled()
def run(
    x: FloatArray,
    ti: TimeArray,
    p: FloatArray,
    kept: FloatArray,
    kept_ti: TimeArray,
    scratch: FloatArray,
    par: FloatArray,
    setup: FloatArray,
    imu_t_ns: TimeArray,
    f_b: FloatArray,
    omega_b: FloatArray,
    unsound: FloatArray,
    aid_t_ns: TimeArray,
    aids: FloatArray,
    epochs: FloatArray,
    out_t_ns: TimeArray,
    out: FloatArray,
    log_t_ns: TimeArray,
    log: FloatArray,
    node_t_ns: TimeArray,
    nodes: FloatArray,
) -> tuple[int, int, int, int]:
    """Fold samples into the state until they end, a gap comes, or the filter is lost.

    Parameters
    ----------
    x, ti, p : state, see ``state``; changed in place
    kept, kept_ti : (KEPT_SECONDS, KEPT_WIDTH), (KEPT_SECONDS, NT) states at the last whole seconds
    scratch : (SCRATCH,) zeros at first; nothing in it outlives the call
    par : ``Tuning.as_array()``
    setup : (7,) inertial sensor in the body (3), antenna against the sensor (3), m; switches ``USE_NHC | USE_ZUPT``
    imu_t_ns, f_b, omega_b, unsound : (n,), (n, 3), (n, 3), (n,) calibrated samples in b; sums of CLIPPED, HELD
    aid_t_ns, aids : (m,), (m, AID_WIDTH) usable aids by increasing time; those after the last sample wait
    epochs : (n, 4) written: down in b and horizontal speed at each sample
    out_t_ns, out : written: track rows
    log_t_ns, log : written: records of the aids, as many as fit; ``ti[I_RECORDS]`` says how many
    node_t_ns, nodes : written: what a smoother needs, as much as fits; ``ti[I_NODES]`` says how many

    Returns
    -------
    samples used, aids used, rows written, why it stopped
    """
    n_samples, n_aids = imu_t_ns.shape[0], aid_t_ns.shape[0]
    n = round(math.sqrt(p.shape[0]))
    dx, q = scratch[:n], scratch[n : 2 * n]
    work = (n, dx, scratch[2 * n : 3 * n], scratch[3 * n : 4 * n], log_t_ns, log)
    imu_lever_b, antenna_lever_b = setup[:3], setup[3:6]
    switches = round(setup[6])
    covariance_ns = np.int64(round(par[_COVARIANCE_S] * 1e9))
    constraint_ns = np.int64(round(par[_CONSTRAINT_S] * 1e9))
    output_ns = np.int64(round(par[_OUTPUT_S] * 1e9))
    bridge_s, gap_s = par[_BRIDGE_S], par[_GAP_S]
    i_aid, rows = 0, 0
    ti[I_RECORDS], ti[I_NODES] = 0, 0

    qw, qx, qy, qz = x[X_Q], x[X_Q + 1], x[X_Q + 2], x[X_Q + 3]
    vn, ve, vd = x[X_V], x[X_V + 1], x[X_V + 2]
    bgx, bgy, bgz = x[X_BG], x[X_BG + 1], x[X_BG + 2]
    bax, bay, baz = x[X_BA], x[X_BA + 1], x[X_BA + 2]
    gn, ge, gd = x[X_G], x[X_G + 1], x[X_G + 2]
    rn, re, rd = x[X_DR], x[X_DR + 1], x[X_DR + 2]
    sn, se, sd, turn = x[X_DV], x[X_DV + 1], x[X_DV + 2], x[X_TURN]
    scale_z = 1.0 + x[X_GYRO_SCALE]
    fx, fy, fz = x[X_F], x[X_F + 1], x[X_F + 2]
    wx, wy, wz = x[X_W], x[X_W + 1], x[X_W + 2]
    s0, s1, s2 = x[X_BLOCK], x[X_BLOCK + 1], x[X_BLOCK + 2]
    s3, s4, s5 = x[X_BLOCK + 3], x[X_BLOCK + 4], x[X_BLOCK + 5]
    h0, h1, h2 = x[X_BLOCK_SUMS], x[X_BLOCK_SUMS + 1], x[X_BLOCK_SUMS + 2]
    h3, h4, h5 = x[X_BLOCK_SUMS + 3], x[X_BLOCK_SUMS + 4], x[X_BLOCK_SUMS + 5]
    in_block = ti[I_BLOCK]
    hangs = x[X_HELD_RUN_S] > 0.0
    t_prev = ti[T_NOW]
    next_event = np.int64(0)
    stopped = STOPPED_END
    used = n_samples
    for k in range(n_samples):
        t = imu_t_ns[k]
        dt = (t - t_prev) * 1e-9
        if dt <= 0.0:
            count(ti, A_IMU, REJECTED_TIME)
            epochs[k, 0], epochs[k, 1], epochs[k, 2], epochs[k, 3] = np.nan, np.nan, np.nan, np.nan
            continue
        if dt > gap_s:
            used, stopped = k, STOPPED_GAP
            break
        nfx, nfy, nfz = f_b[k, 0], f_b[k, 1], f_b[k, 2]
        nwx, nwy, nwz = omega_b[k, 0], omega_b[k, 1], omega_b[k, 2]

        # Trapezoid over the step, rotated by half of its own turn (Titterton & Weston, sec. 11.2).
        ax, ay, az = (
            (0.5 * (wx + nwx) - bgx) * dt,
            (0.5 * (wy + nwy) - bgy) * dt,
            (0.5 * (wz + nwz) - bgz) * dt * scale_z,
        )
        ux, uy, uz = (0.5 * (fx + nfx) - bax) * dt, (0.5 * (fy + nfy) - bay) * dt, (0.5 * (fz + nfz) - baz) * dt
        px = ux + 0.5 * (ay * uz - az * uy)
        py = uy + 0.5 * (az * ux - ax * uz)
        pz = uz + 0.5 * (ax * uy - ay * ux)
        c0, c1, c2, c3, c4, c5, c6, c7, c8 = matrix_of(qw, qx, qy, qz)
        dvn = c0 * px + c1 * py + c2 * pz
        dve = c3 * px + c4 * py + c5 * pz
        dvd = c6 * px + c7 * py + c8 * pz
        sn, se, sd, turn = sn + dvn, se + dve, sd + dvd, turn + az
        dvn, dve, dvd = dvn + gn * dt, dve + ge * dt, dvd + gd * dt
        rn, re, rd = rn + (vn + 0.5 * dvn) * dt, re + (ve + 0.5 * dve) * dt, rd + (vd + 0.5 * dvd) * dt
        vn, ve, vd = vn + dvn, ve + dve, vd + dvd
        qw, qx, qy, qz = turned(qw, qx, qy, qz, ax, ay, az)
        fx, fy, fz, wx, wy, wz = nfx, nfy, nfz, nwx, nwy, nwz
        t_prev = t
        wrong = int(unsound[k])
        if wrong != 0:
            if wrong & CLIPPED:
                x[X_SATURATED_S] += dt
            if wrong & HELD:
                x[X_HELD_S] += dt
                x[X_HELD_RUN_S] += dt
                hangs = True
        if hangs and not wrong & HELD:
            hangs, x[X_HELD_RUN_S] = False, 0.0
        if dt > bridge_s:
            x[X_BRIDGED_S] += dt
        epochs[k, 0] = 2.0 * (qx * qz - qw * qy)
        epochs[k, 1] = 2.0 * (qy * qz + qw * qx)
        epochs[k, 2] = 1.0 - 2.0 * (qx * qx + qy * qy)
        epochs[k, 3] = math.sqrt(vn * vn + ve * ve)

        due = False
        if t >= next_event:
            x[X_Q], x[X_Q + 1], x[X_Q + 2], x[X_Q + 3] = qw, qx, qy, qz
            x[X_V], x[X_V + 1], x[X_V + 2] = vn, ve, vd
            x[X_DR], x[X_DR + 1], x[X_DR + 2] = rn, re, rd
            x[X_DV], x[X_DV + 1], x[X_DV + 2], x[X_TURN] = sn, se, sd, turn
            x[X_F], x[X_F + 1], x[X_F + 2] = fx, fy, fz
            x[X_W], x[X_W + 1], x[X_W + 2] = wx, wy, wz
            ti[T_NOW] = t
            node = ti[I_NODES]
            block_due, constraint_due = t >= ti[T_NEXT_BLOCK], t >= ti[T_NEXT_CONSTRAINT]
            if block_due:
                x[X_BLOCK], x[X_BLOCK + 1], x[X_BLOCK + 2] = s0, s1, s2
                x[X_BLOCK + 3], x[X_BLOCK + 4], x[X_BLOCK + 5] = s3, s4, s5
                x[X_BLOCK_SUMS], x[X_BLOCK_SUMS + 1], x[X_BLOCK_SUMS + 2] = h0, h1, h2
                x[X_BLOCK_SUMS + 3], x[X_BLOCK_SUMS + 4], x[X_BLOCK_SUMS + 5] = h3, h4, h5
                ti[I_BLOCK] = in_block
                close_block(x, ti, p, par)
                s0, s1, s2, s3, s4, s5, in_block = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0
                h0, h1, h2, h3, h4, h5 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
                due = t // SECOND_NS != ti[T_NEXT_BLOCK] // SECOND_NS or ti[T_NEXT_BLOCK] % SECOND_NS == 0
                ti[T_NEXT_BLOCK] = (t // BLOCK_NS + 1) * BLOCK_NS
            propagated = t >= ti[T_NEXT_COVARIANCE] or constraint_due or (i_aid < n_aids and aid_t_ns[i_aid] <= t)
            if block_due or propagated:
                fold_position(x, ti)
            if propagated:
                _catch_up(x, ti, p, q, par, node_t_ns, nodes)
                ti[T_NEXT_COVARIANCE] = (t // covariance_ns + 1) * covariance_ns
            if block_due:
                if not _plausible(x, p):
                    stopped = STOPPED_DIVERGED
                if due:
                    symmetrise(p, n)
                    renew_mounting(x)
            while i_aid < n_aids and aid_t_ns[i_aid] <= t:
                _fuse(x, ti, p, aid_t_ns[i_aid], aids[i_aid], antenna_lever_b, par, work)
                i_aid += 1
            if stopped == STOPPED_END and lost(ti, par):
                stopped = STOPPED_LOST
            if constraint_due:
                ti[T_NEXT_CONSTRAINT] = (t // constraint_ns + 1) * constraint_ns
                if ti[I_STATIONARY] != 0 and switches & USE_ZUPT:
                    fuse_standstill(x, ti, p, par, work)
                elif switches & USE_NHC:
                    fuse_non_holonomic(x, ti, p, par, work)
            if ti[I_NODES] > node:
                close_node(x, ti, p, nodes[node])
            if t >= ti[T_NEXT_OUTPUT]:
                if output_ns > 0:
                    ti[T_NEXT_OUTPUT] = (t // output_ns + 1) * output_ns
                put_row(x, ti, p, imu_lever_b, par, out[rows])
                out_t_ns[rows] = t
                rows += 1
            qw, qx, qy, qz = x[X_Q], x[X_Q + 1], x[X_Q + 2], x[X_Q + 3]
            vn, ve, vd = x[X_V], x[X_V + 1], x[X_V + 2]
            bgx, bgy, bgz = x[X_BG], x[X_BG + 1], x[X_BG + 2]
            bax, bay, baz = x[X_BA], x[X_BA + 1], x[X_BA + 2]
            gn, ge, gd = x[X_G], x[X_G + 1], x[X_G + 2]
            rn, re, rd = x[X_DR], x[X_DR + 1], x[X_DR + 2]
            sn, se, sd, turn = x[X_DV], x[X_DV + 1], x[X_DV + 2], x[X_TURN]
            scale_z = 1.0 + x[X_GYRO_SCALE]
            next_event = min(ti[T_NEXT_BLOCK], ti[T_NEXT_COVARIANCE])
            next_event = min(next_event, min(ti[T_NEXT_CONSTRAINT], ti[T_NEXT_OUTPUT]))
            if i_aid < n_aids:
                next_event = min(next_event, aid_t_ns[i_aid])
        s0, s1, s2 = s0 + nfx, s1 + nfy, s2 + nfz
        s3, s4, s5 = s3 + nwx, s4 + nwy, s5 + nwz
        h0, h1, h2 = h0 + s0, h1 + s1, h2 + s2
        h3, h4, h5 = h3 + s3, h4 + s4, h5 + s5
        in_block += 1
        if due:
            x[X_BLOCK], x[X_BLOCK + 1], x[X_BLOCK + 2] = s0, s1, s2
            x[X_BLOCK + 3], x[X_BLOCK + 4], x[X_BLOCK + 5] = s3, s4, s5
            x[X_BLOCK_SUMS], x[X_BLOCK_SUMS + 1], x[X_BLOCK_SUMS + 2] = h0, h1, h2
            x[X_BLOCK_SUMS + 3], x[X_BLOCK_SUMS + 4], x[X_BLOCK_SUMS + 5] = h3, h4, h5
            ti[I_BLOCK] = in_block
            learn_warming(x, ti, p, par)
            keep(x, ti, p, kept, kept_ti)
        if stopped != STOPPED_END:
            used = k + 1
            break
    x[X_Q], x[X_Q + 1], x[X_Q + 2], x[X_Q + 3] = qw, qx, qy, qz
    x[X_V], x[X_V + 1], x[X_V + 2] = vn, ve, vd
    x[X_DR], x[X_DR + 1], x[X_DR + 2] = rn, re, rd
    x[X_DV], x[X_DV + 1], x[X_DV + 2], x[X_TURN] = sn, se, sd, turn
    x[X_F], x[X_F + 1], x[X_F + 2] = fx, fy, fz
    x[X_W], x[X_W + 1], x[X_W + 2] = wx, wy, wz
    x[X_BLOCK], x[X_BLOCK + 1], x[X_BLOCK + 2] = s0, s1, s2
    x[X_BLOCK + 3], x[X_BLOCK + 4], x[X_BLOCK + 5] = s3, s4, s5
    x[X_BLOCK_SUMS], x[X_BLOCK_SUMS + 1], x[X_BLOCK_SUMS + 2] = h0, h1, h2
    x[X_BLOCK_SUMS + 3], x[X_BLOCK_SUMS + 4], x[X_BLOCK_SUMS + 5] = h3, h4, h5
    ti[I_BLOCK] = in_block
    ti[T_NOW] = t_prev
    return used, i_aid, rows, stopped
