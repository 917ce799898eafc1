"""What felt like an accident and was judged to be none: kept for a while, so that a reviewer can look."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Any

from sqlalchemy import Connection, Row, Select, and_, select, update

from service.storage.places import WhereAndWhen, of_tenant, page_of
from service.storage.statements import insert_into
from service.storage.tables import accident_candidates, vehicles


@dataclass(frozen=True, slots=True)
class CandidateRow:
    """A candidate; the columns of ``accident_candidates``, with its vehicle's name."""

    id: str
    tenant_id: str
    vehicle_pk: int
    vehicle_id: str
    t_ns: int
    decided_t_ns: int
    received_ns: int
    stored_ns: int
    reason: str
    probability: float
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


@dataclass(frozen=True, slots=True)
class CandidateFilter:
    """Which candidates are asked for; None asks for all."""

    where: WhereAndWhen = field(default_factory=WhereAndWhen)
    reasons: Collection[str] | None = None


def put(connection: Connection, row: CandidateRow) -> bool:
    """Store a candidate, unless it is there; whether it was not."""
    values = {column.name: getattr(row, column.name) for column in accident_candidates.c}
    insert = insert_into(connection, accident_candidates).values(**values | {"detail": dict(row.detail)})
    # Told by what returns: PostgreSQL's driver counts no rows here.
    new = insert.on_conflict_do_nothing(index_elements=[accident_candidates.c.id])
    return connection.execute(new.returning(accident_candidates.c.id)).first() is not None


def between(connection: Connection, vehicle_pk: int, from_ns: int, to_ns: int, reason: str) -> list[CandidateRow]:
    """A vehicle's candidates of one name in a time, both ends included, in their order."""
    table = accident_candidates
    mine = and_(table.c.vehicle_pk == vehicle_pk, table.c.t_ns.between(from_ns, to_ns), table.c.reason == reason)
    chosen = select(table, vehicles.c.vehicle_id).join(vehicles, vehicles.c.pk == table.c.vehicle_pk).where(mine)
    return [_candidate(row) for row in connection.execute(chosen.order_by(table.c.t_ns, table.c.id))]


def judge(connection: Connection, candidate_id: str, verdict: str) -> None:
    """Note what a reviewer says."""
    table = accident_candidates
    connection.execute(update(table).where(table.c.id == candidate_id).values(verdict=verdict))


def find(connection: Connection, tenant_id: str, candidate_id: str, *, to_change: bool = False) -> CandidateRow | None:
    """The tenant's candidate; ``to_change`` keeps others from changing it until the transaction ends."""
    statement = _candidates(tenant_id).where(accident_candidates.c.id == candidate_id)
    locked = statement.with_for_update(of=accident_candidates) if to_change else statement
    row = connection.execute(locked).one_or_none()
    return None if row is None else _candidate(row)


def page(
    connection: Connection, tenant_id: str, wanted: CandidateFilter, *, after: tuple[int, str] | None, limit: int
) -> list[CandidateRow]:
    """The tenant's candidates, newest first, those after ``after``."""
    chosen = _candidates(tenant_id)
    if wanted.reasons is not None:
        chosen = chosen.where(accident_candidates.c.reason.in_(wanted.reasons))
    rows = connection.execute(page_of(accident_candidates, chosen, wanted.where, after=after, limit=limit))
    return [_candidate(row) for row in rows]


def _candidates(tenant_id: str) -> Select[Any]:
    chosen = select(accident_candidates, vehicles.c.vehicle_id).select_from(accident_candidates)
    return of_tenant(accident_candidates, chosen, tenant_id)


def _candidate(row: Row[Any]) -> CandidateRow:
    return CandidateRow(**row._mapping)
