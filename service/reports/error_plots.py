"""Errors against the reference or the fixes with their stated spread, and the outages, as plots and tables."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from core.measurements import FloatArray
from service.recordings.drive_folder import Drive
from service.recordings.fusing import Outage
from service.reports.comparison import Comparison, inside, share_inside, time_axis
from service.reports.page import Section, Table
from service.reports.plots import BLUE, Row, band, line, time_plot
from service.reports.texts import number, percent

GAP_S: Final = 5.0
"""Instants further apart are not joined by a line."""


def error_section(drive: Drive, compared: Comparison | None, outages: Sequence[Outage]) -> Section:
    """North, east, down and heading error with +-3 sd."""
    if compared is None:
        return Section("Errors", ["Neither a reference nor fixes while navigating: nothing to compare the track with."])
    t_s = drive.t_s(compared.t_ns)
    series: list[tuple[str, str, FloatArray, FloatArray]] = [
        (f"{axis} error", "m", compared.error_ned_m[:, i], compared.sd_ned_m[:, i])
        for i, axis in enumerate(("north", "east", "down"))
    ]
    if compared.yaw_error_rad is not None:
        series.append(("heading error", "°", np.degrees(compared.yaw_error_rad), np.degrees(compared.sd_yaw_rad)))
    held_out = inside(t_s, outages)
    header = ["error", "RMS", "greatest", "at", "inside 3 sd"] + (["inside 3 sd in outages"] if outages else [])
    table, rows = [], []
    for name, unit, error, sd in series:
        rows.append(Row(f"{name}, {unit}", _error_traces(t_s, error, sd)))
        table.append([name, *_row(t_s, error, sd, unit)])
        if outages:
            table[-1].append(percent(share_inside(error[held_out], sd[held_out])))
    plot = time_plot(
        f"Errors against {compared.against}",
        f"Track minus {compared.against}, with ±3 sd as stated by the filter. "
        + "; ".join(f"{cells[0]} {cells[1]} RMS, {cells[4]} inside" for cells in table)
        + ".",
        rows,
        time_axis(drive, outages),
    )
    return Section("Errors", [_about(compared)], [plot, Table(f"Errors against {compared.against}", header, table)])


def outage_section(found: Mapping[str, Any]) -> Section:
    """What the position did in each span without GNSS."""
    rows = [
        [
            f"{outage['start_s']:g} s",
            f"{outage['duration_s']:g} s",
            outage["against"] or "nothing",
            *(number(outage[key], "m") for key in ("rms_m", "end_m", "max_m")),
            number(outage["distance_m"], "m", 0),
            percent(
                outage["end_m"] / outage["distance_m"] if outage["end_m"] and outage["distance_m"] else math.nan, 2
            ),
        ]
        for outage in found["outages"]
    ]
    if not rows:
        return Section("Outages", ["No fix was withheld: --outage START:DURATION does so and tells the error in it."])
    overall = (
        f"RMS over all of them {number(found['outage_rms_m'], 'm')}, at most {number(found['outage_max_m'], 'm')}."
    )
    header = ["from", "for", "against", "RMS", "at its end", "greatest", "distance", "end error over distance"]
    return Section(
        "Outages", [f"Horizontal errors while GNSS was withheld. {overall}"], [Table("Outages", header, rows)]
    )


def _error_traces(t_s: FloatArray, error: FloatArray, sd: FloatArray) -> list[dict[str, Any]]:
    spread = band(t_s, -3.0 * sd, 3.0 * sd, "±3 sd", gap_s=GAP_S)
    return [*spread, line(t_s, error, "error", BLUE, gap_s=GAP_S)]


def _row(t_s: FloatArray, error: FloatArray, sd: FloatArray, unit: str) -> list[str]:
    known = np.flatnonzero(np.isfinite(error))
    if not known.size:
        return ["–", "–", "–", "–"]
    worst = int(known[np.argmax(np.abs(error[known]))])
    rms = math.sqrt(float(np.mean(np.square(error[known]))))
    at = f"{t_s[worst]:.1f} s"
    return [number(rms, unit), number(float(error[worst]), unit), at, percent(share_inside(error, sd))]


def _about(compared: Comparison) -> str:
    if compared.against != "the reference":
        return (
            "There is no reference, so the track is held against the GNSS fixes, the withheld ones among them. Their "
            "own errors are in the difference: the sd shown holds the receiver's as well, and outside the outages the "
            "track follows the very fixes that it is compared with."
        )
    north, east, down = compared.offset_ned_m
    return (
        f"The median difference outside the outages, north {north:.2f} m, east {east:.2f} m, down {down:.2f} m, is "
        "taken off, as a reference may sit elsewhere on the vehicle or use another datum."
    )
