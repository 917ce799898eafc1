"""The navigation filter of one vehicle: aligns, then folds samples and aids into a track.

The work is in ``kernel.run``; here is what surrounds it: aids that wait for their sample, the change
between aligning and navigating, snapshots.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from core.measurements import GNSS, FloatArray, TimeArray
from core.navigation import kernel, state
from core.navigation.admission import timely, usable_fields, usable_fixes, usable_speeds
from core.navigation.alignment import SECOND_NS, Aligner, InitialState, next_second_ns
from core.navigation.mechanization import normalised, renew_mounting, start_frame
from core.navigation.track import TRACK, TRACK_COLUMNS, Mode, Track
from core.navigation.tuning import Tuning
from core.rotation import matrix_from_quaternion

Series = tuple[TimeArray, FloatArray]

_AID_OF_SERIES: Final = (state.A_POSITION, state.A_MAGNETOMETER, state.A_SPEED)
"""Rows of the counters for the series of ``Aids``, in their order."""


@dataclass(frozen=True, slots=True, eq=False)
class Aids:
    """Samples in body axes besides the inertial ones: each a pair of times (n,) and rows."""

    gnss: Series
    magnetic_b_ut: Series
    speed: Series


@dataclass(frozen=True, slots=True, eq=False)
class FilterOutput:
    """Track rows, and at each inertial sample down in b (3) and horizontal speed: (n, 4), NaN while aligning."""

    track: Track
    epochs: FloatArray


def _empty_rows(columns: int) -> FloatArray:
    return np.empty((0, columns))


@dataclass(frozen=True, slots=True)
class FilterConfig:
    """Set once: tunables, places of sensor and antenna in the body (m), and which constraints hold."""

    tuning: Tuning = field(default_factory=Tuning)
    imu_lever_b_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    antenna_lever_b_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    mount_angle_sd_rad: float | None = None
    """Spread of the mounting left after calibration; None takes the tunable's."""
    non_holonomic: bool = True
    zero_velocity: bool = True


