"""Calibration runs: a recording is uploaded, its parameters are computed, and somebody accepts or refuses them."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable
from typing import Annotated, Any, Final, cast
from uuid import uuid4

from fastapi import APIRouter, Depends, Path, Query, Request, Response
from sqlalchemy import Connection
from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect

from schemas.calibration import (
    AccelUnit,
    CalibrationRun,
    CalibrationRunList,
    CalibrationVersion,
    GyroUnit,
    RunOptions,
    RunStatus,
    Sensors,
)
from schemas.problem import Problem
from service.api.calibrations import shown
from service.api.conditional import answer, answer_content
from service.api.dependencies import ID_PATTERN, Database, Directory, VehiclePath, the_vehicle
from service.api.idempotency import IdempotencyKey, Idempotent, Once
from service.api.pagination import Page, encode_cursor, link_next
from service.api.security import Principal, require
from service.api.times import ValidFrom, time_ns
from service.calibrations import giving
from service.calibrations.files import RunFiles, Upload
from service.errors import BadRequestError, ConflictError, NotFoundError, UnsupportedMediaTypeError
from service.storage import calibration_runs, calibrations, tenants
from service.storage.calibration_runs import RunRow
from service.storage.calibrations import NewCalibration
from service.storage.database import read

router = APIRouter(tags=["calibration"])

MOST_OPEN: Final = 20
"""Runs of one tenant that wait; they are computed one after another."""
WRITTEN_AT_ONCE: Final = 1 << 20
"""Bytes of an upload that are handed to a thread together."""

REPORT_HEADERS: Final = {
    "Content-Security-Policy": "sandbox allow-scripts; default-src 'none'; style-src 'unsafe-inline'; "
    "script-src 'unsafe-inline'; img-src data:; frame-ancestors 'none'"
}
"""The report is a page without network, with styles and scripts of its own; it may do nothing in the caller's name."""

CONFLICT: Final[dict[int | str, dict[str, Any]]] = {409: {"model": Problem, "description": "Not in its present state"}}
UPLOAD: Final[dict[int | str, dict[str, Any]]] = {
    **CONFLICT,
    413: {"model": Problem, "description": "Larger than is taken"},
    415: {"model": Problem, "description": "Not a CSV file"},
}
_BINARY: Final = {"schema": {"type": "string", "format": "binary"}}
RECORDING: Final[dict[str, Any]] = {
    "requestBody": {
        "required": True,
        "description": "A header row with t_s, ax_mps2 … az_mps2, and where there are any gx_radps … gz_radps, "
        "mx_ut … mz_ut, temperature_c; text/csv also with Content-Encoding: gzip.",
        "content": {"text/csv": {"schema": {"type": "string"}}, "application/gzip": _BINARY},
    }
}

Reader = Annotated[Principal, Depends(require("vehicles:read"))]
Writer = Annotated[Principal, Depends(require("vehicles:write"))]
RunPath = Annotated[str, Path(pattern=ID_PATTERN, description="The run's id.")]


