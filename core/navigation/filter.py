"""The navigation filter of one vehicle: aligns, then folds samples and aids into a track.

The work is in ``kernel.run``; here is what surrounds it: aids that wait for their sample or come late, the change
between aligning and navigating, snapshots.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from core.atmosphere import pressure_height_m
from core.measurements import FloatArray, TimeArray
from core.navigation import kernel, state
from core.navigation.admission import (
    thinned,
    timely,
    usable_fields,
    usable_fixes,
    usable_pressures,
    usable_speeds,
)
from core.navigation.aids import AIDS_OF_KIND, Aids, Series, no_series
from core.navigation.alignment import Aligner, InitialState, Start, next_second_ns, turned
from core.navigation.lateness import Recent
from core.navigation.nodes import NODE_WIDTH
from core.navigation.pending import Pending, pending
from core.navigation.recalibration import forget_biases, loosen_biases, shift_biases
from core.navigation.recorder import Recorder
from core.navigation.records import RECORD_COLUMNS, AidRecords
from core.navigation.starting import begin, fix_row
from core.navigation.track import TRACK_COLUMNS, Track, empty_table, joined_tables
from core.navigation.tuning import PARAMETER, Tuning

_RECORDS_A_FIX: Final = 6
_RECORDS_A_CONSTRAINT: Final = 6
"""Most records that a fix (two of position, one of height, three of velocity) and a constraint (standstill) bring."""


@dataclass(frozen=True, slots=True, eq=False)
class FilterOutput:
    """Track rows, and at each inertial sample down in b (3) and horizontal speed: (n, 4), NaN while aligning.

    ``records`` tells of each aid that was compared since the call before; of one that came late, of it alone.
    """

    track: Track
    epochs: FloatArray
    records: AidRecords


@dataclass(frozen=True, slots=True)
class FilterConfig:
    """Set once: tunables, places of sensor and antenna in the body (m), and which constraints hold.

    ``gnss_time_offset_s`` is added to the times of fixes.
    """

    tuning: Tuning = field(default_factory=Tuning)
    imu_lever_b_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    antenna_lever_b_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    gnss_time_offset_s: float = 0.0
    mount_angle_sd_rad: float | None = None
    """Spread of the mounting left after calibration; None takes the tunable's."""
    non_holonomic: bool = True
    zero_velocity: bool = True