class NavigationFilter:
    """INS/GNSS error-state filter; see ``state`` for its states and ``kernel`` for its loop."""

    def __init__(self, config: FilterConfig) -> None:
        self.config = config
        self._par = config.tuning.as_array()
        self._switches = (kernel.USE_NHC if config.non_holonomic else 0) | (
            kernel.USE_ZUPT if config.zero_velocity else 0
        )
        self._imu_lever = np.array(config.imu_lever_b_m, dtype=float)
        self._antenna_lever = np.array(config.antenna_lever_b_m, dtype=float) - self._imu_lever
        self.x = np.zeros(state.NX)
        self.ti = np.zeros(state.NT, np.int64)
        self.p = np.zeros(state.N_STATES**2)
        self._scratch = np.zeros(kernel.SCRATCH)
        self.ring = np.zeros(6 * state.N_BLOCKS)
        self.counts = np.zeros((len(state.AIDS), len(state.OUTCOMES)), np.int64)
        self._aligned = np.zeros(1, np.bool_)
        self._known = np.zeros(1, np.bool_)  # biases and mounting were estimated before
        self._evaluation_ns = np.zeros(1, np.int64)
        self._newest_aid_ns = np.zeros(len(_AID_OF_SERIES), np.int64)
        self._aligner = Aligner(config.tuning)
        self._waiting = Aids(*_no_aids())

    @property
    def aligned(self) -> bool:
        """Whether attitude and position are known."""
        return bool(self._aligned[0])

    @property
    def t_ns(self) -> int:
        """Time of the newest sample taken in; 0 before the first."""
        return int(self.ti[state.T_NOW])

    def covariance(self) -> FloatArray:
        """Covariance of the error states, (N_STATES, N_STATES)."""
        return self.p.reshape(state.N_STATES, state.N_STATES).copy()

    def step(
        self, imu_t_ns: TimeArray, f_b: FloatArray, omega_b: FloatArray, saturated: FloatArray, aids: Aids
    ) -> FilterOutput:
        """Fold samples in. Aids later than the last sample wait for the next call.

        Parameters
        ----------
        imu_t_ns : (n,) int64, increasing
        f_b, omega_b : (n, 3) calibrated specific force (m/s2) and rate (rad/s) in body axes
        saturated : (n,) 1 where the accelerometer read its full scale
        aids : GNSS, magnetometer and wheel speed of the same span
        """
        self._admit(imu_t_ns, aids)
        epochs = np.full((len(imu_t_ns), 4), np.nan)
        rows: list[Track] = []
        begin = 0
        while begin < len(imu_t_ns):
            if self.aligned:
                used, track = self._navigate(
                    imu_t_ns[begin:], f_b[begin:], omega_b[begin:], saturated[begin:], epochs[begin:]
                )
            else:
                used, track = self._align(imu_t_ns[begin:], f_b[begin:], omega_b[begin:])
            begin += used
            if len(track.t_ns):
                rows.append(track)
        if not rows:
            return FilterOutput(Track(np.empty(0, np.int64), _empty_rows(len(TRACK_COLUMNS))), epochs)
        if len(rows) == 1:
            return FilterOutput(rows[0], epochs)
        joined = Track(np.concatenate([r.t_ns for r in rows]), np.concatenate([r.values for r in rows]))
        return FilterOutput(joined, epochs)

    # Aids

    def _admit(self, imu_t_ns: TimeArray, aids: Aids) -> None:
        """Let those aids wait for their sample that can be used."""
        new = (aids.gnss, aids.magnetic_b_ut, aids.speed)
        waiting = [self._waiting.gnss, self._waiting.magnetic_b_ut, self._waiting.speed]
        usable = (
            lambda rows: usable_fixes(rows, self._par),
            usable_fields,
            usable_speeds,
        )
        for kind, (t_ns, rows) in enumerate(new):
            if not len(t_ns):
                continue
            in_time, newest_ns = timely(
                t_ns, imu_t_ns, self.t_ns, int(self._newest_aid_ns[kind]), self.config.tuning.max_gap_s
            )
            in_range = usable[kind](rows)
            kept = in_time & in_range
            self._newest_aid_ns[kind] = newest_ns
            self.counts[_AID_OF_SERIES[kind], state.REJECTED_TIME] += np.count_nonzero(~in_time)
            self.counts[_AID_OF_SERIES[kind], state.REJECTED_RANGE] += np.count_nonzero(in_time & ~in_range)
            old_t_ns, old_rows = waiting[kind]
            waiting[kind] = np.concatenate([old_t_ns, t_ns[kept]]), np.concatenate([old_rows, rows[kept]])
        self._waiting = Aids(*waiting)

    # Navigating

    def _navigate(
        self, t_ns: TimeArray, f_b: FloatArray, omega_b: FloatArray, saturated: FloatArray, epochs: FloatArray
    ) -> tuple[int, Track]:
        interval_ns = round(self.config.tuning.output_interval_s * 1e9)
        span_ns = int(t_ns[-1]) - self.t_ns
        capacity = len(t_ns) if interval_ns == 0 else min(len(t_ns), max(span_ns, 0) // interval_ns + 2)
        out_t, out = np.empty(capacity, np.int64), np.empty((capacity, len(TRACK_COLUMNS)))
        gnss_t, gnss = self._waiting.gnss
        speed_t, speed = self._waiting.speed
        used, used_gnss, used_speed, n_rows, stopped = kernel.run(
            *self.kernel_arguments(t_ns, f_b, omega_b, saturated, (gnss_t, gnss), (speed_t, speed), epochs, out_t, out)
        )
        magnetic_t, magnetic = self._waiting.magnetic_b_ut
        later = magnetic_t > self.t_ns
        self._waiting = Aids(
            (gnss_t[used_gnss:], gnss[used_gnss:]),
            (magnetic_t[later], magnetic[later]),
            (speed_t[used_speed:], speed[used_speed:]),
        )
        if stopped != kernel.STOPPED_END:
            self._aligned[0] = False
            # What led astray may be the very biases and angles.
            self._known[0] = stopped == kernel.STOPPED_GAP
            self.counts[state.A_IMU, state.RESET] += 1
            self._aligner.forget()
            self._evaluation_ns[0] = 0
        return used, Track(out_t[:n_rows], out[:n_rows])

    def kernel_arguments(
        self,
        t_ns: TimeArray,
        f_b: FloatArray,
        omega_b: FloatArray,
        saturated: FloatArray,
        gnss: Series,
        speed: Series,
        epochs: FloatArray,
        out_t_ns: TimeArray,
        out: FloatArray,
    ) -> tuple[Any, ...]:
        """The state and these samples in the order of ``kernel.run``."""
        return (
            self.x, self.ti, self.p, self.ring, self._scratch, self._par,
            self._switches, self._imu_lever, self._antenna_lever,
            t_ns, f_b, omega_b, saturated, *gnss, *speed, epochs, out_t_ns, out, self.counts,
        )  # fmt: skip

    # Aligning

    def _align(self, t_ns: TimeArray, f_b: FloatArray, omega_b: FloatArray) -> tuple[int, Track]:
        """Collect samples up to the next whole second, and evaluate once a sample beyond it has come."""
        late = int(np.searchsorted(t_ns, self.t_ns, side="right"))
        if late:
            self.counts[state.A_IMU, state.REJECTED_TIME] += late
            return late, _no_track()
        if self._evaluation_ns[0] == 0:
            self._evaluation_ns[0] = next_second_ns(t_ns[0])
        boundary = int(self._evaluation_ns[0])
        before = int(np.searchsorted(t_ns, boundary))
        if before:
            self._aligner.add_imu(t_ns[:before], f_b[:before], omega_b[:before])
            self.ti[state.T_NOW] = t_ns[before - 1]
            self.x[state.X_F : state.X_F + 3], self.x[state.X_W : state.X_W + 3] = f_b[before - 1], omega_b[before - 1]
        if before == len(t_ns):
            return before, _no_track()
        self._hand_aids_over(boundary)
        found = self._aligner.evaluate(boundary)
        row = self._aligning_row(boundary)
        self._evaluation_ns[0] = next_second_ns(t_ns[before])
        if found is not None:
            self._start(found)
        return before, row

    def _hand_aids_over(self, boundary: int) -> None:
        parts, rest = [], []
        for times, rows in (self._waiting.gnss, self._waiting.magnetic_b_ut, self._waiting.speed):
            cut = int(np.searchsorted(times, boundary))
            parts.append((times[:cut], rows[:cut]))
            rest.append((times[cut:], rows[cut:]))
        self._aligner.add_aids(*parts)
        self._waiting = Aids(*rest)

    def _aligning_row(self, boundary: int) -> Track:
        """Where GNSS alone puts the vehicle, for those who watch while the filter aligns."""
        gnss_t, gnss = self._aligner.gnss_t_ns, self._aligner.gnss
        recent = gnss_t >= boundary - SECOND_NS
        if not recent.any():
            return _no_track()
        fix = gnss[recent][-1]
        row = np.full((1, len(TRACK_COLUMNS)), np.nan)
        for name in ("lat_rad", "lon_rad", "alt_m", "vn_mps", "ve_mps", "vd_mps"):
            row[0, TRACK[name]] = fix[GNSS[name]]
        sd_h_m, sd_v_m = self._aligner.fix_sd_m(fix)
        row[0, TRACK["sd_n_m"]] = row[0, TRACK["sd_e_m"]] = sd_h_m
        row[0, TRACK["sd_d_m"]] = sd_v_m
        row[0, TRACK["cov_ne_m2"]] = 0.0
        row[0, TRACK["gnss_used"]] = 1.0
        row[0, TRACK["mode"]] = Mode.ALIGNING
        return Track(gnss_t[recent][-1:], row)

    def _start(self, found: InitialState) -> None:
        """Set the state from an alignment; what was known of biases and mounting is kept."""
        x, t = self.x, self.config.tuning
        n = state.N_STATES
        kept = self.covariance() if self._known[0] else None
        bias_before = x[state.X_BG : state.X_BG + 3].copy()
        x[state.X_Q : state.X_Q + 4] = normalised(found.q_n_from_b)
        x[state.X_V : state.X_V + 3] = found.v_n
        x[state.X_LAT], x[state.X_LON], x[state.X_ALT] = found.lat_rad, found.lon_rad, found.alt_m
        x[state.X_DV : state.X_DV + 3] = 0.0
        x[state.X_BLOCK : state.X_STILL_F] = 0.0
        self.ti[:] = 0
        self.ti[state.T_NOW] = self.ti[state.T_COV] = self.ti[state.T_GNSS] = found.t_ns - 1
        # The first sample at or after the second opens every grid.
        self.ti[state.T_NEXT_BLOCK] = self.ti[state.T_NEXT_CONSTRAINT] = self.ti[state.T_NEXT_OUTPUT] = found.t_ns
        self.ring[:] = 0.0
        start_frame(x, self.ti)
        x[state.X_C0 : state.X_C0 + 9] = matrix_from_quaternion(x[state.X_Q : state.X_Q + 4]).reshape(9)

        sd = np.empty(n)
        sd[state.POS : state.POS + 2], sd[state.POS + 2] = found.position_sd_m
        sd[state.VEL : state.VEL + 3] = found.velocity_sd_mps
        sd[state.ATT : state.ATT + 2] = found.tilt_sd_rad
        sd[state.ATT + 2] = found.yaw_sd_rad
        sd[state.GYRO_BIAS : state.GYRO_BIAS + 3] = found.gyro_bias_sd_radps
        sd[state.ACCEL_BIAS : state.ACCEL_BIAS + 3] = t.accel_bias_sd_mps2
        sd[state.SPEED_SCALE] = t.speed_scale_sd
        mount = t.mount_angle_sd_rad if self.config.mount_angle_sd_rad is None else self.config.mount_angle_sd_rad
        sd[state.MOUNT_PITCH] = sd[state.MOUNT_YAW] = mount
        p = np.diag(sd * sd)
        x[state.X_BG : state.X_BG + 3] = found.gyro_bias_radps
        if kept is None:
            x[state.X_BA : state.X_BA + 3] = 0.0
            x[state.X_SCALE] = x[state.X_MOUNT_PITCH] = x[state.X_MOUNT_YAW] = 0.0
        else:
            for group in (state.ACCEL_BIAS, state.ACCEL_BIAS + 1, state.ACCEL_BIAS + 2, *range(state.SPEED_SCALE, n)):
                p[group, group] = kept[group, group]
            before = np.diag(kept)[state.GYRO_BIAS : state.GYRO_BIAS + 3]
            if before.max() < found.gyro_bias_sd_radps**2:
                x[state.X_BG : state.X_BG + 3] = bias_before
                for i in range(3):
                    p[state.GYRO_BIAS + i, state.GYRO_BIAS + i] = before[i]
        renew_mounting(x)
        self.p[:] = p.reshape(-1)
        self._aligned[0] = True
        self._aligner.forget()

    # Snapshots

    def arrays(self) -> dict[str, npt.NDArray[np.generic]]:
        """The whole state by name."""
        own: dict[str, npt.NDArray[np.generic]] = {
            name: getattr(self, name)
            for name in ("x", "ti", "p", "ring", "counts", "_aligned", "_known", "_evaluation_ns", "_newest_aid_ns")
        }
        for name in ("gnss", "magnetic_b_ut", "speed"):
            own[f"waiting.{name}.t"], own[f"waiting.{name}.rows"] = getattr(self._waiting, name)
        own.update({f"aligner.{name}": value for name, value in self._aligner.arrays().items()})
        return own

    def load(self, arrays: dict[str, npt.NDArray[np.generic]]) -> None:
        """Take over what ``arrays`` gave."""
        for name in ("x", "ti", "p", "ring", "counts", "_aligned", "_known", "_evaluation_ns", "_newest_aid_ns"):
            setattr(self, name, arrays[name])
        self._waiting = Aids(
            *((arrays[f"waiting.{n}.t"], arrays[f"waiting.{n}.rows"]) for n in ("gnss", "magnetic_b_ut", "speed"))  # type: ignore[arg-type]
        )
        prefix = "aligner."
        self._aligner.load({k[len(prefix) :]: v for k, v in arrays.items() if k.startswith(prefix)})


def _no_track() -> Track:
    return Track(np.empty(0, np.int64), _empty_rows(len(TRACK_COLUMNS)))


def _no_aids() -> tuple[Series, Series, Series]:
    def none() -> TimeArray:
        return np.empty(0, np.int64)

    return (none(), _empty_rows(len(GNSS))), (none(), _empty_rows(3)), (none(), np.empty(0))
