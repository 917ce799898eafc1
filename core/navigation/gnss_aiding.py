"""GNSS position and velocity: how far they are trusted, fused, refused, and believed against the filter in the end.

How fixes err, in a white and a slow part, is learnt in ``fix_error``.

Innovations are z - h(x). A refused aid changes nothing but counters (and, for positions, the memory from
which a run of refused fixes that agree with each other is recognised as the truth: recovery; a refused height
widens the spread of the filter's own, for the same end).
"""

from __future__ import annotations

import math

from core.compiled import compiled
from core.measurements import GNSS, FloatArray, TimeArray
from core.navigation.admission import position_sd_m
from core.navigation.axes import doubt_axes
from core.navigation.correction import Work, correct, count, record
from core.navigation.fix_error import decay, learn_drift, learn_share, learn_worse, moving_share, slow_share, worse
from core.navigation.kalman import along_six, decorrelate, project_six, update, update_pair
from core.navigation.mechanization import fold_position, matrix_of
from core.navigation.state import (
    A_HEIGHT,
    A_POSITION,
    A_VELOCITY,
    ATT,
    FUSED,
    GNSS_DELAY,
    GNSS_ERROR,
    I_GNSS_USED,
    I_HANGS,
    I_REFUSED,
    I_REFUSED_V,
    I_REJECTED,
    I_RESETS,
    N_STATES,
    POS,
    REJECTED_GATE,
    REJECTED_RANGE,
    REJECTED_TIME,
    RESET,
    T_ANCHOR,
    T_BROKEN,
    T_GNSS,
    T_NOW,
    T_REFUSED,
    T_REFUSED_FOR,
    T_REJECTED,
    VEL,
    X_ALT,
    X_BG,
    X_DECAY_VAR,
    X_DR,
    X_FIX,
    X_G,
    X_GNSS_DELAY,
    X_GNSS_ERROR,
    X_LAT,
    X_LON,
    X_M_PER_RAD,
    X_MEAN_NU,
    X_MOVING,
    X_NEWEST,
    X_OPENED,
    X_Q,
    X_REJECTED_N,
    X_RISING_N,
    X_UNSEEN,
    X_V,
    X_W,
    X_WHITE_SHARE,
)
from core.navigation.tuning import PARAMETER

_LAT, _LON, _ALT = GNSS["lat_rad"], GNSS["lon_rad"], GNSS["alt_m"]
_VN, _VE, _VD = GNSS["vn_mps"], GNSS["ve_mps"], GNSS["vd_mps"]
_SPEED, _COURSE = GNSS["speed_mps"], GNSS["course_rad"]
_SD_VEL = GNSS["sd_v_mps"]

_P_SD_VEL = PARAMETER["gnss_sd_v_mps"]
_P_FLOOR_V = PARAMETER["gnss_sd_v_floor_mps"]
_P_AGE = PARAMETER["gnss_max_age_s"]
_P_WHITE_FLOOR = PARAMETER["gnss_white_floor"]
_P_GATE_POS = PARAMETER["gate_position"]
_P_GATE_VEL = PARAMETER["gate_velocity"]
_P_GATE = PARAMETER["gate_scalar"]
_P_RECOVERY = PARAMETER["recovery_s"]
_P_RECOVERY_FIXES = PARAMETER["recovery_fixes"]
_P_LOST_RESETS = PARAMETER["resets_until_lost"]
_P_LOST_S = PARAMETER["refused_until_lost_s"]
_P_AGREE = PARAMETER["recovery_agreement_m"]
_P_RECOVERY_ATT = PARAMETER["recovery_attitude_sd_rad"]
_P_STILL_SPEED = PARAMETER["still_max_speed_mps"]

COURSE_MIN_SPEED_MPS = 1.0
"""Below this a receiver's course is noise; its speed alone then says little more than the position."""

FADING = 0.3
"""Weight of the newest innovation in their mean: some three fixes. A choice; recovery within 10 s of good fixes."""

SLOW_LIMIT = 9.0
"""Times the stated variance that a height's slow error may have: reflections between houses are three times worse."""


