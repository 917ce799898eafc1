"""What lists of things with a place and a time have in common: the filter, and newest first by cursor."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Self

from sqlalchemy import ColumnElement, Select, Table, and_, or_, tuple_

from service.storage.tables import vehicles

_M_PER_DEG_LAT = 110_574.0
"""Of the meridian where a degree is shortest, at the equator."""


@dataclass(frozen=True, slots=True)
class Box:
    """A rectangle on the map; where ``min_lon_deg`` is above ``max_lon_deg`` it lies across the antimeridian."""

    min_lon_deg: float
    min_lat_deg: float
    max_lon_deg: float
    max_lat_deg: float

    @classmethod
    def around(cls, lat_deg: float, lon_deg: float, radius_m: float) -> Self:
        """All places within so many metres of one, and some more."""
        high_deg = radius_m / _M_PER_DEG_LAT
        south, north = max(lat_deg - high_deg, -90.0), min(lat_deg + high_deg, 90.0)
        shrinks = math.cos(math.radians(max(-south, north)))
        wide_deg = high_deg / shrinks if shrinks > high_deg / 180.0 else 180.0
        if wide_deg >= 180.0:
            return cls(-180.0, south, 180.0, north)
        west, east = (math.remainder(lon_deg + side * wide_deg, 360.0) for side in (-1.0, 1.0))
        return cls(west, south, east, north)

    def holds(self, table: Table) -> ColumnElement[bool]:
        """Whether the place of a table's row lies in it."""
        lon, lat = table.c.lon_deg, table.c.lat_deg
        sides = (lon >= self.min_lon_deg, lon <= self.max_lon_deg)
        crosses = self.min_lon_deg > self.max_lon_deg
        return and_(lat >= self.min_lat_deg, lat <= self.max_lat_deg, or_(*sides) if crosses else and_(*sides))


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
    table: Table, chosen: Select[Any], wanted: WhereAndWhen, *, after: tuple[int, str] | None, limit: int | None
) -> Select[Any]:
    """The rows that were asked for, newest first, those after ``after``; all of them without a limit."""
    if wanted.box is not None:
        chosen = chosen.where(wanted.box.holds(table))
    if wanted.from_ns is not None:
        chosen = chosen.where(table.c.t_ns >= wanted.from_ns)
    if wanted.to_ns is not None:
        chosen = chosen.where(table.c.t_ns <= wanted.to_ns)
    if wanted.vehicle_id is not None:
        chosen = chosen.where(vehicles.c.vehicle_id == wanted.vehicle_id)
    if after is not None:
        chosen = chosen.where(tuple_(table.c.t_ns, table.c.id) < tuple_(*after))
    return chosen.order_by(table.c.t_ns.desc(), table.c.id.desc()).limit(limit)
