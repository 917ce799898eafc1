"""The filter over a drive in a circle: wild, late, repeated and damaged aids are refused, counted, recovered from."""

from __future__ import annotations

import math

import numpy as np
import pytest

from core.earth import radii_m
from core.measurements import GNSS, GNSS_COLUMNS
from core.navigation import state
from core.navigation.aids import Aids
from core.navigation.filter import FilterConfig, NavigationFilter
from core.navigation.track import TRACK, Mode
from core.navigation.tuning import Tuning

NOW_NS = 1_700_000_000_000_000_000
LAT, LON, ALT = 0.8, 0.3, 200.0
RATE_HZ = 50


class Circle:
    """A drive in a circle of 200 m at 15 m/s with perfect sensors: its truth in closed form, on a sphere of its own."""

    radius_m, speed_mps = 200.0, 15.0

    def __init__(self, duration_s):
        self.t_s = np.arange(round(duration_s * RATE_HZ) + 1) / RATE_HZ
        rate = self.speed_mps / self.radius_m
        n = len(self.t_s)
        self.t_ns = NOW_NS + np.rint(self.t_s * 1e9).astype(np.int64)
        self.f_b = np.tile([0.0, self.speed_mps * rate, -9.8126], (n, 1))
        self.omega_b = np.tile([0.0, 0.0, rate], (n, 1))
        self.fix_s = np.arange(0.0, duration_s, 0.5)

    def at(self, t_s):
        """North and east of the start, m, and their rates."""
        a = self.speed_mps / self.radius_m * np.asarray(t_s)
        place = self.radius_m * np.stack([np.sin(a), 1 - np.cos(a)], axis=-1)
        return place, self.speed_mps * np.stack([np.cos(a), np.sin(a)], axis=-1)

    def fixes(self):
        place, v = self.at(self.fix_s)
        meridian, transverse = radii_m(LAT)
        rows = np.full((len(self.fix_s), len(GNSS_COLUMNS)), np.nan)
        rows[:, GNSS["lat_rad"]] = LAT + place[:, 0] / (meridian + ALT)
        rows[:, GNSS["lon_rad"]] = LON + place[:, 1] / ((transverse + ALT) * np.cos(LAT))
        rows[:, GNSS["alt_m"]] = ALT
        rows[:, GNSS["vn_mps"]], rows[:, GNSS["ve_mps"]], rows[:, GNSS["vd_mps"]] = v[:, 0], v[:, 1], 0.0
        rows[:, GNSS["sd_h_m"]], rows[:, GNSS["sd_v_m"]], rows[:, GNSS["sd_v_mps"]] = 1.5, 2.5, 0.1
        rows[:, GNSS["satellites"]], rows[:, GNSS["fix"]] = 9.0, 3.0
        return NOW_NS + np.rint(self.fix_s * 1e9).astype(np.int64), rows

    def run(self, gnss, speed=None, config=None):
        """Fold everything through a filter, a second a call; returns it with its rows."""
        fused = NavigationFilter(config or FilterConfig())
        no_field = (np.empty(0, np.int64), np.empty((0, 3)))
        t, rows = [], []
        for first in range(0, len(self.t_ns), RATE_HZ):
            own = slice(first, first + RATE_HZ)
            last_ns = self.t_ns[own][-1]
            low_ns = -(1 << 62) if first == 0 else self.t_ns[first - 1]

            def part(series, low_ns=low_ns, last_ns=last_ns):
                if series is None:
                    return np.empty(0, np.int64), np.empty(0)
                # What a fix's time says is not when it comes: it comes with the samples of its row.
                times, values, comes_ns = series if len(series) == 3 else (*series, series[0])
                inside = (comes_ns > low_ns) & (comes_ns <= last_ns)
                return times[inside], values[inside]

            step = fused.step(
                self.t_ns[own], self.f_b[own], self.omega_b[own], np.zeros(len(self.t_ns[own])),
                Aids(part(gnss), no_field, part(speed)),
            )  # fmt: skip
            t.append(step.track.t_ns)
            rows.append(step.track.values)
        return fused, np.concatenate(t), np.concatenate(rows)

    def errors_m(self, t_ns, rows, shift_n_m=0.0):
        """Horizontal error of each row, m."""
        place, _ = self.at((t_ns - NOW_NS) * 1e-9)
        meridian, transverse = radii_m(LAT)
        north = (rows[:, TRACK["lat_rad"]] - LAT) * (meridian + ALT) - place[:, 0] - shift_n_m
        east = (rows[:, TRACK["lon_rad"]] - LON) * (transverse + ALT) * np.cos(LAT) - place[:, 1]
        return np.hypot(north, east)


