"""Manoeuvres: harsh braking, acceleration and cornering, and changes of lane, by vehicle and time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from sqlalchemy import Connection, Row, Select, and_, bindparam, false, or_, select, update

from service.storage.accidents import AccidentRow
from service.storage.places import WhereAndWhen
from service.storage.statements import insert_into
from service.storage.tables import manoeuvres, vehicles

FALSE = "false"
"""A reviewer's verdict: there was no such manoeuvre."""
CONFIRMED = "confirmed"
DEFENSIVE = "defensive"

ACCIDENT = "accident"
"""Why a manoeuvre does not count: the vehicle's own accident explains it."""
HAZARD = "hazard"
REVIEWER = "reviewer"


class Excuse(NamedTuple):
    """Why a manoeuvre does not count against its driver, and the id of the accident or candidate that explains it."""

    reason: str
    by: str | None = None


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
    excused_by: str | None = None
    verdict: str | None = None

    @property
    def excuse(self) -> Excuse | None:
        """Why it does not count."""
        return None if self.excused is None else Excuse(self.excused, self.excused_by)


def put(connection: Connection, row: ManoeuvreRow) -> bool:
    """Store a manoeuvre, unless it is there; whether it was not."""
    insert = insert_into(connection, manoeuvres).values(
        {column.name: getattr(row, column.name) for column in manoeuvres.c}
    )
    # Told by what returns: PostgreSQL's driver counts no rows here.
    new = insert.on_conflict_do_nothing(index_elements=[manoeuvres.c.id]).returning(manoeuvres.c.id)
    return connection.execute(new).first() is not None


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


def perhaps_because_of(
    connection: Connection, accident: AccidentRow, kind: str, wanted: WhereAndWhen
) -> list[ManoeuvreRow]:
    """Manoeuvres of the tenant's other vehicles that began in a box and a time, or that an accident excused."""
    in_time = manoeuvres.c.start_ns.between(wanted.from_ns, wanted.to_ns)
    near = false() if wanted.box is None else and_(in_time, wanted.box.holds(manoeuvres))
    theirs = and_(
        manoeuvres.c.tenant_id == accident.tenant_id,
        manoeuvres.c.vehicle_pk != accident.vehicle_pk,
        manoeuvres.c.kind == kind,
        or_(near, manoeuvres.c.excused_by == accident.id),
    )
    ordered = _manoeuvres().where(theirs).order_by(manoeuvres.c.start_ns, manoeuvres.c.id)
    return [_manoeuvre(row) for row in connection.execute(ordered)]


def excuse(connection: Connection, reasons: Mapping[str, Excuse | None]) -> None:
    """Note by id why manoeuvres do not count against the driver, None where they do."""
    if reasons:
        the_one = update(manoeuvres).where(manoeuvres.c.id == bindparam("of"))
        statement = the_one.values(excused=bindparam("because"), excused_by=bindparam("by"))
        told = ((one, (None, None) if reason is None else reason) for one, reason in reasons.items())
        connection.execute(statement, [{"of": one, "because": reason, "by": by} for one, (reason, by) in told])


def forget_cause(connection: Connection, causes: Select[tuple[str]]) -> None:
    """Name these accidents no more as what excuses a manoeuvre, which stays excused."""
    connection.execute(update(manoeuvres).where(manoeuvres.c.excused_by.in_(causes)).values(excused_by=None))


def _manoeuvres() -> Select[Any]:
    return select(manoeuvres, vehicles.c.vehicle_id).join(vehicles, vehicles.c.pk == manoeuvres.c.vehicle_pk)


def _manoeuvre(row: Row[Any]) -> ManoeuvreRow:
    return ManoeuvreRow(**row._mapping)
