"""The mobile-mapping paper's filter over a whole drive (seed 3), built on filterpy's extended Kalman filter."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from filterpy.kalman import ExtendedKalmanFilter
from scipy.spatial.transform import Rotation, Slerp

from core.earth import STANDARD_GRAVITY_MPS2, ecef_from_geodetic, geodetic_from_ecef, gravity_mps2, matrix_e_from_n
from core.errors import InvalidInputError
from core.measurements import GNSS, FloatArray, TimeArray
from core.navigation import ecef_model as model
from core.navigation.admission import position_sd_m, usable_fixes
from core.navigation.solution import SLOW, SLOW_COLUMNS, Solution
from core.navigation.track import TRACK, TRACK_COLUMNS, Mode, Track
from core.navigation.tuning import Tuning
from core.past import BodySamples
from core.rotation import matrix_from_quaternion, rpy_from_matrix
from core.tunables import Tunables, tunable

_NODES_PER_S: Final = 10
_PROGRESS_EPOCHS: Final = 1000
UNKNOWN_SD_M: Final = 1000.0
"""Spread of a height that a fix does not say: it then weighs nothing."""


@dataclass(frozen=True, slots=True)
class EcefTuning(Tunables):
    """What the paper's filter needs besides ``Tuning``; the paper gives no values but its sensor's."""

    ahrs_sd_rad: float = tunable(
        math.radians(2.0), unit="rad", low=1e-4, high=0.5, source="Xsens MTi, dynamic accuracy 2 deg RMS (table 1)"
    )
    attitude_correlation_s: float = tunable(
        60.0, unit="s", low=0.1, high=1e5, source="choice: errors of an AHRS under way hang together for a minute"
    )
    attitude_gap_s: float = tunable(
        0.5, unit="s", low=0.01, high=10, source="choice: over a longer hole the gyroscopes carry the attitude"
    )
    gravity_walk_mps2_rts: float = tunable(
        1e-3, unit="m/s2/sqrt(s)", low=0, high=1, source="choice: the gravity state takes up the accelerometer's bias"
    )
    unknown_velocity_sd_mps: float = tunable(
        20.0, unit="m/s", low=1, high=200, source="at the first fix of a receiver that gives no velocity: 72 km/h"
    )
    climb_share: float = tunable(
        0.06, unit="1", low=0, high=1, source="vertical over horizontal speed where a receiver says no vertical one"
    )
    course_min_speed_mps: float = tunable(
        1.0, unit="m/s", low=0, high=20, source="a course says nothing of a slower receiver"
    )


@dataclass(frozen=True, slots=True, eq=False)
class GivenAttitude:
    """Attitude that the filter is given: by the sensor's own AHRS, or by our causal filter.

    Parameters
    ----------
    t_ns : (n,) times
    q_n_from_b : (n, 4) attitude of the vehicle
    sd_rad : (n, 3) spread of its error about north, east and down
    mount_rad : (n, 2) pitch and yaw of the sensors' axes in the vehicle, where the attitude's source knows them
    """

    t_ns: TimeArray
    q_n_from_b: FloatArray
    sd_rad: FloatArray
    mount_rad: FloatArray

    @classmethod
    def by_ahrs(cls, t_ns: TimeArray, q_n_from_b: FloatArray, tuning: EcefTuning) -> GivenAttitude:
        """The sensor's own, whose body axes are those of the samples."""
        n = len(t_ns)
        return cls(t_ns, q_n_from_b, np.full((n, 3), tuning.ahrs_sd_rad), np.zeros((n, 2)))

    @classmethod
    def by_solution(cls, solution: Solution, tuning: Tuning) -> GivenAttitude:
        """That of another filter, at its rows that have one; each with what was known at the node before it.

        Its spread is widened by the accelerometer's bias: that filter has taken it out of its own tilt, while here
        there is no state for it and it works as tilt.
        """
        track = solution.track
        known = np.isfinite(track.column("yaw_rad")) & (track.column("mode") != Mode.ALIGNING)
        t_ns, rpy = track.t_ns[known], track.values[known, TRACK["roll_rad"] : TRACK["yaw_rad"] + 1]
        at = np.clip(np.searchsorted(solution.t_ns, t_ns, side="right") - 1, 0, None)
        variance = np.diagonal(solution.covariance, axis1=1, axis2=2)[at, 6:]
        bias_as_tilt = tuning.accel_bias_sd_mps2 / STANDARD_GRAVITY_MPS2
        return cls(
            t_ns,
            Rotation.from_euler("ZYX", rpy[:, ::-1]).as_quat(scalar_first=True),
            np.sqrt(variance + bias_as_tilt**2),
            solution.slow[at][:, [SLOW["mount_pitch_rad"], SLOW["mount_yaw_rad"]]],
        )


