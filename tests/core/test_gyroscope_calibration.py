"""A gyroscope calibrated between static positions: truth recovered as surely as stated, and real recordings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from core.calibration.accelerometer import fit_accelerometer
from core.calibration.gyroscope import GyroscopeFit, fit_gyroscope
from core.calibration.gyroscope_axes import axes_of, matrix_of
from core.calibration.recording import CalibrationRecording
from core.calibration.rest import Rest, g_sensitivity
from core.calibration.static_intervals import StaticPositions, find_static
from core.calibration.turns import Turns, integrate
from core.earth import STANDARD_GRAVITY_MPS2
from core.errors import InvalidInputError
from core.measurements import FloatArray
from core.rotation import matrix_from_rotation_vector, rotation_vector_from_matrix
from core.sensors import TriadCalibration
from core.simulation.calibration_recording import Handling, SimulatedRecording, Warming, simulate_recording
from core.simulation.sensors import GYROSCOPE
from tests.recordings import recording

GYRO = TriadCalibration((1.012, 0.985, 1.003), (0.011, -0.008, 0.014), (0.012, -0.02, 0.006), (0.02, -0.03, 0.012))
ACCEL = TriadCalibration((0.99, 1.01, 1.004), (-0.01, 0.006, 0.012), (0.2, -0.3, 0.1))
TO_COUNTS = 4770.0


def simulated(seed: int = 1, gyroscope: TriadCalibration = GYRO, **settings: object) -> SimulatedRecording:
    generator = np.random.default_rng(seed)
    known = {"accelerometer": ACCEL, "gyroscope": gyroscope, "rate_hz": 100.0, "initial_rest_s": 10.0} | settings
    return simulate_recording(generator, **known)  # type: ignore[arg-type]


def fitted(made: SimulatedRecording, **settings: object) -> GyroscopeFit:
    positions = StaticPositions.of(made.recording, made.starts, made.ends)
    accelerometer = fit_accelerometer(positions, STANDARD_GRAVITY_MPS2)
    return fit_gyroscope(made.recording, positions, accelerometer, STANDARD_GRAVITY_MPS2, **settings)  # type: ignore[arg-type]


def parameters(triad: TriadCalibration) -> FloatArray:
    return np.concatenate([triad.scale, triad.misalignment, triad.bias, triad.alignment])


def errors_in_sd(fit: GyroscopeFit, truth: TriadCalibration) -> FloatArray:
    return np.asarray((parameters(fit.calibration) - parameters(truth)) / np.sqrt(np.diag(fit.joint_covariance)))


def with_gyroscope(made: SimulatedRecording, gyroscope: FloatArray | None) -> SimulatedRecording:
    return replace(made, recording=replace(made.recording, gyroscope=gyroscope))


def test_truth_lies_within_the_stated_spread() -> None:
    errors = np.array([errors_in_sd(fitted(simulated(seed)), GYRO) for seed in range(12)])
    assert np.mean(np.abs(errors) < 3.0) >= 0.99
    # 144 values: the RMS of a right spread is 1 +- 0.06; a bias' wander is told a little larger than one recording's.
    assert 0.75 < np.sqrt(np.mean(errors**2)) < 1.15


def test_turns_sampled_too_slowly_do_not_outweigh_the_bias_at_rest() -> None:
    # Turns of 1.5 rad/s with tremor of 8-12 Hz, ten samples a second: integrated, they miss gravity by degrees.
    slow = {"rate_hz": 10.0, "hold_s": 8.0, "initial_rest_s": 40.0}
    fits = [fitted(simulated(seed, **slow)) for seed in range(6)]
    assert all(fit.residual_rms > np.radians(1.0) for fit in fits)
    biases = np.array([errors_in_sd(fit, GYRO)[6:9] for fit in fits])
    assert np.abs(biases).max() < 3.5  # of 18; with all turns at full weight one was 35 off


def test_holds_of_two_seconds_tell_noise_from_bias() -> None:
    made = simulated(3, hold_s=2.0, initial_rest_s=2.0)
    positions = find_static(made.recording)
    fit = fit_gyroscope(
        made.recording, positions, fit_accelerometer(positions, STANDARD_GRAVITY_MPS2), STANDARD_GRAVITY_MPS2
    )
    assert np.abs(errors_in_sd(fit, GYRO)).max() < 3.5


def test_counts_are_calibrated_without_knowing_their_scale() -> None:
    triad = replace(GYRO, scale=(4820.0, 4700.0, 4790.0), bias=(32800.0, 32450.0, 32700.0))
    accelerometer = replace(ACCEL, scale=(415.0, 412.0, 414.0), bias=(33100.0, 33200.0, 32400.0))
    made = simulated(2, triad, accelerometer=accelerometer, counts=(0, 65535))
    positions = find_static(made.recording)
    accel_fit = fit_accelerometer(positions, STANDARD_GRAVITY_MPS2, counts=True)
    fit = fit_gyroscope(made.recording, positions, accel_fit, STANDARD_GRAVITY_MPS2, counts=True)
    assert np.abs(errors_in_sd(fit, triad)).max() < 3.5
    assert fit.sd[:3] / np.array(triad.scale) == pytest.approx(3e-4, rel=0.5)
    assert fit.stop.converged


def test_a_gyroscope_on_its_side_is_told_in_the_accelerometers_axes() -> None:
    # The chip was soldered turned by 90 degrees about z, with x and y swapped in sign and order.
    turned = replace(GYRO, alignment=(0.01, -0.02, np.pi / 2 + 0.015))
    fit = fitted(simulated(4, turned))
    assert np.abs(errors_in_sd(fit, turned)).max() < 3.5


def test_matrix_and_axes_are_one_thing_told_twice() -> None:
    triad = replace(GYRO, alignment=(0.3, -1.2, 0.7))
    assert parameters(axes_of(matrix_of(triad), np.array(triad.bias))) == pytest.approx(parameters(triad), abs=1e-12)
    left_handed = replace(triad, scale=(1.0, -1.0, 1.0), alignment=(0.1, 0.2, -0.1))
    found = axes_of(matrix_of(left_handed), np.zeros(3))
    assert matrix_of(found) == pytest.approx(matrix_of(left_handed), abs=1e-12)
    assert np.prod(found.scale) < 0.0


def test_turning_follows_matrix_and_bias_as_differences_say() -> None:
    generator = np.random.default_rng(5)
    t_s = np.arange(300) / 100.0
    shown = np.cumsum(generator.standard_normal((300, 3)), axis=0) * 0.05
    inverse, bias = np.eye(3) + 0.1 * generator.standard_normal((3, 3)), np.array([[0.02, -0.01, 0.03]])

    def turned(matrix: FloatArray, offset: FloatArray) -> Turns:
        return integrate(t_s, shown, np.array([3]), np.array([290]), matrix, offset, np.ones(3))

    at, step = turned(inverse, bias), 1e-6
    for row in range(3):
        for column in range(3):
            moved = np.zeros((3, 3))
            moved[row, column] = step
            by = turned(inverse - moved, bias).C_a_from_e[0].T @ turned(inverse + moved, bias).C_a_from_e[0]
            expected = rotation_vector_from_matrix(by) / (2.0 * step)
            assert at.by_inverse[0, :, row, column] == pytest.approx(expected, abs=1e-6)
        moved_bias = step * np.eye(3)[row]
        by = turned(inverse, bias - moved_bias).C_a_from_e[0].T @ turned(inverse, bias + moved_bias).C_a_from_e[0]
        assert -at.by_rate[0] @ inverse[:, row] == pytest.approx(
            rotation_vector_from_matrix(by) / (2.0 * step), abs=1e-6
        )


def test_coning_is_integrated_as_the_motion_that_it_is() -> None:
    # A cone of 5 degrees at 5 Hz drifts by omega (1 - cos) = 0.12 rad/s about its axis; sums of rates see none of it.
    half, omega = np.radians(5.0), 2.0 * np.pi * 5.0
    t_s = np.arange(201) / 100.0
    rates = np.column_stack(
        [
            -omega * np.sin(half) * np.sin(omega * t_s),
            omega * np.sin(half) * np.cos(omega * t_s),
            np.full(t_s.size, -omega * (1.0 - np.cos(half))),
        ]
    )
    turns = integrate(t_s, rates, np.array([0]), np.array([200]), np.eye(3), np.zeros((1, 3)), np.zeros(3))
    # Ten whole cones: back where it began. Linear rates at 20 samples a cone leave some 1 % of the 0.24 rad.
    assert np.linalg.norm(rotation_vector_from_matrix(turns.C_a_from_e[0])) < 0.005


def test_an_axis_that_was_never_turned_is_named_and_the_turn_to_add() -> None:
    generator = np.random.default_rng(8)
    tilts = generator.permutation(np.linspace(-2.6, 2.6, 16))
    roll_only = np.array([matrix_from_rotation_vector(np.array([tilt, 0.0, 0.0])) for tilt in tilts])
    made = simulated(8, orientations=roll_only, handling=Handling(wobble_rad=0.0))
    positions = StaticPositions.of(made.recording, made.starts, made.ends)
    other = simulated(9)
    elsewhere = StaticPositions.of(other.recording, other.starts, other.ends)
    accelerometer = fit_accelerometer(elsewhere, STANDARD_GRAVITY_MPS2)
    fit = fit_gyroscope(made.recording, positions, accelerometer, STANDARD_GRAVITY_MPS2)
    assert not fit.observability.observable
    assert {"scale_y", "scale_z"} <= set(fit.observability.weak)
    assert "scale_x" not in fit.observability.weak
    assert "about the box's y axis" in fit.observability.advice or "about the box's z axis" in fit.observability.advice
    assert abs(errors_in_sd(fit, GYRO)[0]) < 3.5


def test_a_bias_that_warms_up_is_followed_through_the_turns() -> None:
    warm = Warming(20.0, 35.0, 60.0, 25.0, gyroscope_per_k=(5e-4, -4e-4, 3e-4))
    fit = fitted(simulated(10, warming=warm))
    errors = errors_in_sd(fit, GYRO)
    assert np.abs(np.delete(errors, [6, 7, 8])).max() < 3.5


def test_gravity_that_moves_the_bias_is_seen_and_not_taken_for_scale() -> None:
    made = simulated(11)
    assert made.recording.gyroscope is not None
    sensitivity = np.array([[1.0, 3.0, 6.0], [-13.0, 0.5, 8.0], [-7.0, -8.0, 2.0]]) / 4770.0 / 9.8
    force = ACCEL.correct(made.recording.accelerometer)
    fit = fitted(with_gyroscope(made, made.recording.gyroscope + force @ sensitivity.T))
    assert np.abs(errors_in_sd(fit, GYRO)).max() < 3.5
    assert np.abs(fit.g_sensitivity - sensitivity).max() < 4.0 * fit.g_sensitivity_sd.max()
    # Without it nothing is corrected: chance would pass one time in a thousand.
    assert not fitted(made).g_sensitivity.any()


def test_a_clipped_turn_is_left_out() -> None:
    made = simulated(12)
    assert made.recording.gyroscope is not None
    rates = made.recording.gyroscope.copy()
    peak = np.abs(rates[:, 0]).max()
    fit = fitted(with_gyroscope(made, np.clip(rates, -0.8 * peak, 0.8 * peak)))
    assert fit.left_out >= 1
    assert np.abs(errors_in_sd(fit, GYRO)).max() < 3.5


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda rates: np.degrees(rates), "degrees a second"),
        (lambda rates: rates * TO_COUNTS, "raw counts"),
        (lambda rates: rates * np.array([1.0, 0.0, 1.0]), "y axis shows 0 throughout"),
        (lambda rates: rates[np.random.default_rng(0).permutation(len(rates))], "record again"),
        (lambda rates: None, "no gyroscope"),
    ],
)
def test_what_cannot_be_calibrated_is_refused_with_what_to_do(change: object, message: str) -> None:
    made = simulated(13)
    with pytest.raises(InvalidInputError, match=message):
        fitted(with_gyroscope(made, change(made.recording.gyroscope)))  # type: ignore[operator]


def test_too_few_turns_are_refused() -> None:
    made = simulated(14)
    positions = StaticPositions.of(made.recording, made.starts, made.ends)
    accelerometer = fit_accelerometer(positions, STANDARD_GRAVITY_MPS2)
    few = StaticPositions.of(made.recording, made.starts[:4], made.ends[:4])
    with pytest.raises(InvalidInputError, match="3 turns between static positions; expected 5 or more"):
        fit_gyroscope(made.recording, few, accelerometer, STANDARD_GRAVITY_MPS2)


def test_noise_and_bias_at_rest_are_those_of_the_box() -> None:
    made = simulated(15, hold_s=10.0)
    assert made.recording.gyroscope is not None
    rest = Rest.of(made.recording.t_s, made.recording.gyroscope, made.starts, made.ends, 0.0, 0.0)
    # 240 means of a second: a standard deviation within 5 %, here three times that.
    assert rest.noise == pytest.approx(GYROSCOPE.random_walk, rel=0.15)
    means = np.array([made.recording.gyroscope[a:b].mean(axis=0) for a, b in zip(made.starts, made.ends, strict=True)])
    assert not g_sensitivity(means[:6], np.eye(3)[[0, 1, 2, 0, 1, 2]])[0].any()


def test_xsens_recording_agrees_with_imu_tk_and_the_factory() -> None:
    folder = recording("data", "calib_xsens_imu_tk")
    rows = np.loadtxt(folder / "imu_raw.csv.gz", delimiter=",", skiprows=1)
    raw = CalibrationRecording(rows[:, 0], rows[:, 1:4].copy(), rows[:, 4:7].copy())
    positions = find_static(raw)
    accelerometer = fit_accelerometer(positions, 9.81744, counts=True)
    fit = fit_gyroscope(raw, positions, accelerometer, 9.81744, counts=True)
    lines = np.array((folder / "peer_imu_tk_gyro.calib").read_text().split(), dtype=float)
    peer = axes_of(np.linalg.inv(lines[:9].reshape(3, 3) @ lines[9:18].reshape(3, 3)), lines[18:])
    factory = np.diag([4778.0, 4758.0, 4766.0]) @ np.array([[1.0, -0.01, -0.02], [0.0, 1.0, 0.04], [-0.01, 0.01, 1.0]])
    scale = np.array(fit.calibration.scale)
    # IMU-TK knows nothing of the g-sensitivity of this triad, which moves its gains by up to 0.1 %.
    assert scale == pytest.approx(peer.scale, rel=1e-3)
    assert scale == pytest.approx(np.diag(factory), rel=2e-3)
    assert (matrix_of(fit.calibration) - matrix_of(peer)) / 4770.0 == pytest.approx(0.0, abs=2e-3)
    # Factory numbers are rounded to 0.01, and its axes are the box's; the accelerometer's are off those by 0.02.
    assert (matrix_of(fit.calibration) - factory) / 4770.0 == pytest.approx(0.0, abs=0.025)
    assert np.degrees(fit.residual_rms) < 0.2
    assert fit.observability.observable


def test_ferraris_recording_agrees_with_imucal() -> None:
    folder = recording("data", "calib_ferraris_imucal")
    rows = np.loadtxt(folder / "example_ferraris_session.csv.gz", delimiter=",", skiprows=1)
    t_s = np.arange(len(rows)) / 102.4
    raw = CalibrationRecording(t_s, rows[:, 4:7].copy(), np.radians(rows[:, 1:4]))
    positions = find_static(raw)
    accelerometer = fit_accelerometer(positions, 9.81)
    fit = fit_gyroscope(raw, positions, accelerometer, 9.81)
    # imucal 2.6.0: K_g and b_g (deg/s). It takes each turn as 360 degrees by hand, we take gravity's word.
    peer_scale, peer_bias = np.array([1.02792, 0.98243, 0.99831]), np.radians([-0.59967, -0.36984, 0.05877])
    assert np.abs((fit.calibration.scale - peer_scale) / fit.sd[:3]).max() < 2.0
    assert np.abs((fit.calibration.bias - peer_bias) / fit.sd[6:]).max() < 2.0
    assert "scale_y" in fit.observability.weak
    # Nothing was turned about y by more than gravity shows: its scale is five times less sure than the others.
    assert fit.sd[1] > 4.0 * fit.sd[0]


def test_arduino_recording_foretells_its_own_check_turn() -> None:
    folder = recording("data", "calib_mpu6050_arduino")

    def loaded(name: str) -> CalibrationRecording:
        rows = np.loadtxt(folder / name, delimiter=",", skiprows=5)
        return CalibrationRecording(np.arange(len(rows)) / 100.0, rows[:, :3].copy(), rows[:, 3:6].copy())

    raw, check = loaded("calibration.csv.gz"), loaded("check_90deg_x_rotation.csv.gz")
    positions = find_static(raw)
    accelerometer = fit_accelerometer(positions, 9.80665, counts=True)
    fit = fit_gyroscope(raw, positions, accelerometer, 9.80665, counts=True)
    held = find_static(check)
    assert held.mean_gyroscope is not None
    assert check.gyroscope is not None
    ups = accelerometer.calibration.correct(held.mean_accelerometer)
    ups /= np.linalg.norm(ups, axis=1)[:, None]
    first, last = held.end[:1] - 1, held.start[-1:]
    inverse = np.asarray(np.linalg.inv(matrix_of(fit.calibration)))
    turn = integrate(check.t_s, check.gyroscope, first, last, inverse, held.mean_gyroscope[:1], fit.noise)
    missed = np.linalg.norm(turn.C_a_from_e[0].T @ ups[0] - ups[-1])
    assert np.degrees(np.arccos(ups[0] @ ups[-1])) == pytest.approx(92.3, abs=0.5)
    # The peer's scales miss it by 1.3 degrees.
    assert np.degrees(missed) < 0.3
