"""The driving manoeuvres' figures: labelled trips of a phone, what was found of the labels and what beside them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from core.driving.earth_axes import EarthAxes
from core.driving.manoeuvres import PHONE, Episode, Manoeuvre, ManoeuvreTracker
from service.bench.calibration_recordings import PLACE
from service.bench.simulated_outages import Tell
from service.bench.tables import aligned, verdicts
from service.bench.targets import Target, judged
from service.errors import UsageError
from service.recordings.labelled_trips import LabelledSpan, LabelledTrip, labelled_trips, read_labelled_trip

TRIPS: Final = "events_driver_behavior"

ASKED: Final = {
    "aggressive_braking": (Manoeuvre.BRAKING, ""),
    "aggressive_acceleration": (Manoeuvre.ACCELERATION, ""),
    "aggressive_left_turn": (Manoeuvre.CORNERING, "left"),
    "aggressive_right_turn": (Manoeuvre.CORNERING, "right"),
    "aggressive_left_lane_change": (Manoeuvre.LANE_CHANGE, "left"),
    "aggressive_right_lane_change": (Manoeuvre.LANE_CHANGE, "right"),
}
"""Label by label what is to be found."""

LEAST_F1: Final = 0.8
"""Issue 6, for braking, acceleration and turns by overlap with the labels."""

TARGETS: Final = tuple(
    Target(f"labelled trips, {kind.value}, 1 - F1", f"labelled/all/{kind.value}/missed", 1.0 - LEAST_F1, "")
    for kind in (Manoeuvre.BRAKING, Manoeuvre.ACCELERATION, Manoeuvre.CORNERING)
)


def measure(folder: Path | None, tell: Tell) -> dict[str, Any]:
    """Precision, recall and F1 by kind of manoeuvre, over all trips and by trip. Raises UsageError without trips."""
    place = (PLACE if folder is None else folder) / TRIPS
    names = labelled_trips(place)
    if not names:
        raise UsageError(f"{place}: no labelled trips; say by --recordings where the folder '{TRIPS}' is")
    by_trip: dict[str, dict[str, dict[str, Any]]] = {}
    for done, name in enumerate(names):
        tell(done, len(names))
        trip = read_labelled_trip(place, name)
        by_trip[name] = scores(trip.labels, episodes(trip))
    both = {kind.value: _summed(trip[kind.value] for trip in by_trip.values()) for kind in Manoeuvre}
    found: dict[str, Any] = {"labelled": {"trips": by_trip, "all": both}}
    return found | {"targets": judged(found, TARGETS)}


def episodes(trip: LabelledTrip) -> list[Episode]:
    """What a tracker finds in a trip's earth axes."""
    motion = EarthAxes().step(trip.t_ns, trip.east_mps2, trip.north_mps2, trip.up_mps2, trip.yaw_up_radps)
    return ManoeuvreTracker(PHONE).step_horizontal(motion)


def scores(labels: Sequence[LabelledSpan], found: Iterable[Episode]) -> dict[str, dict[str, Any]]:
    """By kind: labels found by an aggressive episode of theirs, in time and direction, and episodes with no label.

    Repeats count, as labels are repeated; recoveries do not. All of a trip's unlabelled time counts against.
    """
    aggressive = [one for one in found if one.aggressive and not one.recovery]
    result = {}
    for kind in Manoeuvre:
        asked = [(span, ASKED[span.event][1]) for span in labels if ASKED.get(span.event, ("",))[0] == kind]
        told = [one for one in aggressive if one.kind == kind]
        hits = sum(any(_overlap(span, one) and one.direction == side for one in told) for span, side in asked)
        extra = sum(not any(_overlap(span, one) and one.direction == side for span, side in asked) for one in told)
        result[kind.value] = _score(hits, len(asked) - hits, extra)
    return result


def tables(found: Mapping[str, Any]) -> str:
    """One table, and at the end what is asked against what was measured."""
    rows = [("trip", "manoeuvre", "labelled", "found", "without a label", "precision", "recall", "F1")]
    parts = {"all": found["labelled"]["all"], **found["labelled"]["trips"]}
    for name, kinds in parts.items():
        for kind, one in kinds.items():
            counts = (str(one["hits"] + one["misses"]), str(one["hits"]), str(one["extra"]))
            shares = ("" if one[key] is None else f"{one[key]:.2f}" for key in ("precision", "recall", "f1"))
            rows.append((name, kind, *counts, *shares))
    lines = ["labelled trips of a phone in earth axes, aggressive manoeuvres by overlap:", *aligned(rows, left=(0, 1))]
    return "\n".join([*lines, "", *verdicts(found["targets"])])


def _overlap(span: LabelledSpan, one: Episode) -> bool:
    return one.start_t_ns * 1e-9 < span.end_s and one.end_t_ns * 1e-9 > span.start_s


def _score(hits: int, misses: int, extra: int) -> dict[str, Any]:
    f1 = 2.0 * hits / (2 * hits + misses + extra) if hits + misses + extra else None
    return {
        "hits": hits,
        "misses": misses,
        "extra": extra,
        "precision": hits / (hits + extra) if hits + extra else None,
        "recall": hits / (hits + misses) if hits + misses else None,
        "f1": f1,
        "missed": None if f1 is None else 1.0 - f1,
    }


def _summed(parts: Iterable[Mapping[str, Any]]) -> dict[str, Any]:
    rows = list(parts)
    return _score(*(sum(row[key] for row in rows) for key in ("hits", "misses", "extra")))
