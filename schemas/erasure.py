"""Requests to erase what is stored of a vehicle."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import ConfigDict, Field, field_validator, model_validator

from schemas.model import Model, VehicleId
from schemas.times import Time, parse_time

Text = Annotated[str, Field(max_length=4000, pattern=r"^[^\u0000]*$")]


class NewErasure(Model):
    """What is to be erased: of a time, or all of it."""

    vehicle_id: VehicleId
    from_: str | None = Field(
        default=None,
        alias="from",
        description="From this time on, RFC 3339; a trip that lies partly in the time goes whole.",
        json_schema_extra={"format": "date-time"},
    )
    to: str | None = Field(
        default=None, description="Up to this time, which stays.", json_schema_extra={"format": "date-time"}
    )
    reason: Text = Field(description="Kept with the request: say nothing in it that is to be erased.")
    unregister: bool = Field(default=False, description="Whether the vehicle's registration goes, too.")

    @field_validator("from_", "to")
    @classmethod
    def _check_time(cls, text: str | None) -> str | None:
        if text is not None:
            parse_time(text)
        return text

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.unregister and (self.from_ is not None or self.to is not None):
            raise ValueError("unregister goes with all of the vehicle's data; expected neither from nor to beside it")
        if self.from_ns is not None and self.to_ns is not None and self.from_ns >= self.to_ns:
            raise ValueError("'to' is not after 'from'; expected a time that has a length")
        return self

    @property
    def from_ns(self) -> int | None:
        """UTC nanoseconds."""
        return None if self.from_ is None else parse_time(self.from_)

    @property
    def to_ns(self) -> int | None:
        """UTC nanoseconds."""
        return None if self.to is None else parse_time(self.to)


class Erasure(Model):
    """What was erased."""

    model_config = ConfigDict(serialize_by_alias=True)

    id: str
    vehicle_id: VehicleId
    from_: Time | None = Field(serialization_alias="from", description="With the trips that lay partly in the time.")
    to: Time | None
    unregister: bool
    reason: str
    requested_by: str | None = Field(description="Id of the API key; null while auth is off.")
    erased_at: Time
    removed: dict[str, int] = Field(description="Rows by table; sessions: whether the vehicle's began anew.")
