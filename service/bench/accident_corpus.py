"""Detectors on the corpus: accidents of every class and non-accidents of every kind, in boxes of all sorts."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

from core.simulation.accident_classes import CLASSES
from core.simulation.corpus import accident_case, quiet_case
from core.simulation.disturbances import NonAccident
from core.simulation.handling import SOURCES
from service.bench.accident_scoring import (
    DETECTORS,
    accident_figures,
    accident_record,
    listen,
    quiet_figures,
    quiet_record,
    reliability,
)
from service.bench.processes import in_processes
from service.bench.simulated_outages import Tell

ACCIDENTS: Final = 50
"""Of each class: 650 in all."""
QUIET: Final = 50
"""Of each kind: 900 in all."""
_AT_ONCE: Final = 10


def measure(tell: Tell, accidents: int = ACCIDENTS, quiet: int = QUIET) -> dict[str, Any]:
    """Figures of each detector over the same cases."""
    jobs = [*_jobs(list(CLASSES), accidents), *_jobs(list(SOURCES), quiet)]
    found = {name: ([], []) for name in DETECTORS}  # type: dict[str, tuple[list[Any], list[Any]]]
    for done, part in enumerate(in_processes(_judge, jobs)):
        tell(done + 1, len(jobs))
        for name, (told, silent) in part.items():
            found[name][0].extend(told)
            found[name][1].extend(silent)
    return {
        name: accident_figures(told) | {"quiet": quiet_figures(silent), "reliability": reliability([*told, *silent])}
        for name, (told, silent) in found.items()
    }


def _jobs(names: list[Any], each: int) -> Iterator[tuple[str, int, int]]:
    for name in names:
        for first in range(0, each, _AT_ONCE):
            yield str(name), first, min(first + _AT_ONCE, each)


def _judge(job: tuple[str, int, int]) -> dict[str, tuple[list[Any], list[Any]]]:
    """Records of accidents and of non-accidents by detector, for some seeds of a class or kind."""
    name, first, end = job
    found: dict[str, tuple[list[Any], list[Any]]] = {detector: ([], []) for detector in DETECTORS}
    for seed in range(first, end):
        if name in CLASSES:
            accident = accident_case(name, seed)
            for detector, (told, _) in found.items():
                heard = listen(detector, [accident.motion])
                record = accident_record(accident.truth, accident.t_ns, accident.clipped, *heard)
                told.append(record | {"seed": seed, "excess_mps": accident.excess_mps})
        else:
            case = quiet_case(NonAccident(name), seed)
            for detector, (_, silent) in found.items():
                heard = listen(detector, [case.motion])
                silent.append(quiet_record(case.kind, case.begin_ns, case.end_ns, *heard) | {"seed": seed})
    return found
