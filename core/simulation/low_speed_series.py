"""Seed 1's drive (section 4.3): hours below 20 m/s with low-speed accidents among all that is taken for one."""

from __future__ import annotations

from typing import Final

import numpy as np

from core.simulation.crashes import Crash
from core.simulation.disturbances import NonAccident
from core.simulation.handling import SOURCES, Source
from core.simulation.pulses import CRASH_SHAPES
from core.simulation.roads import CRUISE_MPS, LONGEST_BLOCK_S, STILL_START_S, finish, streets
from core.simulation.route import Route, RouteBuilder, Sky
from core.simulation.shapes import Shape

ACCIDENTS: Final = 21
WHOLE_S: Final = 12600.0
"""A shorter drive has fewer."""
IN_OUTAGE: Final = 3
"""Every third accident lies in an outage of GNSS of 40 to 60 s."""

_AMONG: Final = (
    NonAccident.POTHOLE,
    NonAccident.POTHOLE,
    NonAccident.SPEED_BUMP,
    NonAccident.KERB,
    NonAccident.RAILWAY_CROSSING,
    NonAccident.DOOR_SLAM,
    NonAccident.PARKING_BUMP,
    NonAccident.VIBRATION,
)
_BRAKING_MPS2: Final = (6.0, 9.5)
"""Hard braking on dry asphalt; a choice."""


def seed1(rng: np.random.Generator, duration_s: float) -> Route:
    """Streets with a non-accident every half a minute, now and then a hard braking, and 21 accidents in 3.5 h."""
    b = RouteBuilder(heading_deg=rng.uniform(0.0, 360.0)).hold(STILL_START_S)
    accidents = max(1, round(ACCIDENTS * duration_s / WHOLE_S))
    spacing_s = duration_s / (accidents + 1)
    met = 0
    for accident in range(accidents):
        until_s = (accident + 1) * spacing_s - 30.0
        while b.t_s + 2 * LONGEST_BLOCK_S < until_s:
            _shaken(b, SOURCES[_AMONG[met % len(_AMONG)]], rng)
            met += 1
            if met % len(_AMONG) == 0:
                streets(b, rng, min(b.t_s + LONGEST_BLOCK_S + 20.0, until_s), canyons=False)
        crash, speed_mps = low_speed_crash(rng)
        b.to_speed(speed_mps, 2.0).hold(rng.uniform(1.5, 4.0))
        if accident % IN_OUTAGE == IN_OUTAGE - 1:
            since_s = b.t_s - rng.uniform(5.0, 35.0)
            kind = Sky.TUNNEL if rng.random() < 0.5 else Sky.OUTAGE
            b.under(kind, since_s, since_s + rng.uniform(40.0, 60.0))
        b.crash(crash).roll_out(rng.uniform(3.0, 5.0)).hold(rng.uniform(15.0, 25.0)).to_speed(CRUISE_MPS)
    return finish(b, duration_s)


def low_speed_crash(rng: np.random.Generator) -> tuple[Crash, float]:
    """An accident of seed 1's class (mean speed 3.5 m/s, |dv| below 6.5 m/s) and the speed to have it at, m/s."""
    standing = rng.random() < 0.15
    speed_mps = 0.0 if standing else float(np.clip(rng.normal(3.5, 1.2), 1.5, 7.0))
    delta_v = float(1.8 * (6.2 / 1.8) ** rng.random())
    pdof_deg = (
        rng.uniform(140.0, 220.0) if standing else rng.choice([rng.uniform(-45.0, 45.0), rng.uniform(0.0, 360.0)])
    )
    crash = Crash(
        delta_v_mps=delta_v,
        pdof_deg=float(pdof_deg) % 360.0,
        duration_s=rng.uniform(0.09, 0.2),
        shape=CRASH_SHAPES[rng.integers(len(CRASH_SHAPES))],
        yaw_deg=rng.uniform(-3.0, 3.0) * delta_v,
    )
    return crash, speed_mps


def _shaken(b: RouteBuilder, source: Source, rng: np.random.Generator) -> None:
    """A non-accident, on the way to it a turn or a bend, and in one of four a hard braking after it."""
    if source.high_mps == 0.0:
        b.to_speed(0.0, 2.0).hold(2.0)
    else:
        b.to_speed(6.0).turn(rng.choice([-1.0, 1.0]) * rng.uniform(10.0, 90.0), rng.uniform(10.0, 20.0))
        b.to_speed(rng.uniform(max(source.low_mps, 1.5), min(source.high_mps, 15.0)), 2.0).hold(1.0)
    b.disturb(source.draw(rng, b.speed_mps)).hold(1.5)
    if rng.random() < 0.25:
        b.to_speed(rng.uniform(10.0, 15.0), 2.2)
        b.to_speed(rng.uniform(0.0, 4.0), rng.uniform(*_BRAKING_MPS2), Shape.ABRUPT).hold(2.0)
