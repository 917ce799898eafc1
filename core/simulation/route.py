"""A drive as a script of manoeuvres: speed, heading and grade over time, with crashes and road bumps."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING, Final, Protocol

import numpy as np

from core.earth import STANDARD_GRAVITY_MPS2
from core.errors import InvalidInputError
from core.measurements import FloatArray
from core.simulation.crashes import Crash
from core.simulation.shapes import Shape, peak_rate, step

if TYPE_CHECKING:
    from core.simulation.disturbances import Disturbance

TYRE_FRICTION: Final = 0.7
"""Grip with which a car that was pushed sideways stops sliding; dry asphalt 0.7 to 0.8 (Gillespie 1992)."""
YAW_KICK_S: Final = 0.55
"""Time over which a crash turns the car, s; a choice."""


@dataclass(frozen=True, slots=True)
class Step:
    """A change by ``delta`` that begins at ``start_s`` and takes ``duration_s``."""

    start_s: float
    duration_s: float
    delta: float
    shape: Shape


class Signal(Protocol):
    """A smooth function of time."""

    def at(self, t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Value and time derivative at increasing times, (n,) each."""
        ...


@dataclass(frozen=True, slots=True)
class Channel:
    """A smooth function of time: a first value and the steps that change it."""

    first: float
    steps: tuple[Step, ...]

    def at(self, t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Value and time derivative at increasing times, (n,) each."""
        value = np.full(t_s.shape, self.first)
        rate = np.zeros(t_s.shape)
        for one in self.steps:
            begin, end = np.searchsorted(t_s, [one.start_s, one.start_s + one.duration_s])
            share, share_rate = step(one.shape, (t_s[begin:end] - one.start_s) / one.duration_s)
            value[begin:end] += one.delta * share
            value[end:] += one.delta
            rate[begin:end] += one.delta / one.duration_s * share_rate
        return value, rate


@dataclass(frozen=True, slots=True)
class RoadBump:
    """A hump (height > 0) or pothole (< 0) of cosine form that the front wheels reach at ``start_s``."""

    start_s: float
    length_m: float
    height_m: float


class Sky(StrEnum):
    """What stands between the antenna and the satellites."""

    CANYON = "canyon"
    TUNNEL = "tunnel"
    OUTAGE = "outage"


@dataclass(frozen=True, slots=True)
class SkySpan:
    """A span of the drive without open sky."""

    kind: Sky
    start_s: float
    end_s: float


@dataclass(frozen=True, slots=True)
class Route:
    """What the car is made to do. Speeds along and right of the heading, by tyres and by impacts."""

    duration_s: float
    forward_by_tyres: Signal
    right_by_tyres: Signal
    forward_by_impacts: Signal
    right_by_impacts: Signal
    heading_rad: Signal
    grade_rad: Signal
    bumps: tuple[RoadBump, ...]
    crashes: tuple[tuple[float, Crash], ...]
    sky: tuple[SkySpan, ...]
    disturbances: tuple[tuple[float, Disturbance], ...] = ()


@dataclass(slots=True)
class RouteBuilder:
    """Puts manoeuvres one after the other; ``t_s`` is where the next one begins."""

    heading_deg: float = 0.0
    t_s: float = 0.0
    speed_mps: float = 0.0
    grade_rad: float = 0.0
    _steps: dict[str, list[Step]] = field(default_factory=dict)
    _bumps: list[RoadBump] = field(default_factory=list)
    _crashes: list[tuple[float, Crash]] = field(default_factory=list)
    _sky: list[SkySpan] = field(default_factory=list)
    _disturbances: list[tuple[float, Disturbance]] = field(default_factory=list)

    def _change(self, channel: str, start_s: float, duration_s: float, delta: float, shape: Shape) -> None:
        if delta != 0.0:
            self._steps.setdefault(channel, []).append(Step(start_s, duration_s, delta, shape))

    def hold(self, duration_s: float) -> RouteBuilder:
        """Keep speed and heading."""
        if not duration_s >= 0.0:
            raise InvalidInputError(f"a manoeuvre of {duration_s} s: expected 0 or more")
        self.t_s += duration_s
        return self

    def to_speed(self, speed_mps: float, accel_mps2: float = 1.6, shape: Shape = Shape.EASE) -> RouteBuilder:
        """Accelerate or brake to a speed (below 0: backwards); ``accel_mps2`` is the largest on the way."""
        if not (math.isfinite(speed_mps) and accel_mps2 > 0.0):
            raise InvalidInputError(f"to {speed_mps} m/s at {accel_mps2} m/s2: expected an acceleration above 0")
        delta = speed_mps - self.speed_mps
        duration_s = peak_rate(shape) * abs(delta) / accel_mps2
        self._change("forward_by_tyres", self.t_s, duration_s, delta, shape)
        self.speed_mps = speed_mps
        self.t_s += duration_s
        return self

    def turn(self, angle_deg: float, radius_m: float) -> RouteBuilder:
        """Turn clockwise by an angle at the speed held, with ``radius_m`` where the curve is tightest."""
        if not (self.speed_mps != 0.0 and radius_m > 0.0):
            raise InvalidInputError(f"a turn of radius {radius_m} m at {self.speed_mps} m/s: expected a moving car")
        angle = math.radians(angle_deg)
        duration_s = peak_rate(Shape.EASE) * abs(angle * radius_m / self.speed_mps)
        self._change("heading_rad", self.t_s, duration_s, angle, Shape.EASE)
        self.t_s += duration_s
        return self

    def change_lane(self, offset_m: float, duration_s: float = 4.0) -> RouteBuilder:
        """Move to the right by ``offset_m`` (left if negative): two opposite turns at the speed held."""
        if not (self.speed_mps > 0.0 and duration_s > 0.0):
            raise InvalidInputError("a lane is changed at a speed and over a time above 0")
        angle = offset_m / (self.speed_mps * duration_s / 2)  # small angles: mean heading is half of it, twice
        for share in (angle, -angle):
            self._change("heading_rad", self.t_s, duration_s / 2, share, Shape.EASE)
            self.t_s += duration_s / 2
        return self

    def grade(self, percent: float, over_s: float = 6.0) -> RouteBuilder:
        """Let the road's grade become ``percent`` (up is positive) while the next manoeuvres go on."""
        grade_rad = math.atan(percent / 100.0)
        self._change("grade_rad", self.t_s, over_s, grade_rad - self.grade_rad, Shape.EASE)
        self.grade_rad = grade_rad
        return self

    def bump(self, height_m: float, length_m: float, after_s: float = 0.0) -> RouteBuilder:
        """A speed bump, or with a negative height a pothole, ``after_s`` from here."""
        if not length_m > 0.0:
            raise InvalidInputError(f"a bump of {length_m} m length: expected above 0")
        self._bumps.append(RoadBump(self.t_s + after_s, length_m, height_m))
        return self

    def disturb(self, disturbance: Disturbance) -> RouteBuilder:
        """Be shaken while the speed is held; what it would change of the speed is driven back meanwhile."""
        self._disturbances.append((self.t_s, disturbance))
        self.t_s += disturbance.duration_s
        return self

    def crash(self, crash: Crash) -> RouteBuilder:
        """Collide here; the car goes on with the forward speed left and its tyres stop the slide."""
        forward, right = crash.delta_v_b_mps
        self._crashes.append((self.t_s, crash))
        self._change("forward_by_impacts", self.t_s, crash.duration_s, forward, crash.shape)
        self._change("right_by_impacts", self.t_s, crash.duration_s, right, crash.shape)
        self._change("heading_rad", self.t_s, YAW_KICK_S, math.radians(crash.yaw_deg), Shape.ABRUPT)
        self.t_s += crash.duration_s
        self.speed_mps += forward
        slide_s = peak_rate(Shape.ABRUPT) * abs(right) / (TYRE_FRICTION * STANDARD_GRAVITY_MPS2)
        self._change("right_by_tyres", self.t_s, slide_s, -right, Shape.ABRUPT)
        return self

    def roll_out(self, accel_mps2: float = 5.0) -> RouteBuilder:
        """Come to rest from whatever speed a crash left, also backwards."""
        duration_s = peak_rate(Shape.ABRUPT) * abs(self.speed_mps) / accel_mps2
        self._change("forward_by_tyres", self.t_s, duration_s, -self.speed_mps, Shape.ABRUPT)
        self.speed_mps = 0.0
        self.t_s += duration_s
        return self

    def under(self, kind: Sky, start_s: float, end_s: float | None = None) -> RouteBuilder:
        """Say that from ``start_s`` to ``end_s`` (here, if not said) there was no open sky."""
        self._sky.append(SkySpan(kind, start_s, self.t_s if end_s is None else end_s))
        return self

    def build(self, duration_s: float | None = None) -> Route:
        """The route, of the length reached or cut to ``duration_s``."""

        def channel(name: str, first: float) -> Channel:
            return Channel(first, tuple(sorted(self._steps.get(name, ()), key=lambda one: one.start_s)))

        duration = self.t_s if duration_s is None else duration_s
        return Route(
            duration_s=duration,
            forward_by_tyres=channel("forward_by_tyres", 0.0),
            right_by_tyres=channel("right_by_tyres", 0.0),
            forward_by_impacts=channel("forward_by_impacts", 0.0),
            right_by_impacts=channel("right_by_impacts", 0.0),
            heading_rad=channel("heading_rad", math.radians(self.heading_deg)),
            grade_rad=channel("grade_rad", 0.0),
            bumps=tuple(self._bumps),
            crashes=tuple(one for one in self._crashes if one[0] < duration),
            sky=tuple(
                SkySpan(span.kind, span.start_s, min(span.end_s, duration))
                for span in self._sky
                if span.start_s < duration
            ),
            disturbances=tuple(one for one in self._disturbances if one[0] + one[1].duration_s < duration),
        )