@compiled()
def _reset_position(
    x: FloatArray, ti: TimeArray, p: FloatArray, n: int, nu: tuple[float, float], sd_h: float, par: FloatArray
) -> None:
    """Take the position from the fixes that agree against us; open velocity and heading for what follows."""
    slow = x[X_MOVING] * slow_share(x, par) * sd_h * sd_h
    for i in range(2):
        at, error = POS + i, GNSS_ERROR + i
        x[X_DR + i] += nu[i] + x[X_GNSS_ERROR + i]
        x[X_GNSS_ERROR + i] = 0.0
        for j in range(n):
            p[at * n + j] = 0.0
            p[j * n + at] = 0.0
            p[error * n + j] = 0.0
            p[j * n + error] = 0.0
        p[at * n + at] = sd_h * sd_h - x[X_UNSEEN]
        p[error * n + error] = slow
        p[at * n + error] = -slow
        p[error * n + at] = -slow
        # The drift that made the offset: it grew over the run of refusals at least.
        run_s = max(1.0, (ti[T_NOW] - ti[T_GNSS]) * 1e-9)
        p[(VEL + i) * n + VEL + i] += (nu[i] / run_s) ** 2 + 0.25
    p[(ATT + 2) * n + ATT + 2] += par[_P_RECOVERY_ATT] ** 2


@compiled()
def _widen(x: FloatArray, p: FloatArray, n: int, nu: tuple[float, float], s: tuple[float, float], gate: float) -> None:
    """Open the position where innovations, each within its gate, all point the same way: the filter is too sure.

    The fading mean of normalised innovations has the variance a / (2 - a) if they are white, as the model says
    (Bar-Shalom, Li & Kirubarajan 2001, sec. 5.4.2). Beyond the gate its square is what the position may be off by.
    """
    total = 0.0
    for i in range(2):
        x[X_MEAN_NU + i] += FADING * (nu[i] / math.sqrt(s[i]) - x[X_MEAN_NU + i])
        total += x[X_MEAN_NU + i] ** 2
    if total * (2.0 - FADING) / FADING <= gate:
        return
    for i in range(2):
        opened = x[X_MEAN_NU + i] ** 2 * s[i]
        p[(POS + i) * n + POS + i] += opened
        x[X_OPENED + i] += opened
        x[X_MEAN_NU + i] = 0.0


@compiled()
def _refused(x: FloatArray, ti: TimeArray, t_ns: int, nu_n: float, nu_e: float, sd_h: float, par: FloatArray) -> bool:
    """Remember a refused fix; True if enough of them in a row agree with each other against the filter."""
    # What stays away refutes nothing: an outage hardly makes a run of refusals longer.
    recovery_ns = round(par[_P_RECOVERY] * 1e9)
    ti[T_REFUSED_FOR] = 0 if ti[I_REFUSED] == 0 else ti[T_REFUSED_FOR] + min(t_ns - ti[T_REFUSED], recovery_ns)
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
    return bool(long_enough and ti[I_REJECTED] >= par[_P_RECOVERY_FIXES])


@compiled()
def repeats(x: FloatArray, ti: TimeArray, p: FloatArray, fix: FloatArray, par: FloatArray) -> bool:
    """Whether a fix says to the last bit what the one before said although the vehicle moves; counted if so.

    A receiver that hangs, or one that is asked more often than it computes, sends its last fix with a new time. It
    says nothing of now, and a run of such must not be taken for fixes that agree with each other.
    """
    same = fix[_LAT] == x[X_FIX] and fix[_LON] == x[X_FIX + 1]
    x[X_FIX], x[X_FIX + 1] = fix[_LAT], fix[_LON]
    if not same:
        ti[I_HANGS] = 0
        return False
    if ti[I_HANGS] == 0:
        i0 = VEL * N_STATES + VEL
        sd = math.sqrt(max(p[i0], p[i0 + N_STATES + 1]))
        least = par[_P_STILL_SPEED] + 3.0 * sd
        if x[X_V] ** 2 + x[X_V + 1] ** 2 <= least * least:
            return False
        ti[I_HANGS] = 1  # until it says something else, also where the vehicle stops meanwhile
    count(ti, A_POSITION, REJECTED_RANGE)
    return True


