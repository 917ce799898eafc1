"""The simulated calibration recording: its rates, gravity and field are those of one and the same motion."""

from __future__ import annotations

import numpy as np
import pytest

from core.earth import EARTH_RATE_RADPS, STANDARD_GRAVITY_MPS2
from core.errors import InvalidInputError
from core.sensors import TriadCalibration
from core.simulation.calibration_recording import (
    Handling,
    Iron,
    SimulatedRecording,
    Warming,
    rotations,
    simulate_recording,
    spread_orientations,
    tipped,
)
from core.simulation.sensors import TriadErrors

PERFECT = TriadCalibration()
QUIET = TriadErrors(full_scale=100.0, random_walk=0.0, bias_sd=0.0, instability_sd=0.0)


def quiet_recording(**changes: object) -> SimulatedRecording:
    settings = {
        "accelerometer": PERFECT,
        "gyroscope": PERFECT,
        "accelerometer_errors": QUIET,
        "gyroscope_errors": QUIET,
        "initial_rest_s": 2.0,
        "hold_s": 1.0,
        "positions": 8,
    } | changes
    return simulate_recording(np.random.default_rng(3), **settings)  # type: ignore[arg-type]


def test_rates_lead_from_each_position_to_the_next() -> None:
    made = quiet_recording(rate_hz=500.0)
    assert made.recording.gyroscope is not None
    rates, C = made.recording.gyroscope, made.C_n_from_a[0]
    turns = rotations(0.5 * (rates[1:] + rates[:-1]) / 500.0)
    reached = [C]
    for turn in turns:
        C = C @ turn
        reached.append(C)
    for at, expected in zip(made.starts, made.C_n_from_a, strict=True):
        # The Earth turns 2e-3 rad in these 25 s; trapezoids at 500 Hz add 1e-4.
        assert np.abs(reached[at] - expected).max() < 3e-3


def test_a_box_that_is_tipped_goes_right_round_about_level_axes() -> None:
    orientations = tipped(spread_orientations(8, np.random.default_rng(5)))
    handling = Handling(full_turns=2, wobble_rad=0.0, tremor_rad=0.0)
    made = quiet_recording(rate_hz=400.0, orientations=orientations, handling=handling)
    assert made.recording.gyroscope is not None
    up = -orientations[:, 2]
    assert up == pytest.approx(-spread_orientations(8, np.random.default_rng(5))[:, 2], abs=1e-12)
    for i, (end, start) in enumerate(zip(made.ends[:-1], made.starts[1:], strict=True)):
        turned = made.recording.gyroscope[end - 1 : start + 1].sum(axis=0) / 400.0
        between = np.arccos(up[i] @ up[i + 1])
        # The Earth adds 1e-3 rad in a move, the converter's step of 0.003 rad/s averages out.
        assert np.linalg.norm(turned) == pytest.approx(4.0 * np.pi + between, abs=5e-3)
        assert turned @ up[i] == pytest.approx(0.0, abs=5e-3)


def test_a_box_at_rest_feels_gravity_and_the_earth_alone() -> None:
    made = quiet_recording()
    assert made.recording.gyroscope is not None
    for start, end, C_n_from_a in zip(made.starts, made.ends, made.C_n_from_a, strict=True):
        up_a = -C_n_from_a[2]
        # A step of the converter is 100 / 2^15 = 0.003.
        assert np.abs(made.recording.accelerometer[start:end] - STANDARD_GRAVITY_MPS2 * up_a).max() < 0.002
        assert np.abs(made.recording.gyroscope[start:end]).max() < 0.002 + EARTH_RATE_RADPS
    assert np.all(made.starts[1:] > made.ends[:-1])
    assert made.ends[-1] == len(made.recording.t_s)


def test_a_hand_that_is_never_still_moves_in_the_positions_too() -> None:
    made = quiet_recording(handling=Handling(rest_share=0.2))
    assert made.recording.gyroscope is not None
    first = made.recording.gyroscope[made.starts[0] : made.ends[0]]
    # 0.002 rad at some 10 Hz is 0.13 rad/s, a fifth of it is left.
    assert 0.015 < first.std() < 0.04


def test_counts_are_whole_and_within_the_converter() -> None:
    made = quiet_recording(
        accelerometer=TriadCalibration((415.0,) * 3, bias=(32768.0,) * 3),
        gyroscope=TriadCalibration((30000.0,) * 3, bias=(32768.0,) * 3),
        counts=(0, 65535),
    )
    assert made.recording.gyroscope is not None
    for values in (made.recording.accelerometer, made.recording.gyroscope):
        assert np.array_equal(values, np.rint(values))
        assert values.min() >= 0.0
        assert values.max() <= 65535.0
    assert (made.recording.gyroscope == 65535.0).any()


def test_the_field_keeps_its_strength_through_all_attitudes_until_iron_bends_it() -> None:
    made = quiet_recording(magnetometer=Iron(sd_ut=0.0))
    assert made.recording.magnetometer is not None
    seen = made.recording.magnetometer[np.isfinite(made.recording.magnetometer[:, 0])]
    assert len(seen) == pytest.approx(len(made.recording.t_s) / 4, abs=1)
    assert np.linalg.norm(seen, axis=1) == pytest.approx(np.linalg.norm(Iron().field_n_ut), abs=1e-9)
    bent = quiet_recording(magnetometer=Iron(sd_ut=0.0, hard_iron_ut=(10.0, 0.0, -5.0)))
    assert bent.recording.magnetometer is not None
    assert np.ptp(np.linalg.norm(bent.recording.magnetometer[::4], axis=1)) > 10.0


def test_biases_follow_the_temperature() -> None:
    warming = Warming(warming_s=5.0, gyroscope_per_k=(0.01, 0.0, 0.0))
    made = quiet_recording(warming=warming)
    assert made.recording.gyroscope is not None
    assert made.recording.temperature_c is not None
    first, last = made.recording.gyroscope[0, 0], made.recording.gyroscope[-1, 0]
    rise_k = made.recording.temperature_c[-50:].mean() - made.recording.temperature_c[:50].mean()
    assert rise_k == pytest.approx(20.0, abs=1.0)
    assert last - first == pytest.approx(0.01 * rise_k, abs=0.01)


def test_orientations_cover_the_sphere() -> None:
    C_n_from_a = spread_orientations(40, np.random.default_rng(5))
    assert np.abs(C_n_from_a @ C_n_from_a.transpose(0, 2, 1) - np.eye(3)).max() < 1e-12
    assert np.linalg.det(C_n_from_a) == pytest.approx(1.0)
    up = -C_n_from_a[:, 2]
    # Directions spread evenly have second moments of a third each way.
    assert np.linalg.eigvalsh(up.T @ up / len(up)) == pytest.approx(1.0 / 3.0, abs=0.02)


def test_too_few_positions_are_refused() -> None:
    with pytest.raises(InvalidInputError, match="at least 2 positions"):
        quiet_recording(positions=1)
