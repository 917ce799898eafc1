"""A facet of exposure, by hours, roads, districts or cells: its mean relativity, split over labels exactly."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from core.driving.exposure import Driven
from core.scoring.credibility import NORMAL_95, Estimate, Shrunk, summed
from core.scoring.record import Evidence, Record, together
from core.scoring.score import Contribution, Part, evidence_of

EvidenceOf = Callable[[Sequence[Sequence[str]]], Sequence[tuple[Evidence, ...]]]
"""What is evidence of each of some groups of labels, of which those that weigh most come first."""
NEVER_KNOWN: Final = 1e-9
_FLAT: Final = 1e-9
"""As near to 1 a ratio of differences is left to rounding, and its limit is exact to as much."""
_LEAST: Final = 0.05


@dataclass(frozen=True, slots=True)
class Facet:
    """How a facet takes part.

    Parameters
    ----------
    name, label : of all of it, as ``road_class`` and ``roads``
    relativity : by label, the portfolio's mean 1; a label that is not there counts as that
    sd : by label, how unsure its relativity is itself; none where it is taken as told
    share : the portfolio's, by label; may be empty
    group : what a label is told with
    named : the name and label under which a group is told
    told : as many groups are told one by one, the others together
    weight : exponent of the facet's relativity
    evidence : of what is told; None where the record itself names it
    """

    name: str
    label: str
    relativity: Mapping[str, float]
    sd: Mapping[str, float]
    share: Mapping[str, float]
    group: Callable[[str], str]
    named: Callable[[str], tuple[str, str]]
    shape: float
    count_km: float
    told: int
    weight: float = 1.0
    evidence: EvidenceOf | None = None


def known_share(exposed: Mapping[str, Driven], relativity: Mapping[str, float], total_mm: int) -> float:
    """Share of the distance whose label has a relativity."""
    return sum(driven.distance_mm for label, driven in exposed.items() if label in relativity) / total_mm


def facet_part(facet: Facet, exposed: Mapping[str, Driven], record: Record) -> Part:
    """The mean relativity of what was driven, F = k r + (1 - k), with k the share whose label is known.

    r, the mean of the known, is shrunk toward the portfolio's by the distance known; the rest counts as the portfolio's
    mean and is as unsure as drivers differ. F - 1 is the sum over labels of Z (share - k portfolio's share) (r - 1), as
    the portfolio's mean r is 1; ln F is split alike, times ln F / (F - 1): the logarithmic mean leaves no residual (Ang
    2005).
    """
    total_mm = record.exposure.total.distance_mm
    known = {
        label: driven.distance_mm / total_mm for label, driven in sorted(exposed.items()) if label in facet.relativity
    }
    k = min(math.fsum(known.values()), 1.0)
    expected = k * total_mm * 1e-6 / facet.count_km
    mean = math.fsum(share * facet.relativity[label] for label, share in known.items()) / k if k > NEVER_KNOWN else 1.0
    shrunk = Shrunk(facet.shape, expected * mean, expected)
    against, credibility = facet.share or dict.fromkeys(known, 0.0), shrunk.credibility
    excess = {
        label: credibility * (known.get(label, 0.0) - k * usual) * (facet.relativity[label] - 1.0)
        for label, usual in against.items()
    }
    factor = 1.0 + math.fsum(excess.values())
    per_excess = math.log(factor) / (factor - 1.0) if abs(factor - 1.0) > _FLAT else 2.0 / (factor + 1.0)
    if k > NEVER_KNOWN:
        told = _told(facet, {label: share / k for label, share in known.items()}, excess, record)
    else:
        told = [(Contribution(facet.name, facet.label, 0.0, unit="1"), 0.0)]
    return Part(
        ln=_interval(facet, known, k, shrunk, factor),
        shares=[(contribution, facet.weight * per_excess * part) for contribution, part in told],
        prior_var=facet.weight**2 / facet.shape,
        credibility=k * credibility,
    )


def _interval(facet: Facet, known: Mapping[str, float], k: float, shrunk: Shrunk, factor: float) -> Estimate:
    """Of ln F: by the distance known, by what is not, and by how unsure the labels' own relativities are."""
    own, unknown = shrunk.estimate, Shrunk(facet.shape, 0.0, 0.0).estimate
    # Unknown roads may well be like the known ones: their errors add up, and do not cancel as independent ones would.
    low = k * (own.low - own.value) + (1.0 - k) * (unknown.low - 1.0)
    high = k * (own.high - own.value) + (1.0 - k) * (unknown.high - 1.0)
    sd = math.sqrt(math.fsum((share * facet.sd.get(label, 0.0)) ** 2 for label, share in known.items()))
    labels = NORMAL_95 * sd * shrunk.credibility
    spread = summed((Estimate(0.0, low, high), Estimate(0.0, -labels, labels)))
    return Estimate(
        facet.weight * math.log(factor),
        # Only the labels' sd, taken as if it were normal, can bring it to 0.
        facet.weight * math.log(max(factor + spread.low, _LEAST * factor)),
        facet.weight * math.log(factor + spread.high),
    )


def _told(
    facet: Facet, known: Mapping[str, float], excess: Mapping[str, float], record: Record
) -> list[tuple[Contribution, float]]:
    grouped: dict[str, list[str]] = {}
    for label in excess:
        grouped.setdefault(facet.group(label), []).append(label)
    weights = {
        group: excess[labels[0]] if len(labels) == 1 else math.fsum(excess[label] for label in labels)
        for group, labels in grouped.items()  # thousands of cells, each by itself
    }
    ranked = sorted(grouped, key=lambda group: (-abs(weights[group]), group))
    others = [label for group in ranked[facet.told :] for label in grouped[group]]
    told = {facet.named(group): grouped[group] for group in ranked[: facet.told]} | (
        {(f"{facet.name}:others", f"other {facet.label}"): others} if others else {}
    )
    behind = facet.evidence or (lambda groups: [_behind(facet, labels, record) for labels in groups])
    made = []
    for ((name, label), labels), evidence in zip(told.items(), behind(list(told.values())), strict=True):
        usual = math.fsum(facet.share[one] for one in labels) if facet.share else None
        share = math.fsum(known.get(one, 0.0) for one in labels)
        made.append(
            (
                Contribution(name, label, 0.0, value=share, portfolio=usual, unit="1", evidence=evidence),
                math.fsum(excess[one] for one in labels),
            )
        )
    return made


def _behind(facet: Facet, labels: Sequence[str], record: Record) -> tuple[Evidence, ...]:
    """What is evidence of any of some labels, a trip once with all that it drove under them."""
    return together(piece for label in labels for piece in evidence_of(record, f"{facet.name}:{label}"))
