"""A fused track as a file: CSV, GeoJSON, GPX, KML or Parquet, by the file's ending."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal
from xml.sax.saxutils import escape

import numpy as np
import numpy.typing as npt

from core.measurements import FloatArray, TimeArray
from core.navigation.track import TRACK, Mode, Track
from service.errors import UsageError
from service.recordings.csv_tables import Share, format_table, gzip_bytes, time_column, untold
from service.recordings.files import write_whole

_COLUMNS: Final = (
    # column in the file, column of a track row, format in CSV
    ("lat_deg", "lat_rad", "%.10f"),
    ("lon_deg", "lon_rad", "%.10f"),
    ("alt_ellipsoid_m", "alt_m", "%.4f"),
    ("vn_mps", "vn_mps", "%.5f"),
    ("ve_mps", "ve_mps", "%.5f"),
    ("vd_mps", "vd_mps", "%.5f"),
    ("roll_deg", "roll_rad", "%.5f"),
    ("pitch_deg", "pitch_rad", "%.5f"),
    ("yaw_deg", "yaw_rad", "%.5f"),
    ("sd_n_m", "sd_n_m", "%.4f"),
    ("sd_e_m", "sd_e_m", "%.4f"),
    ("sd_d_m", "sd_d_m", "%.4f"),
    ("sd_yaw_deg", "sd_yaw_rad", "%.5f"),
    ("gnss_used", "gnss_used", "%.0f"),
)
_MODE_TEXT: Final = {mode.value: mode.name.lower() for mode in Mode}
_KML_COLOURS: Final = {Mode.ALIGNING: "ff888888", Mode.AIDED: "ffd07020", Mode.COASTING: "ff1060f0"}
"""aabbggrr: grey, blue, orange."""
_GPX_EAST_DEG: Final = 179.999999999
"""GPX 1.1 counts longitudes from -180 up to but without 180; this is 0.1 mm short of it."""
_NOT_XML: Final = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
HOLE_S: Final = 5.0
"""Rows further apart, and more than three times as far as usual, are not joined: the filter aligned anew in between."""


@dataclass(frozen=True, slots=True, eq=False)
class TrackFile:
    """What is written: the rows of a track, the zero of ``t_s``, a name to show, and what heights are above."""

    track: Track
    start_t_ns: int
    name: str
    heights_are_msl: bool = False

    def column(self, written: str, source: str) -> FloatArray:
        """A column in the unit of its name in the file."""
        values = self.track.column(source)
        if written == "lon_deg":
            return _wrapped_deg(values)
        return np.degrees(values) if written.endswith("_deg") else values

    @property
    def heights(self) -> str:
        """What heights are above, in words."""
        return f"heights above {'mean sea level' if self.heights_are_msl else 'the WGS-84 ellipsoid'}"

    def modes(self) -> list[str]:
        """The mode of each row as text."""
        return [_MODE_TEXT[int(value)] for value in self.track.column("mode")]


def check_ending(path: Path) -> None:
    """Raise UsageError unless the file's ending names a format that can be written here."""
    ending = _ending(path)
    if ending == ".parquet":
        _pyarrow()


def export_track(path: Path, content: TrackFile, progress: Share = untold) -> None:
    """Write a track whole or not at all; raises UsageError for an unknown ending or a place not writable."""
    write_whole(path, _WRITERS[_ending(path)](content, progress))


def _ending(path: Path) -> str:
    for ending in _WRITERS:
        if path.name.lower().endswith(ending):
            return ending
    raise UsageError(f"{path}: unknown file ending; expected one of {', '.join(_WRITERS)}")


def _csv(content: TrackFile, progress: Share) -> bytes:
    columns: dict[str, tuple[npt.ArrayLike, str]] = {"t_s": time_column(content.track.t_ns, content.start_t_ns)}
    for written, source, style in _COLUMNS:
        columns[written] = (content.column(written, source), style)
    columns["mode"] = (content.modes(), "%s")
    return format_table(columns, progress).encode()


def _csv_gz(content: TrackFile, progress: Share) -> bytes:
    return gzip_bytes(_csv(content, lambda share: progress(0.5 * share)).decode())


