"""``drive.toml``: a drive's name, its start in UTC, and how the box and the antenna are fitted."""

from __future__ import annotations

import json
import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, Final, Literal

import pydantic

from schemas.vehicles import SensorNoise
from service.errors import RecordingError

Vector = tuple[float, float, float]

_NO_LEVER_ARM: Final[Vector] = (0.0, 0.0, 0.0)
_EPOCH: Final = datetime(1970, 1, 1, tzinfo=UTC)


@dataclass(frozen=True, slots=True)
class ImuSetup:
    """The ``[imu]`` table; without ``mounting_rpy_deg`` (C_b_from_s) the mounting is unknown.

    ``accel_full_scale_mps2`` is where the accelerometer clips, None if unknown.
    """

    rate_hz: float | None = None
    axes: str | None = None
    mounting_rpy_deg: Vector | None = None
    lever_arm_m: Vector = _NO_LEVER_ARM
    accel_full_scale_mps2: float | None = None
    noise: SensorNoise | None = None


@dataclass(frozen=True, slots=True)
class GnssSetup:
    """The ``[gnss]`` table; the lever arm is in body axes."""

    lever_arm_m: Vector = _NO_LEVER_ARM
    time_offset_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Driver:
    """The ``[driver]`` table."""

    birth_year: int | None = None
    age: int | None = None
    sex: Literal["M", "F"] | None = None


@dataclass(frozen=True, slots=True)
class DriveHeader:
    """All that ``drive.toml`` says."""

    name: str
    start_t_ns: int
    vehicle_id: str
    imu: ImuSetup = field(default_factory=ImuSetup)
    gnss: GnssSetup = field(default_factory=GnssSetup)
    driver: Driver = field(default_factory=Driver)


def read_header(path: Path) -> DriveHeader:
    """Read a ``drive.toml``; raises RecordingError that names the key and what was expected."""
    try:
        document = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise RecordingError(
            f"{path}: is missing; a drive folder needs it, with name, start_utc and vehicle_id"
        ) from None
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise RecordingError(f"{path}: cannot be read as TOML: {error}") from error
    top = _Table(path, "", document)
    imu, gnss, driver = top.table("imu"), top.table("gnss"), top.table("driver")
    return DriveHeader(
        name=top.text("name") or path.parent.name,
        start_t_ns=top.utc_ns("start_utc"),
        vehicle_id=top.text("vehicle_id") or path.parent.name,
        imu=ImuSetup(
            rate_hz=imu.number("rate_hz", above=0.0),
            axes=imu.text("axes"),
            mounting_rpy_deg=imu.vector("mounting_rpy_deg"),
            lever_arm_m=imu.vector("lever_arm_m") or _NO_LEVER_ARM,
            accel_full_scale_mps2=imu.number("accel_full_scale_mps2", above=0.0),
            noise=imu.table("noise").noise() if "noise" in imu.values else None,
        ),
        gnss=GnssSetup(
            lever_arm_m=gnss.vector("lever_arm_m") or _NO_LEVER_ARM,
            time_offset_s=gnss.number("time_offset_s") or 0.0,
        ),
        driver=Driver(birth_year=driver.whole("birth_year"), age=driver.whole("age"), sex=driver.sex("sex")),
    )


def header_text(header: DriveHeader) -> str:
    """A ``drive.toml`` that reads back as ``header``."""
    seconds, nanoseconds = divmod(header.start_t_ns, 1_000_000_000)
    start = _EPOCH + timedelta(seconds=seconds)
    fraction = f".{nanoseconds:09d}".rstrip("0").rstrip(".")
    tables: dict[str, dict[str, Any]] = {
        "": {
            "name": header.name,
            "start_utc": f"{start:%Y-%m-%dT%H:%M:%S}{fraction}Z",
            "vehicle_id": header.vehicle_id,
        },
        "imu": {
            "rate_hz": header.imu.rate_hz,
            "axes": header.imu.axes,
            "mounting_rpy_deg": header.imu.mounting_rpy_deg,
            "lever_arm_m": header.imu.lever_arm_m,
            "accel_full_scale_mps2": header.imu.accel_full_scale_mps2,
        },
        **_noise_tables(header.imu.noise),
        "gnss": {"lever_arm_m": header.gnss.lever_arm_m, "time_offset_s": header.gnss.time_offset_s},
        "driver": {"birth_year": header.driver.birth_year, "age": header.driver.age, "sex": header.driver.sex},
    }
    lines: list[str] = []
    for title, values in tables.items():
        present = {key: value for key, value in values.items() if value is not None}
        if present:
            lines += [f"\n[{title}]"] if title else []
            lines += [f"{key} = {_toml_value(value)}" for key, value in present.items()]
    return "\n".join(lines) + "\n"


