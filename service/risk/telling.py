"""An assessed drive in figures, in words and as a table of instants."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from core.measurements import FloatArray
from core.risk.assessment import RiskModel
from core.risk.belief import ABSTAINED, PROPOSITIONS, SINGLETONS, THETA, decide, named, pignistic
from core.risk.driver import Driver
from core.risk.lookup import DRIVER, ENVIRONMENT
from service.recordings.csv_tables import format_table, time_column
from service.recordings.drive_folder import Drive
from service.risk.assessing import AssessedDrive

_OPTIONS: Final = {"age": "--driver-age", "sex": "--driver-sex", "experience": "--driver-experience"}
_BY_ROADS: Final = ("road", "surroundings", "district")


def figures(assessed: AssessedDrive, model: RiskModel, driver: Driver, source: str) -> dict[str, Any]:
    """Figures as ``telefuse risk assess --json`` prints them (INTERFACES, section 8)."""
    assessment = assessed.assessment
    theta = assessment.fused[:, THETA]
    mean = assessment.fused.mean(axis=0)
    chances = pignistic(mean)
    outside = ~assessed.in_outage
    return {
        "source": source,
        "preset": model.tables.name,
        "rule": model.rule,
        "mean": named(mean),
        "max_theta": float(theta.max()),
        "max_theta_outside_outages": float(theta[outside].max()) if outside.any() else None,
        "conflict": float(mean[0]),
        "conflict_redistributed": float(assessment.conflict.mean()),
        "instants": len(theta),
        "pignistic": _by_singleton(chances),
        "decision": _choice(decide(mean, abstain=False)),
        "sure": _choice(decide(mean)),
        "entities": {name: named(mass.mean(axis=0)) for name, mass in assessment.entities.items()},
        "attribution": {name: _by_singleton(share) for name, share in assessment.attribution(model.rule).items()},
        "coverage": {name: float(share.mean()) for name, share in assessment.coverage.items()},
        "left_out": left_out(assessed, model, driver),
        "utc_offset_s": assessed.environment.utc_offset_s,
    }


def left_out(assessed: AssessedDrive, model: RiskModel, driver: Driver) -> list[str]:
    """What had no part in the assessment, or hardly any, with the reason: a line each."""
    coverage, lines = assessed.assessment.coverage, []
    given = {name for name, values in driver.values().items() if values[0] == values[0] and values[0] != ""}
    for table in model.tables.of(DRIVER):
        if coverage[f"{DRIVER}.{table.name}"].any():
            continue
        missing = [name for name in table.inputs if name not in given]
        options = ", ".join(_OPTIONS[name] for name in missing)
        why = f"{' and '.join(missing)} not given ({options})" if missing else _not_in(table.name, model, driver)
        lines.append(f"{DRIVER}.{table.name}: {why}")
    road = assessed.environment.road
    mapped = bool((road.kind != "").any() or (road.district != "").any())
    for table in model.tables.of(ENVIRONMENT):
        if coverage[f"{ENVIRONMENT}.{table.name}"].any():
            continue
        if not mapped and any(name in _BY_ROADS for name in table.inputs):
            why = "roads are unknown (--roads)"
        elif table.inputs == ("district",):
            names = sorted(set(road.district) - {""})
            known = ", ".join(table.words)
            there = f"not for {', '.join(names)}" if names else "and the map names none here"
            why = f"table '{table.name}' is for {known}, {there}"
        else:
            why = f"table '{table.name}' of {model.tables.name} has nothing for this drive's {', '.join(table.inputs)}"
        lines.append(f"{ENVIRONMENT}.{table.name}: {why}")
    if not np.isfinite(road.limit_kmh).any():
        why = "limits are unknown here" if mapped else "roads are unknown (--roads)"
        lines.append(f"vehicle.speed: {why}")
    if assessed.assessment.vehicle.bad_limits:
        lines.append(f"vehicle.speed: {assessed.assessment.vehicle.bad_limits} instants with a limit that is none")
    if assessed.local_by_longitude:
        hours = assessed.environment.utc_offset_s / 3600.0
        lines.append(f"local time: taken for UTC{hours:+g} h by longitude (--start with an offset says better)")
    return lines


def text(drive: Drive, found: Mapping[str, Any]) -> str:
    """The figures for people."""
    lines = [f"{drive.name}: {found['instants']} instants by {found['source']}, preset {found['preset']}", ""]
    lines += [f"  {_label(name):12}{mass:10.4f}" for name, mass in found["mean"].items()]
    lines += [
        "",
        f"most on Θ {found['max_theta']:.4f}; conflict redistributed {found['conflict_redistributed']:.4f}",
        "pignistic "
        + ", ".join(f"{name} {p:.4f}" for name, p in found["pignistic"].items())
        + f": {found['decision'] or 'undecided'}"
        + ("" if found["sure"] else ", intervals overlap"),
        "coverage " + ", ".join(f"{name} {share:.3f}" for name, share in found["coverage"].items()),
    ]
    return "\n".join([*lines, *(f"left out: {line}" for line in found["left_out"])])


def table_1(drive: Drive, columns: Mapping[str, Mapping[str, Any]]) -> str:
    """Mean masses of several sources side by side, as the paper's table I."""
    names = list(columns)
    lines = [f"{drive.name}: mean masses of {next(iter(columns.values()))['instants']} instants", ""]
    lines.append(f"  {'':12}" + "".join(f"{name:>12}" for name in names))
    lines += [
        f"  {_label(name):12}" + "".join(f"{columns[one]['mean'][name]:12.4f}" for one in names)
        for name in PROPOSITIONS
    ]
    lines.append(f"  {'max Θ':12}" + "".join(f"{columns[one]['max_theta']:12.4f}" for one in names))
    if "fused" in columns and "reference" in columns:
        lines += ["", f"  fused and reference differ by {difference(columns):.5f} at most"]
    return "\n".join([*lines, "", *(f"left out: {line}" for line in columns[names[0]]["left_out"])])


