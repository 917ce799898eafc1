"""Packets on the wire: what goes in comes out, in protobuf and JSON, and bad bytes are named."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from core.measurements import FLAG_AIRBAG, GNSS, GNSS_COLUMNS, Measurements
from schemas import keys
from schemas.packet import (
    PacketError,
    decode,
    encode_packet,
    measurements_from_packet,
    packet_from_json,
    packet_to_json,
)
from schemas.telemetry_pb2 import TelemetryPacket

ROOT = Path(__file__).resolve().parents[2]
T0_NS = 1_700_000_000_123_456_789
PERIOD_NS = 5_000_000
ACCEL_SCALE, GYRO_SCALE = 0.0006, 0.00015


def fix(**values: float) -> list[float]:
    row = [math.nan] * len(GNSS_COLUMNS)
    for name, value in values.items():
        row[GNSS[name]] = value
    return row


def one_second(seed: int = 0, count: int = 200) -> Measurements:
    rng = np.random.default_rng(seed)
    return Measurements(
        imu_t_ns=T0_NS + PERIOD_NS * np.arange(count),
        f_s=rng.normal([0, 0, -9.8], 1.0, (count, 3)),
        omega_s=rng.normal(0, 0.2, (count, 3)),
        gnss_t_ns=np.array([T0_NS - 40_000_000, T0_NS + 160_000_000]),
        gnss=np.array(
            [
                fix(
                    lat_rad=1.0358,
                    lon_rad=0.3154,
                    alt_m=40.5,
                    vn_mps=-3.25,
                    ve_mps=11.5,
                    vd_mps=0.125,
                    fix=3,
                    satellites=9,
                ),
                fix(
                    lat_rad=-0.5,
                    lon_rad=-2.9,
                    speed_mps=12.5,
                    course_rad=6.2,
                    sd_h_m=1.5,
                    sd_v_m=3.0,
                    sd_v_mps=0.1,
                    hdop=1.25,
                ),
            ]
        ),
        magnetometer_t_ns=T0_NS + 100_000_000 * np.arange(10),
        magnetic_s_ut=rng.normal(0, 30, (10, 3)),
        speed_t_ns=np.array([T0_NS + 1, T0_NS + 250_000_007]),
        speed_mps=np.array([12.345, -0.5]),
        barometer_t_ns=np.array([T0_NS - 1, T0_NS + 500_000_000]),
        pressure_pa=np.array([101_325.16, 94_000.5]),
        temperature_c=21.5,
        accel_full_scale_mps2=19.6,
        ignition=False,
        flags=FLAG_AIRBAG,
    )


def counts_packet(m: Measurements, **changes: Any) -> TelemetryPacket:
    options = {"period_ns": PERIOD_NS, "accel_scale_mps2": ACCEL_SCALE, "gyro_scale_radps": GYRO_SCALE, **changes}
    return encode_packet("car-1", "boot-1", 7, m, **options)


def through_the_wire(packet: TelemetryPacket) -> Measurements:
    return measurements_from_packet(decode(packet.SerializeToString()))


def assert_same_times(m: Measurements, back: Measurements) -> None:
    for name in ("imu_t_ns", "gnss_t_ns", "magnetometer_t_ns", "speed_t_ns", "barometer_t_ns"):
        np.testing.assert_array_equal(getattr(back, name), getattr(m, name))


def test_everything_measured_comes_back() -> None:
    m = one_second()
    back = through_the_wire(counts_packet(m))
    assert_same_times(m, back)
    # Half a count, and the last bit of the division by it.
    np.testing.assert_allclose(back.f_s, m.f_s, atol=ACCEL_SCALE / 2 * 1.000001, rtol=0)
    np.testing.assert_allclose(back.omega_s, m.omega_s, atol=GYRO_SCALE / 2 * 1.000001, rtol=0)
    # The units of the wire: 1e-9 deg is 0.1 mm, 1 mm, 1 mm/s, 1e-5 deg; all given values are multiples but the angles.
    np.testing.assert_allclose(back.gnss, m.gnss, atol=1e-7, rtol=1e-7)
    np.testing.assert_allclose(back.gnss[:, :2], m.gnss[:, :2], atol=0.51e-9 * math.pi / 180, rtol=0)
    np.testing.assert_allclose(back.magnetic_s_ut, m.magnetic_s_ut, rtol=6e-8)  # float32
    np.testing.assert_allclose(back.speed_mps, m.speed_mps, atol=1e-12)
    np.testing.assert_allclose(back.pressure_pa, m.pressure_pa, atol=0.004)  # half a step of float32 at 1e5
    assert (back.temperature_c, back.ignition, back.flags) == (21.5, False, FLAG_AIRBAG)
    assert back.accel_full_scale_mps2 == 19.6


def test_what_is_unknown_stays_unknown() -> None:
    m = Measurements(imu_t_ns=np.array([T0_NS]), f_s=np.zeros((1, 3)), omega_s=np.zeros((1, 3)))
    back = through_the_wire(counts_packet(m))
    assert math.isnan(back.temperature_c)
    assert back.ignition is None
    assert len(back.gnss_t_ns) == len(back.magnetometer_t_ns) == len(back.speed_t_ns) == len(back.barometer_t_ns) == 0
    assert back.gnss.shape == (0, len(GNSS_COLUMNS))
    assert back.accel_full_scale_mps2 == ACCEL_SCALE * 32767  # where counts end


def test_uneven_times_travel_to_the_nanosecond() -> None:
    m = one_second()
    uneven = m.imu_t_ns.copy()
    uneven[50:] += 1
    m = Measurements(imu_t_ns=uneven, f_s=m.f_s, omega_s=m.omega_s)
    packet = counts_packet(m)
    np.testing.assert_array_equal(through_the_wire(packet).imu_t_ns, uneven)
    assert packet.imu.offsets_ns
    assert not counts_packet(one_second()).imu.offsets_ns  # even times cost nothing


def test_the_wide_form_keeps_what_counts_would_clip() -> None:
    m = Measurements(
        imu_t_ns=np.array([T0_NS]), f_s=np.array([[3000.0, 0.1, -9.8]]), omega_s=np.array([[0.0, 1.0, 2.0]])
    )
    np.testing.assert_allclose(through_the_wire(counts_packet(m, wide=True)).f_s, m.f_s, rtol=6e-8)
    clipped = through_the_wire(counts_packet(m))
    assert clipped.f_s[0, 0] == 32767 * ACCEL_SCALE
    assert math.isnan(through_the_wire(counts_packet(m, wide=True)).accel_full_scale_mps2)


def test_samples_are_read_in_place_and_come_out_contiguous() -> None:
    packet = counts_packet(one_second())
    block = packet.imu.samples
    assert np.shares_memory(np.frombuffer(block, "<i2"), np.frombuffer(block, np.uint8))
    back = measurements_from_packet(packet)
    assert back.f_s.flags.c_contiguous
    assert back.omega_s.flags.c_contiguous


@pytest.mark.parametrize("wide", [False, True])
def test_json_says_the_same(wide: bool) -> None:
    packet = counts_packet(one_second(), wide=wide)
    text = packet_to_json(packet)
    assert packet_from_json(text) == packet_from_json(text.encode()) == packet_from_json(json.loads(text)) == packet
    rows = json.loads(text)["imu"]["samples_f32" if wide else "samples"]
    assert np.shape(rows) == (200, 6)


def test_json_takes_either_spelling_and_base64() -> None:
    packet = packet_from_json(
        {
            "vehicleId": "car-1",
            "boot_id": "b",
            "sequence": "3",
            "startTimeNs": T0_NS,
            "imu": {"periodNs": 10, "samples": "AQACAAMABAAFAAYA", "offsetsNs": [0]},
            "wheelSpeed": [{"offsetNs": 5, "speedMmps": -100}],
            "barometer": [{"offsetNs": 5, "pressurePa": 95000.25}],
        }
    )
    assert (packet.sequence, packet.start_time_ns, packet.wheel_speed[0].speed_mmps) == (3, T0_NS, -100)
    assert (packet.barometer[0].offset_ns, packet.barometer[0].pressure_pa) == (5, 95000.25)
    assert np.frombuffer(packet.imu.samples, "<i2").tolist() == [1, 2, 3, 4, 5, 6]
    assert np.frombuffer(packet.imu.offsets_ns, "<i8").tolist() == [0]


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("", "malformed"),
        ("[]", "malformed"),
        ("[" * 100_000, "malformed"),
        ('{"vehicle_id": 7}', "malformed"),
        ('{"unknown_field": 1}', "malformed"),
        ('{"sequence": -1}', "malformed"),
        ('{"temperature_c": NaN}', "not_finite"),
        ('{"imu": {"samples_f32": [[1, 2, 3, 4, 5, Infinity]]}}', "not_finite"),
        ('{"imu": {"samples_f32": [[1, 2, 3, 4, 5, 1e99]]}}', "not_finite"),
        ('{"imu": {"samples": [[1, 2, 3]]}}', "malformed"),
        ('{"imu": {"samples": [[1, 2, 3, 4, 5, 6], [1]]}}', "malformed"),
        ('{"imu": {"samples": [[1, 2, 3, 4, 5, 40000]]}}', "malformed"),
        ('{"imu": {"samples": [[1, 2, 3, 4, 5, 1.5]]}}', "malformed"),
        ('{"imu": {"samples": [[1, 2, 3, 4, 5, null]]}}', "malformed"),
        ('{"imu": {"samples": 7}}', "malformed"),
        ('{"imu": {"offsets_ns": [1e30]}}', "malformed"),
        ('{"imu": 5}', "malformed"),
        ('{"sequence": ' + "9" * 5000 + "}", "malformed"),
    ],
)
def test_json_that_is_no_packet_is_named(text: str, code: str) -> None:
    with pytest.raises(PacketError) as refused:
        packet_from_json(text)
    assert refused.value.code == code
    assert refused.value.detail


def test_a_truncated_packet_is_named() -> None:
    data = counts_packet(one_second()).SerializeToString()
    with pytest.raises(PacketError) as refused:
        decode(data[:-7])
    assert refused.value.code == "malformed"


@pytest.mark.parametrize("length", [1, 11, 13, 2399])
def test_a_block_that_is_no_whole_number_of_rows_is_named(length: int) -> None:
    packet = TelemetryPacket()
    packet.imu.samples = bytes(length)
    with pytest.raises(PacketError) as refused:
        measurements_from_packet(packet)
    assert refused.value.code == "block_length"


def test_times_beyond_64_bits_are_named() -> None:
    packet = TelemetryPacket(start_time_ns=2**63 - 1)
    packet.imu.samples, packet.imu.period_ns = bytes(24), 2**63
    with pytest.raises(PacketError) as refused:
        measurements_from_packet(packet)
    assert refused.value.code == "time_range"


@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({"f_s": np.full((200, 3), math.nan)}, "not_finite"),
        ({"speed_mps": np.array([math.inf, 0.0])}, "not_finite"),
        ({"speed_mps": np.array([1e12, 0.0])}, "range"),
    ],
)
def test_what_cannot_be_encoded_is_named(changes: dict[str, Any], code: str) -> None:
    m = one_second()
    values = {name: getattr(m, name) for name in Measurements.__dataclass_fields__} | changes
    with pytest.raises(PacketError) as refused:
        counts_packet(Measurements(**values))
    assert refused.value.code == code


def test_the_generated_module_is_that_of_the_proto_file(tmp_path: Path) -> None:
    pytest.importorskip("grpc_tools")
    command = [sys.executable, "-m", "grpc_tools.protoc", "-I.", f"--python_out={tmp_path}", f"--pyi_out={tmp_path}"]
    subprocess.run([*command, "schemas/telemetry.proto"], cwd=ROOT, check=True)
    for name in ("telemetry_pb2.py", "telemetry_pb2.pyi"):
        assert (tmp_path / "schemas" / name).read_text() == (ROOT / "schemas" / name).read_text(), (
            f"schemas/{name} is stale; from the top: "
            "python -m grpc_tools.protoc -I. --python_out=. --pyi_out=. schemas/telemetry.proto"
        )


def test_keys_of_a_vehicle() -> None:
    # printf default/car-1 | gzip -c | tail -c8 | od -An -tx4 begins with the CRC-32: 5fafd5c2
    prefix = keys.zenoh_prefix("default", "car-1")
    assert prefix == "telefuse/v1/default/c2/car-1"
    parsed = keys.parse_key(f"{prefix}/telemetry")
    assert parsed == keys.VehicleKey("default", "c2", "car-1", "telemetry")
    assert parsed.bucket_is_right
    wrong = keys.parse_key("telefuse/v1/default/c3/car-1/telemetry")
    assert wrong is not None
    assert not wrong.bucket_is_right


@pytest.mark.parametrize(
    "key", ["", "telefuse/v1/a/b/c", "telefuse/v2/a/00/c/ack", "telefuse/v1/a/00/@c/ack", "a/b/c/d/e/f/g"]
)
def test_other_keys_are_none(key: str) -> None:
    assert keys.parse_key(key) is None


@pytest.mark.parametrize(
    "name", ["", ".", "..", "a/b", "a*", "$x", "a#", "a?", "@x", "-a", "a b", "ä", "a\n", "x" * 129]
)
def test_names_that_are_not_allowed(name: str) -> None:
    assert not keys.is_name(name, 128)


@pytest.mark.parametrize("name", ["a", "WVWZZZ1KZAW000001", "3f2b-9", "car_1.2", "x" * 128])
def test_names_that_are_allowed(name: str) -> None:
    assert keys.is_name(name, 128)
