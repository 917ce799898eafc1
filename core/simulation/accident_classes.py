"""Classes of accidents and how one of each is drawn: how hard, from where, how fast, and what follows."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Final

import numpy as np

from core.simulation.collisions import SPIN_DECAY_RADPS2, After, Blow, Collision, mirrored
from core.simulation.pulses import CRASH_SHAPES, shaped_pulse
from core.simulation.ride import FINE_HZ

LEAST_MPS: Final = 1.8
MOST_MPS: Final = 20.0
"""Changes of velocity drawn, m/s; even in their logarithm, as mild accidents are many. Tyres that hold against a blow
take up to 0.4 m/s of it: what a box feels begins at about 1.5 m/s."""
LOW_SPEED_MPS: Final = 6.5
"""Seed 1, 3.3: a low-speed accident's change of velocity stays below."""

Draw = Callable[[np.random.Generator], Collision]


def _delta_v(rng: np.random.Generator, low: float = LEAST_MPS, high: float = MOST_MPS) -> float:
    return float(low * (high / low) ** rng.random())


def _duration_s(delta_v_mps: float, rng: np.random.Generator) -> float:
    """Pulses last 70 to 160 ms: bumpers that touch gently 90 to 160, stiff severe ones 70 to 140 (choice, about the
    95 ms of NHTSA test 10146 and the 100 to 120 ms usual of car-to-car crashes)."""
    low, high = (0.09, 0.16) if delta_v_mps < LOW_SPEED_MPS else (0.07, 0.14)
    return float(rng.uniform(low, high))


def _pulse(duration_s: float, rng: np.random.Generator) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """One of the shapes, its middle moved forward or back by up to a sixth, or two of them one after the other."""
    shape = CRASH_SHAPES[rng.integers(len(CRASH_SHAPES))]
    pulse = shaped_pulse(shape, duration_s)
    n = pulse.size
    bend = rng.uniform(-0.35, 0.35)
    x = (np.arange(n) + 0.5) / n
    pulse = np.interp(x + bend * x * (1 - x), x, pulse, left=0.0, right=0.0)
    if rng.random() < 0.3:  # a bumper gives way before the structure does
        part = shaped_pulse(shape, 0.6 * duration_s)
        pulse[: part.size] += rng.uniform(0.2, 0.8) * part[:n]
    return np.asarray(pulse * (FINE_HZ / pulse.sum()))


def _blow(
    delta_v_mps: float,
    pdof_deg: float,
    rng: np.random.Generator,
    duration_s: float | None = None,
    yaw_deg: float | None = None,
    after_s: float = 0.0,
) -> Blow:
    """A pulse with the turn it brings: off-centre blows turn the car by up to some 5 deg a m/s of their own."""
    length_s = _duration_s(delta_v_mps, rng) if duration_s is None else duration_s
    turn = math.radians(rng.normal(0.0, 2.0) * delta_v_mps if yaw_deg is None else yaw_deg)
    rate = math.copysign(math.sqrt(2.0 * SPIN_DECAY_RADPS2 * abs(turn)), turn)
    return Blow(delta_v_mps, pdof_deg % 360.0, _pulse(length_s, rng), rate, after_s)


def _box(rng: np.random.Generator) -> tuple[float, float, float]:
    """Where the box sits: dashboard to rear seat, near the middle."""
    return float(rng.uniform(-0.3, 1.0)), float(rng.uniform(-0.4, 0.4)), float(rng.uniform(-0.4, 0.1))


