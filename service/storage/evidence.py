"""Evidence of accidents: asked for with the accident itself, built beside the hot path, kept as one file in its row."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

from sqlalchemy import Connection, delete, func, select, update

from schemas.vehicles import VehicleConfig
from service.storage.accidents import AccidentRow
from service.storage.statements import insert_into
from service.storage.tables import accidents, evidence, older_checkpoints

BEFORE_NS: Final = 60_000_000_000
AFTER_NS: Final = 30_000_000_000
"""What is kept around the start of the first impact."""

OPEN: Final = ("pending", "partial")
"""Not done with: more may come, and what it is built from must stay."""


@dataclass(frozen=True, slots=True)
class OpenEvidence:
    """What is still to be built, or to be built again once more has come."""

    accident_id: str
    tenant_id: str
    vehicle_pk: int
    t_ns: int
    status: str
    anchor_journal_id: int | None
    config: VehicleConfig
    created_ns: int
    built_ns: int | None


@dataclass(frozen=True, slots=True)
class EvidenceRow:
    """Evidence with its file, as far as it is built."""

    status: str
    created_ns: int
    built_ns: int | None
    reason: str | None
    sha256: str | None
    bundle: bytes | None


def ask_for(connection: Connection, accident: AccidentRow, config: VehicleConfig, now_ns: int) -> None:
    """Have evidence of an accident built, in the transaction that stores it; nothing where that was asked for."""
    older = older_checkpoints
    early_enough = (older.c.vehicle_pk == accident.vehicle_pk, older.c.t_ns < accident.t_ns - BEFORE_NS)
    insert = insert_into(connection, evidence).values(
        accident_id=accident.id,
        vehicle_pk=accident.vehicle_pk,
        t_ns=accident.t_ns,
        status="pending",
        anchor_journal_id=select(func.max(older.c.journal_id)).where(*early_enough).scalar_subquery(),
        config=config.model_dump(mode="json", exclude={"driver"}),  # who drives proves nothing here
        created_ns=now_ns,
    )
    connection.execute(insert.on_conflict_do_nothing(index_elements=[evidence.c.accident_id]))


def open_ones(connection: Connection) -> list[OpenEvidence]:
    """All that is not done with, the oldest first."""
    rows = connection.execute(
        select(
            evidence.c.accident_id,
            accidents.c.tenant_id,
            evidence.c.vehicle_pk,
            evidence.c.t_ns,
            evidence.c.status,
            evidence.c.anchor_journal_id,
            evidence.c.config,
            evidence.c.created_ns,
            evidence.c.built_ns,
        )
        .join(accidents, accidents.c.id == evidence.c.accident_id)
        .where(evidence.c.status.in_(OPEN))
        .order_by(evidence.c.created_ns, evidence.c.accident_id)
    )
    return [OpenEvidence(**{**row._mapping, "config": VehicleConfig.model_validate(row.config)}) for row in rows]


def is_open(connection: Connection, vehicle_pk: int) -> bool:
    """Whether a vehicle's packets are still needed for evidence."""
    mine = select(evidence.c.accident_id).where(evidence.c.vehicle_pk == vehicle_pk, evidence.c.status.in_(OPEN))
    return connection.execute(mine.limit(1)).first() is not None


def keep(connection: Connection, accident_id: str, status: str, bundle: bytes, sha256: str, now_ns: int) -> None:
    """Store what was built."""
    _set(connection, accident_id, status=status, built_ns=now_ns, reason=None, bundle=bundle, sha256=sha256)


def finish(connection: Connection, accident_id: str) -> None:
    """What was partial stays so."""
    _set(connection, accident_id, status="final")


def fail(connection: Connection, accident_id: str, reason: str, now_ns: int) -> None:
    """Note why there is none."""
    _set(connection, accident_id, status="failed", built_ns=now_ns, reason=reason[:500])


def find(connection: Connection, accident_id: str) -> EvidenceRow | None:
    """The evidence of an accident, with its file."""
    columns = (evidence.c[name] for name in EvidenceRow.__slots__)
    row = connection.execute(select(*columns).where(evidence.c.accident_id == accident_id)).one_or_none()
    return None if row is None else EvidenceRow(*row)


def prune(connection: Connection, before_ns: int, limit: int) -> int:
    """Remove some that were asked for before a time and are done with; returns how many."""
    old = select(evidence.c.accident_id).where(evidence.c.created_ns < before_ns, evidence.c.status.not_in(OPEN))
    return connection.execute(delete(evidence).where(evidence.c.accident_id.in_(old.limit(limit)))).rowcount


def _set(connection: Connection, accident_id: str, **values: Any) -> None:
    connection.execute(update(evidence).where(evidence.c.accident_id == accident_id).values(**values))