@router.post(
    "/vehicles/{vehicle_id}/calibration-runs",
    response_model=CalibrationRun,
    status_code=202,
    responses=UPLOAD,
    openapi_extra=RECORDING,
)
async def create_calibration_run(
    request: Request,
    vehicle_id: VehiclePath,
    caller: Writer,
    engine: Database,
    sensor: Annotated[Sensors, Query(description="What to calibrate; all that is recorded.")] = "all",
    gravity_mps2: Annotated[
        float | None, Query(ge=9.7, le=9.9, allow_inf_nan=False, description="Gravity at the place, if it is known.")
    ] = None,
    counts: Annotated[bool, Query(description="Columns that name no unit are in counts of the converters.")] = False,
    rate_hz: Annotated[
        float | None, Query(gt=0, le=10_000, allow_inf_nan=False, description="Of a recording with no t_s.")
    ] = None,
    accel_unit: Annotated[AccelUnit | None, Query(description="Of columns that name none.")] = None,
    gyro_unit: Annotated[GyroUnit | None, Query(description="Of columns that name none.")] = None,
    level: Annotated[
        bool, Query(description="The vehicle drove in circles on level ground: calibrates its magnetometer.")
    ] = False,
    idempotency_key: IdempotencyKey = None,
) -> Response:
    """Upload a recording of the box held still in many positions; its calibration is computed beside everything else.

    The answer comes once the recording is on disk. Follow the run at its Location until it is done or failed.
    """
    runtime = request.app.state.runtime
    files: RunFiles = runtime.run_files
    await run_in_threadpool(_check_vehicle, engine, caller.tenant_id, vehicle_id)
    limit = request.app.state.settings.max_recording_mib * 2**20
    upload = await run_in_threadpool(files.upload, limit, gzipped=_is_gzipped(request))
    try:
        await _receive(request, upload)
        options = RunOptions(
            sensor=sensor,
            gravity_mps2=gravity_mps2,
            counts=counts,
            rate_hz=rate_hz,
            accel_unit=accel_unit,
            gyro_unit=gyro_unit,
            level=level,
        )
        digest = hashlib.sha256(f"POST\0{request.url.path}\0{request.url.query}\0{upload.sha256}".encode()).hexdigest()
        once = Once(engine, caller.tenant_id, idempotency_key, digest)

        def create(connection: Connection) -> Response:
            tenants.lock(connection, caller.tenant_id)
            vehicle = the_vehicle(connection, caller.tenant_id, vehicle_id).ref
            if calibration_runs.count_open(connection, caller.tenant_id) >= MOST_OPEN:
                raise ConflictError(f"{MOST_OPEN} calibration runs are waiting, which is the most; let them finish")
            run = RunRow(
                id=str(uuid4()),
                vehicle_pk=vehicle.pk,
                status="queued",
                progress=0.0,
                options=options,
                recording_bytes=upload.bytes,
                recording_sha256=upload.sha256,
                created_ns=time.time_ns(),
            )
            calibration_runs.add(connection, run)
            files.keep(upload, run.id)
            location = {"Location": f"{request.url.path}/{run.id}"}
            return answer(request, _run(run, vehicle.vehicle_id), status=202, headers=location)

        response = await run_in_threadpool(once.run, create)
    finally:
        await run_in_threadpool(upload.discard)
    runtime.calibrating.notify()
    return response


@router.get("/vehicles/{vehicle_id}/calibration-runs", response_model=CalibrationRunList)
def list_calibration_runs(
    request: Request, vehicle_id: VehiclePath, caller: Reader, engine: Database, page: Page
) -> Response:
    """A vehicle's calibration runs, newest first."""
    with read(engine) as connection:
        vehicle = the_vehicle(connection, caller.tenant_id, vehicle_id).ref
        rows = calibration_runs.page(connection, vehicle.pk, page.after(int, str), page.limit + 1)
    listed = rows[: page.limit]
    next_cursor = encode_cursor(listed[-1].created_ns, listed[-1].id) if len(rows) > page.limit else None
    body = CalibrationRunList(runs=[_run(row, vehicle_id) for row in listed], next_cursor=next_cursor)
    return answer(request, body, headers=link_next(request, next_cursor))


@router.get("/vehicles/{vehicle_id}/calibration-runs/{run_id}", response_model=CalibrationRun)
def get_calibration_run(
    request: Request, vehicle_id: VehiclePath, run_id: RunPath, caller: Reader, engine: Database
) -> Response:
    """How far a run is, and what it found or why it failed."""
    with read(engine) as connection:
        vehicle = the_vehicle(connection, caller.tenant_id, vehicle_id).ref
        row = _the_run(connection, vehicle.pk, run_id)
    return answer(request, _run(row, vehicle_id))


@router.get(
    "/vehicles/{vehicle_id}/calibration-runs/{run_id}/report",
    response_class=Response,
    responses={200: {"content": {"text/html": {"schema": {"type": "string"}}}, "description": "A page of its own"}},
)
def get_calibration_report(
    request: Request, vehicle_id: VehiclePath, run_id: RunPath, caller: Reader, engine: Database
) -> Response:
    """The report of a run that is done: residuals, parameters with their spread, orientations, as one HTML page."""
    with read(engine) as connection:
        vehicle = the_vehicle(connection, caller.tenant_id, vehicle_id).ref
        row = _the_run(connection, vehicle.pk, run_id)
    path = request.app.state.runtime.run_files.report(row.id)
    if not row.has_report or not path.exists():
        raise NotFoundError(f"there is no report of this run, which is {row.status}")
    return answer_content(request, path.read_bytes(), media_type="text/html; charset=utf-8", headers=REPORT_HEADERS)


