"""Vans, trucks, buses and motorcycles: what is simulated of them against hand values, and what their profiles tell."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from core.accident.detector import ImpactDetector
from core.accident.events import Kind, NoAccident, Status
from core.accident.profiles import PROFILES, for_vehicle
from core.simulation.accident_classes import frontal
from core.simulation.class_accidents import CLASSES_BY_VEHICLE, felt_by
from core.simulation.class_disturbances import SOURCES_BY_CLASS
from core.simulation.corpus import accident_case, quiet_case
from core.simulation.disturbances import NonAccident
from core.simulation.handling import SOURCES
from core.simulation.long_script import DENSITIES
from core.simulation.ride import FINE_HZ
from core.simulation.vehicles import VEHICLES
from tests.crash_timelines import EPOCH_NS, G, drive

BIKE = for_vehicle("motorcycle")


def leaning(motion, roll_rad):
    """The same with a roll over time, (n,), and a sideways acceleration that holds it where it leans into a bend."""
    t_s = (motion.t_ns - EPOCH_NS) * 1e-9
    f_up, down = motion.f_b[:, 2].copy(), np.column_stack([0.0 * roll_rad, np.sin(roll_rad), np.cos(roll_rad)])
    motion.down_b[:] = down
    motion.f_b[:, 2] = f_up / np.cos(roll_rad)  # along its own vertical alone, more than 1 g in a bend
    motion.omega_b[:, 0] += np.gradient(roll_rad, t_s)
    return motion


def lying(motion, roll_rad):
    """The same with a roll over time, (n,), that nothing holds."""
    t_s = (motion.t_ns - EPOCH_NS) * 1e-9
    motion.down_b[:] = np.column_stack([0.0 * roll_rad, np.sin(roll_rad), np.cos(roll_rad)])
    motion.f_b[:] = np.array([0.0, 0.0, 0.0]) - G * motion.down_b
    motion.omega_b[:, 0] += np.gradient(roll_rad, t_s)
    return motion


def test_every_class_has_a_profile_accidents_non_accidents_and_drives():
    assert set(PROFILES) == set(VEHICLES) == set(CLASSES_BY_VEHICLE) == set(SOURCES_BY_CLASS) == set(DENSITIES)
    for vehicle, density in DENSITIES.items():
        driven = {NonAccident(one.name) for one in dataclasses.fields(density) if getattr(density, one.name) > 0.0}
        assert driven <= set(SOURCES_BY_CLASS[vehicle])


@pytest.mark.parametrize(("vehicle", "least", "most"), [("truck", 0.35, 0.8), ("motorcycle", 0.8, 1.2)])
def test_a_blow_moves_a_heavy_vehicle_less_and_longer(vehicle, least, most):
    for seed in range(10):
        car = frontal(np.random.default_rng(seed))
        felt = felt_by(car, VEHICLES[vehicle], np.random.default_rng([seed, 1]))
        (was,), (now,) = car.blows, felt.blows
        assert now.pulse.sum() / FINE_HZ == pytest.approx(1.0)
        if least * was.delta_v_mps > 3.3:  # weaker ones are raised to what its tyres leave of them
            assert least * was.delta_v_mps <= now.delta_v_mps <= most * was.delta_v_mps
        longer = now.pulse.size / was.pulse.size
        assert (longer > 1.1) if vehicle == "truck" else (longer < 1.0)


def test_a_motorcycle_in_a_bend_feels_its_weight_along_its_own_vertical():
    for seed in range(5):
        one = SOURCES[NonAccident.HARD_CORNERING].draw(np.random.default_rng(seed), 15.0, VEHICLES["motorcycle"])
        lean = one.rpy_rad[:, 0]
        across = one.accel_b[:, 1] - G * np.sin(lean)
        assert np.abs(across).max() < 1e-9  # tan(lean) g is what turns it
        assert math.degrees(np.abs(lean).max()) > 25.0


@pytest.mark.parametrize("lean_deg", [40.0, 50.0])
def test_a_motorcycle_that_leans_into_a_bend_is_no_rollover(lean_deg):
    motion = drive(seconds=12.0)
    t_s = (motion.t_ns - EPOCH_NS) * 1e-9
    leant = np.radians(lean_deg) * np.clip(np.minimum(t_s - 3.0, 9.0 - t_s) / 0.7, 0.0, 1.0)
    assert ImpactDetector(BIKE).step(leaning(motion, leant)).impacts == []


def test_a_motorcycle_that_slips_away_is_an_accident_though_nothing_struck_it():
    motion = drive(seconds=20.0)
    t_s = (motion.t_ns - EPOCH_NS) * 1e-9
    motion = lying(motion, np.radians(80.0) * np.clip((t_s - 3.0) / 0.6, 0.0, 1.0) ** 2)
    motion.speed_mps[:] = np.clip(12.0 - 5.0 * np.maximum(t_s - 3.2, 0.0), 0.0, None)
    found = ImpactDetector(BIKE).step(motion).impacts
    assert found[-1].status is Status.CONFIRMED
    assert found[-1].rollover


def test_a_motorcycle_that_falls_where_it_stands_is_told_as_that_and_as_no_accident():
    motion = drive(speed_mps=0.0, seconds=12.0)
    t_s = (motion.t_ns - EPOCH_NS) * 1e-9
    fallen = lying(motion, np.radians(80.0) * np.clip((t_s - 3.0) / 0.9, 0.0, 1.0) ** 2)
    found = ImpactDetector(BIKE).step(fallen)
    assert found.impacts == []
    assert NoAccident.FELL_OVER in [one.reason for one in found.candidates]
    as_car = ImpactDetector().step(fallen)
    assert NoAccident.FELL_OVER not in [one.reason for one in as_car.candidates]


@pytest.mark.parametrize(
    ("vehicle", "kind", "seed"),
    [
        ("motorcycle", NonAccident.WHEELIE, 205),
        ("motorcycle", NonAccident.STOPPIE, 206),
        ("motorcycle", NonAccident.FALL_AT_REST, 207),
        ("truck", NonAccident.TIPPING_BODY, 208),
        ("truck", NonAccident.TRAILER_COUPLING, 209),
        ("bus", NonAccident.KERB, 210),
    ],
)
def test_what_only_such_vehicles_do_is_no_accident(vehicle, kind, seed):
    found = ImpactDetector(for_vehicle(vehicle)).step(quiet_case(kind, seed, vehicle=vehicle).motion)
    assert [one for one in found.impacts if one.status is not Status.RETRACTED] == []


@pytest.mark.parametrize(
    ("vehicle", "name"),
    [("van", "frontal"), ("truck", "rear"), ("bus", "frontal"), ("motorcycle", "side"), ("motorcycle", "lowside")],
)
def test_an_accident_of_each_class_is_found_by_its_profile(vehicle, name):
    case = accident_case(name, 211, 16.0, 100.0, vehicle)
    found = ImpactDetector(for_vehicle(vehicle)).step(case.motion).impacts
    assert found
    assert found[-1].status is not Status.RETRACTED
    if name != "lowside":
        assert found[-1].delta_v_mps == pytest.approx(case.truth.delta_v_mps, rel=0.15, abs=0.3)
        assert found[-1].kind is Kind.COLLISION
    assert found[-1].rollover is (abs(case.truth.roll_deg) > 65.0)  # most motorcycles that are struck fall over