@dataclass(frozen=True, slots=True)
class EcefConfig:
    """Tunables and the places of sensor and antenna in the body, m."""

    tuning: Tuning = field(default_factory=Tuning)
    own: EcefTuning = field(default_factory=EcefTuning)
    imu_lever_b_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    antenna_lever_b_m: tuple[float, float, float] = (0.0, 0.0, 0.0)


class _PaperEkf(ExtendedKalmanFilter):  # type: ignore[misc]
    """filterpy's filter whose prediction goes by the non-linear dynamics, as its documentation has it."""

    x: FloatArray

    def predict_x(self, u: Any = 0) -> None:
        self.x = model.propagate(self.x, *u)


@dataclass(frozen=True, slots=True, eq=False)
class _Epochs:
    """All instants, of samples and fixes, and what is known over the interval that ends with each."""

    t_ns: TimeArray
    f_b: FloatArray
    omega_b: FloatArray
    saturated: npt.NDArray[np.bool_]
    is_sample: npt.NDArray[np.bool_]
    fix: npt.NDArray[np.int64]
    """Row of the fix of that instant, -1 without one."""
    attitude: FloatArray
    """q_n_from_b, (n, 4); NaN where it is not given."""
    attitude_sd_rad: FloatArray


def run(
    samples: BodySamples,
    gnss_t_ns: TimeArray,
    gnss: FloatArray,
    attitude: GivenAttitude,
    config: EcefConfig,
    progress: Callable[[float], None] = lambda share: None,
) -> tuple[Solution, dict[str, int]]:
    """Filter a drive forward.

    A fix corrects the filter only with four satellites or more; a receiver that does not count them is taken to
    have enough. One without velocity corrects the position alone (three rows of eq. 8). There is no gate: the
    paper has none, and this filter is what it is compared as.

    Parameters
    ----------
    samples : calibrated inertial samples
    gnss_t_ns, gnss : (m,), (m, len(GNSS_COLUMNS)) fixes, in increasing time
    attitude : attitude from elsewhere, over as much of the drive as there is; holes are bridged by the gyroscopes
    config : tunables and lever arms
    progress : is told the share done

    Returns
    -------
    the solution, with rows from the first fix on that came with an attitude (its slow states are NaN: it has none),
    and counts of what became of the fixes

    Raises
    ------
    InvalidInputError
        If there is no attitude to start with.
    """
    if not len(attitude.t_ns):
        raise InvalidInputError("the filter has no attitude of its own: expected an AHRS, or a drive that aligns")
    usable = usable_fixes(gnss, config.tuning.as_array())
    epochs = _epochs(samples, gnss_t_ns[usable], attitude, config.own)
    counts = {"gnss_position.rejected_range": int(np.count_nonzero(~usable))}
    drive = _Drive(config, gnss[usable], counts)
    for j in range(1, len(epochs.t_ns)):
        drive.step(epochs, j)
        if j % _PROGRESS_EPOCHS == 0:
            progress(j / len(epochs.t_ns))
    return drive.solution(), {name: count for name, count in counts.items() if count}


