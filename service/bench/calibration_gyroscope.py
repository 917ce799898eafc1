"""The gyroscope's figures: simulated units against their truth, seed 1's table 3, and what no fit can go below."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any, Final

import numpy as np

from core.calibration.accelerometer import fit_accelerometer
from core.calibration.gyroscope import GYROSCOPE_PARAMETERS, fit_gyroscope
from core.calibration.gyroscope_problem import across
from core.calibration.static_intervals import StaticPositions, find_static
from core.calibration.turns import integrate
from core.earth import STANDARD_GRAVITY_MPS2
from core.measurements import FloatArray
from core.rotation import skew
from core.sensors import TriadCalibration, Triple
from core.simulation.calibration_recording import (
    Handling,
    SimulatedRecording,
    simulate_recording,
    spread_orientations,
    tipped,
)
from core.simulation.sensors import GYROSCOPE, UNCALIBRATED, draw_errors
from service.bench.calibration_targets import SEED1_TABLE_3
from service.bench.simulated_outages import Tell
from service.bench.stated_spread import over_stated

UNITS: Final = 500
REPEATED_UNITS: Final = 20
RECORDINGS: Final = 5
POSITIONS: Final = 24
ALIGNMENT_SD_RAD: Final = 0.015
"""Of the gyroscope's chip against the accelerometer's: a degree of soldering, as the units' misalignment."""

PROTOCOLS: Final = {
    "straight": Handling(),
    "twice_round": Handling(full_turns=2),
}
"""From one position to the next the short way about any axis; or, as ``telefuse calibrate`` recommends, twice right
round on the way, about an axis that is level. White noise grows with the root of a turn's time, what tells the scale
with its angle: once round is not enough for seed 1's table 3, three times bring a third less but reach 250 deg/s."""


MISALIGNMENT_PRODUCTS: Final = ("-SFx Mz", "SFx My", "-SFy Mx")
"""Of table 3."""


def measure(tell: Tell) -> dict[str, Any]:
    """Single recordings against truth, and repeated ones against each other and the least variance possible."""
    recorded = REPEATED_UNITS * RECORDINGS * len(PROTOCOLS)
    total = UNITS + recorded
    return {
        "units": against_truth(lambda done, _: tell(done, total)),
        "repeated": repeated(lambda done, all_: tell(UNITS + recorded * done / all_, total)),
        "least_turns": {name: least_turns(SEED1_TABLE_3[name]) for name in MISALIGNMENT_PRODUCTS},
    }


def against_truth(tell: Tell, units: int = UNITS) -> dict[str, Any]:
    """Simulated units with the device's whole noise, each recorded once: errors over what is stated of them."""
    ratios, iterations, weak, left_out, spent_ms = [], [], 0, 0, []
    for seed in range(units):
        tell(seed, units)
        triad, recorded = _recorded(seed, np.random.default_rng(seed), PROTOCOLS["straight"])
        positions = find_static(recorded.recording)
        accelerometer = fit_accelerometer(positions, STANDARD_GRAVITY_MPS2)
        started_s = time.perf_counter()
        fit = fit_gyroscope(recorded.recording, positions, accelerometer, STANDARD_GRAVITY_MPS2)
        spent_ms.append(1e3 * (time.perf_counter() - started_s))
        ratios.append((parameters(fit.calibration) - parameters(triad)) / np.sqrt(np.diag(fit.joint_covariance)))
        iterations.append(fit.iterations)
        weak += not fit.observability.observable
        left_out += fit.left_out
    return {
        "units": units,
        "positions": POSITIONS,
        **over_stated(ratios, GYROSCOPE_PARAMETERS),
        "iterations_max": max(iterations),
        "called_weak": weak,
        "turns_left_out": left_out,
        "fit_ms": float(np.median(spent_ms)),
    }


def repeated(tell: Tell, units: int = REPEATED_UNITS) -> dict[str, Any]:
    """By protocol: variances of the parameters over five recordings of each unit, the least that white noise of the
    rates allows (Cramer-Rao), and those of seed 1, table 3."""
    found = {}
    for done, (name, handling) in enumerate(PROTOCOLS.items()):
        variances, bounds = [], []
        for seed in range(units):
            tell(done * units + seed, len(PROTOCOLS) * units)
            rows = []
            for turn in range(RECORDINGS):
                triad, recorded = _recorded(seed, np.random.default_rng([seed, turn]), handling)
                positions = find_static(recorded.recording)
                accelerometer = fit_accelerometer(positions, STANDARD_GRAVITY_MPS2)
                fit = fit_gyroscope(recorded.recording, positions, accelerometer, STANDARD_GRAVITY_MPS2)
                rows.append(_table_3(fit.calibration))
            variances.append(np.var(rows, axis=0, ddof=1))
            bounds.append(bound(recorded, positions, triad))
        mean, largest, least = np.mean(variances, axis=0), np.max(variances, axis=0), np.mean(bounds, axis=0)
        found[name] = {
            row: {
                "mean": float(mean[i]),
                "largest": float(largest[i]),
                "cramer_rao": float(least[i]) if i < 6 else None,
                "seed1": limit,
            }
            for i, (row, limit) in enumerate(SEED1_TABLE_3.items())
        }
    return {"units": units, "recordings": RECORDINGS, "variances": found}


