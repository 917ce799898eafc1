"""Trips of one box over days, its biases known and changed at will, as measurements and as packets."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np

from core.measurements import SERIES, Measurements
from core.simulation.scenarios import simulate

S = 1_000_000_000
RATE_HZ = 50.0
TRIP_S, REST_S = 200.0, 45.0
BETWEEN_NS = 7200 * S


@functools.cache
def drive():
    """Streets, three minutes, from standing to standing."""
    return simulate("city", 3, TRIP_S, RATE_HZ)


@functools.cache
def trip():
    """The drive, then its ignition off while it goes on standing."""
    whole = drive().measurements
    n, seconds = int(REST_S * RATE_HZ), int(REST_S)
    last = slice(-int(RATE_HZ), None)
    rng = np.random.default_rng(1)

    def still(rows):
        return rows[last].mean(0) + rows[last].std(0) * rng.standard_normal((n, 3))

    rest = Measurements(
        imu_t_ns=whole.imu_t_ns[-1] + (np.arange(n) + 1) * round(S / RATE_HZ),
        f_s=still(whole.f_s),
        omega_s=still(whole.omega_s),
        gnss_t_ns=whole.gnss_t_ns[-1] + (np.arange(seconds) + 1) * S,
        gnss=whole.gnss[-1:].repeat(seconds, 0),
        accel_full_scale_mps2=whole.accel_full_scale_mps2,
    )
    return whole, rest


def trips(count, *, more_from=None, accel_mps2=(0.3, 0.0, 0.0), gyro_radps=(0.0, 0.0, 0.01)):
    """Seconds of several trips, two hours between; from trip ``more_from`` on the sensors show so much more."""
    for number in range(count):
        more = more_from is not None and number >= more_from
        for part, ignition in zip(trip(), (True, False), strict=True):
            changed = {times: getattr(part, times) + number * BETWEEN_NS for times, *_ in SERIES.values()}
            if more:
                changed |= {"f_s": part.f_s + np.array(accel_mps2), "omega_s": part.omega_s + np.array(gyro_radps)}
            yield replace(part, **changed, ignition=ignition)


def seconds(measurements, step_s=1.0):
    """What a box sends of it, a packet each ``step_s``."""
    first, last = int(measurements.imu_t_ns[0]), int(measurements.imu_t_ns[-1])
    begin = first // S * S
    step_ns = round(step_s * S)
    for low in range(begin, last + 1, step_ns):
        yield measurements.between(low, low + step_ns)
