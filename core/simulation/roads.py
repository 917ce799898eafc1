"""Routes of the scenarios: where they lead, what happens on them, and when."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from core.errors import InvalidInputError
from core.simulation.crashes import FRONT_BUMP, GLANCING, SEVERE_FRONTAL, SEVERE_SIDE, STRUCK_AT_REST, Crash
from core.simulation.route import Route, RouteBuilder, Sky
from core.simulation.shapes import Shape

STILL_START_S: Final = 15.0
"""Time that every drive stands at first, as after switching on, s."""
LONGEST_BLOCK_S: Final = 50.0
"""Bound of one random piece of street, s: so much before the end, the streets stop."""
CRUISE_MPS: Final = 12.5
_HARD_BRAKING_MPS2: Final = 7.8
"""Emergency braking on dry asphalt, m/s2: above the paper's 3.7, and no accident."""


def tunnel_crash(rng: np.random.Generator, duration_s: float) -> Route:
    """Streets, a glancing low-speed crash, then a tunnel with a severe crash 20 s in.

    Time to spare is spent in more streets before the first crash.
    """
    b = _opening()
    ending_s = _ending(RouteBuilder(speed_mps=CRUISE_MPS)).t_s
    _require("tunnel_crash", duration_s, b.t_s + ending_s)
    if duration_s - ending_s > b.t_s + LONGEST_BLOCK_S:
        streets(b, rng, duration_s - ending_s, canyons=True)
    return finish(_ending(b), duration_s)


def city(rng: np.random.Generator, duration_s: float) -> Route:
    """A mix of streets, houses, lights, potholes and hills, and a short tunnel; nothing happens."""
    b = RouteBuilder(heading_deg=rng.uniform(0.0, 360.0)).hold(STILL_START_S)
    while b.t_s + 3 * LONGEST_BLOCK_S < duration_s:
        streets(b, rng, min(b.t_s + 240.0, duration_s - LONGEST_BLOCK_S), canyons=True)
        if b.t_s + 2 * LONGEST_BLOCK_S < duration_s:
            tunnel_s = b.t_s
            b.hold(12.0).turn(20.0, 250.0).hold(10.0).under(Sky.TUNNEL, tunnel_s)
    return finish(b, duration_s)


def highway(rng: np.random.Generator, duration_s: float) -> Route:
    """A motorway: 22 to 34 m/s, long curves, lane changes, bridges overhead, one hard braking."""
    b = RouteBuilder(heading_deg=rng.uniform(0.0, 360.0)).hold(STILL_START_S).to_speed(14.0, 2.2).turn(60.0, 80.0)
    b.to_speed(30.0, 2.0)
    braked = False
    while b.t_s + LONGEST_BLOCK_S < duration_s:
        b.to_speed(rng.uniform(22.0, 34.0), 1.2).grade(rng.uniform(-4.0, 4.0), 10.0)
        b.turn(rng.uniform(5.0, 30.0) * rng.choice([-1.0, 1.0]), rng.uniform(600.0, 900.0))
        b.change_lane(3.6 * rng.choice([-1.0, 1.0]), 4.5).hold(rng.uniform(2.0, 6.0))
        if rng.random() < 0.4:
            b.under(Sky.OUTAGE, b.t_s, b.t_s + rng.uniform(1.5, 3.5)).hold(4.0)
        if not braked and b.t_s > duration_s / 2:
            b.to_speed(12.0, _HARD_BRAKING_MPS2, Shape.ABRUPT).to_speed(25.0, 2.0)
            braked = True
    return finish(b, duration_s)


def outages(rng: np.random.Generator, duration_s: float) -> Route:
    """Open streets with a GNSS outage of 60 s every two and a half minutes, from 150 s on."""
    b = RouteBuilder(heading_deg=rng.uniform(0.0, 360.0)).hold(STILL_START_S)
    streets(b, rng, duration_s, canyons=False)
    start_s = 150.0
    while start_s + 60.0 < duration_s:
        b.under(Sky.OUTAGE, start_s, start_s + 60.0)
        start_s += 150.0
    return finish(b, duration_s)


def smooth_outages(rng: np.random.Generator, duration_s: float) -> Route:
    """The route of ``outages`` without its bumps and potholes."""
    return replace(outages(rng, duration_s), bumps=())


