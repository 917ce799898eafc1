"""A fused track as a file: CSV, GeoJSON, GPX, KML or Parquet, by the file's ending."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final
from xml.sax.saxutils import escape

import numpy as np
import numpy.typing as npt

from core.measurements import FloatArray, TimeArray
from core.navigation.track import TRACK, Mode, Track
from service.errors import UsageError
from service.recordings.csv_tables import format_table, gzip_bytes, time_column
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


@dataclass(frozen=True, slots=True, eq=False)
class TrackFile:
    """What is written: the rows of a track, the zero of ``t_s``, and a name to show."""

    track: Track
    start_t_ns: int
    name: str

    def column(self, written: str, source: str) -> FloatArray:
        """A column in the unit of its name in the file."""
        values = self.track.column(source)
        return np.degrees(values) if written.endswith("_deg") else values

    def modes(self) -> list[str]:
        """The mode of each row as text."""
        return [_MODE_TEXT[int(value)] for value in self.track.column("mode")]


def check_ending(path: Path) -> None:
    """Raise UsageError unless the file's ending names a format that can be written here."""
    ending = _ending(path)
    if ending == ".parquet":
        _pyarrow()


def export_track(path: Path, content: TrackFile) -> None:
    """Write a track whole or not at all; raises UsageError for an unknown ending or a place not writable."""
    write_whole(path, _WRITERS[_ending(path)](content))


def _ending(path: Path) -> str:
    for ending in _WRITERS:
        if path.name.lower().endswith(ending):
            return ending
    raise UsageError(f"{path}: unknown file ending; expected one of {', '.join(_WRITERS)}")


def _csv(content: TrackFile) -> bytes:
    columns: dict[str, tuple[npt.ArrayLike, str]] = {"t_s": time_column(content.track.t_ns, content.start_t_ns)}
    for written, source, style in _COLUMNS:
        columns[written] = (content.column(written, source), style)
    columns["mode"] = (content.modes(), "%s")
    return format_table(columns).encode()


def _csv_gz(content: TrackFile) -> bytes:
    return gzip_bytes(_csv(content).decode())


def _geojson(content: TrackFile) -> bytes:
    """A line for each stretch of one mode, with the time of every vertex (RFC 7946; ``coordTimes``)."""
    features = [
        {
            "type": "Feature",
            "geometry": {"type": "LineString", "coordinates": piece.lon_lat_alt},
            "properties": {"name": content.name, "mode": piece.mode.name.lower(), "coordTimes": piece.times},
        }
        for piece in _pieces(content.track)
    ]
    return (json.dumps({"type": "FeatureCollection", "features": features}, allow_nan=False) + "\n").encode()


def _gpx(content: TrackFile) -> bytes:
    """GPX 1.1, a segment for each stretch of one mode; heights are ellipsoidal."""
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        '<gpx version="1.1" creator="telefuse" xmlns="http://www.topografix.com/GPX/1/1">',
        f"<trk><name>{escape(content.name)}</name><desc>heights above the WGS-84 ellipsoid</desc>",
    ]
    for piece in _pieces(content.track):
        lines.append("<trkseg>")
        lines += [
            f'<trkpt lat="{lat:.9f}" lon="{lon:.9f}"><ele>{alt:.3f}</ele><time>{time}</time></trkpt>'
            for (lon, lat, alt), time in zip(piece.lon_lat_alt, piece.times, strict=True)
        ]
        lines.append("</trkseg>")
    return "\n".join([*lines, "</trk></gpx>", ""]).encode()


def _kml(content: TrackFile) -> bytes:
    """KML 2.2, a line on the ground for each stretch of one mode, coloured by it."""
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        '<kml xmlns="http://www.opengis.net/kml/2.2"><Document>',
        f"<name>{escape(content.name)}</name>",
    ]
    for mode, colour in _KML_COLOURS.items():
        style = f"<LineStyle><color>{colour}</color><width>4</width></LineStyle>"
        lines.append(f'<Style id="{mode.name.lower()}">{style}</Style>')
    for piece in _pieces(content.track):
        mode_text = piece.mode.name.lower()
        span = f"<TimeSpan><begin>{piece.times[0]}</begin><end>{piece.times[-1]}</end></TimeSpan>"
        lines.append(f"<Placemark><name>{mode_text}</name>{span}<styleUrl>#{mode_text}</styleUrl>")
        lines.append("<LineString><tessellate>1</tessellate><coordinates>")
        lines += [f"{lon:.9f},{lat:.9f},{alt:.3f}" for lon, lat, alt in piece.lon_lat_alt]
        lines.append("</coordinates></LineString></Placemark>")
    return "\n".join([*lines, "</Document></kml>", ""]).encode()


def _parquet(content: TrackFile) -> bytes:
    """The columns of the CSV form with ``t_ns`` (UTC) before them; NaN where nothing is known."""
    arrow, parquet = _pyarrow()
    track = content.track
    columns: dict[str, Any] = {"t_ns": track.t_ns, "t_s": (track.t_ns - content.start_t_ns) / 1e9}
    columns.update({written: content.column(written, source) for written, source, _ in _COLUMNS})
    columns["gnss_used"] = columns["gnss_used"] > 0.5
    table = arrow.table({**columns, "mode": content.modes()})
    sink = arrow.BufferOutputStream()
    parquet.write_table(table.replace_schema_metadata({"name": content.name}), sink)
    return bytes(sink.getvalue().to_pybytes())


def _pyarrow() -> tuple[Any, Any]:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as error:
        raise UsageError("Parquet needs the package pyarrow: install telefuse[parquet], or write .csv.gz") from error
    return pyarrow, pyarrow.parquet


_WRITERS: Final[dict[str, Callable[[TrackFile], bytes]]] = {
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


def _pieces(track: Track) -> Iterator[_Piece]:
    """Stretches of known position with two vertices or more."""
    position = np.column_stack([np.degrees(track.column("lon_rad")), np.degrees(track.column("lat_rad"))])
    position = np.column_stack([np.round(position, 9), np.round(track.column("alt_m"), 3)])
    known = np.flatnonzero(np.isfinite(position).all(axis=1))
    if known.size < 2:
        return
    position, t_ns, mode = position[known], track.t_ns[known], track.values[known, TRACK["mode"]]
    begins = [0, *(np.flatnonzero(np.diff(mode)) + 1).tolist()]
    for begin, end in zip(begins, [*begins[1:], mode.size - 1], strict=True):
        if end > begin:
            vertices = slice(begin, end + 1)
            yield _Piece(Mode(int(mode[begin])), position[vertices].tolist(), _rfc3339(t_ns[vertices]))


def _rfc3339(t_ns: TimeArray) -> list[str]:
    """UTC to the millisecond."""
    return [f"{text}Z" for text in np.datetime_as_string(t_ns.astype("datetime64[ns]"), unit="ms").tolist()]
