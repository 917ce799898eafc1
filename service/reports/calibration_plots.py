"""Plots of a calibration: positions over time and on a sphere, what they miss, correlations, and the field."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from core.calibration.recording import CalibrationRecording
from core.calibration.static_intervals import StaticPositions
from core.calibration.temperature import BiasTemperature
from core.measurements import FloatArray
from service.reports.plots import BLUE, GREEN, GREY, ORANGE, SHADE, Plot, Trace, line, marks, packed
from service.reports.thinning import evenly

_AXES: Final = tuple(zip("xyz", (BLUE, ORANGE, GREEN), strict=True))
_CLOUD_POINTS: Final = 2_500
"""Points of a cloud: more hide each other."""
_SCENE_PX: Final = 520


def static_intervals(recording: CalibrationRecording, positions: StaticPositions, unit: str) -> Plot:
    """What the accelerometer showed, with the positions shaded."""
    t_s = recording.t_s
    data = [line(t_s, recording.accelerometer[:, i], name, colour) for i, (name, colour) in enumerate(_AXES)]
    spans = [(float(t_s[a]), float(t_s[b - 1])) for a, b in zip(positions.start, positions.end, strict=True)]
    layout = {
        "xaxis": {"title": {"text": "time of the recording, s"}, "range": [float(t_s[0]), float(t_s[-1])]},
        "yaxis": {"title": {"text": f"accelerometer, {unit}"}},
        "shapes": [
            {"type": "rect", "x0": low, "x1": high, "yref": "paper", "y0": 0, "y1": 1, "line": {"width": 0}}
            | {"fillcolor": SHADE, "layer": "below"}
            for low, high in spans
        ],
    }
    held = sum(high - low for low, high in spans)
    text = f"Shaded: the {len(spans)} positions in which the box lay still, {held:.1f} s in all."
    return Plot("What the accelerometer showed", text, data, layout, 340)


def orientations(up: FloatArray, add: FloatArray) -> Plot:
    """Up in the box's axes in each position, and where more would tell most."""
    names = [f"position {i + 1}" for i in range(len(up))]
    data = [*_sphere(), _points(up, "position", BLUE, "circle", text=names)]
    text = "Up as seen by the box in each position: where the sphere is empty, nothing was told."
    if len(add):
        added = np.unique(np.round(add, 6), axis=0)
        data.append(_points(added, "to be added", ORANGE, "diamond"))
        text += " Diamonds: the positions that would tell most of what is not told."
    return _scene("Orientations", text, data, "up along")


def gravity_norms(before: FloatArray, after: FloatArray, gravity_mps2: float, counts: bool) -> Plot:
    """Norm of the specific force in each position, before and after."""
    number = np.arange(1.0, len(before) + 1)
    data = [
        marks(number, before, "before", ORANGE, "x", marker={"size": 8}),
        marks(number, after, "after", BLUE, "circle", marker={"size": 7}),
        _level(number, gravity_mps2, "gravity"),
    ]
    how = " (counts by one scale and zero for all axes)" if counts else ""
    text = (
        f"|a| in each position before{how} and after. Off gravity by {1e3 * _rms(before - gravity_mps2):.1f} mm/s² RMS "
        f"before, {1e3 * _rms(after - gravity_mps2):.3f} mm/s² after."
    )
    return Plot("|a| before and after", text, data, _by_number("position", "|a|, m/s²"), 380, timed=False)


def position_residuals(residuals: FloatArray) -> Plot:
    """Norm after the fit less gravity, in each position."""
    number = np.arange(1.0, len(residuals) + 1)
    text = f"|a| less gravity after the fit: {1e3 * _rms(residuals):.3f} mm/s² RMS."
    data = [_bars(number, 1e3 * residuals, "|a| − g", BLUE)]
    return Plot("Residuals", text, data, _by_number("position", "|a| − g, mm/s²"), 300, timed=False)


def turn_residuals(residuals_rad: FloatArray) -> Plot:
    """Angle by which gravity is missed after each turn."""
    degrees = np.degrees(residuals_rad)
    number = np.arange(1.0, len(degrees) + 1)
    text = (
        f"Angle between gravity as the accelerometer sees it after a turn and as the rates carried it there: "
        f"{_rms(degrees):.3f}° RMS over {len(degrees)} turns."
    )
    data = [_bars(number, degrees, "missed by", BLUE)]
    return Plot("Turns", text, data, _by_number("turn", "gravity missed by, °"), 300, timed=False)


def bias_and_warmth(temperature_c: FloatArray, bias: FloatArray, slope: BiasTemperature, unit: str) -> Plot:
    """Bias in each position against its temperature, less its mean, with the line through it."""
    known = np.isfinite(temperature_c)
    at, off = temperature_c[known], bias[known] - bias[known].mean(axis=0)
    ends = np.array([at.min(), at.max()])
    data = []
    for i, (name, colour) in enumerate(_AXES):
        data.append(marks(at, off[:, i], name, colour, "circle"))
        data.append(
            line(ends, slope.slope_per_k[i] * (ends - slope.reference_c), f"{name}: line", colour, showlegend=False)
        )
    text = (
        f"Bias at rest less its mean, against temperature: {slope.low_c:.1f} to {slope.high_c:.1f} °C."
        " The line is freed of what follows the attitude."
    )
    return Plot("Bias and temperature", text, data, _labelled("temperature, °C", f"bias, {unit}"), 340, timed=False)


