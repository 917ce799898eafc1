"""A vehicle's scores: its records over a period through the tenant's model."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

from sqlalchemy import Connection

from core.scoring.model import ScoreModel
from core.scoring.places import Places
from core.scoring.premium import Tariff
from core.scoring.products import score
from core.scoring.record import Evidence, Record, together
from core.scoring.score import Product, Score
from service.local_days import DEFAULT_ZONE
from service.rating.parts import Holding, Part, holding
from service.rating.period import Asked, Period, period_of
from service.risk.loading import RiskBasis, risk_basis
from service.storage import rating, records, trip_cells
from service.storage.vehicles import VehicleRef

_CELLS_LOOKED_UP: Final = 2
"""Of all cells that are told together; a choice: each takes a tenth of a millisecond."""
_MOST_READ: Final = 256
"""Texts that are kept as they were read: four parts of some tens of tenants."""


@dataclass(frozen=True, slots=True)
class Scored:
    """Scores of one period, and the record that they are of."""

    period: Period
    record: Record
    scores: dict[Product, Score]


class Reading:
    """What tenants rate by, read once a version."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._read: dict[tuple[str, Part, int], tuple[Holding, Any]] = {}

    def of(self, connection: Connection, tenant_id: str, *parts: Part) -> list[tuple[Holding, Any]]:
        """Of each part the version that holds for a tenant now, and what it says."""
        versions = rating.newest_versions(connection, tenant_id)
        return [self._held(connection, tenant_id, part, versions.get(part, 0)) for part in parts]

    def _held(self, connection: Connection, tenant_id: str, part: Part, version: int) -> tuple[Holding, Any]:
        key = (tenant_id, part, version)
        with self._lock:
            if key in self._read:
                return self._read[key]
        held = holding(connection, tenant_id, part)
        assert held is not None
        read = held, held.read()
        with self._lock:
            if len(self._read) >= _MOST_READ:
                self._read.clear()
            self._read[key] = read
        return read

    def risk(self, connection: Connection, tenant_id: str) -> RiskBasis:
        """What the tenant's trips are assessed by."""
        ((held, tables),) = self.of(connection, tenant_id, Part.RISK_TABLES)
        return risk_basis(held.text, tables)

    def scoring(self, connection: Connection, tenant_id: str) -> tuple[ScoreModel, Places | None]:
        """The tenant's score model, and its risk of places; None where there is none."""
        (_, model), (_, places) = self.of(connection, tenant_id, Part.SCORE_MODEL, Part.PLACES)
        assert isinstance(model, ScoreModel)
        assert places is None or isinstance(places, Places)
        return model, places

    def tariff(self, connection: Connection, tenant_id: str) -> Tariff:
        """The tenant's tariff."""
        ((_, tariff),) = self.of(connection, tenant_id, Part.TARIFF)
        assert isinstance(tariff, Tariff)
        return tariff


def zone_of(ref: VehicleRef) -> str:
    """The time zone by which a vehicle's days begin."""
    return ref.config.time_zone or DEFAULT_ZONE


def recorded(
    connection: Connection, ref: VehicleRef, asked: Asked, now_ns: int, *, cells: bool
) -> tuple[Period, Record]:
    """What a vehicle drove in a period; raises InvalidParameterError for one that is none."""
    zone = zone_of(ref)
    period = period_of(asked, zone, records.bounds_ns(connection, ref.pk), now_ns)
    return period, records.of_period(connection, ref.pk, period.from_ns, period.to_ns, zone=zone, cells=cells)


def scored(
    connection: Connection,
    reading: Reading,
    ref: VehicleRef,
    products: tuple[Product, ...],
    asked: Asked,
    now_ns: int,
) -> Scored:
    """A vehicle's scores; raises InvalidParameterError for a period that is none."""
    with_cells = Product.PWYD in products
    period, record = recorded(connection, ref, asked, now_ns, cells=with_cells)
    model, places = reading.scoring(connection, ref.tenant_id)
    behind = partial(_cell_evidence, connection, ref.pk, period, record.trips)
    found = {product: score(product, record, period.length_days, model, places, behind) for product in products}
    return Scored(period, record, found)


def _cell_evidence(
    connection: Connection, vehicle_pk: int, period: Period, trips: int, groups: Sequence[Sequence[str]]
) -> list[tuple[Evidence, ...]]:
    """Trips that drove farthest in the cells of each group; of many cells in those alone that weigh most."""
    told = [cells[:_CELLS_LOOKED_UP] for cells in groups]
    every = [cell for cells in told for cell in cells]
    found = trip_cells.farthest(connection, vehicle_pk, every, period.from_ns, period.to_ns, trips=trips)
    return [together(piece for cell in cells for piece in found.get(cell, ())) for cells in told]
