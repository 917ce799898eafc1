"""What errs slowly is known and learnt: fixes that drift or come late, a gyroscope's scale, the weather, the iron."""

from __future__ import annotations

import functools
import math
from dataclasses import replace

import numpy as np
import pytest

from core.earth import ned_offset_m
from core.measurements import GNSS
from core.navigation import state
from core.navigation.track import TRACK, Mode
from core.navigation.tuning import Tuning
from core.rotation import wrap_angle_rad
from core.session import Session
from core.simulation.gnss import Receiver, measure_gnss
from core.simulation.scenarios import simulate
from service.recordings.fusing import fuse, fuse_config, vehicle_config
from service.recordings.simulated import drive_of

S = 10**9
SEEDS = [1, 2, 3, 4, 5]
LEARNT_S = 90.0
"""From then on fixes have told how they err: ``Tuning.gnss_learn_fixes``, 60 at 1 Hz, after the alignment."""


class Driven:
    """A simulated drive, with its measurements changed, through a session; row by row against the truth."""

    def __init__(self, scenario, seed, duration_s, *, rate_hz=100.0, change=None, non_holonomic=True, **tunables):
        drive = drive_of(simulate(scenario, seed, duration_s, rate_hz))
        config = fuse_config(vehicle_config(drive), every_s=0.1, non_holonomic=non_holonomic)
        tuning = replace(config.filter.tuning, **tunables)
        self.session = Session(replace(config, filter=replace(config.filter, tuning=tuning)))
        m = drive.measurements
        outputs = self.session.step(m if change is None else change(m, drive.start_t_ns))
        track, reference = outputs.track, drive.reference
        navigating = track.column("mode") != Mode.ALIGNING
        t_ns, self.rows = track.t_ns[navigating], track.values[navigating]
        self.t_s, self.truth = (t_ns - drive.start_t_ns) * 1e-9, drive.truth

        def at(series):
            return np.interp(t_ns, reference.t_ns, series)

        origin = (reference.lat_rad[0], reference.lon_rad[0], reference.alt_m[0])
        true = ned_offset_m(at(reference.lat_rad), at(reference.lon_rad), at(reference.alt_m), origin)
        self.error_n = ned_offset_m(*self.rows[:, :3].T, origin) - true
        self.sd_n = self.rows[:, TRACK["sd_n_m"] : TRACK["sd_n_m"] + 3]
        self.yaw_error = wrap_angle_rad(self.rows[:, TRACK["yaw_rad"]] - at(np.unwrap(reference.rpy_rad[:, 2])))

    def between(self, low_s, high_s):
        return (self.t_s >= low_s) & (self.t_s < high_s)

    def estimate(self, x_index, error_index):
        """A state and its sd."""
        nav = self.session.filter
        return float(nav.x[x_index]), math.sqrt(nav.covariance()[error_index, error_index])

    def normalised_square(self):
        """Mean of the horizontal error's square by its covariance, 2 where they agree."""
        a, b, c = self.sd_n[:, 0] ** 2, self.sd_n[:, 1] ** 2, self.rows[:, TRACK["cov_ne_m2"]]
        n, e = self.error_n[:, 0], self.error_n[:, 1]
        squares = (b * n * n - 2.0 * c * n * e + a * e * e) / (a * b - c * c)
        return float(squares[self.t_s > LEARNT_S].mean())

    def inside_three_sd(self):
        """Share of the rows, north and east."""
        inside = np.abs(self.error_n[:, :2]) <= 3.0 * self.sd_n[:, :2]
        return inside[self.t_s > LEARNT_S].mean(axis=0)

    def count(self, aid, outcome):
        return int(self.session.filter.counts[aid, outcome])


@functools.cache
def driven(scenario, seed, duration_s):
    return Driven(scenario, seed, duration_s)


def without_fixes(m, start_ns, from_s, until_s):
    kept = (m.gnss_t_ns < start_ns + from_s * S) | (m.gnss_t_ns >= start_ns + until_s * S)
    return replace(m, gnss_t_ns=m.gnss_t_ns[kept], gnss=m.gnss[kept])


