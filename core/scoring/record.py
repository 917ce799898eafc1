"""What trips add to a vehicle's record, in whole numbers: records add up to the same in any order and of any parts.

A trip has a record, and so have a day, a month and a year: each is the sum of those below it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields
from functools import reduce
from typing import Any, Final, NamedTuple

from core.driving.exposure import NOTHING, Driven, Exposure, Facet
from core.risk.belief import N_SETS

MASS_UNIT: Final = 1e-9
"""In which an instant's masses and coverage are counted."""
MOST_EVIDENCE: Final = 5
"""How many of the heaviest pieces of evidence a record keeps of each kind; a choice."""


class Evidence(NamedTuple):
    """What a figure rests on: how much it weighs there, what it is (``trip``, ``manoeuvre``, ``accident``), its id."""

    weight: int
    kind: str
    id: str


@dataclass(frozen=True, slots=True)
class SpeedingSums:
    """Speeding of moving time, as ``core.driving.speeding`` judges it: milliseconds, millimetres, mm/s."""

    known_ms: int = 0
    unknown_ms: int = 0
    over_ms: int = 0
    certain_ms: int = 0
    certain_over_ms: int = 0
    excess_mm: int = 0
    max_excess_mmps: int = 0
    episodes: int = 0

    def __add__(self, other: SpeedingSums) -> SpeedingSums:
        sums = {one.name: getattr(self, one.name) + getattr(other, one.name) for one in fields(self)}
        return SpeedingSums(**sums | {"max_excess_mmps": max(self.max_excess_mmps, other.max_excess_mmps)})


@dataclass(frozen=True, slots=True)
class BeliefSums:
    """Masses of ``instants`` instants, summed in units of ``MASS_UNIT``, by the bits of ``core.risk.belief``."""

    instants: int = 0
    mass: tuple[int, ...] = (0,) * N_SETS

    def __add__(self, other: BeliefSums) -> BeliefSums:
        return BeliefSums(
            self.instants + other.instants, tuple(a + b for a, b in zip(self.mass, other.mass, strict=True))
        )

    def mean(self) -> tuple[float, ...] | None:
        """Mean masses; None where there is no instant."""
        return tuple(one * MASS_UNIT / self.instants for one in self.mass) if self.instants else None


