"""Static positions found in simulated recordings: where the truth says, whatever shakes, and none where none is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from core.calibration.recording import CalibrationRecording
from core.calibration.static_intervals import StaticPositions, StaticSettings, find_static
from core.errors import InvalidInputError
from core.measurements import FloatArray
from core.simulation.calibration_recording import (
    Handling,
    SimulatedRecording,
    simulate_recording,
    spread_orientations,
)
from core.simulation.sensors import ACCELEROMETER, GYROSCOPE, UNCALIBRATED, TriadErrors, draw_errors

RATE_HZ = 200.0


def _simulated(seed: int, **options: object) -> SimulatedRecording:
    generator = np.random.default_rng(seed)
    unit = draw_errors(UNCALIBRATED, generator)
    given = {"positions": 10, "initial_rest_s": 3.0, "hold_s": 3.0, **options}
    return simulate_recording(generator, accelerometer=unit.accelerometer, gyroscope=unit.gyroscope, **given)


def _with(recording: CalibrationRecording, accelerometer: FloatArray) -> CalibrationRecording:
    return CalibrationRecording(recording.t_s, accelerometer, recording.gyroscope)


def _without_gyroscope(recording: CalibrationRecording) -> CalibrationRecording:
    return CalibrationRecording(recording.t_s, recording.accelerometer)


def _assert_found(simulated: SimulatedRecording, found: StaticPositions, most_early_s: float = 0.3) -> None:
    """Each hold once, in order; a turn that begins gently may be counted to it for a while, but never much of it."""
    assert len(found) == len(simulated.starts)
    early_s = np.r_[simulated.starts - found.start, found.end - simulated.ends] / RATE_HZ
    assert early_s.max() <= most_early_s
    assert early_s.min() >= -0.3  # what is left out at the ends


@pytest.mark.parametrize("seed", range(3))
def test_holds_of_two_seconds_with_no_rest_before_them(seed: int) -> None:
    simulated = _simulated(seed, hold_s=2.0, initial_rest_s=2.0, positions=16)
    _assert_found(simulated, find_static(simulated.recording))


@pytest.mark.parametrize("seed", range(3))
def test_the_accelerometer_alone_is_enough(seed: int) -> None:
    simulated = _simulated(seed, hold_s=2.0, initial_rest_s=2.0, positions=16)
    # It does not see the first degree of a turn, which changes no norm.
    _assert_found(simulated, find_static(_without_gyroscope(simulated.recording)), 0.5)


@pytest.mark.parametrize("rate_hz", [10.0, 25.0, 1000.0])
def test_slow_and_fast_converters(rate_hz: float) -> None:
    simulated = _simulated(21, rate_hz=rate_hz)
    assert len(find_static(simulated.recording)) == 10
    assert len(find_static(_without_gyroscope(simulated.recording))) == 10


@pytest.mark.parametrize("seed", range(5))
def test_whatever_disturbs_a_recording_no_mean_is_empty_and_no_hold_is_counted_twice(seed: int) -> None:
    simulated, generator = _simulated(22), np.random.default_rng(seed)
    shaken = simulated.recording.accelerometer.copy()
    for _ in range(100):
        start, length = generator.integers(0, len(shaken) - 60), generator.integers(1, 60)
        shaken[start : start + length] += generator.normal(0.0, generator.choice([0.05, 0.5, 5.0]), (length, 3))
    found = find_static(_with(simulated.recording, shaken))
    assert np.isfinite(found.mean_accelerometer).all()
    assert np.isfinite(found.cov_accelerometer).all()
    assert (np.diff(np.column_stack([found.start, found.end]).ravel()) > 0).all()


@pytest.mark.parametrize("turn_radps", [0.3, 3.0])
def test_slow_and_fast_hands(turn_radps: float) -> None:
    simulated = _simulated(4, handling=Handling(turn_radps=turn_radps, least_move_s=0.3))
    _assert_found(simulated, find_static(simulated.recording), 0.7)


@pytest.mark.parametrize("rest_share", [0.2, 1.0])
def test_held_in_a_hand_that_trembles(rest_share: float) -> None:
    simulated = _simulated(6, handling=Handling(rest_share=rest_share))
    _assert_found(simulated, find_static(simulated.recording), 0.5)


def test_laid_down_and_held_in_a_hand_in_one_recording() -> None:
    laid, held = _simulated(7, hold_s=4.0), _simulated(8, hold_s=4.0, handling=Handling(rest_share=1.0))
    a, b = laid.recording, held.recording
    joined = CalibrationRecording(
        np.r_[a.t_s, b.t_s + a.t_s[-1] + 1.0 / RATE_HZ],
        np.vstack([a.accelerometer, b.accelerometer]),
        np.vstack([a.gyroscope, b.gyroscope]),
    )
    found = find_static(joined)
    assert len(found) == 20
    variance = np.trace(found.cov_accelerometer, axis1=1, axis2=2)
    # A hold in a hand says of itself that it is known less well.
    assert np.median(variance[10:]) > 2.0 * np.median(variance[:10])


@pytest.mark.parametrize("size_mps2", [0.06, 0.5])
@pytest.mark.parametrize("from_share", [0.0, 0.5])
def test_an_engine_hums_on_the_table(size_mps2: float, from_share: float) -> None:
    simulated = _simulated(9)
    t_s = simulated.recording.t_s
    # Four cylinders idling at 800 rpm; it may be started halfway.
    hum = size_mps2 * np.sqrt(2.0) * np.sin(2.0 * np.pi * 27.0 * t_s) * (t_s >= from_share * t_s[-1])
    shaken = simulated.recording.accelerometer + hum[:, None] * np.array([0.4, 0.4, 1.0])
    _assert_found(simulated, find_static(_with(simulated.recording, shaken)))


@pytest.mark.parametrize("step_mps2", [0.0333, 0.3])
def test_coarse_converters(step_mps2: float) -> None:
    simulated = _simulated(10)
    rounded = np.rint(simulated.recording.accelerometer / step_mps2) * step_mps2
    found = find_static(_with(simulated.recording, rounded))
    _assert_found(simulated, found)
    # Noise of 0.03 m/s2 averages 0.0333 out but not 0.3: such a mean is off by up to half a step.
    exact = find_static(simulated.recording)
    off = np.abs(found.mean_accelerometer - exact.mean_accelerometer)
    sd = np.sqrt(np.diagonal(found.cov_accelerometer, axis1=1, axis2=2))
    assert (off < 3.0 * sd).mean() > 0.97
    assert (sd.min() > 0.2 * step_mps2) == (step_mps2 == 0.3)


def test_counts_without_any_noise() -> None:
    accelerometer = TriadErrors(full_scale=4.0 * 9.80665, random_walk=0.0, instability_sd=0.0)
    gyroscope = TriadErrors(full_scale=8.0, random_walk=0.0, instability_sd=0.0)
    simulated = _simulated(11, accelerometer_errors=accelerometer, gyroscope_errors=gyroscope)
    found = find_static(simulated.recording)
    _assert_found(simulated, found)
    step = accelerometer.step
    assert np.sqrt(np.diagonal(found.cov_accelerometer, axis1=1, axis2=2)) == pytest.approx(
        step * np.sqrt(0.5) / np.pi,
        rel=0.05,  # the first harmonic of the rounding's bias; the rest of it is 2 %
    )


def test_two_holds_with_the_same_orientation_are_two() -> None:
    twice = np.repeat(spread_orientations(6, np.random.default_rng(3)), 2, axis=0)
    simulated = _simulated(12, orientations=twice)
    _assert_found(simulated, find_static(simulated.recording), 0.5)
    _assert_found(simulated, find_static(_without_gyroscope(simulated.recording)), 0.5)


def test_a_knock_at_the_table_does_not_split_a_hold_and_is_no_part_of_its_mean() -> None:
    simulated = _simulated(13, hold_s=4.0)
    knocked = simulated.recording.accelerometer.copy()
    k = np.arange(40)
    blow = 3.0 * np.exp(-k / 8.0) * np.sin(2.0 * np.pi * 20.0 * k / RATE_HZ)
    for middle in (simulated.starts + simulated.ends) // 2:
        knocked[middle : middle + 40] += blow[:, None]
    found, calm = find_static(_with(simulated.recording, knocked)), find_static(simulated.recording)
    _assert_found(simulated, found)
    sd = np.sqrt(np.diagonal(calm.cov_accelerometer, axis1=1, axis2=2))
    # With the blow in it a mean would be off by 4 sd.
    assert np.abs(found.mean_accelerometer - calm.mean_accelerometer).max() < 2.0 * sd.max()


def test_a_box_on_a_turntable_is_not_still_though_its_accelerometer_is() -> None:
    simulated = _simulated(14)
    turned = simulated.recording.gyroscope.copy()
    inside = slice(int(simulated.starts[4]) - 100, int(simulated.ends[4]) + 100)
    turned[inside] += np.array([0.3, 0.0, 0.0])
    found = find_static(CalibrationRecording(simulated.recording.t_s, simulated.recording.accelerometer, turned))
    middle = int(simulated.starts[4] + simulated.ends[4]) // 2
    assert len(found) == 9
    assert not ((found.start <= middle) & (middle < found.end)).any()


def test_variances_of_means_are_those_that_repeated_holds_show() -> None:
    generator = np.random.default_rng(15)
    holds, rows = 400, 600
    signal = np.repeat(generator.normal(0.0, 5.0, (holds, 3)), rows, axis=0)
    noise = 0.03 * generator.standard_normal(signal.shape)
    # Half of it is correlated over 10 samples, as behind a digital filter.
    noise += np.repeat(0.03 * generator.standard_normal((holds * rows // 10, 3)), 10, axis=0)
    recording = CalibrationRecording(np.arange(holds * rows) / RATE_HZ, signal + noise)
    edges = np.arange(0, holds * rows + 1, rows)
    positions = StaticPositions.of(recording, edges[:-1], edges[1:])
    ratio = (positions.mean_accelerometer - signal[::rows]) / np.sqrt(
        np.diagonal(positions.cov_accelerometer, axis1=1, axis2=2)
    )
    # A variance out of 20 blocks makes it 1.05; that neighbouring blocks are correlated some per cent more.
    assert 1.0 < float(np.sqrt(np.mean(ratio**2))) < 1.15


def test_at_rest_from_end_to_end_is_one_position() -> None:
    generator, n = np.random.default_rng(16), 20_000
    for sd in (0.03, 0.0):
        still = np.array([0.1, 0.2, -9.8]) + sd * generator.standard_normal((n, 3))
        found = find_static(
            CalibrationRecording(np.arange(n) / RATE_HZ, still, 0.01 * generator.standard_normal((n, 3)))
        )
        assert len(found) == 1
        assert found.end[0] - found.start[0] > 0.98 * n


def test_a_hole_in_time_ends_a_hold() -> None:
    simulated = _simulated(17, hold_s=6.0)
    keep = np.ones(simulated.recording.t_s.size, dtype=bool)
    middle = int(simulated.starts[5] + simulated.ends[5]) // 2
    keep[middle - 20 : middle + 300] = False
    cut = CalibrationRecording(
        simulated.recording.t_s[keep], simulated.recording.accelerometer[keep], simulated.recording.gyroscope[keep]
    )
    found = find_static(cut)
    for start, end in zip(found.start, found.end, strict=True):
        assert np.diff(cut.t_s[start:end]).max() < 0.1


@pytest.mark.parametrize("with_gyroscope", [True, False])
def test_a_box_that_is_never_still_has_no_positions(with_gyroscope: bool) -> None:
    generator, t_s = np.random.default_rng(18), np.arange(20_000) / RATE_HZ
    waves = sum(
        np.sin(2.0 * np.pi * generator.uniform(0.2, 1.5, 3) * t_s[:, None] + generator.uniform(0.0, 6.0, 3))
        for _ in range(4)
    )
    moving = CalibrationRecording(
        t_s,
        2.0 * waves + np.array([0.0, 0.0, -9.8]) + 0.03 * generator.standard_normal(waves.shape),
        0.5 * waves + 0.01 * generator.standard_normal(waves.shape) if with_gyroscope else None,
    )
    with pytest.raises(InvalidInputError, match="never lies still for 2 s; lay it down in each position"):
        find_static(moving)


def test_saturated_axes_are_told_with_their_position() -> None:
    simulated = _simulated(19)
    reading = simulated.recording.accelerometer
    clipped = np.clip(reading, None, 8.0)
    with pytest.raises(InvalidInputError, match=r"axis is saturated at 8 in position \d+ of 10 .*wider range"):
        find_static(_with(simulated.recording, clipped))


def test_what_is_too_short_or_no_section_is_refused() -> None:
    recording = CalibrationRecording(np.arange(100) / RATE_HZ, np.ones((100, 3)))
    with pytest.raises(InvalidInputError, match=r"lasts 0\.5 s; expected at least 2 s"):
        find_static(recording)
    with pytest.raises(InvalidInputError, match="static position 2 is rows 50 to 200 of 100"):
        StaticPositions.of(recording, np.array([0, 50]), np.array([40, 200]))
    with pytest.raises(InvalidInputError, match="0 starts and 0 ends"):
        StaticPositions.of(recording, np.array([], dtype=int), np.array([], dtype=int))
    with pytest.raises(InvalidInputError, match=r"hold_s is 0\.1"):
        StaticSettings(hold_s=0.1)


def test_noise_of_other_sensors_changes_nothing_but_the_threshold() -> None:
    simulated = [
        _simulated(
            20,
            accelerometer_errors=replace(ACCELEROMETER, random_walk=factor * ACCELEROMETER.random_walk),
            gyroscope_errors=replace(GYROSCOPE, random_walk=factor * GYROSCOPE.random_walk),
        )
        for factor in (0.1, 4.0)
    ]
    found = [find_static(one.recording) for one in simulated]
    for one, positions in zip(simulated, found, strict=True):
        _assert_found(one, positions, 0.5)
    assert found[1].threshold > 5.0 * found[0].threshold
