"""PWYD, where: expected claims by the classes of roads, and by the cells or districts that are driven in."""

from __future__ import annotations

from core.driving.exposure import Facet as Exposed
from core.scoring.facets import EvidenceOf, Facet, facet_part, known_share
from core.scoring.model import FacetRisk, ScoreModel
from core.scoring.places import Places
from core.scoring.record import Record
from core.scoring.score import Basis, Product, Score, checked_days, nothing_driven


def pwyd(
    record: Record,
    days: float,
    model: ScoreModel,
    places: Places | None = None,
    cell_evidence: EvidenceOf | None = None,
) -> Score:
    """PWYD score of a period; a product of facets.

    A place counts once: by its cell where the portfolio's own figures know that, and for the share of the distance
    where they do not, by its district, whose exponent is that share. What has no relativity counts as the portfolio's
    mean; where nothing has, the score is the portfolio's, its interval as wide as drivers differ, and coverage is 0.
    A record names no evidence of cells, of which there are too many: ``cell_evidence`` does, of those that are told.

    Raises
    ------
    InvalidInputError
        If the period is none, or the record is of more days than it has.
    """
    days = checked_days(record, days)
    sha256 = None if places is None else places.sha256
    if reason := nothing_driven(record):
        return Basis(Product.PWYD, record, days, model, sha256).unscored(reason)
    roads = record.exposure.by.get(Exposed.ROAD_CLASS, {})
    districts = record.exposure.by.get(Exposed.DISTRICT, {})
    cell_risk = {} if places is None else places.relativity
    total_mm = record.exposure.total.distance_mm
    coverage = {
        "road_class": known_share(roads, model.road_class.relativity, total_mm),
        "district": known_share(districts, model.district.relativity, total_mm),
        "cell": known_share(record.cells, cell_risk, total_mm),
    }
    basis = Basis(Product.PWYD, record, days, model, sha256, coverage)
    parts = [facet_part(_facet(model.road_class, "road_class", "roads", model.told), roads, record)]
    if model.district.relativity:
        rest = 1.0 - coverage["cell"]
        parts.append(facet_part(_facet(model.district, "district", "districts", model.told, rest), districts, record))
    if places is not None:
        cells = Facet(
            name="cell",
            label="areas",
            relativity=cell_risk,
            sd=places.sd,
            share={},
            group=lambda cell: cell,
            named=lambda cell: (f"cell:{cell}", f"area {cell}"),
            shape=model.cell_shape,
            count_km=model.cell_count_km,
            told=model.told,
            evidence=cell_evidence,
        )
        parts.append(facet_part(cells, record.cells, record))
    return basis.scored(parts)


def _facet(risk: FacetRisk, name: str, label: str, told: int, weight: float = 1.0) -> Facet:
    def named(group: str) -> tuple[str, str]:
        return f"{name}:{group}", f"roads of class {group.replace('_', ' ')}" if name == "road_class" else group

    return Facet(
        name=name,
        label=label,
        relativity=risk.relativity,
        sd={},
        share=risk.share,
        group=risk.groups.__getitem__,
        named=named,
        shape=risk.shape,
        count_km=risk.count_km,
        told=told,
        weight=weight,
    )
