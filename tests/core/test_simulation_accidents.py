"""Simulated accidents and non-accidents against hand values: what was asked for is what a box would integrate."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from core.errors import InvalidInputError
from core.simulation.accident_classes import CLASSES
from core.simulation.body_motion import BodyMotion, band_noise, resonator
from core.simulation.box_model import Box, FilterErrors, converted, estimated_down, sampled, seen, spoilt
from core.simulation.class_disturbances import SOURCES_BY_CLASS
from core.simulation.collisions import After, Blow, Collision, collide, mirrored
from core.simulation.corpus import LEAD_S, accident_case, disturbed, quiet_case
from core.simulation.disturbances import GRID_M, NonAccident, rough_road
from core.simulation.handling import SOURCES
from core.simulation.long_drive import drive_piece
from core.simulation.long_script import Density
from core.simulation.pulses import CRASH_SHAPES, recorded_pulse, ringing, shaped_pulse
from core.simulation.ride import FINE_HZ, Car, ride, tracked
from core.simulation.shapes import Shape
from core.simulation.vehicles import VEHICLES

G = 9.80665
CENTRE = (0.0, 0.0, 0.0)


def level(motion: BodyMotion) -> np.ndarray:
    """Acceleration in level axes from what a perfect sensor feels, by its own attitude: (n, 3)."""
    f_b, _, down_b = motion.felt()
    return f_b + G * down_b


def change(motion: BodyMotion, begin_s: float, end_s: float) -> np.ndarray:
    """Change of velocity along the body's axes, of a car that does not turn meanwhile."""
    rows = slice(round(begin_s * FINE_HZ), round(end_s * FINE_HZ))
    return level(motion)[rows].sum(axis=0) / FINE_HZ


def collision(delta_v=6.0, pdof=0.0, shape=Shape.HAVERSINE, length_s=0.1, **changes) -> Collision:
    blow = Blow(delta_v, pdof, shaped_pulse(shape, length_s))
    fields = {"blows": (blow,), "speed_mps": 10.0, "decel_mps2": 0.0, "ringing_share": 0.0, "box_m": CENTRE}
    return Collision("frontal", **(fields | changes))


@pytest.mark.parametrize(
    ("shape", "peak_over_mean"), [("HAVERSINE", 2.0), ("HALF_SINE", math.pi / 2), ("TRIANGLE", 2.0)]
)
def test_a_pulse_has_unit_area_and_its_shape_s_peak(shape, peak_over_mean):
    pulse = shaped_pulse(Shape[shape], 0.1)
    assert pulse.sum() / FINE_HZ == pytest.approx(1.0)
    assert pulse.max() == pytest.approx(peak_over_mean / 0.1, rel=0.02)  # 100 samples: the peak lies between two


@pytest.mark.parametrize("pdof", [0.0, 37.0, 90.0, 180.0, 270.0, 341.0])
def test_a_blow_takes_the_velocity_that_was_asked_for_away_from_where_it_comes_from(pdof):
    motion, truth = collide(collision(pdof=pdof), np.random.default_rng(1), 5.0, 5.0)
    forward, right, _ = change(motion, 5.0, 5.1)
    # Tyres that slide across give back 0.7 g for most of the pulse: 0.69 m/s for all of it, 5 degrees of the direction.
    assert math.hypot(forward, right) == pytest.approx(6.0, abs=0.6)
    assert math.remainder(math.degrees(math.atan2(-right, -forward)) - pdof, 360.0) == pytest.approx(0.0, abs=5.0)
    assert truth.delta_v_mps == pytest.approx(math.hypot(forward, right), abs=0.05)  # the springs' tilt aside
    assert math.remainder(truth.pdof_deg - pdof, 360.0) == pytest.approx(0.0, abs=5.0)
    assert truth.t_s == 5.0
    assert truth.speed_mps == pytest.approx(10.0)


def test_the_energy_of_a_frontal_crash_into_a_wall_is_the_car_s():
    motion, _ = collide(collision(delta_v=10.0, after=After.REST), np.random.default_rng(1), 5.0, 5.0)
    along = level(motion)[5000:5100, 0]
    speed = 10.0 + np.cumsum(along) / FINE_HZ
    assert np.sum(-along * speed) / FINE_HZ == pytest.approx(0.5 * 10.0**2, rel=0.02)  # J/kg; the sum is not exact


