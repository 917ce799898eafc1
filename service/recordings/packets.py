"""A drive as the telemetry packets that a box would send of it."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Final

import numpy as np

from core.earth import STANDARD_GRAVITY_MPS2
from core.measurements import FloatArray, Measurements
from schemas.packet import encode_packet
from schemas.telemetry_pb2 import TelemetryPacket
from service.errors import RecordingError
from service.recordings.csv_tables import NS_PER_S
from service.recordings.drive_folder import Drive

ACCEL_RANGES_MPS2: Final = tuple(g * STANDARD_GRAVITY_MPS2 for g in (2.0, 4.0, 8.0, 16.0, 32.0, 100.0, 400.0))
GYRO_RANGES_RADPS: Final = tuple(math.radians(deg) for deg in (250.0, 500.0, 1000.0, 2000.0, 4000.0))
"""Full scales that MEMS sensors come in; where the box's own is not known, the least that holds the recording."""
GAP_PERIODS: Final = 3
"""A pause of more than this many sample periods ends a packet, since a box has nothing to put in there."""


def nominal_period_ns(drive: Drive) -> int:
    """Time between inertial samples: of the stated rate, else the median of the recording."""
    if drive.imu.rate_hz is not None:
        return round(NS_PER_S / drive.imu.rate_hz)
    t_ns = drive.measurements.imu_t_ns
    return int(np.median(np.diff(t_ns))) if t_ns.size > 1 else NS_PER_S // 100


def drive_packets(
    drive: Drive, boot_id: str, packet_s: float = 1.0, wide: bool = False, vehicle_id: str | None = None
) -> Iterator[TelemetryPacket]:
    """Packets of a drive in their order, numbered from 1, each of the samples of up to ``packet_s``.

    Sample times are kept to the nanosecond, also uneven ones. Fixes and other samples go into the packet
    that covers their time; those without inertial samples about them go into packets of their own.
    """
    if not 0.0 < packet_s <= 60.0:
        raise RecordingError(f"packet_s is {packet_s}: expected above 0 and at most 60 s")
    m = _finite_inertial(drive.measurements)
    accel_full_scale_mps2 = (
        _least_range(m.f_s, ACCEL_RANGES_MPS2) if math.isnan(m.accel_full_scale_mps2) else m.accel_full_scale_mps2
    )
    gyro_full_scale_radps = _least_range(m.omega_s, GYRO_RANGES_RADPS)
    period_ns = nominal_period_ns(drive)
    edges = _edges(m, round(packet_s * NS_PER_S), period_ns)
    for sequence, (begin_ns, end_ns) in enumerate(itertools.pairwise(edges), start=1):
        yield encode_packet(
            vehicle_id or drive.vehicle_id,
            boot_id,
            sequence,
            m.between(begin_ns, end_ns),
            period_ns=period_ns,
            accel_scale_mps2=accel_full_scale_mps2 / 32768.0,
            gyro_scale_radps=gyro_full_scale_radps / 32768.0,
            wide=wide,
        )


def _finite_inertial(m: Measurements) -> Measurements:
    """Without the inertial samples that the recording does not have a value for."""
    there = np.isfinite(m.f_s).all(axis=1) & np.isfinite(m.omega_s).all(axis=1)
    if there.all():
        return m
    return replace(m, imu_t_ns=m.imu_t_ns[there], f_s=m.f_s[there], omega_s=m.omega_s[there])


def _edges(m: Measurements, packet_ns: int, period_ns: int) -> list[int]:
    """Times at which packets begin, and the end of the last; no packet is empty."""
    t_all = np.unique(np.concatenate([m.imu_t_ns, m.gnss_t_ns, m.magnetometer_t_ns, m.speed_t_ns, m.barometer_t_ns]))
    if not t_all.size:
        return []
    after_gap = m.imu_t_ns[1:][np.diff(m.imu_t_ns) > GAP_PERIODS * period_ns]
    seconds = np.arange(t_all[0], t_all[-1] + 1, packet_ns)
    edges = np.unique(np.concatenate([seconds, after_gap, [t_all[-1] + 1]]))
    counts = np.diff(np.searchsorted(t_all, edges))
    return [*edges[:-1][counts > 0].tolist(), int(edges[-1])]


def _least_range(values: FloatArray, ranges: tuple[float, ...]) -> float:
    peak = float(np.max(np.abs(values), initial=0.0))
    for full_scale in ranges:
        if peak <= full_scale:
            return full_scale
    return peak
