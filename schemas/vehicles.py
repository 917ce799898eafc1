"""Vehicles as they are registered and read: identity, settings of the box, state."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Annotated, Literal, Self
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

from pydantic import AfterValidator, Field, model_validator

from core.risk.driver import OLDEST, YOUNGEST, Driver
from schemas.calibration import Calibration
from schemas.model import Model, NotNegative, PerAxis, VehicleId
from schemas.times import Time

Metres = Annotated[float, Field(ge=-50, le=50, allow_inf_nan=False)]
AngleDeg = Annotated[float, Field(ge=-360, le=360, allow_inf_nan=False)]

# Each limit is some five times the worst sensor that a box has, and below what a figure in deg, hours or g would be.
AccelDensity = Annotated[float, Field(gt=0, le=0.05, allow_inf_nan=False)]
AccelInstability = Annotated[float, Field(ge=0, le=0.1, allow_inf_nan=False)]
AccelWalk = Annotated[float, Field(ge=0, le=0.01, allow_inf_nan=False)]
AccelBias = Annotated[float, Field(gt=0, le=3, allow_inf_nan=False)]
GyroDensity = Annotated[float, Field(gt=0, le=0.005, allow_inf_nan=False)]
GyroInstability = Annotated[float, Field(ge=0, le=0.01, allow_inf_nan=False)]
GyroWalk = Annotated[float, Field(ge=0, le=0.001, allow_inf_nan=False)]
GyroBias = Annotated[float, Field(gt=0, le=0.2, allow_inf_nan=False)]

Propulsion = Literal["gasoline", "diesel", "cng", "lpg", "electric", "hydrogen", "other"]

Interval = tuple[NotNegative, NotNegative]


class NoiseIntervals(Model):
    """95 % intervals, low and high of each axis: they say how long the recording was; the filter goes by the values."""

    random_walk: PerAxis[Interval] | None = None
    bias_instability: PerAxis[Interval] | None = None
    rate_random_walk: PerAxis[Interval] | None = None
    floor: PerAxis[Interval] | None = None


class AccelerometerNoise(Model):
    """Noise of the accelerometers at rest; what is left out is taken to be a consumer sensor's."""

    random_walk: PerAxis[AccelDensity] | None = Field(
        default=None, description="White noise (velocity random walk), m/s²/√Hz = m/s/√s; 100 µg/√Hz is 0.00098."
    )
    bias_instability: PerAxis[AccelInstability] | None = Field(
        default=None, description="Flicker: its floor of the Allan deviation over 0.664, m/s²."
    )
    rate_random_walk: PerAxis[AccelWalk] | None = Field(default=None, description="Walk of the bias, m/s²/√s.")
    turn_on_bias_sd: PerAxis[AccelBias] | None = Field(
        default=None, description="Spread of the bias from one turn-on to the next, after calibration, m/s²."
    )
    floor: PerAxis[NotNegative] | None = Field(
        default=None, description="Smallest Allan deviation, m/s²: flicker and both walks together; told, not used."
    )
    interval95: NoiseIntervals | None = None


class GyroscopeNoise(Model):
    """Noise of the gyroscopes at rest; what is left out is taken to be a consumer sensor's."""

    random_walk: PerAxis[GyroDensity] | None = Field(
        default=None, description="White noise (angle random walk), rad/s/√Hz = rad/√s; 0.3 °/√h is 0.000087."
    )
    bias_instability: PerAxis[GyroInstability] | None = Field(
        default=None, description="Flicker: its floor of the Allan deviation over 0.664, rad/s; 10 °/h is 0.000048."
    )
    rate_random_walk: PerAxis[GyroWalk] | None = Field(default=None, description="Walk of the bias, rad/s/√s.")
    turn_on_bias_sd: PerAxis[GyroBias] | None = Field(
        default=None, description="Spread of the bias from one turn-on to the next, after calibration, rad/s."
    )
    floor: PerAxis[NotNegative] | None = Field(
        default=None, description="Smallest Allan deviation, rad/s: flicker and both walks together; told, not used."
    )
    interval95: NoiseIntervals | None = None


