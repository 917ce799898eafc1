"""What lists of things with a place and a time have in common: the filter, and newest first by cursor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from sqlalchemy import Select, Table, and_, or_, tuple_

from service.storage.tables import vehicles


@dataclass(frozen=True, slots=True)
class Box:
    """A rectangle on the map; where ``min_lon_deg`` is above ``max_lon_deg`` it lies across the antimeridian."""

    min_lon_deg: float
    min_lat_deg: float
    max_lon_deg: float
    max_lat_deg: float


@dataclass(frozen=True, slots=True)
class WhereAndWhen:
    """Which are asked for; None asks for all. Both ends of the time are included."""

    box: Box | None = None
    from_ns: int | None = None
    to_ns: int | None = None
    vehicle_id: str | None = None


def of_tenant(table: Table, chosen: Select[Any], tenant_id: str) -> Select[Any]:
    """``chosen`` from the table joined with its vehicles, the tenant's alone."""
    return chosen.join(vehicles, vehicles.c.pk == table.c.vehicle_pk).where(table.c.tenant_id == tenant_id)


def page_of(
    table: Table, chosen: Select[Any], wanted: WhereAndWhen, *, after: tuple[int, str] | None, limit: int
) -> Select[Any]:
    """The rows that were asked for, newest first, those after ``after``."""
    if wanted.box is not None:
        box, lon, lat = wanted.box, table.c.lon_deg, table.c.lat_deg
        sides = (lon >= box.min_lon_deg, lon <= box.max_lon_deg)
        crosses = box.min_lon_deg > box.max_lon_deg
        chosen = chosen.where(lat >= box.min_lat_deg, lat <= box.max_lat_deg, or_(*sides) if crosses else and_(*sides))
    if wanted.from_ns is not None:
        chosen = chosen.where(table.c.t_ns >= wanted.from_ns)
    if wanted.to_ns is not None:
        chosen = chosen.where(table.c.t_ns <= wanted.to_ns)
    if wanted.vehicle_id is not None:
        chosen = chosen.where(vehicles.c.vehicle_id == wanted.vehicle_id)
    if after is not None:
        chosen = chosen.where(tuple_(table.c.t_ns, table.c.id) < tuple_(*after))
    return chosen.order_by(table.c.t_ns.desc(), table.c.id.desc()).limit(limit)
