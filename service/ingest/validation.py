"""What a packet must be to be taken: every limit, with a stable code and a reason for each refusal."""

from __future__ import annotations

import math
from datetime import UTC, datetime
from typing import Final

from core.atmosphere import PRESSURE_RANGE_PA
from core.measurements import GNSS, FloatArray, Measurements, TimeArray
from schemas.keys import MAX_BOOT_ID, MAX_VEHICLE_ID, NAME_RULE, is_name
from schemas.packet import MAX_COUNT, PacketError, measurements_from_packet
from schemas.telemetry_pb2 import FixType, GnssFix, TelemetryPacket

_NS_PER_S: Final = 1_000_000_000

MAX_PACKET_BYTES: Final = 2**20
"""Bytes of an encoded packet (interface, section 3)."""

MAX_SPAN_NS: Final = 60 * _NS_PER_S
"""Time that the samples of a packet may span (interface, section 3)."""

MIN_PERIOD_NS: Final = _NS_PER_S // 1000
"""Mean time between samples of one series: 1 kHz (interface, section 3)."""

OFFSET_TOLERANCE_NS: Final = 2 * _NS_PER_S
"""How far a fix or another slow sample may lie outside the inertial ones: a receiver reports late, by up to 2 s."""

MIN_TIME_NS: Final = int(datetime(2000, 1, 1, tzinfo=UTC).timestamp()) * _NS_PER_S
"""Earlier than any box (interface, section 3): a clock that was never set."""

MAX_AHEAD_NS: Final = 24 * 3600 * _NS_PER_S
"""How far a packet may be ahead of the service's clock (interface, section 3)."""

MAX_SEQUENCE: Final = 2**31 - 1
"""68 years at one packet a second; more is a damaged counter."""

MAX_FORCE_MPS2: Final = 10_000.0
"""Specific force, each axis; high-g crash sensors end at 2000 to 4000 m/s2."""

MAX_RATE_RADPS: Final = 100.0
"""Angular rate, each axis; MEMS gyroscopes end at 4000 deg/s, 70 rad/s."""

MAX_FIELD_UT: Final = 10_000.0
"""Magnetic field, each axis; box-grade magnetometers end at 4900 microtesla."""

MAX_SPEED_MPS: Final = 200.0
"""Speed of a road vehicle, each component: 720 km/h."""

HEIGHT_RANGE_M: Final = (-1_000.0, 20_000.0)
"""Above the ellipsoid: from below the Dead Sea's shore to above any road."""

TEMPERATURE_RANGE_C: Final = (-100.0, 200.0)
"""Of the box; electronics end well within."""

NULL_ISLAND_RAD: Final = math.radians(1e-4)
"""Within 11 m of 0 N 0 E, in open sea: what a receiver says that knows nothing."""

MAX_DOP: Final = 1_000.0
"""Dilution of precision; receivers say 99.99 for none."""

MAX_SATELLITES: Final = 255
"""In one fix, of all constellations."""

REASONS: Final = {
    "too_large": f"more than {MAX_PACKET_BYTES} bytes",
    "malformed": "not a TelemetryPacket, in protobuf or JSON",
    "vehicle_id": "vehicle_id is missing or has characters that are not allowed",
    "boot_id": "boot_id is missing or has characters that are not allowed",
    "sequence": f"sequence is not in 1..{MAX_SEQUENCE}",
    "vehicle_mismatch": "the packet is of another vehicle than the address or key says",
    "unknown_vehicle": "the vehicle is not registered",
    "time_past": "earlier than the year 2000: the clock was never set",
    "time_future": "more than 24 h ahead",
    "time_range": "a time is beyond 64-bit nanoseconds",
    "span": f"the samples span more than {MAX_SPAN_NS // _NS_PER_S} s",
    "rate": f"more than {_NS_PER_S // MIN_PERIOD_NS} samples a second",
    "unsorted": "the times of a series do not increase",
    "offset": "a fix, field, speed or pressure lies outside the packet's span",
    "block_length": "a block of samples is not a whole number of rows",
    "block_form": "samples and samples_f32 are both set",
    "scale": "the weight of a count is missing or absurd",
    "not_finite": "NaN or infinity",
    "range": "a value that no road vehicle has",
    "no_position": "a fix without latitude or longitude",
    "null_island": "a fix at 0 N 0 E",
    "late": "its place in the sequence was given up on before it came",
    "gap_stepped_over": "it did not come while later packets waited, and was given up on",
}
"""Every code with which a packet is refused."""


def check_identity(packet: TelemetryPacket, expected_vehicle_id: str | None = None) -> None:
    """Raise PacketError unless the packet says whose and which it is, and is of the vehicle expected."""
    if not is_name(packet.vehicle_id, MAX_VEHICLE_ID):
        raise PacketError(
            "vehicle_id", f"vehicle_id {_shown(packet.vehicle_id)}: expected 1 to {MAX_VEHICLE_ID} {NAME_RULE}"
        )
    if expected_vehicle_id is not None and packet.vehicle_id != expected_vehicle_id:
        raise PacketError(
            "vehicle_mismatch", f"the packet is of vehicle '{packet.vehicle_id}', sent as '{expected_vehicle_id}'"
        )
    if not is_name(packet.boot_id, MAX_BOOT_ID):
        raise PacketError("boot_id", f"boot_id {_shown(packet.boot_id)}: expected 1 to {MAX_BOOT_ID} {NAME_RULE}")
    if not 1 <= packet.sequence <= MAX_SEQUENCE:
        raise PacketError("sequence", f"sequence {packet.sequence}: expected 1..{MAX_SEQUENCE}, one more each packet")


