"""What is known of a box's sensors: the parameters, how they were found, and from when on they hold."""

from __future__ import annotations

from typing import Annotated, Final, Literal, Self

from pydantic import Field, StringConstraints, model_validator

from core import sensors
from core.errors import InvalidInputError
from schemas.model import Finite, Model, NotNegative, PerAxis, VehicleId
from schemas.times import Time

Gain = Annotated[float, Field(gt=0, le=1e6, allow_inf_nan=False)]
Sentence = Annotated[str, StringConstraints(max_length=2000, pattern=r"^[^\x00]*$")]
Name = Annotated[str, StringConstraints(max_length=40, pattern=r"^[^\x00]*$")]
Row = PerAxis[Finite]
UNIT_SCALES: Final = (0.5, 2.0)
"""Scales, measured over true, of a triad that shows m/s² or rad/s: data sheets allow 0.9 to 1.1."""


class TriadSd(Model):
    """Standard deviations, in the units of what they belong to."""

    scale: PerAxis[NotNegative] | None = None
    misalignment: PerAxis[NotNegative] | None = None
    bias: PerAxis[NotNegative] | None = None
    alignment: PerAxis[NotNegative] | None = None


class Observability(Model):
    """What the recording could not tell, and what to record to tell it."""

    weak: tuple[Name, ...] = Field(default=(), max_length=50, description="Parameters that rest on the prior.")
    condition: NotNegative | None = None
    add: tuple[Row, ...] = Field(default=(), max_length=50, description="Directions of up to record, best first.")
    advice: Sentence = ""


class Provenance(Model):
    """How a sensor's parameters were found; nothing is computed from it."""

    residual_rms: NotNegative | None = Field(default=None, description="Of the fit, in the sensor's unit (gyro: rad).")
    positions: Annotated[int, Field(ge=0)] | None = Field(default=None, description="Static positions used.")
    iterations: Annotated[int, Field(ge=0)] | None = None
    stop: Name | None = Field(default=None, description="Why the iteration ended.")
    observability: Observability | None = None
    gravity: NotNegative | None = Field(default=None, description="Gravity that was taken to hold, m/s².")
    warnings: tuple[Sentence, ...] = Field(default=(), max_length=50)


class TemperatureSlope(Model):
    """How the bias followed the box's temperature while it was recorded; told, not used."""

    reference_c: Finite = Field(description="Mean temperature at rest, at which the bias holds.")
    low_c: Finite = Field(description="The lowest and the highest between which it was seen.")
    high_c: Finite
    slope_per_k: Row = Field(description="Change of the bias, sensor units a kelvin.")
    sd: PerAxis[NotNegative]


class SensorCalibration(Provenance):
    """The nine parameters of a triad: measured = diag(scale) · M · true + bias.

    M is unit upper triangular with rows (1, −Mz, My), (0, 1, −Mx), (0, 0, 1).
    """

    scale: tuple[Gain, Gain, Gain] = Field(default=(1.0, 1.0, 1.0), description="Measured over true, each axis.")
    misalignment: Row = Field(default=(0.0, 0.0, 0.0), description="Mx, My, Mz, rad.")
    bias: Row = Field(default=(0.0, 0.0, 0.0), description="Offset of each axis, sensor units.")
    sd: TriadSd | None = None
    temperature: TemperatureSlope | None = Field(default=None, description="Where the recording had it and it changed.")


class GyroscopeCalibration(SensorCalibration):
    """A gyroscope triad's parameters, and how it sits against the accelerometers."""

    alignment: Row = Field(
        default=(0.0, 0.0, 0.0), description="Small rotation of its axes against the accelerometer's, rad."
    )


class MagnetometerSd(Model):
    """Standard deviations of a magnetometer's parameters."""

    hard_iron: PerAxis[NotNegative] | None = None
    soft_iron: PerAxis[PerAxis[NotNegative]] | None = None


class MagnetometerCalibration(Provenance):
    """Iron about a magnetometer: measured = soft_iron · true + hard_iron."""

    hard_iron: Row = Field(default=(0.0, 0.0, 0.0), description="Offset of each axis, µT.")
    soft_iron: PerAxis[Row] = Field(
        default=((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)), description="Rows of the matrix."
    )
    field_strength: NotNegative | None = Field(default=None, description="Of the field where it was recorded, µT.")
    sd: MagnetometerSd | None = None

    @model_validator(mode="after")
    def _check_inverse(self) -> Self:
        try:
            sensors.MagnetometerCalibration(self.hard_iron, self.soft_iron)
        except InvalidInputError as error:
            raise ValueError(str(error)) from None
        return self


