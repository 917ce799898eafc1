"""The three products behind one function."""

from __future__ import annotations

from core.errors import InvalidInputError
from core.scoring.facets import EvidenceOf
from core.scoring.model import ScoreModel
from core.scoring.payd import payd
from core.scoring.phyd import phyd
from core.scoring.places import Places
from core.scoring.pwyd import pwyd
from core.scoring.record import Record
from core.scoring.score import Product, Score


def score(
    product: str,
    record: Record,
    days: float,
    model: ScoreModel,
    places: Places | None = None,
    cell_evidence: EvidenceOf | None = None,
) -> Score:
    """A product's score; ``places`` and ``cell_evidence`` are for PWYD alone.

    Raises
    ------
    InvalidInputError
        If there is no such product, the period is none, or the record is of more days than it has.
    """
    if product == Product.PAYD:
        return payd(record, days, model)
    if product == Product.PHYD:
        return phyd(record, days, model)
    if product == Product.PWYD:
        return pwyd(record, days, model, places, cell_evidence)
    raise InvalidInputError(f"no product '{product}': expected one of {', '.join(Product)}")


def scores(record: Record, days: float, model: ScoreModel, places: Places | None = None) -> dict[Product, Score]:
    """All of them."""
    return {product: score(product, record, days, model, places) for product in Product}
