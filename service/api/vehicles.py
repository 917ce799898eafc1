"""Vehicles: register, look, change, remove; their latest state."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated, Any, Final, Literal, cast

from fastapi import APIRouter, Depends, Request, Response

from core.navigation.track import Mode
from schemas.keys import zenoh_prefix
from schemas.problem import Problem
from schemas.vehicles import (
    FusedState,
    LastPacket,
    ListedVehicle,
    Vehicle,
    VehicleList,
    VehicleState,
    VehicleUpdate,
)
from service.api.conditional import IfMatch, IfNoneMatch, answer, check_preconditions
from service.api.dependencies import Database, Directory, VehiclePath, the_vehicle
from service.api.pagination import Page, encode_cursor, link_next
from service.api.security import Principal, require
from service.calibrations import giving
from service.storage import audit, calibration_runs, retention, tenants, trips, vehicles
from service.storage.calibrations import EVER_NS, NONE_GIVEN, NewCalibration
from service.storage.database import read, write
from service.storage.trips import TrackRow
from service.storage.vehicles import VehicleRow

router = APIRouter(tags=["vehicles"])

Reader = Annotated[Principal, Depends(require("vehicles:read"))]
Writer = Annotated[Principal, Depends(require("vehicles:write"))]

MODES: Final = cast(
    Mapping[int, Literal["aligning", "aided", "coasting"]], {int(mode): mode.name.lower() for mode in Mode}
)
PRECONDITION: Final[dict[int | str, dict[str, Any]]] = {412: {"model": Problem, "description": "Changed meanwhile"}}


@router.get("/vehicles", response_model=VehicleList)
def list_vehicles(request: Request, caller: Reader, engine: Database, page: Page) -> Response:
    """The tenant's vehicles, by id."""
    position = page.after(str)
    after_id: str | None = None if position is None else position[0]
    with read(engine) as connection:
        rows = vehicles.page(connection, caller.tenant_id, after_id, page.limit + 1)
    shown = rows[: page.limit]
    next_cursor = encode_cursor(shown[-1].ref.vehicle_id) if len(rows) > page.limit else None
    listed = [ListedVehicle(**dict(_vehicle(row)), last_seen_at=row.last_seen_ns) for row in shown]
    body = VehicleList(vehicles=listed, next_cursor=next_cursor)
    return answer(request, body, headers=link_next(request, next_cursor))


@router.put(
    "/vehicles/{vehicle_id}",
    response_model=Vehicle,
    responses={201: {"model": Vehicle, "description": "Registered"}, **PRECONDITION},
)
def put_vehicle(
    request: Request,
    vehicle_id: VehiclePath,
    update: VehicleUpdate,
    caller: Writer,
    engine: Database,
    directory: Directory,
    if_match: IfMatch = None,
    if_none_match: IfNoneMatch = None,
) -> Response:
    """Register a vehicle, or change the settings of a registered one. Its session goes on with them."""
    with write(engine) as connection:
        tenants.lock(connection, caller.tenant_id)
        before = vehicles.find(connection, caller.tenant_id, vehicle_id)
        check_preconditions(None if before is None else _vehicle(before), if_match, if_none_match)
        row = vehicles.put(connection, caller.tenant_id, vehicle_id, update.config.settings())
        given = update.config.calibration
        earlier = [one for one in row.ref.calibrations if one.version != NONE_GIVEN]
        changed = None
        if given is not None and (not earlier or given != earlier[-1].calibration):
            from_ns, origin = (time.time_ns(), "put") if earlier else (EVER_NS, "registration")
            new = NewCalibration(given, from_ns, origin, created_by=caller.key_id)
            changed = giving.give(connection, row.ref, new)
            row = replace(row, ref=changed.ref)
    directory.changed(row.ref)
    if changed is not None:
        request.app.state.runtime.tell(row.ref, changed.event)
    if before is not None:
        return answer(request, _vehicle(row))
    return answer(request, _vehicle(row), status=201, headers={"Location": request.url.path})


@router.get("/vehicles/{vehicle_id}", response_model=Vehicle)
def get_vehicle(request: Request, vehicle_id: VehiclePath, caller: Reader, engine: Database) -> Response:
    """A vehicle with its settings."""
    with read(engine) as connection:
        row = the_vehicle(connection, caller.tenant_id, vehicle_id)
    return answer(request, _vehicle(row))


@router.delete("/vehicles/{vehicle_id}", status_code=204)
def delete_vehicle(
    request: Request, vehicle_id: VehiclePath, caller: Writer, engine: Database, directory: Directory
) -> Response:
    """Remove a vehicle and everything that is stored about it: packets, track, trips, accidents, events,
    evidence, calibrations and their recordings. That it was done stays in the audit."""
    with read(engine) as connection:
        row = the_vehicle(connection, caller.tenant_id, vehicle_id)
        run_ids = calibration_runs.ids_of(connection, row.ref.pk)
    retention.erase_history(engine, row.ref.pk)
    if directory.remove(caller.tenant_id, vehicle_id):
        with write(engine) as connection:
            subject = f"vehicle/{vehicle_id}"
            audit.note(connection, caller.tenant_id, caller.key_id, "vehicle.erased", subject, time.time_ns())
    request.app.state.runtime.run_files.erase(run_ids)
    return Response(status_code=204)


@router.get("/vehicles/{vehicle_id}/state", response_model=VehicleState)
def get_state(request: Request, vehicle_id: VehiclePath, caller: Reader, engine: Database) -> Response:
    """What is known of a vehicle right now: last heard of, durable up to where, and where it is."""
    with read(engine) as connection:
        row = the_vehicle(connection, caller.tenant_id, vehicle_id)
        packet = vehicles.newest_packet(connection, row.ref.pk)
        durable = None
        if packet is not None:
            gap_wait_ns = round(request.app.state.settings.gap_wait_s * 1e9)
            durable = vehicles.durable_sequence(connection, row.ref.pk, packet.boot_id, gap_wait_ns)
        position = trips.newest_position(connection, row.ref.pk) if caller.may("positions:read") else None
    body = VehicleState(
        vehicle_id=row.ref.vehicle_id,
        last_seen_at=row.last_seen_ns,
        last_packet=None
        if packet is None
        else LastPacket(
            boot_id=packet.boot_id,
            sequence=packet.sequence,
            start_time=packet.start_t_ns,
            received_at=packet.received_ns,
        ),
        durable_sequence=durable,
        fused=None if position is None else _fused(position),
    )
    return answer(request, body)


def _vehicle(row: VehicleRow) -> Vehicle:
    return Vehicle(
        vehicle_id=row.ref.vehicle_id,
        zenoh_prefix=zenoh_prefix(row.ref.tenant_id, row.ref.vehicle_id),
        config=row.ref.config,
        registered_at=row.registered_ns,
        updated_at=row.updated_ns,
    )


def _fused(row: TrackRow) -> FusedState:
    same = {name: getattr(row, name) for name in FusedState.model_fields if name in TrackRow.__slots__}
    same["mode"] = MODES[row.mode]
    return FusedState(time=row.t_ns, alt_ellipsoid_m=row.alt_m, speed_mps=math.hypot(row.vn_mps, row.ve_mps), **same)
