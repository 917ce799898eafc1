"""The simulated box shows errors of the stated sizes, and the same seed shows the same bits."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from core.atmosphere import pressure_height_m
from core.measurements import GNSS
from core.sensors import TriadCalibration
from core.simulation.gnss import Receiver, measure_gnss
from core.simulation.route import RouteBuilder, Sky, SkySpan
from core.simulation.scenarios import MADRID, SCENARIOS, WHITE_GNSS
from core.simulation.sensors import (
    ACCELEROMETER,
    MICRO_IBB,
    UNCALIBRATED,
    DeviceErrors,
    TriadErrors,
    Vibration,
    draw_errors,
    gauss_markov,
    measure_inertial,
    measure_magnetic,
    measure_pressure,
    measure_wheel_speed,
)
from core.simulation.trajectory import Trajectory, drive

STILL = Vibration(road_sd_mps2=0.0, engine_sd_mps2=0.0, ringing_share=0.0)


@pytest.fixture(scope="module")
def standing() -> Trajectory:
    return drive(RouteBuilder().hold(200.0).build(), MADRID, 200.0)


@pytest.fixture(scope="module")
def driving() -> Trajectory:
    return drive(RouteBuilder(heading_deg=30.0).to_speed(14.0).hold(590.0).build(), MADRID, 50.0)


def _perfect() -> DeviceErrors:
    device = replace(
        MICRO_IBB,
        accelerometer=TriadErrors(bias_sd=0.0, scale_sd=0.0, misalignment_sd_rad=0.0),
        gyroscope=TriadErrors(bias_sd=0.0, scale_sd=0.0, misalignment_sd_rad=0.0),
        mounting_sd_rad=0.0,
        hard_iron_sd_ut=0.0,
        wheel_scale_sd=0.0,
    )
    return draw_errors(device, np.random.default_rng(1))


def test_white_noise_has_the_density_of_the_data_sheet(standing: Trajectory) -> None:
    triad = replace(ACCELEROMETER, instability_sd=0.0)
    device = replace(MICRO_IBB, vibration=STILL, accelerometer=triad)
    f_s, _ = measure_inertial(standing, device, _perfect(), np.random.default_rng(2))
    stated = triad.random_walk * math.sqrt(200.0)
    # 40 000 samples: the sd of an sd is 0.35 %; five of them, and 0.0002 of quantisation beside 0.03.
    assert f_s.std(axis=0) == pytest.approx(np.full(3, stated), rel=0.018)


def test_values_are_counts_of_16_bit_and_clip_at_full_scale(standing: Trajectory) -> None:
    blow = replace(standing, f_b=standing.f_b + np.array([300.0, -300.0, 0.0]))
    f_s, _ = measure_inertial(blow, MICRO_IBB, _perfect(), np.random.default_rng(2))
    counts = f_s / MICRO_IBB.accelerometer.step
    assert np.abs(counts - np.rint(counts)).max() < 1e-6
    assert counts[:, 0].min() == pytest.approx(32767)
    assert counts[:, 1].max() == pytest.approx(-32768)


def test_the_drawn_triad_is_what_the_measurements_show(standing: Trajectory) -> None:
    errors = replace(
        _perfect(), accelerometer=TriadCalibration(scale=(1.0, 1.0, 1.01), bias=(0.2, 0.0, 0.0)), hard_iron_ut=(0, 0, 0)
    )
    f_s, _ = measure_inertial(standing, replace(MICRO_IBB, vibration=STILL), errors, np.random.default_rng(2))
    expected = errors.accelerometer.apply(standing.f_b[:1])[0]
    # Mean of 200 s of bias instability with sd 0.15 mg = 0.0015 m/s2: four of them.
    assert f_s.mean(axis=0) == pytest.approx(expected, abs=0.006)


def test_vibration_has_no_mean_and_grows_with_speed(standing: Trajectory, driving: Trajectory) -> None:
    quiet = TriadErrors(bias_sd=0.0, random_walk=0.0, instability_sd=0.0)
    device = replace(MICRO_IBB, accelerometer=quiet, vibration=Vibration())
    at_rest, _ = measure_inertial(standing, device, _perfect(), np.random.default_rng(2))
    moving, _ = measure_inertial(driving, device, _perfect(), np.random.default_rng(2))
    shake = moving[2000:, 2] - driving.f_b[2000:, 2]
    assert shake.std() == pytest.approx(device.vibration.road_sd_mps2, rel=0.1)
    # A band about 12 Hz integrates to its two ends, of 0.45 / (2 pi 12) = 0.006 m/s each: four of them.
    # White noise of that size would leave 1.5 m/s after 560 s.
    assert abs(shake.sum() / 50.0) < 0.03
    assert at_rest[:, 2].std() < 0.1


def test_a_gauss_markov_sequence_is_stationary_and_forgets_at_its_rate() -> None:
    x = np.stack([gauss_markov(2000, 2.0, 10.0, 1.0, np.random.default_rng(k)) for k in range(400)])
    # 400 independent runs: the sd of an sd is 3.5 %; three of them.
    assert x[:, 0].std() == pytest.approx(2.0, rel=0.11)
    assert x[:, -1].std() == pytest.approx(2.0, rel=0.11)
    lag = np.mean(x[:, :-10] * x[:, 10:]) / np.mean(x * x)
    assert lag == pytest.approx(math.exp(-1.0), abs=0.02)


def test_fixes_are_off_by_what_they_state_and_their_errors_hang_together(driving: Trajectory) -> None:
    errors_m = []
    for seed in range(30):
        t_s, rows = measure_gnss(driving, (), Receiver(), (0.0, 0.0, 0.0), np.random.default_rng(seed))
        north = (rows[:, GNSS["lat_rad"]] - np.interp(t_s, driving.t_s, driving.lat_rad)) * 6.37e6
        errors_m.append(north)
    error = np.array(errors_m)
    stated = Receiver().stated_sd_m
    assert 0.6 * stated < error.std() < 1.2 * stated
    one_second = np.mean(error[:, :-1] * error[:, 1:]) / np.mean(error**2)
    assert one_second > 0.8


def test_a_receiver_without_memory_jumps_from_fix_to_fix(driving: Trajectory) -> None:
    t_s, rows = measure_gnss(driving, (), WHITE_GNSS, (0.0, 0.0, 0.0), np.random.default_rng(1))
    error_m = (rows[:, GNSS["lat_rad"]] - np.interp(t_s, driving.t_s, driving.lat_rad)) * 6.37e6
    # 600 differences of neighbours: their sd is off by 3.5 % (one sigma).
    assert np.diff(error_m).std() == pytest.approx(1.5 * math.sqrt(2.0), rel=0.12)


def test_under_a_tunnel_there_are_no_fixes_and_between_houses_poor_ones(driving: Trajectory) -> None:
    sky = (SkySpan(Sky.TUNNEL, 100.0, 160.0), SkySpan(Sky.CANYON, 300.0, 400.0))
    t_s, rows = measure_gnss(driving, sky, Receiver(), (0.0, 0.0, 0.0), np.random.default_rng(5))
    assert not ((t_s >= 100.0) & (t_s < 160.0)).any()
    assert ((t_s >= 99.0) & (t_s < 161.0)).sum() == 2
    error_m = np.abs(rows[:, GNSS["lat_rad"]] - np.interp(t_s, driving.t_s, driving.lat_rad)) * 6.37e6
    street, free = (t_s > 303) & (t_s < 397), t_s < 100
    assert error_m[street].std() > 2 * error_m[free].std()
    for name, more in (("satellites", False), ("hdop", True), ("sd_h_m", True)):
        poor, good = rows[street, GNSS[name]], rows[free, GNSS[name]]
        assert (poor.min() > good.max()) if more else (poor.max() < good.min()), name


def test_the_antenna_is_where_its_lever_arm_says(driving: Trajectory) -> None:
    silent = Receiver(drift_sd_m=0.0, white_sd_m=0.0, velocity_sd_mps=0.0)
    at_box = measure_gnss(driving, (), silent, (0.0, 0.0, 0.0), np.random.default_rng(5))[1]
    ahead = measure_gnss(driving, (), silent, (2.0, 0.0, -1.0), np.random.default_rng(5))[1]
    north = (ahead - at_box)[:, GNSS["lat_rad"]] * 6.36e6
    # 2 m ahead at 30 degrees of heading; the radius of curvature there is within 0.2 % of 6.36e6 m.
    assert north[100:] == pytest.approx(np.full(north.size - 100, 2.0 * math.cos(math.radians(30.0))), abs=0.01)
    assert (ahead - at_box)[100:, GNSS["alt_m"]] == pytest.approx(np.ones(north.size - 100), abs=0.01)


def test_the_magnetometer_points_to_magnetic_north(driving: Trajectory) -> None:
    _, field_s = measure_magnetic(driving, MADRID.field_n_ut, MICRO_IBB, _perfect(), np.random.default_rng(1))
    heading = math.degrees(math.atan2(-field_s[:, 1].mean(), field_s[:, 0].mean()))
    declination = math.degrees(math.atan2(MADRID.field_n_ut[1], MADRID.field_n_ut[0]))
    assert heading == pytest.approx(30.0 - declination, abs=0.3)


def test_wheels_show_the_speed_times_their_unknown_scale(driving: Trajectory) -> None:
    device = replace(MICRO_IBB, wheel_speed_hz=4.0)
    t_s, speed = measure_wheel_speed(driving, device, replace(_perfect(), wheel_scale=1.02))
    assert np.diff(t_s) == pytest.approx(np.full(t_s.size - 1, 0.25), abs=0.011)
    assert speed[-1] == pytest.approx(14.0 * 1.02, abs=0.01)
    assert measure_wheel_speed(driving, MICRO_IBB, _perfect())[0].size == 0


def test_a_barometer_shows_the_height_but_for_weather_wind_and_noise(driving: Trajectory) -> None:
    device = replace(MICRO_IBB, barometer_hz=10.0)
    errors = replace(_perfect(), pressure_offset_pa=400.0, wind_share=0.0)
    t_s, pressure_pa = measure_pressure(driving, device, errors, np.random.default_rng(3))
    assert np.diff(t_s) == pytest.approx(np.full(t_s.size - 1, 0.1), abs=0.011)
    error_m = pressure_height_m(pressure_pa) - np.interp(t_s, driving.t_s, driving.alt_m)
    # 640 m up 1 hPa is 9.0 m; the drift's sd of 25 Pa is 2.2 m, of which 3 sd.
    assert error_m == pytest.approx(np.full(t_s.size, -36.0), abs=6.6)
    # What changes from sample to sample is noise, 1.3 Pa, and a step of the drift, 0.26 Pa.
    assert np.diff(pressure_pa).std() / math.sqrt(2.0) == pytest.approx(1.31, rel=0.05)
    assert np.rint(pressure_pa / 0.16) * 0.16 == pytest.approx(pressure_pa, abs=1e-6)
    blown = measure_pressure(driving, device, replace(errors, wind_share=0.1), np.random.default_rng(3))[1]
    # A tenth of half the density, 1.15 kg/m3 at 640 m, times (14 m/s)^2, to the converter's step.
    assert blown[-1] - pressure_pa[-1] == pytest.approx(0.1 * 0.5 * 1.15 * 14.0**2, abs=0.2)
    assert measure_pressure(driving, MICRO_IBB, errors, np.random.default_rng(3))[0].size == 0


def test_an_uncalibrated_box_is_far_off_and_its_calibration_knows_by_how_much() -> None:
    drawn = [draw_errors(UNCALIBRATED, np.random.default_rng(k)) for k in range(300)]
    raw = np.array([one.accelerometer.bias for one in drawn])
    left = raw - np.array([one.known_accelerometer.bias for one in drawn])
    assert raw.std() > 4 * left.std()
    # 900 draws: the sd of an sd is 2.4 %; four of them.
    assert left.std() == pytest.approx(UNCALIBRATED.accelerometer.bias_sd, rel=0.1)
    known = draw_errors(MICRO_IBB, np.random.default_rng(1)).known_accelerometer
    assert known == TriadCalibration()


def test_every_scenario_has_a_text_and_a_length() -> None:
    for name, scenario in SCENARIOS.items():
        assert scenario.text, name
        assert scenario.duration_s >= 60.0, name
