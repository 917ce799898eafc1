"""The map of a drive without tiles: metres east and north of its start, the track coloured by mode."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from core.accident.placing import Accident
from core.earth import ECCENTRICITY_SQ, SEMI_MAJOR_M
from core.measurements import GNSS, FloatArray
from core.navigation import state
from core.navigation.records import AidRecords
from core.navigation.track import Mode, Track
from service.recordings.drive_folder import Drive
from service.recordings.fusing import Outage
from service.reports.comparison import inside
from service.reports.plots import AMBER, BLUE, GREEN, GREY, ORANGE, PURPLE, Plot, Trace, packed
from service.reports.thinning import evenly

MODE_COLOURS: Final = {Mode.ALIGNING: GREY, Mode.AIDED: BLUE, Mode.COASTING: ORANGE}
TRACK_POINTS: Final = 20_000
"""Of the whole line: one each 0.2 s in an hour."""
FIX_POINTS: Final = 5_000
ELLIPSES: Final = 60
"""Over the drive, besides those at the end of each outage."""


class LocalMap:
    """East and north of an origin in its tangent plane (Groves 2013, eq. 2.112 and 2.150).

    True to scale within 1e-4 up to 90 km from there.
    """

    def __init__(self, lat_rad: float, lon_rad: float, alt_m: float) -> None:
        self.lat_rad, self.lon_rad, self.alt_m = lat_rad, lon_rad, alt_m
        self._origin_e_m = _ecef_m(np.array([lat_rad]), np.array([lon_rad]), np.array([alt_m]))[0]

    def east_north_m(self, lat_rad: FloatArray, lon_rad: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Points at the origin's height, (n,) each; NaN stays NaN."""
        d = _ecef_m(lat_rad, lon_rad, np.full(len(lat_rad), self.alt_m)) - self._origin_e_m
        s, c = math.sin(self.lat_rad), math.cos(self.lat_rad)
        sl, cl = math.sin(self.lon_rad), math.cos(self.lon_rad)
        return -sl * d[:, 0] + cl * d[:, 1], -s * cl * d[:, 0] - s * sl * d[:, 1] + c * d[:, 2]


def map_plot(
    drive: Drive,
    track: Track,
    outages: Sequence[Outage],
    accidents: Sequence[Accident] = (),
    records: AidRecords | None = None,
    gnss_time_offset_s: float = 0.0,
) -> Plot | None:
    """The map; None where nothing has a place. The times of ``records`` hold the offset, those of the fixes do not."""
    m = drive.measurements
    lat, lon = track.column("lat_rad"), track.column("lon_rad")
    placed = np.flatnonzero(np.isfinite(lat))
    if placed.size:
        first = placed[0]
        plane = LocalMap(float(lat[first]), float(lon[first]), float(np.nan_to_num(track.column("alt_m")[first])))
    else:
        fixed = np.flatnonzero(np.isfinite(m.gnss[:, GNSS["lat_rad"]]))
        if not fixed.size:
            return None
        plane = LocalMap(float(m.gnss[fixed[0], 0]), float(m.gnss[fixed[0], 1]), 0.0)
    data: list[Trace] = []
    if drive.reference is not None:
        data.append(_reference(drive, plane))
    data += _fixes(drive, plane, outages, records, round(gnss_time_offset_s * 1e9))
    kept = placed[evenly(placed.size, TRACK_POINTS)]
    for mode, colour in MODE_COLOURS.items():
        if (track.column("mode")[placed] == mode).any():
            data.append(_stretches(drive, track, kept, mode, colour, plane))
    if placed.size:
        data.append(_ellipses(drive, track, placed, outages, plane))
        data += [
            _place("start", track, int(placed[0]), "triangle-up", plane),
            _place("end", track, int(placed[-1]), "square", plane),
        ]
    data += _accidents(accidents, drive.start_t_ns, plane)
    east_size = f"{math.degrees(plane.lat_rad):.6f}°, {math.degrees(plane.lon_rad):.6f}°"
    text = (
        f"Metres east and north of {east_size} (latitude, longitude; WGS-84), both axes to the same scale."
        f" {_mode_shares(track)} Ellipses hold 3 sd of the horizontal position"
        f"{', also at the end of each outage' if outages else ''}. Point at the line for time and coordinates."
    )
    layout: dict[str, Any] = {
        "xaxis": {"title": {"text": "east, m"}},
        "yaxis": {"title": {"text": "north, m"}, "scaleanchor": "x", "scaleratio": 1},
    }
    return Plot("Map", text, data, layout, 640, timed=False)


