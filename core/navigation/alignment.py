"""Initial alignment: level and gyroscope bias at rest, heading from the magnetometer or from motion.

At rest, roll and pitch come from the accelerometers and the azimuth from the tilt-compensated
magnetometer (seed 1, eq. 13-17; eq. 14 misprints acc as mag). Without one, or when the drive begins in
motion, the gyroscopes carry a heading of unknown zero along, and GNSS velocities (or the chords between
positions) turned back by it all point the same way: that way is the heading at the start.

Everything is decided at whole seconds from what lies before them, so that packets do not matter.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import IntEnum
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from core.earth import STANDARD_GRAVITY_MPS2, ned_offset_m, radii_m
from core.measurements import GNSS, FloatArray, TimeArray
from core.navigation.admission import position_sd_m
from core.navigation.tuning import Tuning
from core.rotation import matrix_from_rpy, quaternion_from_matrix

SECOND_NS = 1_000_000_000
MAX_GAP_S = 0.5
"""A longer hole in the samples ends what has been learnt: the turn within it is unknown."""
FIX_MAX_AGE_S = 2.0
"""An older fix does not say where the vehicle is now."""


class Start(IntEnum):
    """When an alignment may be gone by: it rests on the body axes, which have to be those of the car."""

    NEVER = 0
    IN_MOTION = 1
    AT_REST_TOO = 2


@dataclass(slots=True)
class InitialState:
    """What alignment found, with its spread (of the position: horizontal per axis, and vertical).

    Angles rad, vectors in n or b as named.
    """

    t_ns: int
    lat_rad: float
    lon_rad: float
    alt_m: float
    position_sd_m: tuple[float, float]
    v_n: FloatArray
    velocity_sd_mps: float
    q_n_from_b: FloatArray
    tilt_sd_rad: float
    yaw_sd_rad: float
    gyro_bias_radps: FloatArray
    gyro_bias_sd_radps: float


TimeOrTimes = TypeVar("TimeOrTimes", np.int64, TimeArray)


def next_second_ns(t_ns: TimeOrTimes) -> TimeOrTimes:
    """The first whole second after a time (or each of an array), ns: when what came before is evaluated."""
    return (t_ns // SECOND_NS + 1) * SECOND_NS


def level(f_b: FloatArray) -> tuple[float, float]:
    """Roll and pitch (rad) that make a mean specific force (3,) point up: seed 1, eq. 13-14."""
    return math.atan2(-f_b[1], -f_b[2]), math.atan2(f_b[0], math.hypot(f_b[1], f_b[2]))


def magnetic_azimuth(m_b: FloatArray, roll_rad: float, pitch_rad: float) -> float:
    """Heading (rad) from magnetic north of a field (3,) in b, by levelling it: seed 1, eq. 15-17."""
    levelled = matrix_from_rpy(roll_rad, pitch_rad, 0.0) @ m_b
    return math.atan2(-levelled[1], levelled[0])


@dataclass(slots=True)
class _Second:
    """One second of samples, reduced: its means, and whether weighted means each 0.1 s hardly differ."""

    mean_f: FloatArray
    mean_w: FloatArray
    still: bool


@dataclass(frozen=True, slots=True)
class _Level:
    """Gravity as the box feels it, with the spread of its direction, and what the gyroscopes read of no turn."""

    force_b: FloatArray
    tilt_sd_rad: float
    gyro_bias_radps: FloatArray
    gyro_bias_sd_radps: float


@dataclass(frozen=True, slots=True)
class _Moves:
    """Horizontal moves in n, (n, 2), that all point where the vehicle went at ``t_ns``, with its velocities then.

    ``sum_sd`` is the sd of their coherent sum, ``tilt_sd_rad`` that of a level found by their accelerations.
    """

    t_ns: TimeArray
    move_n: FloatArray
    v_n: FloatArray
    sum_sd: float
    tilt_sd_rad: float


@dataclass(slots=True)
class Aligner:
    """Collects samples until position, level and heading are known. State is its arrays."""

    tuning: Tuning
    imu_t_ns: TimeArray = field(default_factory=lambda: np.empty(0, np.int64))
    imu: FloatArray = field(default_factory=lambda: np.empty((0, 6)))
    gnss_t_ns: TimeArray = field(default_factory=lambda: np.empty(0, np.int64))
    gnss: FloatArray = field(default_factory=lambda: np.empty((0, len(GNSS))))
    magnetic_t_ns: TimeArray = field(default_factory=lambda: np.empty(0, np.int64))
    magnetic_b_ut: FloatArray = field(default_factory=lambda: np.empty((0, 3)))
    speed_t_ns: TimeArray = field(default_factory=lambda: np.empty(0, np.int64))
    speed_mps: FloatArray = field(default_factory=lambda: np.empty(0))
    # Rest that was seen: weight in seconds, mean f (3), mean w (3), time of its end.
    rest: FloatArray = field(default_factory=lambda: np.zeros(7))
    rest_end_ns: npt.NDArray[np.int64] = field(default_factory=lambda: np.zeros(1, np.int64))

    KEEP_MOVING_S = 30.0
    """Samples kept since the vehicle stood, for the heading to be found in."""

    def arrays(self) -> dict[str, npt.NDArray[np.generic]]:
        """State by name, for snapshots."""
        names = [n for n in self.__slots__ if n != "tuning"]
        return {name: getattr(self, name) for name in names}

    def load(self, arrays: dict[str, npt.NDArray[np.generic]]) -> None:
        """Take over what ``arrays`` gave."""
        for name, value in arrays.items():
            setattr(self, name, value)

    def add_imu(self, t_ns: TimeArray, f_b: FloatArray, omega_b: FloatArray) -> None:
        """Samples before the next evaluation, in order."""
        self.imu_t_ns = np.concatenate([self.imu_t_ns, t_ns])
        self.imu = np.concatenate([self.imu, np.hstack([f_b, omega_b])])

    def add_aids(
        self,
        gnss: tuple[TimeArray, FloatArray],
        magnetic: tuple[TimeArray, FloatArray],
        speed: tuple[TimeArray, FloatArray],
    ) -> None:
        """Usable aids before the next evaluation, in order."""
        self.gnss_t_ns = np.concatenate([self.gnss_t_ns, gnss[0]])
        self.gnss = np.concatenate([self.gnss, gnss[1]])
        self.magnetic_t_ns = np.concatenate([self.magnetic_t_ns, magnetic[0]])
        self.magnetic_b_ut = np.concatenate([self.magnetic_b_ut, magnetic[1]])
        self.speed_t_ns = np.concatenate([self.speed_t_ns, speed[0]])
        self.speed_mps = np.concatenate([self.speed_mps, speed[1]])

    def forget(self) -> None:
        """Drop everything learnt: the samples have a hole."""
        fresh = Aligner(self.tuning)
        self.load(fresh.arrays())

    def turn(self, C_new_from_old: FloatArray) -> None:
        """Turn all that was learnt into other body axes."""
        for rows in (self.imu[:, :3], self.imu[:, 3:], self.magnetic_b_ut, self.rest[None, 1:4], self.rest[None, 4:7]):
            rows[:] = turned(rows, C_new_from_old)

    def evaluate(self, t_ns: int, start: Start = Start.AT_REST_TOO) -> InitialState | None:
        """What is known at ``t_ns`` (a whole second) from the samples before it; None if not enough, or not wanted."""
        holes = np.flatnonzero(np.diff(self.imu_t_ns) > MAX_GAP_S * 1e9)
        if len(holes):
            cut = int(holes[-1]) + 1
            self.rest[:] = 0.0
            self.imu_t_ns, self.imu = self.imu_t_ns[cut:], self.imu[cut:]
        second = self._reduce(t_ns)
        if second is not None and second.still and not self._aids_move(t_ns) and self._is_as_at_rest(second):
            self._add_rest(second, t_ns)
            found = self._at_rest(t_ns) if start >= Start.AT_REST_TOO else None
        else:
            found = self._in_motion(t_ns) if start >= Start.IN_MOTION else None
        self._trim(t_ns)
        return found

    # What the samples say.

    def _reduce(self, t_ns: int) -> _Second | None:
        inside = self.imu_t_ns >= t_ns - SECOND_NS
        samples = self.imu[inside]
        tenths = (self.imu_t_ns[inside] - (t_ns - SECOND_NS)) / (SECOND_NS // 10)
        block = tenths.astype(np.int64)
        if np.bincount(block, minlength=10).min() == 0:
            return None
        # Hats of 0.2 s: of an engine's shaking at 27 Hz they leave a hundredth, where plain means leave a tenth.
        rise = tenths - block
        means = np.stack(
            [
                np.bincount(block, samples[:, i] * (1.0 - rise), minlength=11)
                + np.bincount(block + 1, samples[:, i] * rise, minlength=11)
                for i in range(6)
            ],
            axis=1,
        )
        weight = np.bincount(block, 1.0 - rise, minlength=11) + np.bincount(block + 1, rise, minlength=11)
        means = means[1:10] / weight[1:10, None]
        still_f = means[:, :3].var(axis=0).sum() <= self.tuning.still_accel_sd_mps2**2
        still_w = means[:, 3:].var(axis=0).sum() <= self.tuning.still_gyro_sd_radps**2
        return _Second(samples[:, :3].mean(axis=0), samples[:, 3:].mean(axis=0), bool(still_f and still_w))

    def _aids_move(self, t_ns: int) -> bool:
        """Whether wheel or GNSS say that the vehicle moves although the box feels nothing."""
        limit = self.tuning.still_max_speed_mps
        wheel = self.speed_mps[self.speed_t_ns >= t_ns - SECOND_NS]
        if wheel.size:
            return bool(wheel.max() > limit)
        recent = self.gnss[self.gnss_t_ns >= t_ns - 2 * SECOND_NS]
        if not len(recent):
            return False
        v = fix_velocity(recent[-1])
        if v is not None:
            return math.hypot(v[0], v[1]) > limit
        moved = offsets_m(recent)[-1]
        return math.hypot(moved[0], moved[1]) > 2.0 * self.fix_sd_m(recent[-1])[0]

    def _is_as_at_rest(self, second: _Second) -> bool:
        """Whether a quiet second feels what the rest before it felt: pulling away evenly is quiet too."""
        rested = self.rest[0] >= self.tuning.align_still_s
        change = float(np.linalg.norm(second.mean_f - self.rest[1:4]))
        return not rested or change <= self.tuning.still_mean_accel_mps2

    def _add_rest(self, second: _Second, t_ns: int) -> None:
        if self.rest_end_ns[0] != t_ns - SECOND_NS:
            self.rest[:] = 0.0
        weight = min(self.rest[0], 60.0)
        self.rest[1:4] = (self.rest[1:4] * weight + second.mean_f) / (weight + 1.0)
        self.rest[4:7] = (self.rest[4:7] * weight + second.mean_w) / (weight + 1.0)
        self.rest[0] += 1.0
        self.rest_end_ns[0] = t_ns

    def _trim(self, t_ns: int) -> None:
        """Keep what the next evaluation may need: from the end of the rest, or the moving window."""
        rested = self.rest[0] >= self.tuning.align_still_s
        keep_s = self.KEEP_MOVING_S if rested else self.tuning.align_moving_s
        start = max(t_ns - int(keep_s * 1e9), int(self.rest_end_ns[0]) if rested else 0)
        if rested and self.rest_end_ns[0] < t_ns - int(self.KEEP_MOVING_S * 1e9):
            self.rest[:] = 0.0  # carried too long: the gyroscopes' heading has drifted away
        for times, rows in (("imu_t_ns", "imu"), ("magnetic_t_ns", "magnetic_b_ut"), ("speed_t_ns", "speed_mps")):
            kept = getattr(self, times) >= start
            setattr(self, rows, getattr(self, rows)[kept])
            setattr(self, times, getattr(self, times)[kept])
        kept = self.gnss_t_ns >= min(start, t_ns - int(FIX_MAX_AGE_S * 1e9))
        self.gnss_t_ns, self.gnss = self.gnss_t_ns[kept], self.gnss[kept]

    # The two ways to a heading.

    def _at_rest(self, t_ns: int) -> InitialState | None:
        if self.rest[0] < self.tuning.align_still_s or not self._has_fix(t_ns):
            return None
        recent = self.magnetic_b_ut[self.magnetic_t_ns >= t_ns - 2 * SECOND_NS]
        if not len(recent):
            return None
        field_b = recent.mean(axis=0)
        if not 20.0 <= float(np.linalg.norm(field_b)) <= 75.0:
            return None  # the Earth's field is 22-67 uT: this is the car's iron
        felt = self._rest_level()
        if not self._is_gravity(felt.force_b):
            return None
        roll, pitch = level(felt.force_b)
        yaw = magnetic_azimuth(field_b, roll, pitch)
        attitude = matrix_from_rpy(roll, pitch, yaw)
        return self._state(t_ns, attitude, np.zeros(3), 0.1, self.tuning.align_magnetic_sd_rad, felt)

    def _in_motion(self, t_ns: int) -> InitialState | None:
        if not self._has_fix(t_ns) or not len(self.imu_t_ns):
            return None
        rested = self.rest[0] >= self.tuning.align_still_s
        start_ns = int(self.rest_end_ns[0]) if rested else t_ns - int(self.tuning.align_moving_s * 1e9)
        if self.imu_t_ns[0] > start_ns + SECOND_NS // 10:
            return None
        inside = self.imu_t_ns >= start_ns
        times, samples = self.imu_t_ns[inside], self.imu[inside]
        if len(times) < 10:
            return None
        moves = self._moves(start_ns)
        if moves is None:
            return None
        move_t_ns, move_n, move_sd = moves.t_ns, moves.move_n, moves.sum_sd

        felt = self._rest_level() if rested else self._motion_level(times, samples, moves)
        if not self._is_gravity(felt.force_b):
            return None
        bias = felt.gyro_bias_radps
        roll, pitch = level(felt.force_b)
        rotations = _integrate(times, samples[:, 3:] - bias, matrix_from_rpy(roll, pitch, 0.0))
        headings = np.arctan2(rotations[:, 1, 0], rotations[:, 0, 0])
        at_move = np.interp(move_t_ns, times, np.unwrap(headings))
        pointer = np.sum((move_n[:, 0] + 1j * move_n[:, 1]) * np.exp(-1j * at_move))
        yaw_sd = move_sd / max(abs(pointer), 1e-9)
        if yaw_sd > self.tuning.align_max_yaw_sd_rad:
            return None
        zero = float(np.angle(pointer))
        c_n_from_b = matrix_from_rpy(0.0, 0.0, zero) @ rotations[-1]
        v_n, velocity_sd = self._velocity(t_ns, c_n_from_b)
        if math.hypot(v_n[0], v_n[1]) < self.tuning.align_min_speed_mps:
            return None
        return self._state(t_ns, c_n_from_b, v_n, velocity_sd, max(yaw_sd, 0.03), felt)

    def _moves(self, start_ns: int) -> _Moves | None:
        """GNSS velocities where the receiver gives them, else chords between successive positions."""
        inside = self.gnss_t_ns >= start_ns
        times, fixes = self.gnss_t_ns[inside], self.gnss[inside]
        if len(times) < 2:
            return None
        velocities = [fix_velocity(fix) for fix in fixes]
        fast = [i for i, v in enumerate(velocities) if v is not None and math.hypot(v[0], v[1]) >= 1.0]
        if fast:
            sd = [fixes[i, GNSS["sd_v_mps"]] for i in fast]
            worst = float(np.nanmax(sd)) if np.isfinite(sd).any() else self.tuning.gnss_sd_v_mps
            # Errors of successive velocities are far from independent: three are worth one.
            moves = np.array([velocities[i] for i in fast], dtype=float)[:, :2]
            sum_sd = max(worst, self.tuning.gnss_sd_v_mps) * math.sqrt(3.0 * len(fast))
            return _Moves(times[fast], moves, moves, sum_sd, self.tuning.align_tilt_moving_sd_rad)
        chords = np.diff(offsets_m(fixes), axis=0)
        sd_m, _ = self.fix_sd_m(fixes[-1])
        # The sum of the chords is the last position minus the first.
        return _Moves(
            (times[1:] + times[:-1]) // 2,
            chords,
            chords / (np.diff(times) * 1e-9)[:, None],
            1.5 * sd_m,
            self.tuning.align_tilt_unsure_sd_rad,
        )

    def _rest_level(self) -> _Level:
        """From the rest that was seen."""
        t = self.tuning
        bias_sd = max(t.zaru_sd_radps / math.sqrt(max(self.rest[0], 1.0)), 1e-6)
        return _Level(self.rest[1:4].copy(), t.align_tilt_still_sd_rad, self.rest[4:7].copy(), bias_sd)

    def _is_gravity(self, force_b: FloatArray) -> bool:
        """Whether a mean force can be gravity, as felt; what is not comes of damaged samples or a crash."""
        off_mps2 = float(np.linalg.norm(force_b)) - STANDARD_GRAVITY_MPS2
        return abs(off_mps2) <= self.tuning.align_gravity_mps2

    def _motion_level(self, times: TimeArray, samples: FloatArray, moves: _Moves) -> _Level:
        """From a stretch in motion: gravity is what kinematics leaves of the mean force."""
        speed = np.hypot(moves.v_n[:, 0], moves.v_n[:, 1])
        seconds = (moves.t_ns - moves.t_ns[0]) * 1e-9
        bias, mean = np.zeros(3), samples.mean(axis=0)
        forward, rate, tilt_sd = 0.0, float(mean[5]), self.tuning.align_tilt_unsure_sd_rad
        if len(seconds) >= 4 and seconds[-1] > 0.6 * self.tuning.align_moving_s and speed.min() > 1.0:
            course = np.unwrap(np.arctan2(moves.v_n[:, 1], moves.v_n[:, 0]))
            rate = float(np.polyfit(seconds, course, 1)[0])
            forward = float(np.polyfit(seconds, speed, 1)[0])
            tilt_sd = moves.tilt_sd_rad
            if self._has_velocity():
                covered = (times >= moves.t_ns[0]) & (times <= moves.t_ns[-1])
                bias[2] = float(samples[covered, 5].mean()) - rate
        force = mean[:3] - np.array([forward, float(speed.mean()) * rate, 0.0])
        return _Level(force, tilt_sd, bias, self.tuning.align_gyro_bias_moving_sd_radps)

    def _has_velocity(self) -> bool:
        return len(self.gnss) > 0 and fix_velocity(self.gnss[-1]) is not None

    # Position and velocity at the end.

    def _has_fix(self, t_ns: int) -> bool:
        return len(self.gnss_t_ns) > 0 and t_ns - self.gnss_t_ns[-1] <= FIX_MAX_AGE_S * 1e9

    def fix_sd_m(self, fix: FloatArray) -> tuple[float, float]:
        """Horizontal (per axis) and vertical sd of a GNSS row, m."""
        return position_sd_m(fix, self.tuning.as_array())

    def _velocity(self, t_ns: int, c_n_from_b: FloatArray) -> tuple[FloatArray, float]:
        wheel = self.speed_mps[self.speed_t_ns >= t_ns - SECOND_NS]
        velocity = fix_velocity(self.gnss[-1])
        if velocity is not None:
            v_n = np.array([velocity[0], velocity[1], velocity[2] if math.isfinite(velocity[2]) else 0.0])
            return v_n, 0.5 + 2.0 * (t_ns - int(self.gnss_t_ns[-1])) * 1e-9
        if wheel.size:
            return c_n_from_b[:, 0] * float(wheel[-1]), 1.0
        moved = offsets_m(self.gnss[-3:])[-1]
        span = (self.gnss_t_ns[-1] - self.gnss_t_ns[-3:][0]) * 1e-9
        return (np.array([moved[0], moved[1], 0.0]) / span if span > 0 else np.zeros(3)), 2.0

    def _state(
        self,
        t_ns: int,
        c_n_from_b: FloatArray,
        v_n: FloatArray,
        velocity_sd: float,
        yaw_sd: float,
        felt: _Level,
    ) -> InitialState:
        fix = self.gnss[-1]
        sd_h_m, sd_v_m = self.fix_sd_m(fix)
        age_s = (t_ns - int(self.gnss_t_ns[-1])) * 1e-9
        lat, lon = float(fix[GNSS["lat_rad"]]), float(fix[GNSS["lon_rad"]])
        meridian, transverse = radii_m(lat)
        alt = float(fix[GNSS["alt_m"]]) if math.isfinite(fix[GNSS["alt_m"]]) else 0.0
        return InitialState(
            t_ns=t_ns,
            lat_rad=lat + v_n[0] * age_s / meridian,
            lon_rad=lon + v_n[1] * age_s / (transverse * math.cos(lat)),
            alt_m=alt,
            position_sd_m=(sd_h_m + velocity_sd * age_s, sd_v_m + velocity_sd * age_s),
            v_n=v_n,
            velocity_sd_mps=velocity_sd,
            q_n_from_b=quaternion_from_matrix(c_n_from_b),
            tilt_sd_rad=felt.tilt_sd_rad,
            yaw_sd_rad=yaw_sd,
            gyro_bias_radps=felt.gyro_bias_radps,
            gyro_bias_sd_radps=felt.gyro_bias_sd_radps,
        )


def turned(rows: FloatArray, C_new_from_old: FloatArray) -> FloatArray:
    """Vectors (n, 3) in other axes, each by the same operations however many there are."""
    x, y, z = rows[:, 0], rows[:, 1], rows[:, 2]
    return np.stack([c[0] * x + c[1] * y + c[2] * z for c in C_new_from_old], axis=1)


def fix_velocity(fix: FloatArray) -> tuple[float, float, float] | None:
    """Velocity (n, e, d) of a GNSS row, m/s; d may be NaN; None if the receiver gives none."""
    if math.isfinite(fix[GNSS["vn_mps"]]) and math.isfinite(fix[GNSS["ve_mps"]]):
        return float(fix[GNSS["vn_mps"]]), float(fix[GNSS["ve_mps"]]), float(fix[GNSS["vd_mps"]])
    speed, course = fix[GNSS["speed_mps"]], fix[GNSS["course_rad"]]
    if math.isfinite(speed) and math.isfinite(course):
        return float(speed * math.cos(course)), float(speed * math.sin(course)), math.nan
    return None


def offsets_m(fixes: FloatArray) -> FloatArray:
    """North and east (n, 2) of GNSS rows against the first of them, m."""
    lat, lon = fixes[:, GNSS["lat_rad"]], fixes[:, GNSS["lon_rad"]]
    return ned_offset_m(lat, lon, np.zeros(len(lat)), (float(lat[0]), float(lon[0]), 0.0))[:, :2]


def _integrate(times: TimeArray, omega_b: FloatArray, start: FloatArray) -> FloatArray:
    """Rotations (n, 3, 3) from b at each instant, ``start`` (3, 3) at the first; trapezoid, small angles."""
    rotations = np.empty((len(times), 3, 3))
    c = start.copy()
    rotations[0] = c
    for k in range(1, len(times)):
        a = 0.5 * (omega_b[k - 1] + omega_b[k]) * (times[k] - times[k - 1]) * 1e-9
        skew = np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])
        c = c @ (np.eye(3) + skew + 0.5 * skew @ skew)
        rotations[k] = c
    return rotations