def check_content(packet: TelemetryPacket, now_ns: int) -> None:
    """Raise PacketError unless everything in the packet is something that a filter may see."""
    _check_start(packet.start_time_ns, now_ns)
    _check_scales(packet)
    m = measurements_from_packet(packet)
    end_t_ns = _check_times(packet, m)
    if end_t_ns > now_ns + MAX_AHEAD_NS:
        raise PacketError("time_future", f"samples until {_utc(end_t_ns)}, more than 24 h ahead of {_utc(now_ns)}")
    _check_range("imu: specific force", m.f_s, MAX_FORCE_MPS2, "m/s2")
    _check_range("imu: angular rate", m.omega_s, MAX_RATE_RADPS, "rad/s")
    _check_range("magnetometer", m.magnetic_s_ut, MAX_FIELD_UT, "microtesla")
    _check_range("wheel_speed", m.speed_mps, MAX_SPEED_MPS, "m/s")
    if m.pressure_pa.size:
        for pressure_pa in (m.pressure_pa.min(), m.pressure_pa.max()):  # both NaN if any is
            _check_value("barometer: pressure_pa", float(pressure_pa), *PRESSURE_RANGE_PA)
    if packet.HasField("temperature_c"):
        low, high = TEMPERATURE_RANGE_C
        _check_value("temperature_c", packet.temperature_c, low, high)
    for index, row in enumerate(m.gnss.tolist()):
        _check_fix(f"gnss[{index}]", row, packet.gnss[index])


def _check_start(start_t_ns: int, now_ns: int) -> None:
    if start_t_ns < MIN_TIME_NS:
        raise PacketError("time_past", f"start_time_ns {start_t_ns} is before 2000; set the clock before sending")
    if start_t_ns > now_ns + MAX_AHEAD_NS:
        raise PacketError("time_future", f"start_time_ns {start_t_ns} is more than 24 h ahead of {_utc(now_ns)}")


def _check_scales(packet: TelemetryPacket) -> None:
    imu, magnetometer = packet.imu, packet.magnetometer
    for used, name, scale, most in (
        (imu.samples, "imu.accel_scale_mps2", imu.accel_scale_mps2, MAX_FORCE_MPS2),
        (imu.samples, "imu.gyro_scale_radps", imu.gyro_scale_radps, MAX_RATE_RADPS),
        (magnetometer.samples, "magnetometer.scale_ut", magnetometer.scale_ut, MAX_FIELD_UT),
    ):
        # Written so that NaN is refused too.
        if used and not 0.0 < scale <= most / MAX_COUNT:
            raise PacketError(
                "scale", f"{name} is {scale}: expected more than 0 and at most {most / MAX_COUNT:.3g} a count"
            )
    if imu.HasField("accel_full_scale_mps2") and not 0.0 < imu.accel_full_scale_mps2 <= MAX_FORCE_MPS2:
        raise PacketError(
            "scale", f"imu.accel_full_scale_mps2 is {imu.accel_full_scale_mps2}: expected at most {MAX_FORCE_MPS2:g}"
        )


def _check_times(packet: TelemetryPacket, m: Measurements) -> int:
    """Check the times of all series; returns the end of the inertial samples, or of all where there are none."""
    start_t_ns = packet.start_time_ns
    series = (
        ("imu", m.imu_t_ns),
        ("gnss", m.gnss_t_ns),
        ("magnetometer", m.magnetometer_t_ns),
        ("wheel_speed", m.speed_t_ns),
        ("barometer", m.barometer_t_ns),
    )
    for name, t_ns in series:
        _check_series(name, t_ns)
    if len(m.imu_t_ns):
        first_t_ns, end_t_ns = int(m.imu_t_ns[0]), int(m.imu_t_ns[-1])
    else:
        first_t_ns, end_t_ns = start_t_ns, start_t_ns + MAX_SPAN_NS
    if first_t_ns < start_t_ns:
        raise PacketError("offset", f"imu.offsets_ns begin {start_t_ns - first_t_ns} ns before start_time_ns")
    if end_t_ns - start_t_ns > MAX_SPAN_NS:
        raise PacketError(
            "span", f"the inertial samples end {(end_t_ns - start_t_ns) / _NS_PER_S:g} s after start_time_ns"
        )
    earliest_ns, latest_ns = start_t_ns - OFFSET_TOLERANCE_NS, end_t_ns + OFFSET_TOLERANCE_NS
    for name, t_ns in series[1:]:
        if len(t_ns) and not (earliest_ns <= t_ns[0] and t_ns[-1] <= latest_ns):
            there = [(int(t) - start_t_ns) / _NS_PER_S for t in (t_ns[0], t_ns[-1])]
            allowed = [(t - start_t_ns) / _NS_PER_S for t in (earliest_ns, latest_ns)]
            raise PacketError(
                "offset",
                f"{name}: offsets {there[0]:g} to {there[1]:g} s, expected within {allowed[0]:g} to {allowed[1]:g} s",
            )
    return max([start_t_ns, *(int(t_ns[-1]) for _, t_ns in series if len(t_ns))])