def _mode_shares(track: Track) -> str:
    mode = track.column("mode")
    if not mode.size:
        return "No row has a place."
    shares = [f"{100 * float(np.mean(mode == one)):.1f} % {one.name.lower()}" for one in Mode if (mode == one).any()]
    return f"Of the rows {', '.join(shares)}."


def _stretches(drive: Drive, track: Track, kept: Any, mode: Mode, colour: str, plane: LocalMap) -> Trace:
    """All rows of a mode as one line, broken where it was another: each stretch reaches to the next one's first."""
    of_mode = track.column("mode")[kept] == mode
    shown = of_mode | np.concatenate([[False], of_mode[:-1]])
    lat, lon = track.column("lat_rad")[kept], track.column("lon_rad")[kept]
    east, north = plane.east_north_m(lat, lon)
    # Where the filter had no place in between, the line has a hole.
    holes = np.concatenate([[False], np.diff(kept) > 4 * max(np.median(np.diff(kept)), 1) if kept.size > 1 else []])
    cut = ~shown | holes.astype(bool)
    begins = np.flatnonzero(cut)
    columns = np.column_stack([east, north, drive.t_s(track.t_ns[kept]), np.degrees(lat), np.degrees(lon)])
    columns[~shown] = np.nan
    columns = np.insert(columns, begins[shown[begins]], np.nan, axis=0)
    # One NaN parts two stretches as well as many do.
    empty = np.isnan(columns[:, 0])
    columns = columns[~(empty & np.concatenate([[True], empty[:-1]]))]
    return {
        "type": "scatter",
        "mode": "lines",
        "name": mode.name.lower(),
        "x": packed(columns[:, 0], "f8"),
        "y": packed(columns[:, 1], "f8"),
        "customdata": packed(columns[:, 2:], "f8"),
        "hovertemplate": f"{mode.name.lower()}, %{{customdata[0]:.2f}} s<br>"
        "%{customdata[1]:.7f}°, %{customdata[2]:.7f}°<extra></extra>",
        "line": {"color": colour, "width": 3},
    }


def _reference(drive: Drive, plane: LocalMap) -> Trace:
    assert drive.reference is not None
    kept = evenly(len(drive.reference.t_ns), TRACK_POINTS)
    east, north = plane.east_north_m(drive.reference.lat_rad[kept], drive.reference.lon_rad[kept])
    return {
        "type": "scatter",
        "mode": "lines",
        "name": "reference",
        "x": packed(east, "f8"),
        "y": packed(north, "f8"),
        "line": {"color": GREEN, "width": 7},
        "opacity": 0.45,
        "hoverinfo": "skip",
    }


def _fixes(
    drive: Drive, plane: LocalMap, outages: Sequence[Outage], records: AidRecords | None, offset_ns: int
) -> list[Trace]:
    m = drive.measurements
    lat, lon = m.gnss[:, GNSS["lat_rad"]], m.gnss[:, GNSS["lon_rad"]]
    known = np.isfinite(lat) & np.isfinite(lon)
    withheld = known & inside(drive.t_s(m.gnss_t_ns), outages)
    refused = np.zeros(len(lat), np.bool_)
    if records is not None:
        outcome = records.column("outcome")
        of_fix = (records.column("aid") == state.A_POSITION) & (outcome != state.FUSED) & (outcome != state.RESET)
        refused = known & ~withheld & np.isin(m.gnss_t_ns + offset_ns, records.t_ns[of_fix])
    kinds = (
        ("GNSS fix", known & ~withheld & ~refused, GREY, "circle-open"),
        ("fix refused", refused, PURPLE, "diamond-open"),
        ("fix withheld", withheld, AMBER, "x-thin-open"),
    )
    traces = []
    for name, of_kind, colour, symbol in kinds:
        rows = np.flatnonzero(of_kind)
        if not rows.size:
            continue
        rows = rows[evenly(rows.size, FIX_POINTS)]
        east, north = plane.east_north_m(lat[rows], lon[rows])
        traces.append(
            {
                "type": "scatter",
                "mode": "markers",
                "name": name,
                "x": packed(east, "f8"),
                "y": packed(north, "f8"),
                "customdata": packed(drive.t_s(m.gnss_t_ns[rows])[:, None], "f8"),
                "hovertemplate": f"{name}, %{{customdata[0]:.2f}} s<extra></extra>",
                "marker": {"color": colour, "symbol": symbol, "size": 6},
            }
        )
    return traces