@dataclass(frozen=True, slots=True)
class Record:
    """What was driven, and how, as far as scores ask.

    Parameters
    ----------
    trips : how many
    days : on how many days; a trip's own record has 0, a day's 1
    exposure : by every facet but the cell
    cells : distance and time by H3 cell
    coasting_ms : of the moving time, without GNSS
    manoeuvres : by kind, aggressive ones that count and are not excused
    excused : by kind, those that a hazard, an accident or a reviewer explains
    belief : masses by entity, and ``fused``
    coverage : by source, over the instants of ``belief["fused"]``, in units of ``MASS_UNIT``
    accidents : those that nobody took back, by severity
    evidence : by what it is evidence of, the heaviest first
    """

    trips: int = 0
    days: int = 0
    exposure: Exposure = field(default_factory=Exposure)
    cells: Mapping[str, Driven] = field(default_factory=dict)
    coasting_ms: int = 0
    manoeuvres: Mapping[str, int] = field(default_factory=dict)
    excused: Mapping[str, int] = field(default_factory=dict)
    speeding: SpeedingSums = SpeedingSums()
    belief: Mapping[str, BeliefSums] = field(default_factory=dict)
    coverage: Mapping[str, int] = field(default_factory=dict)
    accidents: Mapping[str, int] = field(default_factory=dict)
    evidence: Mapping[str, tuple[Evidence, ...]] = field(default_factory=dict)

    def __add__(self, other: Record) -> Record:
        return Record(
            trips=self.trips + other.trips,
            days=self.days + other.days,
            exposure=self.exposure + other.exposure,
            cells=_merged(self.cells, other.cells, NOTHING, Driven.plus),
            coasting_ms=self.coasting_ms + other.coasting_ms,
            manoeuvres=_merged(self.manoeuvres, other.manoeuvres, 0, int.__add__),
            excused=_merged(self.excused, other.excused, 0, int.__add__),
            speeding=self.speeding + other.speeding,
            belief=_merged(self.belief, other.belief, BeliefSums(), BeliefSums.__add__),
            coverage=_merged(self.coverage, other.coverage, 0, int.__add__),
            accidents=_merged(self.accidents, other.accidents, 0, int.__add__),
            evidence=_merged(self.evidence, other.evidence, (), lambda one, more: heaviest((*one, *more))),
        )

    @property
    def distance_m(self) -> float:
        """Distance, m."""
        return self.exposure.total.distance_m

    def mean_coverage(self) -> dict[str, float]:
        """By source, how far the instants rested on it, from 0 to 1."""
        instants = self.belief.get("fused", BeliefSums()).instants
        return {name: units * MASS_UNIT / instants for name, units in sorted(self.coverage.items())} if instants else {}

    def to_json(self, *, cells: bool = True) -> dict[str, Any]:
        """As plain numbers, lists and maps, from which ``from_json`` makes the same; what is nothing is left out."""
        told: dict[str, Any] = {
            "trips": self.trips,
            "days": self.days,
            "total": self.exposure.total,
            "by": {facet.value: dict(labels) for facet, labels in self.exposure.by.items()},
            "cells": dict(self.cells) if cells else {},
            "coasting_ms": self.coasting_ms,
            "manoeuvres": dict(self.manoeuvres),
            "excused": dict(self.excused),
            "speeding": {one.name: getattr(self.speeding, one.name) for one in fields(SpeedingSums)},
            "belief": {name: [sums.instants, *sums.mass] for name, sums in self.belief.items()},
            "coverage": dict(self.coverage),
            "accidents": dict(self.accidents),
            "evidence": {about: [list(one) for one in pieces] for about, pieces in self.evidence.items()},
        }
        return {name: value for name, value in told.items() if value}

    @classmethod
    def from_json(cls, told: Mapping[str, Any]) -> Record:
        """What ``to_json`` told."""
        by = {Facet(facet): _driven(labels) for facet, labels in told.get("by", {}).items()}
        return cls(
            trips=told.get("trips", 0),
            days=told.get("days", 0),
            exposure=Exposure(Driven(*told.get("total", NOTHING)), by),
            cells=_driven(told.get("cells", {})),
            coasting_ms=told.get("coasting_ms", 0),
            manoeuvres=told.get("manoeuvres", {}),
            excused=told.get("excused", {}),
            speeding=SpeedingSums(**told.get("speeding", {})),
            belief={name: BeliefSums(sums[0], tuple(sums[1:])) for name, sums in told.get("belief", {}).items()},
            coverage=told.get("coverage", {}),
            accidents=told.get("accidents", {}),
            evidence={
                about: tuple(Evidence(*one) for one in pieces) for about, pieces in told.get("evidence", {}).items()
            },
        )


def total(records: Iterable[Record]) -> Record:
    """The sum of records."""
    return reduce(Record.__add__, records, Record())


def _merged(one: Mapping[str, Any], other: Mapping[str, Any], nothing: Any, plus: Any) -> dict[str, Any]:
    merged = dict(one)
    for key, value in other.items():
        merged[key] = plus(merged.get(key, nothing), value)
    return merged


def heaviest(pieces: Iterable[Evidence]) -> tuple[Evidence, ...]:
    """Those that a record keeps."""
    # The same, whatever is added first: the heaviest, and of equals the one whose id comes first.
    return tuple(sorted(set(pieces), key=lambda piece: (-piece.weight, piece.kind, piece.id))[:MOST_EVIDENCE])


def together(pieces: Iterable[Evidence]) -> tuple[Evidence, ...]:
    """The heaviest of pieces that may tell of the same thing several times: it weighs as much as they do together."""
    weights: dict[tuple[str, str], int] = {}
    for piece in pieces:
        weights[piece.kind, piece.id] = weights.get((piece.kind, piece.id), 0) + piece.weight
    return heaviest(Evidence(weight, *which) for which, weight in weights.items())


def _driven(labels: Mapping[str, Any]) -> dict[str, Driven]:
    return {label: Driven(*driven) for label, driven in labels.items()}