class NoiseRecording(Model):
    """The rest from which noise was measured."""

    duration_s: NotNegative
    rate_hz: NotNegative
    warnings: tuple[str, ...] = Field(default=(), description="What to know before the figures are believed.")


class SensorNoise(Model):
    """What is known of the inertial sensors' noise: the block that ``telefuse noise --json`` prints."""

    accelerometer: AccelerometerNoise | None = None
    gyroscope: GyroscopeNoise | None = None
    recording: NoiseRecording | None = None


class DriverInfo(Model):
    """Who usually drives, as far as it may be used where the vehicle is; what is left out has no part in any risk."""

    birth_year: int | None = Field(default=None, ge=1900, le=2200)
    age: int | None = Field(default=None, description="Instead of the year of birth; it stays what it is.")
    sex: Literal["M", "F"] | None = None
    licensed_year: int | None = Field(default=None, ge=1900, le=2200, description="Since when they may drive.")

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.age is not None:
            if self.birth_year is not None:
                raise ValueError("birth_year and age are both given; expected one of them")
            if not YOUNGEST <= self.age <= OLDEST:
                raise ValueError(f"age is {self.age}; expected a driver's, {YOUNGEST} to {OLDEST}, or none at all")
        born, licensed = self.birth_year, self.licensed_year
        if born is not None and licensed is not None and licensed - born < YOUNGEST:
            raise ValueError(
                f"licensed_year {self.licensed_year} is before the age of {YOUNGEST}; expected a later one, or none"
            )
        return self

    def in_year(self, year: int) -> Driver:
        """Who that is in a year; what cannot be is left out."""
        age = self.age if self.birth_year is None else year - self.birth_year
        if age is not None and not YOUNGEST <= age <= OLDEST:
            age = None
        experience = None if self.licensed_year is None else float(year - self.licensed_year)
        if experience is not None and not 0.0 <= experience <= (OLDEST if age is None else age) - YOUNGEST:
            experience = None
        return Driver(age, self.sex, experience)


def _known_zone(name: str) -> str:
    try:
        ZoneInfo(name)
    except (ValueError, OSError, ZoneInfoNotFoundError):
        raise ValueError(f"'{name}' is no time zone; expected an IANA name such as Europe/Helsinki") from None
    return name


TimeZone = Annotated[
    str, Field(min_length=1, max_length=64, pattern=r"^[A-Za-z0-9_+/-]+$"), AfterValidator(_known_zone)
]


class VehicleConfig(Model):
    """How the box sits in the vehicle and how it is to be treated; all of it may be left out."""

    mounting_rpy_deg: tuple[AngleDeg, AngleDeg, AngleDeg] | None = Field(
        default=None,
        description="Roll, pitch, yaw of C_b_from_s = Rz(yaw)·Ry(pitch)·Rx(roll); left out, it is found in motion.",
    )
    imu_lever_arm_m: tuple[Metres, Metres, Metres] = Field(
        default=(0.0, 0.0, 0.0), description="Inertial sensor from the vehicle's reference point; forward, right, down."
    )
    gnss_lever_arm_m: tuple[Metres, Metres, Metres] = Field(
        default=(0.0, 0.0, 0.0), description="GNSS antenna from the vehicle's reference point; forward, right, down."
    )
    gnss_time_offset_s: float = Field(
        default=0.0, ge=-5, le=5, allow_inf_nan=False, description="To be added to the time stamps of the fixes."
    )
    accel_full_scale_mps2: float | None = Field(
        default=None,
        gt=0,
        le=10_000,
        description="Where the accelerometer clips; left out, it is read from the packets.",
    )
    vehicle_class: Literal["car", "motorcycle", "van", "truck", "bus"] = "car"
    vin: str | None = Field(
        default=None,
        pattern=r"^[A-HJ-NPR-Z0-9]{17}$",
        description="Identification number (ISO 3779), for eCall.",
    )
    propulsion: tuple[Propulsion, ...] | None = Field(
        default=None, description="What it carries to be driven by, for those who come to help."
    )
    detector: Literal["telefuse", "paper"] = Field(default="telefuse", description="Which accident detector decides.")
    noise: SensorNoise | None = Field(
        default=None,
        description="Noise of the inertial sensors at rest; the filter adds what a moving car does to them.",
    )
    time_zone: TimeZone | None = Field(
        default=None,
        description="IANA name, such as Europe/Helsinki, by which days, months and hours of driving are told apart."
        " Left out, days are UTC's and hours those of the place's longitude. A change holds for trips after it; days"
        " are told apart anew.",
    )
    driver: DriverInfo | None = Field(
        default=None, description="Holds for trips assessed after it; left out, risk and scores go without."
    )


