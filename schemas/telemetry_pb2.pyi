from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class FixType(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    FIX_TYPE_UNSPECIFIED: _ClassVar[FixType]
    FIX_TYPE_NONE: _ClassVar[FixType]
    FIX_TYPE_2D: _ClassVar[FixType]
    FIX_TYPE_3D: _ClassVar[FixType]
FIX_TYPE_UNSPECIFIED: FixType
FIX_TYPE_NONE: FixType
FIX_TYPE_2D: FixType
FIX_TYPE_3D: FixType

class TelemetryPacket(_message.Message):
    __slots__ = ("vehicle_id", "sequence", "boot_id", "start_time_ns", "imu", "gnss", "magnetometer", "wheel_speed", "temperature_c", "ignition", "flags", "barometer")
    VEHICLE_ID_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    BOOT_ID_FIELD_NUMBER: _ClassVar[int]
    START_TIME_NS_FIELD_NUMBER: _ClassVar[int]
    IMU_FIELD_NUMBER: _ClassVar[int]
    GNSS_FIELD_NUMBER: _ClassVar[int]
    MAGNETOMETER_FIELD_NUMBER: _ClassVar[int]
    WHEEL_SPEED_FIELD_NUMBER: _ClassVar[int]
    TEMPERATURE_C_FIELD_NUMBER: _ClassVar[int]
    IGNITION_FIELD_NUMBER: _ClassVar[int]
    FLAGS_FIELD_NUMBER: _ClassVar[int]
    BAROMETER_FIELD_NUMBER: _ClassVar[int]
    vehicle_id: str
    sequence: int
    boot_id: str
    start_time_ns: int
    imu: Imu
    gnss: _containers.RepeatedCompositeFieldContainer[GnssFix]
    magnetometer: Magnetometer
    wheel_speed: _containers.RepeatedCompositeFieldContainer[WheelSpeed]
    temperature_c: float
    ignition: bool
    flags: int
    barometer: _containers.RepeatedCompositeFieldContainer[AirPressure]
    def __init__(self, vehicle_id: _Optional[str] = ..., sequence: _Optional[int] = ..., boot_id: _Optional[str] = ..., start_time_ns: _Optional[int] = ..., imu: _Optional[_Union[Imu, _Mapping]] = ..., gnss: _Optional[_Iterable[_Union[GnssFix, _Mapping]]] = ..., magnetometer: _Optional[_Union[Magnetometer, _Mapping]] = ..., wheel_speed: _Optional[_Iterable[_Union[WheelSpeed, _Mapping]]] = ..., temperature_c: _Optional[float] = ..., ignition: _Optional[bool] = ..., flags: _Optional[int] = ..., barometer: _Optional[_Iterable[_Union[AirPressure, _Mapping]]] = ...) -> None: ...

class Imu(_message.Message):
    __slots__ = ("period_ns", "accel_scale_mps2", "gyro_scale_radps", "samples", "samples_f32", "offsets_ns", "accel_full_scale_mps2")
    PERIOD_NS_FIELD_NUMBER: _ClassVar[int]
    ACCEL_SCALE_MPS2_FIELD_NUMBER: _ClassVar[int]
    GYRO_SCALE_RADPS_FIELD_NUMBER: _ClassVar[int]
    SAMPLES_FIELD_NUMBER: _ClassVar[int]
    SAMPLES_F32_FIELD_NUMBER: _ClassVar[int]
    OFFSETS_NS_FIELD_NUMBER: _ClassVar[int]
    ACCEL_FULL_SCALE_MPS2_FIELD_NUMBER: _ClassVar[int]
    period_ns: int
    accel_scale_mps2: float
    gyro_scale_radps: float
    samples: bytes
    samples_f32: bytes
    offsets_ns: bytes
    accel_full_scale_mps2: float
    def __init__(self, period_ns: _Optional[int] = ..., accel_scale_mps2: _Optional[float] = ..., gyro_scale_radps: _Optional[float] = ..., samples: _Optional[bytes] = ..., samples_f32: _Optional[bytes] = ..., offsets_ns: _Optional[bytes] = ..., accel_full_scale_mps2: _Optional[float] = ...) -> None: ...

class GnssFix(_message.Message):
    __slots__ = ("offset_ns", "lat_1e9deg", "lon_1e9deg", "height_mm", "vn_mmps", "ve_mmps", "vd_mmps", "speed_mmps", "course_1e5deg", "sd_h_mm", "sd_v_mm", "sd_vel_mmps", "satellites", "hdop", "vdop", "fix")
    OFFSET_NS_FIELD_NUMBER: _ClassVar[int]
    LAT_1E9DEG_FIELD_NUMBER: _ClassVar[int]
    LON_1E9DEG_FIELD_NUMBER: _ClassVar[int]
    HEIGHT_MM_FIELD_NUMBER: _ClassVar[int]
    VN_MMPS_FIELD_NUMBER: _ClassVar[int]
    VE_MMPS_FIELD_NUMBER: _ClassVar[int]
    VD_MMPS_FIELD_NUMBER: _ClassVar[int]
    SPEED_MMPS_FIELD_NUMBER: _ClassVar[int]
    COURSE_1E5DEG_FIELD_NUMBER: _ClassVar[int]
    SD_H_MM_FIELD_NUMBER: _ClassVar[int]
    SD_V_MM_FIELD_NUMBER: _ClassVar[int]
    SD_VEL_MMPS_FIELD_NUMBER: _ClassVar[int]
    SATELLITES_FIELD_NUMBER: _ClassVar[int]
    HDOP_FIELD_NUMBER: _ClassVar[int]
    VDOP_FIELD_NUMBER: _ClassVar[int]
    FIX_FIELD_NUMBER: _ClassVar[int]
    offset_ns: int
    lat_1e9deg: int
    lon_1e9deg: int
    height_mm: int
    vn_mmps: int
    ve_mmps: int
    vd_mmps: int
    speed_mmps: int
    course_1e5deg: int
    sd_h_mm: int
    sd_v_mm: int
    sd_vel_mmps: int
    satellites: int
    hdop: float
    vdop: float
    fix: FixType
    def __init__(self, offset_ns: _Optional[int] = ..., lat_1e9deg: _Optional[int] = ..., lon_1e9deg: _Optional[int] = ..., height_mm: _Optional[int] = ..., vn_mmps: _Optional[int] = ..., ve_mmps: _Optional[int] = ..., vd_mmps: _Optional[int] = ..., speed_mmps: _Optional[int] = ..., course_1e5deg: _Optional[int] = ..., sd_h_mm: _Optional[int] = ..., sd_v_mm: _Optional[int] = ..., sd_vel_mmps: _Optional[int] = ..., satellites: _Optional[int] = ..., hdop: _Optional[float] = ..., vdop: _Optional[float] = ..., fix: _Optional[_Union[FixType, str]] = ...) -> None: ...

class Magnetometer(_message.Message):
    __slots__ = ("offset_ns", "period_ns", "scale_ut", "samples", "samples_f32", "offsets_ns")
    OFFSET_NS_FIELD_NUMBER: _ClassVar[int]
    PERIOD_NS_FIELD_NUMBER: _ClassVar[int]
    SCALE_UT_FIELD_NUMBER: _ClassVar[int]
    SAMPLES_FIELD_NUMBER: _ClassVar[int]
    SAMPLES_F32_FIELD_NUMBER: _ClassVar[int]
    OFFSETS_NS_FIELD_NUMBER: _ClassVar[int]
    offset_ns: int
    period_ns: int
    scale_ut: float
    samples: bytes
    samples_f32: bytes
    offsets_ns: bytes
    def __init__(self, offset_ns: _Optional[int] = ..., period_ns: _Optional[int] = ..., scale_ut: _Optional[float] = ..., samples: _Optional[bytes] = ..., samples_f32: _Optional[bytes] = ..., offsets_ns: _Optional[bytes] = ...) -> None: ...

class WheelSpeed(_message.Message):
    __slots__ = ("offset_ns", "speed_mmps")
    OFFSET_NS_FIELD_NUMBER: _ClassVar[int]
    SPEED_MMPS_FIELD_NUMBER: _ClassVar[int]
    offset_ns: int
    speed_mmps: int
    def __init__(self, offset_ns: _Optional[int] = ..., speed_mmps: _Optional[int] = ...) -> None: ...

class AirPressure(_message.Message):
    __slots__ = ("offset_ns", "pressure_pa")
    OFFSET_NS_FIELD_NUMBER: _ClassVar[int]
    PRESSURE_PA_FIELD_NUMBER: _ClassVar[int]
    offset_ns: int
    pressure_pa: float
    def __init__(self, offset_ns: _Optional[int] = ..., pressure_pa: _Optional[float] = ...) -> None: ...
