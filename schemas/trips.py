"""Trips and their tracks as they are read."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, Field

from schemas.accidents import Note
from schemas.geojson import LineString, Point
from schemas.model import Model, VehicleId
from schemas.times import Time


class Place(Model):
    """A place on the ground."""

    lat_deg: float
    lon_deg: float


class Trip(Model):
    """One trip, as far as it is known."""

    id: str
    vehicle_id: VehicleId
    start_at: Time
    end_at: Time
    ended: bool = Field(description="False while the trip may still go on.")
    start: Place | None = Field(description="Null for keys without positions:read.")
    end: Place | None = Field(description="Null for keys without positions:read.")
    distance_m: float = Field(description="Along the fused track.")
    moving_s: float
    coasting_s: float = Field(description="Time without GNSS.")
    max_speed_mps: float
    assessed: bool = Field(description="Whether its risk is known, as it is now; it takes some seconds after its end.")
    road_lookup: Literal["done", "retrying", "failed"] | None = Field(
        description="Whether the roads under it were looked up: retrying where that failed in part and is done again, "
        "failed where these stay unknown, so that coverage is lower; null while not assessed."
    )
    night_share: float | None = Field(
        default=None,
        description="Of the distance, from dusk to dawn by the sun; null while not assessed, and in lists.",
    )


class TripList(Model):
    """A page of trips, newest first."""

    trips: list[Trip]
    next_cursor: str | None = Field(description="Give it as cursor for the page after this one; null at the end.")


class MassesOverTime(BaseModel):
    """Mass of each proposition at each instant; they sum to 1."""

    LR: list[float]
    MR: list[float]
    LR_MR: list[float] = Field(alias="LR|MR")
    HR: list[float]
    LR_HR: list[float] = Field(alias="LR|HR")
    MR_HR: list[float] = Field(alias="MR|HR")
    LR_MR_HR: list[float] = Field(alias="LR|MR|HR")


class TripRisk(BaseModel):
    """A trip's risk over time; each list has one value an instant. No places: a key without positions:read sees it."""

    trip_id: str
    vehicle_id: VehicleId
    model_sha256: str = Field(description="What it was assessed by.")
    assessed_at: Time
    times: list[Time]
    mean: dict[str, float] = Field(description="Mean mass by proposition, over all seconds of the trip.")
    fused: MassesOverTime
    entities: dict[str, MassesOverTime] = Field(description="driver, environment, vehicle: those of which is known.")
    conflict: list[float] = Field(description="Mass between the entities that the rule redistributed.")
    coverage: dict[str, list[float]] = Field(description="By source, from 0 to 1: how far the instant rests on it.")
    speed_kmh: list[float | None] = Field(description="Null where it is not known.")
    limit_kmh: list[float | None] = Field(description="Null where it is not known, or there is none.")
    limit_certainty: list[Literal["unknown", "assumed", "tagged"]] = Field(
        description="tagged: the map says it; assumed: by country and class of road."
    )


class Manoeuvre(BaseModel):
    """One manoeuvre: what was done, how hard, and whether it counts."""

    id: str
    vehicle_id: VehicleId
    kind: Literal["braking", "acceleration", "cornering", "lane_change"]
    start_at: Time
    peak_at: Time
    end_at: Time
    duration_s: float
    peak_mps2: float
    direction: Literal["left", "right"] | None
    aggressive: bool = Field(description="Beyond the harsh threshold: always, but for ordinary changes of lane.")
    counted: bool = Field(description="False for a repeat within a minute, and for taking up speed after braking.")
    recovery: bool
    excused: Literal["accident", "hazard", "reviewer"] | None = Field(
        description="Why it does not count against the driver: its own accident, a hazard (another vehicle's accident "
        "ahead, a pothole that was struck), or a reviewer's word."
    )
    excused_by: str | None = Field(
        description="The accident, or of a pothole the candidate, that explains it; null for keys without "
        "positions:read, as it tells where the vehicle was."
    )
    verdict: Literal["confirmed", "defensive", "false"] | None = Field(description="A reviewer's; null without one.")
    speed_before_mps: float | None
    speed_at_peak_mps: float | None
    speed_after_mps: float | None
    across_mps2: float | None = Field(
        description="Acceleration in the other axis at the peak: to the right, or forward."
    )
    radius_m: float | None = Field(description="Null straight ahead, and where it is not known.")
    heading_change_deg: float | None
    place: Place | None = Field(description="Null for keys without positions:read, and once the track is not kept.")
    sd_n_m: float | None
    sd_e_m: float | None
    cov_ne_m2: float | None


class ManoeuvreList(BaseModel):
    """A trip's manoeuvres, in their order."""

    manoeuvres: list[Manoeuvre]


class NewManoeuvreReview(Model):
    """A person's verdict on a manoeuvre; the last one counts."""

    verdict: Literal["confirmed", "defensive", "false"]
    note: Note = ""


class ManoeuvreReview(Model):
    """A verdict that was given."""

    id: str
    verdict: Literal["confirmed", "defensive", "false"]
    note: str
    reviewer: str | None = Field(description="Id of the API key; null while auth is off.")
    before: str = Field(description="The verdict before it, else why it was excused, else none.")
    after: str
    reviewed_at: Time


class ManoeuvreReviewList(Model):
    """Verdicts, newest first."""

    reviews: list[ManoeuvreReview]


class TrackProperties(BaseModel):
    """Figures of a track; each list has one value a position of the geometry."""

    trip_id: str
    vehicle_id: VehicleId
    times: list[Time]
    speed_mps: list[float]
    yaw_deg: list[float | None]
    sd_n_m: list[float] = Field(description="Standard deviation of the position to the north; likewise east and down.")
    sd_e_m: list[float]
    sd_d_m: list[float]
    cov_ne_m2: list[float]
    mode: list[Literal["aligning", "aided", "coasting"]]


class TrackFeature(BaseModel):
    """A trip's track: a line, a point where it has one position only, null where it has none."""

    type: Literal["Feature"]
    id: str
    geometry: LineString | Point | None
    properties: TrackProperties


class TrackCollection(BaseModel):
    """GeoJSON with the track as its one feature."""

    type: Literal["FeatureCollection"]
    features: list[TrackFeature]
