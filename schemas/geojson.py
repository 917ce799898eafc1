"""GeoJSON (RFC 7946) as this service writes it: longitude first, WGS-84, heights above the ellipsoid."""

from __future__ import annotations

from typing import Any, Final, Literal

from pydantic import BaseModel, Field

GEOJSON_MEDIA_TYPE: Final = "application/geo+json"

Position = tuple[float, float, float]
"""Longitude, latitude, height: degrees, degrees, metres."""


class Point(BaseModel):
    """One place."""

    type: Literal["Point"] = "Point"
    coordinates: Position


class LineString(BaseModel):
    """A way through two places or more."""

    type: Literal["LineString"] = "LineString"
    coordinates: list[Position] = Field(min_length=2)


class Link(BaseModel):
    """Where to go on from here."""

    rel: str
    href: str
    type: str = GEOJSON_MEDIA_TYPE


def feature(feature_id: str, geometry: dict[str, Any] | None, properties: dict[str, Any]) -> dict[str, Any]:
    """A feature, ready for JSON."""
    return {"type": "Feature", "id": feature_id, "geometry": geometry, "properties": properties}


def point(lon_deg: float, lat_deg: float, alt_m: float) -> dict[str, Any]:
    """A point to 1e-8 degrees (1 mm) and 1 mm."""
    return {"type": "Point", "coordinates": [round(lon_deg, 8), round(lat_deg, 8), round(alt_m, 3)]}


def path(positions: list[tuple[float, float, float]]) -> dict[str, Any] | None:
    """A way through (longitude, latitude, height): a line, a point where there is one only, null for none."""
    points = [point(*position) for position in positions]
    if len(points) < 2:
        return points[0] if points else None
    return {"type": "LineString", "coordinates": [each["coordinates"] for each in points]}
