"""Which of a trip's manoeuvres count against its driver, and what its accidents explain."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

from core.driving.manoeuvres import Episode, Manoeuvre, explained
from core.scoring.record import Evidence, Record
from service.storage.accidents import AccidentRow
from service.storage.manoeuvres import CONFIRMED, DEFENSIVE, FALSE, ManoeuvreRow

BY_ACCIDENT: Final = "accident"
BY_REVIEWER: Final = "reviewer"
_WEIGHTS: Final[Mapping[str, int]] = {"low_speed": 1, "severe": 2, "airbag": 3}


def with_events(
    record: Record, manoeuvres: Sequence[ManoeuvreRow], accidents: Sequence[AccidentRow]
) -> tuple[Record, dict[str, str | None]]:
    """A record with these manoeuvres and accidents in the place of its own, and why manoeuvres do not count.

    An accident explains the braking and swerving before it, and whatever it happened in the midst of. Candidates
    explain nothing: who brakes hard because of a hazard and who does for no reason feel alike, and it is for a reviewer
    to say which it was.
    """
    standing = [one for one in accidents if not one.is_none]
    reasons = _excuses(manoeuvres, [one.t_ns for one in standing])
    counted = [one for one in manoeuvres if one.aggressive and one.counted and one.verdict != FALSE]
    blamed = [one for one in counted if reasons[one.id] is None]
    of_others = {about: told for about, told in record.evidence.items() if about not in (*Manoeuvre, "accidents")}
    evidence = {
        str(kind): tuple(
            Evidence(round(1e3 * one.peak_mps2), "manoeuvre", one.id) for one in blamed if one.kind == kind
        )
        for kind in Manoeuvre
    }
    evidence["accidents"] = tuple(Evidence(_WEIGHTS.get(one.severity, 1), "accident", one.id) for one in standing)
    counts = replace(
        Record(),
        manoeuvres=dict(sorted(Counter(one.kind for one in blamed).items())),
        excused=dict(sorted(Counter(one.kind for one in counted if reasons[one.id] is not None).items())),
        accidents=dict(sorted(Counter(one.severity for one in standing).items())),
        evidence={about: told for about, told in evidence.items() if told},
    )
    bare = replace(record, manoeuvres={}, excused={}, accidents={}, evidence=of_others)
    return bare + counts, reasons  # added, so that only the heaviest evidence stays


def _excuses(manoeuvres: Sequence[ManoeuvreRow], accidents_ns: Sequence[int]) -> dict[str, str | None]:
    evasive = explained([_episode(one) for one in manoeuvres], accidents_ns)
    reasons: dict[str, str | None] = {}
    for row, episode in zip(manoeuvres, evasive, strict=True):
        struck = any(row.start_ns <= t_ns <= row.end_ns for t_ns in accidents_ns)
        if row.verdict == CONFIRMED or row.verdict == FALSE:
            reasons[row.id] = None
        elif row.verdict == DEFENSIVE:
            reasons[row.id] = BY_REVIEWER
        else:
            reasons[row.id] = BY_ACCIDENT if episode.defensive or struck else None
    return reasons


def _episode(row: ManoeuvreRow) -> Episode:
    def number(value: float | None) -> float:
        return math.nan if value is None else value

    return Episode(
        kind=Manoeuvre(row.kind),
        start_t_ns=row.start_ns,
        peak_t_ns=row.peak_ns,
        end_t_ns=row.end_ns,
        peak_mps2=row.peak_mps2,
        direction=row.direction,
        aggressive=row.aggressive,
        speed_before_mps=number(row.speed_before_mps),
        speed_after_mps=number(row.speed_after_mps),
        speed_at_peak_mps=number(row.speed_at_peak_mps),
        across_mps2=number(row.across_mps2),
        radius_m=number(row.radius_m),
        heading_change_rad=math.radians(number(row.heading_change_deg)),
        counted=row.counted,
        recovery=row.recovery,
    )
