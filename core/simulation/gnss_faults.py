"""What goes wrong with a receiver: wild fixes, jumps, reflections, spoofing, freezing, wrong and late times.

Each takes a stream, the span in true time and the fault's size, and leaves the stated accuracy as it is:
a receiver does not know that it is wrong.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

import numpy as np

from core.earth import radii_m
from core.measurements import GNSS, FloatArray
from core.simulation.stream import Stream

Span = tuple[int, int]
"""From and until (without), UTC nanoseconds of true time."""

OUTLIER_SHARE: Final = 0.3
"""Share of the fixes that are wild, 0 to 1. A choice: enough that some come in a row."""
PULL_OFF_S: Final = 30.0
"""Time in which a spoofer moves to its whole offset, s, 5 to 300. A choice: 60 m then take 0.4 m/s2 at most, no more
than a car's own driving (Humphreys et al. 2008, ION GNSS: a portable civil spoofer, drags off by aligned signals)."""

_POSITION: Final = (GNSS["lat_rad"], GNSS["lon_rad"], GNSS["alt_m"])
_VELOCITY: Final = (GNSS["vn_mps"], GNSS["ve_mps"], GNSS["vd_mps"])
_SPEED, _COURSE = GNSS["speed_mps"], GNSS["course_rad"]


def outliers(stream: Stream, span: Span, size_m: float, rng: np.random.Generator) -> Stream:
    """A share of the fixes lies off by a normal error of ``size_m`` an axis, each by its own."""
    inside = stream.during("gnss", span)
    wild = inside & (rng.random(inside.size) < OUTLIER_SHARE)
    offset_n_m = np.where(wild[:, None], size_m * rng.standard_normal((inside.size, 3)), 0.0)
    return stream.changed(gnss=_moved(stream.measurements.gnss, offset_n_m))


def jump(stream: Stream, span: Span, size_m: float, rng: np.random.Generator) -> Stream:
    """All positions lie ``size_m`` off to one side; velocities stay true."""
    offset_n_m = np.outer(stream.during("gnss", span), _aside(rng)) * size_m
    return stream.changed(gnss=_moved(stream.measurements.gnss, offset_n_m))


def multipath_ramp(stream: Stream, span: Span, rate_mps: float, rng: np.random.Generator) -> Stream:
    """Positions drift off to one side by ``rate_mps`` and come back at once; velocities stay true."""
    gone_s = np.where(stream.during("gnss", span), (stream.comes_ns["gnss"] - span[0]) * 1e-9, 0.0)
    return stream.changed(gnss=_moved(stream.measurements.gnss, np.outer(gone_s, _aside(rng)) * rate_mps))


def spoof(stream: Stream, span: Span, size_m: float, rng: np.random.Generator) -> Stream:
    """Positions are dragged off to one side, velocities with them, to ``size_m``, held, and let go at once.

    The offset grows as 10 u^3 - 15 u^4 + 6 u^5 of the share u of ``PULL_OFF_S``: velocity and acceleration begin and
    end at zero, the peaks are 1.88 size/T and 5.8 size/T^2. Where it begins nothing tells it from the truth.
    """
    inside, aside_n = stream.during("gnss", span), _aside(rng)
    u = np.clip((stream.comes_ns["gnss"] - span[0]) * 1e-9 / PULL_OFF_S, 0.0, 1.0)
    offset_m = np.where(inside, size_m * u**3 * (10.0 - 15.0 * u + 6.0 * u * u), 0.0)
    rate_mps = np.where(inside, size_m / PULL_OFF_S * 30.0 * u * u * (1.0 - u) ** 2, 0.0)
    moved = _moved(stream.measurements.gnss, np.outer(offset_m, aside_n))
    return stream.changed(gnss=_hastened(moved, np.outer(rate_mps, aside_n)))


def frozen(stream: Stream, span: Span, size: float, rng: np.random.Generator) -> Stream:
    """The receiver repeats its last fix, velocity included, with new times; ``size`` says nothing."""
    return stream.changed(gnss=_held(stream, span))


def frozen_at_rest(stream: Stream, span: Span, size: float, rng: np.random.Generator) -> Stream:
    """The receiver repeats its last position with new times and says that it stands; ``size`` says nothing."""
    fixes, inside = _held(stream, span), stream.during("gnss", span)
    for column in (*_VELOCITY, _SPEED):
        fixes[inside, column] = np.where(np.isnan(fixes[inside, column]), np.nan, 0.0)
    return stream.changed(gnss=fixes)


def receiver_clock(stream: Stream, span: Span, step_s: float, rng: np.random.Generator) -> Stream:
    """The receiver's times are ``step_s`` ahead of the box's (behind where negative), as by a wrong leap second."""
    shift_ns = np.where(stream.during("gnss", span), round(step_s * 1e9), 0).astype(np.int64)
    return stream.changed(gnss_t_ns=stream.measurements.gnss_t_ns + shift_ns)


def late(stream: Stream, span: Span, longest_s: float, rng: np.random.Generator) -> Stream:
    """Fixes with right times come up to ``longest_s`` late, in their order."""
    inside = stream.during("gnss", span)
    delay_ns = np.where(inside, rng.uniform(0.0, longest_s * 1e9, inside.size), 0.0).astype(np.int64)
    comes_ns = np.maximum.accumulate(stream.comes_ns["gnss"] + delay_ns)
    return replace(stream, comes_ns={**stream.comes_ns, "gnss": comes_ns})


def _aside(rng: np.random.Generator) -> FloatArray:
    """A horizontal direction (3,) in n."""
    angle = rng.uniform(0.0, 2.0 * math.pi)
    return np.array([math.cos(angle), math.sin(angle), 0.0])


def _moved(fixes: FloatArray, offset_n_m: FloatArray) -> FloatArray:
    """Fixes (m, columns) with positions moved by (m, 3) m in n; those by nothing keep their bits."""
    moved, lat, alt = fixes.copy(), fixes[:, _POSITION[0]], np.nan_to_num(fixes[:, _POSITION[2]])
    meridian, transverse = np.array([radii_m(one) for one in lat]).reshape(-1, 2).T
    moved[:, _POSITION[0]] += offset_n_m[:, 0] / (meridian + alt)
    moved[:, _POSITION[1]] += offset_n_m[:, 1] / ((transverse + alt) * np.cos(lat))
    moved[:, _POSITION[2]] -= offset_n_m[:, 2]
    return moved


def _hastened(fixes: FloatArray, rate_n_mps: FloatArray) -> FloatArray:
    """Fixes (m, columns) with (m, 3) m/s added to their velocity, in whichever form they give it."""
    hastened = fixes.copy()
    hastened[:, _VELOCITY] += rate_n_mps
    north = fixes[:, _SPEED] * np.cos(fixes[:, _COURSE]) + rate_n_mps[:, 0]
    east = fixes[:, _SPEED] * np.sin(fixes[:, _COURSE]) + rate_n_mps[:, 1]
    changed = rate_n_mps.any(axis=1) & np.isfinite(north)
    hastened[changed, _SPEED] = np.hypot(north, east)[changed]
    hastened[changed, _COURSE] = np.arctan2(east, north)[changed]
    return hastened


def _held(stream: Stream, span: Span) -> FloatArray:
    inside = np.flatnonzero(stream.during("gnss", span))
    fixes = stream.measurements.gnss.copy()
    if inside.size:
        fixes[inside] = fixes[max(int(inside[0]) - 1, 0)]
    return fixes