def test_ringing_shakes_and_changes_no_velocity():
    pulse = 60.0 * shaped_pulse(Shape.HALF_SINE, 0.1) / FINE_HZ * 10.0
    rung = ringing(np.pad(pulse, (100, 800)), 0.4, np.random.default_rng(2))
    assert rung[100:250].std() > 0.05 * pulse.max()
    assert abs(rung.sum(axis=0)).max() / FINE_HZ < 0.1
    assert (rung[:90] == 0.0).all()


def test_a_later_blow_comes_from_where_the_car_points_by_then():
    turned = Blow(5.0, 180.0, shaped_pulse(Shape.HAVERSINE, 0.1), yaw_rate_radps=3.0)
    second = Blow(4.0, 90.0, shaped_pulse(Shape.HAVERSINE, 0.1), after_s=1.5)
    motion, truth = collide(collision(blows=(turned, second), speed_mps=0.0), np.random.default_rng(1), 5.0, 8.0)
    yaw_deg = math.degrees(motion.rpy_rad[6499, 2])
    assert yaw_deg > 60.0
    assert [one["t_s"] for one in truth.impacts] == [5.0, 6.5]
    # Tyres hold against being pushed across at 7 m/s2.
    assert truth.impacts[1]["delta_v_mps"] == pytest.approx(4.0, abs=0.8)
    assert truth.impacts[1]["pdof_deg"] == pytest.approx(90.0, abs=12.0)
    assert truth.delta_v_mps == max(one["delta_v_mps"] for one in truth.impacts)


@pytest.mark.parametrize("roll_deg", [90.0, 180.0, -270.0])
def test_a_rollover_turns_the_vertical_by_its_quarters_and_lies(roll_deg):
    motion, truth = collide(
        collision(delta_v=4.0, pdof=90.0, roll_deg=roll_deg, roll_s=2.0), np.random.default_rng(3), 5.0, 15.0
    )
    f_b, omega_b, down_b = motion.felt()
    angle = math.radians(roll_deg)
    assert down_b[-1] == pytest.approx([0.0, math.sin(angle), math.cos(angle)], abs=0.01)
    assert f_b[-1] == pytest.approx(-G * down_b[-1], abs=0.1)
    assert math.degrees(omega_b[:, 0].sum() / FINE_HZ) == pytest.approx(roll_deg, abs=2.0)
    assert truth.kind == "rollover"


def test_the_box_s_place_counts_and_a_turning_car_s_front_gets_more():
    blow = Blow(5.0, 90.0, shaped_pulse(Shape.HAVERSINE, 0.1), yaw_rate_radps=-2.0)
    at = {
        ahead: collide(collision(blows=(blow,), box_m=(ahead, 0.0, 0.0)), np.random.default_rng(1))[1].delta_v_mps
        for ahead in (0.0, 1.0)
    }
    assert at[1.0] - at[0.0] == pytest.approx(2.0, abs=0.25)  # yaw rate times arm; it decays from the first


def test_mirrored_comes_from_the_other_side():
    other = mirrored(collision(pdof=70.0, roll_deg=90.0))
    assert other.blows[0].pdof_deg == 290.0
    assert other.roll_deg == -90.0


@pytest.mark.parametrize("name", CLASSES)
def test_each_class_is_drawn_within_what_it_promises(name):
    for seed in range(6):
        drawn = CLASSES[name](np.random.default_rng(seed))
        assert all(1.5 <= blow.delta_v_mps <= 20.0 for blow in drawn.blows)
        case = accident_case(name, seed)
        assert np.isfinite(case.motion.f_b).all()
        limit = case.box.full_scale_mps2 + 0.16  # and the bias left over
        assert np.abs(case.motion.f_b).max() <= limit
        assert case.truth.kind == {"rollover": "rollover", "parked_hit": "parked_hit"}.get(name, "collision")
        assert case.t_ns - case.motion.t_ns[0] == LEAD_S * 1e9
    moving = name not in ("struck_standing", "parked_hit")
    assert (case.truth.speed_mps > 0.4) == moving


def test_the_same_seed_gives_the_same_bits_and_another_others():
    first, again, other = (accident_case("oblique", seed).motion for seed in (4, 4, 5))
    assert np.array_equal(first.f_b, again.f_b)
    assert np.array_equal(first.down_b, again.down_b, equal_nan=True)
    assert first.f_b.shape != other.f_b.shape or not np.array_equal(first.f_b, other.f_b)
    one, two = (quiet_case(NonAccident.KERB, 4).motion for _ in range(2))
    assert np.array_equal(one.f_b, two.f_b)