def parking(rng: np.random.Generator, duration_s: float) -> Route:
    """Manoeuvring in a car park with kerbs and reversing; struck from behind while standing."""
    b = RouteBuilder(heading_deg=rng.uniform(0.0, 360.0)).hold(STILL_START_S)
    struck = False
    while b.t_s + LONGEST_BLOCK_S < duration_s:
        b.to_speed(rng.uniform(2.0, 4.0), 1.2).turn(rng.uniform(60.0, 110.0) * rng.choice([-1.0, 1.0]), 6.5).hold(3.0)
        if rng.random() < 0.5:
            b.bump(0.05, 0.5, 0.5).hold(2.0)
        b.to_speed(0.0, 1.5).hold(4.0).to_speed(-1.2, 0.8).turn(35.0 * rng.choice([-1.0, 1.0]), 6.0).to_speed(0.0, 1.0)
        b.hold(rng.uniform(3.0, 8.0))
        if not struck and b.t_s > duration_s / 2:
            b.crash(STRUCK_AT_REST).roll_out(4.0).hold(15.0)
            struck = True
    return finish(b, duration_s)


def crash_series(rng: np.random.Generator, duration_s: float) -> Route:
    """Streets with an accident every two to three minutes, of all kinds and below 20 m/s (seed 1, 3.5 h)."""
    b = RouteBuilder(heading_deg=rng.uniform(0.0, 360.0)).hold(STILL_START_S)
    while b.t_s + 4 * LONGEST_BLOCK_S < duration_s:
        streets(b, rng, b.t_s + rng.uniform(90.0, 150.0), canyons=True)
        crash, speed_mps = _any_crash(rng)
        b.to_speed(speed_mps, 2.0).hold(2.0)
        b.crash(crash).roll_out(rng.uniform(3.0, 5.0)).hold(rng.uniform(15.0, 25.0)).to_speed(CRUISE_MPS)
    return finish(b, duration_s)


def _any_crash(rng: np.random.Generator) -> tuple[Crash, float]:
    """A crash and a speed to have it at."""
    kind = rng.integers(5)
    if kind == 0:
        return GLANCING, rng.uniform(5.0, 7.0)
    if kind == 1:
        return FRONT_BUMP, rng.uniform(5.0, 9.0)
    if kind == 2:
        return STRUCK_AT_REST, 0.0
    if kind == 3:
        return SEVERE_SIDE, rng.uniform(4.0, 8.0)
    drawn = Crash(
        delta_v_mps=rng.uniform(3.0, 11.0),
        pdof_deg=rng.uniform(-40.0, 40.0) % 360.0,
        duration_s=rng.uniform(0.09, 0.16),
        shape=[Shape.HAVERSINE, Shape.HALF_SINE, Shape.TRIANGLE][rng.integers(3)],
        yaw_deg=rng.uniform(-25.0, 25.0),
    )
    return drawn, drawn.delta_v_mps + rng.uniform(0.5, 5.0)


def _opening() -> RouteBuilder:
    b = RouteBuilder(heading_deg=40.0).hold(STILL_START_S)
    b.to_speed(9.0).hold(6.0).grade(3.0).to_speed(6.0).turn(90.0, 12.0).to_speed(13.0, 2.2).hold(9.0).change_lane(3.2)
    b.grade(0.0).to_speed(0.0, 2.0).hold(9.0)
    canyon_s = b.t_s
    b.to_speed(10.0, 2.0).bump(-0.05, 0.7, 4.0).hold(8.0).to_speed(5.5, 2.0).turn(-90.0, 9.0).to_speed(11.0).hold(10.0)
    b.to_speed(0.0, 2.2).hold(12.0).to_speed(5.0).turn(85.0, 9.0).to_speed(12.0).hold(9.0).bump(-0.06, 0.6, 1.0)
    b.hold(6.0).under(Sky.CANYON, canyon_s)
    b.grade(-4.0).to_speed(5.5, 2.0).bump(0.07, 0.9, 2.0).hold(6.0).grade(0.0).to_speed(14.0, 2.4).hold(7.0)
    b.to_speed(3.0, _HARD_BRAKING_MPS2, Shape.ABRUPT).hold(2.0)
    return b.to_speed(CRUISE_MPS, 2.2).hold(6.0).turn(-40.0, 60.0)


