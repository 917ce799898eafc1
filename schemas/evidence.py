"""Evidence of an accident as it is read: curves, an event recorder's elements, an eCall's data."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field

from schemas.accidents import EvidenceStatus
from schemas.times import Time

Cell = float | int | str | None


class Replay(BaseModel):
    """How the evidence was made: by folding the packets again."""

    begun: Literal["checkpoint", "first_packet", "anew"] = Field(
        serialization_alias="from",
        validation_alias="from",
        description="checkpoint: in the live session's own state; first_packet: where that began; anew: another "
        "session, begun some minutes before, as no state of then was there.",
    )
    same: bool = Field(description="The accident and the positions that it gives are those stored, to the bit.")
    differences: list[str]
    positions_compared: int


class Covered(BaseModel):
    """What of the time asked for there is."""

    asked_ns: tuple[int, int]
    from_ns: int | None
    to_ns: int | None
    gaps: list[tuple[int, int]] = Field(description="Samples more than 0.1 s apart: the last, the next.")
    whole: bool
    rate_hz: float | None = None


class Trace(BaseModel):
    """Curves around an accident: tables as columns, ``t_s`` from the start of the first impact on.

    A column that is not there needs positions:read; null is unknown.
    """

    accident_id: str
    time: Time = Field(description="When t_s is 0.")
    status: EvidenceStatus
    sha256: str = Field(description="Of the whole bundle that this is from.")
    covered: Covered
    replay: Replay
    parts: dict[str, dict[str, list[Cell]]]


class EdrElement(BaseModel):
    """One data element; what was not recorded has neither value nor series."""

    element: str = Field(description="Its name in tables I and II of 49 CFR 563.")
    recorded: bool
    unit: str | None = None
    rate_hz: float | None = None
    t_s: list[float] | None = Field(default=None, description="From time zero on.")
    values: list[float | None] | None = None
    value: Cell = None
    note: str | None = None


class Edr(BaseModel):
    """What an event data recorder would have kept."""

    regulation: str
    accident_id: str
    vehicle_id: str
    time_zero: Time
    time_zero_by: str
    end_of_event_s: float | None
    trigger_threshold_reached: bool = Field(description="8 km/h within 150 ms.")
    clipped: bool
    complete_file: bool
    evidence_sha256: str
    elements: list[EdrElement]


class MsdControl(BaseModel):
    """Control block."""

    automaticActivation: bool  # noqa: N815  (all names are EN 15722's)
    testCall: bool  # noqa: N815
    positionCanBeTrusted: bool = Field(description="Within 150 m with 95 %.")  # noqa: N815
    vehicleType: str  # noqa: N815


class MsdVin(BaseModel):
    """Vehicle identification number in its parts."""

    isowmi: str
    isovds: str
    isovisModelyear: str  # noqa: N815
    isovisSeqPlant: str  # noqa: N815


class MsdLocation(BaseModel):
    """Milliarcseconds; 2147483647 while unknown."""

    positionLatitude: int  # noqa: N815
    positionLongitude: int  # noqa: N815


class MsdDelta(BaseModel):
    """Steps of 100 milliarcseconds, north and east."""

    latitudeDelta: Annotated[int, Field(ge=-512, le=511)]  # noqa: N815
    longitudeDelta: Annotated[int, Field(ge=-512, le=511)]  # noqa: N815


class MsdStructure(BaseModel):
    """The minimum set of data."""

    messageIdentifier: Annotated[int, Field(ge=1, le=255)]  # noqa: N815
    control: MsdControl
    vehicleIdentificationNumber: MsdVin | None  # noqa: N815
    vehiclePropulsionStorageType: dict[str, bool] | None  # noqa: N815
    timestamp: int = Field(description="Seconds since 1970, UTC.")
    vehicleLocation: MsdLocation  # noqa: N815
    vehicleDirection: int = Field(description="Steps of 2 degrees from north; 255 while unknown.")  # noqa: N815
    recentVehicleLocationN1: MsdDelta | None  # noqa: N815
    recentVehicleLocationN2: MsdDelta | None  # noqa: N815
    numberOfPassengers: int | None  # noqa: N815


class MsdBody(BaseModel):
    """The set and what goes with it."""

    msdStructure: MsdStructure  # noqa: N815
    optionalAdditionalData: dict[str, Any]  # noqa: N815


class Msd(BaseModel):
    """An eCall's minimum set of data (EN 15722) by its names and units; null is what is not known or not to be told."""

    msdVersion: int  # noqa: N815
    msd: MsdBody


class AuditEntry(BaseModel):
    """Who did what to what."""

    time: Time
    actor: str | None = Field(description="Id of the API key; null while auth is off.")
    action: str
    subject: str
    detail: dict[str, Any]


class AuditTrail(BaseModel):
    """Entries, newest first."""

    entries: list[AuditEntry]
    next_cursor: str | None
