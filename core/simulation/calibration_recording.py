"""A box as it is calibrated: held in one position after another, turned by hand between them, with exact truth."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
import numpy.typing as npt

from core.calibration.recording import CalibrationRecording
from core.calibration.sphere import directions
from core.earth import EARTH_RATE_RADPS, STANDARD_GRAVITY_MPS2
from core.errors import InvalidInputError
from core.measurements import FloatArray
from core.rotation import rotation_vector_from_matrix
from core.sensors import TriadCalibration, Triple
from core.simulation.sensors import ACCELEROMETER, GYROSCOPE, TriadErrors, with_noise
from core.tunables import Tunables, tunable

IntArray = npt.NDArray[np.int64]

NO_TRIPLE: Final[Triple] = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Handling(Tunables):
    """How a hand turns a box from one position to the next, and how still it is between."""

    turn_radps: float = tunable(
        1.5, unit="rad/s", low=0.05, high=10.0, source="choice: mean rate of a brisk turn; its peak is 1.9 times that"
    )
    least_move_s: float = tunable(1.0, unit="s", low=0.1, high=60.0, source="choice: taking up and laying down")
    full_turns: int = tunable(
        0, unit="1", low=0, high=10, source="times that each move goes right round, about its own axis, on its way"
    )
    wobble_rad: float = tunable(0.15, unit="rad", low=0.0, high=1.0, source="choice: a hand turns about no fixed axis")
    tremor_rad: float = tunable(
        0.002, unit="rad", low=0.0, high=0.1, source="choice: 0.1 deg at 8-12 Hz, physiological tremor of a hand"
    )
    rest_share: float = tunable(
        0.0, unit="1", low=0.0, high=1.0, source="share of the tremor that is left in a position; 0: laid on a table"
    )
    shake_mps2: float = tunable(0.5, unit="m/s2", low=0.0, high=50.0, source="choice: tremor of a hand that moves")
    reach_m: float = tunable(0.2, unit="m", low=0.0, high=2.0, source="choice: way of the box between positions")


@dataclass(frozen=True, slots=True)
class Iron:
    """A magnetometer: measured = soft_iron @ field + hard_iron + noise, in microtesla, ``rate_hz`` times a second.

    The default is the LSM303DLHC (seed 1, table 1; 2 to 5 mG RMS) in the field of central Europe.
    """

    field_n_ut: Triple = (20.0, 1.0, 44.0)
    hard_iron_ut: Triple = NO_TRIPLE
    soft_iron: tuple[Triple, Triple, Triple] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    rate_hz: float = 50.0
    sd_ut: float = 0.4


@dataclass(frozen=True, slots=True)
class Warming:
    """A box that warms up: exponentially from ``start_c`` to ``end_c``; biases follow at so much a kelvin.

    The biases of the calibration hold at ``reference_c``. Slopes are m/s2 per K and rad/s per K; the default is the
    LSM303DLHC's 0.5 mg/K and the L3GD20's 0.03 deg/s/K (data sheets).
    """

    start_c: float = 20.0
    end_c: float = 40.0
    warming_s: float = 120.0
    reference_c: float = 25.0
    accelerometer_per_k: Triple = (0.0049, 0.0049, 0.0049)
    gyroscope_per_k: Triple = (5.2e-4, 5.2e-4, 5.2e-4)
    sensor_sd_c: float = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedRecording:
    """A recording and its truth: samples ``starts`` to ``ends`` (k,), end exclusive, are held in
    ``C_n_from_a`` (k, 3, 3), from the accelerometer's axes to north-east-down."""

    recording: CalibrationRecording
    starts: IntArray
    ends: IntArray
    C_n_from_a: FloatArray


