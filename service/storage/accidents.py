"""Accidents: told again as more is known, read by place, time, kind, status, severity and vehicle."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Final

from sqlalchemy import Connection, Row, Select, and_, case, or_, select, update

from service.storage.places import WhereAndWhen, of_tenant, page_of
from service.storage.statements import insert_into
from service.storage.tables import accidents, evidence, trips, vehicles

TRIP_LINK_NS: Final = 3600 * 1_000_000_000
"""An accident belongs to the newest trip begun before it, unless that one came to its end longer ago than this."""

SHOWN: Final = ("suspected", "confirmed")
"""What is listed unless somebody asks for others: retracted and false ones were none."""

REVIEWER: Final = "reviewer"
"""The ``detector`` of accidents that a person made of a candidate."""

_OF_FIRST: Final = ("id", "tenant_id", "vehicle_pk", "trip_id", "t_ns", "received_ns", "stored_ns", "verdict", "street")
"""Columns that no later revision changes."""

_FORMERLY_UNSAID: Final[Mapping[str, Any]] = {
    "delta_v_interval_mps": [None, None],
    "pdof_sd_deg": None,
    "impacts": 1,
    "each_impact": [],
    "rollover": False,
    "injury": None,
    "reasons": [],
}
"""Figures that accidents of earlier versions do not have."""


@dataclass(frozen=True, slots=True)
class AccidentRow:
    """An accident; the columns of ``accidents``, with its vehicle's name and how far its evidence is."""

    id: str
    tenant_id: str
    vehicle_pk: int
    vehicle_id: str
    trip_id: str | None
    t_ns: int
    decided_t_ns: int
    received_ns: int
    stored_ns: int
    revision: int
    kind: str
    status: str
    severity: str
    confidence: float
    lat_deg: float | None
    lon_deg: float | None
    alt_m: float | None
    sd_n_m: float | None
    sd_e_m: float | None
    cov_ne_m2: float | None
    heading_deg: float | None
    mode: int
    detail: Mapping[str, Any]
    verdict: str | None = None
    street: str | None = None
    evidence: str | None = None

    @property
    def is_none(self) -> bool:
        """Whether it turned out to be no accident."""
        return self.status not in SHOWN


@dataclass(frozen=True, slots=True)
class AccidentFilter:
    """Which accidents are asked for; None asks for all."""

    where: WhereAndWhen = field(default_factory=WhereAndWhen)
    severities: Collection[str] | None = None
    statuses: Collection[str] | None = None
    kinds: Collection[str] | None = None


def put(connection: Connection, row: AccidentRow) -> AccidentRow:
    """Store a revision, unless a newer one is there; returns it with the status that a reviewer gave, if one did."""
    values = {column.name: getattr(row, column.name) for column in accidents.c}
    insert = insert_into(connection, accidents).values(**values | {"detail": dict(row.detail)})
    revised: dict[str, Any] = {
        column.name: insert.excluded[column.name] for column in accidents.c if column.name not in _OF_FIRST
    }
    revised["status"] = case((accidents.c.verdict.is_(None), insert.excluded.status), else_=accidents.c.status)
    connection.execute(
        insert.on_conflict_do_update(
            index_elements=[accidents.c.id],
            set_=revised,
            where=accidents.c.revision < insert.excluded.revision,
        )
    )
    verdict = connection.execute(select(accidents.c.verdict).where(accidents.c.id == row.id)).scalar_one()
    return row if verdict is None else replace(row, verdict=verdict, status=verdict)


def judge(connection: Connection, accident_id: str, verdict: str) -> None:
    """Give an accident the status that a reviewer says."""
    connection.execute(update(accidents).where(accidents.c.id == accident_id).values(verdict=verdict, status=verdict))


def name_street(connection: Connection, accident_id: str, street: str) -> None:
    """Note the street on which it was."""
    connection.execute(update(accidents).where(accidents.c.id == accident_id).values(street=street[:300]))