def _epochs(samples: BodySamples, fix_t_ns: TimeArray, attitude: GivenAttitude, own: EcefTuning) -> _Epochs:
    if len(samples.t_ns) < 2:
        raise InvalidInputError(f"{len(samples.t_ns)} inertial samples: expected two or more")
    inside = np.flatnonzero((fix_t_ns > samples.t_ns[0]) & (fix_t_ns <= samples.t_ns[-1]))
    t_ns = np.union1d(samples.t_ns, fix_t_ns[inside])
    fix = np.full(len(t_ns), -1)
    fix[np.searchsorted(t_ns, fix_t_ns[inside])] = inside
    q, sd, mount = _given_at(t_ns, attitude, own.attitude_gap_s)
    after = np.clip(np.searchsorted(samples.t_ns, t_ns), 1, None)
    turn = Rotation.from_euler("ZY", mount[:, ::-1]).inv()
    return _Epochs(
        t_ns,
        turn.apply((samples.f_b[after - 1] + samples.f_b[after]) / 2),
        turn.apply((samples.omega_b[after - 1] + samples.omega_b[after]) / 2),
        np.maximum(samples.saturated[after - 1], samples.saturated[after]) > 0.5,
        np.isin(t_ns, samples.t_ns),
        fix,
        q,
        sd,
    )


