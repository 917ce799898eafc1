"""The report of one fused drive, in the order in which it is read: figures, map, errors, aids, states, settings."""

from __future__ import annotations

import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any, Final

import numpy as np

from core.accident.placing import Accident
from core.measurements import GNSS
from core.navigation.records import AidRecords
from core.navigation.solution import Solution
from core.session import SessionConfig
from core.tunables import Tunables, describe
from service.recordings.drive_folder import Drive
from service.recordings.fusing import Fused, Outage
from service.reports.aid_plots import aid_section
from service.reports.comparison import compare
from service.reports.error_plots import error_section, outage_section
from service.reports.map_plot import map_plot
from service.reports.motion_plots import distance_m, motion_section
from service.reports.page import Section, Table, page
from service.reports.state_plots import state_section
from service.reports.texts import number

_LIBRARIES: Final = ("telefuse", "numpy", "numba", "scipy", "plotly")


@dataclass(frozen=True, slots=True, eq=False)
class NavigationReport:
    """What a report is made of. Without ``solution`` or ``records`` it goes without the plots that need them."""

    drive: Drive
    config: SessionConfig
    outages: Sequence[Outage]
    fused: Fused
    figures: Mapping[str, Any]
    solution: Solution | None = None
    records: AidRecords | None = None

    def html(self) -> str:
        """The page as one document."""
        drive, outages, track = self.drive, self.outages, self.fused.track
        compared = compare(drive, track, outages, self.config.filter.tuning)
        offset_s = self.config.filter.gnss_time_offset_s
        chart = map_plot(drive, track, outages, self.fused.accidents, self.records, offset_s)
        sections = [
            self._summary(),
            Section("Map", [] if chart else ["Neither a fix nor a fused row has a place."], [chart] if chart else []),
            error_section(drive, compared, outages),
            outage_section(self.figures),
            motion_section(drive, track, outages),
            aid_section(drive, self.records, self.figures["aids"], outages),
        ]
        if self.solution is not None and len(self.solution.t_ns):
            sections.append(state_section(drive, self.solution, outages))
        sections += [_accidents(self.fused.accidents, drive.start_t_ns), self._settings()]
        return page(f"Navigation report: {drive.name}", sections)

    def _summary(self) -> Section:
        drive, found, m = self.drive, self.figures, self.drive.measurements
        start = np.datetime_as_string(np.datetime64(drive.start_t_ns, "ns"), unit="s")
        median_s = float(np.median(np.diff(m.imu_t_ns))) * 1e-9 if len(m.imu_t_ns) > 1 else float("nan")
        facts = [
            ("drive", drive.name),
            ("vehicle", drive.vehicle_id),
            ("start", f"{start} UTC"),
            ("length", f"{found['duration_s']:.1f} s, {distance_m(self.fused.track) / 1000:.2f} km"),
            ("inertial samples", f"{found['epochs']} at {number(1.0 / median_s, 'Hz', 0)}"),
            ("GNSS fixes", str(int(np.isfinite(m.gnss[:, GNSS["lat_rad"]]).sum()))),
            ("wheel speeds", str(len(m.speed_t_ns))),
            ("magnetometer samples", str(len(m.magnetometer_t_ns))),
            ("reference", "none" if drive.reference is None else f"{len(drive.reference.t_ns)} rows"),
            ("trajectory", "smoothed" if self.solution is not None and self.solution.smoothed else "causal"),
            ("aligned after", number(found["aligned_after_s"], "s", 1)),
            ("error against", found["against"] or "nothing to compare with"),
            ("horizontal error, RMS", number(found["position_rms_m"] or found.get("gnss_rms_m"), "m")),
            ("same without a constant offset", number(found.get("position_rms_offset_removed_m"), "m")),
            ("heading error, RMS", number(found["yaw_rms_deg"], "°")),
            ("error in outages, RMS", number(found["outage_rms_m"], "m")),
            ("error in outages, greatest", number(found["outage_max_m"], "m")),
            ("accidents", str(len(self.fused.accidents))),
            ("filter", f"{found['ns_per_epoch']:.0f} ns a sample"),
            ("made by", ", ".join(f"{name} {version(name)}" for name in _LIBRARIES) + f", Python {_python()}"),
        ]
        return Section("Summary", [], [Table("Drive and key figures", [], facts, prose=True)])

    def _settings(self) -> Section:
        config = self.config
        mounting = "roll {:.2f}°, pitch {:.2f}°, yaw {:.2f}°".format(*np.degrees(config.mounting.rpy_rad))
        switches = [
            ("mounting", mounting if config.mounting.known else "not given, to be found"),
            ("IMU in the body", _vector(config.filter.imu_lever_b_m)),
            ("antenna in the body", _vector(config.filter.antenna_lever_b_m)),
            ("GNSS time offset", f"{config.filter.gnss_time_offset_s:g} s"),
            ("accelerometer clips at", number(config.accel_full_scale_mps2, "m/s²", 1)),
            ("non-holonomic constraints", "on" if config.filter.non_holonomic else "off"),
            ("zero-velocity updates", "on" if config.filter.zero_velocity else "off"),
            ("denoising", "on" if "denoise" in self.figures else "off"),
            ("accident detector", config.detector),
        ]
        tuning = config.filter.tuning
        return Section(
            "Settings",
            [],
            [
                Table("What was given and switched", [], switches, prose=True),
                _tunables("Tunables of the navigation, with where each comes from", tuning),
            ],
        )


def _tunables(caption: str, values: Tunables) -> Table:
    rows = []
    for known in describe(type(values)):
        value = getattr(values, known.name)
        unit = "" if known.unit == "1" else known.unit
        changed = "" if value == known.default else f" (default {known.default:g})"
        rows.append([known.name, f"{value:g}{changed}", unit, f"{known.low:g} to {known.high:g}", known.source])
    return Table(caption, ["name", "value", "unit", "range", "source"], rows, folded=True, prose=True)


def _accidents(accidents: Sequence[Accident], start_t_ns: int) -> Section:
    rows = [
        [
            f"{(one.impact.t_ns - start_t_ns) * 1e-9:.2f} s",
            one.impact.severity.value,
            number(one.impact.confidence),
            f"{number(one.impact.delta_v_mps, 'm/s', 1)} ± {number(one.impact.delta_v_sd_mps, '', 1)}",
            number(one.impact.pdof_deg, "°", 0),
            f"{number(float(np.degrees(one.place.lat_rad)), '°', 7)}, "
            f"{number(float(np.degrees(one.place.lon_rad)), '°', 7)}",
            f"{number(one.place.sd_n_m, 'm', 1)}, {number(one.place.sd_e_m, 'm', 1)}",
            one.place.mode.name.lower(),
        ]
        for one in accidents
    ]
    if not rows:
        return Section("Accidents", ["None found."])
    header = ["at", "severity", "confidence", "Δv ± sd", "from", "latitude, longitude", "sd north, east", "mode"]
    return Section("Accidents", [], [Table("Accidents", header, rows, prose=True)])


def _vector(metres: tuple[float, float, float]) -> str:
    forward, right, down = metres
    return f"forward {forward:g} m, right {right:g} m, down {down:g} m"


def _python() -> str:
    return platform.python_version()
