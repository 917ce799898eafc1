"""Records as they are stored: sums by flat names, so that a query over years adds up a hundred in one loop.

Cells are apart (``cell_sums``). Names are such as ``trips``, ``by/road_class/mm/primary``, ``belief/fused/3``.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import fields
from itertools import pairwise
from typing import Any, Final

from core.driving.exposure import Driven, Exposure, Facet
from core.risk.belief import N_SETS
from core.scoring.record import MOST_EVIDENCE, BeliefSums, Evidence, Record, SpeedingSums

_COUNTS: Final = ("manoeuvres", "excused", "coverage", "accidents")
_SPEEDING: Final = tuple(one.name for one in fields(SpeedingSums) if one.name != "max_excess_mmps")

Told = dict[str, Any]
"""``sums``, which add up name by name; ``max_excess_mmps``, of which the greatest counts; and ``evidence``, by what it
is of a text with a line a piece (``_line``), the heaviest first."""
_HEAVIEST: Final = 2**63 - 1


def told_of(record: Record) -> Told:
    """A record but for its cells."""
    sums = {
        "trips": record.trips,
        "days": record.days,
        "coasting_ms": record.coasting_ms,
        "total/mm": record.exposure.total.distance_mm,
        "total/ms": record.exposure.total.time_ms,
    }
    for facet, labels in record.exposure.by.items():
        for label, driven in labels.items():
            sums[f"by/{facet.value}/mm/{label}"], sums[f"by/{facet.value}/ms/{label}"] = driven
    for name in _COUNTS:
        sums |= {f"{name}/{key}": count for key, count in getattr(record, name).items()}
    sums |= {f"speeding/{name}": getattr(record.speeding, name) for name in _SPEEDING}
    for entity, belief in record.belief.items():
        sums |= {f"belief/{entity}/{bits}": mass for bits, mass in enumerate(belief.mass)}
        sums[f"belief/{entity}/n"] = belief.instants
    evidence = {about: "\n".join(map(_line, pieces)) for about, pieces in record.evidence.items()}
    return {"sums": sums, "max_excess_mmps": record.speeding.max_excess_mmps, "evidence": evidence}


def record_of(parts: Iterable[Mapping[str, Any]], cells: Mapping[str, Driven] | None = None) -> Record:
    """The record of all that was told, with its cells."""
    parts = list(parts)
    sums, max_excess_mmps = _summed(parts)
    by: dict[Facet, dict[str, Driven]] = {}
    counts: dict[str, dict[str, int]] = {name: {} for name in _COUNTS}
    masses: dict[str, list[int]] = {}
    for path, value in sums.items():
        head, _, rest = path.partition("/")
        if head == "by":
            facet, unit, label = rest.split("/", 2)
            if unit == "mm":
                by.setdefault(Facet(facet), {})[label] = Driven(value, sums[f"by/{facet}/ms/{label}"])
        elif head in counts:
            counts[head][rest] = value
        elif head == "belief":
            entity, _, bits = rest.rpartition("/")
            if bits != "n":
                masses.setdefault(entity, [0] * N_SETS)[int(bits)] = value
    speeding = {name: sums[f"speeding/{name}"] for name in _SPEEDING}
    return Record(
        trips=sums["trips"],
        days=sums["days"],
        exposure=Exposure(Driven(sums["total/mm"], sums["total/ms"]), by),
        cells=dict(cells or {}),
        coasting_ms=sums["coasting_ms"],
        speeding=SpeedingSums(**speeding, max_excess_mmps=max_excess_mmps),
        belief={name: BeliefSums(sums[f"belief/{name}/n"], tuple(mass)) for name, mass in masses.items()},
        evidence=_EvidenceOf([one["evidence"] for one in parts]),
        **counts,
    )


def added(parts: Sequence[Mapping[str, Any]]) -> Told:
    """What would be told of the sum of records, without making them."""
    sums, max_excess_mmps = _summed(parts)
    evidence = _EvidenceOf([one["evidence"] for one in parts])
    return {
        "sums": sums,
        "max_excess_mmps": max_excess_mmps,
        "evidence": {about: "\n".join(evidence.lines(about)) for about in evidence},
    }


def _summed(parts: Sequence[Mapping[str, Any]]) -> tuple[dict[str, int], int]:
    sums: dict[str, int] = dict(_NOTHING)
    max_excess_mmps = 0
    for one in parts:
        for path, value in one["sums"].items():
            sums[path] = sums.get(path, 0) + value
        max_excess_mmps = max(max_excess_mmps, one["max_excess_mmps"])
    return sums, max_excess_mmps


class _EvidenceOf(Mapping[str, tuple[Evidence, ...]]):
    """The evidence of a sum, found where it is asked for: a score tells of a few of a hundred figures."""

    def __init__(self, parts: Sequence[Mapping[str, str]]) -> None:
        self._parts = parts
        self._about = dict.fromkeys(about for part in parts for about in part)

    def __getitem__(self, about: str) -> tuple[Evidence, ...]:
        if about not in self._about:
            raise KeyError(about)
        return tuple(map(_piece, self.lines(about)))

    def __iter__(self) -> Iterator[str]:
        return iter(self._about)

    def __len__(self) -> int:
        return len(self._about)

    def lines(self, about: str) -> list[str]:
        """The heaviest pieces, each once, as a record keeps them."""
        found = sorted(line for part in self._parts for line in part.get(about, "").splitlines())
        first = found[:MOST_EVIDENCE]
        if any(one == other for one, other in pairwise(first)):  # never of trips, each of which is in one part alone
            first = list(dict.fromkeys(found))[:MOST_EVIDENCE]
        return first


def _line(piece: Evidence) -> str:
    """A piece as a line; the heavier, the earlier it sorts, and of equals the one whose id comes first."""
    return f"{_HEAVIEST - piece.weight:016x} {piece.kind} {piece.id}"


def _piece(line: str) -> Evidence:
    weight, kind, name = line.split(" ", 2)
    return Evidence(_HEAVIEST - int(weight, 16), kind, name)


_NOTHING: Final = told_of(Record())["sums"]
