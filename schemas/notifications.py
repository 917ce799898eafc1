"""What a webhook carries: event types, the bodies of their ``data`` and the message around them."""

from __future__ import annotations

import json
from collections.abc import Mapping
from datetime import UTC, datetime
from enum import StrEnum
from typing import Any, Final

from pydantic import BaseModel, ConfigDict, Field

from schemas.impacts import ImpactFigures

MAX_MESSAGE_BYTES: Final = 20_000
"""Receivers may rely on a message being smaller than this; evidence is fetched, not pushed."""


class EventType(StrEnum):
    """What an endpoint can ask for; ``ping`` comes only when it is tested."""

    ACCIDENT_DETECTED = "accident.detected"
    ACCIDENT_UPDATED = "accident.updated"
    ACCIDENT_RETRACTED = "accident.retracted"
    TRIP_COMPLETED = "trip.completed"
    CALIBRATION_CHANGED = "calibration.changed"
    CALIBRATION_DRIFTED = "calibration.drifted"
    SCORE_UPDATED = "score.updated"
    VEHICLE_OFFLINE = "vehicle.offline"
    PING = "ping"


class EventBody(BaseModel):
    """Base of the ``data`` of events."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class AccidentBody(ImpactFigures, EventBody):
    """Data of ``accident.*``: enough to act on; the evidence is at ``GET /v1/accidents/{accident_id}``.

    Told again as more is known. Messages may come in any order: of two with the same ``accident_id`` the higher
    ``revision`` is the newer, and of one revision that with a ``review_id``.
    """

    accident_id: str
    vehicle_id: str
    trip_id: str | None
    t_ns: int = Field(description="Start of the first impact, UTC")
    revision: int
    kind: str = Field(description="collision, parked_hit or rollover")
    status: str = Field(description="suspected, confirmed, retracted, or false by a reviewer")
    severity: str = Field(description="low_speed, severe or airbag")
    confidence: float = Field(ge=0, le=1)
    street: str | None
    lat_deg: float | None = Field(description="Place of the impact; null where the box never had a fix")
    lon_deg: float | None
    alt_m: float | None
    sd_n_m: float | None = Field(description="Standard deviation of the position to the north")
    sd_e_m: float | None = Field(description="Standard deviation of the position to the east")
    cov_ne_m2: float | None = Field(description="Covariance of the position's north and east errors")
    heading_deg: float | None
    mode: str = Field(description="How the position was known: aided, or coasting without GNSS")
    review_id: str | None = Field(default=None, description="The review that brought this; null where more was felt")


class TripBody(EventBody):
    """Data of ``trip.completed``: what a key without ``positions:read`` may know of a trip."""

    trip_id: str
    vehicle_id: str
    start_ns: int
    end_ns: int
    distance_m: float
    moving_s: float
    coasting_s: float
    max_speed_mps: float


class ScoreFigures(EventBody):
    """A score as it is told; its reasons are at ``GET /v1/vehicles/{vehicle_id}/scores/{product}``."""

    score: float | None = Field(description="0 to 100; null where nothing was driven")
    interval95: tuple[float, float] | None
    relativity: float | None = Field(description="Expected claims over those of the portfolio's mean driver")


class ScoreBody(EventBody):
    """Data of ``score.updated``: the scores of the year up to a vehicle's last trip, as they are now."""

    vehicle_id: str
    trip_id: str | None = Field(description="The trip that changed them, or whose record was changed")
    cause: str = Field(description="trip: one more; rescored: a review, an accident or later data changed one; erasure")
    from_ns: int = Field(description="Begin of the period")
    to_ns: int = Field(description="End of the period")
    scores: dict[str, ScoreFigures] = Field(description="By product: payd, phyd, pwyd")
    model_version: str
    model_sha256: str


class CalibrationChangedBody(EventBody):
    """Data of ``calibration.changed``: somebody gave a vehicle another; ``GET …/calibrations`` has it."""

    vehicle_id: str
    calibration_version: int
    origin: str = Field(description="registration, put, or run: accepted from a calibration run")
    valid_from_ns: int = Field(description="0: ever since")
    run_id: str | None
    created_by: str | None = Field(description="Id of the API key")


class CalibrationDriftBody(EventBody):
    """Data of ``calibration.drifted``: on a trip one axis showed another bias than it was known to have."""

    vehicle_id: str
    calibration_version: int = Field(description="Of the calibration that holds from now on, with the new bias")
    t_ns: int = Field(description="From when on it holds, UTC")
    sensor: str = Field(description="accelerometer (m/s²) or gyroscope (rad/s)")
    axis: str = Field(description="x, y or z of the sensor")
    was: float
    is_: float = Field(serialization_alias="is")
    sd: float = Field(description="Standard deviation of the difference")


class PingBody(EventBody):
    """Data of ``ping``."""

    endpoint_id: str
    message: str = "A test from telefuse: this endpoint is set up to receive events."


def rfc3339(t_ns: int) -> str:
    """A UTC time to the microsecond, as ``2026-01-31T12:00:00.000000Z``."""
    moment = datetime.fromtimestamp(t_ns // 1_000_000_000, UTC).replace(microsecond=t_ns % 1_000_000_000 // 1000)
    return moment.isoformat(timespec="microseconds").replace("+00:00", "Z")


def message(event_type: str, t_ns: int, data: Mapping[str, Any]) -> bytes:
    """The request body, the same bytes at each attempt; ValueError where it is too large or not JSON (NaN)."""
    content = {"type": event_type, "timestamp": rfc3339(t_ns), "data": data}
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    encoded = text.encode()
    if len(encoded) >= MAX_MESSAGE_BYTES:
        raise ValueError(f"{event_type} is {len(encoded)} bytes; a webhook message is below {MAX_MESSAGE_BYTES}")
    return encoded
