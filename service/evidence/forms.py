"""Evidence as callers read it: curves in degrees and seconds from the impact, and what an event recorder keeps."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from core.accident.edr import CrashMotion, EventData, Series, event_data
from core.measurements import FLAG_AIRBAG
from schemas.notifications import rfc3339
from service.evidence.bundle import Bundle
from service.evidence.tape import AID_TABLES, Table

PARTS: Final = ("samples", "states", "innovations", *AID_TABLES)
"""Tables of a trace."""

PLACES: Final = frozenset(
    {"lat_rad", "lon_rad", "alt_m", "vn_mps", "ve_mps", "vd_mps", "yaw_rad", "course_rad", "sd_yaw_rad"}
)
"""Columns by which a way can be drawn: for keys with positions:read."""

_NO_PLACES: Final = ("samples", "states", "innovations", "magnetometer", "wheel_speed", "barometer")
_DECIMALS: Final = {"lat_deg": 9, "lon_deg": 9}
_USUAL_DECIMALS: Final = 6
_FLAGS: Final = ("clipped", "held", "gnss_used")

Columns = dict[str, list[Any]]


def parts_for(places: bool) -> tuple[str, ...]:
    """What a caller may have, by whether places may be shown."""
    return PARTS if places else _NO_PLACES


def columns_of(bundle: Bundle, part: str, *, places: bool) -> Columns:
    """A table as columns: ``t_s`` from the start of the first impact on, angles in degrees, null for unknown."""
    table = bundle.table(part)
    names = table.dtype.names or ()
    found: Columns = {"t_s": _seconds(table["t_ns"], bundle)}
    for name in names[1:]:
        if not places and name in PLACES:
            continue
        values: npt.NDArray[np.float64] = table[name]
        if name in ("aid", "outcome"):
            words = bundle.manifest["names"][name]
            found[name] = [words[int(one)] for one in values]
        elif name in _FLAGS:
            found[name] = [int(one) if math.isfinite(one) else None for one in values.tolist()]
        elif name == "mode":
            found[name] = [("aligning", "aided", "coasting")[int(one)] for one in values]
        elif name.endswith("_rad"):
            shown = f"{name.removesuffix('_rad')}_deg"
            found[shown] = _rounded(np.degrees(values), shown)
        else:
            found[name] = _rounded(values, name)
    return found


def to_csv(columns: Mapping[str, Sequence[Any]]) -> bytes:
    """Columns as a CSV table; what is not known is empty."""
    return _csv(columns, zip(*columns.values(), strict=True))


def crash_motion(samples: Table) -> CrashMotion:
    """The calibrated samples of a bundle."""

    def vectors(*names: str) -> npt.NDArray[np.float64]:
        return np.column_stack([samples[name] for name in names])

    return CrashMotion(
        t_ns=samples["t_ns"],
        f_b=vectors("ax_b_mps2", "ay_b_mps2", "az_b_mps2"),
        omega_b=vectors("gx_b_radps", "gy_b_radps", "gz_b_radps"),
        down_b=vectors("down_x", "down_y", "down_z"),
        speed_mps=samples["speed_mps"],
        clipped=samples["clipped"],
    )


def event_of(bundle: Bundle) -> EventData:
    """The event recorder's elements."""
    return event_data(crash_motion(bundle.table("samples")), int(bundle.manifest["accident"]["t_ns"]))


NOT_RECORDED: Final = (
    "Engine throttle, % full (or accelerator pedal, % full)",
    "Service brake, on/off",
    "Ignition cycle, crash",
    "Ignition cycle, download",
    "Safety belt status, driver",
    "Frontal air bag warning lamp, on/off",
    "Frontal air bag deployment, time to deploy, driver",
    "Frontal air bag deployment, time to deploy, right front passenger",
    "Engine RPM",
    "ABS activity",
    "Stability control",
    "Steering input",
    "Safety belt status, right front passenger",
)
"""Elements of tables I and II that a black box does not see."""


