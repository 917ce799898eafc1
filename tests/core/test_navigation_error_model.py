"""The propagated covariance against the path itself: small errors grow as Phi says, noise as its integrals say."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from core.earth import gravity_mps2, ned_offset_m
from core.navigation import kernel, state
from core.navigation.correction import correct
from core.navigation.mechanization import fold_position, start_frame
from core.navigation.nodes import NODE_WIDTH
from core.navigation.records import RECORD_COLUMNS
from core.navigation.track import TRACK_COLUMNS
from core.navigation.tuning import Tuning
from core.rotation import matrix_from_quaternion, matrix_from_rpy, quaternion_from_matrix
from core.simulation.route import RouteBuilder
from core.simulation.trajectory import Place, drive

START_NS = 1_700_000_000_000_000_000
RATE_HZ = 200
QUIET = replace(
    Tuning(),
    gyro_noise_radps_rts=1e-7,
    accel_noise_mps2_rts=1e-6,
    gyro_bias_walk_radps2_rts=0.0,
    accel_bias_walk_mps3_rts=0.0,
    speed_scale_walk_rts=0.0,
    mount_angle_walk_rad_rts=0.0,
)
"""As little noise as the tunables allow, so that P moves by Phi alone."""


@dataclass
class Filter:
    """The state of ``kernel.run``, and samples to run it over without any aid."""

    x: np.ndarray
    ti: np.ndarray
    p: np.ndarray

    def copy(self):
        return Filter(self.x.copy(), self.ti.copy(), self.p.copy())

    def run(self, t_ns, f_b, omega_b, tuning=QUIET):
        none = np.empty(0, np.int64)
        n, second = len(t_ns), kernel.KEPT_SECONDS
        used, *_, stopped = kernel.run(
            self.x, self.ti, self.p, np.zeros((second, kernel.KEPT_WIDTH)), np.zeros((second, state.NT), np.int64),
            np.zeros(kernel.SCRATCH), tuning.as_array(), np.zeros(7), t_ns, f_b, omega_b, np.zeros(n),
            none, np.empty((0, state.AID_WIDTH)), np.empty((n, 4)), np.empty(n, np.int64),
            np.empty((n, len(TRACK_COLUMNS))),
            none, np.empty((0, len(RECORD_COLUMNS))), none, np.empty((0, NODE_WIDTH)),
        )  # fmt: skip
        assert (used, stopped) == (n, kernel.STOPPED_END)
        return self

    def put_wrong(self, error):
        """The truth, of which this state is an estimate with this error."""
        truth = self.copy()
        correct(truth.x, error.copy())
        fold_position(truth.x, truth.ti)
        return truth

    def error_against(self, truth):
        """Truth minus this estimate, (16,): the states of ``INDICES``."""
        x, y = self.x, truth.x
        origin = (x[state.X_LAT], x[state.X_LON], x[state.X_ALT])
        place = [y[i : i + 1] for i in (state.X_LAT, state.X_LON, state.X_ALT)]
        turn = matrix_from_quaternion(y[:4]) @ matrix_from_quaternion(x[:4]).T
        phi = 0.5 * np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
        return np.concatenate(
            [
                ned_offset_m(*place, origin)[0],
                y[state.X_V : state.X_V + 3] - x[state.X_V : state.X_V + 3],
                phi,
                y[state.X_BG : state.X_BG + 3] - x[state.X_BG : state.X_BG + 3],
                y[state.X_BA : state.X_BA + 3] - x[state.X_BA : state.X_BA + 3],
                [y[state.X_GYRO_SCALE] - x[state.X_GYRO_SCALE]],
            ]
        )


def started(C_n_from_b, v_n, f_b, omega_b):
    x, ti = np.zeros(state.NX), np.zeros(state.NT, np.int64)
    x[:4] = quaternion_from_matrix(C_n_from_b)
    x[state.X_V : state.X_V + 3] = v_n
    x[state.X_LAT], x[state.X_LON], x[state.X_ALT] = 0.8, 0.3, 200.0
    x[state.X_F : state.X_F + 3], x[state.X_W : state.X_W + 3] = f_b, omega_b
    x[state.X_C0 : state.X_C0 + 9] = C_n_from_b.reshape(9)
    ti[state.T_NOW] = ti[state.T_COV] = START_NS
    ti[state.T_NEXT_BLOCK] = ti[state.T_NEXT_COVARIANCE] = START_NS + 100_000_000
    ti[state.T_NEXT_CONSTRAINT] = ti[state.T_NEXT_OUTPUT] = 1 << 62
    start_frame(x, ti)
    return Filter(x, ti, np.zeros(state.N_STATES**2))


def turning_and_braking(intervals):
    """A filter in a bend taken under braking at 12 m/s, and the samples of so many covariance intervals."""
    bend = RouteBuilder(heading_deg=50.0, speed_mps=14.0).grade(6.0).to_speed(11.0, 3.0).turn(80.0, 25.0).build()
    braking = RouteBuilder(heading_deg=50.0, speed_mps=14.0).to_speed(8.0, 3.5)
    assert braking.t_s < bend.duration_s
    route = replace(bend, forward_by_tyres=braking.build().forward_by_tyres, heading_rad=bend.heading_rad)
    truth = drive(route, Place(0.8, 0.3, 200.0, (20.0, 0.0, 40.0)), RATE_HZ)
    first = round(2.2 * RATE_HZ)  # into the bend and the braking alike
    rows = slice(first + 1, first + 1 + intervals * RATE_HZ // 10)
    filtered = started(matrix_from_rpy(*truth.rpy_rad[first]), truth.v_n[first], truth.f_b[first], truth.omega_b[first])
    t_ns = START_NS + (1 + np.arange(intervals * RATE_HZ // 10, dtype=np.int64)) * (10**9 // RATE_HZ)
    return filtered, (t_ns, truth.f_b[rows], truth.omega_b[rows])


INDICES = [*range(15), state.GYRO_SCALE]
ERRORS = [*np.repeat([10.0, 1.0, 2e-3, 1e-3, 0.1], 3), 2e-3]
"""The navigation states and the gyroscope's scale, and what is put wrong in each, m, m/s, rad, rad/s, m/s2, 1: the
model is linear there, and rounding far below."""

LEFT_OUT = (
    # What Phi leaves out, as a velocity (m/s), an acceleration (m/s2) and a rate (rad/s), for each kind of error:
    # Position: gravity changes by 3.1e-6 m/s2 a metre; n turns by 1.6e-7 rad a metre, in the Earth's rate.
    (0.0, 3.1e-5, 1e-9),
    # Velocity: Coriolis, 1.5e-4 m/s2 a m/s; n turns by 1.6e-7 rad/s a m/s.
    (0.0, 1.5e-4, 1.7e-7),
    # Attitude: 10 m/s3 of jerk within an interval, times 0.1^2 / 12; phi^2 / 2 of 10 m/s2; n turns by 1e-4 rad/s.
    (10 * 0.1**2 / 12 * 2e-3, 11 * 2e-3**2 / 2, 1e-4 * 2e-3),
    # Gyroscope bias: its way into position, g dt^3 / 6 an interval; C moves on a curve within an interval (5e-4).
    (10 * 0.1**2 / 6 * 1e-3, 10 * 0.1**2 / 12 * 1e-3, 5e-4 * 1e-3),
    # Accelerometer bias: C turns by 0.044 rad within an interval, which position feels by a twelfth; as above.
    (0.044 * 0.1 / 12 * 0.1, 5e-4 * 0.1, 1e-8),
    # Gyroscope scale: as a bias of 0.5 rad/s times it.
    (10 * 0.1**2 / 6 * 1e-3, 10 * 0.1**2 / 12 * 1e-3, 5e-4 * 1e-3),
)
ROUNDING_M = 5e-9
"""Of a latitude in radians, as a length."""
CURVATURE_M = 10.0**2 / 6.36e6
"""By which 10 m north and back differ, on meridians that meet."""


def predicted(filtered, samples, which):
    """Phi times the error of one state: the covariance of that error alone is its square."""
    model, index = filtered.copy(), INDICES[which]
    model.p[index * (state.N_STATES + 1)] = ERRORS[which] ** 2
    p = model.run(*samples).p.reshape(state.N_STATES, state.N_STATES)
    return p[INDICES, index] / np.sqrt(p[index, index])  # every Phi here has ones on its diagonal


@pytest.mark.parametrize("intervals", [1, 10])
@pytest.mark.parametrize("which", range(len(INDICES)))
def test_a_small_error_grows_as_the_covariance_says(which, intervals):
    filtered, samples = turning_and_braking(intervals)
    error = np.zeros(state.N_STATES)
    error[INDICES[which]] = ERRORS[which]
    truth = filtered.put_wrong(error).run(*samples)
    grown = filtered.copy().run(*samples).error_against(truth)
    off = np.abs(grown - predicted(filtered, samples, which))
    t = 0.1 * intervals
    velocity, acceleration, rate = LEFT_OUT[which // 3]
    curvature_m = CURVATURE_M * (which < 3)
    assert off[:3].max() < velocity * t + acceleration * t * t / 2 + ROUNDING_M + curvature_m
    assert off[3:6].max() < acceleration * t + 1e-12
    assert off[6:9].max() < rate * t + 1e-12
    assert off[9:].max() < 1e-12


def test_noise_adds_up_to_its_integrals():
    duration_s, noise_f, noise_w = 20.0, 5e-3, 4e-4
    level, g = np.eye(3), gravity_mps2(0.8, 200.0)
    filtered = started(level, np.zeros(3), [0.0, 0.0, -g], np.zeros(3))
    n = round(duration_s * 50)
    t_ns = START_NS + (1 + np.arange(n, dtype=np.int64)) * 20_000_000
    tuning = replace(QUIET, accel_noise_mps2_rts=noise_f, gyro_noise_radps_rts=noise_w)
    filtered.run(t_ns, np.tile([0.0, 0.0, -g], (n, 1)), np.zeros((n, 3)), tuning)
    variance = np.diag(filtered.p.reshape(state.N_STATES, state.N_STATES))
    t = duration_s
    from_f, from_w = noise_f**2, (g * noise_w) ** 2
    # A random walk, integrated once and twice; the covariance's steps of 0.1 s leave out 0.1 s / T of it, times 2.5.
    expected = [from_f * t**3 / 3 + from_w * t**5 / 20, from_f * t + from_w * t**3 / 3, noise_w**2 * t]
    assert variance[[0, 3, 6]] == pytest.approx(expected, rel=2.5 * 0.1 / t)
    assert variance[[1, 4, 7]] == pytest.approx(expected, rel=2.5 * 0.1 / t)
    # A tilt about down moves nothing, so height is moved by the accelerometers' noise alone.
    assert variance[[2, 5]] == pytest.approx([from_f * t**3 / 3, from_f * t], rel=2.5 * 0.1 / t)


def test_an_unknown_bias_grows_into_position_by_half_its_square_of_time():
    g = gravity_mps2(0.8, 200.0)
    filtered = started(np.eye(3), np.zeros(3), [0.0, 0.0, -g], np.zeros(3))
    for i in range(3):
        filtered.p[(state.ACCEL_BIAS + i) * (state.N_STATES + 1)] = 0.05**2
        filtered.p[(state.GYRO_BIAS + i) * (state.N_STATES + 1)] = 1e-4**2
    t, n = 30.0, 30 * 50
    t_ns = START_NS + (1 + np.arange(n, dtype=np.int64)) * 20_000_000
    filtered.run(t_ns, np.tile([0.0, 0.0, -g], (n, 1)), np.zeros((n, 3)))
    variance = np.diag(filtered.p.reshape(state.N_STATES, state.N_STATES))
    from_f, from_w = 0.05 * t**2 / 2, 1e-4 * g * t**3 / 6
    assert np.sqrt(variance[:2]) == pytest.approx(np.hypot(from_f, from_w), rel=0.01)  # steps of 0.1 s in 30 s
    assert np.sqrt(variance[2]) == pytest.approx(from_f, rel=0.01)
