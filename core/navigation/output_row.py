"""One row of the track, made from the filter's state."""

from __future__ import annotations

import math

from core.compiled import compiled
from core.measurements import FloatArray, TimeArray
from core.navigation.mechanization import matrix_of
from core.navigation.state import (
    ACCEL_BIAS,
    ATT,
    I_GNSS_USED,
    MOUNT_YAW,
    N_STATES,
    POS,
    T_GNSS,
    T_NOW,
    VEL,
    X_ALT,
    X_DR,
    X_LAT,
    X_LON,
    X_M_PER_RAD,
    X_MOUNT_SC,
    X_Q,
    X_UNSEEN,
    X_V,
)
from core.navigation.track import TRACK, Mode
from core.navigation.tuning import PARAMETER

_COASTING_S = PARAMETER["coasting_after_s"]
_C_LAT, _C_VN, _C_ROLL, _C_SD_N, _C_SD_YAW, _C_USED, _C_MODE, _C_SD_V = (
    TRACK["lat_rad"],
    TRACK["vn_mps"],
    TRACK["roll_rad"],
    TRACK["sd_n_m"],
    TRACK["sd_yaw_rad"],
    TRACK["gnss_used"],
    TRACK["mode"],
    TRACK["sd_v_h_mps"],
)
_COASTING, _AIDED = int(Mode.COASTING), int(Mode.AIDED)


@compiled()
def put_row(x: FloatArray, ti: TimeArray, p: FloatArray, lever_b: FloatArray, par: FloatArray, row: FloatArray) -> None:
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
        unseen = x[X_UNSEEN + 1] if i == 2 else x[X_UNSEEN]
        row[_C_SD_N + i] = math.sqrt(max(p[(POS + i) * n + POS + i], 0.0) + unseen)
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
    for k, first in enumerate((VEL, ATT, ACCEL_BIAS)):
        both = p[first * n + first] + p[(first + 1) * n + first + 1]
        row[_C_SD_V + k] = math.sqrt(max(0.5 * both, 0.0))
    ti[I_GNSS_USED] = 0