def edr_form(bundle: Bundle) -> dict[str, Any]:
    """The elements of 49 CFR 563 by their names there, each with whether it was recorded."""
    data = event_of(bundle)
    speed_note = "fused from GNSS and inertial sensors, not the speedometer's"
    bound = "the accelerometer read its full scale: a lower bound" if data.clipped else None
    elements = [
        _series("Delta-V, longitudinal", "km/h", data.longitudinal, 100.0, bound),
        _maximum("Maximum delta-V, longitudinal", data.maximum_longitudinal.delta_v_kmh, "km/h", bound),
        _maximum("Time, maximum delta-V, longitudinal", data.maximum_longitudinal.t_s, "s"),
        _series("Delta-V, lateral", "km/h", data.lateral, 100.0, bound),
        _maximum("Maximum delta-V, lateral", data.maximum_lateral.delta_v_kmh, "km/h", bound),
        _maximum("Time, maximum delta-V, lateral", data.maximum_lateral.t_s, "s"),
        _maximum("Maximum delta-V, resultant", data.maximum_resultant.delta_v_kmh, "km/h", bound),
        _maximum("Time, maximum delta-V, resultant", data.maximum_resultant.t_s, "s"),
        _series("Speed, vehicle indicated", "km/h", data.speed_kmh["5s_2hz"], 2.0, speed_note),
        _series("Speed, vehicle indicated (20 s)", "km/h", data.speed_kmh["20s_10hz"], 10.0, speed_note),
        *(
            _series(f"{name} acceleration", "m/s2", Series(data.acceleration_t_s, values), None, bound)
            for name, values in zip(("Longitudinal", "Lateral", "Normal"), data.acceleration_mps2.T, strict=True)
        ),
        _series("Vehicle roll angle", "deg", data.roll_deg, 10.0),
        _value("Multi-event, number of events", data.events, None),
        _value("Time from event 1 to 2", _figure(data.to_next_s), "s", "none" if data.events < 2 else None),
        *_said_by_packets(bundle, data.time_zero_ns),
        *({"element": name, "recorded": False} for name in NOT_RECORDED),
        _value("Complete file recorded", "yes" if data.complete else "no", None),
    ]
    return {
        "regulation": "49 CFR 563",
        "accident_id": bundle.manifest["accident"]["id"],
        "vehicle_id": bundle.manifest["accident"]["vehicle_id"],
        "time_zero": rfc3339(data.time_zero_ns),
        "time_zero_by": "563.5: 0.8 km/h within 20 ms"
        if data.time_zero_found
        else "the detector's start of the impact",
        "end_of_event_s": _figure(data.end_s),
        "trigger_threshold_reached": data.triggered,
        "clipped": data.clipped,
        "complete_file": data.complete,
        "evidence_sha256": bundle.sha256,
        "elements": elements,
    }


def edr_csv(form: Mapping[str, Any]) -> bytes:
    """The same as a table with a row a value."""
    rows: list[tuple[Any, ...]] = [
        (name, "yes", None, None, form[name], None)
        for name in ("regulation", "accident_id", "vehicle_id", "time_zero", "clipped", "evidence_sha256")
    ]
    for element in form["elements"]:
        name = element["element"]
        if not element["recorded"]:
            rows.append((name, "no", None, None, None, element.get("note")))
        elif "t_s" in element:
            pairs = zip(element["t_s"], element["values"], strict=True)
            rows += [(name, "yes", element["unit"], t_s, value, element.get("note")) for t_s, value in pairs]
        else:
            rows.append((name, "yes", element["unit"], None, element["value"], element.get("note")))
    return _csv(("element", "recorded", "unit", "t_s", "value", "note"), rows)


def _said_by_packets(bundle: Bundle, zero_ns: int) -> Iterator[dict[str, Any]]:
    """What the vehicle told its box: ignition a second before, and an air bag that fired."""
    ignition: bool | None = None
    airbag_s: float | None = None
    for packet in bundle.packets():
        start_s = (packet.start_time_ns - zero_ns) * 1e-9
        if packet.HasField("ignition") and start_s <= -1.0:
            ignition = packet.ignition
        if packet.flags & FLAG_AIRBAG and airbag_s is None:
            airbag_s = start_s
    if ignition is None:
        yield {"element": "Ignition, on/off, 1 s before", "recorded": False}
    else:
        yield _value("Ignition, on/off, 1 s before", "on" if ignition else "off", None)
    note = "start of the first packet in which the vehicle signalled it" if airbag_s is not None else "no signal came"
    yield _value("Air bag signal of the vehicle", _figure(math.nan if airbag_s is None else airbag_s), "s", note)


def _series(name: str, unit: str, series: Series, rate_hz: float | None, note: str | None = None) -> dict[str, Any]:
    values = [_figure(one) for one in series.values.tolist()]
    if all(one is None for one in values):
        return {"element": name, "recorded": False}
    t_s = [round(one, 4) for one in series.t_s.tolist()]
    return _noted(
        {"element": name, "recorded": True, "unit": unit, "rate_hz": rate_hz, "t_s": t_s, "values": values}, note
    )


def _maximum(name: str, value: float, unit: str, note: str | None = None) -> dict[str, Any]:
    return _value(name, _figure(value), unit, note) if math.isfinite(value) else {"element": name, "recorded": False}


def _value(name: str, value: Any, unit: str | None, note: str | None = None) -> dict[str, Any]:
    return _noted({"element": name, "recorded": True, "unit": unit, "value": value}, note)


def _noted(element: dict[str, Any], note: str | None) -> dict[str, Any]:
    return element if note is None else element | {"note": note}


def _figure(value: float) -> float | None:
    return round(value, 4) if math.isfinite(value) else None


def _seconds(t_ns: npt.NDArray[np.int64], bundle: Bundle) -> list[float]:
    start_ns = int(bundle.manifest["accident"]["t_ns"])
    return [one / 1e9 for one in (t_ns - start_ns).tolist()]


def _rounded(values: npt.NDArray[np.float64], name: str) -> list[float | None]:
    decimals = _DECIMALS.get(name, _USUAL_DECIMALS)
    known = np.isfinite(values)
    shown = np.round(np.where(known, values, 0.0), decimals).tolist()
    if known.all():
        return list(shown)
    return [one if is_known else None for one, is_known in zip(shown, known.tolist(), strict=True)]


def _csv(header: Iterable[str], rows: Iterable[Sequence[Any]]) -> bytes:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\r\n")
    writer.writerow(header)
    writer.writerows(["" if cell is None else cell for cell in row] for row in rows)
    return text.getvalue().encode()
