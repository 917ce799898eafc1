"""Whether what is said with 90 % is so in 90 %: on cases in which little is plain, fitted on half of them, shown on the
other. Weak accidents, ordinary ones, what is hard to tell from them, and the candidates of long drives."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import Any, Final, NamedTuple

import numpy as np
from scipy.optimize import minimize

from core.accident.thresholds import JudgementThresholds
from core.measurements import FloatArray
from core.simulation.accident_classes import CLASSES
from core.simulation.corpus import WEAK_CLASSES, accident_case, quiet_case, weak_case
from core.simulation.disturbances import NonAccident
from core.simulation.long_drive import PIECE_KM, drive_piece
from service.bench.accident_scoring import OURS, accident_record, listen, quiet_record, share
from service.bench.processes import in_processes
from service.bench.simulated_outages import Tell

HARD: Final = (
    NonAccident.KERB, NonAccident.POTHOLE, NonAccident.SPEED_BUMP, NonAccident.PARKING_BUMP,
    NonAccident.EMERGENCY_BRAKING, NonAccident.SENSOR_GLITCH, NonAccident.TRAILER_COUPLING, NonAccident.BOX_KNOCKED,
    NonAccident.DOOR_SLAM, NonAccident.TOW,
)  # fmt: skip
"""Non-accidents that leave a change of velocity, or look as if."""
WEAK: Final = 60
"""Of each class of weak accidents, and of each hard non-accident."""
ORDINARY: Final = 16
"""Of each class of the corpus."""
KM: Final = 5000.0
FIRST: Final = 20_000
"""Seeds and pieces from here on: none of them made anything."""
EDGES: Final = (0.0, 0.02, 0.1, 0.3, 0.5, 0.7, 0.8, 0.9, 0.95, 0.99, 1.0)
_AT_ONCE: Final = 4


class _Job(NamedTuple):
    form: str
    name: str
    first: int
    end: int


class _Row(NamedTuple):
    """What was said at once and in the end to be an accident, and whether it was."""

    seed: int
    form: str
    first: float
    last: float
    true: bool


def measure(
    tell: Tell, weak: int = WEAK, ordinary: int = ORDINARY, km: float = KM, first: int = FIRST
) -> dict[str, Any]:
    """The diagram of odd seeds, and the line that fits the even ones best: as told at once, and in the end."""
    jobs = list(_jobs(weak, ordinary, math.ceil(km / PIECE_KM), first))
    rows: list[_Row] = []
    for done, part in enumerate(in_processes(_judge, jobs)):
        tell(done + 1, len(jobs))
        rows.extend(part)
    fitted, shown = ([row for row in rows if row.seed % 2 == half] for half in (0, 1))
    forms = dict.fromkeys(row.form for row in rows)
    return {
        "from": {form: sum(row.form == form for row in rows) for form in forms},
        "first": diagram([(row.first, row.true) for row in shown])
        | {"fit": line([(row.first, row.true) for row in fitted])},
        "last": diagram([(row.last, row.true) for row in shown])
        | {"fit": line([(row.last, row.true) for row in fitted])},
    }


def _jobs(weak: int, ordinary: int, pieces: int, first: int) -> Iterable[_Job]:
    drawn: Sequence[tuple[str, Iterable[str], int]] = (
        ("weak", WEAK_CLASSES, weak), ("accident", CLASSES, ordinary), ("quiet", HARD, weak), ("drive", ("",), pieces),
    )  # fmt: skip
    for form, names, each in drawn:
        for name in names:
            for at in range(first, first + each, _AT_ONCE):
                yield _Job(form, str(name), at, min(at + _AT_ONCE, first + each))


def _judge(job: _Job) -> list[_Row]:
    """A row of each probability that was told."""
    return [
        _Row(seed, job.form, *row)
        for seed in range(job.first, job.end)
        for record in _records(job, seed)
        for row in record["probabilities"]
    ]


def _records(job: _Job, seed: int) -> list[dict[str, Any]]:
    if job.form == "drive":
        piece = drive_piece(seed)
        told = listen(OURS, piece.motions)
        return [quiet_record(one.kind, one.begin_ns, one.end_ns, *told) for one in piece.happenings]
    if job.form == "quiet":
        case = quiet_case(NonAccident(job.name), seed)
        return [quiet_record(case.kind, case.begin_ns, case.end_ns, *listen(OURS, [case.motion]))]
    accident = weak_case(job.name, seed) if job.form == "weak" else accident_case(job.name, seed)
    return [accident_record(accident.truth, accident.t_ns, accident.clipped, *listen(OURS, [accident.motion]))]


def diagram(rows: Sequence[tuple[float, bool]]) -> dict[str, Any]:
    """Probability said against share that came true, by bins; Brier's score and the expected error of calibration."""
    said, true = (np.array(column, dtype=float) for column in zip(*rows, strict=True))
    bins, error = [], 0.0
    for low, high in pairwise(EDGES):
        inside = (said >= low) & ((said < high) | (high == 1.0))
        if inside.any():
            mean = float(said[inside].mean())
            accidents = share(true[inside] > 0.5)
            bins.append({"from": low, "to": high, "count": int(inside.sum()), "said": mean, "accidents": accidents})
            error += float(inside.mean()) * abs(mean - float(true[inside].mean()))
    return {
        "count": len(rows),
        "middling": int(np.sum((said > 0.1) & (said < 0.9))),
        "brier": float(np.mean((said - true) ** 2)),
        "ece": error,
        "bins": bins,
    }


def line(rows: Sequence[tuple[float, bool]]) -> dict[str, float]:
    """Slope and shift of log-odds by which these would come true best (Platt 1999), with their spreads.

    Of a probability that is said with ``told_slope`` and ``told_shift``; what would be said in their place.
    """
    limits = JudgementThresholds()
    said, true = (np.array(column, dtype=float) for column in zip(*rows, strict=True))
    said = np.clip(said, 1e-9, 1.0 - 1e-9)
    odds = (np.log(said / (1.0 - said)) - limits.told_shift) / limits.told_slope

    def loss(x: FloatArray) -> float:
        z = np.where(true > 0.5, 1.0, -1.0) * (x[0] * odds + x[1])
        return float(np.sum(np.logaddexp(0.0, -z)))

    best = minimize(loss, np.array([limits.told_slope, limits.told_shift]), method="BFGS")
    slope_sd, shift_sd = np.sqrt(np.diag(best.hess_inv))
    return {
        "slope": float(best.x[0]), "slope_sd": float(slope_sd), "shift": float(best.x[1]), "shift_sd": float(shift_sd),
    }  # fmt: skip
