"""What a tenant rates by, as it is listed and read."""

from __future__ import annotations

from pydantic import Field

from schemas.model import Model
from schemas.times import Time


class RatingVersion(Model):
    """One version of a part; the newest holds."""

    part: str = Field(description="risk-tables, score-model, tariff or places")
    version: int = Field(description="0: as shipped, nothing of one's own was ever put")
    own: bool = Field(description="false: the one that is shipped")
    sha256: str = Field(description="Of the text")
    created_at: Time | None
    created_by: str | None = Field(description="Id of the API key")


class RatingParts(Model):
    """What holds of each part."""

    parts: list[RatingVersion]


class RatingHistory(Model):
    """Versions of a part, newest first."""

    versions: list[RatingVersion]
    next_cursor: str | None


class PlacesBuild(Model):
    """What the risk of places was worked out from."""

    rating: RatingVersion
    vehicles: int
    distance_m: float
    cells: int
    accidents: int
    accidents_left_out: int = Field(description="In cells where no trip was recorded, or of unknown place.")