# The covariance's own rate


@pytest.mark.parametrize("seed", SEEDS[:3])
def test_a_covariance_at_ten_hertz_costs_millimetres_against_one_at_every_sample(seed):
    coarse, fine = (
        Driven("exact_outages", seed, 260.0, rate_hz=200.0, covariance_interval_s=interval_s)
        for interval_s in (0.1, 0.005)
    )
    assert coarse.truth["outages"][0]["duration_s"] == 60.0
    # The design's claim is 3 mm horizontally; a centimetre of position is what it has to stay below.
    assert np.abs(coarse.error_n - fine.error_n).max() < 0.01
    assert coarse.sd_n == pytest.approx(fine.sd_n, rel=2e-3)
    assert coarse.session.filter.counts.tolist() == fine.session.filter.counts.tolist()  # standstill and constraints


# Fixes that drift


@pytest.mark.parametrize("seed", SEEDS)
def test_a_receiver_that_drifts_is_known_to(seed):
    drive = driven("highway", seed, 600.0)
    assert drive.session.filter.x[state.X_WHITE_SHARE] < 0.3  # of 1.5 m stated, 0.4 m are white: 0.07
    assert (drive.inside_three_sd() >= 0.99).all()
    assert drive.normalised_square() < 4.0  # of 2: a drift of 90 s shows 600 s few independent errors


@pytest.mark.parametrize("seed", SEEDS)
def test_a_receiver_that_is_white_is_known_to(seed):
    drive = driven("exact_outages", seed, 600.0)
    share = drive.session.filter.x[state.X_WHITE_SHARE]
    assert 0.7 < share < 1.3  # 60 fixes of two axes: known to 13 %
    assert (drive.inside_three_sd() >= 0.99).all()
    assert 0.4 < drive.normalised_square() < 3.0  # of 2: a share of 15 % is kept for what may be slow after all


def test_between_houses_the_spread_grows_by_what_the_receiver_hides():
    # In a canyon the simulated receiver states half of a multipath of 5 m: innovations tell, after some fixes.
    inside = np.array([driven("city", seed, 900.0).inside_three_sd() for seed in SEEDS])
    assert inside.mean() >= 0.99


# Fixes of a receiver that does not say how good it is


UNSTATED = ("sd_h_m", "sd_v_m", "hdop", "vdop")


def received(receiver, seed, ramp_at_s=None):
    """The drive's fixes by another receiver, under open sky, with no accuracy stated."""

    def change(m, start_ns):
        truth = simulate("outages", seed, 300.0, 100.0).trajectory
        t_s, rows = measure_gnss(truth, (), receiver, (0.0, 0.0, 0.0), np.random.default_rng(seed))
        rows[:, [GNSS[name] for name in UNSTATED]] = np.nan
        if ramp_at_s is not None:
            off_m = np.clip(t_s - ramp_at_s, 0.0, 15.0)  # reflections that drift off by 1 m/s
            rows[:, GNSS["lat_rad"]] += np.where(t_s < ramp_at_s + 20.0, off_m, 0.0) / 6.37e6
        return replace(m, gnss_t_ns=start_ns + np.rint(t_s * S).astype(np.int64), gnss=rows)

    return change


FINE = Receiver(drift_sd_m=0.3, white_sd_m=0.05)
HIDING = Receiver(drift_sd_m=2.0, drift_s=600.0, white_sd_m=0.1)
"""Off by as much as is assumed of a receiver that states nothing, and for so long that no fix shows it."""
QUICK = Receiver(drift_sd_m=2.0, drift_s=30.0, white_sd_m=0.3)


def moving_share(drive):
    return float(drive.session.filter.x[state.X_MOVING])


