"""Calibrations of a vehicle's box: the one that holds at a time, a new one, and all there were."""

from __future__ import annotations

import time
from typing import Annotated, Any, Final, cast

from fastapi import APIRouter, Depends, Request, Response
from sqlalchemy import Connection

from schemas.calibration import Calibration, CalibrationHistory, CalibrationVersion
from schemas.problem import Problem
from service.api.conditional import IfMatch, answer, check_preconditions
from service.api.dependencies import Database, Directory, VehiclePath, the_vehicle
from service.api.pagination import Page, encode_cursor, link_next
from service.api.security import Principal, require
from service.api.times import AtTime, ValidFrom, time_ns
from service.calibrations import giving
from service.storage import calibrations, tenants
from service.storage.calibrations import EVER_NS, NONE_GIVEN, CalibrationRow, NewCalibration, Timeline
from service.storage.database import read, write

router = APIRouter(tags=["calibration"])

Reader = Annotated[Principal, Depends(require("vehicles:read"))]
Writer = Annotated[Principal, Depends(require("vehicles:write"))]
PRECONDITION: Final[dict[int | str, dict[str, Any]]] = {412: {"model": Problem, "description": "Changed meanwhile"}}


@router.get("/vehicles/{vehicle_id}/calibration", response_model=CalibrationVersion)
def get_calibration(
    request: Request, vehicle_id: VehiclePath, caller: Reader, engine: Database, at: AtTime = None
) -> Response:
    """What is known of the box's sensors, now or at a time; null for a sensor that was never calibrated."""
    at_ns = time_ns("at", at)
    with read(engine) as connection:
        row = the_vehicle(connection, caller.tenant_id, vehicle_id)
        found = version_at(connection, row.ref.pk, time.time_ns() if at_ns is None else at_ns)
    return answer(request, found)


@router.put("/vehicles/{vehicle_id}/calibration", response_model=CalibrationVersion, responses=PRECONDITION)
def put_calibration(
    request: Request,
    vehicle_id: VehiclePath,
    calibration: Calibration,
    caller: Writer,
    engine: Database,
    directory: Directory,
    valid_from: ValidFrom = None,
    if_match: IfMatch = None,
) -> Response:
    """Put a calibration that holds from now on, or from the time given, as ``telefuse calibrate`` writes it.

    Sessions use the one that holds at the time of each sample. A time past is taken for packets that come in from now
    on; nothing is computed again. What is the same as that which holds now is not put twice.
    """
    from_ns = time_ns("valid_from", valid_from)
    now_ns = time.time_ns()
    with write(engine) as connection:
        tenants.lock(connection, caller.tenant_id)
        vehicle = the_vehicle(connection, caller.tenant_id, vehicle_id)
        current = version_at(connection, vehicle.ref.pk, now_ns)
        check_preconditions(current, if_match, None)
        if from_ns is None and current.version != NONE_GIVEN and _content(current) == calibration:
            return answer(request, current)
        new = NewCalibration(calibration, now_ns if from_ns is None else from_ns, "put", created_by=caller.key_id)
        given = giving.give(connection, vehicle.ref, new)
        body = shown(given.row, calibrations.timeline(connection, vehicle.ref.pk))
    directory.changed(given.ref)
    request.app.state.runtime.tell(given.ref, given.event)
    return answer(request, body)


@router.get("/vehicles/{vehicle_id}/calibrations", response_model=CalibrationHistory)
def list_calibrations(
    request: Request, vehicle_id: VehiclePath, caller: Reader, engine: Database, page: Page
) -> Response:
    """Every calibration of a vehicle with its time, the one put last first; those that trips made of them, too."""
    position = page.after(int)
    before = None if position is None else position[0]
    with read(engine) as connection:
        vehicle = the_vehicle(connection, caller.tenant_id, vehicle_id)
        rows = calibrations.page(connection, vehicle.ref.pk, before, page.limit + 1)
        timeline = calibrations.timeline(connection, vehicle.ref.pk)
    listed = rows[: page.limit]
    next_cursor = encode_cursor(listed[-1].version) if len(rows) > page.limit else None
    body = CalibrationHistory(calibrations=[shown(row, timeline) for row in listed], next_cursor=next_cursor)
    return answer(request, body, headers=link_next(request, next_cursor))


def version_at(connection: Connection, vehicle_pk: int, t_ns: int) -> CalibrationVersion:
    """The vehicle's calibration that holds at a time; version 0, all null, where none does."""
    timeline = calibrations.timeline(connection, vehicle_pk)
    row = calibrations.find(connection, vehicle_pk, timeline.version_at(t_ns))
    if row is not None:
        return shown(row, timeline)
    return CalibrationVersion(
        version=NONE_GIVEN,
        valid_from=None,
        valid_to=timeline.end_ns(NONE_GIVEN),
        origin=None,
        base=None,
        run_id=None,
        created_at=None,
        created_by=None,
    )


def shown(row: CalibrationRow, timeline: Timeline) -> CalibrationVersion:
    """A version as callers see it."""
    return CalibrationVersion(
        **dict(row.calibration),
        version=row.version,
        valid_from=None if row.valid_from_ns == EVER_NS else row.valid_from_ns,
        valid_to=timeline.end_ns(row.version),
        origin=cast(Any, row.origin),
        base=row.base,
        run_id=row.run_id,
        created_at=row.stored_ns,
        created_by=row.created_by,
    )


def _content(version: CalibrationVersion) -> Calibration:
    return Calibration(**{name: getattr(version, name) for name in Calibration.model_fields})
