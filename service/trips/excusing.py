"""Which of a trip's manoeuvres count against its driver, and what accidents and hazards explain."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

from core.driving.manoeuvres import Manoeuvre, is_explained
from core.scoring.record import Evidence, Record
from service.storage.accidents import AccidentRow
from service.storage.manoeuvres import (
    ACCIDENT,
    CONFIRMED,
    DEFENSIVE,
    FALSE,
    HAZARD,
    REVIEWER,
    Excuse,
    ManoeuvreRow,
)

_WEIGHTS: Final[Mapping[str, int]] = {"low_speed": 1, "severe": 2, "airbag": 3}


def with_events(
    record: Record,
    manoeuvres: Sequence[ManoeuvreRow],
    accidents: Sequence[AccidentRow],
    hazards: Mapping[str, str | None],
) -> tuple[Record, dict[str, Excuse | None]]:
    """A record with these manoeuvres and accidents in the place of its own, and why manoeuvres do not count.

    The vehicle's own accident explains the braking and swerving before it, and whatever it happened in the midst of; a
    hazard the braking that it is told of by (``service.trips.hazards``). Whatever else made somebody brake hard, nobody
    can feel, and it is for a reviewer to say.
    """
    standing = [one for one in accidents if not one.is_none]
    reasons = _excuses(manoeuvres, standing, hazards)
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


def _excuses(
    manoeuvres: Sequence[ManoeuvreRow], accidents: Sequence[AccidentRow], hazards: Mapping[str, str | None]
) -> dict[str, Excuse | None]:
    reasons: dict[str, Excuse | None] = {}
    for one in manoeuvres:
        if one.verdict == CONFIRMED or one.verdict == FALSE:
            reasons[one.id] = None
        elif one.verdict == DEFENSIVE:
            reasons[one.id] = Excuse(REVIEWER)
        elif (accident := next((other for other in accidents if _is_explained(one, other.t_ns)), None)) is not None:
            reasons[one.id] = Excuse(ACCIDENT, accident.id)
        else:
            reasons[one.id] = Excuse(HAZARD, hazards[one.id]) if one.id in hazards else None
    return reasons


def _is_explained(one: ManoeuvreRow, accident_t_ns: int) -> bool:
    struck = one.start_ns <= accident_t_ns <= one.end_ns
    return struck or is_explained(Manoeuvre(one.kind), one.start_ns, one.end_ns, [accident_t_ns])
