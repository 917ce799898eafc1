"""Names for what was no accident: which of the known classes a shock, a manoeuvre or a weak pulse belongs to."""

from __future__ import annotations

import math
from dataclasses import dataclass

from core.accident.events import NoAccident
from core.tunables import Tunables, tunable


@dataclass(frozen=True, slots=True)
class NamingThresholds(Tunables):
    """By what the classes that are no accidents are told from each other."""

    abrupt_share: float = tunable(
        0.04, unit="1", low=0.0, high=0.5, source="choice: bodies swell and ring; converters fail within a sample"
    )
    abrupt_radps: float = tunable(
        0.2, unit="rad/s", low=0.0, high=2.0, source="choice: a turn is felt, but no blow that turns the car"
    )
    stuck_s: float = tunable(
        0.1, unit="s", low=0.02, high=1.0, source="choice: shocks that are no accidents clip for less"
    )
    fallen_radps: float = tunable(0.8, unit="rad/s", low=0.1, high=10.0, source="choice: a box that falls tumbles")
    knock_radps: float = tunable(
        0.25, unit="rad/s", low=0.05, high=20.0, source="choice: hands turn boxes, doors hardly a standing car"
    )
    loose_radps: float = tunable(
        0.8, unit="rad/s", low=0.1, high=20.0, source="choice: roads turn a car by less within a knock's time"
    )
    knock_s: float = tunable(
        0.04, unit="s", low=0.005, high=0.2, source="choice: knocks are shorter than a wheel's way"
    )
    slow_mps: float = tunable(1.2, unit="m/s", low=0.3, high=5.0, source="choice: kerb stones stop who parks")
    level_share: float = tunable(
        0.5, unit="1", low=0.1, high=2.0, source="choice: what shakes so little is no road but brakes or steering"
    )
    steady_mps2: float = tunable(2.5, unit="m/s2", low=0.5, high=10.0, source="choice: quarter of a g throughout")
    rough_mps2: float = tunable(
        3.0, unit="m/s2", low=1.0, high=20.0, source="choice: rms of cobbles and gravel, ISO 8608 classes D and E"
    )
    train_shocks: int = tunable(
        6, unit="1", low=3, high=50, source="choice: two axles over two rails make four shocks, cobbles no end"
    )
    gauge: float = tunable(
        0.32,
        unit="1",
        low=0.0,
        high=1.0,
        source="simulated, dense long drives: humps and holes repeat less after 1.435 m",
    )
    rises: float = tunable(
        0.02,
        unit="1",
        low=0.0,
        high=1.0,
        source="shocks_road_anomalies_2017: 172 of 200 bumps lift a car first by more, and 12 of 100 potholes",
    )
    hole_m: float = tunable(
        1.1, unit="m", low=0.1, high=10.0, source="simulated: an edge's step is over sooner; holes let a car swing"
    )
    train_s: float = tunable(
        0.45, unit="s", low=0.1, high=2.0, source="choice: longer than a hole shakes a car at speed"
    )
    train_m: float = tunable(8.0, unit="m", low=1.0, high=100.0, source="choice: two lengths of a car")
    train_mps2: float = tunable(
        1.9, unit="m/s2", low=0.5, high=20.0, source="choice: rms before, on a road that shakes on: ISO 8608 class D"
    )
    crossing_m: float = tunable(
        4.5, unit="m", low=1.0, high=20.0, source="two axles, 2.6 m apart, over a track of 1.435 m"
    )
    crossing_most_m: float = tunable(
        28.0, unit="m", low=4.0, high=100.0, source="choice: two tracks, two axles, and the springs' way to rest"
    )
    even_share: float = tunable(
        0.5, unit="1", low=0.0, high=2.0, source="choice: what both wheels of an axle meet at once hardly rolls a car"
    )
    pushed_radps: float = tunable(
        0.03, unit="rad/s", low=0.0, high=1.0, source="choice, 2 deg/s: a car pitches by it when pushed"
    )
    kerb_mps: float = tunable(7.5, unit="m/s", low=1.0, high=15.0, source="choice: kerbs are mounted slowly")
    kerb_radps: float = tunable(
        0.12, unit="rad/s", low=0.05, high=3.0, source="simulated: one side at a time is lifted"
    )
    bump_mps: float = tunable(
        14.0, unit="m/s", low=5.0, high=30.0, source="choice: humps stand where 50 km/h is the limit"
    )
    ferry_leans: int = tunable(3, unit="1", low=2, high=50, source="choice: a ship rolls on, a truck is loaded once")