def bound(recorded: SimulatedRecording, positions: StaticPositions, triad: TriadCalibration) -> FloatArray:
    """Least variances (6,) of table 3's products by the turns of a recording, bias and both ups being known exactly.

    The inverse of Fisher's information with no noise but the data sheet's white noise of the rates.
    """
    recording = recorded.recording
    assert recording.gyroscope is not None
    forward = (triad.apply(np.eye(3)) - np.array(triad.bias)).T
    inverse = np.asarray(np.linalg.inv(forward))
    begin, end = (positions.end - 1)[:-1], positions.start[1:]
    bias = np.tile(triad.bias, (len(begin), 1))
    noise = np.full(3, GYROSCOPE.random_walk)
    turns = integrate(recording.t_s, recording.gyroscope, begin, end, inverse, bias, noise)
    up = -recorded.C_n_from_a[1:, 2]
    information = np.zeros((9, 9))
    for k in range(len(begin)):
        lever = across(up[k]).T @ skew(up[k])
        rows = lever @ turns.by_inverse[k].reshape(3, 9)
        information += rows.T @ np.linalg.inv(lever @ turns.covariance[k] @ lever.T) @ rows
    # A change of the inverse G is one of A = G^-1 by -A dG A; the products are those of its RQ decomposition.
    spread = np.linalg.inv(information)
    step = 1e-7
    by = np.column_stack(
        [
            (_products(inverse + d.reshape(3, 3)) - _products(inverse - d.reshape(3, 3))) / (2.0 * step)
            for d in step * np.eye(9)
        ]
    )
    return np.asarray(np.diag(by @ spread @ by.T))


def least_turns(variance: float) -> float:
    """Whole turns a move that a product of misalignment of no more than this variance takes at the very least.

    A turn by a about a fixed axis u shows a product by u_i u_j a, at most a / 2, while white noise of density N adds
    N^2 a / w of variance at a rate w: all moves at the full scale, about the best axis and for this product alone,
    everything else and up in each position known, have the variance 4 N^2 / (moves w a). A half turn's other
    contribution, at most 2, does not grow with a.
    """
    angle_rad = 4.0 * GYROSCOPE.random_walk**2 / ((POSITIONS - 1) * GYROSCOPE.full_scale * variance)
    return angle_rad / (2.0 * np.pi)


def parameters(calibration: TriadCalibration) -> FloatArray:
    """The twelve in the order of ``GYROSCOPE_PARAMETERS``."""
    return np.array([*calibration.scale, *calibration.misalignment, *calibration.bias, *calibration.alignment])


def _recorded(
    seed: int, generator: np.random.Generator, handling: Handling
) -> tuple[TriadCalibration, SimulatedRecording]:
    """A unit as it was soldered, by its seed, and a recording of it."""
    unit = np.random.default_rng([seed])
    errors = draw_errors(UNCALIBRATED, unit)
    alignment = ALIGNMENT_SD_RAD * unit.standard_normal(3)
    turned: Triple = (float(alignment[0]), float(alignment[1]), float(alignment[2]))
    gyroscope = replace(errors.gyroscope, alignment=turned)
    up = spread_orientations(POSITIONS, generator)
    recorded = simulate_recording(
        generator,
        accelerometer=errors.accelerometer,
        gyroscope=gyroscope,
        orientations=tipped(up) if handling.full_turns else up,
        initial_rest_s=5.0,
        handling=handling,
    )
    return gyroscope, recorded


def _table_3(calibration: TriadCalibration) -> FloatArray:
    (sx, sy, sz), (mx, my, mz) = calibration.scale, calibration.misalignment
    return np.array([sx, -sx * mz, sx * my, sy, -sy * mx, sz, *calibration.bias])


def _products(inverse: FloatArray) -> FloatArray:
    """SF M of the triad whose matrix has this inverse, as table 3 lists it, (6,)."""
    matrix = np.linalg.inv(inverse)
    # SF M (SF M)' = A A': its upper triangular root, by Cholesky from the last row on.
    upper = np.linalg.cholesky((matrix @ matrix.T)[::-1, ::-1])[::-1, ::-1]
    return np.array([upper[0, 0], upper[0, 1], upper[0, 2], upper[1, 1], upper[1, 2], upper[2, 2]])
