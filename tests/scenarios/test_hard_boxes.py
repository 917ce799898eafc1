"""What a box that is shaken, badly made or badly served by its receiver does to the path, in a stream and after it."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np

from core.measurements import GNSS
from core.navigation.track import TRACK
from core.navigation.tuning import Tuning
from core.simulation.scenarios import simulate
from service.recordings.fusing import Outage, figures, fuse, fuse_config, track_errors, vehicle_config
from service.recordings.simulated import drive_of

OUTAGE = Outage(80.0, 30.0)


@functools.cache
def recorded(scenario="outages", seed=3, duration_s=150.0):
    """A drive with fixes throughout, in a car with springs on a road with bumps."""
    return drive_of(simulate(scenario, seed, duration_s, 100.0))


def with_measurements(drive, **changes):
    return replace(drive, measurements=replace(drive.measurements, **changes))


def fused(drive, outages, **how):
    return fuse(drive, fuse_config(vehicle_config(drive), every_s=0.1), outages, **how)


def inside_3_sd(drive, found, outage):
    """Share of the instants of an outage."""
    _, errors = track_errors(drive, found.track, ())
    inside = (errors.t_s >= outage.start_s) & (errors.t_s < outage.end_s)
    t_ns = found.track.t_ns
    sd_m = [
        np.interp(errors.t_ns - t_ns[0], t_ns - t_ns[0], found.track.values[:, TRACK[name]])
        for name in ("sd_n_m", "sd_e_m")
    ]
    return np.mean(np.all(np.abs(errors.ned_m[:, :2].T) <= 3.0 * np.array(sd_m), axis=0)[inside])


def test_a_reset_after_an_outage_puts_the_smoothed_path_right_and_widens_its_spread():
    """The accelerometer is off for ten seconds of it, as by an engine that beats with the sampling."""
    drive = recorded()
    t_s, f_s = drive.t_s(drive.measurements.imu_t_ns), drive.measurements.f_s.copy()
    f_s[(t_s >= 85.0) & (t_s < 95.0), 0] += 0.5
    drive = with_measurements(drive, f_s=f_s)
    causal, smooth = fused(drive, [OUTAGE]), fused(drive, [OUTAGE], smooth=True)
    assert causal.counts["gnss_position.reset"] == 1
    causal_m, smooth_m = (figures(drive, one, [OUTAGE])["outage_rms_m"] for one in (causal, smooth))
    assert inside_3_sd(drive, causal, OUTAGE) < 0.7  # the filter could not know
    assert smooth_m < causal_m / 5.0
    assert inside_3_sd(drive, smooth, OUTAGE) > 0.95


def test_smoothed_nothing_is_less_sure_than_filtered_however_what_fixes_claim_jumps():
    drive = recorded(duration_s=90.0)
    gnss = drive.measurements.gnss.copy()
    gnss[:, [GNSS["sd_h_m"], GNSS["sd_v_m"], GNSS["sd_v_mps"]]] = np.nan  # what is left is their dilution
    gnss[::2, GNSS["hdop"]] *= 1.5
    drive = with_measurements(drive, gnss=gnss)
    filtered, smooth = fused(drive, [], keep=True).solution, fused(drive, [], smooth=True).solution
    for axis in range(6):
        ratio = smooth.covariance[:, axis, axis] / filtered.covariance[:, axis, axis]
        assert ratio.max() < 1.0 + 1e-6, axis


def test_an_outage_refutes_nothing():
    """Some wild fixes that do not agree, then none: the filter keeps its path and does not align anew in the tunnel."""
    drive = recorded()
    t_s, gnss = drive.t_s(drive.measurements.gnss_t_ns), drive.measurements.gnss.copy()
    wild = np.flatnonzero((t_s >= 75.0) & (t_s < 80.0))
    gnss[wild, GNSS["lat_rad"]] += np.where(wild % 2, 1.0, -1.0) * 60.0 / 6.37e6
    found = fused(with_measurements(drive, gnss=gnss), [OUTAGE])
    assert found.counts["gnss_position.rejected_gate"] == 5
    assert "imu.reset" not in found.counts
    figure = figures(drive, found, [OUTAGE])["outages"][0]
    assert figure["max_m"] < 15.0  # 30 s without a fix cost up to 5 m in such drives, 60 s up to 16 m


def test_a_car_that_its_engine_shakes_stands_all_the_same():
    drive = recorded("engine_shaken", duration_s=60.0)  # by 1.5 m/s2; it stands for the first 15 s
    counts = fused(drive, []).counts
    assert counts["zupt.fused"] >= 40  # 5 Hz; of plain means it would be none


def test_axes_that_lean_are_allowed_for_once_a_turn_has_shown_it():
    """By 4 degrees, worse than any: then half of the error of a filter that takes them for square, and honest."""
    drive = recorded(seed=5)
    omega_s = drive.measurements.omega_s.copy()
    omega_s[:, :2] += np.radians(4.0) * omega_s[:, 2:]
    leaning = with_measurements(drive, omega_s=omega_s)

    def found(one, lean_sd_rad):
        config = fuse_config(vehicle_config(one), every_s=0.1)
        tuning = replace(config.filter.tuning, gyro_axes_sd_rad=lean_sd_rad)
        return fuse(one, replace(config, filter=replace(config.filter, tuning=tuning)), [OUTAGE])

    default = Tuning().gyro_axes_sd_rad
    doubting, trusting = found(leaning, default), found(leaning, 0.0)
    doubting_m, trusting_m = (figures(leaning, one, [OUTAGE])["outage_rms_m"] for one in (doubting, trusting))
    assert doubting_m < 0.6 * trusting_m  # 3.0 m against 6.8 m
    assert inside_3_sd(leaning, doubting, OUTAGE) > 0.95
    # A good box pays nothing for it.
    assert np.array_equal(found(drive, default).track.values, found(drive, 0.0).track.values, equal_nan=True)
