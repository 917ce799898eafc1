"""Plots as plotly.js takes them: traces with packed numbers, rows over one time axis, shaded spans."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from core.measurements import FloatArray
from service.reports.thinning import LINE_POINTS, extremes

Trace = dict[str, Any]

# Okabe & Ito's colours, told apart by colour-blind eyes too; their blue is lightened to be seen on near-black as well.
BLUE: Final = "#1f83c4"
ORANGE: Final = "#d55e00"
GREEN: Final = "#009e73"
PURPLE: Final = "#cc79a7"
SKY: Final = "#56b4e9"
AMBER: Final = "#e69f00"
GREY: Final = "#808080"
BAND: Final = "rgba(128,128,128,0.28)"
SHADE: Final = "rgba(213,94,0,0.13)"

ROW_PX: Final = 190
MARGIN_PX: Final = 96


@dataclass(frozen=True, slots=True)
class Row:
    """One set of axes of a time plot: its label with the unit, and what is drawn in it."""

    label: str
    traces: Sequence[Trace]
    axis: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class TimeAxis:
    """What all time plots of a drive share: its span (from, to), and the spans in it that are shaded."""

    span_s: tuple[float, float]
    shaded_s: Sequence[tuple[float, float]] = ()

    @property
    def note(self) -> str:
        """What the shading means, if there is any."""
        return "Shaded: GNSS withheld." if self.shaded_s else ""


@dataclass(frozen=True, slots=True)
class Plot:
    """A plot with its title and, in words, what it shows; ``timed`` ones share their zoom."""

    title: str
    text: str
    data: Sequence[Trace]
    layout: Mapping[str, Any]
    height_px: int
    timed: bool = True


def packed(values: npt.ArrayLike, dtype: str = "f4") -> dict[str, str]:
    """Numbers as plotly.js's typed arrays: base64 of their little-endian bytes, a quarter of their decimal digits."""
    array = np.ascontiguousarray(values, dtype=f"<{dtype}")
    text = {"dtype": dtype, "bdata": base64.b64encode(array.tobytes()).decode()}
    return text if array.ndim == 1 else text | {"shape": ",".join(map(str, array.shape))}


def line(t_s: FloatArray, values: FloatArray, name: str, colour: str, *, gap_s: float = np.inf, **more: Any) -> Trace:
    """A line over time, thinned with its extremes kept, broken where two points are more than ``gap_s`` apart."""
    holes = np.flatnonzero(np.diff(t_s) > gap_s) + 1
    t_s, values = np.insert(t_s, holes, t_s[holes - 1]), np.insert(values, holes, np.nan)
    kept = extremes(values)
    style = {"color": colour, "width": 1.5} | more.pop("line", {})
    return {
        "type": "scatter",
        "mode": "lines",
        "name": name,
        "x": packed(t_s[kept], "f8"),
        "y": packed(values[kept]),
        "line": style,
        **more,
    }


def marks(x: FloatArray, y: FloatArray, name: str, colour: str, symbol: str, **more: Any) -> Trace:
    """Points; the greatest and smallest stay where there are too many."""
    kept = extremes(y, LINE_POINTS)
    marker = {"color": colour, "symbol": symbol, "size": 6} | more.pop("marker", {})
    text = {"type": "scatter", "mode": "markers", "name": name, "marker": marker, **more}
    return text | {"x": packed(x[kept], "f8"), "y": packed(y[kept], "f8")}


def band(t_s: FloatArray, low: FloatArray, high: FloatArray, name: str, *, gap_s: float = np.inf) -> list[Trace]:
    """The span between two lines, which both are cut alike, so that it is filled without slivers."""
    holes = np.flatnonzero(np.diff(t_s) > gap_s) + 1
    t_s = np.insert(t_s, holes, t_s[holes - 1])
    low, high = np.insert(low, holes, np.nan), np.insert(high, holes, np.nan)
    kept = extremes(high - low)
    known = np.isfinite(low[kept]) & np.isfinite(high[kept])
    # A filled line must not be broken: each unbroken stretch is run through there and back.
    x: list[FloatArray] = []
    y: list[FloatArray] = []
    for stretch in np.split(kept[known], np.flatnonzero(np.diff(np.flatnonzero(known)) > 1) + 1):
        if stretch.size:
            x += [t_s[stretch], t_s[stretch][::-1], np.array([np.nan])]
            y += [high[stretch], low[stretch][::-1], np.array([np.nan])]
    empty = np.empty(0)
    return [
        {
            "type": "scatter",
            "mode": "lines",
            "name": name,
            "x": packed(np.concatenate(x) if x else empty, "f8"),
            "y": packed(np.concatenate(y) if y else empty),
            "fill": "toself",
            "fillcolor": BAND,
            "line": {"width": 0},
            "hoverinfo": "skip",
        }
    ]


def time_plot(title: str, text: str, rows: Sequence[Row], axis: TimeAxis, row_px: int = ROW_PX) -> Plot:
    """Rows one above the other over one time axis."""
    height_px = MARGIN_PX + row_px * len(rows)
    share, gap = 1.0 / len(rows), 16.0 / max(height_px - MARGIN_PX, 1)
    bottom = "y" if len(rows) == 1 else f"y{len(rows)}"
    layout: dict[str, Any] = {
        "xaxis": {"title": {"text": "time of the drive, s"}, "anchor": bottom, "range": list(axis.span_s)}
    }
    data: list[Trace] = []
    seen: set[str] = set()
    for number, row in enumerate(rows):
        suffix = "" if number == 0 else str(number + 1)
        top = 1.0 - number * share
        layout[f"yaxis{suffix}"] = {
            "title": {"text": row.label},
            "domain": [max(top - share + (gap if number < len(rows) - 1 else 0.0), 0.0), top],
            **row.axis,
        }
        # One entry of the legend switches what has that name in all rows.
        data += [
            {**trace, "yaxis": f"y{suffix}", "legendgroup": trace["name"]} | _once(trace["name"], seen)
            for trace in row.traces
        ]
    layout["shapes"] = [
        {"type": "rect", "x0": low, "x1": high, "yref": "paper", "y0": 0, "y1": 1, "line": {"width": 0}}
        | {"fillcolor": SHADE, "layer": "below"}
        for low, high in axis.shaded_s
    ]
    return Plot(title, f"{text} {axis.note}".rstrip(), data, layout, height_px)


def _once(name: str, seen: set[str]) -> dict[str, bool]:
    first = name not in seen
    seen.add(name)
    return {"showlegend": first}