def _given_at(t_ns: TimeArray, attitude: GivenAttitude, gap_s: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Attitude, its spread and the mounting at instants; the attitude NaN in holes."""
    given_t_ns = attitude.t_ns
    before = np.clip(np.searchsorted(given_t_ns, t_ns, side="right") - 1, 0, len(given_t_ns) - 1)
    after = np.clip(np.searchsorted(given_t_ns, t_ns), 0, len(given_t_ns) - 1)
    q = np.full((len(t_ns), 4), np.nan)
    near = (t_ns >= given_t_ns[0]) & (t_ns <= given_t_ns[-1])
    near &= given_t_ns[after] - given_t_ns[before] <= gap_s * 1e9
    if len(given_t_ns) == 1:
        q[near] = attitude.q_n_from_b[0]
    elif near.any():
        turns = Rotation.from_quat(attitude.q_n_from_b, scalar_first=True)
        between = Slerp(given_t_ns - given_t_ns[0], turns)
        q[near] = between(t_ns[near] - given_t_ns[0]).as_quat(scalar_first=True)
    return q, attitude.sd_rad[before], attitude.mount_rad[before]


class _Drive:
    """One pass over the epochs: starts at a fix, predicts, corrects, notes rows and nodes."""

    def __init__(self, config: EcefConfig, fixes: FloatArray, counts: dict[str, int]) -> None:
        self._tuning, self._own = config.tuning, config.own
        self._par = config.tuning.as_array()
        self._imu_lever = np.array(config.imu_lever_b_m, dtype=float)
        self._antenna = np.array(config.antenna_lever_b_m, dtype=float) - self._imu_lever
        self._fixes, self._counts = fixes, counts
        self._ekf: _PaperEkf | None = None
        self._given = np.full(4, np.nan)
        self._fixed_ns = 0
        self._used = False
        self._rows: list[FloatArray] = []
        self._row_t_ns: list[int] = []
        self._nodes: list[FloatArray] = []
        self._node_t_ns: list[int] = []

    def step(self, epochs: _Epochs, j: int) -> None:
        """From the epoch before to this one."""
        dt_s = int(epochs.t_ns[j] - epochs.t_ns[j - 1]) * 1e-9
        if dt_s > self._tuning.max_gap_s:
            self._ekf = None
        fix = int(epochs.fix[j])
        if self._ekf is not None:
            self._predict(self._ekf, epochs, j, dt_s)
        if fix >= 0:
            if self._ekf is not None:
                self._correct(self._ekf, self._fixes[fix], epochs.omega_b[j])
            elif np.isfinite(epochs.attitude[j]).all():
                self._ekf = self._start(epochs, j, self._fixes[fix])
            else:
                self._count("gnss_position.rejected_time")
                return
            self._fixed_ns, self._used = int(epochs.t_ns[j]), True
        if self._ekf is not None and epochs.is_sample[j]:
            self._note(self._ekf, int(epochs.t_ns[j]), epochs.omega_b[j])

    def _count(self, name: str) -> None:
        self._counts[name] = self._counts.get(name, 0) + 1

    def _start(self, epochs: _Epochs, j: int, fix: FloatArray) -> _PaperEkf:
        lat, lon, alt = (float(fix[GNSS[name]]) for name in ("lat_rad", "lon_rad", "alt_m"))
        alt = 0.0 if math.isnan(alt) else alt
        z, R = self._measurement(fix, alt)
        x = np.zeros(model.N_STATES)
        x[model.QUATERNION : model.QUATERNION + 4] = epochs.attitude[j]
        x[model.POSITION : model.POSITION + 3] = ecef_from_geodetic(lat, lon, alt)
        x[model.GRAVITY] = gravity_mps2(lat, alt)
        arm = model.measured(x, self._antenna, epochs.omega_b[j]) - x[: model.N_MEASURED]
        x[: len(z)] = z - arm[: len(z)]
        P = np.zeros((model.N_STATES, model.N_STATES))
        P[3:6, 3:6] = np.eye(3) * self._own.unknown_velocity_sd_mps**2
        P[: len(z), : len(z)] = R
        by_rotation = model.quaternion_by_rotation(epochs.attitude[j])
        quaternion = slice(model.QUATERNION, model.QUATERNION + 4)
        P[quaternion, quaternion] = by_rotation @ np.diag(epochs.attitude_sd_rad[j] ** 2) @ by_rotation.T
        P[model.GRAVITY, model.GRAVITY] = self._tuning.accel_bias_sd_mps2**2
        ekf = _PaperEkf(dim_x=model.N_STATES, dim_z=model.N_MEASURED)
        ekf.x, ekf.P = x, P
        self._given = epochs.attitude[j]
        self._count("gnss_position.fused")
        return ekf

    def _predict(self, ekf: _PaperEkf, epochs: _Epochs, j: int, dt_s: float) -> None:
        t, own = self._tuning, self._own
        given, omega_b = epochs.attitude[j], epochs.omega_b[j]
        if np.isfinite(given).all():
            kept = math.exp(-dt_s / own.attitude_correlation_s)
            turn_var = (1.0 - kept * kept) * epochs.attitude_sd_rad[j] ** 2
        else:
            kept = 1.0
            given = model.quaternion_product(self._given, model.quaternion_from_rotation(dt_s * omega_b))
            turn_var = np.full(3, t.gyro_noise_radps_rts**2 * dt_s)
        step = (epochs.f_b[j], omega_b, self._given, given, kept, dt_s)
        bridged_s = dt_s if dt_s > t.bridge_s else 0.0
        speed_var = t.accel_noise_mps2_rts**2 * dt_s + (t.bridge_accel_sd_mps2 * bridged_s) ** 2
        if epochs.saturated[j]:
            speed_var += (t.saturated_accel_sd_mps2 * dt_s) ** 2
        ekf.F = model.transition(ekf.x, *step)
        by_rotation = model.quaternion_by_rotation(ekf.x[model.QUATERNION : model.QUATERNION + 4])
        Q = np.zeros((model.N_STATES, model.N_STATES))
        for i in range(3):
            p, v = model.POSITION + i, model.VELOCITY + i
            Q[p, p], Q[p, v], Q[v, p], Q[v, v] = (speed_var * dt_s**k / d for k, d in ((2, 3), (1, 2), (1, 2), (0, 1)))
        quaternion = slice(model.QUATERNION, model.QUATERNION + 4)
        Q[quaternion, quaternion] = (by_rotation * turn_var) @ by_rotation.T
        Q[model.GRAVITY, model.GRAVITY] = own.gravity_walk_mps2_rts**2 * dt_s
        ekf.Q = Q
        ekf.predict(u=step)
        self._given = given

    def _correct(self, ekf: _PaperEkf, fix: FloatArray, omega_b: FloatArray) -> None:
        here_m = geodetic_from_ecef(*ekf.x[model.POSITION : model.POSITION + 3])[2]
        z, R = self._measurement(fix, here_m)
        rows = len(z)
        ekf.update(
            z,
            lambda x: model.measurement_jacobian(x, self._antenna, omega_b)[:rows],
            lambda x: model.measured(x, self._antenna, omega_b)[:rows],
            R,
        )
        # The quaternion keeps its length: neither it nor its spread may leave the sphere.
        quaternion = slice(model.QUATERNION, model.QUATERNION + 4)
        ekf.x[quaternion] /= np.linalg.norm(ekf.x[quaternion])
        onto = np.eye(model.N_STATES)
        onto[quaternion, quaternion] -= np.outer(ekf.x[quaternion], ekf.x[quaternion])
        ekf.P = onto @ ekf.P @ onto.T
        self._count("gnss_position.fused")
        if rows == model.N_MEASURED:
            self._count("gnss_velocity.fused")

    def _measurement(self, fix: FloatArray, alt_m: float) -> tuple[FloatArray, FloatArray]:
        """What a fix measured in e, three or six rows, and its covariance; ``alt_m`` where it says no height."""
        lat, lon, alt = (float(fix[GNSS[name]]) for name in ("lat_rad", "lon_rad", "alt_m"))
        sd_h_m, sd_v_m = position_sd_m(fix, self._par)
        if math.isnan(alt):
            alt, sd_v_m = alt_m, UNKNOWN_SD_M
        C_e_from_n = matrix_e_from_n(lat, lon)
        z = np.array(ecef_from_geodetic(lat, lon, alt))
        R = (C_e_from_n * np.array([sd_h_m, sd_h_m, sd_v_m]) ** 2) @ C_e_from_n.T
        velocity = self._velocity(fix)
        if velocity is None:
            return z, R
        v_n, sd_mps = velocity
        both = np.zeros((model.N_MEASURED, model.N_MEASURED))
        both[:3, :3], both[3:, 3:] = R, (C_e_from_n * sd_mps**2) @ C_e_from_n.T
        return np.concatenate([z, C_e_from_n @ v_n]), both

    def _velocity(self, fix: FloatArray) -> tuple[FloatArray, FloatArray] | None:
        """Velocity of a fix in n and its sd, (3,) each, None if it says none; without a vertical one, level."""
        north, east, down, speed, course, sd = (
            float(fix[GNSS[name]]) for name in ("vn_mps", "ve_mps", "vd_mps", "speed_mps", "course_rad", "sd_v_mps")
        )
        if math.isnan(north + east):
            if math.isnan(speed + course) or speed < self._own.course_min_speed_mps:
                return None
            north, east = speed * math.cos(course), speed * math.sin(course)
        sd = max(sd, self._tuning.gnss_sd_v_floor_mps) if sd > 0.0 else self._tuning.gnss_sd_v_mps
        sd_mps = np.full(3, sd)
        if math.isnan(down):
            down, sd_mps[2] = 0.0, math.hypot(sd, self._own.climb_share * math.hypot(north, east))
        return np.array([north, east, down]), sd_mps

    def _note(self, ekf: _PaperEkf, t_ns: int, omega_b: FloatArray) -> None:
        """The vehicle's row at a sample, and ten times a second its covariance."""
        at_body = model.measured(ekf.x, -self._imu_lever, omega_b)
        lat, lon, alt = geodetic_from_ecef(*at_body[:3])
        v_n = matrix_e_from_n(lat, lon).T @ at_body[3:]
        attitude = rpy_from_matrix(matrix_from_quaternion(ekf.x[model.QUATERNION : model.QUATERNION + 4]))
        T = model.navigation_jacobian(ekf.x)
        P = T @ ekf.P @ T.T
        sd = np.sqrt(np.diag(P))
        coasting = (t_ns - self._fixed_ns) * 1e-9 > self._tuning.coasting_after_s
        mode = Mode.COASTING if coasting else Mode.AIDED
        told = float(self._used), float(mode)
        sd_v_h, sd_tilt = (np.hypot(*sd[first : first + 2]) / np.sqrt(2.0) for first in (3, 6))
        self._rows.append(
            np.array([lat, lon, alt, *v_n, *attitude, *sd[:3], P[0, 1], sd[8], *told, sd_v_h, sd_tilt, np.nan])
        )
        self._used = False
        if not self._node_t_ns or t_ns * _NODES_PER_S // 10**9 != self._node_t_ns[-1] * _NODES_PER_S // 10**9:
            self._node_t_ns.append(t_ns)
            self._nodes.append(P)
        self._row_t_ns.append(t_ns)

    def solution(self) -> Solution:
        """All that was noted."""
        nodes = len(self._node_t_ns)
        none = np.full((nodes, len(SLOW_COLUMNS)), np.nan)
        return Solution(
            Track(np.array(self._row_t_ns, np.int64), np.array(self._rows).reshape(-1, len(TRACK_COLUMNS))),
            np.array(self._node_t_ns, np.int64),
            np.array(self._nodes).reshape(nodes, 9, 9),
            none,
            none.copy(),
        )