def simulate_recording(
    generator: np.random.Generator,
    *,
    accelerometer: TriadCalibration,
    gyroscope: TriadCalibration,
    positions: int = 24,
    orientations: FloatArray | None = None,
    hold_s: float = 5.0,
    initial_rest_s: float = 30.0,
    rate_hz: float = 200.0,
    gravity_mps2: float = STANDARD_GRAVITY_MPS2,
    lat_rad: float = 0.82,
    accelerometer_errors: TriadErrors = ACCELEROMETER,
    gyroscope_errors: TriadErrors = GYROSCOPE,
    handling: Handling = Handling(),
    counts: tuple[int, int] | None = None,
    magnetometer: Iron | None = None,
    warming: Warming | None = None,
) -> SimulatedRecording:
    """Record a box that is laid in ``positions``, each for ``hold_s``, the first for ``initial_rest_s``.

    Attitude is an analytic function of time, so rates are exact values of that very motion.

    Parameters
    ----------
    accelerometer, gyroscope : what the triads really are; with ``counts`` their scales are counts per m/s2 (per
        rad/s) and their biases counts
    orientations : (k, 3, 3) C_n_from_a in north-east-down; default as many as ``positions``, evenly spread in random
        order and with random headings
    lat_rad : latitude, for the Earth's rate
    accelerometer_errors, gyroscope_errors : noise, full scale and converter; default the Micro-iBB (seed 1, table 1).
        What is left after a factory calibration is not drawn from them: the triads are given
    counts : least and greatest count of the converters; None gives m/s2 and rad/s in steps of the full scale's 2^15

    Raises
    ------
    InvalidInputError
        If there are fewer than 2 positions or a hold or rate is not positive.
    """
    if orientations is None:
        orientations = spread_orientations(positions, generator)
    if len(orientations) < 2 or min(hold_s, initial_rest_s, rate_hz) <= 0.0:
        raise InvalidInputError(
            f"{len(orientations)} positions held for {hold_s} s, the first for {initial_rest_s} s, at {rate_hz} Hz: "
            "expected at least 2 positions, and all above 0"
        )
    motion = _motion(orientations, hold_s, initial_rest_s, rate_hz, handling, generator)
    t_s, C_n_from_a, dt_s = motion.t_s, motion.C_n_from_a, 1.0 / rate_hz
    earth_n = EARTH_RATE_RADPS * np.array([math.cos(lat_rad), 0.0, -math.sin(lat_rad)])
    f_a = _into(C_n_from_a, motion.acceleration_n - np.array([0.0, 0.0, gravity_mps2]))
    omega_a = motion.omega_a + _into(C_n_from_a, earth_n)
    temperature_c = (
        None
        if warming is None
        else warming.end_c + (warming.start_c - warming.end_c) * np.exp(-t_s / warming.warming_s)
    )
    shown = []
    slopes = (NO_TRIPLE, NO_TRIPLE) if warming is None else (warming.accelerometer_per_k, warming.gyroscope_per_k)
    for true, triad, errors, per_k in (
        (f_a, accelerometer, accelerometer_errors, slopes[0]),
        (omega_a, gyroscope, gyroscope_errors, slopes[1]),
    ):
        if temperature_c is None or warming is None:
            noise = np.zeros_like(true)
        else:
            noise = np.outer(temperature_c - warming.reference_c, per_k)
        # Noise is the sensing element's, before the gain.
        signal = triad.apply(true) + np.array(triad.scale) * with_noise(noise, errors, dt_s, generator)
        step, low, high = (1.0, *counts) if counts is not None else (errors.step, -32768, 32767)
        shown.append(np.clip(np.rint(signal / step), low, high) * step)
    magnetic = None if magnetometer is None else _magnetic(C_n_from_a, magnetometer, rate_hz, generator)
    if temperature_c is not None and warming is not None:
        temperature_c = temperature_c + warming.sensor_sd_c * generator.standard_normal(t_s.size)
    recording = CalibrationRecording(t_s, shown[0], shown[1], magnetic, temperature_c)
    return SimulatedRecording(recording, motion.starts, motion.ends, orientations)