@pytest.mark.parametrize("seed", SEEDS[:3])
def test_a_receiver_that_keeps_to_the_path_is_known_to_and_its_offset_is_not(seed):
    fine = Driven("outages", seed, 300.0, change=received(FINE, seed))
    hiding = Driven("outages", seed, 300.0, change=received(HIDING, seed))
    # 0.3 m of drift over 2.1 m assumed is 2 % of the variance; three times that by white fixes, path, and prudence.
    assert moving_share(fine) < 0.1
    late = fine.t_s > LEARNT_S
    assert np.sqrt(np.mean(np.sum(fine.error_n[late, :2] ** 2, axis=1))) < 1.0  # twice 0.3 m of two axes
    for drive in (fine, hiding):
        assert (drive.inside_three_sd() >= 0.99).all()
        # What is assumed of such a receiver is not lost: the spread told of the position stays near it.
        assert drive.sd_n[drive.t_s > LEARNT_S, :2].min() > 0.7 * Tuning().gnss_sd_h_m


@pytest.mark.parametrize("seed", SEEDS[:3])
def test_a_receiver_that_drifts_quickly_is_not_taken_for_a_better_one(seed):
    drive = Driven("outages", seed, 300.0, change=received(QUICK, seed))
    assert moving_share(drive) > 0.5
    assert (drive.inside_three_sd() >= 0.99).all()


def test_after_the_drive_an_offset_that_no_fix_shows_stays_in_the_spread():
    # Of seeds 1 to 4 the one whose offset is largest, 3.5 m.
    drive = drive_of(simulate("outages", 4, 300.0, 100.0))
    drive = replace(drive, measurements=received(HIDING, 4)(drive.measurements, drive.start_t_ns))
    track, reference = fuse(drive, fuse_config(vehicle_config(drive), every_s=0.1), smooth=True).track, drive.reference
    late = (track.column("mode") != Mode.ALIGNING) & (drive.t_s(track.t_ns) > LEARNT_S)
    rows, t_ns = track.values[late], track.t_ns[late]
    origin = tuple(float(series[0]) for series in (reference.lat_rad, reference.lon_rad, reference.alt_m))
    true = [np.interp(t_ns, reference.t_ns, s) for s in (reference.lat_rad, reference.lon_rad, reference.alt_m)]
    error_n = ned_offset_m(*rows[:, :3].T, origin) - ned_offset_m(*true, origin)
    sd_n = rows[:, TRACK["sd_n_m"] : TRACK["sd_n_m"] + 2]
    assert (np.abs(error_n[:, :2]) <= 3.0 * sd_n).mean(axis=0).min() >= 0.99


def test_what_was_learnt_of_the_drift_does_not_outlive_reflections():
    ramped, plain = (Driven("outages", 1, 300.0, change=received(FINE, 1, at_s)) for at_s in (120.0, None))
    shares = []
    for drive in (ramped, plain):
        after = drive.between(150.0, 300.0)  # they end at 140 s, and ten seconds of good fixes bring it back
        assert (np.abs(drive.error_n[after, :2]) <= 3.0 * drive.sd_n[after, :2]).mean() >= 0.99
        shares.append(moving_share(drive))
    assert shares[0] < 0.5  # and three minutes later it is known again, if not as well


# Fixes that come late, unsaid


def late_by(late_s):
    return lambda m, start_ns: replace(m, gnss_t_ns=m.gnss_t_ns + round(late_s * S))


@pytest.mark.parametrize("scenario", ["city", "exact_outages"])
@pytest.mark.parametrize("seed", SEEDS)
def test_a_receivers_delay_is_found(scenario, seed):
    delayed = Driven(scenario, seed, 300.0, change=late_by(0.2))
    delay_s, sd_s = delayed.estimate(state.X_GNSS_DELAY, state.GNSS_DELAY)
    assert sd_s < 0.02
    assert abs(delay_s - 0.2) < 3.0 * sd_s


# A gyroscope's scale


