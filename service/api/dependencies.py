"""What endpoints ask for: the database, the vehicle directory, the caller's vehicle.

Dependencies that wait for nothing are coroutines: FastAPI hands each other one to a thread, which costs more than it
does.
"""

from __future__ import annotations

from typing import Annotated, Final

from fastapi import Depends, Path, Request
from sqlalchemy import Connection, Engine

from schemas.model import VehicleId
from service.errors import NotFoundError
from service.storage import vehicles
from service.storage.vehicles import VehicleDirectory, VehicleRow


async def database(request: Request) -> Engine:
    """The database; endpoints open their own transactions, and commit before they answer."""
    engine: Engine = request.app.state.runtime.database
    return engine


async def directory(request: Request) -> VehicleDirectory:
    """The vehicles, through which they must be changed."""
    found: VehicleDirectory = request.app.state.runtime.directory
    return found


Database = Annotated[Engine, Depends(database)]
Directory = Annotated[VehicleDirectory, Depends(directory)]
ID_PATTERN: Final = r"^[A-Za-z0-9-]{1,36}$"
"""Ids that the service gives out."""

VehiclePath = Annotated[VehicleId, Path(description="The vehicle's id.", examples=["WVWZZZ1KZAW000001"])]


def the_vehicle(
    connection: Connection, tenant_id: str, vehicle_id: str, *, with_calibrations: bool = True
) -> VehicleRow:
    """The tenant's vehicle; raises NotFoundError for none, also where another tenant has one of that name."""
    row = vehicles.find(connection, tenant_id, vehicle_id, with_calibrations=with_calibrations)
    if row is None:
        raise no_vehicle(vehicle_id)
    return row


def no_vehicle(vehicle_id: str) -> NotFoundError:
    """What is answered where the tenant has no vehicle of that name."""
    return NotFoundError(f"there is no vehicle '{vehicle_id}'; register it with PUT /v1/vehicles/{vehicle_id}")
