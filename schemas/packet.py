"""Telemetry packets to and from bytes, JSON and measurements; see ``telemetry.proto`` for the fields."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from typing import Any, Final, NoReturn

import numpy as np
import numpy.typing as npt
from google.protobuf import json_format
from google.protobuf.message import DecodeError

from core.measurements import GNSS, GNSS_COLUMNS, FloatArray, Measurements, TimeArray
from schemas.telemetry_pb2 import AirPressure, FixType, GnssFix, Imu, Magnetometer, TelemetryPacket, WheelSpeed

_COUNT: Final = np.dtype("<i2")
_FLOAT: Final = np.dtype("<f4")
_OFFSET: Final = np.dtype("<i8")
MAX_COUNT: Final = 2**15 - 1
"""The end of an int16 block's range, where it clips."""

_IMU_AXES: Final = 6
_MAGNETIC_AXES: Final = 3
_INT64: Final = range(-(2**63), 2**63)

_RAD_PER_1E9DEG: Final = math.radians(1e-9)
_RAD_PER_1E5DEG: Final = math.radians(1e-5)
_M_PER_MM: Final = 1e-3

_GNSS_FIELDS: Final = (
    # wire field, column of core.measurements.GNSS_COLUMNS, column's unit per wire unit
    ("lat_1e9deg", "lat_rad", _RAD_PER_1E9DEG),
    ("lon_1e9deg", "lon_rad", _RAD_PER_1E9DEG),
    ("height_mm", "alt_m", _M_PER_MM),
    ("vn_mmps", "vn_mps", _M_PER_MM),
    ("ve_mmps", "ve_mps", _M_PER_MM),
    ("vd_mmps", "vd_mps", _M_PER_MM),
    ("speed_mmps", "speed_mps", _M_PER_MM),
    ("course_1e5deg", "course_rad", _RAD_PER_1E5DEG),
    ("sd_h_mm", "sd_h_m", _M_PER_MM),
    ("sd_v_mm", "sd_v_m", _M_PER_MM),
    ("sd_vel_mmps", "sd_v_mps", _M_PER_MM),
    ("satellites", "satellites", 1.0),
    ("hdop", "hdop", 1.0),
    ("vdop", "vdop", 1.0),
)
_COLUMN_OF_FIELD: Final = {
    GnssFix.DESCRIPTOR.fields_by_name[field].number: (GNSS[column], factor) for field, column, factor in _GNSS_FIELDS
}
_FLOAT_FIELDS: Final = frozenset({"hdop", "vdop"})
_FIX_COLUMN: Final = GNSS["fix"]
_FIX_OF_WIRE: Final = {FixType.FIX_TYPE_NONE: 0.0, FixType.FIX_TYPE_2D: 2.0, FixType.FIX_TYPE_3D: 3.0}
_WIRE_OF_FIX: Final = {value: wire for wire, value in _FIX_OF_WIRE.items()}


class PacketError(ValueError):
    """A packet that cannot be used: ``code`` is stable, the text says what was wrong and what was expected."""

    def __init__(self, code: str, detail: str) -> None:
        super().__init__(detail)
        self.code = code
        self.detail = detail


def decode(data: bytes) -> TelemetryPacket:
    """Parse the binary form; raises PacketError where the bytes are no such message."""
    try:
        return TelemetryPacket.FromString(data)
    except DecodeError as error:
        raise PacketError(
            "malformed", f"{len(data)} bytes are not a telefuse.v1.TelemetryPacket (cut short or damaged): {error}"
        ) from error