def difference(columns: Mapping[str, Mapping[str, Any]]) -> float:
    """The greatest difference of a mean mass between fused and reference."""
    fused, reference = columns["fused"]["mean"], columns["reference"]["mean"]
    return float(max(abs(fused[name] - reference[name]) for name in PROPOSITIONS))


def timeline(drive: Drive, assessed: AssessedDrive) -> str:
    """Every instant as CSV: motion, road, risks of the three systems, masses of all levels, coverage."""
    instants, road, assessment = assessed.instants, assessed.environment.road, assessed.assessment
    vehicle, motion = assessment.vehicle, instants.motion
    columns: dict[str, Any] = {
        "t_s": time_column(instants.t_ns, drive.start_t_ns),
        "lat_deg": (np.degrees(instants.lat_rad), "%.8f"),
        "lon_deg": (np.degrees(instants.lon_rad), "%.8f"),
        "in_outage": (assessed.in_outage.astype(int), "%d"),
        "speed_mps": (motion.speed_mps, "%.4f"),
        "forward_mps2": (motion.forward_mps2, "%.4f"),
        "right_mps2": (motion.right_mps2, "%.4f"),
        "limit_kmh": (np.where(np.isfinite(road.limit_kmh), road.limit_kmh, np.nan), "%.0f"),
        "excess_kmh": (np.where(np.isfinite(vehicle.excess_kmh), vehicle.excess_kmh, np.nan), "%.3f"),
        "road": (road.kind, "%s"),
        "surroundings": (road.surroundings, "%s"),
        "district": (np.array([_cell(name) for name in road.district]), "%s"),
        "sun_deg": (np.degrees(assessed.environment.sun_rad()), "%.3f"),
        "speed_risk": (vehicle.speed_risk, "%.6f"),
        "motion_risk": (vehicle.motion_risk, "%.6f"),
        "vehicle_risk": (vehicle.risk, "%.6f"),
    }
    levels = {"": assessment.fused} | {f"{name}_": mass for name, mass in assessment.entities.items()}
    for prefix, mass in levels.items():
        for index, name in enumerate(PROPOSITIONS):
            columns[f"{prefix}mass_{name or 'empty'}"] = (mass[:, index], "%.9f")
    for index, name in enumerate(SINGLETONS):
        columns[f"pignistic_{name}"] = (pignistic(assessment.fused)[:, index], "%.9f")
    columns["sure"] = (np.array(["", *SINGLETONS])[decide(assessment.fused) + 1], "%s")
    for name, share in assessment.coverage.items():
        columns[f"coverage_{name}"] = (share, "%.6f")
    return format_table(columns)


def _not_in(name: str, model: RiskModel, driver: Driver) -> str:
    table = next(one for one in model.tables.tables if one.name == name)
    given = ", ".join(f"{key} {driver.values()[key][0]}" for key in table.inputs)
    return f"table '{name}' of {model.tables.name} has no row for {given}"


def _label(name: str) -> str:
    return {"": "conflict", PROPOSITIONS[THETA]: "Θ"}.get(name, name.replace("|", " ∪ "))


def _cell(name: str) -> str:
    return '"' + name.replace('"', '""') + '"' if any(c in name for c in ',"\n') else name


def _choice(place: Any) -> str | None:
    return None if int(place) == ABSTAINED else SINGLETONS[int(place)]


def _by_singleton(values: FloatArray) -> dict[str, float | None]:
    return {name: None if math.isnan(v) else float(v) for name, v in zip(SINGLETONS, values, strict=True)}