def spread_orientations(count: int, generator: np.random.Generator) -> FloatArray:
    """C_n_from_a (count, 3, 3) whose up directions cover the sphere evenly, in random order and with any heading."""
    up = generator.permutation(directions(count)) @ np.linalg.qr(generator.standard_normal((3, 3)))[0]
    aside = np.cross(up, generator.standard_normal((count, 3)))
    aside /= np.linalg.norm(aside, axis=1)[:, None]
    return np.stack([aside, np.cross(-up, aside), -up], axis=1)


def tipped(C_n_from_a: FloatArray) -> FloatArray:
    """The same up directions (n, 3, 3) with headings such that each turn to the next is about a level axis."""
    up_a = -C_n_from_a[:, 2]
    found = [C_n_from_a[0]]
    for before, after in pairwise(up_a):
        axis_a = np.cross(before, after)
        sine = float(np.linalg.norm(axis_a))
        if sine < 1e-9:  # the same way up, or upside down: about any axis across
            axis_a, sine = np.linalg.svd(before[None])[2][1], 1.0
        angle_rad = math.atan2(float(np.linalg.norm(np.cross(before, after))), float(before @ after))
        found.append(found[-1] @ rotations(-angle_rad / sine * axis_a[None])[0])
    return np.array(found)


def rotations(vectors_rad: FloatArray) -> FloatArray:
    """Matrices (n, 3, 3) of rotation vectors (n, 3), rad: exp of their cross products (Rodrigues)."""
    return _series(vectors_rad, *_sines(vectors_rad))


@dataclass(frozen=True, slots=True, eq=False)
class _Motion:
    t_s: FloatArray
    C_n_from_a: FloatArray
    omega_a: FloatArray
    acceleration_n: FloatArray
    starts: IntArray
    ends: IntArray


def _motion(
    orientations: FloatArray,
    hold_s: float,
    initial_rest_s: float,
    rate_hz: float,
    handling: Handling,
    generator: np.random.Generator,
) -> _Motion:
    """C_n_from_a(t) = C_i exp(s(t) phi_i) exp(tremor(t)): a turn about one axis, and what the hand adds to it."""
    steps = np.array([rotation_vector_from_matrix(a.T @ b) for a, b in pairwise(orientations)])
    length = np.linalg.norm(steps, axis=1)
    steps[length > 0.0] *= (1.0 + 2.0 * math.pi * handling.full_turns / length[length > 0.0])[:, None]
    held = np.r_[initial_rest_s, np.full(len(steps), hold_s)]
    moving = handling.least_move_s + np.linalg.norm(steps, axis=1) / handling.turn_radps
    begins = np.cumsum(np.r_[0.0, held[:-1] + moving])  # of each position
    t_s = np.arange(math.floor((begins[-1] + held[-1]) * rate_hz)) / rate_hz
    at = np.searchsorted(begins, t_s, side="right") - 1
    in_move = np.minimum(at, len(steps) - 1)
    tau = np.where(at < len(steps), np.clip((t_s - begins[at] - held[at]) / moving[in_move], 0.0, 1.0), 0.0)
    duration, step = moving[in_move], steps[in_move]

    # The least jerk between two rests (Flash & Hogan 1985): a quintic.
    share = tau**3 * (10.0 - 15.0 * tau + 6.0 * tau**2)
    share_rate = 30.0 * (tau * (1.0 - tau)) ** 2 / duration
    share_accel = 60.0 * tau * (1.0 - tau) * (1.0 - 2.0 * tau) / duration**2
    hump = 64.0 * (tau * (1.0 - tau)) ** 3
    hump_rate = 192.0 * (tau * (1.0 - tau)) ** 2 * (1.0 - 2.0 * tau) / duration

    wobble, wobble_rate = _waves(t_s, (0.3, 1.2), handling.wobble_rad, generator)
    tremor, tremor_rate = _waves(t_s, (8.0, 12.0), handling.tremor_rad, generator)
    still = handling.rest_share + (1.0 - handling.rest_share) * hump
    still_rate = (1.0 - handling.rest_share) * hump_rate
    off = hump[:, None] * wobble + still[:, None] * tremor
    off_rate = (
        hump_rate[:, None] * wobble
        + hump[:, None] * wobble_rate
        + still_rate[:, None] * tremor
        + still[:, None] * tremor_rate
    )
    C_turn, C_off = rotations(share[:, None] * step), rotations(off)
    omega_a = _into(C_off, share_rate[:, None] * step) + _body_rates(off, off_rate)
    way_n = handling.reach_m * generator.standard_normal((len(steps), 3))
    shake, _ = _waves(t_s, (8.0, 12.0), handling.shake_mps2, generator)
    acceleration_n = share_accel[:, None] * way_n[in_move] + still[:, None] * shake

    starts = np.ceil(begins * rate_hz - 1e-9).astype(np.int64)
    ends = np.minimum(np.floor((begins + held) * rate_hz + 1e-9).astype(np.int64) + 1, t_s.size)
    C_n_from_a = orientations[at] @ C_turn @ C_off
    return _Motion(t_s, C_n_from_a, omega_a, acceleration_n, starts, ends)


