"""Accidents as they are read: GeoJSON features at the place of the impact."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, Field

from core.accident.events import Severity
from schemas.geojson import Link, Point
from schemas.model import VehicleId
from schemas.times import Time


class AccidentProperties(BaseModel):
    """What is known of an accident."""

    vehicle_id: VehicleId
    trip_id: str | None
    time: Time = Field(description="Start of the impact.")
    decided_at: Time = Field(description="The sample at which it was decided.")
    received_at: Time = Field(description="When the packet that decided it came in.")
    stored_at: Time
    status: str
    severity: Severity
    confidence: float = Field(ge=0, le=1)
    sd_n_m: float | None = Field(description="Standard deviation of the place to the north; likewise east.")
    sd_e_m: float | None
    cov_ne_m2: float | None = Field(description="Covariance of the place's north and east errors.")
    heading_deg: float | None
    mode: Literal["aligning", "aided", "coasting"] = Field(description="How the place was known; coasting: no GNSS.")
    detector: str
    delta_v_mps: float = Field(description="Change of the horizontal velocity.")
    delta_v_sd_mps: float
    delta_v_b_mps: tuple[float, float] = Field(description="The same, forward and right.")
    pdof_deg: float = Field(description="Where the force came from, clockwise seen from above; 0 is the front.")
    peak_mps2: float
    duration_s: float
    clipped: bool = Field(description="The accelerometer read its full scale, so the peak is a lower bound.")
    speed_before_mps: float | None
    paper_agrees: bool = Field(description="Whether the published fixed-threshold rule finds this accident too.")


class AccidentFeature(BaseModel):
    """One accident."""

    type: Literal["Feature"]
    id: str
    geometry: Point | None = Field(description="Place of the impact; null where the box never had a fix.")
    properties: AccidentProperties


class AccidentCollection(BaseModel):
    """A page of accidents, newest first."""

    type: Literal["FeatureCollection"]
    features: list[AccidentFeature]
    links: list[Link] = Field(description="rel next: the page after this one.")
    numberReturned: int  # noqa: N815  (OGC API Features names it so)
