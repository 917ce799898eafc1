"""A user's own districts: named polygons from GeoJSON or CSV, in place of the map's administrative areas."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import shapely
from shapely.errors import ShapelyError
from shapely.geometry.base import BaseGeometry

from service.errors import UsageError
from service.roads.districts import Districts

_EXPECTED: Final = (
    "expected GeoJSON features with a property 'name', or CSV with columns name and wkt, of polygons in degrees"
)
_AREAS: Final = ("Polygon", "MultiPolygon")


def read_districts(path: Path) -> Districts:
    """The polygons of a file; several of one name are one district. Raises UsageError that names the bad one."""
    try:
        text = path.read_text("utf-8-sig")
    except OSError as error:
        raise UsageError(f"{path}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise UsageError(f"{path}: is no UTF-8 text; {_EXPECTED}") from error
    found = [_checked(path, *one) for one in (_of_csv(path, text) if _is_csv(path) else _of_geojson(path, text))]
    if not found:
        raise UsageError(f"{path}: no district; {_EXPECTED}")
    return Districts(tuple(name for name, _ in found), tuple(area for _, area in found))


def _is_csv(path: Path) -> bool:
    return path.suffix.lower() == ".csv"


def _of_csv(path: Path, text: str) -> Iterator[tuple[str, str, BaseGeometry | None]]:
    rows = csv.DictReader(io.StringIO(text))
    if missing := {"name", "wkt"} - set(rows.fieldnames or ()):
        raise UsageError(f"{path}: no column {' or '.join(sorted(missing))}; {_EXPECTED}")
    csv.field_size_limit(len(text) + 1)
    for row in rows:
        try:
            area = shapely.from_wkt(row["wkt"] or "")
        except ShapelyError:
            area = None
        yield f"line {rows.line_num}", row["name"] or "", area


def _of_geojson(path: Path, text: str) -> Iterator[tuple[str, str, BaseGeometry | None]]:
    try:
        features: list[Any] = json.loads(text)["features"]
        told = [(one["properties"] or {}, one["geometry"]) for one in features]
    except (ValueError, KeyError, TypeError) as error:
        raise UsageError(f"{path}: is no GeoJSON of features; {_EXPECTED}") from error
    for number, (properties, geometry) in enumerate(told, 1):
        try:
            area = shapely.from_geojson(json.dumps(geometry))
        except ShapelyError:
            area = None
        yield f"feature {number}", str(properties.get("name") or ""), area


def _checked(path: Path, where: str, name: str, area: BaseGeometry | None) -> tuple[str, BaseGeometry]:
    if not name.strip():
        raise UsageError(f"{path}, {where}: no name; {_EXPECTED}")
    if area is None or area.geom_type not in _AREAS or area.is_empty:
        raise UsageError(f"{path}, {where} ({name}): no polygon; {_EXPECTED}")
    west, south, east, north = area.bounds
    if not (-180.0 <= west <= east <= 180.0 and -90.0 <= south <= north <= 90.0):
        raise UsageError(
            f"{path}, {where} ({name}): reaches from {west:g} {south:g} to {east:g} {north:g}; expected longitude and"
            " latitude in degrees (WGS-84), in this order"
        )
    if not area.is_valid:
        raise UsageError(
            f"{path}, {where} ({name}): {shapely.is_valid_reason(area)}; expected a line that never crosses itself"
        )
    shapely.prepare(area)
    return name.strip(), area