class GivenConfig(VehicleConfig):
    """Settings as they are sent: a calibration may come along, and is kept where all calibrations are."""

    calibration: Calibration | None = Field(
        default=None,
        description="Put as PUT …/calibration would, where it is another than the last; the first one holds for all "
        "packets. Left out, calibrations stay as they are.",
    )

    @model_validator(mode="after")
    def _check_driver(self) -> Self:
        # Here and not with what is stored, which has to be read in any year.
        year = datetime.now(UTC).year
        driver = self.driver
        if driver is not None and driver.birth_year is not None and not YOUNGEST <= year - driver.birth_year <= OLDEST:
            raise ValueError(
                f"driver: born in {driver.birth_year}, they are {year - driver.birth_year}; expected a driver's age,"
                f" {YOUNGEST} to {OLDEST}, or none at all"
            )
        return self

    def settings(self) -> VehicleConfig:
        """What of it is kept with the vehicle."""
        return VehicleConfig.model_validate(self.model_dump(exclude={"calibration"}))


class VehicleUpdate(Model):
    """What registers or changes a vehicle; a field that is left out has its default afterwards."""

    config: GivenConfig = GivenConfig()


class Vehicle(Model):
    """A registered vehicle."""

    vehicle_id: VehicleId
    zenoh_prefix: str = Field(description="Where the box puts its packets: this and /telemetry.")
    config: VehicleConfig
    registered_at: Time
    updated_at: Time


class ListedVehicle(Vehicle):
    """A vehicle in a list, with when it was last heard of."""

    last_seen_at: Time | None


class VehicleList(Model):
    """A page of vehicles, by id."""

    vehicles: list[ListedVehicle]
    next_cursor: str | None = Field(description="Give it as cursor for the page after this one; null at the end.")


class FusedState(Model):
    """Where the vehicle was last known to be, how it moved, and how sure that is."""

    time: Time
    mode: Literal["aligning", "aided", "coasting"] = Field(description="coasting: without GNSS.")
    lat_deg: float
    lon_deg: float
    alt_ellipsoid_m: float
    vn_mps: float
    ve_mps: float
    vd_mps: float
    speed_mps: float
    roll_deg: float | None
    pitch_deg: float | None
    yaw_deg: float | None
    sd_n_m: float = Field(description="Standard deviation of the position to the north; likewise east and down.")
    sd_e_m: float
    sd_d_m: float
    cov_ne_m2: float = Field(description="Covariance of the position's north and east errors.")
    sd_yaw_deg: float | None


class LastPacket(Model):
    """The newest packet that became durable."""

    boot_id: str
    sequence: int
    start_time: Time
    received_at: Time


class VehicleState(Model):
    """What the service knows of a vehicle right now."""

    vehicle_id: VehicleId
    last_seen_at: Time | None
    last_packet: LastPacket | None
    durable_sequence: int | None = Field(
        description="In the last packet's boot: every packet up to here is durable or refused for good."
    )
    fused: FusedState | None = Field(
        description="Null before the first fused position, and for keys without positions:read."
    )