def _noise_tables(noise: SensorNoise | None) -> dict[str, dict[str, Any]]:
    """``[imu.noise.accelerometer]`` and its like, down to the tables of intervals."""
    tables: dict[str, dict[str, Any]] = {}

    def add(title: str, values: dict[str, Any]) -> None:
        tables[title] = {key: value for key, value in values.items() if not isinstance(value, dict)}
        for key, value in values.items():
            if isinstance(value, dict):
                add(f"{title}.{key}", value)

    if noise is not None:
        add("imu.noise", noise.model_dump(exclude_none=True))
    return tables


def _toml_value(value: object) -> str:
    """Text, numbers, flags and lists of them are written alike in JSON and TOML."""
    return json.dumps(list(value) if isinstance(value, tuple) else value, ensure_ascii=True, allow_nan=False)


@dataclass(frozen=True, slots=True)
class _Table:
    """One table of the file; each getter checks the type and names the key when it is another."""

    path: Path
    title: str
    values: Mapping[str, Any]

    def _refuse(self, key: str, expected: str) -> RecordingError:
        where = f"[{self.title}] {key}" if self.title else key
        found = f"is {self.values[key]!r}" if key in self.values else "is missing"
        return RecordingError(f"{self.path}: {where} {found}; expected {expected}")

    def table(self, key: str) -> _Table:
        values = self.values.get(key, {})
        if not isinstance(values, dict):
            raise self._refuse(key, "a table")
        return _Table(self.path, f"{self.title}.{key}" if self.title else key, values)

    def text(self, key: str) -> str | None:
        value = self.values.get(key)
        if value is not None and not isinstance(value, str):
            raise self._refuse(key, "text in quotes")
        return value

    def number(self, key: str, above: float = -math.inf) -> float | None:
        value = self.values.get(key)
        if value is None:
            return None
        if isinstance(value, bool) or not isinstance(value, int | float) or not above < value < math.inf:
            raise self._refuse(key, f"a number above {above:g}" if above > -math.inf else "a number")
        return float(value)

    def whole(self, key: str) -> int | None:
        value = self.values.get(key)
        if value is None:
            return None
        if isinstance(value, bool) or not isinstance(value, int) or value < 0:
            raise self._refuse(key, "a whole number from 0")
        return value

    def vector(self, key: str) -> Vector | None:
        value = self.values.get(key)
        if value is None:
            return None
        numbers = value if isinstance(value, list) else []
        if len(numbers) != 3 or not all(
            isinstance(v, int | float) and not isinstance(v, bool) and math.isfinite(v) for v in numbers
        ):
            raise self._refuse(key, "a list of three numbers")
        return float(numbers[0]), float(numbers[1]), float(numbers[2])

    def noise(self) -> SensorNoise:
        try:
            return SensorNoise.model_validate(self.values)
        except pydantic.ValidationError as error:
            first = error.errors(include_url=False)[0]
            where = ".".join(("imu.noise", *(str(part) for part in first["loc"])))
            raise RecordingError(
                f"{self.path}: {where} is {first['input']!r}: {first['msg']}; expected the block that 'telefuse noise' "
                "prints, in m/s2, rad/s and their densities"
            ) from error

    def sex(self, key: str) -> Literal["M", "F"] | None:
        value = self.values.get(key)
        if value is None:
            return None
        if value == "M":
            return "M"
        if value == "F":
            return "F"
        raise self._refuse(key, '"M" or "F"')

    def utc_ns(self, key: str) -> int:
        """An RFC 3339 text or a TOML date-time; one without an offset is taken as UTC."""
        value = self.values.get(key)
        try:
            moment = datetime.fromisoformat(value) if isinstance(value, str) else value
        except ValueError:
            moment = None
        if not isinstance(moment, datetime):
            raise self._refuse(key, 'a UTC time such as "2026-05-04T08:30:00Z"')
        moment = moment if moment.tzinfo is not None else moment.replace(tzinfo=UTC)
        return (moment - _EPOCH) // timedelta(microseconds=1) * 1000