def count(fused, aid, outcome):
    return int(fused.counts[state.AIDS.index(aid), state.OUTCOMES.index(outcome)])


@pytest.fixture(scope="module")
def circle():
    return Circle(90.0)


@pytest.fixture(scope="module")
def undisturbed(circle):
    return circle.run(circle.fixes())


def test_the_undisturbed_drive_is_followed(circle, undisturbed):
    fused, t_ns, rows = undisturbed
    settled = t_ns > NOW_NS + 20 * 10**9
    assert rows[settled, TRACK["mode"]].tolist() == [Mode.AIDED] * settled.sum()
    # 0.1 m: perfect fixes on a sphere's metres, against the filter's on the ellipsoid, over 400 m.
    assert circle.errors_m(t_ns, rows)[settled].max() < 0.1
    assert count(fused, "gnss_position", "rejected_gate") == 0


def test_one_wild_fix_does_not_move_the_track(circle, undisturbed):
    t_ns, fixes = circle.fixes()
    fixes[100, GNSS["lat_rad"]] += 60.0 / 6.37e6
    fused, row_t_ns, rows = circle.run((t_ns, fixes))
    assert count(fused, "gnss_position", "rejected_gate") == 1
    assert circle.errors_m(row_t_ns, rows)[row_t_ns > NOW_NS + 20 * 10**9].max() < 0.1
    assert np.array_equal(row_t_ns, undisturbed[1])


def test_wild_fixes_that_do_not_agree_do_not_move_the_track(circle):
    t_ns, fixes = circle.fixes()
    wild = slice(100, 124)  # 12 s
    fixes[wild, GNSS["lat_rad"]] += np.random.default_rng(5).choice([-1, 1], 24) * 60.0 / 6.37e6
    fused, row_t_ns, rows = circle.run((t_ns, fixes))
    assert count(fused, "gnss_position", "rejected_gate") == 24
    assert count(fused, "gnss_position", "reset") == count(fused, "imu", "reset") == 0
    assert circle.errors_m(row_t_ns, rows)[row_t_ns > NOW_NS + 20 * 10**9].max() < 0.2


def test_fixes_that_all_moved_are_believed_within_ten_seconds_and_not_at_once(circle):
    t_ns, fixes = circle.fixes()
    from_ns = NOW_NS + 50 * 10**9
    fixes[t_ns >= from_ns, GNSS["lat_rad"]] += 80.0 / 6.37e6
    fused, row_t_ns, rows = circle.run((t_ns, fixes))
    shift_m = 80.0 / 6.37e6 * (radii_m(LAT)[0] + ALT)
    moved = circle.errors_m(row_t_ns, rows, shift_m)
    still = (row_t_ns > from_ns) & (row_t_ns < from_ns + 4 * 10**9)
    assert circle.errors_m(row_t_ns, rows)[still].max() < 1.0
    assert moved[(row_t_ns > from_ns + 10 * 10**9)].max() < 1.0
    assert count(fused, "gnss_position", "reset") == 1
    assert count(fused, "imu", "reset") == 0