class NavigationFilter:
    """INS/GNSS error-state filter; see ``state`` for its states and ``kernel`` for its loop."""

    def __init__(self, config: FilterConfig) -> None:
        self.config = config
        self._par = config.tuning.as_array()
        switches = (kernel.USE_NHC if config.non_holonomic else 0) | (kernel.USE_ZUPT if config.zero_velocity else 0)
        imu_lever = np.array(config.imu_lever_b_m, dtype=float)
        antenna_lever = np.array(config.antenna_lever_b_m, dtype=float) - imu_lever
        self._setup = np.concatenate([imu_lever, antenna_lever, [float(switches)]])
        self._scratch = np.zeros(kernel.SCRATCH)
        self._clear()
        self.recorder: Recorder | None = None
        """Set by post-processing, which wants more than a stream can keep."""
        # Told before each step by who knows the mounting, so no part of the state.
        self.start = Start.AT_REST_TOO
        self.mount_angle_sd_rad = (
            config.tuning.mount_angle_sd_rad if config.mount_angle_sd_rad is None else config.mount_angle_sd_rad
        )

    def _clear(self) -> None:
        self.x = np.zeros(state.NX)
        self.ti = np.zeros(state.NT, np.int64)
        self.p = np.zeros(state.N_STATES**2)
        self._aligned = np.zeros(1, np.bool_)
        self._known = np.zeros(1, np.bool_)  # biases and mounting were estimated before
        self._evaluation_ns = np.zeros(1, np.int64)
        self._newest_aid_ns = np.zeros(len(AIDS_OF_KIND), np.int64)
        self._used_aid_ns = np.zeros(len(AIDS_OF_KIND), np.int64)
        self._aligner = Aligner(self.config.tuning)
        # What was refused or given up outside of the kernel: going back does not undo it.
        self._own_counts = np.zeros((len(state.AIDS), len(state.OUTCOMES)), np.int64)
        self._pending = Pending()
        self._recent = Recent()

    @property
    def aligned(self) -> bool:
        """Whether attitude and position are known."""
        return bool(self._aligned[0])

    @property
    def t_ns(self) -> int:
        """Time of the newest sample taken in; 0 before the first."""
        return int(self.ti[state.T_NOW])

    @property
    def counts(self) -> TimeArray:
        """How often each aid had each outcome, (len(AIDS), len(OUTCOMES))."""
        return np.asarray(self._own_counts + self.ti[state.I_COUNTS :].reshape(self._own_counts.shape))

    def covariance(self) -> FloatArray:
        """Covariance of the error states, (N_STATES, N_STATES)."""
        return self.p.reshape(state.N_STATES, state.N_STATES).copy()

    def step(
        self, imu_t_ns: TimeArray, f_b: FloatArray, omega_b: FloatArray, unsound: FloatArray, aids: Aids
    ) -> FilterOutput:
        """Fold samples in. Aids later than the last sample wait for the next call.

        Parameters
        ----------
        imu_t_ns : (n,) int64, increasing
        f_b, omega_b : (n, 3) calibrated specific force (m/s2) and rate (rad/s) in body axes
        unsound : (n,) sums of ``kernel.CLIPPED`` and ``kernel.HELD``, 0 where nothing is wrong with a sample
        aids : GNSS, magnetometer, wheel speed and air pressure of the same span
        """
        self._admit(imu_t_ns, aids)
        epochs = np.full((len(imu_t_ns), 4), np.nan)
        rows: list[Track] = []
        records: list[AidRecords] = []
        begin = 0
        while begin < len(imu_t_ns):
            if self.aligned:
                used = self._navigate(
                    imu_t_ns[begin:], f_b[begin:], omega_b[begin:], unsound[begin:], epochs[begin:], rows, records
                )
            else:
                used, track = self._align(imu_t_ns[begin:], f_b[begin:], omega_b[begin:])
                rows.append(track)
                if self.recorder is not None:
                    self.recorder.add(joined_tables([], NODE_WIDTH), track, AidRecords.joined([]))
            begin += used
        return FilterOutput(Track.joined(rows), epochs, AidRecords.joined(records))

    def warm(self, rate_kps: float) -> None:
        """Let the biases walk as the box's temperature does, told before each step; the mean change is not known.

        A drift of so much a second, all one way for ``warming_s``, spreads as this walk does in that time.
        """
        tuning = self.config.tuning
        lasting = rate_kps * math.sqrt(tuning.warming_s)
        for name, per_k in (
            ("gyro_bias_walk_radps2_rts", tuning.gyro_bias_radps_per_k),
            ("accel_bias_walk_mps3_rts", tuning.accel_bias_mps2_per_k),
        ):
            self._par[PARAMETER[name]] = math.hypot(getattr(tuning, name), per_k * lasting)

    # Aids

    def _admit(self, imu_t_ns: TimeArray, aids: Aids) -> None:
        """Let those aids wait for their sample that can be used."""
        tuning = self.config.tuning
        kinds = (
            (state.K_GNSS, aids.gnss, lambda rows: usable_fixes(rows, self._par), 0.0),
            (state.K_SPEED, aids.speed, usable_speeds, tuning.speed_interval_s),
            (state.K_MAGNETIC, aids.magnetic_b_ut, usable_fields, tuning.magnetic_interval_s),
            (state.K_BARO, aids.pressure_pa, usable_pressures, tuning.baro_interval_s),
        )
        for kind, (t_ns, values), usable, interval_s in kinds:
            if not len(t_ns):
                continue
            in_time, newest_ns = timely(
                t_ns, imu_t_ns, self.t_ns, int(self._newest_aid_ns[kind]), tuning.max_gap_s, tuning.late_s
            )
            in_range = usable(values)
            kept = in_time & in_range
            self._newest_aid_ns[kind] = newest_ns
            aid = AIDS_OF_KIND[kind][0]
            self._own_counts[aid, state.REJECTED_TIME] += np.count_nonzero(~in_time)
            self._own_counts[aid, state.REJECTED_RANGE] += np.count_nonzero(in_time & ~in_range)
            t_ns, values = t_ns[kept], values[kept]
            if interval_s > 0.0:
                chosen, self._used_aid_ns[kind] = thinned(t_ns, int(self._used_aid_ns[kind]), int(interval_s * 1e9))
                t_ns, values = t_ns[chosen], values[chosen]
            # Known from its own time on; where samples have gone past that, from the next one.
            from_ns = np.maximum(t_ns, self.t_ns + 1)
            if kind == state.K_GNSS:
                t_ns = t_ns + round(self.config.gnss_time_offset_s * 1e9)
            elif kind == state.K_BARO:
                values = pressure_height_m(values)
            self._pending = self._pending.join(pending(kind, t_ns, np.maximum(from_ns, t_ns), values))

    # Navigating

    def _navigate(
        self,
        t_ns: TimeArray,
        f_b: FloatArray,
        omega_b: FloatArray,
        unsound: FloatArray,
        epochs: FloatArray,
        rows: list[Track],
        records: list[AidRecords],
    ) -> int:
        """Fold samples up to where a late aid is known, or go back for that; returns how many were used."""
        late = self._pending.from_ns > self._pending.t_ns
        end = len(t_ns)
        if late.any():
            end = int(np.searchsorted(t_ns, self._pending.from_ns[late].min()))
            if end == 0:
                self._go_back(late & (self._pending.from_ns <= t_ns[0]), records)
                return 0
        aids = self._pending.take(~late)
        used, used_aids, track, told, stopped = self._run(
            t_ns[:end], f_b[:end], omega_b[:end], unsound[:end], aids, epochs[:end]
        )
        rows.append(track)
        records.append(told)
        self._recent.add(t_ns[:used], f_b[:used], omega_b[:used], unsound[:used], aids.take(slice(0, used_aids)))
        done = np.zeros(len(self._pending), np.bool_)
        done[np.flatnonzero(~late)[:used_aids]] = True
        self._pending = self._pending.take(~done)
        if stopped != kernel.STOPPED_END:
            self._align_anew(stopped)
        return used

    def _go_back(self, chosen: npt.NDArray[np.bool_], records: list[AidRecords]) -> None:
        """Let late aids in at their own time: from a state kept before it, fold everything since in again."""
        late = self._pending.take(chosen)
        self._pending = self._pending.take(~chosen)
        now_ns = self.t_ns
        ahead = late.t_ns > now_ns  # of an instant between the last sample and the next: nothing to go back for
        if ahead.any():
            early = late.take(ahead)
            self._pending = self._pending.join(Pending(early.t_ns, early.t_ns, early.rows))
        late = late.take(~ahead)
        while len(late) and (slot := self._recent.slot_before(int(late.t_ns[0]))) is None:
            self._own_counts[AIDS_OF_KIND[round(late.rows[0, 0])][0], state.REJECTED_TIME] += 1
            late = late.take(slice(1, None))
        if not len(late) or slot is None:
            return
        recent = self._recent
        kept = recent.kept[slot]
        self.x[:], self.p[:], self.ti[:] = kept[: state.NX], kept[state.NX :], recent.kept_ti[slot]
        recent.aids = recent.aids.join(late)
        again, aids = recent.t_ns > self.t_ns, recent.aids.take(recent.aids.t_ns > self.t_ns)
        if self.recorder is not None:
            self.recorder.cut(self.t_ns)
        samples = np.ascontiguousarray(recent.samples[again])
        epochs = np.empty((len(samples), 4))
        f_b, omega_b = np.ascontiguousarray(samples[:, :3]), np.ascontiguousarray(samples[:, 3:6])
        _, _, _, told, stopped = self._run(
            recent.t_ns[again], f_b, omega_b, np.ascontiguousarray(samples[:, 6]), aids, epochs
        )
        own = np.zeros(len(told.t_ns), np.bool_)
        for kind, aids_of_kind in AIDS_OF_KIND.items():
            own |= np.isin(told.column("aid"), aids_of_kind) & np.isin(told.t_ns, late.of(kind)[0])
        records.append(AidRecords(told.t_ns[own], told.values[own]))
        if stopped != kernel.STOPPED_END:
            self.ti[state.T_NOW] = now_ns
            self._align_anew(stopped)

    def _run(
        self,
        t_ns: TimeArray,
        f_b: FloatArray,
        omega_b: FloatArray,
        unsound: FloatArray,
        aids: Pending,
        epochs: FloatArray,
    ) -> tuple[int, int, Track, AidRecords, int]:
        """Samples and aids used, rows, records, and why the kernel came back."""
        tuning = self.config.tuning
        span_ns = max(int(t_ns[-1]) - self.t_ns, 0)

        def instants(interval_s: float) -> int:
            interval_ns = round(interval_s * 1e9)
            return len(t_ns) if interval_ns == 0 else min(len(t_ns), span_ns // interval_ns + 2)

        n_aids, constraints = len(aids), instants(tuning.constraint_interval_s)
        rows = Track(*empty_table(instants(tuning.output_interval_s), len(TRACK_COLUMNS)))
        log = AidRecords(
            *empty_table(_RECORDS_A_CONSTRAINT * constraints + _RECORDS_A_FIX * n_aids, len(RECORD_COLUMNS))
        )
        n_nodes = 0
        if self.recorder is not None:
            n_nodes = instants(tuning.covariance_interval_s) + constraints + n_aids
        nodes = empty_table(n_nodes, NODE_WIDTH)
        used, used_aids, n_rows, stopped = kernel.run(
            *self.kernel_arguments(
                t_ns, f_b, omega_b, unsound, aids.t_ns, aids.rows, epochs,
                rows.t_ns, rows.values, log.t_ns, log.values, *nodes,
            )
        )  # fmt: skip
        n_records, n_nodes = int(self.ti[state.I_RECORDS]), int(self.ti[state.I_NODES])
        # Of no meaning between calls: the state is to be the same however the samples come.
        self.ti[state.I_RECORDS] = self.ti[state.I_NODES] = 0
        track = Track(rows.t_ns[:n_rows], rows.values[:n_rows])
        records = AidRecords(log.t_ns[:n_records], log.values[:n_records])
        if self.recorder is not None:
            self.recorder.add((nodes[0][:n_nodes], nodes[1][:n_nodes]), track, records)
        return used, used_aids, track, records, stopped

    def kernel_arguments(
        self,
        t_ns: TimeArray,
        f_b: FloatArray,
        omega_b: FloatArray,
        unsound: FloatArray,
        aid_t_ns: TimeArray,
        aids: FloatArray,
        epochs: FloatArray,
        *outputs: npt.NDArray[Any],
    ) -> tuple[Any, ...]:
        """The state, these samples and aids, and where the outputs go, in the order of ``kernel.run``."""
        return (
            self.x, self.ti, self.p, self._recent.kept, self._recent.kept_ti, self._scratch, self._par, self._setup,
            t_ns, f_b, omega_b, unsound, aid_t_ns, aids, epochs, *outputs,
        )  # fmt: skip

    def _align_anew(self, stopped: int) -> None:
        self._aligned[0] = False
        # What led astray may be the very biases and angles.
        self._known[0] = stopped == kernel.STOPPED_GAP
        self._own_counts[state.A_IMU, state.RESET] += 1
        self._aligner.forget()
        self._evaluation_ns[0] = 0

    # Aligning

    def _align(self, t_ns: TimeArray, f_b: FloatArray, omega_b: FloatArray) -> tuple[int, Track]:
        """Collect samples up to the next whole second, and evaluate once a sample beyond it has come."""
        late = int(np.searchsorted(t_ns, self.t_ns, side="right"))
        if late:
            self._own_counts[state.A_IMU, state.REJECTED_TIME] += late
            return late, Track.joined([])
        if self._evaluation_ns[0] == 0:
            self._evaluation_ns[0] = next_second_ns(t_ns[0])
        boundary = int(self._evaluation_ns[0])
        before = int(np.searchsorted(t_ns, boundary))
        if before:
            self._aligner.add_imu(t_ns[:before], f_b[:before], omega_b[:before])
            self.ti[state.T_NOW] = t_ns[before - 1]
            self.x[state.X_F : state.X_F + 3], self.x[state.X_W : state.X_W + 3] = f_b[before - 1], omega_b[before - 1]
        if before == len(t_ns):
            return before, Track.joined([])
        self._hand_aids_over(boundary)
        found = self._aligner.evaluate(boundary, self.start)
        row = fix_row(self._aligner, boundary)
        self._evaluation_ns[0] = next_second_ns(t_ns[before])
        if found is not None:
            self._start(found)
        return before, row

    def retrace(
        self, imu_t_ns: TimeArray, f_b: FloatArray, omega_b: FloatArray, unsound: FloatArray, aids: Aids
    ) -> None:
        """Forget everything and go through the past in other body axes, up to now; parameters as of ``step``.

        What was told stands, and what this brings again is not counted.
        """
        counts = self.counts
        self._clear()
        if self.recorder is not None and len(imu_t_ns):
            from_ns = int(imu_t_ns[0])
            self.recorder.cut(from_ns - 1)
            self.recorder.starts_ns[:] = [start_ns for start_ns in self.recorder.starts_ns if start_ns < from_ns]
        self.step(imu_t_ns, f_b, omega_b, unsound, aids)
        self._own_counts += counts - self.counts

    def turn(self, C_new_from_old: FloatArray, t_ns: int, recent: Series, gnss: Series) -> None:
        """Take other body axes from ``t_ns`` on, a whole second: align in them, at once if the recent past allows it.

        Parameters
        ----------
        C_new_from_old : (3, 3)
        recent : times (n,) and rows (n, 6) of the specific force and rate before, in the new axes
        gnss : usable fixes before
        """
        for group in (state.X_F, state.X_W):
            self.x[group : group + 3] = C_new_from_old @ self.x[group : group + 3]
        magnetic = self._pending.rows[:, 0] == state.K_MAGNETIC
        self._pending.rows[magnetic, 1:4] = turned(self._pending.rows[magnetic, 1:4], C_new_from_old)
        if not self.aligned:
            self._aligner.turn(C_new_from_old)
            return
        self._aligned[0] = self._known[0] = False  # biases and angles were learnt in axes that are none of the car's
        self._evaluation_ns[0] = t_ns
        self._aligner.forget()
        self._aligner.add_imu(recent[0], recent[1][:, :3], recent[1][:, 3:])
        self._aligner.add_aids(gnss, no_series(3), no_series())

    def _hand_aids_over(self, boundary: int) -> None:
        before = (self._pending.t_ns < boundary) & (self._pending.from_ns <= boundary)
        own = self._pending.take(before)
        self._pending = self._pending.take(~before)
        self._aligner.add_aids(own.of(state.K_GNSS), own.of(state.K_MAGNETIC), own.of(state.K_SPEED))

    def _start(self, found: InitialState) -> None:
        """Begin to navigate from an alignment; what was known of biases and mounting is kept."""
        kept = self.covariance() if self._known[0] else None
        given_offset = self.config.gnss_time_offset_s != 0.0
        p = begin(self.x, self.ti, found, kept, self.config.tuning, self.mount_angle_sd_rad, given_offset)
        self.p[:] = p.reshape(-1)
        self._aligned[0] = True
        self._aligner.forget()
        self._recent.begin(self.x, self.ti, self.p)
        if self.recorder is not None:
            self.recorder.starts_ns.append(found.t_ns)

    # Other calibrations

    def shift_biases(self, f_b: FloatArray, omega_b: FloatArray, accel_sd_mps2: float, gyro_sd_radps: float) -> None:
        """Go on with samples that show this much more of the same motion, less sure of their biases.

        Aids that are late by then are refused.
        """
        shift_biases(self.x, self.ti, f_b, omega_b)
        loosen_biases(self.p, accel_sd_mps2, gyro_sd_radps)
        self._recent.begin(self.x, self.ti, self.p)

    def forget_biases(self) -> None:
        """Go on with samples of another calibration: what was learnt of biases is not of its."""
        self._known[0] = False
        self._aligner.forget()
        if self.aligned:
            forget_biases(self.x, self.ti, self.p, self.config.tuning)
            self._recent.begin(self.x, self.ti, self.p)

    # Snapshots

    def arrays(self) -> dict[str, npt.NDArray[np.generic]]:
        """The whole state by name."""
        own: dict[str, npt.NDArray[np.generic]] = {name: getattr(self, name) for name in _ARRAYS}
        own["pending.t_ns"], own["pending.from_ns"] = self._pending.t_ns, self._pending.from_ns
        own["pending.rows"] = self._pending.rows
        own.update({f"aligner.{name}": value for name, value in self._aligner.arrays().items()})
        own.update({f"recent.{name}": value for name, value in self._recent.arrays().items()})
        return own

    def load(self, arrays: dict[str, npt.NDArray[np.generic]]) -> None:
        """Take over what ``arrays`` gave."""
        for name in _ARRAYS:
            setattr(self, name, arrays[name])
        self._pending = Pending(*(arrays[f"pending.{name}"] for name in ("t_ns", "from_ns", "rows")))  # type: ignore[arg-type]
        for part, stage in (("aligner.", self._aligner), ("recent.", self._recent)):
            stage.load({k[len(part) :]: v for k, v in arrays.items() if k.startswith(part)})


_ARRAYS: Final = (
    "x",
    "ti",
    "p",
    "_aligned",
    "_known",
    "_evaluation_ns",
    "_newest_aid_ns",
    "_used_aid_ns",
    "_own_counts",
)
