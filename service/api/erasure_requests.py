"""Erasure of what is stored of a vehicle, on somebody's request."""

from __future__ import annotations

import time
from typing import Annotated, Final
from uuid import uuid4

from fastapi import APIRouter, Depends, Path, Request, Response
from sqlalchemy import Connection

from schemas.erasure import Erasure, NewErasure
from service.api.conditional import answer
from service.api.dependencies import ID_PATTERN, Database, Directory, the_vehicle
from service.api.idempotency import Idempotent
from service.api.security import Principal, require
from service.engine.sessions import open_session
from service.errors import NotFoundError, UnavailableError
from service.rating.announcing import announce
from service.storage import audit, calibration_runs, erasure, records, vehicles
from service.storage.database import read
from service.storage.erasure import ErasureRow, Span
from service.storage.vehicles import VehicleRef
from service.webhooks.outbox import NewEvent

router = APIRouter(tags=["operation"])

Admin = Annotated[Principal, Depends(require("admin"))]
RequestPath = Annotated[str, Path(pattern=ID_PATTERN, description="The request's id.")]
SET_ASIDE_S: Final = 30.0
"""How long the engine may take to let go of a vehicle: a commit, while the disk is busy."""


@router.post("/erasure-requests", response_model=Erasure, status_code=201)
def erase(
    request: Request, asked: NewErasure, caller: Admin, engine: Database, directory: Directory, once: Idempotent
) -> Response:
    """Erase what is stored of a vehicle, of a time or all: packets, track, trips, records, manoeuvres, accidents with
    their evidence, events with their deliveries, reviews, and what its session knows. What it adds to scores is taken
    out of all sums.

    Scores that are left are told by score.updated. What was given stays: registration, settings, calibrations, unless
    `unregister`. The audit says that it was done.
    """
    runtime = request.app.state.runtime
    with read(engine) as connection:
        known = vehicles.find(connection, caller.tenant_id, asked.vehicle_id)
        run_ids = [] if known is None else calibration_runs.ids_of(connection, known.ref.pk)
    span = Span.asked(asked.from_ns, asked.to_ns)
    bulk: dict[str, int] = {}
    told: list[tuple[VehicleRef, NewEvent]] = []

    def create(connection: Connection) -> Response:
        ref = the_vehicle(connection, caller.tenant_id, asked.vehicle_id).ref

        def anew() -> bytes:
            left = the_vehicle(connection, caller.tenant_id, asked.vehicle_id).ref
            return open_session(left.config, left.calibrations, None).snapshot()

        removed = erasure.remove(connection, ref, span, anew)
        if asked.unregister:
            vehicles.delete_row(connection, ref.pk)
            removed["vehicles"] = 1
        now_ns = time.time_ns()
        row = ErasureRow(
            id=str(uuid4()),
            tenant_id=caller.tenant_id,
            vehicle_id=asked.vehicle_id,
            from_ns=None if asked.from_ns is None else span.from_ns,
            to_ns=None if asked.to_ns is None else span.to_ns,
            unregister=asked.unregister,
            reason=asked.reason,
            actor=caller.key_id,
            created_ns=now_ns,
            removed={name: bulk.get(name, 0) + removed.get(name, 0) for name in sorted({*bulk, *removed})},
        )
        erasure.add(connection, row)
        subject = f"vehicle/{asked.vehicle_id}"
        said = {"erasure_request_id": row.id, "removed": dict(row.removed)}
        audit.note(connection, caller.tenant_id, caller.key_id, "vehicle.data_erased", subject, now_ns, said)
        if row.removed.get("trip_records") and records.bounds_ns(connection, ref.pk) is not None:
            event = announce(connection, runtime.reading, ref, cause="erasure", trip_id=None, now_ns=now_ns)
            told.append((ref, event))
        where = {"Location": f"/v1/erasure-requests/{row.id}"}
        return answer(request, _shown(row), status=201, headers=where)

    is_new = known is not None and once.is_new()
    try:
        if known is not None and is_new:
            if not runtime.engine.set_aside(known.ref.pk, SET_ASIDE_S):
                raise UnavailableError("the engine is too busy to let go of the vehicle; nothing is erased: try again")
            span = erasure.span_of(engine, known.ref.pk, span)
            bulk = erasure.remove_bulk(engine, known.ref.pk, span)
        response = once.run(create)
    finally:
        if known is not None and is_new:
            runtime.engine.take_back(known.ref.pk)
    for ref, event in told:
        runtime.tell(ref, event)
    if known is not None:
        with read(engine) as connection:
            left = vehicles.find(connection, caller.tenant_id, asked.vehicle_id)
        if left is not None:
            directory.changed(left.ref)  # what was learnt of its calibrations may be gone
        else:
            directory.removed(known.ref)
            runtime.run_files.erase(run_ids)
    return response


@router.get("/erasure-requests/{request_id}", response_model=Erasure)
def get_erasure_request(request: Request, request_id: RequestPath, caller: Admin, engine: Database) -> Response:
    """What was erased on a request."""
    with read(engine) as connection:
        row = erasure.find(connection, caller.tenant_id, request_id)
    if row is None:
        raise NotFoundError(f"there is no erasure request '{request_id}'; POST /v1/erasure-requests makes one")
    return answer(request, _shown(row))


def _shown(row: ErasureRow) -> Erasure:
    return Erasure(
        id=row.id,
        vehicle_id=row.vehicle_id,
        from_=row.from_ns,
        to=row.to_ns,
        unregister=row.unregister,
        reason=row.reason,
        requested_by=row.actor,
        erased_at=row.created_ns,
        removed=dict(row.removed),
    )
