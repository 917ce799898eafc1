"""How the vehicle moved: speed, height and attitude over time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from core.earth import horizontal_distance_m
from core.measurements import GNSS
from core.navigation.track import Track
from service.recordings.drive_folder import Drive
from service.recordings.fusing import Outage
from service.reports.comparison import time_axis
from service.reports.page import Section
from service.reports.plots import AMBER, BLUE, GREEN, GREY, ORANGE, PURPLE, Row, Trace, line, time_plot
from service.reports.texts import number

GAP_S = 5.0
"""Rows further apart are not joined by a line."""


def motion_section(drive: Drive, track: Track, outages: Sequence[Outage]) -> Section:
    """Speed, height, roll, pitch and heading, beside what was measured of them and the reference."""
    t_s = drive.t_s(track.t_ns)
    speed = np.hypot(track.column("vn_mps"), track.column("ve_mps"))
    known = speed[np.isfinite(speed)]
    if not known.size:
        return Section("Motion", ["The filter never aligned: no velocity and no attitude are known."])
    heading = np.mod(np.degrees(track.column("yaw_rad")), 360.0)
    # A heading that passes north is no line across the plot.
    heading[1:][np.abs(np.diff(heading)) > 180.0] = np.nan
    height = track.column("alt_m")
    tilt = [
        line(t_s, np.degrees(track.column(f"{name}_rad")), name, colour, gap_s=GAP_S)
        for name, colour in (("roll", GREEN), ("pitch", PURPLE))
    ]
    rows = [
        Row("speed, m/s", [*_measured_speeds(drive), line(t_s, speed, "fused", BLUE, gap_s=GAP_S)]),
        Row("height, m", [*_fixed_heights(drive), line(t_s, height, "fused", BLUE, gap_s=GAP_S)]),
        Row("roll and pitch, °", tilt),
        Row("heading, °", [line(t_s, heading, "fused", BLUE, gap_s=GAP_S)]),
    ]
    low, high = float(np.nanmin(height)), float(np.nanmax(height))
    datum = (
        "GNSS heights are above mean sea level, fused ones as GNSS gave them"
        if drive.gnss_alt_is_msl
        else ("heights are above the WGS-84 ellipsoid")
    )
    text = (
        f"Mean speed {number(float(known.mean()), 'm/s', 1)}, greatest {number(float(known.max()), 'm/s', 1)}; height "
        f"{low:.0f} to {high:.0f} m, {datum}; heading clockwise from north."
    )
    return Section("Motion", [], [time_plot("Speed, height and attitude", text, rows, time_axis(drive, outages))])


def distance_m(track: Track) -> float:
    """Length of the fused path, from one row each second, so that noise between rows does not add up."""
    placed = np.flatnonzero(np.isfinite(track.column("lat_rad")))
    if placed.size < 2:
        return 0.0
    first = np.concatenate([[True], np.diff(track.t_ns[placed] // 1_000_000_000) != 0])
    rows = placed[first]
    lat, lon = track.column("lat_rad")[rows], track.column("lon_rad")[rows]
    return float(horizontal_distance_m(lat[:-1], lon[:-1], lat[1:], lon[1:]).sum())


def _measured_speeds(drive: Drive) -> list[Trace]:
    m, traces = drive.measurements, []
    if len(m.speed_t_ns):
        traces.append(line(drive.t_s(m.speed_t_ns), m.speed_mps, "wheel", AMBER, gap_s=GAP_S))
    gnss = np.hypot(m.gnss[:, GNSS["vn_mps"]], m.gnss[:, GNSS["ve_mps"]])
    gnss = np.where(np.isfinite(gnss), gnss, m.gnss[:, GNSS["speed_mps"]])
    if np.isfinite(gnss).any():
        traces.append(line(drive.t_s(m.gnss_t_ns), gnss, "GNSS", ORANGE, gap_s=GAP_S))
    return traces


def _fixed_heights(drive: Drive) -> list[Trace]:
    m = drive.measurements
    height = m.gnss[:, GNSS["alt_m"]]
    if not np.isfinite(height).any():
        return []
    traces = [line(drive.t_s(m.gnss_t_ns), height, "GNSS", ORANGE, gap_s=GAP_S)]
    if drive.reference is not None:
        traces.insert(0, line(drive.t_s(drive.reference.t_ns), drive.reference.alt_m, "reference", GREY, gap_s=GAP_S))
    return traces