def test_a_wrong_heading_is_noticed_and_found_anew(circle):
    fused = NavigationFilter(FilterConfig())
    t_ns, fixes = circle.fixes()
    no_field, no_speed = (np.empty(0, np.int64), np.empty((0, 3))), (np.empty(0, np.int64), np.empty(0))
    at = 30 * RATE_HZ + 1

    def step(own, fix):
        samples = (circle.t_ns[own], circle.f_b[own], circle.omega_b[own], np.zeros(len(circle.t_ns[own])))
        return fused.step(*samples, Aids((t_ns[fix], fixes[fix]), no_field, no_speed)).track

    step(slice(0, at), slice(0, 61))
    assert fused.aligned
    # Turned about: heading and velocity point backwards, and the filter is sure of it.
    w, x, y, z = fused.x[:4]
    fused.x[:4] = -z, -y, x, w
    fused.x[state.X_V : state.X_V + 2] *= -1.0
    track = step(slice(at, None), slice(61, None))
    assert count(fused, "imu", "reset") >= 1
    # 15 s to notice, 10 s to align, 10 s for what the alignment left to fade.
    late = track.t_ns > NOW_NS + 65 * 10**9
    assert (track.values[late, TRACK["mode"]] == Mode.AIDED).all()
    assert circle.errors_m(track.t_ns[late], track.values[late]).max() < 1.0


BAD_FIXES = {
    "no latitude": {"lat_rad": math.nan},
    "no longitude": {"lon_rad": math.nan},
    "beyond the pole": {"lat_rad": 1.6},
    "an absurd longitude": {"lon_rad": 7.0},
    "endless": {"lat_rad": math.inf},
    "three satellites": {"satellites": 3.0},
    "no fix": {"fix": 0.0},
    "in orbit": {"alt_m": 4e5},
    "supersonic": {"ve_mps": 400.0},
    "a spread of a city": {"sd_h_m": 2e4},
    "an endless course": {"course_rad": math.inf},
}


@pytest.mark.parametrize("damage", BAD_FIXES.values(), ids=BAD_FIXES.keys())
def test_a_fix_out_of_range_is_refused_and_changes_nothing(circle, damage):
    t_ns, fixes = circle.fixes()
    short, _, rows = circle.run((np.delete(t_ns, 130), np.delete(fixes, 130, axis=0)))
    for name, value in damage.items():
        fixes[130, GNSS[name]] = value
    fused, _, damaged_rows = circle.run((t_ns, fixes))
    assert count(fused, "gnss_position", "rejected_range") == 1
    assert damaged_rows.tobytes() == rows.tobytes()
    assert fused.x.tobytes() == short.x.tobytes()


def test_four_satellites_and_a_two_dimensional_fix_are_enough(circle):
    t_ns, fixes = circle.fixes()
    fixes[:, GNSS["satellites"]], fixes[:, GNSS["fix"]] = 4.0, 2.0
    fused, _, _ = circle.run((t_ns, fixes))
    assert fused.aligned
    assert count(fused, "gnss_position", "rejected_range") == 0


@pytest.mark.parametrize("late_s", [0.7, 1.7, 2.7])
def test_a_fix_that_comes_late_is_used_until_it_is_too_old(circle, late_s):
    t_ns, fixes = circle.fixes()
    at = np.flatnonzero(t_ns == NOW_NS + 60 * 10**9 + 5 * 10**8)[0]
    silence = np.arange(at + 1, at + 7)  # until it has come
    t_ns, fixes = np.delete(t_ns, silence), np.delete(fixes, silence, axis=0)
    comes_ns = t_ns.copy()
    comes_ns[at] += round(late_s * 1e9)  # with the packet that begins 0.5, 1.5 or 2.5 s after its time
    fused, row_t_ns, rows = circle.run((t_ns, fixes, comes_ns))
    assert count(fused, "gnss_position", "rejected_time") == (late_s > Tuning().late_s)
    assert circle.errors_m(row_t_ns, rows)[row_t_ns > NOW_NS + 20 * 10**9].max() < 0.2


