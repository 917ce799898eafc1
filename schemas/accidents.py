"""Accidents, and what was taken for none, as they are read: GeoJSON features at the place of the impact."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, Field

from core.accident.events import Kind, NoAccident, Severity
from schemas.geojson import Link, Point
from schemas.impacts import ImpactFigures
from schemas.model import Model, VehicleId
from schemas.times import Time

AccidentStatus = Literal["suspected", "confirmed", "retracted", "false"]
"""``retracted`` by what followed, ``false`` by a reviewer; ``confirmed`` by either."""

EvidenceStatus = Literal["pending", "partial", "complete", "final", "failed"]


class Placed(BaseModel):
    """How well the place is known."""

    sd_n_m: float | None = Field(description="Standard deviation of the place to the north; likewise east.")
    sd_e_m: float | None
    cov_ne_m2: float | None = Field(description="Covariance of the place's north and east errors.")
    heading_deg: float | None
    mode: Literal["aligning", "aided", "coasting"] = Field(description="How the place was known; coasting: no GNSS.")


class AccidentProperties(ImpactFigures, Placed):
    """What is known of an accident."""

    vehicle_id: VehicleId
    trip_id: str | None
    time: Time = Field(description="Start of the first impact.")
    decided_at: Time = Field(description="The sample at which this much was known.")
    received_at: Time = Field(description="When the packet came in by which it was first suspected.")
    stored_at: Time = Field(description="When that was stored.")
    revision: int = Field(description="Counts up as more is known; 0 is the first suspicion.")
    kind: Kind
    status: AccidentStatus
    verdict: Literal["confirmed", "false"] | None = Field(description="A reviewer's, who has the last word.")
    severity: Severity
    confidence: float = Field(ge=0, le=1)
    street: str | None = Field(description="Where it was on the road network; null where no roads are loaded.")
    evidence: EvidenceStatus | None = Field(description="How far its evidence is; null for accidents without any.")


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


class CandidateProperties(Placed):
    """What felt like an accident, and why it was judged to be none."""

    vehicle_id: VehicleId
    time: Time = Field(description="Start of the shock.")
    decided_at: Time = Field(description="The sample at which it was judged.")
    received_at: Time
    stored_at: Time
    reason: NoAccident
    probability: float = Field(ge=0, le=1, description="That it was an accident.")
    verdict: Literal["accident", "no_accident"] | None = Field(description="A reviewer's; null without one.")
    delta_v_mps: float | None = Field(description="Change of the horizontal velocity over the shock.")
    vertical_mps: float | None
    peak_mps2: float | None
    duration_s: float | None
    speed_before_mps: float | None
    paper_agrees: bool = Field(description="Whether the published fixed-threshold rule calls it an accident.")


class CandidateFeature(BaseModel):
    """One candidate."""

    type: Literal["Feature"]
    id: str
    geometry: Point | None
    properties: CandidateProperties


class CandidateCollection(BaseModel):
    """A page of candidates, newest first."""

    type: Literal["FeatureCollection"]
    features: list[CandidateFeature]
    links: list[Link] = Field(description="rel next: the page after this one.")
    numberReturned: int  # noqa: N815


Note = Annotated[str, Field(max_length=4000, pattern=r"^[^\u0000]*$")]


class NewReview(Model):
    """A person's verdict on an accident; the last one counts."""

    verdict: Literal["confirmed", "false"]
    note: Note = ""


class NewCandidateReview(Model):
    """A person's verdict on what was taken for none; the last one counts."""

    verdict: Literal["accident", "no_accident"]
    note: Note = ""


class Review(Model):
    """A verdict that was given."""

    id: str
    verdict: Literal["confirmed", "false", "accident", "no_accident"]
    note: str
    reviewer: str | None = Field(description="Id of the API key; null while auth is off.")
    before: str = Field(description="Status before it; of a candidate, what it was taken for.")
    after: str
    reviewed_at: Time
    accident_id: str | None = Field(description="The accident that it is about, or that a candidate became.")


class ReviewList(Model):
    """Verdicts, newest first."""

    reviews: list[Review]
