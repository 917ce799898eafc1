"""Trips of a phone in earth axes with labelled manoeuvres (Ferreira et al., PLOS ONE 2017), as files of a folder."""

from __future__ import annotations

import csv
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from core.measurements import FloatArray, TimeArray
from service.errors import RecordingError
from service.recordings.csv_tables import find_table, read_table, times_ns

_LABELS: Final = re.compile(r"(trip\w+)_labels\.csv")


@dataclass(frozen=True, slots=True)
class LabelledSpan:
    """What the driver was told to do, and when: seconds of the trip's own clock."""

    event: str
    start_s: float
    end_s: float


@dataclass(frozen=True, slots=True, eq=False)
class LabelledTrip:
    """Acceleration without gravity and rate about up, (n,) each, in east, north, up; ``t_ns`` from the trip's begin."""

    name: str
    t_ns: TimeArray
    east_mps2: FloatArray
    north_mps2: FloatArray
    up_mps2: FloatArray
    yaw_up_radps: FloatArray
    labels: tuple[LabelledSpan, ...]


def labelled_trips(folder: Path) -> list[str]:
    """Names of the trips in a folder, in order; empty where there is none."""
    found = (_LABELS.fullmatch(path.name) for path in sorted(folder.glob("*_labels.csv")))
    return [match.group(1) for match in found if match]


def read_labelled_trip(folder: Path, name: str) -> LabelledTrip:
    """A trip: ``NAME_linacc.csv``, ``NAME_gyro.csv`` (t_s, x, y, z; plain or .gz) and ``NAME_labels.csv``."""
    force, rate = (_table(folder, f"{name}_{sensor}.csv") for sensor in ("linacc", "gyro"))
    # The two sensors are read at their own instants, 20 ms apart at most.
    within = (force["t_s"] >= rate["t_s"][0]) & (force["t_s"] <= rate["t_s"][-1])
    t_s = force["t_s"][within]
    return LabelledTrip(
        name=name,
        t_ns=times_ns(t_s, 0),
        east_mps2=force["x"][within],
        north_mps2=force["y"][within],
        up_mps2=force["z"][within],
        yaw_up_radps=np.interp(t_s, rate["t_s"], rate["z"]),
        labels=_labels(folder / f"{name}_labels.csv"),
    )


def _table(folder: Path, name: str) -> dict[str, FloatArray]:
    path = find_table(folder, name)
    if path is None:
        raise RecordingError(f"{folder}: no {name}; expected it beside the labels, with columns t_s, x, y, z")
    table = read_table(path, ("t_s", "x", "y", "z"))
    if not len(table["t_s"]):
        raise RecordingError(f"{path}: no rows; expected samples of the trip")
    return table


def _labels(path: Path) -> tuple[LabelledSpan, ...]:
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    try:
        spans = tuple(LabelledSpan(row["event"], float(row["start_s"]), float(row["end_s"])) for row in rows)
    except (KeyError, TypeError, ValueError) as error:
        raise RecordingError(f"{path}: expected columns event, start_s, end_s, times as numbers") from error
    for number, span in enumerate(spans, start=2):
        if not span.start_s < span.end_s:
            raise RecordingError(f"{path}: line {number}: ends at {span.end_s:g} s; expected after {span.start_s:g} s")
    return spans