def _hit(name: str, rng: np.random.Generator, pdof_deg: float, delta_v_mps: float) -> Collision:
    """A car on its way is hit once; frontal ones lose at most some more than their speed. Half of them brake before."""
    against = max(0.0, math.cos(math.radians(pdof_deg))) * delta_v_mps
    return Collision(
        name=name,
        blows=(_blow(delta_v_mps, pdof_deg, rng),),
        speed_mps=max(rng.uniform(0.85, 1.0) * against, 1.0) + rng.uniform(0.0, 8.0),
        braking_mps2=rng.uniform(3.0, 8.5),
        braking_s=rng.uniform(0.4, 1.5) * (rng.random() < 0.45),
        decel_mps2=rng.uniform(2.0, 6.5),
        ringing_share=rng.uniform(0.1, 0.5),
        box_m=_box(rng),
    )


def frontal(rng: np.random.Generator) -> Collision:
    """Into what is ahead, within 30 degrees."""
    return _hit("frontal", rng, rng.uniform(-30.0, 30.0), _delta_v(rng))


def rear(rng: np.random.Generator) -> Collision:
    """Struck from behind while moving."""
    return _hit("rear", rng, rng.uniform(150.0, 210.0), _delta_v(rng, high=12.0))


def side(rng: np.random.Generator) -> Collision:
    """Struck on a side in a crossing."""
    found = _hit("side", rng, rng.uniform(50.0, 130.0), _delta_v(rng, high=14.0))
    return found if rng.random() < 0.5 else mirrored(found)


def oblique(rng: np.random.Generator) -> Collision:
    """A corner is hit: between front and side or side and rear, and the car turns."""
    delta_v, pdof = _delta_v(rng, high=15.0), rng.choice([rng.uniform(30.0, 60.0), rng.uniform(120.0, 150.0)])
    blow = _blow(delta_v, pdof, rng, yaw_deg=rng.uniform(-6.0, 6.0) * delta_v)
    found = replace(_hit("oblique", rng, pdof, delta_v), blows=(blow,))
    return found if rng.random() < 0.5 else mirrored(found)


def sideswipe(rng: np.random.Generator) -> Collision:
    """Along another car's side or a guard rail: a long, soft pulse, half forward and half across."""
    delta_v, pdof = _delta_v(rng, 2.0, 6.0), rng.uniform(25.0, 75.0)
    blow = _blow(delta_v, pdof, rng, duration_s=rng.uniform(0.12, 0.28), yaw_deg=rng.uniform(-12.0, 4.0))
    found = replace(_hit("sideswipe", rng, pdof, delta_v), blows=(blow,), speed_mps=delta_v + rng.uniform(2.0, 15.0))
    return found if rng.random() < 0.5 else mirrored(found)


def low_speed(rng: np.random.Generator) -> Collision:
    """Seed 1's class: mean speed 3.5 m/s, |dv| below 6.5 m/s, from anywhere."""
    delta_v = _delta_v(rng, high=0.95 * LOW_SPEED_MPS)
    pdof = rng.choice([rng.uniform(-40.0, 40.0), rng.uniform(0.0, 360.0)])
    speed = float(np.clip(rng.normal(3.5, 1.2), 0.8, 7.0))
    return replace(_hit("low_speed", rng, pdof, delta_v), speed_mps=speed, braking_s=0.0)


def struck_standing(rng: np.random.Generator) -> Collision:
    """Standing with the engine on, struck from anywhere, mostly from behind; the brakes may be on."""
    delta_v = _delta_v(rng, high=10.0)
    pdof = rng.uniform(150.0, 210.0) if rng.random() < 0.6 else rng.uniform(0.0, 360.0)
    return replace(_hit("struck_standing", rng, pdof, delta_v), speed_mps=0.0, braking_s=0.0)


def parked_hit(rng: np.random.Generator) -> Collision:
    """Parked, ignition off, struck from anywhere."""
    delta_v = _delta_v(rng, high=8.0)
    return replace(
        _hit("parked_hit", rng, rng.uniform(0.0, 360.0), delta_v),
        speed_mps=0.0,
        braking_s=0.0,
        ignition=False,
        decel_mps2=rng.uniform(4.0, 7.0),
    )