def correlations(correlation: FloatArray, names: Sequence[str]) -> Plot:
    """Correlations of the parameters' errors as a map of colours."""
    labels = [name.replace("_", " ") for name in names]
    shown = np.round(correlation, 3)
    trace: Trace = {
        "type": "heatmap",
        "name": "correlation",
        "x": labels,
        "y": labels,
        "z": shown.tolist(),
        "zmin": -1,
        "zmax": 1,
        "colorscale": [[0, ORANGE], [0.5, "rgba(128,128,128,0.08)"], [1, BLUE]],
        "text": [[f"{value:.2f}" for value in row] for row in np.round(shown, 2) + 0.0],
        "texttemplate": "%{text}",
        "hovertemplate": "%{x}, %{y}: %{z:.3f}<extra></extra>",
    }
    layout = {
        "xaxis": {"showgrid": False},
        "yaxis": {"showgrid": False, "autorange": "reversed"},
        "margin": {"l": 96, "r": 16, "t": 16, "b": 48},
    }
    off = np.abs(shown - np.eye(len(shown)))
    i, j = np.unravel_index(int(np.argmax(off)), off.shape)
    most = f"{shown[i, j]:.2f} between {labels[i]} and {labels[j]}"
    text = f"Greatest: {most}. Near ±1 the recording tells only both together."
    return Plot("Correlations of the parameters", text, [trace], layout, 64 + 34 * len(labels), timed=False)


def magnetic_spheres(shown: FloatArray, corrected: FloatArray, strength: float, unit: str) -> Plot:
    """The field's points before and after, over its strength."""
    kept = evenly(len(shown), _CLOUD_POINTS)
    before = shown[kept] / float(np.median(np.linalg.norm(shown - np.median(shown, axis=0), axis=1)))
    data = [
        *_sphere(),
        _points(before, "before", ORANGE, "circle", marker={"size": 2, "opacity": 0.6}),
        _points(corrected[kept] / strength, "after", BLUE, "circle", marker={"size": 2, "opacity": 0.8}),
    ]
    missed = _rms(np.linalg.norm(corrected, axis=1) - strength)
    text = (
        f"The field over its strength, which is {strength:.4g} {unit}: after calibration on the unit sphere to "
        f"{missed:.3g} {unit} RMS. Before, its size is that of the median distance from the middle."
    )
    return _scene("The magnetic field", text, data, "")


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _labelled(x: str, y: str) -> dict[str, Any]:
    return {"xaxis": {"title": {"text": x}}, "yaxis": {"title": {"text": y}}}


def _by_number(what: str, label: str) -> dict[str, Any]:
    return {"xaxis": {"title": {"text": what}, "rangemode": "tozero"}, "yaxis": {"title": {"text": label}}}


def _level(number: FloatArray, value: float, name: str) -> Trace:
    ends = np.array([number[0] - 0.5, number[-1] + 0.5])
    return line(ends, np.full(2, value), name, GREY, line={"dash": "dash"})


def _bars(x: FloatArray, y: FloatArray, name: str, colour: str) -> Trace:
    return {
        "type": "bar",
        "name": name,
        "x": packed(x),
        "y": packed(y),
        "marker": {"color": colour},
        "showlegend": False,
    }


def _points(rows: FloatArray, name: str, colour: str, symbol: str, **more: Any) -> Trace:
    marker = {"color": colour, "symbol": symbol, "size": 5} | more.pop("marker", {})
    axes = {axis: packed(rows[:, i]) for i, axis in enumerate("xyz")}
    return {"type": "scatter3d", "mode": "markers", "name": name, "marker": marker, **axes, **more}


def _sphere() -> list[Trace]:
    """Circles of latitude and longitude of the unit sphere, as one line with gaps."""
    turn = np.linspace(0.0, 2.0 * np.pi, 61)
    heights = np.sin(np.radians([-60.0, -30.0, 0.0, 30.0, 60.0]))
    rings = [np.column_stack([_cos(h) * np.cos(turn), _cos(h) * np.sin(turn), np.full(61, h)]) for h in heights]
    rings += [
        np.column_stack([np.cos(east) * np.cos(turn), np.sin(east) * np.cos(turn), np.sin(turn)])
        for east in np.radians(np.arange(0.0, 180.0, 30.0))
    ]
    # Null, not NaN in a typed array, is what breaks a line in three dimensions.
    net = [[*np.round(ring[:, i], 4).tolist(), None] for i in range(3) for ring in rings]
    axes = {
        axis: [v for ring in net[i * len(rings) : (i + 1) * len(rings)] for v in ring] for i, axis in enumerate("xyz")
    }
    style = {"color": GREY, "width": 1}
    trace = {"type": "scatter3d", "mode": "lines", "name": "sphere", "line": style, "hoverinfo": "skip", "opacity": 0.5}
    return [{**trace, **axes, "showlegend": False}]


def _cos(sine: float) -> float:
    return float(np.sqrt(1.0 - sine**2))


def _scene(title: str, text: str, data: Sequence[Trace], along: str) -> Plot:
    axes = {
        f"{axis}axis": {"title": {"text": f"{along} {axis}".strip()}, "showbackground": False, "nticks": 5}
        for axis in "xyz"
    }
    camera = {"eye": {"x": 1.2, "y": 1.2, "z": 0.75}, "projection": {"type": "orthographic"}}
    scene = {"aspectmode": "data", "camera": camera, **axes}
    layout = {"scene": scene, "margin": {"l": 0, "r": 0, "t": 24, "b": 0}}
    return Plot(title, text, data, layout, _SCENE_PX, timed=False)