def _waves(
    t_s: FloatArray, band_hz: tuple[float, float], sd: float, generator: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Three sines an axis within a band, (n, 3), of that standard deviation, and their rates of change."""
    values, rates = np.zeros((t_s.size, 3)), np.zeros((t_s.size, 3))
    for _ in range(3):
        angular = 2.0 * math.pi * generator.uniform(*band_hz, 3)
        angle = np.outer(t_s, angular) + generator.uniform(0.0, 2.0 * math.pi, 3)
        size = sd * math.sqrt(2.0 / 3.0)
        values += size * np.sin(angle)
        rates += size * angular * np.cos(angle)
    return values, rates


def _magnetic(C_n_from_a: FloatArray, magnetometer: Iron, rate_hz: float, generator: np.random.Generator) -> FloatArray:
    field_a = _into(C_n_from_a, np.array(magnetometer.field_n_ut))
    shown = field_a @ np.array(magnetometer.soft_iron).T + np.array(magnetometer.hard_iron_ut)
    every = max(1, round(rate_hz / magnetometer.rate_hz))
    rows: FloatArray = np.full(shown.shape, np.nan)
    rows[::every] = shown[::every] + magnetometer.sd_ut * generator.standard_normal((len(shown[::every]), 3))
    return rows


def _into(C_from: FloatArray, vectors: FloatArray) -> FloatArray:
    """Vectors (n, 3) or (3,) told in the axes that C_from (n, 3, 3) leads out of."""
    return np.asarray(np.einsum("nji,nj->ni", C_from, np.broadcast_to(vectors, (len(C_from), 3))))


def _body_rates(vectors: FloatArray, rates: FloatArray) -> FloatArray:
    """Angular rate in body axes of exp(vectors(t)): its right Jacobian times the rate (Chirikjian 2012, eq. 10.86)."""
    square = np.maximum(np.einsum("ni,ni->n", vectors, vectors), 1e-16)
    sine, cosine = _sines(vectors)
    return np.asarray(np.einsum("nij,nj->ni", _series(vectors, -cosine, (1.0 - sine) / square), rates))


def _sines(vectors: FloatArray) -> tuple[FloatArray, FloatArray]:
    """sin(a)/a and (1 - cos(a))/a^2 of lengths a, (n,) each."""
    angle = np.linalg.norm(vectors, axis=1)
    return np.asarray(np.sinc(angle / math.pi)), np.asarray(0.5 * np.sinc(0.5 * angle / math.pi) ** 2)


def _series(vectors: FloatArray, first: FloatArray, second: FloatArray) -> FloatArray:
    """I + first [v x] + second [v x]^2, (n, 3, 3)."""
    cross = np.zeros((len(vectors), 3, 3))
    x, y, z = vectors.T
    cross[:, 0, 1], cross[:, 0, 2], cross[:, 1, 2] = -z, y, -x
    cross[:, 1, 0], cross[:, 2, 0], cross[:, 2, 1] = z, -y, x
    return np.asarray(np.eye(3) + first[:, None, None] * cross + second[:, None, None] * (cross @ cross))