def _geojson(content: TrackFile, progress: Share) -> bytes:
    """A line for each stretch of one mode, with the time of every vertex (RFC 7946; ``coordTimes``)."""
    pieces = list(_pieces(content.track, progress))
    features = [
        {
            "type": "Feature",
            "geometry": {"type": "LineString", "coordinates": piece.lon_lat_alt},
            "properties": {
                "name": content.name,
                "mode": piece.mode.name.lower(),
                "heights": content.heights,
                "coordTimes": piece.times,
            },
        }
        for piece in pieces
    ]
    collection: dict[str, Any] = {"type": "FeatureCollection"}
    if pieces:
        collection["bbox"] = _bbox(pieces)
    return (json.dumps(collection | {"features": features}, allow_nan=False) + "\n").encode()


def _bbox(pieces: list[_Piece]) -> list[float]:
    """West, south, lowest, east, north, highest; west exceeds east across the antimeridian (RFC 7946, 5.2)."""
    rows = np.concatenate([piece.lon_lat_alt for piece in pieces])
    (west, south, low), (east, north, high) = rows.min(axis=0).tolist(), rows.max(axis=0).tolist()
    if east - west > 180.0:
        lon = rows[:, 0]
        west, east = float(lon[lon > 0.0].min()), float(lon[lon < 0.0].max())
    return [west, south, low, east, north, high]


def _gpx(content: TrackFile, progress: Share) -> bytes:
    """GPX 1.1, a segment for each stretch of one mode; longitudes are below 180 there."""
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        '<gpx version="1.1" creator="telefuse" xmlns="http://www.topografix.com/GPX/1/1">',
        f"<trk><name>{_xml(content.name)}</name><desc>{content.heights}</desc>",
    ]
    for piece in _pieces(content.track, progress):
        lines.append("<trkseg>")
        lines += [
            f'<trkpt lat="{lat:.9f}" lon="{min(lon, _GPX_EAST_DEG):.9f}">'
            f"<ele>{alt:.3f}</ele><time>{time}</time></trkpt>"
            for (lon, lat, alt), time in zip(piece.lon_lat_alt, piece.times, strict=True)
        ]
        lines.append("</trkseg>")
    return "\n".join([*lines, "</trk></gpx>", ""]).encode()


def _kml(content: TrackFile, progress: Share) -> bytes:
    """KML 2.2, a line on the ground for each stretch of one mode, coloured by it."""
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        '<kml xmlns="http://www.opengis.net/kml/2.2"><Document>',
        f"<name>{_xml(content.name)}</name><description>{content.heights}</description>",
    ]
    for mode, colour in _KML_COLOURS.items():
        style = f"<LineStyle><color>{colour}</color><width>4</width></LineStyle>"
        lines.append(f'<Style id="{mode.name.lower()}">{style}</Style>')
    for piece in _pieces(content.track, progress):
        mode_text = piece.mode.name.lower()
        span = f"<TimeSpan><begin>{piece.times[0]}</begin><end>{piece.times[-1]}</end></TimeSpan>"
        lines.append(f"<Placemark><name>{mode_text}</name>{span}<styleUrl>#{mode_text}</styleUrl>")
        lines.append("<LineString><tessellate>1</tessellate><coordinates>")
        lines += [f"{lon:.9f},{lat:.9f},{alt:.3f}" for lon, lat, alt in piece.lon_lat_alt]
        lines.append("</coordinates></LineString></Placemark>")
    return "\n".join([*lines, "</Document></kml>", ""]).encode()


def _parquet(content: TrackFile, progress: Share) -> bytes:
    """The columns of the CSV form with ``t_ns`` (UTC) before them; null where nothing is known."""
    arrow, parquet = _pyarrow()
    track = content.track
    columns: dict[str, Any] = {"t_ns": track.t_ns, "t_s": (track.t_ns - content.start_t_ns) / 1e9}
    columns.update({written: content.column(written, source) for written, source, _ in _COLUMNS})
    columns["gnss_used"] = columns["gnss_used"] > 0.5
    columns = {name: arrow.array(values, from_pandas=True) for name, values in columns.items()}
    table = arrow.table({**columns, "mode": content.modes()})
    sink = arrow.BufferOutputStream()
    parquet.write_table(table.replace_schema_metadata({"name": content.name, "heights": content.heights}), sink)
    return bytes(sink.getvalue().to_pybytes())


def _pyarrow() -> tuple[Any, Any]:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as error:
        raise UsageError("Parquet needs the package pyarrow: install telefuse[parquet], or write .csv.gz") from error
    return pyarrow, pyarrow.parquet


