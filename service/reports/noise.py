"""The report on noise: Allan curves with their intervals, the fits in them, and the figures."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from core.calibration.allan import TERMS
from core.calibration.allan_fit import AllanFit
from core.measurements import FloatArray
from core.sensors import AXES
from service.noise import NoiseOutcome, told
from service.reports.customary import CUSTOMARY
from service.reports.page import Section, Table, page
from service.reports.plots import AMBER, BAND, BLUE, GREEN, GREY, ORANGE, PURPLE, SKY, Plot, Trace, packed
from service.reports.texts import number

AXIS_COLOURS: Final = (BLUE, ORANGE, GREEN)
_TERM_COLOURS: Final = dict(zip(TERMS, (GREY, SKY, AMBER, PURPLE), strict=True))
_CURVE_UNITS: Final[Mapping[str, str]] = {"accelerometer": "mm/s²", "gyroscope": "°/h"}
_HEIGHT_PX: Final = 460


def noise_report(outcome: NoiseOutcome) -> str:
    """The whole page."""
    sections = [_summary(outcome)]
    sections += [_sensor(sensor, fits) for sensor, fits in outcome.fits.items()]
    return page(f"Noise report: {outcome.name}", sections)


def _summary(outcome: NoiseOutcome) -> Section:
    facts = [
        ("recording", outcome.name),
        ("at rest", f"{outcome.duration_s:.1f} s from {outcome.start_s:.1f} s"),
        ("rate", number(outcome.rate_hz, "Hz", 2)),
    ]
    rows = []
    for sensor, fits in outcome.fits.items():
        for name, (unit, factor) in CUSTOMARY[sensor].items():
            cells = [told(getattr(fit, name), factor) for fit in fits]
            rows.append([f"{sensor}: {name.replace('_', ' ')}, {unit}", *cells])
    parts = [
        Table("Recording", [], facts, prose=True),
        Table("Noise with 95 % intervals", ["noise", *AXES], rows),
    ]
    return Section("Summary", outcome.warnings, parts)


def _sensor(sensor: str, fits: tuple[AllanFit, AllanFit, AllanFit]) -> Section:
    unit = _CURVE_UNITS[sensor]
    factor = CUSTOMARY[sensor]["floor"][1]
    together: list[Trace] = []
    for axis, fit, colour in zip(AXES, fits, AXIS_COLOURS, strict=True):
        curve = fit.curve
        together += [
            _band(curve.tau_s, factor * curve.low, factor * curve.high, f"{axis}: 95 %", axis),
            _line(curve.tau_s, factor * curve.deviation, axis, colour, legendgroup=axis),
        ]
    text = (
        "Overlapping Allan deviation, with 95 % intervals of chi-square whose degrees of freedom are those of the "
        "noises fitted. White noise falls by a factor of 10 over two decades; where the curve is flat is the floor."
    )
    parts = [_plot(f"{sensor.capitalize()}: Allan deviation", text, together, unit)]
    for axis, fit, colour in zip(AXES, fits, AXIS_COLOURS, strict=True):
        parts.append(_fitted(f"{sensor.capitalize()} {axis}: fit", axis, fit, colour, factor, unit))
    return Section(sensor.capitalize(), [], parts)


def _fitted(title: str, axis: str, fit: AllanFit, colour: str, factor: float, unit: str) -> Plot:
    curve = fit.curve
    shares = fit.deviations(curve.tau_s)
    data = [
        _band(curve.tau_s, factor * curve.low, factor * curve.high, "95 %", "95 %"),
        _line(curve.tau_s, factor * curve.deviation, axis, colour, mode="lines+markers", marker={"size": 5}),
        _line(
            curve.tau_s,
            factor * np.sqrt(np.square(shares).sum(axis=1)),
            "fit",
            GREY,
            line={"width": 2.5, "dash": "dash"},
        ),
    ]
    smallest = 0.5 * float(curve.low.min())
    for index, name in enumerate(TERMS):
        if getattr(fit, name).resolved:
            shown = np.where(shares[:, index] > smallest, factor * shares[:, index], np.nan)
            label = name.replace("_", " ")
            data.append(_line(curve.tau_s, shown, label, _TERM_COLOURS[name], line={"width": 1.2, "dash": "dot"}))
    text = f"Fitted from {fit.fitted_tau_s[0]:.3g} s to {fit.fitted_tau_s[-1]:.4g} s at octaves. "
    if fit.excess_sd > 0.0:
        text += f"The noises leave {50.0 * fit.excess_sd:.1f} % of the deviation beyond chance; intervals hold it. "
    absent = [name.replace("_", " ") for name in TERMS if not getattr(fit, name).resolved]
    if absent:
        text += f"Not told from none: {', '.join(absent)}."
    return _plot(title, text, data, unit)


def _plot(title: str, text: str, data: list[Trace], unit: str) -> Plot:
    layout: dict[str, Any] = {
        "xaxis": {"type": "log", "title": {"text": "averaging time, s"}, "dtick": 1},
        "yaxis": {"type": "log", "title": {"text": f"Allan deviation, {unit}"}, "exponentformat": "power"},
    }
    return Plot(title, text, data, layout, _HEIGHT_PX, timed=False)


def _line(x: FloatArray, y: FloatArray, name: str, colour: str, **more: Any) -> Trace:
    style = {"color": colour, "width": 1.5} | more.pop("line", {})
    trace = {
        "type": "scatter",
        "mode": "lines",
        "name": name,
        "x": packed(x, "f8"),
        "y": packed(y, "f8"),
        "line": style,
    }
    return trace | more


def _band(x: FloatArray, low: FloatArray, high: FloatArray, name: str, group: str) -> Trace:
    around_x, around_y = np.concatenate([x, x[::-1]]), np.concatenate([high, low[::-1]])
    shape = {
        "fill": "toself",
        "fillcolor": BAND,
        "hoverinfo": "skip",
        "legendgroup": group,
        "showlegend": name == "95 %",
    }
    return _line(around_x, around_y, name, BAND, line={"width": 0}) | shape
