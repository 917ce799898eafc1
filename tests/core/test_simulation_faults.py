"""Faults do what their names say, within their span, and leave everything else as it was."""

from __future__ import annotations

import numpy as np
import pytest

from core.earth import ned_offset_m
from core.errors import InvalidInputError
from core.measurements import GNSS, SERIES
from core.simulation.faults import FAULTS, Fault, inject
from core.simulation.gnss_faults import PULL_OFF_S
from core.simulation.scenarios import simulate
from core.simulation.sensor_faults import ACCEL_MPS2_PER_K
from core.simulation.stream import Stream

S = 10**9
FOR_GOOD = ("box_clock", "temperature")
"""Faults that outlast their span: what has stepped or warmed stays so."""


@pytest.fixture(scope="module")
def stream():
    return Stream.of(simulate("highway", 1, 120.0, 50.0).measurements)


def faulty(stream, kind, start_s=40.0, duration_s=20.0, size=None, seed=1):
    return inject(stream, [Fault.of(kind, start_s, duration_s, size)], np.random.default_rng(seed))


def since_s(stream, series):
    return (stream.comes_ns[series] - stream.comes_ns["imu"][0]) / S


def moved_n_m(before, after):
    """How far each fix was moved, (m, 3) in n."""
    fixes, others = after.measurements.gnss, before.measurements.gnss
    return np.array([ned_offset_m(*new[None, :3].T, tuple(old[:3]))[0] for new, old in zip(fixes, others, strict=True)])


def equal(one, other):
    return all(
        np.array_equal(getattr(one.measurements, name), getattr(other.measurements, name), equal_nan=True)
        for fields in SERIES.values()
        for name in fields
    ) and all(np.array_equal(one.comes_ns[name], other.comes_ns[name]) for name in SERIES)


def part(stream, keep):
    """What comes at seconds for which ``keep`` holds."""
    for name in SERIES:
        stream = stream.chosen(name, np.flatnonzero(keep(since_s(stream, name))))
    return stream


@pytest.mark.parametrize("kind", FAULTS)
def test_each_fault_changes_its_span_and_nothing_outside(stream, kind):
    found = faulty(stream, kind)
    assert not equal(found, stream)
    until = np.inf if kind in FOR_GOOD else 62.0  # a late fix of the span's last second comes up to 2 s after it
    same_zero = stream.comes_ns["imu"][0]
    assert found.comes_ns["imu"][0] == same_zero

    def outside(t_s):
        return (t_s < 40.0) | (t_s >= until)

    assert equal(part(found, outside), part(stream, outside))


@pytest.mark.parametrize("kind", FAULTS)
def test_the_same_seed_gives_the_same_bits(stream, kind):
    assert equal(faulty(stream, kind), faulty(stream, kind))


@pytest.mark.parametrize("kind", ["outliers", "jump", "multipath_ramp", "spoof", "frozen"])
def test_a_wrong_receiver_states_its_accuracy_as_before(stream, kind):
    columns = [GNSS["sd_h_m"], GNSS["sd_v_m"], GNSS["hdop"], GNSS["satellites"]]
    before, after = (one.measurements.gnss[:, columns] for one in (stream, faulty(stream, kind)))
    assert np.array_equal(before, after) or kind == "frozen"  # which repeats that too


def test_sizes_are_metres_in_n(stream):
    inside = stream.during("gnss", (int(stream.comes_ns["imu"][0]) + 40 * S, int(stream.comes_ns["imu"][0]) + 60 * S))
    # 0.1 %: metres a radian at the fix against those at the offset's middle.
    assert np.hypot(*moved_n_m(stream, faulty(stream, "jump", size=60.0))[inside, :2].T) == pytest.approx(60, rel=1e-3)
    ramp = np.hypot(*moved_n_m(stream, faulty(stream, "multipath_ramp", size=2.0))[inside, :2].T)
    assert ramp == pytest.approx(2.0 * (since_s(stream, "gnss")[inside] - 40.0), rel=2e-3, abs=1e-3)