def trip_at(connection: Connection, vehicle_pk: int, t_ns: int) -> str | None:
    """The trip on which something happened to a vehicle."""
    found: str | None = connection.execute(
        select(trips.c.id)
        .where(trips.c.vehicle_pk == vehicle_pk, trips.c.start_ns <= t_ns, trips.c.end_ns >= t_ns - TRIP_LINK_NS)
        .order_by(trips.c.start_ns.desc())
        .limit(1)
    ).scalar_one_or_none()
    return found


def of_trip(connection: Connection, tenant_id: str, trip_id: str) -> list[AccidentRow]:
    """The accidents of a trip, those that turned out to be none as well, in their order."""
    statement = _accidents(tenant_id).where(accidents.c.trip_id == trip_id).order_by(accidents.c.t_ns, accidents.c.id)
    return [_accident(row) for row in connection.execute(statement)]


def of_others(connection: Connection, tenant_id: str, vehicle_pk: int, wanted: WhereAndWhen) -> list[AccidentRow]:
    """Accidents of the tenant's other vehicles that nobody took back, the newest first."""
    table = accidents
    theirs = and_(table.c.vehicle_pk != vehicle_pk, table.c.status.in_(SHOWN))
    rows = connection.execute(page_of(table, _accidents(tenant_id).where(theirs), wanted, after=None, limit=None))
    return [_accident(row) for row in rows]


def strays(connection: Connection, vehicle_pk: int, trip_id: str, from_ns: int, to_ns: int) -> dict[str, str | None]:
    """Accidents in the time of a trip, by id, with the earlier trip, or none, to which they were counted before it was
    told."""
    inside = and_(accidents.c.vehicle_pk == vehicle_pk, accidents.c.t_ns.between(from_ns, to_ns))
    other = or_(accidents.c.trip_id.is_(None), accidents.c.trip_id != trip_id)
    chosen = select(accidents.c.id, accidents.c.trip_id).where(inside, other)
    return {row.id: row.trip_id for row in connection.execute(chosen)}


def give_to_trip(connection: Connection, accident_ids: Collection[str], trip_id: str) -> None:
    """Have accidents belong to a trip."""
    connection.execute(update(accidents).where(accidents.c.id.in_(accident_ids)).values(trip_id=trip_id))


def find(connection: Connection, tenant_id: str, accident_id: str, *, to_change: bool = False) -> AccidentRow | None:
    """The tenant's accident; ``to_change`` keeps others from changing it until the transaction ends."""
    statement = _accidents(tenant_id).where(accidents.c.id == accident_id)
    row = connection.execute(statement.with_for_update(of=accidents) if to_change else statement).one_or_none()
    return None if row is None else _accident(row)


def page(
    connection: Connection, tenant_id: str, wanted: AccidentFilter, *, after: tuple[int, str] | None, limit: int
) -> list[AccidentRow]:
    """The tenant's accidents, newest first, those after ``after``."""
    chosen = _accidents(tenant_id)
    for column, values in (
        (accidents.c.severity, wanted.severities),
        (accidents.c.status, wanted.statuses),
        (accidents.c.kind, wanted.kinds),
    ):
        if values is not None:
            chosen = chosen.where(column.in_(values))
    return [
        _accident(row) for row in connection.execute(page_of(accidents, chosen, wanted.where, after=after, limit=limit))
    ]


def _accidents(tenant_id: str) -> Select[Any]:
    chosen = select(accidents, vehicles.c.vehicle_id, evidence.c.status.label("evidence")).select_from(
        accidents.outerjoin(evidence, evidence.c.accident_id == accidents.c.id)
    )
    return of_tenant(accidents, chosen, tenant_id)


def _accident(row: Row[Any]) -> AccidentRow:
    return AccidentRow(**{**row._mapping, "detail": {**_FORMERLY_UNSAID, **row.detail}})
