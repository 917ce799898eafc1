"""The model that scores go by: what a TOML document says, checked once, with name, version and digest."""

from __future__ import annotations

import itertools
import math
from bisect import bisect_right
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

from core.driving.manoeuvres import Manoeuvre
from core.errors import InvalidInputError
from core.risk.assessment import ENTITIES
from core.scoring.credibility import shape_of
from core.scoring.numbers import Section, digest, is_number, text_of

_FACET: Final = ("unit", "range", "source", "cap", "damping", "spread", "count_km", "labels", "groups")
_RATE: Final = ("rate", "spread", "dispersion", "weight", "cap")
FUSED: Final = "fused"


@dataclass(frozen=True, slots=True)
class Scale:
    """From ln relativity to points: ``base`` for the portfolio's mean, ``per_halving`` more for half of its claims."""

    base: float
    per_halving: float

    def points(self, ln_relativity: float) -> float:
        """Points that this adds."""
        return -self.per_halving / math.log(2.0) * ln_relativity


@dataclass(frozen=True, slots=True)
class Mileage:
    """Claims by annual distance: ``fixed`` and, from each of ``from_km`` on, ``slope`` more a 1000 km."""

    annual_km: float
    shape: float
    count_km: float
    fixed: float
    from_km: tuple[float, ...]
    slope: tuple[float, ...]

    def relativity(self, annual_km: float) -> float:
        """Expected claims of a year with this distance over those of the portfolio's mean distance."""
        return self._claims(annual_km) / self._claims(self.annual_km)

    def _claims(self, annual_km: float) -> float:
        bands = bisect_right(self.from_km, annual_km)
        ends = (*self.from_km[1:bands], annual_km)
        return self.fixed + math.fsum(
            slope * (end - start) * 1e-3
            for slope, start, end in zip(self.slope[:bands], self.from_km[:bands], ends, strict=True)
        )


@dataclass(frozen=True, slots=True)
class FacetRisk:
    """Relativities of a facet's labels, of which the portfolio's mean is 1, and how soon a driver's mean is believed.

    Parameters
    ----------
    relativity : by label
    share : the portfolio's, by label; empty where relativities are the user's own
    groups : by label, under what it is told: itself where nothing else is said
    """

    relativity: Mapping[str, float]
    share: Mapping[str, float]
    groups: Mapping[str, str]
    shape: float
    count_km: float


@dataclass(frozen=True, slots=True)
class Regressor:
    """One of PHYD's: ln relativity is ``weight`` * (value - ``portfolio``), the value up to ``cap``.

    ``exposure`` is what tells as much as one Poisson count where the value is the portfolio's; ``dispersion`` so many
    counts that tell as much as one.
    """

    portfolio: float
    shape: float
    weight: float
    cap: float
    exposure: float
    dispersion: float = 1.0

    def ln(self, relative: float) -> float:
        """Ln relativity of a value over the portfolio's."""
        return self.weight * (min(relative * self.portfolio, self.cap) - self.portfolio)


@dataclass(frozen=True, slots=True)
class ScoreModel:
    """Everything that scores go by but the record."""

    name: str
    version: str
    text: str
    sha256: str
    scale: Scale
    mileage: Mileage
    hour: FacetRisk
    manoeuvres: Mapping[str, Regressor]
    speeding: Regressor
    speeding_share: float
    vehicle: Regressor
    entity: str
    correlation: float
    road_class: FacetRisk
    district: FacetRisk
    cell_shape: float
    cell_count_km: float
    told: int


def score_model_of(document: Mapping[str, Any]) -> ScoreModel:
    """The model that a TOML document says.

    Raises
    ------
    InvalidInputError
        That names the number: missing, without unit, range or source, out of its range, a share that does not sum, …
    """
    known = ("name", "version", "text", "scale", "payd", "phyd", "pwyd")
    if unknown := [key for key in document if key not in known]:
        raise InvalidInputError(f"unknown key '{unknown[0]}': expected {', '.join(known)}")
    _of_these(document, "payd", ("mileage", "hour"))
    _of_these(document, "phyd", (*(kind.value for kind in Manoeuvre), "speeding", "vehicle", "together"))
    _of_these(document, "pwyd", ("road_class", "district", "cell"))
    scale = Section(document, "scale", ("base", "per_halving"))
    speeding = Section(document, "phyd.speeding", ("share", "excess_kmh", "spread", "weight", "count_h", "cap"))
    vehicle = Section(document, "phyd.vehicle", ("entity", "risk", "spread", "weight", "count_km", "cap"))
    entity = text_of(vehicle.content, "entity", "phyd.vehicle.")
    if entity not in (*ENTITIES, FUSED):
        raise InvalidInputError(f"phyd.vehicle.entity is '{entity}': expected one of {', '.join((*ENTITIES, FUSED))}")
    correlation = Section(document, "phyd.together", ("correlation",)).number("correlation")
    if not 0.0 <= correlation <= 1.0:
        raise InvalidInputError(f"phyd.together.correlation is {correlation:g}: expected 0 to 1")
    cell = Section(document, "pwyd.cell", ("spread", "count_km", "told"))
    share = _positive(speeding, "share")
    return ScoreModel(
        name=text_of(document, "name", ""),
        version=text_of(document, "version", ""),
        text=str(document.get("text", "")),
        sha256=digest(document),
        scale=Scale(scale.number("base"), _positive(scale, "per_halving")),
        mileage=_mileage(document),
        hour=_facet(document, "payd.hour"),
        manoeuvres={kind.value: _manoeuvre(document, kind.value) for kind in Manoeuvre},
        speeding=_regressor(speeding, share * _positive(speeding, "excess_kmh"), _positive(speeding, "count_h")),
        speeding_share=share,
        vehicle=_regressor(vehicle, _positive(vehicle, "risk"), _positive(vehicle, "count_km")),
        entity=entity,
        correlation=correlation,
        road_class=_facet(document, "pwyd.road_class"),
        district=_facet(document, "pwyd.district"),
        cell_shape=shape_of(_positive(cell, "spread")),
        cell_count_km=_positive(cell, "count_km"),
        told=round(_positive(cell, "told")),
    )


