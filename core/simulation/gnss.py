"""A receiver whose errors hang together in time: drift, multipath in streets, gaps in tunnels."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from core.earth import radii_m
from core.measurements import GNSS, GNSS_COLUMNS, FloatArray
from core.sensors import Triple
from core.simulation.route import Sky, SkySpan
from core.simulation.sensors import gauss_markov
from core.simulation.trajectory import Trajectory, matrices_b_from_n, rotate
from core.tunables import Tunables, tunable

_UBLOX7 = "u-blox 7, CEP 2.5 m, velocity 0.1 m/s (data sheet UBX-12007115)"


@dataclass(frozen=True, slots=True)
class Receiver(Tunables):
    """Error budget of a single-frequency receiver. Default: u-blox 7. Horizontal sd are per axis."""

    rate_hz: float = tunable(1.0, unit="Hz", low=0.1, high=20.0, source="u-blox 7 in the Micro-iBB (seed 1)")
    drift_sd_m: float = tunable(1.2, unit="m", low=0.0, high=20.0, source=f"{_UBLOX7}: most of it drifts slowly")
    drift_s: float = tunable(90.0, unit="s", low=1.0, high=1e4, source="choice: ionosphere and orbits, minutes")
    white_sd_m: float = tunable(0.4, unit="m", low=0.0, high=20.0, source="choice: code noise after smoothing")
    vertical_ratio: float = tunable(1.8, unit="1", low=0.5, high=5.0, source="VDOP over HDOP under open sky")
    velocity_sd_mps: float = tunable(0.07, unit="m/s", low=0.0, high=2.0, source=_UBLOX7)
    stated_sd_m: float = tunable(1.5, unit="m", low=0.1, high=50.0, source="choice: what the receiver claims, open sky")
    stated_velocity_factor: float = tunable(
        1.3, unit="1", low=0.1, high=10.0, source="choice: receivers are a little pessimistic of their velocity"
    )
    stated_velocity_floor_mps: float = tunable(
        0.02, unit="m/s", low=0.0, high=1.0, source="choice: added to that; none claims to be better"
    )
    multipath_sd_m: float = tunable(5.0, unit="m", low=0.0, high=100.0, source="choice: street canyons 3-10 m")
    multipath_s: float = tunable(9.0, unit="s", low=0.5, high=1e3, source="choice: about a house front at city speed")
    multipath_velocity_sd_mps: float = tunable(0.25, unit="m/s", low=0.0, high=5.0, source="choice")
    wild_share: float = tunable(
        0.04, unit="1", low=0.0, high=1.0, source="choice: fixes in canyons from reflections alone"
    )
    wild_sd_m: float = tunable(25.0, unit="m", low=0.0, high=500.0, source="choice: size of such a wild fix")


def measure_gnss(
    truth: Trajectory,
    sky: tuple[SkySpan, ...],
    receiver: Receiver,
    lever_arm_b_m: Triple,
    rng: np.random.Generator,
) -> tuple[FloatArray, FloatArray]:
    """Times (m,) and rows (m, len(GNSS_COLUMNS)) of fixes: none under a tunnel, poor ones between houses.

    Position and velocity are those of the antenna, ``lever_arm_b_m`` from the box in body axes.
    """
    dt_s = 1.0 / receiver.rate_hz
    t_s: FloatArray = np.arange(math.floor(truth.t_s[-1] * receiver.rate_hz) + 1) * dt_s
    n = t_s.size
    canyon = np.zeros(n, dtype=bool)
    seen = np.ones(n, dtype=bool)
    for span in sky:
        inside = (t_s >= span.start_s) & (t_s < span.end_s)
        if span.kind is Sky.CANYON:
            canyon |= inside
        else:
            seen &= ~inside

    up = np.array([1.0, 1.0, receiver.vertical_ratio])
    drift = np.column_stack([gauss_markov(n, receiver.drift_sd_m, receiver.drift_s, dt_s, rng) for _ in range(3)])
    bent = np.column_stack(
        [gauss_markov(n, receiver.multipath_sd_m, receiver.multipath_s, dt_s, rng) for _ in range(3)]
    )
    # Reflections come and go over seconds, not at a line across the street.
    depth = np.convolve(canyon.astype(float), np.ones(5) / 5, mode="same")
    wild = canyon & (rng.random(n) < receiver.wild_share)
    position_error = (drift + receiver.white_sd_m * rng.standard_normal((n, 3)) + depth[:, None] * bent) * up
    position_error += wild[:, None] * receiver.wild_sd_m * rng.standard_normal((n, 3)) * up
    velocity_sd = np.hypot(receiver.velocity_sd_mps, depth * receiver.multipath_velocity_sd_mps)
    velocity_error = velocity_sd[:, None] * rng.standard_normal((n, 3)) * up

    antenna_n, antenna_v_n = _lever(truth, lever_arm_b_m)
    at = [np.interp(t_s, truth.t_s, series) for series in (truth.lat_rad, truth.lon_rad, truth.alt_m)]
    offset = np.column_stack([np.interp(t_s, truth.t_s, antenna_n[:, i]) for i in range(3)]) + position_error
    velocity = np.column_stack([np.interp(t_s, truth.t_s, truth.v_n[:, i] + antenna_v_n[:, i]) for i in range(3)])
    meridian, transverse = np.array([radii_m(lat) for lat in at[0]]).T

    # Choices within what receivers show: 9-12 satellites at HDOP about 1 in the open, 5-7 and worse in a street.
    satellites = np.where(canyon, rng.integers(5, 8, n), rng.integers(9, 13, n)).astype(float)
    hdop = np.where(canyon, 1.8 + 1.4 * rng.random(n), 0.9 + 0.3 * rng.random(n))
    rows = np.full((n, len(GNSS_COLUMNS)), np.nan)
    rows[:, GNSS["lat_rad"]] = at[0] + offset[:, 0] / (meridian + at[2])
    rows[:, GNSS["lon_rad"]] = at[1] + offset[:, 1] / ((transverse + at[2]) * np.cos(at[0]))
    rows[:, GNSS["alt_m"]] = at[2] - offset[:, 2]
    for i, name in enumerate(("vn_mps", "ve_mps", "vd_mps")):
        rows[:, GNSS[name]] = velocity[:, i] + velocity_error[:, i]
    # A receiver sees that a street is bad, though not how bad: it claims half of the multipath.
    stated = np.hypot(receiver.stated_sd_m, depth * receiver.multipath_sd_m / 2)
    rows[:, GNSS["sd_h_m"]] = np.round(stated, 2)
    rows[:, GNSS["sd_v_m"]] = np.round(stated * receiver.vertical_ratio, 2)
    stated_velocity = receiver.stated_velocity_factor * velocity_sd + receiver.stated_velocity_floor_mps
    rows[:, GNSS["sd_v_mps"]] = np.round(stated_velocity, 3)
    rows[:, GNSS["hdop"]] = np.round(hdop, 2)
    rows[:, GNSS["vdop"]] = np.round(hdop * receiver.vertical_ratio, 2)
    rows[:, GNSS["satellites"]] = satellites
    rows[:, GNSS["fix"]] = 3.0
    return t_s[seen], rows[seen]


def _lever(truth: Trajectory, arm_b_m: Triple) -> tuple[FloatArray, FloatArray]:
    """Where the antenna is against the box and how fast it moves round it, NED, (n, 3) each."""
    C_n_from_b = matrices_b_from_n(truth.rpy_rad).transpose(0, 2, 1)
    arm_b = np.broadcast_to(np.array(arm_b_m), truth.omega_b.shape)
    return rotate(C_n_from_b, arm_b), rotate(C_n_from_b, np.cross(truth.omega_b, arm_b))