def _ending(b: RouteBuilder) -> RouteBuilder:
    """From cruising to the two crashes; after the second the car stands, then is towed out of the tunnel."""
    b.to_speed(6.2, 2.0).hold(3.0).crash(GLANCING).roll_out(3.5).hold(32.0)
    b.to_speed(9.0).hold(5.0).to_speed(6.0, 2.0).turn(90.0, 14.0).to_speed(14.5, 2.0).hold(14.0)
    tunnel_s = b.t_s
    b.grade(-4.0).hold(7.0).turn(22.0, 260.0).grade(0.0, 4.0)
    b.hold(tunnel_s + 20.0 - b.t_s)
    b.crash(SEVERE_FRONTAL).roll_out(5.0).hold(60.0)
    b.to_speed(4.0, 0.8).grade(4.0).hold(20.0).under(Sky.TUNNEL, tunnel_s)
    return b.hold(16.0).grade(0.0).to_speed(0.0, 0.8).hold(10.0)


def streets(b: RouteBuilder, rng: np.random.Generator, until_s: float, canyons: bool) -> None:
    """Random streets, ending at ``until_s`` (later if that is near) at cruising speed."""
    canyon_s = None
    b.to_speed(CRUISE_MPS)
    while b.t_s + LONGEST_BLOCK_S < until_s:
        if canyons and canyon_s is None and rng.random() < 0.15:
            canyon_s = b.t_s
        elif canyon_s is not None and b.t_s - canyon_s > 60.0:
            b.under(Sky.CANYON, canyon_s)
            canyon_s = None
        _block(b, rng)
    if canyon_s is not None:
        b.under(Sky.CANYON, canyon_s)
    b.grade(0.0).to_speed(CRUISE_MPS)
    b.hold(max(0.0, until_s - b.t_s))


def _block(b: RouteBuilder, rng: np.random.Generator) -> None:
    """One piece of street, under ``LONGEST_BLOCK_S``."""
    side = rng.choice([-1.0, 1.0])
    kind = rng.choice(
        ["turn", "bend", "lights", "lane", "bump", "hill", "brake"], p=[0.3, 0.2, 0.2, 0.1, 0.08, 0.08, 0.04]
    )
    if kind == "turn":
        b.to_speed(rng.uniform(5.0, 6.5), 2.0).turn(side * rng.uniform(70.0, 110.0), rng.uniform(9.0, 14.0))
    elif kind == "bend":
        b.to_speed(rng.uniform(9.0, 14.0)).turn(side * rng.uniform(10.0, 50.0), rng.uniform(80.0, 150.0))
    elif kind == "lights":
        b.to_speed(0.0, rng.uniform(1.6, 2.6)).hold(rng.uniform(4.0, 15.0))
    elif kind == "lane":
        b.to_speed(rng.uniform(10.0, 14.0)).change_lane(side * 3.2)
    elif kind == "bump":
        hump = rng.random() < 0.5
        b.to_speed(5.5 if hump else 11.0, 2.0)
        b.bump(0.07 if hump else -0.05, 0.9 if hump else 0.6, 1.0).hold(4.0)
    elif kind == "hill":
        b.grade(rng.uniform(-5.0, 5.0), 5.0).hold(5.0)
    else:
        b.to_speed(13.5, 2.2).to_speed(rng.uniform(0.0, 4.0), _HARD_BRAKING_MPS2, Shape.ABRUPT).hold(2.0)
    b.to_speed(rng.uniform(9.0, 14.0), rng.uniform(1.2, 2.4)).hold(rng.uniform(3.0, 9.0))


def _require(name: str, duration_s: float, least_s: float) -> None:
    if duration_s < least_s:
        raise InvalidInputError(f"a drive of {duration_s:g} s: {name} takes at least {least_s:.0f} s")


def finish(b: RouteBuilder, duration_s: float) -> Route:
    """Brake to rest if there is time for it, and stand until the end."""
    if b.t_s + 20.0 < duration_s:
        b.hold(max(0.0, duration_s - b.t_s - 20.0)).grade(0.0).to_speed(0.0, 2.5)
    return b.hold(max(0.0, duration_s - b.t_s)).build(duration_s)
