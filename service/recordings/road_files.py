"""A road's line and profile as a file: GeoJSON or CSV, by the file's ending."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from core.navigation.road_profile import RoadLine
from service.errors import UsageError
from service.recordings.csv_tables import format_table, gzip_bytes
from service.recordings.files import write_whole

_COLUMNS: Final[tuple[tuple[str, Callable[[RoadLine], npt.NDArray[Any]], str], ...]] = (
    # column and property in the file, its values, format
    ("chainage_m", lambda line: line.chainage_m, "%.1f"),
    ("lat_deg", lambda line: np.degrees(line.lat_rad), "%.9f"),
    ("lon_deg", lambda line: np.degrees(line.lon_rad), "%.9f"),
    ("alt_ellipsoid_m", lambda line: line.alt_m, "%.3f"),
    ("grade_percent", lambda line: 100.0 * np.tan(line.grade_rad), "%.3f"),
    ("grade_rad", lambda line: line.grade_rad, "%.6f"),
    ("bank_percent", lambda line: 100.0 * np.tan(line.bank_rad), "%.3f"),
    ("bank_rad", lambda line: line.bank_rad, "%.6f"),
    ("sd_n_m", lambda line: line.sd_n_m, "%.4f"),
    ("sd_e_m", lambda line: line.sd_e_m, "%.4f"),
    ("sd_alt_m", lambda line: line.sd_alt_m, "%.4f"),
    ("sd_grade_rad", lambda line: line.sd_grade_rad, "%.6f"),
    ("sd_bank_rad", lambda line: line.sd_bank_rad, "%.6f"),
    ("passes", lambda line: line.passes, "%d"),
    ("passes_opposite", lambda line: line.opposite, "%d"),
)


def check_road_ending(path: Path) -> None:
    """Raise UsageError unless the file's ending names a format that can be written here."""
    _ending(path)


def write_road(path: Path, lines: Sequence[RoadLine], name: str) -> None:
    """Write a road whole or not at all; raises UsageError."""
    write_whole(path, _WRITERS[_ending(path)](lines, name))


def _csv(lines: Sequence[RoadLine], name: str) -> bytes:
    """A row a point; ``line`` counts the lines from 1."""
    columns: dict[str, Any] = {
        "line": (np.repeat(np.arange(1, len(lines) + 1), [len(one.lat_rad) for one in lines]), "%d")
    }
    for column, values, style in _COLUMNS:
        columns[column] = (np.concatenate([np.empty(0), *(values(one) for one in lines)]), style)
    return format_table(columns).encode()


def _geojson(lines: Sequence[RoadLine], name: str) -> bytes:
    """For each line a LineString in three dimensions, then its points with the profile as properties (RFC 7946)."""
    features = []
    for number, line in enumerate(lines, start=1):
        table = {column: [style % value for value in values(line).tolist()] for column, values, style in _COLUMNS}
        known = {column: [json.loads(text) for text in texts] for column, texts in table.items()}
        places = [
            list(place) for place in zip(known["lon_deg"], known["lat_deg"], known["alt_ellipsoid_m"], strict=True)
        ]
        properties = {"name": name, "line": number, "length_m": known["chainage_m"][-1], "points": len(places)}
        features.append(_feature("LineString", places, properties))
        kept = [column for column in known if column not in ("lat_deg", "lon_deg", "alt_ellipsoid_m")]
        for index, place in enumerate(places):
            features.append(
                _feature("Point", place, {"line": number} | {column: known[column][index] for column in kept})
            )
    return (json.dumps({"type": "FeatureCollection", "features": features}, allow_nan=False) + "\n").encode()


def _feature(kind: str, coordinates: list[Any], properties: dict[str, Any]) -> dict[str, Any]:
    return {"type": "Feature", "geometry": {"type": kind, "coordinates": coordinates}, "properties": properties}


_WRITERS: Final[dict[str, Callable[[Sequence[RoadLine], str], bytes]]] = {
    ".geojson": _geojson,
    ".csv": _csv,
    ".csv.gz": lambda lines, name: gzip_bytes(_csv(lines, name).decode()),
}


def _ending(path: Path) -> str:
    for ending in _WRITERS:
        if path.name.lower().endswith(ending):
            return ending
    raise UsageError(f"{path}: unknown file ending; expected one of {', '.join(_WRITERS)}")