def test_a_recorded_pulse_keeps_its_change_of_velocity_at_another_rate():
    t_s = np.arange(-0.05, 0.3, 1e-4)
    phase = np.clip(t_s / 0.1, 0.0, 1.0)
    accel = -2.0 * 15.0 / 0.1 * np.sin(np.pi * phase) ** 2 + 40.0 * np.sin(2 * np.pi * 900.0 * t_s)
    pulse = recorded_pulse(t_s, accel)
    assert len(pulse) == 350
    assert pulse.sum() / FINE_HZ == pytest.approx(-15.0, rel=0.01)
    assert np.abs(pulse[:40]).max() < 5.0  # what lay above 300 Hz is gone: it would come back as 100 Hz
    with pytest.raises(InvalidInputError, match="increase evenly"):
        recorded_pulse(t_s[::-1], accel)
    with pytest.raises(InvalidInputError, match="cut_hz below"):
        recorded_pulse(t_s[::50], accel[::50])


def test_a_wheel_bridges_a_short_hole_and_meets_a_kerb_before_its_edge():
    hole = np.zeros(200)
    hole[100:110] = -0.05  # 10 cm wide under a wheel of 31 cm radius
    sunk = -tracked(hole, 0.31).min()
    assert sunk == pytest.approx(0.31 - math.sqrt(0.31**2 - 0.05**2), abs=0.002)
    kerb = np.where(np.arange(200) >= 100, 0.1, 0.0)
    climbs = np.flatnonzero(tracked(kerb, 0.31) > 1e-6)[0]
    ahead_m = math.sqrt(0.31**2 - 0.21**2)
    assert (100 - climbs) * GRID_M == pytest.approx(ahead_m, abs=2 * GRID_M)


def test_a_car_over_a_step_ends_as_high_as_the_step_and_loses_the_energy_of_its_lift():
    height_m, speed_mps, car = 0.05, 3.0, Car()
    profile = np.concatenate([np.zeros(100), np.full(1500, height_m)])
    motion = ride(profile, profile, speed_mps, car, np.zeros(3))
    up = -motion[:, 2]
    climbed = np.cumsum(np.cumsum(up)) / FINE_HZ**2
    assert climbed[-1] == pytest.approx(height_m, abs=0.004)
    mass_kg = car.sprung_kg + 4 * car.unsprung_kg
    lost_mps = -motion[:, 0].sum() / FINE_HZ
    # Force times slope is power: at least the weight's lift, and what springs and tyres swallow; speed is held.
    assert lost_mps * mass_kg * speed_mps > mass_kg * G * height_m
    assert lost_mps * speed_mps < 4.0 * G * height_m


def test_the_heave_of_the_car_on_its_springs_has_its_frequency():
    car = replace(Car(), damping_nspm=200.0)
    profile = np.concatenate([np.zeros(50), np.full(3000, 0.01)])
    motion = ride(profile, profile, 5.0, car, np.zeros(3))
    up = -motion[1500:, 2]
    spectrum = np.abs(np.fft.rfft(up * np.hanning(up.size), 16384))
    found_hz = np.fft.rfftfreq(16384, 1 / FINE_HZ)[np.argmax(spectrum)]
    series = 1 / (1 / car.spring_npm + 1 / car.tyre_npm)
    expected_hz = math.sqrt(4 * series / car.sprung_kg) / (2 * math.pi)
    assert found_hz == pytest.approx(expected_hz, rel=0.1)  # pitch is near it and couples