def measurements_from_packet(packet: TelemetryPacket) -> Measurements:
    """What the packet measured, in SI units and sensor axes; raises PacketError where a block cannot be read.

    The int16 block is read in place; the one pass that scales it also makes the floats.
    """
    start_t_ns = packet.start_time_ns
    imu = packet.imu
    rows = _rows("imu", imu, _IMU_AXES)
    full_scale_mps2 = imu.accel_full_scale_mps2 if imu.HasField("accel_full_scale_mps2") else math.nan
    if rows.dtype == _COUNT:
        f_s, omega_s = rows[:, :3] * imu.accel_scale_mps2, rows[:, 3:] * imu.gyro_scale_radps
        if len(rows) and math.isnan(full_scale_mps2):
            full_scale_mps2 = MAX_COUNT * imu.accel_scale_mps2
    else:
        f_s, omega_s = rows[:, :3].astype(np.float64), rows[:, 3:].astype(np.float64)

    magnetometer = packet.magnetometer
    magnetic = _rows("magnetometer", magnetometer, _MAGNETIC_AXES)
    magnetic_s_ut = magnetic * (magnetometer.scale_ut if magnetic.dtype == _COUNT else np.float64(1.0))

    return Measurements(
        imu_t_ns=_block_times("imu", imu, start_t_ns, 0, len(rows)),
        f_s=f_s,
        omega_s=omega_s,
        gnss_t_ns=_times("gnss", start_t_ns, packet.gnss),
        gnss=_gnss_rows(packet.gnss),
        magnetometer_t_ns=_block_times("magnetometer", magnetometer, start_t_ns, magnetometer.offset_ns, len(magnetic)),
        magnetic_s_ut=magnetic_s_ut,
        speed_t_ns=_times("wheel_speed", start_t_ns, packet.wheel_speed),
        speed_mps=np.array([speed.speed_mmps for speed in packet.wheel_speed], dtype=np.float64) * _M_PER_MM,
        barometer_t_ns=_times("barometer", start_t_ns, packet.barometer),
        pressure_pa=np.array([air.pressure_pa for air in packet.barometer], dtype=np.float64),
        temperature_c=packet.temperature_c if packet.HasField("temperature_c") else math.nan,
        accel_full_scale_mps2=full_scale_mps2,
        ignition=packet.ignition if packet.HasField("ignition") else None,
        flags=packet.flags,
    )


def encode_packet(
    vehicle_id: str,
    boot_id: str,
    sequence: int,
    measurements: Measurements,
    *,
    period_ns: int,
    accel_scale_mps2: float | None = None,
    gyro_scale_radps: float | None = None,
    wide: bool = False,
) -> TelemetryPacket:
    """Build a packet: int16 counts of the given weights, which clip as a converter does, or float32 if ``wide``.

    Times that are not exactly ``period_ns`` apart go along sample by sample. Raises PacketError where a value
    is not finite or does not fit its field.
    """
    m = measurements
    try:
        packet = TelemetryPacket(
            vehicle_id=vehicle_id, boot_id=boot_id, sequence=sequence, start_time_ns=_start_t_ns(m), flags=m.flags
        )
        start_t_ns = packet.start_time_ns
        if len(m.imu_t_ns):
            _finite("imu", m.f_s, m.omega_s)
            packet.imu.period_ns = period_ns
            if not math.isnan(m.accel_full_scale_mps2):
                packet.imu.accel_full_scale_mps2 = m.accel_full_scale_mps2
            if wide:
                packet.imu.samples_f32 = np.hstack((m.f_s, m.omega_s)).astype(_FLOAT).tobytes()
            elif accel_scale_mps2 is None or gyro_scale_radps is None:
                raise PacketError(
                    "scale", "counts need accel_scale_mps2 and gyro_scale_radps; or ask for the wide form"
                )
            else:
                packet.imu.accel_scale_mps2 = accel_scale_mps2
                packet.imu.gyro_scale_radps = gyro_scale_radps
                counts = np.hstack((_counts(m.f_s, accel_scale_mps2), _counts(m.omega_s, gyro_scale_radps)))
                packet.imu.samples = counts.tobytes()
            packet.imu.offsets_ns = _uneven_offsets(m.imu_t_ns, start_t_ns, 0, period_ns)
        if len(m.magnetometer_t_ns):
            _finite("magnetometer", m.magnetic_s_ut)
            packet.magnetometer.samples_f32 = m.magnetic_s_ut.astype(_FLOAT).tobytes()
            _set_magnetometer_times(packet.magnetometer, m.magnetometer_t_ns, start_t_ns)
        for t_ns, row in zip(m.gnss_t_ns.tolist(), m.gnss.tolist(), strict=True):
            packet.gnss.append(_gnss_fix(t_ns - start_t_ns, row))
        _finite("wheel_speed", m.speed_mps)
        for t_ns, speed_mps in zip(m.speed_t_ns.tolist(), m.speed_mps.tolist(), strict=True):
            packet.wheel_speed.add(offset_ns=t_ns - start_t_ns, speed_mmps=round(speed_mps / _M_PER_MM))
        _finite("barometer", m.pressure_pa)
        for t_ns, pressure_pa in zip(m.barometer_t_ns.tolist(), m.pressure_pa.tolist(), strict=True):
            packet.barometer.add(offset_ns=t_ns - start_t_ns, pressure_pa=pressure_pa)
        if not math.isnan(m.temperature_c):
            packet.temperature_c = m.temperature_c
        if m.ignition is not None:
            packet.ignition = m.ignition
    except (ValueError, OverflowError) as error:
        if isinstance(error, PacketError):
            raise
        raise PacketError(
            "range", f"packet {sequence} of {vehicle_id}: a value does not fit its field: {error}"
        ) from error
    return packet