@pytest.mark.parametrize("seed", SEEDS)
def test_a_gyroscopes_scale_is_found(seed):
    def shrunk(m, start_ns):
        omega_s = m.omega_s.copy()
        omega_s[:, 2] *= 0.99
        return replace(m, omega_s=omega_s)

    drive = Driven("exact_outages", seed, 300.0, change=shrunk)
    scale, sd = drive.estimate(state.X_GYRO_SCALE, state.GYRO_SCALE)
    assert sd < 0.003
    assert abs(scale - (1.0 / 0.99 - 1.0)) < 3.0 * sd


# The Earth's fields


@pytest.mark.parametrize("seed", SEEDS[:3])
def test_a_heading_stays_within_the_magnetometers_spread_through_twelve_minutes_without_a_fix(seed):
    drive = Driven("city", seed, 900.0, change=lambda m, start_ns: without_fixes(m, start_ns, 120, 880))
    late = drive.between(700, 880)
    assert drive.count(state.A_MAGNETOMETER, state.FUSED) > 700
    assert np.abs(drive.yaw_error[late]).max() < Tuning().magnetic_sd_rad
    assert (np.abs(drive.yaw_error[late]) < 3.0 * drive.rows[late, TRACK["sd_yaw_rad"]]).all()


def test_a_field_that_is_disturbed_for_half_a_minute_is_left_out():
    def beside_a_tram(m, start_ns):
        field = m.magnetic_s_ut.copy()
        near = (m.magnetometer_t_ns >= start_ns + 200 * S) & (m.magnetometer_t_ns < start_ns + 230 * S)
        field[near] *= 1.4
        return replace(m, magnetic_s_ut=field)

    disturbed, plain = (Driven("city", 1, 400.0, change=change) for change in (beside_a_tram, None))
    refused = [one.count(state.A_MAGNETOMETER, state.REJECTED_RANGE) for one in (disturbed, plain)]
    assert refused[0] >= refused[1] + 30  # one a second
    assert disturbed.count(state.A_MAGNETOMETER, state.FUSED) > 300
    assert np.abs(disturbed.yaw_error - plain.yaw_error)[disturbed.t_s > 230.0].max() < math.radians(0.5)


@pytest.mark.parametrize("seed", SEEDS[:3])
def test_a_barometer_bounds_the_height_where_nothing_else_does(seed):
    def deaf(m, start_ns):
        m = without_fixes(m, start_ns, 200, 500)
        return replace(m, barometer_t_ns=m.barometer_t_ns[:0], pressure_pa=m.pressure_pa[:0])

    heard = Driven("highway", seed, 600.0, change=lambda m, start_ns: without_fixes(m, start_ns, 200, 500))
    alone = Driven("highway", seed, 600.0, change=deaf)
    end = heard.between(490, 500)
    assert heard.sd_n[end, 2].max() < 0.5 * alone.sd_n[end, 2].min()
    # Wind of driving (5 % of 46 m at 30 m/s) and weather (25 Pa, 2.1 m), both at three sd, root sum square.
    assert np.abs(heard.error_n[heard.between(200, 500), 2]).max() < 3.0 * math.hypot(2.3, 2.1)


@pytest.mark.parametrize("seed", SEEDS[:3])
def test_a_step_of_pressure_ends_in_the_bias_and_not_in_the_height(seed):
    step_pa, step_m = 300.0, 25.0  # a window opened at speed, made large; 8.4 m a hPa

    def stepped(m, start_ns):
        pressure_pa = m.pressure_pa + step_pa * (m.barometer_t_ns >= start_ns + 300 * S)
        return replace(m, pressure_pa=pressure_pa)

    drive, plain = (Driven("highway", seed, 400.0, change=change) for change in (stepped, None))
    refused = drive.count(state.A_BAROMETER, state.REJECTED_GATE)
    assert 1 <= refused <= 10
    moved = np.abs(drive.error_n - plain.error_n)[:, 2]
    assert moved.max() < 2.0
    bias_m = [one.estimate(state.X_BARO_BIAS, state.BARO_BIAS)[0] for one in (drive, plain)]
    assert bias_m[0] - bias_m[1] == pytest.approx(-step_m, abs=2.0)