def _check_series(name: str, t_ns: TimeArray) -> None:
    if len(t_ns) < 2:
        return
    span_ns = int(t_ns[-1]) - int(t_ns[0])
    if not (t_ns[1:] > t_ns[:-1]).all():
        raise PacketError(
            "unsorted", f"{name}: times must increase from sample to sample (is a period or offset missing?)"
        )
    if span_ns > MAX_SPAN_NS + 2 * OFFSET_TOLERANCE_NS:
        raise PacketError(
            "span", f"{name}: {span_ns / _NS_PER_S:g} s in one packet, expected at most {MAX_SPAN_NS // _NS_PER_S}"
        )
    if span_ns < (len(t_ns) - 1) * MIN_PERIOD_NS:
        raise PacketError(
            "rate", f"{name}: {len(t_ns)} samples in {span_ns / _NS_PER_S:g} s, expected at most 1000 a second"
        )


def _check_fix(where: str, row: list[float], fix: GnssFix) -> None:
    lat_rad, lon_rad = row[GNSS["lat_rad"]], row[GNSS["lon_rad"]]
    if math.isnan(lat_rad) or math.isnan(lon_rad):
        if fix.fix != FixType.FIX_TYPE_NONE or not (math.isnan(lat_rad) and math.isnan(lon_rad)):
            raise PacketError(
                "no_position", f"{where}: expected latitude and longitude, or neither and fix FIX_TYPE_NONE"
            )
    else:
        _check_value(f"{where}: latitude, rad,", lat_rad, -math.pi / 2, math.pi / 2)
        _check_value(f"{where}: longitude, rad,", lon_rad, -math.pi, math.pi)
        if abs(lat_rad) < NULL_ISLAND_RAD and abs(lon_rad) < NULL_ISLAND_RAD:
            raise PacketError("null_island", f"{where} is at 0 N 0 E; leave the position out while there is none")
    if math.isnan(row[GNSS["vn_mps"]]) != math.isnan(row[GNSS["ve_mps"]]):
        raise PacketError(
            "range", f"{where}: north velocity without east, or the other way round; expected both or neither"
        )
    for name, low, high in _FIX_RANGES:
        value = row[GNSS[name]]
        if not math.isnan(value) or (name in ("hdop", "vdop") and fix.HasField(name)):
            _check_value(f"{where}: {name}", value, low, high)


_SPREAD: Final = (1e-3, math.inf)
"""A spread of nothing would make a filter believe a fix for ever: 1 mm at least."""

_FIX_RANGES: Final = (
    ("alt_m", *HEIGHT_RANGE_M),
    ("vn_mps", -MAX_SPEED_MPS, MAX_SPEED_MPS),
    ("ve_mps", -MAX_SPEED_MPS, MAX_SPEED_MPS),
    ("vd_mps", -MAX_SPEED_MPS, MAX_SPEED_MPS),
    ("speed_mps", 0.0, MAX_SPEED_MPS),
    ("course_rad", 0.0, math.tau),
    ("sd_h_m", *_SPREAD),
    ("sd_v_m", *_SPREAD),
    ("sd_v_mps", *_SPREAD),
    ("hdop", 0.0, MAX_DOP),
    ("vdop", 0.0, MAX_DOP),
    ("satellites", 0.0, MAX_SATELLITES),
)


def _check_range(where: str, values: FloatArray, most: float, unit: str) -> None:
    if not values.size:
        return
    low, high = float(values.min()), float(values.max())  # NaN if any is
    if math.isnan(low) or math.isinf(low) or math.isinf(high):
        raise PacketError("not_finite", f"{where}: a sample is NaN or infinite")
    if max(-low, high) > most:
        raise PacketError("range", f"{where}: {low:g} to {high:g} {unit}, expected within {most:g}")


def _check_value(where: str, value: float, low: float, high: float) -> None:
    if not math.isfinite(value):
        raise PacketError("not_finite", f"{where} is {value}; leave out what is not known")
    # An end of the range, scaled from the wire's units, may come out a rounding beyond itself.
    slack = 1e-14 * max(abs(low) if math.isfinite(low) else 0.0, abs(value))
    if not low - slack <= value <= high + slack:
        raise PacketError("range", f"{where} is {value:g}, expected {low:g} to {high:g}")


def _utc(t_ns: int) -> str:
    return datetime.fromtimestamp(t_ns // _NS_PER_S, UTC).isoformat()


def _shown(text: str) -> str:
    return repr(text[:40]) if text else "is missing"
