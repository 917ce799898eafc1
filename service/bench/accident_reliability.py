"""Whether what is said with 90 % is so in 90 %: fitted on half of cases in which little is plain, shown on the other.

Weak accidents and ordinary ones, and the candidates of drives crowded with what is none, weighed as they occur."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import Any, Final, NamedTuple

import numpy as np
from scipy.optimize import minimize

from core.accident.weights import JudgementThresholds
from core.measurements import FloatArray
from core.simulation.accident_classes import CLASSES
from core.simulation.corpus import WEAK_CLASSES, accident_case, weak_case
from core.simulation.long_drive import PIECE_KM, drive_piece
from core.simulation.long_script import Density
from service.bench.accident_scoring import OURS, accident_record, listen, proportion_interval, quiet_record
from service.bench.processes import in_processes
from service.bench.simulated_outages import Tell

CROWDED: Final = Density(
    pothole=80.0, speed_bump=30.0, kerb=60.0, railway_crossing=10.0, vibration=20.0, parking_bump=60.0, door_slam=20.0,
    boot_slam=8.0, emergency_braking=60.0, hard_cornering=20.0, swerve=20.0, tow=1.0, box_knocked=30.0,
    sensor_glitch=40.0, ferry=0.2, car_wash=1.0, trailer_coupling=20.0,
)  # fmt: skip
"""Non-accidents of the drives, many times those of ``Density``: each counts for as much less."""
WEAK: Final = 20
"""Of each class of weak accidents."""
ORDINARY: Final = 8
"""Of each class of the corpus."""
KM: Final = 1000.0
FIRST: Final = 20_000
"""Seeds and pieces from here on: none of them made anything."""
ACCIDENTS: Final = 40.0
"""In 100 000 km of the long drives, half of them weak. Their non-accidents are some twenty times the world's, and there
a vehicle has about 2 in 100 000 km: 0.25 that the police record (NHTSA 2019: 6.75 million crashes in 5.2e12 km, two
vehicles each), as many again that are not reported, and more knocks in car parks (choice)."""
EDGES: Final = (0.0, 0.02, 0.1, 0.3, 0.5, 0.7, 0.8, 0.9, 0.95, 0.99, 1.0)
_AT_ONCE: Final = 4


class _Job(NamedTuple):
    form: str
    name: str
    first: int
    end: int


class _Row(NamedTuple):
    """What was said at once and in the end to be an accident, whether it was, and how often it is for each drawn."""

    seed: int
    form: str
    first: float
    last: float
    true: bool
    weight: float


def measure(
    tell: Tell, weak: int = WEAK, ordinary: int = ORDINARY, km: float = KM, first: int = FIRST
) -> dict[str, Any]:
    """The diagram of odd seeds, and the line that fits the even ones best: as told at once, and in the end."""
    pieces = math.ceil(km / PIECE_KM)
    jobs = list(_jobs(weak, ordinary, pieces, first))
    each = {"weak": weak * len(WEAK_CLASSES), "accident": ordinary * len(CLASSES), "drive": pieces * PIECE_KM / 1e5}
    rows: list[_Row] = []
    for done, part in enumerate(in_processes(_judge, jobs)):
        tell(done + 1, len(jobs))
        rows.extend(row._replace(weight=row.weight / each[row.form]) for row in part)
    fitted, shown = ([row for row in rows if row.seed % 2 == half] for half in (0, 1))
    return {
        "from": {form: sum(row.form == form for row in rows) for form in each},
        "first": diagram([(row.first, row.true, row.weight) for row in shown])
        | {"fit": line([(row.first, row.true, row.weight) for row in fitted])},
        "last": diagram([(row.last, row.true, row.weight) for row in shown])
        | {"fit": line([(row.last, row.true, row.weight) for row in fitted])},
    }


def _jobs(weak: int, ordinary: int, pieces: int, first: int) -> Iterable[_Job]:
    drawn: Sequence[tuple[str, Iterable[str], int]] = (
        ("weak", WEAK_CLASSES, weak), ("accident", CLASSES, ordinary), ("drive", ("",), pieces),
    )  # fmt: skip
    for form, names, each in drawn:
        for name in names:
            for at in range(first, first + each, _AT_ONCE):
                yield _Job(form, str(name), at, min(at + _AT_ONCE, first + each))


def _judge(job: _Job) -> list[_Row]:
    """A row of each probability that was told, weighed against the others of its form."""
    return [
        _Row(seed, job.form, first, last, true, weight)
        for seed in range(job.first, job.end)
        for record, weight in _records(job, seed)
        for first, last, true in record["probabilities"]
    ]


def _records(job: _Job, seed: int) -> Iterable[tuple[dict[str, Any], float]]:
    if job.form == "drive":
        piece, usual = drive_piece(seed, CROWDED), Density()
        told = listen(OURS, piece.motions)
        for one in piece.happenings:
            crowd = getattr(CROWDED, one.kind.value) / getattr(usual, one.kind.value)
            yield quiet_record(one.kind, one.begin_ns, one.end_ns, *told), 1.0 / crowd
        return
    accident = weak_case(job.name, seed) if job.form == "weak" else accident_case(job.name, seed)
    told = listen(OURS, [accident.motion])
    yield accident_record(accident.truth, accident.t_ns, accident.clipped, *told), 0.5 * ACCIDENTS


def diagram(rows: Sequence[tuple[float, bool, float]]) -> dict[str, Any]:
    """Probability said against share that came true, by bins; Brier's score and the expected error of calibration.

    Of rows of what was said, whether it came true, and their weight; intervals are those of as many even ones as would
    scatter as much (Kish 1965).
    """
    said, true, weight = (np.array(column, dtype=float) for column in zip(*rows, strict=True))
    bins, error = [], 0.0
    for low, high in pairwise(EDGES):
        inside = (said >= low) & ((said < high) | (high == 1.0))
        if inside.any():
            w = weight[inside]
            mean, came = float(np.average(said[inside], weights=w)), float(np.average(true[inside], weights=w))
            bins.append(
                {"from": low, "to": high, "count": int(inside.sum()), "said": mean, "accidents": _interval(came, w)}
            )
            error += float(w.sum() / weight.sum()) * abs(mean - came)
    return {
        "count": len(rows),
        "middling": int(np.sum((said > 0.1) & (said < 0.9))),
        "brier": float(np.average((said - true) ** 2, weights=weight)),
        "ece": error,
        "bins": bins,
    }


def _interval(came: float, weight: FloatArray) -> dict[str, float]:
    """A share with its 95 % interval."""
    n = float(weight.sum()) ** 2 / float(np.sum(weight * weight))
    low, high = proportion_interval(came * n, n)
    return {"share": came, "low": low, "high": high}


def line(rows: Sequence[tuple[float, bool, float]]) -> dict[str, float]:
    """Slope and shift of log-odds by which weighed rows would come true best (Platt 1999): what would be said in the
    place of ``told_slope`` and ``told_shift``."""
    limits = JudgementThresholds()
    said, true, weight = (np.array(column, dtype=float) for column in zip(*rows, strict=True))
    said = np.clip(said, 1e-9, 1.0 - 1e-9)
    odds = (np.log(said / (1.0 - said)) - limits.told_shift) / limits.told_slope

    def loss(x: FloatArray) -> float:
        z = np.where(true > 0.5, 1.0, -1.0) * (x[0] * odds + x[1])
        return float(np.sum(weight * np.logaddexp(0.0, -z)))

    best = minimize(loss, np.array([limits.told_slope, limits.told_shift]), method="BFGS")
    return {"slope": float(best.x[0]), "shift": float(best.x[1])}