@router.post(
    "/vehicles/{vehicle_id}/calibration-runs/{run_id}:accept",
    response_model=CalibrationVersion,
    status_code=201,
    responses=CONFLICT,
)
def accept_calibration_run(
    request: Request,
    vehicle_id: VehiclePath,
    run_id: RunPath,
    caller: Writer,
    directory: Directory,
    once: Idempotent,
    valid_from: ValidFrom = None,
) -> Response:
    """Make what a run found the vehicle's calibration, from now on or from the time given."""
    from_ns = time_ns("valid_from", valid_from)
    taken: list[giving.Given] = []

    def accept(connection: Connection) -> Response:
        tenants.lock(connection, caller.tenant_id)
        vehicle = the_vehicle(connection, caller.tenant_id, vehicle_id).ref
        run = _undecided(connection, vehicle.pk, run_id)
        assert run.result is not None
        now_ns = time.time_ns()
        valid_from_ns = now_ns if from_ns is None else from_ns
        new = NewCalibration(run.result, valid_from_ns, "run", run_id=run.id, created_by=caller.key_id)
        given = giving.give(connection, vehicle, new)
        taken.append(given)
        calibration_runs.decide(connection, run.id, "accepted", given.row.version, now_ns)
        body = shown(given.row, calibrations.timeline(connection, vehicle.pk))
        location = {"Location": request.url.path.partition("/calibration-runs/")[0] + "/calibrations"}
        return answer(request, body, status=201, headers=location)

    response = once.run(accept)
    for given in taken:
        directory.changed(given.ref)
        request.app.state.runtime.tell(given.ref, given.event)
    return response


@router.post(
    "/vehicles/{vehicle_id}/calibration-runs/{run_id}:refuse", response_model=CalibrationRun, responses=CONFLICT
)
def refuse_calibration_run(
    request: Request, vehicle_id: VehiclePath, run_id: RunPath, caller: Writer, once: Idempotent
) -> Response:
    """Note that what a run found is not to be used; the vehicle's calibration stays."""

    def refuse(connection: Connection) -> Response:
        vehicle = the_vehicle(connection, caller.tenant_id, vehicle_id).ref
        run = _undecided(connection, vehicle.pk, run_id)
        calibration_runs.decide(connection, run.id, "refused", None, time.time_ns())
        return answer(request, _run(_the_run(connection, vehicle.pk, run_id), vehicle_id))

    return once.run(refuse)


def _check_vehicle(engine: Any, tenant_id: str, vehicle_id: str) -> None:
    with read(engine) as connection:
        the_vehicle(connection, tenant_id, vehicle_id)


def _is_gzipped(request: Request) -> bool:
    media_type = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    encoding = request.headers.get("content-encoding", "identity").strip().lower()
    if media_type in ("application/gzip", "application/x-gzip") and encoding == "identity":
        return True
    if media_type != "text/csv" or encoding not in ("identity", "gzip"):
        raise UnsupportedMediaTypeError(
            f"content-type '{media_type}', content-encoding '{encoding}': expected text/csv, plain or gzip"
        )
    return encoding == "gzip"


async def _receive(request: Request, upload: Upload) -> None:
    """Write the body as it comes, away from the event loop."""
    held = bytearray()

    async def flush(write: Callable[[bytes], None]) -> None:
        if held:
            await run_in_threadpool(write, bytes(held))
            held.clear()

    try:
        async for chunk in request.stream():
            held += chunk
            if len(held) >= WRITTEN_AT_ONCE:
                await flush(upload.write)
    except ClientDisconnect as error:
        raise BadRequestError("the connection ended before the recording did") from error
    await flush(upload.write)
    if not upload.bytes:
        raise BadRequestError("the body is empty; expected a recording as CSV")
    await run_in_threadpool(upload.finish)


def _the_run(connection: Connection, vehicle_pk: int, run_id: str, *, to_change: bool = False) -> RunRow:
    row = calibration_runs.find(connection, vehicle_pk, run_id, to_change=to_change)
    if row is None:
        raise NotFoundError(f"there is no calibration run '{run_id}' of this vehicle")
    return row


def _undecided(connection: Connection, vehicle_pk: int, run_id: str) -> RunRow:
    """The run, done and neither accepted nor refused."""
    run = _the_run(connection, vehicle_pk, run_id, to_change=True)
    if run.status != "done":
        raise ConflictError(f"the run is {run.status}; only what is done can be accepted or refused")
    if run.decision is not None:
        raise ConflictError(f"the run was {run.decision} before; upload the recording again to decide anew")
    return run


def _run(row: RunRow, vehicle_id: str) -> CalibrationRun:
    return CalibrationRun(
        id=row.id,
        vehicle_id=vehicle_id,
        status=cast(RunStatus, row.status),
        progress=row.progress,
        options=row.options,
        recording_bytes=row.recording_bytes,
        recording_sha256=row.recording_sha256,
        created_at=row.created_ns,
        started_at=row.started_ns,
        finished_at=row.finished_ns,
        result=row.result,
        problem=row.problem,
        has_report=row.has_report,
        decision=cast(Any, row.decision),
        decided_at=row.decided_ns,
        version=row.version,
    )
