"""Calibration runs: what was uploaded, how far its calculation is, and what came of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

from sqlalchemy import Connection, Row, and_, func, insert, or_, select, update

from schemas.calibration import Calibration, RunOptions, RunProblem
from service.storage.tables import calibration_runs, vehicles

OPEN: Final = ("queued", "running")


@dataclass(frozen=True, slots=True)
class RunRow:
    """One run; times are UTC nanoseconds."""

    id: str
    vehicle_pk: int
    status: str
    progress: float
    options: RunOptions
    recording_bytes: int
    recording_sha256: str
    created_ns: int
    started_ns: int | None = None
    finished_ns: int | None = None
    result: Calibration | None = None
    problem: RunProblem | None = None
    has_report: bool = False
    decision: str | None = None
    decided_ns: int | None = None
    version: int | None = None


def add(connection: Connection, run: RunRow) -> None:
    """Store a new run."""
    connection.execute(insert(calibration_runs).values(_columns(run)))


def find(connection: Connection, vehicle_pk: int, run_id: str, *, to_change: bool = False) -> RunRow | None:
    """A vehicle's run; ``to_change`` keeps others from changing it until the transaction ends."""
    table = calibration_runs
    statement = select(table).where(table.c.vehicle_pk == vehicle_pk, table.c.id == run_id)
    row = connection.execute(statement.with_for_update() if to_change else statement).one_or_none()
    return None if row is None else _run(row)


def page(connection: Connection, vehicle_pk: int, before: tuple[int, str] | None, limit: int) -> list[RunRow]:
    """A vehicle's runs, newest first, those before ``(created_ns, id)``."""
    table = calibration_runs
    statement = select(table).where(table.c.vehicle_pk == vehicle_pk)
    if before is not None:
        created_ns, run_id = before
        same = and_(table.c.created_ns == created_ns, table.c.id < run_id)
        statement = statement.where(or_(table.c.created_ns < created_ns, same))
    ordered = statement.order_by(table.c.created_ns.desc(), table.c.id.desc())
    return [_run(row) for row in connection.execute(ordered.limit(limit))]


def count_open(connection: Connection, tenant_id: str) -> int:
    """How many of a tenant's runs are not finished."""
    joined = calibration_runs.join(vehicles, vehicles.c.pk == calibration_runs.c.vehicle_pk)
    mine = select(func.count()).select_from(joined).where(vehicles.c.tenant_id == tenant_id)
    return int(connection.execute(mine.where(calibration_runs.c.status.in_(OPEN))).scalar_one())


def next_open(connection: Connection) -> RunRow | None:
    """The run that has waited longest; one under way was broken off, if whoever asks computes none."""
    table = calibration_runs
    waiting = select(table).where(table.c.status.in_(OPEN)).order_by(table.c.created_ns, table.c.id).limit(1)
    row = connection.execute(waiting).one_or_none()
    return None if row is None else _run(row)


def ids_of(connection: Connection, vehicle_pk: int) -> list[str]:
    """All runs of a vehicle."""
    return list(connection.scalars(select(calibration_runs.c.id).where(calibration_runs.c.vehicle_pk == vehicle_pk)))


def begin(connection: Connection, run_id: str, now_ns: int) -> None:
    """Note that a run is under way."""
    _set(connection, run_id, status="running", progress=0.0, started_ns=now_ns)


def note_progress(connection: Connection, run_id: str, progress: float) -> None:
    """Note how far a run is."""
    _set(connection, run_id, progress=progress)


def succeed(connection: Connection, run_id: str, result: Calibration, has_report: bool, now_ns: int) -> None:
    """Keep what a run found."""
    content = result.model_dump(mode="json", exclude_none=True)
    _set(connection, run_id, status="done", progress=1.0, result=content, has_report=has_report, finished_ns=now_ns)


def fail(connection: Connection, run_id: str, problem: RunProblem, now_ns: int) -> None:
    """Keep why a run found nothing."""
    _set(connection, run_id, status="failed", problem=problem.model_dump(), finished_ns=now_ns)


def decide(connection: Connection, run_id: str, decision: str, version: int | None, now_ns: int) -> None:
    """Keep what somebody made of a run's result."""
    _set(connection, run_id, decision=decision, version=version, decided_ns=now_ns)


def finished(connection: Connection) -> dict[str, int | None]:
    """Every run with when it was finished."""
    rows = connection.execute(select(calibration_runs.c.id, calibration_runs.c.finished_ns))
    return {row.id: row.finished_ns for row in rows}


def _set(connection: Connection, run_id: str, **values: Any) -> None:
    connection.execute(update(calibration_runs).where(calibration_runs.c.id == run_id).values(**values))


def _columns(run: RunRow) -> dict[str, Any]:
    values: dict[str, Any] = {name: getattr(run, name) for name in RunRow.__slots__}
    return values | {"options": run.options.model_dump(), "result": None, "problem": None}


def _run(row: Row[Any]) -> RunRow:
    values = {name: getattr(row, name) for name in RunRow.__slots__}
    values["options"] = RunOptions.model_validate(row.options)
    values["result"] = None if row.result is None else Calibration.model_validate(row.result)
    values["problem"] = None if row.problem is None else RunProblem.model_validate(row.problem)
    return RunRow(**values)