@compiled()
def fuse_position(
    x: FloatArray,
    ti: TimeArray,
    p: FloatArray,
    t_ns: int,
    fix: FloatArray,
    lever_b: FloatArray,
    par: FloatArray,
    work: Work,
) -> bool:
    """GNSS position: horizontal by one gate of two dimensions, height by its own. True if fused.

    ``fix`` is one that is usable; ``lever_b`` is the antenna against the inertial sensor, body axes, m.
    """
    n, dx, ph, ph2 = work[0], work[1], work[2], work[3]
    sd_h, sd_v = position_sd_m(fix, par)
    stated = sd_h * sd_h
    taken = stated * worse(x, par)
    slow, moving = slow_share(x, par), moving_share(x, stated, par)
    decay(x, ti, p, n, (slow * taken, slow * sd_v * sd_v), moving, par)
    x[X_UNSEEN], x[X_UNSEEN + 1] = (1.0 - moving) * slow * taken, (1.0 - moving) * slow * sd_v * sd_v
    lag_s = (ti[T_NOW] - t_ns) * 1e-9 + x[X_GNSS_DELAY]
    c = matrix_of(x[X_Q], x[X_Q + 1], x[X_Q + 2], x[X_Q + 3])
    ln = c[0] * lever_b[0] + c[1] * lever_b[1] + c[2] * lever_b[2]
    le = c[3] * lever_b[0] + c[4] * lever_b[1] + c[5] * lever_b[2]
    ld = c[6] * lever_b[0] + c[7] * lever_b[1] + c[8] * lever_b[2]
    vn, ve, vd = x[X_V], x[X_V + 1], x[X_V + 2]
    d_lon = fix[_LON] - x[X_LON]
    if d_lon > math.pi:
        d_lon -= 2.0 * math.pi
    elif d_lon < -math.pi:
        d_lon += 2.0 * math.pi
    nu_n = (fix[_LAT] - x[X_LAT]) * x[X_M_PER_RAD] + lag_s * vn - ln - x[X_GNSS_ERROR]
    nu_e = d_lon * x[X_M_PER_RAD + 1] + lag_s * ve - le - x[X_GNSS_ERROR + 1]
    nu_d = -(fix[_ALT] - x[X_ALT]) + lag_s * vd - ld - x[X_GNSS_ERROR + 2]

    # z - h = dr + (phi x l) + slow error - v delay
    at_n = (POS, GNSS_ERROR, GNSS_DELAY, ATT, ATT + 1, ATT + 2)
    at_e = (POS + 1, GNSS_ERROR + 1, GNSS_DELAY, ATT, ATT + 1, ATT + 2)
    row_n = (1.0, 1.0, -vn, 0.0, ld, -le)
    row_e = (1.0, 1.0, -ve, -ld, 0.0, ln)
    white = max(x[X_WHITE_SHARE], par[_P_WHITE_FLOOR])
    rr = white * taken
    own_n = project_six(p, n, at_n, row_n, ph)
    own_e = project_six(p, n, at_e, row_e, ph2)
    snn, see, sne = own_n + rr, own_e + rr, along_six(at_e, row_e, ph)
    ratio = (see * nu_n * nu_n - 2.0 * sne * nu_n * nu_e + snn * nu_e * nu_e) / (snn * see - sne * sne)
    ratio /= par[_P_GATE_POS]
    fused = ratio <= 1.0
    outcome = FUSED
    if not fused:
        outcome = RESET if _refused(x, ti, t_ns, nu_n, nu_e, sd_h, par) else REJECTED_GATE
        count(ti, A_POSITION, REJECTED_GATE)
    record(ti, work, t_ns, A_POSITION, 0, nu_n, snn, ratio, outcome)
    record(ti, work, t_ns, A_POSITION, 1, nu_e, see, ratio, outcome)
    if outcome == REJECTED_GATE:
        if ti[I_REFUSED] >= 2 and not math.isfinite(fix[_VN]):
            doubt_axes(x, p, par)
        return False
    count(ti, A_POSITION, outcome)
    if fused:
        learn_drift(x, ti, t_ns, nu_n + x[X_GNSS_ERROR], nu_e + x[X_GNSS_ERROR + 1], stated, par)
        learn_share(x, 0.5 * (nu_n * nu_n + nu_e * nu_e), 0.5 * (own_n + own_e), taken, par)
        learn_worse(x, 0.5 * ratio * par[_P_GATE_POS], par)
        share = sne / snn
        decorrelate(n, ph, ph2, share)
        update_pair(p, n, ph, 1.0 / snn, nu_n, ph2, 1.0 / (see - share * sne), nu_e - share * nu_n, dx)
        _widen(x, p, n, (nu_n, nu_e), (snn, see), par[_P_GATE_POS])
        ti[I_RESETS] = 0
    else:
        _reset_position(x, ti, p, n, (nu_n, nu_e), sd_h, par)
        x[X_MEAN_NU], x[X_MEAN_NU + 1] = 0.0, 0.0
        ti[I_RESETS] += 1
        ti[T_BROKEN] = max(1, ti[T_NOW] - ti[T_GNSS])
        ti[T_ANCHOR] = 0
    ti[I_REJECTED] = 0
    ti[I_REFUSED] = 0
    ti[T_GNSS] = ti[T_NOW]
    ti[I_GNSS_USED] = 1

    if math.isfinite(nu_d):
        at_d = (POS + 2, GNSS_ERROR + 2, GNSS_DELAY, ATT, ATT + 1, ATT + 2)
        row_d = (1.0, 1.0, -vd, le, -ln, 0.0)
        s = project_six(p, n, at_d, row_d, ph) + white * sd_v * sd_v
        innovation = nu_d - along_six(at_d, row_d, dx)
        ratio = innovation * innovation / (par[_P_GATE] * s)
        believed = ratio <= 1.0 or not fused
        if believed:
            update(p, n, ph, s, innovation, dx)
        else:
            # A height that stays wrong must not stay refused: a quarter of its excess is believed next time, as the
            # receiver's slow error as far as that may be, and beyond as the filter's own.
            excess = 0.25 * innovation * innovation / par[_P_GATE]
            slow_at = (GNSS_ERROR + 2) * n + GNSS_ERROR + 2
            to_slow = min(excess, max(0.0, SLOW_LIMIT * sd_v * sd_v - p[slow_at]))
            p[slow_at] += to_slow
            p[(POS + 2) * n + POS + 2] += excess - to_slow
            x[X_DECAY_VAR + 2] += to_slow
            x[X_OPENED + 2] += excess - to_slow
        outcome = FUSED if believed else REJECTED_GATE
        count(ti, A_HEIGHT, outcome)
        record(ti, work, t_ns, A_HEIGHT, 0, innovation, s, ratio, outcome)
    correct(x, dx)
    fold_position(x, ti)
    return True