def _of_these(document: Mapping[str, Any], product: str, keys: tuple[str, ...]) -> None:
    found = document.get(product)
    if not isinstance(found, Mapping):
        raise InvalidInputError(f"[{product}] is missing: expected the sections {', '.join(keys)}")
    if unknown := [key for key in found if key not in keys]:
        raise InvalidInputError(f"[{product}]: unknown section '{unknown[0]}': expected {', '.join(keys)}")


def _positive(section: Section, key: str) -> float:
    value = section.number(key)
    if not value > 0.0:
        raise InvalidInputError(f"{section.path}.{key} is {value:g}: expected more than 0")
    return value


def _mileage(document: Mapping[str, Any]) -> Mileage:
    section = Section(document, "payd.mileage", ("annual_km", "spread", "count_km", "fixed", "bands"))
    bands = Section(document, "payd.mileage.bands", ("unit", "range", "source", "from_km", "slope"))
    slope, starts = bands.numbers("slope", bands.content.get("slope")), bands.content.get("from_km")
    if not isinstance(starts, list) or not all(is_number(start) for start in starts) or len(starts) != len(slope):
        raise InvalidInputError(
            f"payd.mileage.bands.from_km is {starts!r}: expected a start for each of {len(slope)} slopes"
        )
    if starts[0] != 0.0 or not all(low < high for low, high in itertools.pairwise(starts)):
        raise InvalidInputError(f"payd.mileage.bands.from_km is {starts!r}: expected starts that rise from 0")
    if min(slope) < 0.0:
        raise InvalidInputError(
            f"payd.mileage.bands.slope has {min(slope):g}: expected claims that do not fall with distance"
        )
    return Mileage(
        annual_km=_positive(section, "annual_km"),
        shape=shape_of(_positive(section, "spread")),
        count_km=_positive(section, "count_km"),
        fixed=_positive(section, "fixed"),
        from_km=tuple(float(start) for start in starts),
        slope=slope,
    )


def _manoeuvre(document: Mapping[str, Any], kind: str) -> Regressor:
    section = Section(document, f"phyd.{kind}", _RATE)
    rate = _positive(section, "rate")
    dispersion = _positive(section, "dispersion")
    return replace(_regressor(section, rate, dispersion * 100.0 / rate), dispersion=dispersion)


def _regressor(section: Section, portfolio: float, exposure: float) -> Regressor:
    cap = section.number("cap")
    if not cap > portfolio:
        raise InvalidInputError(f"{section.path}.cap is {cap:g}: expected more than the portfolio's {portfolio:g}")
    weight = section.number("weight")
    if weight < 0.0:
        raise InvalidInputError(f"{section.path}.weight is {weight:g}: expected 0 or more")
    return Regressor(portfolio, shape_of(_positive(section, "spread")), weight, cap, exposure)


def _facet(document: Mapping[str, Any], path: str) -> FacetRisk:
    section = Section(document, path, _FACET)
    labels = section.content.get("labels", {})
    if not isinstance(labels, Mapping):
        raise InvalidInputError(f"{path}.labels is {labels!r}: expected a section of labels")
    cap, damping = _positive(section, "cap"), section.number("damping")
    rates, shares = {}, {}
    for label, told in labels.items():
        values = section.numbers(f"labels.{label}", told if isinstance(told, list) else [told])
        if not values[0] > 0.0 or len(values) > 2:
            raise InvalidInputError(f"{path}.labels.{label} is {told!r}: expected a rate above 0, or [rate, share]")
        rates[label] = min(values[0], cap) ** damping
        if len(values) == 2:
            shares[label] = values[1]
    if shares and len(shares) != len(rates):
        raise InvalidInputError(f"{path}.labels: some have a share: expected [rate, share] of all or of none")
    total = math.fsum(shares.values())
    if shares and not abs(total - 1.0) <= 0.01:
        raise InvalidInputError(f"{path}.labels: shares sum to {total:g}: expected 1")
    mean = math.fsum(rates[label] * share for label, share in shares.items()) / total if shares else 1.0
    return FacetRisk(
        relativity={label: rate / mean for label, rate in rates.items()},
        share={label: share / total for label, share in shares.items()},
        groups=_groups(section, rates),
        shape=shape_of(_positive(section, "spread")),
        count_km=_positive(section, "count_km"),
    )


def _groups(section: Section, rates: Mapping[str, float]) -> dict[str, str]:
    told = section.content.get("groups", {})
    if not isinstance(told, Mapping) or not all(isinstance(labels, list) for labels in told.values()):
        raise InvalidInputError(f"{section.path}.groups is {told!r}: expected lists of labels by the group's name")
    groups = {label: label for label in rates}
    grouped: set[str] = set()
    for group, labels in told.items():
        for label in labels:
            if label not in rates or label in grouped:
                raise InvalidInputError(f"{section.path}.groups.{group} has '{label}': expected each label once")
            grouped.add(label)
            groups[label] = group
    return groups