def test_a_spoofer_drags_velocity_as_it_drags_position(stream):
    found = faulty(stream, "spoof", duration_s=PULL_OFF_S + 10.0, size=60.0)
    offset = moved_n_m(stream, found)
    rate = (found.measurements.gnss - stream.measurements.gnss)[:, GNSS["vn_mps"] : GNSS["vn_mps"] + 2]
    t_s = since_s(stream, "gnss")
    dragged = (t_s >= 41.0) & (t_s <= 69.0)
    # Central differences at 1 Hz of a curve whose third derivative is 60 size/T^3 at most: 0.022 m/s.
    assert np.abs(np.gradient(offset[:, :2], t_s, axis=0) - rate)[dragged].max() < 0.03
    held = (t_s > 71.0) & (t_s < 80.0)
    assert np.hypot(*offset[held, :2].T) == pytest.approx(60.0, rel=1e-3)
    assert np.abs(rate[held]).max() < 1e-12


def test_late_fixes_keep_their_times_and_their_order(stream):
    found = faulty(stream, "late", size=2.0)
    assert np.array_equal(found.measurements.gnss_t_ns, stream.measurements.gnss_t_ns)
    delay_s = (found.comes_ns["gnss"] - stream.comes_ns["gnss"]) / S
    assert 1.5 < delay_s.max() <= 2.0
    assert (np.diff(found.comes_ns["gnss"]) >= 0).all()
    packets = list(found.packets(1.0))
    assert any(
        p.measurements.gnss_t_ns.size and p.measurements.gnss_t_ns[0] < p.measurements.imu_t_ns[0] for p in packets
    )


@pytest.mark.parametrize("step_s", [3.0, -3.0])
def test_no_packet_holds_a_step_back_of_the_clock_and_all_of_them_hold_everything(stream, step_s):
    found = faulty(stream, "box_clock", size=step_s)
    packets = list(found.packets(1.0))
    for name, fields in SERIES.items():
        for packet in packets:
            assert (np.diff(getattr(packet.measurements, fields[0])) >= 0).all()
        joined = [np.concatenate([getattr(p.measurements, field) for p in packets]) for field in fields]
        for field, values in zip(fields, joined, strict=True):
            assert np.array_equal(values, getattr(found.measurements, field), equal_nan=True), name
    assert [p.clock_ahead_ns for p in (packets[0], packets[-1])] == [0, round(step_s * S)]


def test_a_box_warms_up_towards_its_rise(stream):
    found = faulty(stream, "temperature", start_s=0.0, duration_s=1e6, size=20.0)
    drift = np.abs(found.measurements.f_s - stream.measurements.f_s) / ACCEL_MPS2_PER_K
    assert drift[-1] == pytest.approx(np.full(3, 20.0 * (1 - np.exp(-120.0 / 300.0))), rel=1e-3)
    assert (np.diff(drift, axis=0) > -1e-9).all()


def test_shaking_clips_at_the_full_scale_which_is_told(stream):
    found = faulty(stream, "saturation", duration_s=2.0)
    limit = found.measurements.accel_full_scale_mps2
    inside = (since_s(stream, "imu") >= 40.0) & (since_s(stream, "imu") < 42.0)
    assert np.abs(found.measurements.f_s).max() <= limit
    assert (
        np.abs(found.measurements.f_s[inside]) == limit
    ).mean() > 0.3  # of a sine of twice the range: 2/3, and noise


def test_faults_lie_one_upon_the_other(stream):
    both = inject(
        stream, [Fault.of("jump", 20.0, 10.0, 30.0), Fault.of("gaps", 60.0, 10.0, 0.5)], np.random.default_rng(1)
    )
    assert equal(part(both, lambda t: t < 55.0), part(faulty(stream, "jump", 20.0, 10.0, 30.0), lambda t: t < 55.0))
    assert both.measurements.imu_t_ns.size == stream.measurements.imu_t_ns.size - 50  # two gaps of half a second


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("flood", 0.0), "unknown fault 'flood': expected one of outliers"),
        (("drops", 0.0, 10.0, 2.0), "drops of 2: expected 0 to 1"),
        (("jump", 0.0, -1.0), "expected a duration of 0 or more"),
        (("jump", float("nan")), "expected a duration"),
    ],
)
def test_what_is_no_fault_is_refused(arguments, told):
    with pytest.raises(InvalidInputError, match=told):
        Fault.of(*arguments)
