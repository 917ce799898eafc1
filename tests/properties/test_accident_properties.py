"""Detectors and trips tell the same to the bit however samples are cut, and nothing in a stream breaks them."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from core.accident.detector import ImpactDetector
from core.accident.events import Findings, VehicleMotion
from core.accident.paper_rule import PaperRule
from core.snapshot import pack, unpack

G = 9.80665
EPOCH_NS = 1_700_000_000_000_000_000
DETECTORS = pytest.mark.parametrize("detector", [ImpactDetector, PaperRule])


def eventful(seed, attitude=True):
    """Twenty seconds with crashes, shocks, spin, gaps, spikes of not-a-number and clipping, at 100 Hz."""
    rng = np.random.default_rng(seed)
    n = 2000
    t_s = np.arange(n) / 100.0
    f_b = np.array([0.0, 0.0, -G]) + rng.normal(0.0, 0.5, (n, 3))
    omega_b = rng.normal(0.0, 0.3, (n, 3))
    for _ in range(8):
        first = int(rng.integers(0, n - 40))
        length = int(rng.integers(2, 40))
        shape = np.sin(np.pi * np.arange(length) / length) ** 2
        f_b[first : first + length] += np.outer(shape, rng.normal(0.0, 60.0, 3))
        omega_b[first : first + length, 2] += rng.normal(0.0, 3.0)
    t_ns = EPOCH_NS + np.round(t_s * 1e9).astype(np.int64)
    for _ in range(2):
        t_ns[int(rng.integers(1, n)) :] += int(rng.integers(1, 4_000_000_000))
    f_b[rng.integers(0, n, 5)] = np.nan
    limit = 4 * G
    down_b = np.tile([0.0, 0.0, 1.0], (n, 1))
    if not attitude:
        down_b[int(rng.integers(0, n)) :] = np.nan
    with np.errstate(invalid="ignore"):
        saturated = (np.abs(f_b) >= limit).any(axis=1).astype(np.uint8)
    speed_mps = np.abs(rng.normal(8.0, 6.0, n))
    speed_mps[rng.random(n) < 0.1] = np.nan
    return VehicleMotion(t_ns, np.clip(f_b, -limit, limit), omega_b, down_b, speed_mps, saturated, G)


def rows(motion, start, end):
    arrays = {
        field.name: getattr(motion, field.name)[start:end]
        for field in dataclasses.fields(motion)
        if field.name not in ("gravity_mps2", "ignition", "flags")
    }
    return VehicleMotion(**arrays, gravity_mps2=motion.gravity_mps2, ignition=motion.ignition, flags=motion.flags)


def bits(found):
    return [[repr(dataclasses.astuple(one)) for one in kind] for kind in found]


def add(found, more):
    found.impacts.extend(more.impacts)
    found.candidates.extend(more.candidates)


@DETECTORS
def test_the_eventful_stream_has_events(detector):
    assert sum(len(detector().step(eventful(seed)).impacts) for seed in range(10)) >= 5


@DETECTORS
@settings(deadline=None, max_examples=40)
@given(seed=st.integers(0, 30), attitude=st.booleans(), data=st.data())
def test_any_cutting_and_any_snapshot_between_tell_the_same_bits(detector, seed, attitude, data):
    motion = eventful(seed, attitude)
    n = len(motion.t_ns)
    whole = detector()
    expected = whole.step(motion)
    cuts = sorted(data.draw(st.lists(st.integers(0, n), max_size=25)))
    part, found = detector(), Findings([], [])
    for start, end in zip([0, *cuts], [*cuts, n], strict=True):
        add(found, part.step(rows(motion, start, end)))
        restored = detector()
        restored.load(unpack(pack(part.state(), 1), 1))
        part = restored
    assert bits(found) == bits(expected)
    assert pack(part.state(), 1) == pack(whole.state(), 1)


@DETECTORS
def test_one_sample_at_a_time_tells_the_same_bits(detector):
    motion = eventful(3)
    part, found = detector(), Findings([], [])
    for k in range(len(motion.t_ns)):
        add(found, part.step(rows(motion, k, k + 1)))
    assert bits(found) == bits(detector().step(motion))


ODD = (0.0, -G, G, 1e9, -1e9, 1e-300, math.inf, -math.inf, math.nan)


@DETECTORS
@settings(deadline=None, max_examples=100)
@given(seed=st.integers(0, 2**32 - 1), scale=st.sampled_from([1.0, 1e2, 1e5]), odd=st.sampled_from([0.0, 0.1, 0.6]))
def test_nothing_in_a_stream_breaks_a_detector(detector, seed, scale, odd):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(0, 400))
    values = rng.normal(0.0, scale, (n, 7))
    values = np.where(rng.random(values.shape) < odd, rng.choice(ODD, values.shape), values)
    down_b = rng.normal(0.0, 1.0, (n, 3))
    down_b /= np.linalg.norm(down_b, axis=1, keepdims=True)
    down_b[rng.random(n) < 0.3] = np.nan
    t_ns = EPOCH_NS + np.cumsum(rng.choice([5_000_000, 5_000_000, 5_000_000, 0, -(10**9), 3 * 10**9], n))
    saturated = rng.integers(0, 2, n).astype(np.uint8)
    wild = VehicleMotion(t_ns, values[:, :3], values[:, 3:6], down_b, values[:, 6], saturated, G)
    fold = detector()
    for impact in [*fold.step(wild).impacts, *fold.step(eventful(1)).impacts]:
        assert 0.0 <= impact.confidence <= 1.0
        assert 0.0 <= impact.pdof_deg < 360.0
        assert math.isfinite(impact.delta_v_mps)
        assert impact.decided_t_ns >= impact.t_ns


def test_a_broken_stretch_does_not_deafen_the_detector():
    rng = np.random.default_rng(0)
    n = 400
    t_ns = EPOCH_NS + np.arange(n, dtype=np.int64) * 10_000_000
    wild = rng.normal(0.0, 1e4, (n, 3))
    level = np.tile([0.0, 0.0, 1.0], (n, 1))
    fold = ImpactDetector()
    fold.step(VehicleMotion(t_ns, wild, wild, level * np.nan, np.full(n, np.nan), np.zeros(n, np.uint8), G))
    f_b = np.tile([0.0, 0.0, -G], (n, 1))
    f_b[200:212, 0] -= 60.0
    nod = np.zeros((n, 3))
    nod[200:240, 1] = 0.3 * np.sin(np.linspace(0.0, np.pi, 40))  # a blow nods a car on its springs
    later = t_ns + 60_000_000_000
    calm = VehicleMotion(later, f_b, nod, level, np.full(n, 10.0), np.zeros(n, np.uint8), G)
    impact = fold.step(calm).impacts[-1]
    assert impact.delta_v_mps == pytest.approx(7.2, abs=0.7)
