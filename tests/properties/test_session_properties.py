"""A session tells the same to the bit however its stream is cut, and nothing in a stream breaks it."""

from __future__ import annotations

import functools
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from core.earth import horizontal_distance_m
from core.measurements import GNSS, Measurements
from core.navigation.track import TRACK_COLUMNS
from core.preparation import Mounting
from core.session import Session, SessionConfig
from core.simulation.scenarios import simulate

S = 10**9
RATE_HZ = 50.0
SERIES = (
    ("imu_t_ns", "f_s", "omega_s"),
    ("gnss_t_ns", "gnss"),
    ("magnetometer_t_ns", "magnetic_s_ut"),
    ("speed_t_ns", "speed_mps"),
    ("barometer_t_ns", "pressure_pa"),
)
DETECTORS = st.sampled_from(["telefuse", "paper"])


@functools.cache
def simulated(scenario, seed, duration_s):
    return simulate(scenario, seed, duration_s, RATE_HZ)


def without(m, *series, inside=None):
    """Measurements without series, or without what of them lies within a span of times."""
    changed = {}
    for times, *rows in series:
        t_ns = getattr(m, times)
        kept = np.zeros(len(t_ns), np.bool_)
        if inside is not None:
            kept = (t_ns < inside[0]) | (t_ns >= inside[1])
        changed |= {name: getattr(m, name)[kept] for name in (times, *rows)}
    return replace(m, **changed)


def from_to(drive, from_s, until_s):
    return drive.measurements.between(drive.start_t_ns + round(from_s * S), drive.start_t_ns + round(until_s * S))


@functools.cache
def drives():
    """Streams with all that a session meets: starts, crashes, tunnels, holes, wheel speed, and no fix at all."""
    crash = simulated("tunnel_crash", 1, 430.0)
    start_ns = crash.start_t_ns
    whole = crash.measurements
    hole = (start_ns + 200 * S + 123_456_789, start_ns + 215 * S)
    short_hole = (start_ns + 100 * S, start_ns + 102 * S)
    highway = from_to(simulated("highway", 2, 300.0), 10.0, 150.0)
    parking = simulated("parking", 3, 240.0).measurements
    ended = replace(parking, ignition=False)
    return {
        "two crashes and a tunnel": from_to(crash, 60.0, 430.0),
        "holes in the samples": without(without(whole, SERIES[0], inside=hole), SERIES[0], inside=short_hole),
        "silence of all": without(without(whole, *SERIES, inside=hole), SERIES[2]),
        "wheel speed, from motion": without(highway, SERIES[2]),
        "no fix": without(from_to(crash, 200.0, 430.0), SERIES[1]),
        "ignition off": ended,
    }


NAMES = [
    "two crashes and a tunnel",
    "holes in the samples",
    "silence of all",
    "wheel speed, from motion",
    "no fix",
    "ignition off",
]


class Told:
    """Everything that a session told, and its state."""

    def __init__(self, session, outputs):
        self.snapshot = session.snapshot()
        self.track = np.concatenate([o.track.values for o in outputs] or [np.empty((0, len(TRACK_COLUMNS)))])
        self.t_ns = np.concatenate([o.track.t_ns for o in outputs])
        kinds = ("accidents", "suppressed", "episodes")
        self.accidents = repr([[one for o in outputs for one in getattr(o, kind)] for kind in kinds])
        self.trips = repr([trip for o in outputs for trip in o.trips])
        self.counts = {}
        for o in outputs:
            for name, count in o.counts.items():
                self.counts[name] = self.counts.get(name, 0) + count

    def __eq__(self, other):
        return (
            self.t_ns.tobytes() == other.t_ns.tobytes()
            and self.track.tobytes() == other.track.tobytes()
            and (self.accidents, self.trips, self.counts) == (other.accidents, other.trips, other.counts)
            and self.snapshot == other.snapshot
        )


GIVEN = Mounting(known=True)
TO_BE_FOUND = Mounting((3.0, 0.3, -1.7))
"""A guess that has the box upside down: the session has to find out that it sits as the car does."""
MOUNTINGS = st.sampled_from([GIVEN, TO_BE_FOUND])


def config(detector="telefuse", mounting=GIVEN):
    return SessionConfig(mounting=mounting, detector=detector)


@functools.cache
def at_once(name, detector, mounting=GIVEN):
    session = Session(config(detector, mounting))
    return Told(session, [session.step(drives()[name])])


