"""What every aid brought: innovation against its expected spread, test ratio against the gate, and counts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from core.navigation import state
from core.navigation.records import AidRecords
from service.recordings.drive_folder import Drive
from service.recordings.fusing import Outage
from service.reports.comparison import share_inside, time_axis
from service.reports.page import Section, Table
from service.reports.plots import (
    AMBER,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    SKY,
    Plot,
    Row,
    Trace,
    band,
    line,
    marks,
    time_plot,
)
from service.reports.texts import number, percent

GAP_S: Final = 5.0
"""Two records of an aid further apart than this are not joined by a line."""
OUTCOME_MARKS: Final = {
    "rejected_gate": (ORANGE, "x"),
    "rejected_time": (AMBER, "triangle-down"),
    "rejected_range": (PURPLE, "diamond"),
    "reset": (GREEN, "star"),
}
"""Colour and symbol of each outcome but ``fused``, which is the line."""
AXES: Final = {
    "gnss_position": ("north", "east"),
    "gnss_height": ("height",),
    "gnss_velocity": ("north", "east", "down"),
    "nhc": ("lateral", "vertical"),
    "zupt": ("north", "east", "down"),
    "zaru": ("x", "y", "z"),
}
"""Names of an aid's components; another aid's are numbered where it has more than one."""
UNITS: Final = {
    "gnss_position": ("m", 1.0),
    "gnss_height": ("m", 1.0),
    "barometer": ("m", 1.0),
    "zaru": ("°/s", float(np.degrees(1.0))),
    "magnetometer": ("°", float(np.degrees(1.0))),
}
"""Unit shown for an innovation, and what the core's unit is multiplied by for it; m/s for all others."""
RATIO_FLOOR: Final = 1e-4
"""Test ratios below are drawn here: on a logarithmic axis they would fill the plot with nothing of interest."""


def aid_section(
    drive: Drive, records: AidRecords | None, counts: Mapping[str, Mapping[str, int]], outages: Sequence[Outage]
) -> Section:
    """Counts of all aids, and a plot for each whose records were kept."""
    outcomes = [name for name in state.OUTCOMES if any(name in of_aid for of_aid in counts.values())]
    table = Table(
        "Aids by outcome",
        ["aid", *outcomes],
        [[aid, *(str(of_aid.get(name, 0)) for name in outcomes)] for aid, of_aid in counts.items()],
    )
    paragraphs = [
        "An innovation is what an aid measured minus what was expected of it. Its test ratio is its square over the "
        "gate times the variance expected: above 1 it is out of its gate and refused."
    ]
    parts: list[Table | Plot] = [table]
    if records is not None and len(records.t_ns):
        present = np.unique(records.column("aid").astype(int))
        parts.append(_consistency(records, present))
        parts += [_plot(drive, records, int(aid), outages) for aid in present if _compared(records, int(aid))]
    return Section("Aids", paragraphs, parts)


def _compared(records: AidRecords, aid: int) -> bool:
    return bool(np.isfinite(records.column("innovation")[records.column("aid") == aid]).any())


def _axes(records: AidRecords, aid: int) -> list[tuple[int, str]]:
    found = np.unique(records.column("axis")[records.column("aid") == aid]).astype(int).tolist()
    names = AXES.get(state.AIDS[aid], ())
    return [(axis, names[axis] if axis < len(names) else f"axis {axis}" if len(found) > 1 else "") for axis in found]


def _consistency(records: AidRecords, present: Any) -> Table:
    rows = []
    for aid in present:
        for axis, name in _axes(records, int(aid)):
            own = records.of(int(aid), axis)
            innovation, variance = own.column("innovation"), own.column("variance")
            known = np.isfinite(innovation) & (variance > 0.0)
            if not known.any():
                continue
            unit, factor = UNITS.get(state.AIDS[aid], ("m/s", 1.0))
            rows.append(
                [
                    f"{state.AIDS[aid]} {name}".strip(),
                    str(int(known.sum())),
                    number(factor * float(np.mean(innovation[known])), unit, 3),
                    number(factor * float(np.std(innovation[known])), unit, 3),
                    number(factor * float(np.sqrt(np.mean(variance[known]))), unit, 3),
                    number(float(np.mean(np.square(innovation[known]) / variance[known]))),
                    percent(share_inside(innovation, np.sqrt(variance))),
                ]
            )
    header = ["aid", "compared", "mean", "sd", "expected sd", "mean of square over variance", "inside 3 sd"]
    return Table("Innovations against their expected spread (1.00 and 99.7 % where both agree)", header, rows)


def _plot(drive: Drive, records: AidRecords, aid: int, outages: Sequence[Outage]) -> Plot:
    aid_name = state.AIDS[aid]
    unit, factor = UNITS.get(aid_name, ("m/s", 1.0))
    axes = _axes(records, aid)
    rows: list[Row] = []
    ratios: list[Trace] = []
    joint = _joint(records, aid, axes)
    for (axis, name), colour in zip(axes, (BLUE, SKY, GREEN, AMBER) * 2, strict=False):
        own = records.of(aid, axis)
        t_s, innovation = drive.t_s(own.t_ns), factor * own.column("innovation")
        spread = 3.0 * factor * np.sqrt(own.column("variance"))
        traces = band(t_s, -spread, spread, "±3 sd expected", gap_s=GAP_S)
        fused = own.column("outcome") == state.FUSED
        traces.append(line(t_s[fused], innovation[fused], "fused", BLUE, gap_s=GAP_S))
        rows.append(Row(f"{name or 'innovation'}, {unit}", traces + _refused(own, t_s, innovation)))
        if not (joint and ratios):
            ratio, label = np.maximum(own.column("ratio"), RATIO_FLOOR), "" if joint else name
            ratios.append(line(t_s, ratio, f"ratio {label}".strip(), colour, gap_s=GAP_S, line={"width": 1}))
    whole = records.column("aid") == aid
    every_s = drive.t_s(records.t_ns[whole])
    gate = line(every_s[[0, -1]], np.ones(2), "gate", GREY, line={"dash": "dash", "width": 2})
    rows.append(Row("test ratio", [*ratios, gate], {"type": "log", "exponentformat": "power"}))
    finite = records.column("ratio")[whole]
    finite = finite[np.isfinite(finite)]
    beyond = float(np.mean(finite > 1.0)) if finite.size else float("nan")
    text = (
        f"Innovations of {aid_name} with ±3 sd as expected of them; the line is what was fused, marks are what was "
        f"not. {int(whole.sum())} records, {percent(beyond, 2)} of those compared above their gate, the greatest test "
        f"ratio {number(float(finite.max()) if finite.size else None)}."
    )
    return time_plot(aid_name, text, rows, time_axis(drive, outages), row_px=150)


def _joint(records: AidRecords, aid: int, axes: Sequence[tuple[int, str]]) -> bool:
    """Whether the components went through one gate together, and so have one ratio."""
    first, *others = (records.of(aid, axis).column("ratio") for axis, _ in axes)
    return all(np.array_equal(first, other, equal_nan=True) for other in others)


def _refused(own: AidRecords, t_s: Any, innovation: Any) -> list[Trace]:
    traces = []
    outcome = own.column("outcome").astype(int)
    for index, name in enumerate(state.OUTCOMES):
        rows = outcome == index
        if name == "fused" or not rows.any():
            continue
        colour, symbol = OUTCOME_MARKS.get(name, (GREY, "cross"))
        # What was refused before it was compared has no innovation: it is marked at zero, when it came.
        traces.append(marks(t_s[rows], np.nan_to_num(innovation[rows]), name, colour, symbol))
    return traces