@compiled()
def lost(ti: TimeArray, par: FloatArray) -> bool:
    """Whether fixes have contradicted the state for so long that it has to be found anew."""
    if ti[I_RESETS] >= par[_P_LOST_RESETS]:
        return True
    refused = ti[I_REFUSED] >= par[_P_RECOVERY_FIXES]
    return bool(refused and ti[T_REFUSED_FOR] * 1e-9 >= par[_P_LOST_S])


@compiled()
def fuse_velocity(
    x: FloatArray,
    ti: TimeArray,
    p: FloatArray,
    t_ns: int,
    fix: FloatArray,
    lever_b: FloatArray,
    par: FloatArray,
    work: Work,
) -> None:
    """GNSS velocity, or speed with course: horizontal by one gate of two dimensions, vertical by its own."""
    n, dx, ph, ph2 = work[0], work[1], work[2], work[3]
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
    an, ae, ad = 0.0, 0.0, 0.0
    if x[X_RISING_N] > 0.0:
        # Of a whole block: single samples shake.
        fx, fy, fz = x[X_NEWEST], x[X_NEWEST + 1], x[X_NEWEST + 2]
        an = c[0] * fx + c[1] * fy + c[2] * fz + x[X_G]
        ae = c[3] * fx + c[4] * fy + c[5] * fz + x[X_G + 1]
        ad = c[6] * fx + c[7] * fy + c[8] * fz + x[X_G + 2]
    lag_s = (ti[T_NOW] - t_ns) * 1e-9 + x[X_GNSS_DELAY]
    nu_n = vn + an * lag_s - x[X_V] - (c[0] * bx + c[1] * by + c[2] * bz)
    nu_e = ve + ae * lag_s - x[X_V + 1] - (c[3] * bx + c[4] * by + c[5] * bz)
    nu_d = vd + ad * lag_s - x[X_V + 2] - (c[6] * bx + c[7] * by + c[8] * bz)
    rr = sd * sd
    row_n, row_e, row_d = (1.0, -an, 0.0, 0.0, 0.0, 0.0), (1.0, -ae, 0.0, 0.0, 0.0, 0.0), (1.0, -ad, 0.0, 0.0, 0.0, 0.0)
    at_n = (VEL, GNSS_DELAY, ATT, ATT, ATT, ATT)
    at_e = (VEL + 1, GNSS_DELAY, ATT, ATT, ATT, ATT)
    at_d = (VEL + 2, GNSS_DELAY, ATT, ATT, ATT, ATT)
    snn = project_six(p, n, at_n, row_n, ph) + rr
    see = project_six(p, n, at_e, row_e, ph2) + rr
    sne = along_six(at_e, row_e, ph)
    ratio = (see * nu_n * nu_n - 2.0 * sne * nu_n * nu_e + snn * nu_e * nu_e) / (snn * see - sne * sne)
    ratio /= par[_P_GATE_VEL]
    outcome = FUSED if ratio <= 1.0 else REJECTED_GATE
    count(ti, A_VELOCITY, outcome)
    record(ti, work, t_ns, A_VELOCITY, 0, nu_n, snn, ratio, outcome)
    record(ti, work, t_ns, A_VELOCITY, 1, nu_e, see, ratio, outcome)
    if outcome == REJECTED_GATE:
        # As with heights: a velocity that stays wrong must not stay refused.
        opened_n, opened_e = 0.25 * nu_n * nu_n / par[_P_GATE_VEL], 0.25 * nu_e * nu_e / par[_P_GATE_VEL]
        p[VEL * n + VEL] += opened_n
        p[(VEL + 1) * n + VEL + 1] += opened_e
        x[X_OPENED + 3] += opened_n
        x[X_OPENED + 4] += opened_e
        ti[I_REFUSED_V] += 1
        if ti[I_REFUSED_V] >= 2:
            doubt_axes(x, p, par)
        return
    ti[I_REFUSED_V] = 0
    share = sne / snn
    decorrelate(n, ph, ph2, share)
    update_pair(p, n, ph, 1.0 / snn, nu_n, ph2, 1.0 / (see - share * sne), nu_e - share * nu_n, dx)
    if math.isfinite(nu_d):
        sd_h, sd_v = position_sd_m(fix, par)  # the sky's geometry is that of the positions
        s = project_six(p, n, at_d, row_d, ph) + rr * (sd_v / sd_h) ** 2
        innovation = nu_d - along_six(at_d, row_d, dx)
        ratio = innovation * innovation / (par[_P_GATE] * s)
        outcome = FUSED if ratio <= 1.0 else REJECTED_GATE
        if outcome == FUSED:
            update(p, n, ph, s, innovation, dx)
        record(ti, work, t_ns, A_VELOCITY, 2, innovation, s, ratio, outcome)
    correct(x, dx)


@compiled()
def too_old(ti: TimeArray, t_ns: int, par: FloatArray, aid: int) -> bool:
    """Whether a sample lies too far behind the newest inertial one; counted if so."""
    if (ti[T_NOW] - t_ns) * 1e-9 > par[_P_AGE]:
        count(ti, aid, REJECTED_TIME)
        return True
    return False