class Calibration(Model):
    """What is known of the box's sensors: what ``telefuse calibrate`` writes."""

    accelerometer: SensorCalibration | None = Field(default=None, description="Bias in m/s².")
    gyroscope: GyroscopeCalibration | None = Field(default=None, description="Bias in rad/s.")
    magnetometer: MagnetometerCalibration | None = None
    warnings: tuple[Sentence, ...] = Field(default=(), max_length=50)

    def check_units(self) -> None:
        """Raise ValueError where it is of raw counts: what a drive or a packet holds is in m/s² and rad/s."""
        low, high = UNIT_SCALES
        for name in ("accelerometer", "gyroscope"):
            triad: SensorCalibration | None = getattr(self, name)
            if triad is not None and not all(low <= scale <= high for scale in triad.scale):
                shown = ", ".join(f"{scale:g}" for scale in triad.scale)
                raise ValueError(
                    f"{name}: its scale is {shown}, as of raw counts; for m/s² and rad/s {low:g} to {high:g} is "
                    "expected: calibrate a recording in these units"
                )


Origin = Literal["registration", "put", "run", "field"]


class CalibrationVersion(Calibration):
    """A calibration with the time in which it holds."""

    version: int = Field(description="Counts up with each that is put; 0 is the box as it measures, uncalibrated.")
    valid_from: Time | None = Field(description="Null: ever since.")
    valid_to: Time | None = Field(
        description="When the next one takes over, null while none is known; as valid_from where it never held."
    )
    origin: Origin | None = Field(
        description="registration; put; run: accepted from a calibration run; field: followed on a trip."
    )
    base: int | None = Field(description="With origin field: the version whose biases are brought up to date.")
    run_id: str | None = Field(description="With origin run.")
    created_at: Time | None
    created_by: str | None = Field(description="Id of the API key that put it.")


class CalibrationHistory(Model):
    """A page of calibrations, newest first."""

    calibrations: list[CalibrationVersion]
    next_cursor: str | None = Field(description="Give it as cursor for the page after this one; null at the end.")


RunStatus = Literal["queued", "running", "done", "failed"]
Sensors = Literal["accelerometer", "gyroscope", "magnetometer", "all"]
AccelUnit = Literal["mps2", "g", "mg"]
GyroUnit = Literal["radps", "dps", "mdps"]


class RunOptions(Model):
    """What is said of an uploaded recording beside what its header says."""

    sensor: Sensors = "all"
    gravity_mps2: float | None = Field(default=None, description="Null: standard gravity.")
    counts: bool = Field(default=False, description="Columns that name no unit are in counts of the converters.")
    rate_hz: float | None = Field(default=None, description="Of a recording with no t_s.")
    accel_unit: AccelUnit | None = Field(default=None, description="Of columns that name none.")
    gyro_unit: GyroUnit | None = Field(default=None, description="Of columns that name none.")
    level: bool = Field(default=False, description="The vehicle drove in circles: only its magnetometer is calibrated.")


class RunProblem(Model):
    """Why a run failed."""

    code: str
    detail: str = Field(description="What is wrong with the recording, and what to record again.")


class CalibrationRun(Model):
    """The calibration of a vehicle's box from an uploaded recording."""

    id: str
    vehicle_id: VehicleId
    status: RunStatus
    progress: float = Field(ge=0, le=1)
    options: RunOptions
    recording_bytes: int = Field(description="As uploaded.")
    recording_sha256: str
    created_at: Time
    started_at: Time | None
    finished_at: Time | None
    result: Calibration | None = Field(description="With status done.")
    problem: RunProblem | None = Field(description="With status failed.")
    has_report: bool
    decision: Literal["accepted", "refused"] | None
    decided_at: Time | None
    version: int | None = Field(description="Of the calibration that it became, once accepted.")


class CalibrationRunList(Model):
    """A page of calibration runs, newest first."""

    runs: list[CalibrationRun]
    next_cursor: str | None = Field(description="Give it as cursor for the page after this one; null at the end.")
