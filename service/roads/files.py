"""The roads under a drive as a file: CSV, a row a position, or GeoJSON, a line a stretch of one way."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np

from service.errors import UsageError
from service.recordings.csv_tables import format_table, gzip_bytes, time_column
from service.recordings.files import write_whole
from service.roads.drives import Positions
from service.roads.folder import ATTRIBUTION
from service.roads.protocol import NO_WAY, Certainty, MatchedPoints, RoadClass, RoadPlace, Surroundings


def check_ending(path: Path) -> None:
    """Raise UsageError unless the file's ending names a format that can be written here."""
    _ending(path)


def write_matched(path: Path, positions: Positions, matched: MatchedPoints, start_t_ns: int) -> None:
    """Write the file whole or not at all; raises UsageError."""
    write_whole(path, _WRITERS[_ending(path)](positions, matched, start_t_ns))


def _csv(positions: Positions, matched: MatchedPoints, start_t_ns: int) -> bytes:
    n = range(len(matched))
    return format_table(
        {
            "t_s": time_column(positions.t_ns, start_t_ns),
            "lat_deg": (positions.lat_deg, "%.8f"),
            "lon_deg": (positions.lon_deg, "%.8f"),
            "sd_m": (positions.sd_m, "%.2f"),
            "way_id": ([str(one) if one != NO_WAY else "" for one in matched.way_id.tolist()], "%s"),
            "street": ([_cell(matched.street(i)) for i in n], "%s"),
            "road_class": ([RoadClass(one).name.lower() for one in matched.road_class.tolist()], "%s"),
            "surroundings": ([Surroundings(one).name.lower() for one in matched.surroundings.tolist()], "%s"),
            "limit_kmh": (matched.limit_kmh, "%.4g"),
            "limit_certainty": ([Certainty(one).name.lower() for one in matched.limit_certainty.tolist()], "%s"),
            "district": ([_cell(matched.district(i)) for i in n], "%s"),
            "tunnel": (matched.tunnel.astype(int), "%d"),
            "road_lat_deg": (matched.lat_deg, "%.8f"),
            "road_lon_deg": (matched.lon_deg, "%.8f"),
            "distance_m": (matched.distance_m, "%.2f"),
            "confidence": (matched.confidence, "%.3f"),
        }
    ).encode()


def _cell(text: str | None) -> str:
    """Text of a cell (RFC 4180)."""
    if text is None:
        return ""
    return '"' + text.replace('"', '""') + '"' if any(one in text for one in ',"\n') else text


def _geojson(positions: Positions, matched: MatchedPoints, start_t_ns: int) -> bytes:
    edges = np.flatnonzero(np.diff(matched.way_id, prepend=matched.way_id[:1] - 1, append=matched.way_id[-1:] - 1))
    features: list[dict[str, Any]] = []
    for first, last in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        if matched.way_id[first] == NO_WAY:
            continue
        # On to the next way's first position, so that a drive is one line, where it goes on there.
        end = last + 1 if last < len(matched) and matched.way_id[last] != NO_WAY else last
        line = np.round(np.column_stack([matched.lon_deg, matched.lat_deg])[first:end], 7).tolist()
        t_s = (positions.t_ns[[first, last - 1]] - start_t_ns) / 1e9
        facts = RoadPlace.of(matched, first).json() | {
            "from_t_s": round(float(t_s[0]), 3),
            "to_t_s": round(float(t_s[1]), 3),
            "distance_m": round(float(np.nanmax(matched.distance_m[first:last])), 2),
            "confidence": round(float(matched.confidence[first:last].mean()), 3),
        }
        geometry = {"type": "LineString", "coordinates": line if len(line) > 1 else line * 2}
        features.append({"type": "Feature", "geometry": geometry, "properties": facts})
    document = {"type": "FeatureCollection", "attribution": ATTRIBUTION, "features": features}
    return (json.dumps(document, ensure_ascii=False, allow_nan=False) + "\n").encode()


_WRITERS: Final[dict[str, Callable[[Positions, MatchedPoints, int], bytes]]] = {
    ".geojson": _geojson,
    ".csv": _csv,
    ".csv.gz": lambda *arguments: gzip_bytes(_csv(*arguments).decode()),
}


def _ending(path: Path) -> str:
    for ending in _WRITERS:
        if path.name.lower().endswith(ending):
            return ending
    raise UsageError(f"{path}: unknown file ending; expected one of {', '.join(_WRITERS)}")