# --- JSON -----------------------------------------------------------------------------------------

_BLOCKS: Final = (("imu", _IMU_AXES), ("magnetometer", _MAGNETIC_AXES))
_ARRAYS: Final = (
    ("samples", "samples", _COUNT),
    ("samples_f32", "samplesF32", _FLOAT),
    ("offsets_ns", "offsetsNs", _OFFSET),
)


def packet_from_json(data: bytes | str | Mapping[str, Any]) -> TelemetryPacket:
    """Read the JSON form: protobuf's own mapping, with ``samples`` (rows of counts), ``samples_f32`` (rows of
    values) and ``offsets_ns`` (numbers) of a block as plain arrays or as base64; raises PacketError.

    Field names may be written as in the .proto file or in lowerCamelCase. NaN and infinity are refused.
    """
    message = dict(data) if isinstance(data, Mapping) else _json_object(data)
    packet = TelemetryPacket()
    arrays: list[tuple[str, str, bytes]] = []
    for block, axes in _BLOCKS:
        if isinstance(message.get(block), dict):
            message[block] = fields = dict(message[block])
            for name, camel_name, dtype in _ARRAYS:
                for written in (name, camel_name):
                    if isinstance(fields.get(written), list):
                        where = f"{block}.{name}"
                        shape = (-1,) if dtype == _OFFSET else (-1, axes)
                        arrays.append((block, name, _plain_array(where, fields.pop(written), dtype, shape)))
    try:
        json_format.ParseDict(message, packet)
    except (json_format.ParseError, TypeError, ValueError, RecursionError) as error:
        raise PacketError(
            "malformed", f"not the JSON form of a telemetry packet: {' '.join(str(error).split())}"
        ) from error
    for block, name, content in arrays:
        setattr(getattr(packet, block), name, content)
    return packet


def packet_to_json(packet: TelemetryPacket) -> str:
    """The JSON form with plain arrays and the field names of the .proto file."""
    message = json_format.MessageToDict(packet, preserving_proto_field_name=True)
    for block, axes in _BLOCKS:
        for name, _, dtype in _ARRAYS:
            if name in message.get(block, ()):
                values = np.frombuffer(getattr(getattr(packet, block), name), dtype)
                message[block][name] = (values if dtype == _OFFSET else values.reshape(-1, axes)).tolist()
    return json.dumps(message, allow_nan=False)


def _json_object(text: bytes | str) -> dict[str, Any]:
    def refuse(constant: str) -> NoReturn:
        raise PacketError("not_finite", f"the JSON holds {constant}; leave out what is not known")

    try:
        message = json.loads(text, parse_constant=refuse)
    except PacketError:
        raise
    except (ValueError, RecursionError) as error:
        raise PacketError("malformed", f"not JSON: {error}") from error
    if not isinstance(message, dict):
        raise PacketError("malformed", f"expected a JSON object with the packet's fields, got {type(message).__name__}")
    return message


def _plain_array(where: str, values: list[Any], dtype: np.dtype[Any], shape: tuple[int, ...]) -> bytes:
    expected = "numbers" if dtype == _FLOAT else "whole numbers"
    rows = "an array of" if len(shape) == 1 else f"rows of {shape[1]}"
    refusal = PacketError("malformed", f"{where}: expected {rows} {expected} within {dtype.name}")
    if not values:
        return b""
    try:
        array = np.array(values)
    except (ValueError, OverflowError):
        raise refusal from None
    if (
        array.ndim != len(shape)
        or array.shape[1:] != shape[1:]
        or array.dtype.kind not in ("iuf" if dtype == _FLOAT else "iu")
    ):
        raise refusal
    if dtype == _FLOAT:
        with np.errstate(over="ignore"):
            floats = array.astype(_FLOAT)
        _finite(where, floats)
        return floats.tobytes()
    limits = np.iinfo(dtype)
    if array.min() < limits.min or array.max() > limits.max:
        raise refusal
    return array.astype(dtype).tobytes()


# --- one block, one series ------------------------------------------------------------------------


def _rows(where: str, block: Imu | Magnetometer, axes: int) -> npt.NDArray[Any]:
    counts, floats = block.samples, block.samples_f32
    if counts and floats:
        raise PacketError("block_form", f"{where}: samples and samples_f32 are both set; send one")
    content, dtype, name = (floats, _FLOAT, "samples_f32") if floats else (counts, _COUNT, "samples")
    width = axes * dtype.itemsize
    if len(content) % width:
        raise PacketError(
            "block_length",
            f"{where}.{name}: {len(content)} bytes, expected a multiple of {width} ({axes} {dtype.name} a row)",
        )
    return np.frombuffer(content, dtype).reshape(-1, axes)


