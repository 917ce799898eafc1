"""Any measurements survive the wire; any bytes give a packet or a PacketError, never anything else."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from core.measurements import GNSS, GNSS_COLUMNS, Measurements
from schemas.packet import (
    PacketError,
    decode,
    encode_packet,
    measurements_from_packet,
    packet_from_json,
    packet_to_json,
)
from schemas.telemetry_pb2 import TelemetryPacket
from service.ingest.validation import REASONS, check_content, check_identity

T0_NS = 1_700_000_000_000_000_000

# A column's range on the wire, and its unit there.
_COLUMNS = {
    "lat_rad": (-math.pi / 2, math.pi / 2, math.radians(1e-9)),
    "lon_rad": (-math.pi, math.pi, math.radians(1e-9)),
    "alt_m": (-1000.0, 20000.0, 1e-3),
    "vn_mps": (-200.0, 200.0, 1e-3),
    "ve_mps": (-200.0, 200.0, 1e-3),
    "vd_mps": (-200.0, 200.0, 1e-3),
    "speed_mps": (0.0, 200.0, 1e-3),
    "course_rad": (0.0, 6.28, math.radians(1e-5)),
    "sd_h_m": (0.001, 4e6, 1e-3),
    "sd_v_m": (0.001, 4e6, 1e-3),
    "sd_v_mps": (0.001, 4e6, 1e-3),
}


@st.composite
def measurements(draw: st.DrawFn) -> Measurements:
    def times(most: int) -> np.ndarray:
        steps = draw(st.lists(st.integers(1, 10**9), max_size=most))
        return T0_NS + np.cumsum(np.array(steps, dtype=np.int64))

    def values(shape: tuple[int, ...], most: float) -> np.ndarray:
        seed = draw(st.integers(0, 2**32 - 1))
        return np.random.default_rng(seed).uniform(-most, most, shape)

    imu_t_ns, gnss_t_ns, magnetometer_t_ns, speed_t_ns = times(12), times(3), times(5), times(5)
    barometer_t_ns = times(5)
    rows = []
    for _ in gnss_t_ns:
        row = [math.nan] * len(GNSS_COLUMNS)
        for name, (low, high, _unit) in _COLUMNS.items():
            row[GNSS[name]] = draw(st.one_of(st.just(math.nan), st.floats(low, high)))
        row[GNSS["satellites"]] = draw(st.sampled_from([math.nan, 0.0, 12.0]))
        row[GNSS["fix"]] = draw(st.sampled_from([math.nan, 0.0, 2.0, 3.0]))
        rows.append(row)
    return Measurements(
        imu_t_ns=imu_t_ns,
        f_s=values((len(imu_t_ns), 3), 150.0),
        omega_s=values((len(imu_t_ns), 3), 4.0),
        gnss_t_ns=gnss_t_ns,
        gnss=np.array(rows).reshape(-1, len(GNSS_COLUMNS)),
        magnetometer_t_ns=magnetometer_t_ns,
        magnetic_s_ut=values((len(magnetometer_t_ns), 3), 100.0),
        speed_t_ns=speed_t_ns,
        speed_mps=values((len(speed_t_ns),), 80.0),
        barometer_t_ns=barometer_t_ns,
        pressure_pa=90_000.0 + values((len(barometer_t_ns),), 20_000.0),
        ignition=draw(st.sampled_from([None, True, False])),
        flags=draw(st.integers(0, 7)),
    )


@given(measurements(), st.booleans())
@settings(max_examples=150, deadline=None)
def test_measurements_survive_the_wire(m: Measurements, wide: bool) -> None:
    scales = {} if wide else {"accel_scale_mps2": 0.005, "gyro_scale_radps": 0.000125}
    assume(any(map(len, (m.imu_t_ns, m.gnss_t_ns, m.magnetometer_t_ns, m.speed_t_ns, m.barometer_t_ns))))
    packet = encode_packet("car", "boot", 1, m, period_ns=5_000_000, wide=wide, **scales)
    back = measurements_from_packet(decode(packet.SerializeToString()))
    for name in ("imu_t_ns", "gnss_t_ns", "magnetometer_t_ns", "speed_t_ns", "barometer_t_ns"):
        np.testing.assert_array_equal(getattr(back, name), getattr(m, name))
    # Half a count where there are counts, else float32's 24 bits.
    np.testing.assert_allclose(back.f_s, m.f_s, atol=1e-9 if wide else 0.00250001, rtol=1e-7)
    np.testing.assert_allclose(back.omega_s, m.omega_s, atol=1e-9 if wide else 0.0000625001, rtol=1e-7)
    np.testing.assert_allclose(back.magnetic_s_ut, m.magnetic_s_ut, rtol=1e-7)
    np.testing.assert_allclose(back.speed_mps, m.speed_mps, atol=0.000501)
    np.testing.assert_allclose(back.pressure_pa, m.pressure_pa, rtol=6e-8)  # float32
    for name, (_low, _high, unit) in _COLUMNS.items():
        # Half a unit of the wire, and the rounding of doubles at 4e6.
        np.testing.assert_allclose(back.gnss[:, GNSS[name]], m.gnss[:, GNSS[name]], atol=0.51 * unit, rtol=1e-15)
    for name in ("satellites", "fix"):
        np.testing.assert_array_equal(back.gnss[:, GNSS[name]], m.gnss[:, GNSS[name]])
    assert (back.ignition, back.flags) == (m.ignition, m.flags)
    assert packet_from_json(packet_to_json(packet)) == packet


def take(data: bytes) -> None:
    """The way of a packet up to the journal; only PacketError may come out of it, with a known code."""
    code = "malformed"
    try:
        packet = decode(data)
        check_identity(packet)
        check_content(packet, T0_NS)
    except PacketError as error:
        code = error.code
    assert code in REASONS


@given(st.binary(max_size=400))
@settings(max_examples=500, deadline=None)
def test_random_bytes_are_refused_or_taken(data: bytes) -> None:
    take(data)


def _packet() -> TelemetryPacket:
    rng = np.random.default_rng(3)
    m = Measurements(
        imu_t_ns=T0_NS + 5_000_000 * np.arange(40),
        f_s=rng.normal(0, 5, (40, 3)),
        omega_s=rng.normal(0, 0.2, (40, 3)),
        gnss_t_ns=np.array([T0_NS]),
        gnss=np.array([[1.0, 0.3, 40, 1, 2, 3, math.nan, 1, 1, 2, 0.1, 1.2, 2.0, 9, 3]]),
        magnetometer_t_ns=T0_NS + np.array([0, 7, 100_000_000]),
        magnetic_s_ut=rng.normal(0, 30, (3, 3)),
        speed_t_ns=np.array([T0_NS]),
        speed_mps=np.array([3.0]),
    )
    return encode_packet("car", "boot", 1, m, period_ns=5_000_000, accel_scale_mps2=0.0006, gyro_scale_radps=0.0002)


GOOD = _packet().SerializeToString()


@given(st.integers(0, len(GOOD)))
@settings(max_examples=300, deadline=None)
def test_a_packet_cut_anywhere_is_refused_or_taken(length: int) -> None:
    take(GOOD[:length])


@given(st.lists(st.tuples(st.integers(0, len(GOOD) - 1), st.integers(0, 255)), min_size=1, max_size=8))
@example([(0, 0)])
@settings(max_examples=500, deadline=None)
def test_a_packet_with_damaged_bytes_is_refused_or_taken(damage: list[tuple[int, int]]) -> None:
    data = bytearray(GOOD)
    for at, value in damage:
        data[at] = value
    take(bytes(data))


_NAMES = st.sampled_from(
    [
        *TelemetryPacket.DESCRIPTOR.fields_by_name,
        *(field.camelcase_name for field in TelemetryPacket.DESCRIPTOR.fields),
        "samples",
        "samplesF32",
        "offsets_ns",
        "lat_1e9deg",
        "hdop",
        "x",
    ]
)
json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(_NAMES, inner, max_size=4),
    max_leaves=20,
)


@given(st.dictionaries(_NAMES, json_values, max_size=6))
@settings(max_examples=300, deadline=None)
def test_any_json_is_refused_or_taken(message: dict[str, object]) -> None:
    try:
        packet = packet_from_json(message)
    except PacketError:
        return
    take(packet.SerializeToString())
