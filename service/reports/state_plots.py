"""The states that change slowly, with their spread: biases, mounting, scale, and what GNSS and barometer hide."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from core.navigation.solution import SLOW, Solution
from service.recordings.drive_folder import Drive
from service.recordings.fusing import Outage
from service.reports.comparison import time_axis
from service.reports.page import Section, Table
from service.reports.plots import BLUE, Plot, Row, band, line, time_plot
from service.reports.texts import number

_DEG: Final = float(np.degrees(1.0))
GAP_S: Final = 2.0
"""Nodes come some ten a second; further apart the filter was aligning in between."""


@dataclass(frozen=True, slots=True)
class Group:
    """States that are drawn together: (column, label), the unit shown and what the core's is multiplied by."""

    title: str
    unit: str
    factor: float
    decimals: int
    states: Sequence[tuple[str, str]]


GROUPS: Final = (
    Group("Gyroscope biases", "°/s", _DEG, 4, [(f"gyro_bias_{axis}_radps", axis) for axis in "xyz"]),
    Group("Accelerometer biases", "m/s²", 1.0, 4, [(f"accel_bias_{axis}_mps2", axis) for axis in "xyz"]),
    Group("Mounting angles", "°", _DEG, 3, [("mount_pitch_rad", "pitch"), ("mount_yaw_rad", "yaw")]),
    Group("Scale of the wheel speed", "%", 100.0, 3, [("speed_scale", "scale")]),
    Group("Scale of the gyroscope", "%", 100.0, 3, [("gyro_scale_z", "z")]),
    Group(
        "Correlated GNSS error",
        "m",
        1.0,
        2,
        [(f"gnss_error_{short}_m", name) for short, name in (("n", "north"), ("e", "east"), ("d", "down"))],
    ),
    Group("GNSS delay", "ms", 1e3, 1, [("gnss_delay_s", "delay")]),
    Group("Barometer bias", "m", 1.0, 2, [("baro_bias_m", "bias")]),
)


def state_section(drive: Drive, solution: Solution, outages: Sequence[Outage]) -> Section:
    """Each group over time with +-3 sd, and what the drive ended with."""
    paragraphs = [
        "Estimates with ±3 sd. "
        + ("Smoothed: the whole drive entered each of them." if solution.smoothed else "Causal: from what lay before.")
    ]
    plots: list[Table | Plot] = []
    rows: list[list[str]] = []
    unused: list[str] = []
    for group in GROUPS:
        if not _estimated(solution, group):
            unused.append(group.title.lower())
            continue
        plots.append(_plot(drive, solution, group, outages))
        rows += _ends(solution, group)
    if unused:
        paragraphs.append(f"Not estimated in this drive: {', '.join(unused)}.")
    table = Table("Estimates at the start and the end", ["state", "start", "sd", "end", "sd"], rows)
    return Section("Biases, mounting and other slow states", paragraphs, [table, *plots] if rows else [])


def _estimated(solution: Solution, group: Group) -> bool:
    """Whether its spread was ever above zero: a state that is switched off has none."""
    sd = solution.slow_sd[:, [SLOW[column] for column, _ in group.states]]
    return bool((sd > 0.0).any())


def _plot(drive: Drive, solution: Solution, group: Group, outages: Sequence[Outage]) -> Plot:
    t_s = drive.t_s(solution.t_ns)
    rows, ends = [], []
    for column, label in group.states:
        value = group.factor * solution.slow[:, SLOW[column]]
        sd = group.factor * solution.slow_sd[:, SLOW[column]]
        spread = band(t_s, value - 3.0 * sd, value + 3.0 * sd, "±3 sd", gap_s=GAP_S)
        # The first spread is wide before anything was measured: the axis is that of what was learnt.
        rows.append(
            Row(f"{label}, {group.unit}", [*spread, line(t_s, value, "estimate", BLUE, gap_s=GAP_S)], _range(value, sd))
        )
        last = f"{number(float(value[-1]), group.unit, group.decimals)} ± {number(float(sd[-1]), '', group.decimals)}"
        ends.append(f"{label} {last}")
    text = f"At the end: {', '.join(ends)} (1 sd). The band is ±3 sd."
    return time_plot(group.title, text, rows, time_axis(drive, outages), row_px=150)


def _range(value: np.ndarray, sd: np.ndarray) -> dict[str, list[float]]:
    known = np.isfinite(value) & np.isfinite(sd)
    if not known.any():
        return {}
    reach = 4.0 * float(np.median(sd[known]))
    low, high = float(value[known].min()) - reach, float(value[known].max()) + reach
    return {"range": [low, high]} if high > low else {}


def _ends(solution: Solution, group: Group) -> list[list[str]]:
    rows = []
    for column, label in group.states:
        values = [part[at, SLOW[column]] for at in (0, -1) for part in (solution.slow, solution.slow_sd)]
        cells = [number(group.factor * float(value), group.unit, group.decimals) for value in values]
        rows.append([f"{group.title}: {label}", *cells])
    return rows