def _ellipses(drive: Drive, track: Track, placed: Any, outages: Sequence[Outage], plane: LocalMap) -> Trace:
    t_s = drive.t_s(track.t_ns[placed])
    ends = np.searchsorted(t_s, [outage.end_s for outage in outages]) - 1
    at = placed[
        np.unique(np.concatenate([evenly(placed.size, ELLIPSES), np.clip(ends, 0, placed.size - 1)]).astype(int))
    ]
    var_n, var_e = np.square(track.column("sd_n_m")[at]), np.square(track.column("sd_e_m")[at])
    cov = track.column("cov_ne_m2")[at]
    known = np.isfinite(var_n) & np.isfinite(var_e) & np.isfinite(cov)
    at = at[known]
    matrices = np.stack([var_e, cov, cov, var_n], axis=-1)[known].reshape(-1, 2, 2)
    values, vectors = np.linalg.eigh(matrices)
    around = np.linspace(0.0, 2.0 * np.pi, 33)
    circle = np.stack([np.cos(around), np.sin(around)])
    outline = 3.0 * vectors @ (np.sqrt(np.maximum(values, 0.0))[:, :, None] * circle)
    east, north = plane.east_north_m(track.column("lat_rad")[at], track.column("lon_rad")[at])
    gap = np.full((len(at), 1), np.nan)
    return {
        "type": "scatter",
        "mode": "lines",
        "name": "3 sd",
        "x": packed(np.hstack([east[:, None] + outline[:, 0], gap]).ravel(), "f8"),
        "y": packed(np.hstack([north[:, None] + outline[:, 1], gap]).ravel(), "f8"),
        "line": {"color": PURPLE, "width": 1},
        "hoverinfo": "skip",
    }


def _place(name: str, track: Track, row: int, symbol: str, plane: LocalMap) -> Trace:
    east, north = plane.east_north_m(track.column("lat_rad")[[row]], track.column("lon_rad")[[row]])
    return {
        "type": "scatter",
        "mode": "markers",
        "name": name,
        "x": east.tolist(),
        "y": north.tolist(),
        "hovertemplate": f"{name}<extra></extra>",
        "marker": {"color": GREY, "symbol": symbol, "size": 12},
    }


def _accidents(accidents: Sequence[Accident], start_t_ns: int, plane: LocalMap) -> list[Trace]:
    known = [one for one in accidents if math.isfinite(one.place.lat_rad)]
    if not known:
        return []
    east, north = plane.east_north_m(
        np.array([a.place.lat_rad for a in known]), np.array([a.place.lon_rad for a in known])
    )
    texts = [
        f"{a.impact.severity.value}, {(a.impact.t_ns - start_t_ns) * 1e-9:.1f} s, Δv {a.impact.delta_v_mps:.1f} m/s"
        for a in known
    ]
    return [
        {
            "type": "scatter",
            "mode": "markers",
            "name": "accident",
            "x": east.tolist(),
            "y": north.tolist(),
            "text": texts,
            "hovertemplate": "%{text}<extra></extra>",
            "marker": {"color": ORANGE, "symbol": "star", "size": 16, "line": {"color": GREY, "width": 1}},
        }
    ]


def _ecef_m(lat_rad: FloatArray, lon_rad: FloatArray, alt_m: FloatArray) -> FloatArray:
    transverse = SEMI_MAJOR_M / np.sqrt(1.0 - ECCENTRICITY_SQ * np.square(np.sin(lat_rad)))
    c = np.cos(lat_rad)
    return np.stack(
        [
            (transverse + alt_m) * c * np.cos(lon_rad),
            (transverse + alt_m) * c * np.sin(lon_rad),
            (transverse * (1.0 - ECCENTRICITY_SQ) + alt_m) * np.sin(lat_rad),
        ],
        axis=-1,
    )
