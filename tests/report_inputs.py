"""Inputs of a report with known numbers in them, so that what is drawn can be told to be right."""

from __future__ import annotations

import math

import numpy as np

from core.accident.events import Impact, Severity
from core.accident.placing import Accident, Place
from core.measurements import GNSS, GNSS_COLUMNS, Measurements
from core.navigation import state
from core.navigation.records import AidRecords
from core.navigation.solution import SLOW, SLOW_COLUMNS, Solution
from core.navigation.track import TRACK, TRACK_COLUMNS, Mode, Track
from core.session import MountingEstimate, SessionConfig
from service.recordings.drive_folder import Drive, Reference
from service.recordings.fusing import Fused, Outage, figures
from service.reports.navigation import NavigationReport

START_NS = 1_714_984_200_000_000_000
LAT_RAD, LON_RAD, ALT_M = math.radians(40.0), math.radians(-3.7), 640.0
M_PER_RAD = 6.37e6
"""Of the sphere on which the made-up drive goes: its metres need no ellipsoid."""


def report(seconds: int = 120, rate_hz: int = 50, name: str = "Tunnel & <crash>", reference: bool = True):
    """A circle driven with errors of 1 sd at most, an outage from 40 s to 60 s, one refused fix and one accident."""
    rng = np.random.default_rng(7)
    n = seconds * rate_hz
    t_s = np.arange(n) / rate_hz
    angle = t_s / 30.0
    north, east = 300.0 * np.sin(angle), 300.0 * np.cos(angle)
    lat = LAT_RAD + north / M_PER_RAD
    lon = LON_RAD + east / (M_PER_RAD * math.cos(LAT_RAD))
    t_ns = START_NS + np.rint(t_s * 1e9).astype(np.int64)
    outage = Outage(40.0, 20.0)
    inside = (t_s >= outage.start_s) & (t_s < outage.end_s)
    rows = np.zeros((n, len(TRACK_COLUMNS)))
    sd = np.where(inside, 1.0 + (t_s - outage.start_s) / 4.0, 1.0)
    signs = np.arange(n) % 3 - 1.0  # a median of none, so that no constant offset is taken off
    values = {
        "lat_rad": lat + signs * sd / M_PER_RAD, "lon_rad": lon, "alt_m": np.full(n, ALT_M),
        "vn_mps": 10.0 * np.cos(angle), "ve_mps": -10.0 * np.sin(angle), "yaw_rad": np.unwrap(np.pi / 2 + angle),
        "sd_n_m": sd, "sd_e_m": sd, "sd_d_m": 2.0 * sd, "cov_ne_m2": 0.3 * sd**2, "sd_yaw_rad": np.full(n, 0.01),
        "mode": np.where(inside, Mode.COASTING, Mode.AIDED),
    }  # fmt: skip
    for column, series in values.items():
        rows[:, TRACK[column]] = series
    rows[: 2 * rate_hz] = np.nan
    rows[: 2 * rate_hz, TRACK["mode"]] = Mode.ALIGNING
    track = Track(t_ns, rows)

    fixes = np.arange(0, n, rate_hz)
    gnss = np.full((len(fixes), len(GNSS_COLUMNS)), np.nan)
    gnss[:, GNSS["lat_rad"]], gnss[:, GNSS["lon_rad"]], gnss[:, GNSS["alt_m"]] = lat[fixes], lon[fixes], ALT_M
    gnss[:, GNSS["vn_mps"]], gnss[:, GNSS["ve_mps"]] = rows[fixes, TRACK["vn_mps"]], rows[fixes, TRACK["ve_mps"]]
    gnss[:, GNSS["vd_mps"]] = 0.0
    measurements = Measurements(
        imu_t_ns=t_ns, f_s=np.zeros((n, 3)), omega_s=np.zeros((n, 3)), gnss_t_ns=t_ns[fixes], gnss=gnss
    )
    truth = Reference(
        t_ns=t_ns, lat_rad=lat, lon_rad=lon, alt_m=np.full(n, ALT_M),
        v_n_mps=np.zeros((n, 3)), rpy_rad=np.column_stack([np.zeros(n), np.zeros(n), np.pi / 2 + angle]),
    )  # fmt: skip
    drive = Drive(name, START_NS, "van-1", measurements, reference=truth if reference else None)

    mounting = MountingEstimate(True, False, (0.0, 0.0, 0.0), (0.01, 0.01, 0.01))
    impact = Impact(
        t_ns=START_NS + 70_000_000_000, decided_t_ns=START_NS + 70_100_000_000, detector="telefuse",
        severity=Severity.SEVERE, confidence=0.9, delta_v_mps=9.0, delta_v_sd_mps=0.5, delta_v_b_mps=(-9.0, 0.0),
        pdof_deg=0.0, peak_mps2=150.0, duration_s=0.1, clipped=False, speed_before_mps=10.0, paper_agrees=True,
    )  # fmt: skip
    accident = Accident(impact, Place(LAT_RAD, LON_RAD, ALT_M, 1.0, 1.0, 0.0, 0.0, Mode.AIDED))
    counts = {"gnss_position.fused": 99, "gnss_position.rejected_gate": 1}
    fused = Fused(track, (accident,), counts, n, n * 1e-7, mounting)
    outages = [outage]
    return NavigationReport(
        drive, SessionConfig(), outages, fused, figures(drive, fused, outages), _solution(track), _records(t_s, rng)
    )


def _records(t_s, rng):
    """Positions each second with one of 6 sd at 80 s, and non-holonomic constraints at 5 Hz."""
    rows, times = [], []
    for aid, axes, every, sd in ((state.A_POSITION, 2, 1.0, 3.0), (state.A_NHC, 2, 0.2, 0.25)):
        at_s = np.arange(2.0, t_s[-1], every)
        if aid == state.A_POSITION:
            at_s = at_s[(at_s < 40.0) | (at_s >= 60.0)]
        for axis in range(axes):
            innovation = np.clip(rng.standard_normal(len(at_s)), -2.5, 2.5) * sd
            if aid == state.A_POSITION and axis == 0:
                innovation[np.searchsorted(at_s, 80.0)] = 6.0 * sd
            ratio = innovation**2 / (13.82 * sd**2)
            outcome = np.where(ratio > 1.0, state.REJECTED_GATE, state.FUSED)
            one = np.ones(len(at_s))
            rows.append(np.column_stack([aid * one, axis * one, innovation, sd**2 * one, ratio, outcome]))
            times.append(START_NS + np.rint(at_s * 1e9).astype(np.int64))
    t_ns, values = np.concatenate(times), np.concatenate(rows)
    order = np.argsort(t_ns, kind="stable")
    return AidRecords(t_ns[order], values[order])


def _solution(track):
    """Nodes each 0.1 s; a mounting of 2 deg pitch that is learnt; no barometer."""
    t_ns = track.t_ns[100::5]
    k = len(t_ns)
    slow, slow_sd = np.zeros((k, len(SLOW_COLUMNS))), np.full((k, len(SLOW_COLUMNS)), 0.01)
    slow[:, SLOW["mount_pitch_rad"]] = math.radians(2.0)
    slow_sd[:, SLOW["mount_pitch_rad"]] = np.radians(np.linspace(5.0, 0.25, k))
    slow_sd[:, SLOW["baro_bias_m"]] = 0.0
    return Solution(track, t_ns, np.tile(np.eye(9), (k, 1, 1)), slow, slow_sd)
