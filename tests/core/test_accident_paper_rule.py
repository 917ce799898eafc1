"""Seed 1's rule: both thresholds at one sample, its unit, and what it says of an accident."""

from __future__ import annotations

import math

import numpy as np
import pytest

from core.accident.detector import ImpactDetector
from core.accident.events import Severity, VehicleMotion
from core.accident.paper_rule import PaperRule
from core.accident.thresholds import PaperThresholds

G = 9.80665
EPOCH_NS = 1_700_000_000_000_000_000
RATE_HZ = 200
HIT = slice(600, 610)
"""Samples with the acceleration and yaw rate of a test: 50 ms, 3 s into the motion."""


def motion(*, acceleration_mps2=(0.0, 0.0, 0.0), yaw_rate_degps=0.0, speed_mps=5.0, at=HIT, seconds=6):
    n = seconds * RATE_HZ
    f_b = np.tile([0.0, 0.0, -G], (n, 1))
    omega_b = np.zeros((n, 3))
    for where in [at] if isinstance(at, slice) else at:
        f_b[where] += acceleration_mps2
        omega_b[where, 2] = math.radians(yaw_rate_degps)
    return VehicleMotion(
        t_ns=EPOCH_NS + np.arange(n, dtype=np.int64) * (1_000_000_000 // RATE_HZ),
        f_b=f_b,
        omega_b=omega_b,
        down_b=np.tile([0.0, 0.0, 1.0], (n, 1)),
        speed_mps=np.full(n, speed_mps),
        saturated=np.zeros(n, dtype=np.uint8),
        gravity_mps2=G,
    )


def told(given, thresholds=None):
    return PaperRule(thresholds).step(given).impacts


@pytest.mark.parametrize(
    ("acceleration", "yaw_rate", "speed", "holds"),
    [
        ((-3.8, 0.0, 0.0), 76.0, 5.0, True),  # 15.2 deg/m
        ((-3.6, 0.0, 0.0), 76.0, 5.0, False),  # too soft
        ((-3.8, 0.0, 0.0), 74.0, 5.0, False),  # 14.8 deg/m: too straight
        ((0.0, 0.0, 3.8), -76.0, 5.0, True),  # any axis, either way
        ((2.2, 2.2, 2.2), 76.0, 5.0, True),  # the norm of three axes is 3.81
        ((0.0, 0.0, 0.0), 200.0, 5.0, False),  # gravity is no acceleration
    ],
)
def test_both_thresholds_must_be_passed_at_once(acceleration, yaw_rate, speed, holds):
    given = motion(acceleration_mps2=acceleration, yaw_rate_degps=yaw_rate, speed_mps=speed)
    assert bool(told(given)) is holds


def test_the_thresholds_must_be_passed_at_the_same_sample():
    given = motion(acceleration_mps2=(-8.0, 0.0, 0.0))
    given.omega_b[620:630, 2] = math.radians(100.0)
    assert told(given) == []


def test_the_reading_of_3_3_takes_the_curvature_in_radians():
    given = motion(acceleration_mps2=(-8.0, 0.0, 0.0), yaw_rate_degps=250.0, speed_mps=5.0)
    literal = PaperThresholds(curvature_unit_deg=math.degrees(1.0))
    assert told(given)
    assert told(given, literal) == []  # 15 1/m: a radius below 7 cm


@pytest.mark.parametrize(("yaw_rate", "holds"), [(7.0, False), (8.0, True)])
def test_at_a_standstill_the_speed_counts_as_half_a_metre_a_second(yaw_rate, holds):
    given = motion(acceleration_mps2=(0.0, 6.0, 0.0), yaw_rate_degps=yaw_rate, speed_mps=0.0)
    assert bool(told(given)) is holds


def test_a_door_slammed_on_a_parked_car_with_a_noisy_gyroscope_is_no_accident():
    given = motion(acceleration_mps2=(0.0, 6.0, 0.0), speed_mps=0.0)
    given.omega_b[:, 2] = np.random.default_rng(5).normal(0.0, math.radians(0.4), len(given.t_ns))
    assert told(given) == []


def test_the_rule_does_not_hold_while_the_speed_is_unknown():
    assert told(motion(acceleration_mps2=(-8.0, 0.0, 0.0), yaw_rate_degps=200.0, speed_mps=math.nan)) == []


@pytest.mark.parametrize(
    ("acceleration", "length", "severity"),
    [(-8.0, 100, Severity.LOW_SPEED), (-16.0, 160, Severity.SEVERE), (-90.0, 20, Severity.AIRBAG)],
)
def test_an_accident_is_told_with_its_class_and_change_of_velocity(acceleration, length, severity):
    at = slice(600, 600 + length)
    given = motion(acceleration_mps2=(acceleration, 0.0, 0.0), yaw_rate_degps=10.0, speed_mps=0.6, at=at)
    (impact,) = told(given)
    assert impact.severity is severity
    # The window reaches half a second from the first sample, so of the 0.8 s pulse it sees 0.5 s.
    seen_s = min(length / RATE_HZ, 0.5)
    expected = abs(acceleration) * (length / RATE_HZ if severity is not Severity.SEVERE else seen_s)
    assert impact.delta_v_mps == pytest.approx(expected, rel=0.03)
    assert impact.delta_v_b_mps[0] < 0
    # Turning by 10 deg/s over up to half a second, the force comes from 2.5 degrees right of ahead on average.
    assert impact.pdof_deg == pytest.approx(2.5 * min(seen_s / 0.5, 1.0), abs=0.5)
    assert impact.speed_before_mps == 0.6
    assert impact.t_ns == given.t_ns[600]
    assert impact.decided_t_ns - impact.t_ns == 500_000_000
    assert impact.detector == "paper"


@pytest.mark.parametrize(("apart_s", "accidents"), [(4.0, 1), (7.0, 2)])
def test_samples_within_five_seconds_are_one_accident(apart_s, accidents):
    later = 600 + round(apart_s * RATE_HZ)
    given = motion(
        acceleration_mps2=(-8.0, 0.0, 0.0),
        yaw_rate_degps=200.0,
        at=(HIT, slice(later, later + 10)),
        seconds=15,
    )
    assert len(told(given)) == accidents


@pytest.mark.parametrize("yaw_rate", [0.0, 200.0])
def test_the_other_detector_says_whether_the_rule_agrees(yaw_rate):
    at = slice(600, 620)
    given = motion(acceleration_mps2=(-60.0, 0.0, 0.0), yaw_rate_degps=yaw_rate, at=at)
    given.omega_b[at, 1] = np.radians(20.0) * np.sin(np.linspace(0.0, np.pi, 20))  # a blow nods the car
    given.f_b[at, 0] *= np.linspace(0.5, 1.5, 20)
    impact, *_ = ImpactDetector().step(given).impacts
    assert impact.paper_agrees is (yaw_rate > 0)