def test_an_aid_sent_again_enters_once(circle, undisturbed):
    t_ns, fixes = circle.fixes()
    twice_t_ns = np.concatenate([t_ns[:121], t_ns[115:]])
    twice = np.concatenate([fixes[:121], fixes[115:]])
    comes_ns = np.concatenate([t_ns[:121], np.maximum(t_ns[115:], t_ns[120])])
    fused, _, rows = circle.run((twice_t_ns, twice, comes_ns))
    assert count(fused, "gnss_position", "rejected_time") == 6
    assert rows.tobytes() == undisturbed[2].tobytes()


def test_a_fix_from_the_future_keeps_no_later_one_out(circle, undisturbed):
    t_ns, fixes = circle.fixes()
    comes_ns = t_ns.copy()
    t_ns = np.insert(t_ns, 120, t_ns[120] + 3600 * 10**9)
    fixes = np.insert(fixes, 120, fixes[120], axis=0)
    comes_ns = np.insert(comes_ns, 120, comes_ns[120])
    fused, _, rows = circle.run((t_ns, fixes, comes_ns))
    assert count(fused, "gnss_position", "rejected_time") == 1
    assert rows.tobytes() == undisturbed[2].tobytes()


def test_fixes_without_inertial_samples_do_not_pile_up():
    fused = NavigationFilter(FilterConfig())
    circle = Circle(1.0)
    no_field, no_speed = (np.empty(0, np.int64), np.empty((0, 3))), (np.empty(0, np.int64), np.empty(0))
    none = (np.empty(0, np.int64), np.empty((0, 3)), np.empty((0, 3)), np.empty(0))
    samples = (circle.t_ns, circle.f_b, circle.omega_b, np.zeros(len(circle.t_ns)))
    fix = circle.fixes()[1][:1]
    for second in range(100):
        at_ns = np.array([NOW_NS + second * 10**9])
        fused.step(*(samples if second == 50 else none), Aids((at_ns, fix), no_field, no_speed))
    waiting = fused.arrays()["pending.t_ns"]
    assert len(waiting) <= Tuning().max_gap_s + 1


@pytest.mark.parametrize("reading", [math.nan, -3.0, 1e9, math.inf])
def test_a_wheel_speed_that_no_wheel_has_is_refused(circle, undisturbed, reading):
    at_ns = np.array([NOW_NS + 60 * 10**9])
    fused, _, rows = circle.run(circle.fixes(), (at_ns, np.array([reading])))
    assert count(fused, "speed", "rejected_range") == 1
    assert rows.tobytes() == undisturbed[2].tobytes()


def test_without_fixes_the_mode_says_so_and_spreads_grow(circle):
    t_ns, fixes = circle.fixes()
    kept = t_ns < NOW_NS + 60 * 10**9
    _, row_t_ns, rows = circle.run((t_ns[kept], fixes[kept]))
    after = row_t_ns > NOW_NS + 63 * 10**9  # two missed fixes and the row that tells
    assert (rows[after, TRACK["mode"]] == Mode.COASTING).all()
    # From second to second: between the constraints' updates it rises, and each takes a little off.
    assert (np.diff(rows[after, TRACK["sd_n_m"]][::10]) > 0.0).all()
    assert not rows[after, TRACK["gnss_used"]].any()


def test_a_state_that_no_vehicle_has_is_given_up_for_a_new_start(circle):
    t_ns, fixes = circle.fixes()
    wild = Circle(90.0)
    hit = (wild.t_s > 40.0) & (wild.t_s < 43.0)
    wild.f_b[hit, 0] = 5_000.0
    fused, row_t_ns, rows = wild.run((t_ns, fixes))
    assert count(fused, "imu", "reset") >= 1
    late = row_t_ns > NOW_NS + 65 * 10**9  # 7 s to align in motion, twice, and 5 s to settle
    assert circle.errors_m(row_t_ns, rows)[late].max() < 1.0
