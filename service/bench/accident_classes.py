"""The detector with each class of vehicle's profile on that class' accidents, non-accidents and long drives."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any, Final, NamedTuple

from core.accident.detector import ImpactDetector
from core.accident.profiles import for_vehicle
from core.simulation.class_accidents import CLASSES_BY_VEHICLE, FALLS
from core.simulation.class_disturbances import SOURCES_BY_CLASS
from core.simulation.corpus import accident_case, quiet_case
from core.simulation.disturbances import NonAccident
from core.simulation.long_drive import PIECE_KM, drive_piece
from service.bench.accident_scoring import (
    accident_figures,
    accident_record,
    heard,
    quiet_figures,
    quiet_record,
    rate,
    share,
)
from service.bench.processes import in_processes
from service.bench.simulated_outages import Tell

CLASSES: Final = tuple(name for name in CLASSES_BY_VEHICLE if name != "car")
"""Of cars the corpus and the long drives tell."""
ACCIDENTS: Final = 20
"""Of each kind of accident that befalls a class."""
QUIET: Final = 10
KM: Final = 2000.0
"""Of long drives, each class."""
FIRST: Final = 1000
"""Seeds and pieces from here on: those before were looked at when the profiles were made."""
_AT_ONCE: Final = 5


class _Job(NamedTuple):
    vehicle: str
    form: str
    """``accident``, ``quiet`` or ``drive``."""
    name: str
    first: int
    end: int


def measure(
    tell: Tell, accidents: int = ACCIDENTS, quiet: int = QUIET, km: float = KM, first: int = FIRST
) -> dict[str, Any]:
    """Figures by class of vehicle, over cases and pieces from seed ``first`` on."""
    jobs = list(_jobs(accidents, quiet, math.ceil(km / PIECE_KM), first))
    found: dict[str, dict[str, list[Any]]] = {name: {"accident": [], "quiet": [], "drive": []} for name in CLASSES}
    for done, (job, records) in enumerate(zip(jobs, in_processes(_judge, jobs), strict=True)):
        tell(done + 1, len(jobs))
        found[job.vehicle][job.form].extend(records)
    return {name: _figures(**parts) for name, parts in found.items()}


def _jobs(accidents: int, quiet: int, pieces: int, first: int) -> Iterable[_Job]:
    for vehicle in CLASSES:
        for form, names, each in (
            ("accident", CLASSES_BY_VEHICLE[vehicle], accidents),
            ("quiet", SOURCES_BY_CLASS[vehicle], quiet),
            ("drive", ("",), pieces),
        ):
            for name in names:
                for at in range(first, first + each, _AT_ONCE):
                    yield _Job(vehicle, form, str(name), at, min(at + _AT_ONCE, first + each))


def _judge(job: _Job) -> list[dict[str, Any]]:
    return [_record(job, seed) for seed in range(job.first, job.end)]


def _record(job: _Job, seed: int) -> dict[str, Any]:
    detector = ImpactDetector(for_vehicle(job.vehicle))
    if job.form == "accident":
        accident = accident_case(job.name, seed, vehicle=job.vehicle)
        told = heard(detector, [accident.motion])
        return accident_record(accident.truth, accident.t_ns, accident.clipped, *told) | {
            "seed": seed,
            "excess_mps": accident.excess_mps,
        }
    if job.form == "quiet":
        case = quiet_case(NonAccident(job.name), seed, vehicle=job.vehicle)
        told = heard(detector, [case.motion])
        return quiet_record(case.kind, case.begin_ns, case.end_ns, *told) | {"seed": seed}
    piece = drive_piece(seed, vehicle=job.vehicle)
    stories, candidates = heard(detector, piece.motions)
    return {
        "seed": seed,
        "km": piece.distance_m / 1e3,
        "alarms": [(one.first.t_ns, one.stands) for one in stories],
        "quiet": [quiet_record(one.kind, one.begin_ns, one.end_ns, stories, candidates) for one in piece.happenings],
    }


def _figures(
    accident: list[dict[str, Any]], quiet: list[dict[str, Any]], drive: list[dict[str, Any]]
) -> dict[str, Any]:
    """Falls have no blow whose change of velocity could be told: they are found, or not, and told as lying."""
    falls = [one for one in accident if one["class"] in FALLS]
    blows = [one for one in accident if one["class"] not in FALLS]
    km = sum(one["km"] for one in drive)
    alarms = [(one["seed"], *alarm) for one in drive for alarm in one["alarms"]]
    found = accident_figures(blows)
    told = [one for one in blows if one["found"]]
    found["delta_v_unclipped"]["outside"] = share([_off(one) for one in told if not one["clipped"]])
    found["direction"]["outside"] = share([one["direction_error_deg"] > 15.0 for one in told])
    found["delay"]["late_share"] = share([one["delay_s"] > 0.150 for one in told])
    return found | {
        "falls": share([one["found"] for one in falls]),
        "missed": [(one["class"], one["seed"], round(one["delta_v_mps"], 2)) for one in accident if not one["found"]],
        "quiet": quiet_figures(quiet),
        "wrong": [(one["kind"], one["seed"]) for one in quiet if one["false_alarms"]],
        "km": km,
        "false_alarms": rate(sum(stands for _, _, stands in alarms), km),
        "withdrawn": rate(sum(not stands for _, _, stands in alarms), km),
        "shown": [(seed, t_ns) for seed, t_ns, stands in alarms if stands],
        "long": quiet_figures([one for piece in drive for one in piece["quiet"]]),
    }


def _off(one: dict[str, Any]) -> bool:
    """Whether a change of velocity is told off by more than 10 % and 1 km/h."""
    return bool(abs(one["delta_v_error_mps"]) > max(0.1 * one["delta_v_mps"], 1.0 / 3.6))