@dataclass(frozen=True, slots=True)
class Shock:
    """A shock as it was felt, or a train of them, with what went on around it.

    Parameters
    ----------
    speed_mps : speed before; NaN while unknown
    stood, moved : whether the vehicle had stood, and whether it has moved within the last minutes
    shocks : how many followed each other
    abrupt : largest acceleration right before and after, over the peak
    clipping_s : for how long an axis of the accelerometer read its full scale at a stretch
    heave_s : length of the largest vertical swing
    rises : share of its vertical change of velocity that is upwards before it is downwards; negative where it is not
    gauge : how much its vertical acceleration repeats itself after a track's gauge of way, -1..1; 0 while unknown
    uneven : rms of the roll rate over that of the pitch rate
    shaken_s : for how long the vertical shakes by more than a third of its peak, from first to last
    sway_radps, nod_radps, turn_radps : largest roll, pitch and yaw rates
    rough_mps2 : rms of the vertical acceleration just before
    forward_mps2, right_mps2 : the mean horizontal acceleration of it
    fell : whether the box fell just before
    tilt_deg : how far the vertical is from where it usually is
    towed : whether the box says that the vehicle is towed
    """

    speed_mps: float
    stood: bool
    moved: bool
    shocks: int
    abrupt: float
    clipping_s: float
    heave_s: float
    rises: float
    gauge: float
    uneven: float
    shaken_s: float
    sway_radps: float
    nod_radps: float
    turn_radps: float
    rough_mps2: float
    forward_mps2: float
    right_mps2: float
    vertical_mps2: float
    horizontal_mps2: float
    fell: bool
    tilt_deg: float
    towed: bool


def name(shock: Shock, limits: NamingThresholds) -> NoAccident:
    """The class that fits a shock best; UNEXPLAINED where none does. Rules in the order of how sure they are."""
    rate = math.sqrt(shock.sway_radps**2 + shock.nod_radps**2 + shock.turn_radps**2)
    if shock.fell and rate > limits.fallen_radps:
        return NoAccident.BOX_DROPPED
    if shock.clipping_s > limits.stuck_s or (shock.abrupt < limits.abrupt_share and rate < limits.abrupt_radps):
        return NoAccident.SENSOR_GLITCH
    if shock.stood:
        if shock.towed:
            return NoAccident.TOWING
        if rate > limits.knock_radps:
            return NoAccident.BOX_KNOCKED
        return NoAccident.TRAILER_COUPLING if _pushed_along(shock, limits) else NoAccident.DOOR_SLAM
    if _is_train(shock, limits):
        return NoAccident.VIBRATION_TRAIN
    if rate > limits.loose_radps and shock.heave_s < limits.knock_s:
        return NoAccident.BOX_KNOCKED
    if shock.vertical_mps2 < limits.level_share * shock.horizontal_mps2:
        if shock.speed_mps < limits.slow_mps:
            return NoAccident.KERB
        return manoeuvre(shock.forward_mps2, shock.right_mps2, limits)
    return _road(shock, limits)


def _road(shock: Shock, limits: NamingThresholds) -> NoAccident:
    """What a road does to a car that drives over it: a hump lifts it before it falls, a hole lets it fall first."""
    if shock.rough_mps2 > limits.rough_mps2:
        return NoAccident.VIBRATION_TRAIN
    if _is_crossing(shock, limits):
        return NoAccident.RAILWAY_CROSSING
    rises = shock.rises > limits.rises
    if shock.speed_mps < limits.kerb_mps and shock.sway_radps > limits.kerb_radps:
        sinks = not rises and shock.heave_s * shock.speed_mps > limits.hole_m
        return NoAccident.POTHOLE if sinks else NoAccident.KERB
    if shock.shocks >= limits.train_shocks:
        return NoAccident.VIBRATION_TRAIN
    return NoAccident.SPEED_BUMP if rises and not shock.speed_mps > limits.bump_mps else NoAccident.POTHOLE


def _pushed_along(shock: Shock, limits: NamingThresholds) -> bool:
    """Whether a standing car was pushed along and pitched, as by a trailer: doors roll it, boots strike downwards."""
    level = shock.vertical_mps2 < limits.level_share * shock.horizontal_mps2
    return level and shock.nod_radps > max(limits.pushed_radps, shock.sway_radps)


def _is_train(shock: Shock, limits: NamingThresholds) -> bool:
    """Whether a rough road shook on and on, one side unlike the other."""
    goes_on = shock.shaken_s > limits.train_s and shock.shaken_s * shock.speed_mps > limits.train_m
    uneven = shock.sway_radps > shock.nod_radps and shock.vertical_mps2 > limits.level_share * shock.horizontal_mps2
    return goes_on and uneven and shock.rough_mps2 > limits.train_mps2


def _is_crossing(shock: Shock, limits: NamingThresholds) -> bool:
    """Whether rails were crossed: both wheels of an axle at once, rail after rail; or what lifts it where none humps.

    At a track's gauge after a rail there is another.
    """
    if shock.uneven > limits.even_share:
        return False
    far = limits.crossing_m < shock.shaken_s * shock.speed_mps < limits.crossing_most_m
    lifted = shock.rises > limits.rises and shock.speed_mps > limits.bump_mps
    return lifted or (far and shock.gauge > limits.gauge)


def manoeuvre(forward_mps2: float, right_mps2: float, limits: NamingThresholds) -> NoAccident:
    """Hard braking or cornering, by the acceleration that goes on, m/s2."""
    if -forward_mps2 > max(limits.steady_mps2, abs(right_mps2)):
        return NoAccident.EMERGENCY_BRAKING
    if abs(right_mps2) > max(limits.steady_mps2, abs(forward_mps2)):
        return NoAccident.HARD_CORNERING
    return NoAccident.UNEXPLAINED


def lean(leans: int, limits: NamingThresholds) -> NoAccident:
    """What leans a parked vehicle, by how often it has."""
    return NoAccident.FERRY if leans >= limits.ferry_leans else NoAccident.TOWING
