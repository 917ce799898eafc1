"""Scenarios hold what they promise: crashes where truth says, tunnels without fixes, the same bits again."""

from __future__ import annotations

import math

import numpy as np
import pytest

from core.errors import InvalidInputError
from core.simulation import roads
from core.simulation.scenarios import SCENARIOS, SimulatedDrive, simulate

UNEVENTFUL = ("city", "highway", "outages", "engine_shaken", "exact_outages", "uncalibrated_outages")


@pytest.fixture(scope="module")
def demo() -> SimulatedDrive:
    return simulate("tunnel_crash", seed=1)


@pytest.fixture(scope="module")
def wide() -> SimulatedDrive:
    return simulate("wide_sensor", seed=1)


def test_the_demo_has_a_low_speed_crash_and_a_severe_one_20_s_into_a_tunnel(demo: SimulatedDrive) -> None:
    low, severe = demo.truth["accidents"]
    (tunnel,) = demo.truth["outages"]
    assert low["severity"] == "low_speed"
    assert not low["in_outage"]
    assert 3.0 <= low["delta_v_mps"] <= 6.5
    assert severe["severity"] == "airbag"  # 10.2 m/s in 0.14 s: both of the seed's upper classes, the faster is told
    assert severe["in_outage"]
    assert 7.0 <= severe["delta_v_mps"] <= 12.0
    assert severe["t_s"] - tunnel["start_s"] == pytest.approx(20.0, abs=0.01)
    assert tunnel["duration_s"] >= 40.0


def test_the_demo_begins_at_rest_and_brakes_hard_without_an_accident(demo: SimulatedDrive) -> None:
    truth = demo.trajectory
    assert (truth.speed_mps[truth.t_s < 10.0] == 0.0).all()
    crash_s = [one["t_s"] for one in demo.truth["accidents"]]
    calm = np.all([np.abs(truth.t_s - t) > 3.0 for t in crash_s], axis=0)
    assert 7.0 < -truth.f_b[calm, 0].min() < 9.5


def test_truth_places_each_crash_on_the_trajectory(demo: SimulatedDrive) -> None:
    truth = demo.trajectory
    for one in demo.truth["accidents"]:
        row = np.searchsorted(truth.t_s, one["t_s"])
        assert math.degrees(truth.lat_rad[row]) == pytest.approx(one["lat_deg"], abs=1e-6)  # 0.1 m, 5 ms at 14 m/s
        assert math.degrees(truth.lon_rad[row]) == pytest.approx(one["lon_deg"], abs=1.5e-6)
        after = np.searchsorted(truth.t_s, one["t_s"] + one["duration_s"] + 0.005)
        change = np.hypot(*(truth.v_n[after, :2] - truth.v_n[row, :2]))
        # The kick in yaw turns what velocity is left while the pulse lasts.
        assert change == pytest.approx(one["delta_v_mps"], rel=0.12)


def test_the_severe_pulse_clips_at_2_g_and_not_at_16_g(demo: SimulatedDrive, wide: SimulatedDrive) -> None:
    for drive, clips in ((demo, True), (wide, False)):
        severe = drive.truth["accidents"][1]
        t_s = (drive.measurements.imu_t_ns - drive.start_t_ns) / 1e9
        near = np.abs(t_s - severe["t_s"] - 0.07) < 0.2
        full_scale = drive.measurements.accel_full_scale_mps2
        assert severe["clipped"] is clips
        assert bool(np.abs(drive.measurements.f_s[near]).max() > 0.999 * full_scale) is clips
    assert [one["clipped"] for one in demo.truth["accidents"]] == [False, True]
    assert demo.trajectory.t_s.size == wide.trajectory.t_s.size


def test_the_same_seed_gives_the_same_bits_and_another_gives_others(demo: SimulatedDrive) -> None:
    again, other = simulate("tunnel_crash", seed=1), simulate("tunnel_crash", seed=2)
    for name in ("imu_t_ns", "f_s", "omega_s", "gnss", "magnetic_s_ut"):
        assert np.array_equal(
            getattr(demo.measurements, name), getattr(again.measurements, name), equal_nan=name == "gnss"
        )
    assert demo.truth == again.truth
    assert not np.array_equal(demo.measurements.f_s, other.measurements.f_s)


@pytest.mark.parametrize("name", list(SCENARIOS))
def test_every_scenario_can_be_driven_at_a_length_and_rate_asked_for(name: str) -> None:
    drive = simulate(name, seed=3, duration_s=480.0, rate_hz=50.0)
    assert drive.trajectory.t_s[-1] == pytest.approx(480.0, abs=0.03)
    assert np.unique(np.diff(drive.measurements.imu_t_ns)).tolist() == [20_000_000]
    truth = drive.trajectory
    assert np.isfinite(truth.f_b).all()
    assert truth.speed_mps.max() < 36.0
    lateral = np.abs(truth.f_b[:, 1])
    crash_s = [one["t_s"] for one in drive.truth["accidents"]]
    shaken_s = [(one["t_s"], one["t_s"] + one["duration_s"]) for one in drive.truth["non_accidents"]]
    spans = [(t - 0.1, t + 2.0) for t in crash_s] + shaken_s
    calm = np.all([(truth.t_s < a) | (truth.t_s > b) for a, b in spans] or [truth.t_s >= 0.0], axis=0)
    assert lateral[calm].max() < 6.0  # tyres hold, also in the tightest turn
    assert (len(crash_s) > 0) == (name not in UNEVENTFUL)
    for outage in drive.truth["outages"]:
        fix_s = (drive.measurements.gnss_t_ns - drive.start_t_ns) / 1e9
        assert not ((fix_s >= outage["start_s"]) & (fix_s < outage["start_s"] + outage["duration_s"])).any()


def test_a_longer_demo_drives_more_streets_and_still_crashes_20_s_into_the_tunnel() -> None:
    drive = simulate("tunnel_crash", seed=5, duration_s=900.0, rate_hz=50.0)
    (tunnel,) = [one for one in drive.truth["outages"] if one["duration_s"] > 40.0]
    assert drive.truth["accidents"][-1]["t_s"] - tunnel["start_s"] == pytest.approx(20.0, abs=0.01)
    assert len(drive.truth["accidents"]) == 2


def test_over_three_and_a_half_hours_the_series_has_more_than_20_crashes_of_both_kinds() -> None:
    route = roads.crash_series(np.random.default_rng(1), 3.5 * 3600.0)
    assert len(route.crashes) > 20
    classes = {crash.severity for _, crash in route.crashes}
    assert "low_speed" in classes
    assert classes & {"severe", "airbag"}
    times = np.array([t for t, _ in route.crashes])
    speed = route.forward_by_tyres.at(times)[0] + route.forward_by_impacts.at(times)[0]
    assert speed.max() < 20.0
    assert np.diff(times).min() > 60.0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"scenario": "moon"}, "unknown scenario 'moon': expected one of tunnel_crash"),
        ({"duration_s": 5.0}, "expected 30 s to 4 h"),
        ({"scenario": "tunnel_crash", "duration_s": 100.0}, "takes at least"),
        ({"seed": -1}, "seed is -1"),
        ({"rate_hz": 5000.0}, "10 to 1000 Hz"),
    ],
)
def test_what_cannot_be_simulated_is_refused_with_what_was_expected(arguments: dict, message: str) -> None:
    with pytest.raises(InvalidInputError, match=message):
        simulate(**arguments)