_WRITERS: Final[dict[str, Callable[[TrackFile, Share], bytes]]] = {
    ".csv": _csv,
    ".csv.gz": _csv_gz,
    ".geojson": _geojson,
    ".gpx": _gpx,
    ".kml": _kml,
    ".parquet": _parquet,
}


@dataclass(frozen=True, slots=True)
class _Piece:
    """A stretch of one mode: vertices and their times. It begins where the one before ends."""

    mode: Mode
    lon_lat_alt: list[list[float]]
    times: list[str]


def _pieces(track: Track, progress: Share) -> Iterator[_Piece]:
    """Stretches of known position with two vertices or more, cut where rows are missing and at the antimeridian."""
    lon, lat, alt = _wrapped_deg(track.column("lon_rad")), np.degrees(track.column("lat_rad")), track.column("alt_m")
    known = np.flatnonzero(np.isfinite(lon) & np.isfinite(lat) & np.isfinite(alt))
    if known.size < 2:
        return
    position, t_ns = np.column_stack([lon, lat, alt])[known], track.t_ns[known]
    mode = track.values[known, TRACK["mode"]].astype(int)
    steps_ns = np.diff(t_ns)
    apart = steps_ns > max(HOLE_S * 1e9, 3.0 * float(np.median(steps_ns)))
    crossing = np.abs(np.diff(position[:, 0])) > 180.0
    decimals = _decimals(t_ns)
    begin = 0
    for last in [*np.flatnonzero((np.diff(mode) != 0) | apart | crossing).tolist(), known.size - 1]:
        # A stretch of one mode reaches to the first vertex of the next one; over a hole it does not.
        joins = last + 1 < known.size and not apart[last] and not crossing[last]
        rows, times = position[begin : last + 1 + joins], t_ns[begin : last + 1 + joins]
        if last + 1 < known.size and crossing[last] and not apart[last]:
            edge, edge_t_ns = _at_antimeridian(position[last : last + 2], t_ns[last : last + 2])
            rows, times = np.vstack([rows, edge]), np.append(times, edge_t_ns)
        if begin and crossing[begin - 1] and not apart[begin - 1]:
            edge, edge_t_ns = _at_antimeridian(position[begin - 1 : begin + 1], t_ns[begin - 1 : begin + 1])
            rows, times = np.vstack([edge * [-1.0, 1.0, 1.0], rows]), np.concatenate([[edge_t_ns], times])
        if len(rows) > 1:
            vertices = np.column_stack([np.round(rows[:, :2], 9), np.round(rows[:, 2], 3)]).tolist()
            yield _Piece(Mode(int(mode[begin])), vertices, _rfc3339(times, decimals))
            progress((last + 1) / known.size)
        begin = last + 1


def _at_antimeridian(ends: FloatArray, t_ns: TimeArray) -> tuple[FloatArray, int]:
    """Where and when the way between two vertices meets longitude 180, on the side that it comes from."""
    side = np.copysign(180.0, ends[0, 0])
    share = (side - ends[0, 0]) / (ends[1, 0] + 2.0 * side - ends[0, 0])
    edge = ends[0] + share * (ends[1] - ends[0])
    edge[0] = side
    return edge, int(t_ns[0]) + round(float(share) * int(t_ns[1] - t_ns[0]))


def _wrapped_deg(lon_rad: FloatArray) -> FloatArray:
    """Longitudes as degrees from -180 up to 180; those that lie there already stay to the bit."""
    lon = np.degrees(lon_rad)
    return np.where(np.abs(lon) <= 180.0, lon, np.mod(lon + 180.0, 360.0) - 180.0)


def _decimals(t_ns: TimeArray) -> Literal["ms", "us", "ns"]:
    """The coarsest unit that keeps every time to the nanosecond."""
    if np.any(t_ns % 1_000):
        return "ns"
    return "us" if np.any(t_ns % 1_000_000) else "ms"


def _rfc3339(t_ns: TimeArray, unit: Literal["ms", "us", "ns"]) -> list[str]:
    return [f"{text}Z" for text in np.datetime_as_string(t_ns.astype("datetime64[ns]"), unit=unit).tolist()]


def _xml(text: str) -> str:
    """Text for XML 1.0, without the control characters that it has no way to say."""
    return escape(_NOT_XML.sub("\ufffd", text))