def test_a_rough_road_has_the_spectrum_of_its_class():
    road = rough_road(2_000_000, 256e-6, np.random.default_rng(1))
    pieces = road[: 2_000_000 // 10_000 * 10_000].reshape(-1, 10_000)
    pieces = (pieces - pieces.mean(axis=1, keepdims=True)) * np.hanning(10_000)
    power = 2.0 * GRID_M * np.mean(np.abs(np.fft.rfft(pieces, axis=1)) ** 2, axis=0) / (np.hanning(10_000) ** 2).sum()
    n = np.fft.rfftfreq(10_000, GRID_M)
    near = (n > 0.08) & (n < 0.125)
    assert np.mean(power[near] * (n[near] / 0.1) ** 2) == pytest.approx(256e-6, rel=0.15)  # 200 pieces


OF_THEIR_OWN = [
    (vehicle, kind)
    for vehicle, sources in SOURCES_BY_CLASS.items()
    for kind, source in sources.items()
    if vehicle == "car" or source is not SOURCES.get(kind)
]


@pytest.mark.parametrize(("vehicle", "kind"), OF_THEIR_OWN)
def test_each_disturbance_is_finite_bounded_and_starts_quietly(vehicle, kind):
    source = SOURCES_BY_CLASS[vehicle][kind]
    for seed in range(4):
        rng = np.random.default_rng([seed, 9])
        speed_mps = rng.uniform(max(source.low_mps, 1.0), source.high_mps) if source.high_mps else 0.0
        one = source.draw(rng, speed_mps, VEHICLES[vehicle])
        assert one.kind is kind
        assert one.accel_b.shape == one.rpy_rad.shape == (one.speed_mps.size, 3)
        assert np.isfinite(one.accel_b).all()
        assert 0.0 <= one.hardness <= 1.0
        assert np.abs(one.rpy_rad[0]).max() < 0.01
        assert one.speed_mps.min() >= 0.0
        struck = kind in (NonAccident.BOX_DROPPED, NonAccident.BOX_KNOCKED)
        limit = 400.0 * G if struck else 25.0 * G if kind is NonAccident.FALL_AT_REST else 12.0 * G
        assert np.abs(one.accel_b).max() < limit


def test_braking_ends_at_rest_having_taken_the_whole_speed_and_jerks_back():
    one = SOURCES[NonAccident.EMERGENCY_BRAKING].draw(np.random.default_rng(1), 15.0)
    stop = int(np.argmax(one.speed_mps <= 0.01))
    assert one.accel_b[:stop, 0].sum() / FINE_HZ == pytest.approx(-15.0, abs=0.3)
    assert 6.0 < -one.accel_b[:stop, 0].min() < 12.2  # 10.8 at most, and ABS
    assert one.accel_b[stop : stop + 200, 0].max() > 0.5
    assert one.speed_mps[-1] < 1e-9


def test_a_bend_turns_the_car_as_speed_and_side_force_say():
    one = SOURCES[NonAccident.HARD_CORNERING].draw(np.random.default_rng(2), 12.0)
    assert one.rpy_rad[-1, 2] == pytest.approx(one.accel_b[:, 1].sum() / FINE_HZ / 12.0)


def test_a_parking_bump_stops_less_than_1_m_per_s():
    for seed in range(20):
        one = SOURCES[NonAccident.PARKING_BUMP].draw(np.random.default_rng(seed), 0.0)
        pulse = np.cumsum(one.accel_b[:1400, 0]) / FINE_HZ
        assert 0.15 < np.abs(pulse).max() < 1.5  # up to 1 m/s and a third of it rolled back


def test_a_dropped_box_falls_freely_and_ends_turned_and_at_rest():
    one = SOURCES[NonAccident.BOX_DROPPED].draw(np.random.default_rng(3), 0.0)
    motion = disturbed(one)
    f_b, _, down_b = motion.felt()
    falling = round((LEAD_S + 1.05) * FINE_HZ)
    assert np.linalg.norm(f_b[falling]) < 0.1
    assert np.linalg.norm(f_b, axis=1).max() > 15 * G
    assert f_b[-1] == pytest.approx(-G * down_b[-1], abs=1e-6)
    assert down_b[-1, 2] < 0.99


def test_a_box_clips_and_says_so_and_low_passes_what_is_too_fast_for_it():
    signal = np.zeros((1000, 3))
    signal[500] = 30.0
    clipped, saturated = converted(signal, 2 * G, 0.0, 100.0, np.random.default_rng(1))
    assert clipped.max() == 2 * G
    assert saturated.sum() == 1
    t = np.arange(2000) / FINE_HZ
    fast = np.column_stack([np.sin(2 * np.pi * 180.0 * t)] * 3)
    box = Box(rate_hz=100.0, corner_hz=30.0)
    assert np.abs(sampled(fast, box)[50:]).max() < 1.1 * (30.0 / 180.0) ** 2  # order 2, six times its corner
    steady = sampled(np.ones((1000, 3)), box)
    assert steady == pytest.approx(np.ones((100, 3)))


def test_the_filter_s_vertical_is_off_by_what_is_said_and_follows_a_rollover():
    n, box = 60_000, Box(rate_hz=100.0, errors=FilterErrors(tilt_sd_rad=0.01, tilt_s=5.0))
    down = np.tile([0.0, 0.0, 1.0], (n, 1))
    off = estimated_down(down, np.zeros((n, 3)), box, np.random.default_rng(1))[:, :2]
    assert off.std() == pytest.approx(0.01, rel=0.15)  # 120 correlation times
    motion, _ = collide(collision(roll_deg=180.0, pdof=90.0, roll_s=2.0), np.random.default_rng(3), 5.0, 15.0)
    given = seen(motion, replace(box, gyro_full_scale_radps=10.0), np.random.default_rng(4), 0)
    assert given.down_b[-1] @ motion.felt()[2][-1] > math.cos(0.06)


@pytest.mark.parametrize("seed", range(8))
def test_a_spoilt_converter_stays_within_its_range_and_leaves_the_rest_alone(seed):
    f, saturated = np.tile([0.1, -0.2, -G], (1000, 1)), np.zeros(1000)
    before = f.copy()
    spoilt(f, saturated, 400, 16 * G, np.random.default_rng(seed))
    changed = np.flatnonzero((f != before).any(axis=1))
    assert changed.size
    assert changed[0] >= 400
    assert changed[-1] < 500
    assert np.abs(f).max() <= 16 * G


def test_band_noise_has_unit_sd_and_no_share_at_zero_frequency():
    noise = band_noise(200_000, 12.0, 0.5, np.random.default_rng(1))
    assert noise.std() == pytest.approx(1.0, rel=0.03)
    assert np.abs(noise.mean(axis=0)).max() < 0.01
    tone = np.sin(2 * np.pi * 40.0 * np.arange(5000) / FINE_HZ)
    assert resonator(tone, 40.0, 0.05)[2000:].max() == pytest.approx(1.0, rel=0.06)


def test_a_long_piece_drives_its_way_meets_what_it_should_and_is_the_same_again():
    piece, again = drive_piece(5, distance_km=10.0), drive_piece(5, distance_km=10.0)
    assert 10_000.0 <= piece.distance_m < 16_000.0
    t_ns = np.concatenate([motion.t_ns for motion in piece.motions])
    assert np.unique(np.diff(t_ns)).tolist() == [10_000_000]
    speed = np.concatenate([motion.speed_mps for motion in piece.motions])
    assert np.nansum(speed) / 100.0 == pytest.approx(piece.distance_m, rel=0.05)  # unknown at first
    assert all(np.array_equal(a.f_b, b.f_b) for a, b in zip(piece.motions, again.motions, strict=True))
    assert piece.happenings == again.happenings
    assert piece.happenings


def test_a_long_piece_has_as_many_of_a_kind_as_its_density_says():
    density = Density(**{kind.value: 0.0 for kind in NonAccident if kind is not NonAccident.KERB} | {"kerb": 100.0})
    kinds = [one.kind for seed in range(6) for one in drive_piece(seed, density, 10.0).happenings]
    assert set(kinds) == {NonAccident.KERB}
    assert 38 <= len(kinds) <= 84  # Poisson with mean 60, three sd


def test_a_long_piece_feels_its_manoeuvres_as_its_speed_changes():
    none = Density(**{kind.value: 0.0 for kind in NonAccident})
    piece = drive_piece(3, none, 10.0)
    (motion,) = piece.motions
    known = np.isfinite(motion.speed_mps)
    along = (motion.f_b + G * motion.down_b)[known, 0]
    speed = motion.speed_mps[known]
    smooth = np.convolve(along, np.full(200, 1 / 200), mode="same")
    slope = np.convolve(np.gradient(speed) * 100.0, np.full(200, 1 / 200), mode="same")
    assert np.corrcoef(smooth, slope)[0, 1] > 0.9
    assert np.abs(smooth).max() < 8.0


@pytest.mark.parametrize("shape", CRASH_SHAPES)
def test_every_crash_shape_can_be_used(shape):
    _, truth = collide(collision(shape=shape, length_s=0.12), np.random.default_rng(1))
    assert truth.duration_s == pytest.approx(0.12)