def hit_and_run(rng: np.random.Generator) -> Collision:
    """Hits and drives on."""
    delta_v = _delta_v(rng, high=5.0)
    pdof = rng.uniform(-60.0, 60.0)
    speed = delta_v + rng.uniform(3.0, 10.0)
    return replace(_hit("hit_and_run", rng, pdof, delta_v), speed_mps=speed, after=After.DRIVE_ON)


def multi_impact(rng: np.random.Generator) -> Collision:
    """A first blow, and one or two more 0.3 to 4 s later from elsewhere."""
    first = _delta_v(rng, 2.3, 12.0)
    blows, after = [_blow(first, rng.uniform(-60.0, 60.0), rng)], 0.0
    for _ in range(int(rng.integers(1, 3))):
        after += rng.uniform(0.3, 2.0)
        delta_v = _delta_v(rng, 2.0, 10.0)
        blows.append(_blow(delta_v, rng.uniform(0.0, 360.0), rng, after_s=after))
    speed = first + rng.uniform(4.0, 12.0)
    return replace(_hit("multi_impact", rng, blows[0].pdof_deg, first), blows=tuple(blows), speed_mps=speed)


def spin(rng: np.random.Generator) -> Collision:
    """Hit at a corner so that it spins by 60 to 200 degrees, at 130 to 240 deg/s at first."""
    delta_v, pdof = _delta_v(rng, 3.0, 12.0), rng.uniform(100.0, 170.0)
    blow = _blow(delta_v, pdof, rng, yaw_deg=rng.uniform(60.0, 200.0))
    found = replace(_hit("spin", rng, pdof, delta_v), blows=(blow,), speed_mps=rng.uniform(8.0, 20.0))
    return found if rng.random() < 0.5 else mirrored(found)


def off_road(rng: np.random.Generator) -> Collision:
    """A blow, then rough ground, and in half of them a tree or ditch within 4 s."""
    first = _delta_v(rng, 2.0, 8.0)
    blows = [_blow(first, rng.uniform(-80.0, 80.0), rng)]
    if rng.random() < 0.5:
        after = rng.uniform(0.8, 4.0)
        blows.append(_blow(_delta_v(rng, 3.0, 12.0), rng.uniform(-60.0, 60.0), rng, after_s=after))
    speed = first + rng.uniform(8.0, 15.0)
    hit = _hit("off_road", rng, blows[0].pdof_deg, first)
    return replace(hit, blows=tuple(blows), speed_mps=speed, after=After.OFF_ROAD)


def rollover(rng: np.random.Generator) -> Collision:
    """Tripped while sliding sideways: it tips over by one to four quarters and lies.

    A trip by soil or kerb takes 0.1 to 0.35 s for 2.5 to 6 m/s, and roll rates reach 150 to 450 deg/s (choice).
    """
    delta_v, quarters = _delta_v(rng, 2.5, 6.0), int(rng.integers(1, 5))
    blow = _blow(delta_v, rng.uniform(70.0, 110.0), rng, duration_s=rng.uniform(0.1, 0.35), yaw_deg=0.0)
    found = replace(
        _hit("rollover", rng, blow.pdof_deg, delta_v),
        blows=(blow,),
        speed_mps=rng.uniform(8.0, 22.0),
        roll_deg=90.0 * quarters,
        roll_s=rng.uniform(0.9, 1.3) * (0.4 + 0.6 * quarters),
        decel_mps2=rng.uniform(3.0, 5.0),
        grip=0.05,
    )
    # Hit low on the right side, the car rolls to the right.
    return found if rng.random() < 0.5 else mirrored(found)


CLASSES: Final[Mapping[str, Draw]] = MappingProxyType(
    {
        draw.__name__: draw
        for draw in (
            frontal,
            rear,
            side,
            oblique,
            sideswipe,
            low_speed,
            struck_standing,
            parked_hit,
            hit_and_run,
            multi_impact,
            spin,
            off_road,
            rollover,
        )
    }
)
