"""Manoeuvres: harsh braking, acceleration and cornering, and changes of lane, by vehicle and time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from sqlalchemy import Connection, Row, Select, and_, bindparam, select, update

from service.storage.statements import insert_into
from service.storage.tables import manoeuvres, vehicles

FALSE = "false"
"""A reviewer's verdict: there was no such manoeuvre."""
CONFIRMED = "confirmed"
DEFENSIVE = "defensive"


@dataclass(frozen=True, slots=True)
class ManoeuvreRow:
    """A manoeuvre; the columns of ``manoeuvres``, with its vehicle's name."""

    id: str
    tenant_id: str
    vehicle_pk: int
    vehicle_id: str
    kind: str
    start_ns: int
    peak_ns: int
    end_ns: int
    stored_ns: int
    peak_mps2: float
    direction: str
    aggressive: bool
    counted: bool
    recovery: bool
    speed_before_mps: float | None
    speed_at_peak_mps: float | None
    speed_after_mps: float | None
    across_mps2: float | None
    radius_m: float | None
    heading_change_deg: float | None
    lat_deg: float | None = None
    lon_deg: float | None = None
    sd_n_m: float | None = None
    sd_e_m: float | None = None
    cov_ne_m2: float | None = None
    excused: str | None = None
    verdict: str | None = None


def put(connection: Connection, row: ManoeuvreRow) -> bool:
    """Store a manoeuvre, unless it is there; whether it was not."""
    insert = insert_into(connection, manoeuvres).values(
        {column.name: getattr(row, column.name) for column in manoeuvres.c}
    )
    return connection.execute(insert.on_conflict_do_nothing(index_elements=[manoeuvres.c.id])).rowcount == 1


def find(connection: Connection, tenant_id: str, manoeuvre_id: str, *, to_change: bool = False) -> ManoeuvreRow | None:
    """The tenant's manoeuvre; ``to_change`` keeps others from changing it until the transaction ends."""
    statement = _manoeuvres().where(manoeuvres.c.tenant_id == tenant_id, manoeuvres.c.id == manoeuvre_id)
    locked = statement.with_for_update(of=manoeuvres) if to_change else statement
    row = connection.execute(locked).one_or_none()
    return None if row is None else _manoeuvre(row)


def between(connection: Connection, vehicle_pk: int, from_ns: int, to_ns: int) -> list[ManoeuvreRow]:
    """A vehicle's manoeuvres that began in a time, both ends included, in their order."""
    mine = and_(manoeuvres.c.vehicle_pk == vehicle_pk, manoeuvres.c.start_ns.between(from_ns, to_ns))
    ordered = _manoeuvres().where(mine).order_by(manoeuvres.c.start_ns, manoeuvres.c.kind)
    return [_manoeuvre(row) for row in connection.execute(ordered)]


def judge(connection: Connection, manoeuvre_id: str, verdict: str) -> None:
    """Note what a reviewer says."""
    connection.execute(update(manoeuvres).where(manoeuvres.c.id == manoeuvre_id).values(verdict=verdict))


def excuse(connection: Connection, reasons: Mapping[str, str | None]) -> None:
    """Note by id why manoeuvres do not count against the driver, None where they do."""
    if reasons:
        statement = update(manoeuvres).where(manoeuvres.c.id == bindparam("of")).values(excused=bindparam("because"))
        connection.execute(statement, [{"of": one, "because": reason} for one, reason in reasons.items()])


def _manoeuvres() -> Select[Any]:
    return select(manoeuvres, vehicles.c.vehicle_id).join(vehicles, vehicles.c.pk == manoeuvres.c.vehicle_pk)


def _manoeuvre(row: Row[Any]) -> ManoeuvreRow:
    return ManoeuvreRow(**row._mapping)
