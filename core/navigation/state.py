"""Layout of the filter's state: names of the error states and of the flat arrays that hold everything.

The error is truth minus estimate. Position, velocity and attitude errors are in n; C_n_from_b(true) =
(I + [phi x]) C_n_from_b(estimate). Fifteen navigation states are followed by what makes the aids usable: the
scale of the wheel speed, the pitch and yaw of the box in the car, the receiver's error that hangs together in time
and its delay, the barometer's bias, and the scale of the gyroscope that turns with the car.
"""

from __future__ import annotations

from typing import Final

from core.measurements import GNSS_COLUMNS

# Error states: first index of each group.
POS: Final = 0
VEL: Final = 3
ATT: Final = 6
GYRO_BIAS: Final = 9
ACCEL_BIAS: Final = 12
SPEED_SCALE: Final = 15
MOUNT_PITCH: Final = 16
MOUNT_YAW: Final = 17
GNSS_ERROR: Final = 18  # the fixes' error against the truth, n, slowly varying part
GNSS_DELAY: Final = 21
BARO_BIAS: Final = 22
GYRO_SCALE: Final = 23  # of the rate about b's z axis
N_STATES: Final = 24

# The nominal state ``x``, float64.
X_Q: Final = 0  # q_n_from_b, 4
X_V: Final = 4  # v_n, m/s, 3
X_LAT: Final = 7
X_LON: Final = 8
X_ALT: Final = 9
X_BG: Final = 10  # gyroscope bias, rad/s, 3
X_BA: Final = 13  # accelerometer bias, m/s2, 3
X_SCALE: Final = 16
X_MOUNT_PITCH: Final = 17
X_MOUNT_YAW: Final = 18
X_F: Final = 19  # last specific force f_b, bias not removed, m/s2, 3
X_W: Final = 22  # last rate omega_b, bias not removed, rad/s, 3
X_DR: Final = 25  # metres north, east, down since latitude and longitude were last folded, 3
X_DV: Final = 28  # integral of C_n_from_b f_b since the covariance was last propagated, m/s, 3
X_C0: Final = 31  # C_n_from_b when the covariance was last propagated, 9
X_G: Final = 40  # gravity plus Coriolis in n, m/s2, 3
X_WIN: Final = 43  # rate of n against i, rad/s, 3
X_BLOCK: Final = 46  # sums of f_b and omega_b over the open block, 6
X_SATURATED_S: Final = 52  # clipped time since the covariance was last propagated, s
X_REJECTED_N: Final = 53  # innovation of the last refused fix, m, 2
X_BRIDGED_S: Final = 55  # time bridged without samples since the covariance was last propagated, s
X_STILL_F: Final = 56  # spread of the standing vehicle's means as learnt, m/s2; 0 before
X_STILL_W: Final = 57  # the same of the rates, rad/s
X_M_PER_RAD: Final = 58  # metres a radian of latitude, and of longitude, where the vehicle is, 2
X_MOUNT_SC: Final = 60  # sine and cosine of the mounting's pitch, then of its yaw, 4
X_GNSS_ERROR: Final = 64  # slowly varying error of the fixes in n, m, 3
X_GNSS_DELAY: Final = 67  # a fix is of this long before its time, s
X_BARO_BIAS: Final = 68  # barometric minus ellipsoidal height, m
X_GYRO_SCALE: Final = 69  # share by which the rate about z is larger than measured
X_WHITE_SHARE: Final = 70  # variance of the fixes' white error over the stated one, as learnt
X_WHITE_FIXES: Final = 71  # how many fixes it was learnt from, up to a limit
X_SLOW_VAR: Final = 72  # variance of the slowly varying error at the last fix, horizontal and vertical, m2
X_DECAY: Final = 74  # factor by which that error has shrunk at this instant, 1 without a fix
X_DECAY_VAR: Final = 75  # variances that were added to it then, n, e, d, m2
X_HEAVE: Final = 78  # spread of the vertical block means over the last second, m/s2
X_FIELD: Final = 79  # magnitude of the magnetic field as learnt, uT; 0 before
X_MEAN_NU: Final = 80  # fading mean of the innovations of fixes over their sd, 2
X_FIX: Final = 82  # latitude and longitude of the last fix, rad, 2
X_TURN: Final = 84  # integral of the rate about z since the covariance was last propagated, rad
X_HELD_S: Final = 85  # time with a hanging gyroscope since the covariance was last propagated, s
X_HELD_RUN_S: Final = 86  # the same since it began to hang, s
X_READING: Final = 87  # last wheel speed, m/s
X_GAINED: Final = 88  # speed gained since that reading first came, by the accelerometers, m/s
X_SQUAT: Final = 89  # pitch of the body an acceleration, as learnt, rad s2/m
X_SQUAT_VAR: Final = 90  # its variance
X_DRIFT: Final = 91  # half the variance by which fixes drift in a second over the stated one, as learnt, 1/s
X_DRIFTS: Final = 92  # how many differences of fixes it was learnt from, up to a limit
X_ANCHOR: Final = 93  # an earlier fix against the path, and the path's velocity then, north and east, m, m/s, 4
X_MOVED: Final = 97  # how far corrections have moved the path since, m north and east, 2
X_UNSEEN: Final = 99  # variance of what fixes err by and no fix can show, horizontal and vertical, m2
X_MOVING: Final = 101  # share of the slow error that drifts, as of the last fix
X_BIAS_THEN: Final = 102  # the gyroscopes' biases at the last whole second, rad/s, 3
X_BIAS_VAR_THEN: Final = 105  # their variances then, and what was added to them since, 3
X_BIAS_MOVED: Final = 108  # fading sum of what they were moved by, rad/s, 3
X_BIAS_SCORE: Final = 111  # fading sum of the same over its sd, 3
X_BIAS_SECONDS: Final = 114  # seconds that the first of these sums is of, fading alike
X_BIAS_SCORE_VAR: Final = 115  # variance of the second
X_WARMING: Final = 116  # rate of the box's temperature that they show, K/s
X_WORSE: Final = 117  # variance of fixes over the stated one by their innovations, with its margin
X_OPENED: Final = 118  # variances that aids added to position (3) and horizontal velocity (2) at this instant
X_EXCHANGED: Final = 123  # likewise to position and slow error, with opposite signs, horizontal and vertical, m2
X_BLOCK_SUMS: Final = 125  # sums of the open block's sums, as they were after each sample, 6
X_RISING: Final = 131  # sums over the block before, by weights that rise to its end, 6
X_RISING_N: Final = 137  # samples in it, 0 without one
X_TURNED: Final = 138  # how far the vehicle has turned lately, rad
X_AXES_VAR: Final = 139  # variance of tilt that a turn leaves, a radian, 0 until fixes contradict what came of one
X_OPENED_TILT: Final = 140  # variance that was added to the tilt at this instant, each axis, rad2
X_NEWEST: Final = 141  # mean f_b over the last closed block, 3
X_VERTICAL: Final = 144  # mean f_b downwards over each of the last N_BLOCKS blocks
X_RING: Final = 154  # N_BLOCKS rows of mean f_b (3), mean omega_b (3), each over two blocks by a hat
N_BLOCKS: Final = 10
NX: Final = X_RING + 6 * N_BLOCKS

