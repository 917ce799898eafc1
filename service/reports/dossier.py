"""The dossier of an accident: all that is known of it on one page that can be printed."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from core.accident.edr import KMH, CrashMotion, EventData, acceleration, velocity_kmh
from core.accident.events import Impact, Kind, Severity, Status
from core.accident.placing import Accident, Place
from core.measurements import GNSS_COLUMNS, FloatArray, Measurements
from core.navigation import state
from core.navigation.records import RECORD_COLUMNS, AidRecords
from core.navigation.track import TRACK_COLUMNS, Mode, Track
from schemas.notifications import rfc3339
from service.evidence.bundle import Bundle
from service.evidence.forms import crash_motion, event_of
from service.evidence.tape import Table as EvidenceTable
from service.recordings.drive_folder import Drive
from service.reports.map_plot import map_plot
from service.reports.page import Section, Table, page
from service.reports.plots import AMBER, BLUE, GREEN, GREY, ORANGE, PURPLE, Plot, Row, TimeAxis, line, marks, time_plot
from service.reports.texts import number
from service.storage.accidents import REVIEWER, AccidentRow
from service.storage.evidence import EvidenceRow
from service.storage.reviews import ReviewRow

CRASH_S: Final = (-0.5, 1.5)
"""Around the first impact, for the curves of the crash itself."""
AROUND_S: Final = (-60.0, 30.0)
GAP_S: Final = 0.25
"""Samples further apart are not joined by a line."""
MAP_PX: Final = 370
ROW_PX: Final = 96
CRASH_ROW_PX: Final = 120

_WORDS: Final = {
    "low_speed": "low speed",
    "parked_hit": "parked vehicle hit",
    "false": "judged false by a reviewer",
    "pending": "pending",
}


@dataclass(frozen=True, slots=True, eq=False)
class Dossier:
    """What a dossier is made of. Without ``places`` it goes without the way that led there."""

    accident: AccidentRow
    bundle: Bundle
    evidence: EvidenceRow
    reviews: Sequence[ReviewRow]
    places: bool

    def html(self) -> str:
        """The page as one document."""
        samples = self.bundle.table("samples")
        motion, event = crash_motion(samples), event_of(self.bundle)
        crash = [_crash_plot(motion, event, self.accident.t_ns)] if len(samples) else []
        sections = [
            Section("What happened", self._missing(), [self._facts(), *self._map(samples)], beside=True),
            Section("The crash", [], [*crash, _event_table(event)], beside=True),
            Section("Before and after", [], self._around(samples)),
            Section("Reasons and evidence", [], [self._reasons(), self._evidence()], beside=True),
            Section("Reviews", [] if self.reviews else ["Nobody has reviewed it."], self._reviews()),
        ]
        title = f"Accident of {self.accident.vehicle_id}, {_utc(self.accident.t_ns)}"
        return page(title, sections, compact=True)

    def _missing(self) -> list[str]:
        """What a reader must know before the rest."""
        said = []
        if self.accident.is_none:
            said.append(f"This was no accident: {_word(self.accident.status)}.")
        covered = self.bundle.manifest["covered"]
        if not covered["whole"]:
            said.append("The recording is not whole: " + _holes(covered, self.accident.t_ns) + ".")
        if not self.places:
            said.append("The way that led there is left out: it needs the scope positions:read.")
        return said

    def _facts(self) -> Table:
        row, felt = self.accident, self.accident.detail
        low, high = felt["delta_v_interval_mps"]
        interval = "" if low is None else f", 95 % within {_kmh(low)} and {'∞' if high is None else _kmh(high)} km/h"
        where = "not known: the box never had a fix"
        if row.lat_deg is not None and row.lon_deg is not None:
            where = f"{row.lat_deg:.6f}°, {row.lon_deg:.6f}° (WGS-84), sd {number(row.sd_n_m, 'm north', 1)}, "
            where += f"{number(row.sd_e_m, 'm east', 1)}, {Mode(row.mode).name.lower()}"
        injury = felt["injury"]
        facts = [
            ("vehicle", row.vehicle_id),
            ("time", _utc(row.t_ns)),
            ("place", where),
            ("street", row.street or "–"),
            ("kind", f"{_word(row.kind)}, {_word(row.severity)}{', rolled over' if felt['rollover'] else ''}"),
            ("status", f"{_word(row.status)}, revision {row.revision}"),
            ("confidence", f"{100 * row.confidence:.0f} %, found by {felt['detector']}; the published rule "
             f"{'agrees' if felt['paper_agrees'] else 'does not'}"),
            ("change of velocity Δv", f"{_kmh(felt['delta_v_mps'])} km/h{interval}"
             f"{'; the accelerometer read its full scale' if felt['clipped'] else ''}"),
            ("force came from", f"{number(felt['pdof_deg'], '°', 0)} ± {number(felt['pdof_sd_deg'], '°', 0)} "
             "(clockwise, 0° front)"),
            ("peak, duration", f"{number(felt['peak_mps2'] / 9.80665, 'g', 1)}, {1000 * felt['duration_s']:.0f} ms"),
            ("speed before", "–" if felt["speed_before_mps"] is None else f"{_kmh(felt['speed_before_mps'])} km/h"),
            ("impacts", str(felt["impacts"])),
            *_each_impact(felt["each_impact"]),
            ("injury MAIS 3+", "–" if injury is None else f"{100 * injury['probability']:.1f} % "
             f"({100 * injury['low']:.1f} to {100 * injury['high']:.1f} %), {injury['source']}"),
        ]  # fmt: skip
        return Table("The accident", [], facts, prose=True)

    def _map(self, samples: EvidenceTable) -> list[Plot]:
        if not self.places:
            return []
        states, gnss = self.bundle.table("states"), self.bundle.table("gnss")
        track = Track(states["t_ns"], _values(states, TRACK_COLUMNS))
        drive = Drive(
            self.accident.vehicle_id,
            self.accident.t_ns,
            self.accident.vehicle_id,
            Measurements(
                imu_t_ns=samples["t_ns"],
                f_s=np.empty((len(samples), 3)),
                omega_s=np.empty((len(samples), 3)),
                gnss_t_ns=gnss["t_ns"],
                gnss=_values(gnss, GNSS_COLUMNS),
            ),
        )
        innovations = self.bundle.table("innovations")
        records = AidRecords(innovations["t_ns"], _values(innovations, RECORD_COLUMNS))
        offset_s = float(self.bundle.manifest["settings"]["gnss_time_offset_s"])
        chart = map_plot(drive, track, [], [_accident(self.accident)], records, offset_s)
        return [] if chart is None else [replace(chart, height_px=MAP_PX)]

    def _around(self, samples: EvidenceTable) -> list[Plot]:
        if not len(samples):
            return []
        t_s = (samples["t_ns"] - self.accident.t_ns) * 1e-9
        states = self.bundle.table("states")
        at_s = (states["t_ns"] - self.accident.t_ns) * 1e-9
        tilt = [
            line(at_s, np.degrees(states[f"{name}_rad"]), name, colour, gap_s=GAP_S)
            for name, colour in (("roll", GREEN), ("pitch", PURPLE))
        ]
        rows = [
            Row("speed, km/h", [line(t_s, KMH * samples["speed_mps"], "speed", BLUE, gap_s=GAP_S)]),
            Row("turn, °/s", [line(t_s, np.degrees(samples["gz_b_radps"]), "yaw rate", AMBER, gap_s=GAP_S)]),
            *([Row("tilt, °", tilt)] if len(states) else []),
            *self._innovations(),
        ]
        holes = [
            ((low - self.accident.t_ns) * 1e-9, (high - self.accident.t_ns) * 1e-9)
            for low, high in self.bundle.manifest["covered"]["gaps"]
        ]
        text = "Fused speed, yaw rate and tilt from a minute before to half a minute after the impact; below them how "
        text += "far GNSS and wheel speeds were from what was expected, in shares of their gates: above 1 refused."
        if holes:
            text += " Shaded: no samples."
        return [_timed("Speed, turning and tilt", text, rows, AROUND_S, holes)]

    def _innovations(self) -> list[Row]:
        table = self.bundle.table("innovations")
        t_s, traces = (table["t_ns"] - self.accident.t_ns) * 1e-9, []
        for aid, name, colour in (
            (state.A_POSITION, "position", BLUE),
            (state.A_VELOCITY, "velocity", ORANGE),
            (state.A_SPEED, "wheel speed", GREEN),
        ):
            own = (table["aid"] == aid) & np.isfinite(table["ratio"])
            if own.any():
                traces.append(marks(t_s[own], np.sqrt(table["ratio"][own]), name, colour, "circle-open"))
        return [Row("off by, gates", traces)] if traces else []

    def _reasons(self) -> Table:
        reasons = self.accident.detail["reasons"]
        rows = [[str(index + 1), reason] for index, reason in enumerate(reasons)] or [["–", "none are stated"]]
        return Table("Reasons", [], rows, prose=True)

    def _evidence(self) -> Table:
        manifest, replay = self.bundle.manifest, self.bundle.manifest["replay"]
        covered = manifest["covered"]
        differences = "; ".join(replay["differences"])
        whole = "whole" if covered["whole"] else _holes(covered, self.accident.t_ns)
        begun = {
            "checkpoint": "the session's own state of then",
            "first_packet": "the vehicle's first packet",
            "anew": "a session begun anew: no state of then was there",
        }[replay["from"]]
        instruments = manifest["instruments"] or {}
        version = (instruments.get("calibration") or {}).get("version")
        rows = [
            ("SHA-256", self.bundle.sha256),
            ("status", f"{self.evidence.status}, {whole}"),
            ("samples", f"{len(self.bundle.table('samples'))} at {number(covered.get('rate_hz'), 'Hz', 0)}, "
             f"{len(manifest['packets'])} packets as they came"),
            ("replayed from", begun),
            ("replay gave", f"another {differences}" if differences else "the accident and all positions, to the bit"),
            ("calibration", f"version {version}" if version else "none given: the box as it measures"),
            ("mounting", _mounting(instruments.get("mounting"))),
            ("made by", ", ".join(f"{name} {one}" for name, one in manifest["versions"].items())),
        ]  # fmt: skip
        return Table("Evidence", [], rows, prose=True)

    def _reviews(self) -> list[Table]:
        if not self.reviews:
            return []
        rows = [[_utc(one.created_ns), one.verdict, one.reviewer or "–", one.note or "–"] for one in self.reviews]
        return [Table("Reviews", ["at", "verdict", "key", "note"], rows, prose=True)]


def _crash_plot(motion: CrashMotion, event: EventData, t_ns: int) -> Plot:
    """Acceleration and the velocity gained, around the first impact."""
    t_s: FloatArray = np.asarray((motion.t_ns - t_ns) * 1e-9, float)
    inside = (t_s >= CRASH_S[0]) & (t_s <= CRASH_S[1])
    near = t_s[inside]
    a_b = acceleration(motion)[inside] / 9.80665
    zero_s = (event.time_zero_ns - t_ns) * 1e-9
    v = velocity_kmh(near, acceleration(motion)[inside])
    if len(near):
        v = v - np.array([np.interp(zero_s, near, v[:, axis]) for axis in range(2)])
    colours = (("forward", BLUE), ("right", ORANGE), ("down", GREY))
    clipped = motion.clipped[inside] > 0
    rows = [
        Row(
            "acceleration, g",
            [line(near, a_b[:, axis], name, colour, gap_s=GAP_S) for axis, (name, colour) in enumerate(colours)]
            + ([marks(near[clipped], _largest(a_b[clipped]), "at full scale", PURPLE, "x-thin-open")]
               if clipped.any() else []),
        ),
        Row(
            "Δv, km/h",
            [line(near, v[:, axis], name, colour, gap_s=GAP_S) for axis, (name, colour) in enumerate(colours[:2])],
        ),
    ]  # fmt: skip
    text = f"In the vehicle's axes, without gravity; time zero of the event data is at {zero_s:.3f} s."
    return _timed("Acceleration and change of velocity", text, rows, CRASH_S, (), CRASH_ROW_PX)


def _largest(rows: FloatArray) -> FloatArray:
    """Of each row the value that is the furthest from zero."""
    return np.asarray(np.take_along_axis(rows, np.abs(rows).argmax(axis=1)[:, None], axis=1)[:, 0])


def _timed(
    title: str,
    text: str,
    rows: Sequence[Row],
    span_s: tuple[float, float],
    holes: Sequence[tuple[float, float]],
    row_px: int = ROW_PX,
) -> Plot:
    plot = time_plot(title, text, rows, TimeAxis(span_s, holes), row_px)
    layout = dict(plot.layout)
    layout["xaxis"] = {**layout["xaxis"], "title": {"text": "time since the impact, s"}}
    # Of its own zoom: half a second around a crash and a minute and a half share no axis.
    return replace(plot, text=plot.text.removesuffix("Shaded: GNSS withheld.").rstrip(), layout=layout, timed=False)


def _event_table(event: EventData) -> Table:
    def at(maximum: float, t_s: float) -> str:
        return f"{number(maximum, 'km/h', 1)} at {number(1000 * t_s, 'ms', 0)}"

    speeds = event.speed_kmh["5s_2hz"]
    shown = ", ".join(number(one, "", 0) for one in speeds.values)
    rows = [
        ("maximum Δv, longitudinal", at(event.maximum_longitudinal.delta_v_kmh, event.maximum_longitudinal.t_s)),
        ("maximum Δv, lateral", at(event.maximum_lateral.delta_v_kmh, event.maximum_lateral.t_s)),
        ("maximum Δv, resultant", at(event.maximum_resultant.delta_v_kmh, event.maximum_resultant.t_s)),
        ("speed, 5 s at 2 Hz, km/h", shown),
        ("events", str(event.events) + (f", the second after {event.to_next_s:.1f} s" if event.events > 1 else "")),
        ("8 km/h within 150 ms", "reached" if event.triggered else "not reached"),
        ("complete file", "yes" if event.complete else "no"),
    ]
    return Table("Event data (49 CFR 563)", [], rows, prose=True)


def _accident(row: AccidentRow) -> Accident:
    """As the map takes it."""

    def rad(angle_deg: float | None) -> float:
        return math.nan if angle_deg is None else math.radians(angle_deg)

    def figure(value: float | None) -> float:
        return math.nan if value is None else value

    place = Place(
        rad(row.lat_deg),
        rad(row.lon_deg),
        figure(row.alt_m),
        figure(row.sd_n_m),
        figure(row.sd_e_m),
        figure(row.cov_ne_m2),
        rad(row.heading_deg),
        Mode(row.mode),
    )
    felt = row.detail
    impact = Impact(
        t_ns=row.t_ns,
        decided_t_ns=row.decided_t_ns,
        detector=felt["detector"],
        severity=Severity(row.severity),
        confidence=row.confidence,
        delta_v_mps=felt["delta_v_mps"],
        delta_v_sd_mps=figure(felt["delta_v_sd_mps"]),
        delta_v_b_mps=(figure(felt["delta_v_b_mps"][0]), figure(felt["delta_v_b_mps"][1])),
        pdof_deg=figure(felt["pdof_deg"]),
        peak_mps2=felt["peak_mps2"],
        duration_s=felt["duration_s"],
        clipped=felt["clipped"],
        speed_before_mps=figure(felt["speed_before_mps"]),
        paper_agrees=felt["paper_agrees"],
        kind=Kind(row.kind),
        status=Status.CONFIRMED if felt["detector"] == REVIEWER else Status.SUSPECTED,
    )
    return Accident(impact, place)


def _values(table: EvidenceTable, names: Sequence[str]) -> FloatArray:
    # Evidence from before a column was told has none of it.
    known = table.dtype.names or ()
    columns = [table[name] if name in known else np.full(len(table), np.nan) for name in names]
    return np.column_stack(columns) if len(table) else np.empty((0, len(names)))


def _holes(covered: dict[str, object], t_ns: int) -> str:
    first, last, gaps = covered["from_ns"], covered["to_ns"], covered["gaps"]
    if not isinstance(first, int) or not isinstance(last, int) or not isinstance(gaps, list):
        return "no samples are left"
    said = [f"samples from {(first - t_ns) * 1e-9:.1f} s to {(last - t_ns) * 1e-9:.1f} s around the impact"]
    said += [f"none from {(low - t_ns) * 1e-9:.1f} s to {(high - t_ns) * 1e-9:.1f} s" for low, high in gaps]
    return ", ".join(said)


def _mounting(found: dict[str, object] | None) -> str:
    if found is None:
        return "–"
    rpy, sd = found["rpy_rad"], found["sd_rad"]
    assert isinstance(rpy, list)
    assert isinstance(sd, list)
    angles = ", ".join(
        f"{name} {number(math.degrees(one), '°', 1)}" for name, one in zip(("roll", "pitch", "yaw"), rpy, strict=True)
    )
    return f"{angles} ({'given' if found['given'] else 'found' if found['found'] else 'nominal'})"


def _each_impact(impacts: Sequence[Mapping[str, Any]]) -> list[tuple[str, str]]:
    """A line an impact, where there are several."""
    lines = []
    for at, one in enumerate(impacts, 1):
        low, high = ("∞" if bound is None else _kmh(bound) for bound in one["delta_v_interval_mps"])
        line = (
            f"after {number(one['after_s'], 's', 2)}: Δv {_kmh(one['delta_v_mps'])} km/h, 95 % within {low} and {high}"
        )
        line += f" km/h, from {number(one['pdof_deg'], '°', 0)} ± {number(one['pdof_sd_deg'], '°', 0)}"
        lines.append((f"impact {at}", line + (", read its full scale" if one["clipped"] else "")))
    return lines if len(lines) > 1 else []


def _word(text: str) -> str:
    return _WORDS.get(text, text)


def _kmh(speed_mps: float) -> str:
    return f"{KMH * speed_mps:.1f}"


def _utc(t_ns: int) -> str:
    return rfc3339(t_ns)[:-4].replace("T", " ") + " UTC"