def _block_times(where: str, block: Imu | Magnetometer, start_t_ns: int, offset_ns: int, count: int) -> TimeArray:
    offsets = block.offsets_ns
    if offsets:
        if len(offsets) != count * _OFFSET.itemsize:
            raise PacketError(
                "block_length",
                f"{where}.offsets_ns: {len(offsets)} bytes, expected {_OFFSET.itemsize} for each of {count} samples",
            )
        values = np.frombuffer(offsets, _OFFSET)
        _check_time(where, start_t_ns + int(values.min()))
        _check_time(where, start_t_ns + int(values.max()))
        return values.astype(np.int64) + start_t_ns
    first_t_ns = start_t_ns + offset_ns
    _check_time(where, first_t_ns)
    if not count:
        return np.empty(0, dtype=np.int64)
    _check_time(where, first_t_ns + block.period_ns * count)
    return first_t_ns + block.period_ns * np.arange(count, dtype=np.int64)


def _times(where: str, start_t_ns: int, series: Iterable[GnssFix | WheelSpeed | AirPressure]) -> TimeArray:
    times = [start_t_ns + item.offset_ns for item in series]
    for t_ns in times:
        _check_time(where, t_ns)
    return np.array(times, dtype=np.int64)


def _check_time(where: str, t_ns: int) -> None:
    if t_ns not in _INT64:
        raise PacketError("time_range", f"{where}: a time is beyond what 64-bit nanoseconds can say")


def _gnss_rows(fixes: Iterable[GnssFix]) -> FloatArray:
    rows = []
    for fix in fixes:
        row = [math.nan] * len(GNSS_COLUMNS)
        for field, value in fix.ListFields():
            place = _COLUMN_OF_FIELD.get(field.number)
            if place is not None:
                row[place[0]] = value * place[1]
        row[_FIX_COLUMN] = _FIX_OF_WIRE.get(fix.fix, math.nan)
        rows.append(row)
    return np.array(rows, dtype=np.float64).reshape(-1, len(GNSS_COLUMNS))


def _gnss_fix(offset_ns: int, row: list[float]) -> GnssFix:
    fix = GnssFix(offset_ns=offset_ns)
    for field, column, factor in _GNSS_FIELDS:
        value = row[GNSS[column]]
        if math.isnan(value):
            continue
        if field in _FLOAT_FIELDS:
            setattr(fix, field, value)
        else:
            whole = round((value % math.tau if column == "course_rad" else value) / factor)
            setattr(fix, field, whole)
    fix.fix = _WIRE_OF_FIX.get(row[_FIX_COLUMN], FixType.FIX_TYPE_UNSPECIFIED)
    return fix


def _start_t_ns(m: Measurements) -> int:
    if len(m.imu_t_ns):
        return int(m.imu_t_ns[0])
    slow = (m.gnss_t_ns, m.magnetometer_t_ns, m.speed_t_ns, m.barometer_t_ns)
    firsts = [int(times[0]) for times in slow if len(times)]
    if not firsts:
        raise PacketError("empty", "nothing was measured: a packet needs at least one sample to have a time")
    return min(firsts)


def _counts(values: FloatArray, scale: float) -> npt.NDArray[np.int16]:
    limits = np.iinfo(np.int16)
    return np.clip(np.rint(values / scale), limits.min, limits.max).astype(_COUNT)


def _uneven_offsets(times: TimeArray, start_t_ns: int, offset_ns: int, period_ns: int) -> bytes:
    """Offsets sample by sample; nothing where start, offset and period already say them exactly."""
    offsets = times - start_t_ns
    if np.array_equal(offsets, offset_ns + period_ns * np.arange(len(times), dtype=np.int64)):
        return b""
    return offsets.astype(_OFFSET).tobytes()


def _set_magnetometer_times(magnetometer: Magnetometer, times: TimeArray, start_t_ns: int) -> None:
    magnetometer.offset_ns = int(times[0]) - start_t_ns
    if len(times) > 1:
        magnetometer.period_ns = max(int(times[1] - times[0]), 0)
    magnetometer.offsets_ns = _uneven_offsets(times, start_t_ns, magnetometer.offset_ns, magnetometer.period_ns)


def _finite(where: str, *arrays: npt.NDArray[np.floating[Any]]) -> None:
    if not all(np.isfinite(array).all() for array in arrays):
        raise PacketError("not_finite", f"{where}: a value is NaN or infinite; leave out what is not known")
