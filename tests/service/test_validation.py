"""Every limit of a packet: just within it is taken, just beyond it is refused with its code."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from schemas.packet import PacketError
from schemas.telemetry_pb2 import FixType, TelemetryPacket
from service.ingest import validation
from service.ingest.validation import REASONS, check_content, check_identity

SECOND_NS = 1_000_000_000
T0_NS = 1_700_000_000 * SECOND_NS
NOW_NS = T0_NS + 3600 * SECOND_NS


def good_packet() -> TelemetryPacket:
    packet = TelemetryPacket(vehicle_id="car-1", boot_id="boot-1", sequence=1, start_time_ns=T0_NS)
    packet.imu.period_ns = 10_000_000
    packet.imu.accel_scale_mps2, packet.imu.gyro_scale_radps = 0.0006, 0.00015
    packet.imu.samples = np.zeros((100, 6), "<i2").tobytes()
    packet.gnss.add(offset_ns=0, lat_1e9deg=59_350_000_000, lon_1e9deg=18_070_000_000, height_mm=40_000)
    packet.magnetometer.period_ns, packet.magnetometer.scale_ut = 100_000_000, 0.1
    packet.magnetometer.samples = np.zeros((10, 3), "<i2").tobytes()
    packet.wheel_speed.add(offset_ns=0, speed_mmps=10_000)
    packet.barometer.add(offset_ns=0, pressure_pa=101_325.0)
    return packet


def floats(*row: float) -> bytes:
    return np.array([row], "<f4").tobytes()


def set_imu_floats(packet: TelemetryPacket, *row: float) -> None:
    packet.imu.samples = b""
    packet.imu.samples_f32 = floats(*row)


def set_even_samples(packet: TelemetryPacket, count: int, period_ns: int) -> None:
    packet.imu.samples, packet.imu.period_ns = bytes(12 * count), period_ns


def set_offsets(packet: TelemetryPacket, *offsets_ns: int) -> None:
    packet.imu.samples = bytes(12 * len(offsets_ns))
    packet.imu.offsets_ns = np.array(offsets_ns, "<i8").tobytes()


def no_position(packet: TelemetryPacket, fix: FixType) -> None:
    packet.gnss[0].ClearField("lat_1e9deg")
    packet.gnss[0].ClearField("lon_1e9deg")
    packet.gnss[0].fix = fix


Change = Callable[[TelemetryPacket], object]

TAKEN: list[Change] = [
    lambda p: None,
    lambda p: p.ClearField("imu"),
    lambda p: [p.ClearField(name) for name in ("imu", "gnss", "magnetometer", "wheel_speed", "barometer")],
    lambda p: setattr(p, "start_time_ns", validation.MIN_TIME_NS),
    lambda p: setattr(p, "start_time_ns", NOW_NS + 24 * 3600 * SECOND_NS - SECOND_NS),
    lambda p: set_even_samples(p, 6001, 10_000_000),  # 60 s
    lambda p: set_even_samples(p, 1000, 1_000_000),  # 1 kHz
    lambda p: set_offsets(p, 0, 3_000_000, 700_000_000),
    lambda p: set_imu_floats(p, 9999, 0, 0, 0, 0, -99),
    lambda p: setattr(p.gnss[0], "offset_ns", -2 * SECOND_NS),
    lambda p: setattr(p.gnss[0], "offset_ns", 2 * SECOND_NS),
    lambda p: setattr(p.gnss[0], "lat_1e9deg", -90_000_000_000),
    lambda p: setattr(p.gnss[0], "lon_1e9deg", 180_000_000_000),
    lambda p: setattr(p.gnss[0], "lat_1e9deg", 0),  # the equator is a place
    lambda p: setattr(p.gnss[0], "course_1e5deg", 36_000_000),
    lambda p: setattr(p.gnss[0], "speed_mmps", 200_000),
    lambda p: setattr(p.gnss[0], "sd_h_mm", 1),
    lambda p: setattr(p.barometer[0], "pressure_pa", 30_000.0),
    lambda p: setattr(p.barometer[0], "pressure_pa", 110_000.0),
    lambda p: no_position(p, FixType.FIX_TYPE_NONE),
]


@pytest.mark.parametrize("change", TAKEN)
def test_what_is_within_the_limits_is_taken(change: Change) -> None:
    packet = good_packet()
    change(packet)
    check_identity(packet, "car-1")
    check_content(packet, NOW_NS)


REFUSED: list[tuple[str, Change]] = [
    ("time_past", lambda p: setattr(p, "start_time_ns", 0)),
    ("time_past", lambda p: setattr(p, "start_time_ns", validation.MIN_TIME_NS - 1)),
    ("time_past", lambda p: setattr(p, "start_time_ns", -(2**63))),
    ("time_future", lambda p: setattr(p, "start_time_ns", NOW_NS + 24 * 3600 * SECOND_NS + 1)),
    ("time_future", lambda p: setattr(p, "start_time_ns", NOW_NS + 24 * 3600 * SECOND_NS)),  # and its samples after it
    ("time_future", lambda p: setattr(p, "start_time_ns", 2**63 - 1)),
    ("time_range", lambda p: setattr(p.imu, "period_ns", 2**63)),
    ("time_range", lambda p: setattr(p.wheel_speed[0], "offset_ns", 2**63 - 1)),
    ("span", lambda p: set_even_samples(p, 6002, 10_000_000)),
    ("span", lambda p: set_offsets(p, 0, 61 * SECOND_NS)),
    ("rate", lambda p: set_even_samples(p, 1000, 999_999)),
    ("rate", lambda p: set_offsets(p, 0, 999_999)),
    ("unsorted", lambda p: setattr(p.imu, "period_ns", 0)),
    ("unsorted", lambda p: set_offsets(p, 0, 5_000_000, 4_000_000)),
    ("unsorted", lambda p: set_offsets(p, 0, 5_000_000, 5_000_000)),
    ("unsorted", lambda p: p.gnss.add(offset_ns=-1, lat_1e9deg=10**9, lon_1e9deg=10**9)),
    ("unsorted", lambda p: p.wheel_speed.add(offset_ns=0, speed_mmps=1)),
    ("unsorted", lambda p: p.barometer.add(offset_ns=0, pressure_pa=1e5)),
    ("offset", lambda p: set_offsets(p, -1, 5_000_000)),
    ("offset", lambda p: setattr(p.gnss[0], "offset_ns", -2 * SECOND_NS - 1)),
    ("offset", lambda p: setattr(p.wheel_speed[0], "offset_ns", 4 * SECOND_NS)),
    ("offset", lambda p: setattr(p.barometer[0], "offset_ns", -3 * SECOND_NS)),
    ("offset", lambda p: setattr(p.magnetometer, "offset_ns", 3 * SECOND_NS)),
    ("block_length", lambda p: setattr(p.imu, "samples", bytes(13))),
    ("block_length", lambda p: setattr(p.imu, "offsets_ns", bytes(8))),
    ("block_length", lambda p: setattr(p.imu, "offsets_ns", bytes(9))),
    ("block_length", lambda p: setattr(p.magnetometer, "samples", bytes(5))),
    ("block_form", lambda p: setattr(p.imu, "samples_f32", bytes(24))),
    ("scale", lambda p: p.imu.ClearField("accel_scale_mps2")),
    ("scale", lambda p: setattr(p.imu, "gyro_scale_radps", -1.0)),
    ("scale", lambda p: setattr(p.imu, "gyro_scale_radps", math.nan)),
    ("scale", lambda p: setattr(p.imu, "accel_scale_mps2", math.inf)),
    ("scale", lambda p: setattr(p.magnetometer, "scale_ut", 0.0)),
    ("scale", lambda p: setattr(p.imu, "accel_full_scale_mps2", math.nan)),
    ("not_finite", lambda p: set_imu_floats(p, math.nan, 0, 0, 0, 0, 0)),
    ("not_finite", lambda p: set_imu_floats(p, 0, 0, 0, 0, 0, -math.inf)),
    ("not_finite", lambda p: setattr(p, "temperature_c", math.nan)),
    ("not_finite", lambda p: setattr(p.gnss[0], "hdop", math.nan)),
    ("not_finite", lambda p: setattr(p.gnss[0], "vdop", math.inf)),
    ("range", lambda p: set_imu_floats(p, 10_001, 0, 0, 0, 0, 0)),
    ("range", lambda p: set_imu_floats(p, 0, 0, 0, 0, -101, 0)),
    ("range", lambda p: setattr(p, "temperature_c", -274.0)),
    ("range", lambda p: setattr(p.wheel_speed[0], "speed_mmps", 200_001)),
    ("range", lambda p: setattr(p.barometer[0], "pressure_pa", 1013.25)),  # hPa
    ("range", lambda p: setattr(p.barometer[0], "pressure_pa", 110_001.0)),
    ("range", lambda p: p.barometer[0].ClearField("pressure_pa")),
    ("not_finite", lambda p: setattr(p.barometer[0], "pressure_pa", math.nan)),
    ("not_finite", lambda p: p.barometer.add(offset_ns=1_000_000, pressure_pa=math.inf)),
    ("range", lambda p: setattr(p.gnss[0], "lat_1e9deg", 90_000_000_001)),
    ("range", lambda p: setattr(p.gnss[0], "lon_1e9deg", -180_000_000_001)),
    ("range", lambda p: setattr(p.gnss[0], "height_mm", 30_000_000)),
    ("range", lambda p: setattr(p.gnss[0], "vn_mmps", 1)),  # without east
    ("range", lambda p: setattr(p.gnss[0], "vd_mmps", -300_000)),
    ("range", lambda p: setattr(p.gnss[0], "course_1e5deg", 36_000_001)),
    ("range", lambda p: setattr(p.gnss[0], "sd_h_mm", 0)),
    ("range", lambda p: setattr(p.gnss[0], "sd_vel_mmps", 0)),
    ("range", lambda p: setattr(p.gnss[0], "satellites", 256)),
    ("no_position", lambda p: p.gnss[0].ClearField("lat_1e9deg")),
    ("no_position", lambda p: no_position(p, FixType.FIX_TYPE_3D)),
    ("no_position", lambda p: no_position(p, FixType.FIX_TYPE_UNSPECIFIED)),
    ("null_island", lambda p: [setattr(p.gnss[0], name, 0) for name in ("lat_1e9deg", "lon_1e9deg")]),
    ("null_island", lambda p: p.gnss.add(offset_ns=10**8, lat_1e9deg=50_000, lon_1e9deg=-50_000)),
]


@pytest.mark.parametrize(("code", "change"), REFUSED)
def test_what_is_beyond_a_limit_is_refused_with_its_code(code: str, change: Change) -> None:
    packet = good_packet()
    change(packet)
    with pytest.raises(PacketError) as refused:
        check_content(packet, NOW_NS)
    assert refused.value.code == code, refused.value.detail
    assert code in REASONS


@pytest.mark.parametrize(
    ("code", "change"),
    [
        ("vehicle_id", lambda p: p.ClearField("vehicle_id")),
        ("vehicle_id", lambda p: setattr(p, "vehicle_id", "a/b")),
        ("vehicle_id", lambda p: setattr(p, "vehicle_id", "x" * 129)),
        ("vehicle_mismatch", lambda p: setattr(p, "vehicle_id", "car-2")),
        ("boot_id", lambda p: p.ClearField("boot_id")),
        ("boot_id", lambda p: setattr(p, "boot_id", "**")),
        ("boot_id", lambda p: setattr(p, "boot_id", "x" * 65)),
        ("sequence", lambda p: p.ClearField("sequence")),
        ("sequence", lambda p: setattr(p, "sequence", 2**31)),
        ("sequence", lambda p: setattr(p, "sequence", 2**64 - 1)),
    ],
)
def test_a_packet_that_cannot_be_placed_is_refused(code: str, change: Change) -> None:
    packet = good_packet()
    change(packet)
    with pytest.raises(PacketError) as refused:
        check_identity(packet, "car-1")
    assert refused.value.code == code
    assert code in REASONS