def test_the_streams_hold_what_they_are_for():
    assert sorted(NAMES) == sorted(drives())
    told = {name: at_once(name, "telefuse") for name in NAMES}
    assert told["two crashes and a tunnel"].accidents.count("revision=0") == 2
    assert "Trip(" in told["two crashes and a tunnel"].trips
    assert told["holes in the samples"].counts["imu.reset"] == 1
    assert told["wheel speed, from motion"].counts["speed.fused"] > 100
    assert told["wheel speed, from motion"].counts["barometer.fused"] > 100
    assert not len(told["no fix"].t_ns)
    assert told["no fix"].accidents.count("revision=0") == 2  # found although nobody knows where
    for name in ("two crashes and a tunnel", "holes in the samples", "silence of all", "wheel speed, from motion"):
        assert at_once(name, "telefuse", TO_BE_FOUND).counts["mounting.found"] == 1


@pytest.mark.parametrize("name", NAMES)
@settings(deadline=None, max_examples=20)
@given(detector=DETECTORS, mounting=MOUNTINGS, restore=st.booleans(), data=st.data())
def test_any_cutting_and_any_restart_between_tell_the_same_bits(name, detector, mounting, restore, data):
    m = drives()[name]
    first, last = int(m.imu_t_ns[0]), int(m.imu_t_ns[-1])
    cuts = data.draw(st.lists(st.integers(first - S, last + S), max_size=40))
    # Packets of a second too, whose edges fall on the grids of the filter.
    seconds = data.draw(st.sampled_from([0, 0, 1, 7]))
    if seconds:
        cuts += range(first // S * S, last, seconds * S)
    bounds = [-(1 << 62), *sorted(cuts), 1 << 62]
    session, outputs = Session(config(detector, mounting)), []
    for low, high in pairwise(bounds):
        outputs.append(session.step(m.between(low, high)))
        if restore and len(outputs) % 5 == 0:
            session = Session.restore(config(detector, mounting), session.snapshot())
    assert Told(session, outputs) == at_once(name, detector, mounting)


@pytest.mark.parametrize("mounting", [GIVEN, TO_BE_FOUND])
def test_one_sample_at_a_time_tells_the_same_bits(mounting):
    m = from_to(simulated("tunnel_crash", 1, 430.0), 175.0, 225.0)
    whole = Session(config(mounting=mounting))
    expected = Told(whole, [whole.step(m)])
    session = Session(config(mounting=mounting))
    edges = [-(1 << 62), *(int(t) for t in m.imu_t_ns[1:]), 1 << 62]
    outputs = [session.step(m.between(low, high)) for low, high in pairwise(edges)]
    assert Told(session, outputs) == expected


@settings(deadline=None, max_examples=15)
@given(data=st.data())
def test_what_comes_again_or_too_late_changes_nothing(data):
    m = drives()["holes in the samples"]
    first, last = int(m.imu_t_ns[0]), int(m.imu_t_ns[-1])
    edges = [-(1 << 62), *range(first + 10 * S, last, 10 * S), 1 << 62]
    session, outputs, parts = Session(config()), [], []
    for low, high in pairwise(edges):
        parts.append(m.between(low, high))
        outputs.append(session.step(parts[-1]))
        if data.draw(st.integers(0, 3)) == 0:
            again = session.step(parts[data.draw(st.integers(0, len(parts) - 1))])
            assert not len(again.track.t_ns)
            assert again.accidents == again.trips == ()
            assert all(name.endswith("rejected_time") for name in again.counts)
    told, expected = Told(session, outputs), at_once("holes in the samples", "telefuse")
    assert (told.track.tobytes(), told.accidents, told.trips) == (
        expected.track.tobytes(), expected.accidents, expected.trips
    )  # fmt: skip


@pytest.mark.parametrize("mounting", [GIVEN, TO_BE_FOUND])
def test_empty_measurements_change_nothing(mounting):
    m = from_to(simulated("tunnel_crash", 1, 430.0), 0.0, 100.0)
    session = Session(config(mounting=mounting))
    session.step(m)
    before = session.snapshot()
    for _ in range(3):
        outputs = session.step(Measurements())
        assert not len(outputs.track.t_ns)
        assert outputs.counts == {}
    assert session.snapshot() == before


ODD = np.array([0.0, 1.0, -1.0, np.nan, np.inf, -np.inf, 1e300, -1e300, 1e-300, 1e5, -1e5, 9e3, -9e3, 90.0, -180.0])
JUMPS_NS = [S, -S, 3 * S // 10, 7 * S, 600 * S, -600 * S, 86_400 * S, -(1 << 61), 1 << 62]


def damaged(rng):
    """A drive with values, times and order damaged, and cut by position, so that aids come early and late."""
    m = from_to(simulated("city", 3, 300.0), 0.0, 150.0)
    changed = {name: getattr(m, name).copy() for series in SERIES for name in series}
    changed["speed_t_ns"], changed["speed_mps"] = m.imu_t_ns[::10].copy(), np.full(len(m.imu_t_ns[::10]), 8.0)
    changed["barometer_t_ns"], changed["pressure_pa"] = m.imu_t_ns[::5].copy(), np.full(len(m.imu_t_ns[::5]), 94_000.0)
    share = rng.choice([0.0, 1e-3, 1e-2, 0.3])
    for name in ("f_s", "omega_s", "gnss", "magnetic_s_ut", "speed_mps", "pressure_pa"):
        hit = rng.random(changed[name].shape) < share
        changed[name][hit] = rng.choice(ODD, hit.sum())
        if rng.random() < 0.2:
            with np.errstate(over="ignore"):
                changed[name] *= rng.choice([-1.0, 10.0, 1e3])
    for times, *_ in SERIES:
        t_ns = changed[times]
        for _ in range(rng.integers(0, 4)):
            t_ns[rng.integers(0, len(t_ns)) :] += rng.choice(JUMPS_NS)
        if rng.random() < 0.2:
            rng.shuffle(t_ns)
    m = replace(m, **changed, accel_full_scale_mps2=float(rng.choice([np.nan, 19.6])))
    shares = np.sort(rng.random(12)).tolist()
    for low, high in zip([0.0, *shares], [*shares, 1.0], strict=True):
        part = {}
        for series in SERIES:
            n = len(getattr(m, series[0]))
            part |= {name: getattr(m, name)[int(low * n) : int(high * n)] for name in series}
        yield replace(m, **part)


def assert_sound(session):
    """The filter's state is finite and its covariance one that a distribution can have."""
    nav = session.filter
    p = nav.covariance()
    assert np.isfinite(nav.x).all()
    assert np.isfinite(p).all()
    if not nav.aligned:
        return
    variance = np.diag(p)
    assert (variance >= 0.0).all()
    sd = np.sqrt(np.maximum(variance, 1e-300))
    correlation = p / np.outer(sd, sd)
    # Rounding between two symmetrisations, a second apart; of an eigenvalue, that of 18 products.
    assert np.abs(correlation - correlation.T).max() < 1e-6
    assert np.linalg.eigvalsh(0.5 * (correlation + correlation.T)).min() > -1e-6


@settings(deadline=None, max_examples=100)
@given(seed=st.integers(0, 2**32 - 1), detector=DETECTORS, mounting=MOUNTINGS)
@example(seed=15, detector="telefuse", mounting=GIVEN)  # clips behind the end of a pulse
@example(seed=219, detector="paper", mounting=GIVEN)  # has it learn that fixes are from the future
def test_nothing_in_a_stream_breaks_a_session_and_it_finds_itself_again(seed, detector, mounting):
    session = Session(config(detector, mounting))
    for part in damaged(np.random.default_rng(seed)):
        outputs = session.step(part)
        assert_sound(session)
        assert (np.diff(outputs.track.t_ns) > 0).all()
        positions = outputs.track.values[:, :2]
        assert np.isfinite(positions).all()
    # 3 min of samples at most: 30 s to align by, 5 s that may wait, the detector's 2.5 s, and the second in hand.
    assert len(session.snapshot()) < 1_000_000

    after = simulated("outages", 3, 140.0)
    shift_ns = session.filter.t_ns - int(after.measurements.imu_t_ns[0]) + S
    if session.filter.t_ns > 1 << 61:
        return  # its clock jumped to the year 2043: nothing on this side of it is later
    m = after.measurements
    later = replace(m, **{times: getattr(m, times) + shift_ns for times, *_ in SERIES})
    track = session.step(later).track
    assert_sound(session)
    truth = after.trajectory
    # While it aligns the last row is the last fix, up to a second old.
    row_s = [(int(track.t_ns[-1]) - shift_ns - int(m.imu_t_ns[0])) * 1e-9]
    lat_rad, lon_rad = (np.interp(row_s, truth.t_s, series) for series in (truth.lat_rad, truth.lon_rad))
    error_m = horizontal_distance_m(track.column("lat_rad")[-1:], track.column("lon_rad")[-1:], lat_rad, lon_rad)
    assert error_m[0] < 8.0  # five times what its fixes are good to


def test_p_stays_sound_over_a_whole_drive():
    session = Session(config())
    m = drives()["two crashes and a tunnel"]
    first = int(m.imu_t_ns[0])
    for second in range(0, 370, 2):
        session.step(m.between(first + second * S, first + (second + 2) * S))
        assert_sound(session)


def test_a_receiver_that_has_no_fix_starts_nothing():
    m = from_to(simulated("city", 3, 300.0), 0.0, 60.0)
    rows = m.gnss.copy()
    rows[:, [GNSS["lat_rad"], GNSS["lon_rad"]]] = np.nan
    rows[:, GNSS["fix"]] = 0.0
    session = Session(config())
    outputs = session.step(replace(m, gnss=rows))
    assert outputs.counts["gnss_position.rejected_range"] == len(rows)
    assert not session.filter.aligned