# Integer state ``ti``, int64: times in ns and counters.
T_NOW: Final = 0
T_COV: Final = 1  # covariance is valid at
T_FOLD: Final = 2  # latitude and longitude are valid at
T_NEXT_BLOCK: Final = 3
T_NEXT_CONSTRAINT: Final = 4
T_NEXT_OUTPUT: Final = 5
T_GNSS: Final = 6  # last position fused
T_NEXT_COVARIANCE: Final = 7
T_REJECTED: Final = 8  # first of a run of refused positions that agree
I_REJECTED: Final = 9  # length of that run, 0 if none
I_RESETS: Final = 10  # position resets since the last fused position
I_BLOCK: Final = 11  # samples in the open block
I_BLOCKS: Final = 12  # such rows since start or gap
I_GNSS_USED: Final = 13  # since the last output row
I_STATIONARY: Final = 14
T_REFUSED: Final = 15  # newest of a run of refused positions, whether they agree or not
I_REFUSED: Final = 16  # length of that run, 0 if none
T_DECAY: Final = 17  # slowly varying GNSS error is valid at
T_QUIET: Final = 18  # since then the vehicle has felt as if it stood, 0 if not
I_RECORDS: Final = 19  # rows written in this call
I_NODES: Final = 20  # likewise
T_BROKEN: Final = 21  # since the last fused position, ns, where the position was reset at this instant, else 0
I_HANGS: Final = 22  # the receiver repeats its last fix although the vehicle moved
T_READING: Final = 23  # last wheel speed
T_REPEATED: Final = 24  # first of a run of equal ones
T_ANCHOR: Final = 25  # of that earlier fix, 0 without one
T_BIAS: Final = 26  # last whole second at which the biases were looked at, 0 before
T_REFUSED_FOR: Final = 27  # how long that run has lasted, ns, without outages
I_REFUSED_V: Final = 28  # velocities refused in a row
I_COUNTS: Final = 29  # how often each aid had each outcome, len(AIDS) rows of len(OUTCOMES)

# Aids and outcomes, the axes of the counters.
AIDS: Final = (
    "imu",
    "gnss_position",
    "gnss_height",
    "gnss_velocity",
    "nhc",
    "zupt",
    "zaru",
    "speed",
    "magnetometer",
    "barometer",
)
OUTCOMES: Final = ("fused", "rejected_gate", "rejected_time", "rejected_range", "reset")
(A_IMU, A_POSITION, A_HEIGHT, A_VELOCITY, A_NHC, A_ZUPT, A_ZARU, A_SPEED, A_MAGNETOMETER, A_BAROMETER) = range(
    len(AIDS)
)
FUSED, REJECTED_GATE, REJECTED_TIME, REJECTED_RANGE, RESET = range(len(OUTCOMES))
NT: Final = I_COUNTS + len(AIDS) * len(OUTCOMES)

# Rows of aids, merged by time: the kind, then its values.
K_GNSS, K_SPEED, K_MAGNETIC, K_BARO = range(4)
AID_WIDTH: Final = 1 + len(GNSS_COLUMNS)
"""A fix is the longest: its columns follow the kind. Speed: m/s; field: uT in b, 3; barometer: height, m."""
