"""What models of the border share: strictness, numbers with bounds, names."""

from __future__ import annotations

from typing import Annotated, Final, TypeVar

from pydantic import BaseModel, ConfigDict, Field, StringConstraints

VEHICLE_ID_PATTERN: Final = r"^[A-Za-z0-9][A-Za-z0-9._-]{0,127}$"
"""``schemas.keys.is_name`` as a pattern, for the OpenAPI document; a test holds the two together."""

VehicleId = Annotated[str, StringConstraints(pattern=VEHICLE_ID_PATTERN)]

Finite = Annotated[float, Field(allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]

_Figure = TypeVar("_Figure")
PerAxis = tuple[_Figure, _Figure, _Figure]
"""The sensor's x, y, z."""


class Model(BaseModel):
    """Base of what callers send and get: strict about unknown fields, immutable."""

    model_config = ConfigDict(extra="forbid", frozen=True)
