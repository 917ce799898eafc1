"""Trips and their tracks as they are read."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, Field

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


class TripList(Model):
    """A page of trips, newest first."""

    trips: list[Trip]
    next_cursor: str | None = Field(description="Give it as cursor for the page after this one; null at the end.")


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
