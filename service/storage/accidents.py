"""Accidents, read: by place, time, severity and vehicle."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

from sqlalchemy import Connection, Row, Select, and_, or_, select, tuple_

from service.storage.tables import accidents, vehicles


@dataclass(frozen=True, slots=True)
class AccidentRow:
    """An accident with its vehicle's name; the columns of ``accidents``."""

    id: str
    tenant_id: str
    vehicle_pk: int
    vehicle_id: str
    trip_id: str | None
    t_ns: int
    decided_t_ns: int
    received_ns: int
    stored_ns: int
    status: str
    severity: str
    confidence: float
    lat_deg: float
    lon_deg: float
    alt_m: float
    sd_n_m: float
    sd_e_m: float
    cov_ne_m2: float
    heading_deg: float | None
    mode: int
    detail: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Box:
    """A rectangle on the map; where ``min_lon_deg`` is above ``max_lon_deg`` it lies across the antimeridian."""

    min_lon_deg: float
    min_lat_deg: float
    max_lon_deg: float
    max_lat_deg: float


@dataclass(frozen=True, slots=True)
class AccidentFilter:
    """Which accidents are asked for; None asks for all. Both ends of the time are included."""

    box: Box | None = None
    from_ns: int | None = None
    to_ns: int | None = None
    severities: Collection[str] | None = None
    vehicle_id: str | None = None


def find(connection: Connection, tenant_id: str, accident_id: str) -> AccidentRow | None:
    """The tenant's accident."""
    row = connection.execute(_accidents(tenant_id).where(accidents.c.id == accident_id)).one_or_none()
    return None if row is None else _accident(row)


def page(
    connection: Connection, tenant_id: str, wanted: AccidentFilter, *, after: tuple[int, str] | None, limit: int
) -> list[AccidentRow]:
    """The tenant's accidents, newest first, those after ``after``."""
    statement = _accidents(tenant_id)
    if wanted.box is not None:
        box, lon, lat = wanted.box, accidents.c.lon_deg, accidents.c.lat_deg
        sides = (lon >= box.min_lon_deg, lon <= box.max_lon_deg)
        crosses = box.min_lon_deg > box.max_lon_deg
        statement = statement.where(
            lat >= box.min_lat_deg, lat <= box.max_lat_deg, or_(*sides) if crosses else and_(*sides)
        )
    if wanted.from_ns is not None:
        statement = statement.where(accidents.c.t_ns >= wanted.from_ns)
    if wanted.to_ns is not None:
        statement = statement.where(accidents.c.t_ns <= wanted.to_ns)
    if wanted.severities is not None:
        statement = statement.where(accidents.c.severity.in_(wanted.severities))
    if wanted.vehicle_id is not None:
        statement = statement.where(vehicles.c.vehicle_id == wanted.vehicle_id)
    if after is not None:
        statement = statement.where(tuple_(accidents.c.t_ns, accidents.c.id) < tuple_(*after))
    statement = statement.order_by(accidents.c.t_ns.desc(), accidents.c.id.desc()).limit(limit)
    return [_accident(row) for row in connection.execute(statement)]


def _accidents(tenant_id: str) -> Select[Any]:
    return (
        select(accidents, vehicles.c.vehicle_id)
        .join(vehicles, vehicles.c.pk == accidents.c.vehicle_pk)
        .where(accidents.c.tenant_id == tenant_id)
    )


def _accident(row: Row[Any]) -> AccidentRow:
    return AccidentRow(**row._mapping)
