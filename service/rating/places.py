"""The risk of places, from what a tenant's own vehicles drove where, and where they had accidents."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from typing import Final

import numpy as np
from sqlalchemy import Connection, select

from core.scoring.places import Places, places_from
from service.cells import cells
from service.local_days import Period
from service.storage import cell_sums
from service.storage.tables import accidents, record_rollups, vehicles

COUNTED: Final = ("suspected", "confirmed")


@dataclass(frozen=True, slots=True)
class BuiltPlaces:
    """The risk of places; ``left_out`` accidents were in cells where no trip has a record yet, or nowhere."""

    places: Places
    vehicles: int
    distance_m: float
    accidents: int
    left_out: int


def build_places(connection: Connection, tenant_id: str) -> BuiltPlaces:
    """Relativities of the cells in which a tenant's vehicles drove, by the accidents that nobody took back."""
    mine = vehicles.c.tenant_id == tenant_id
    years = (
        select(record_rollups.c.vehicle_pk, record_rollups.c.cells)
        .join(vehicles, vehicles.c.pk == record_rollups.c.vehicle_pk)
        .where(mine, record_rollups.c.period == Period.YEAR)
    )
    rows = connection.execute(years).all()
    driven = cell_sums.unpacked([row.cells for row in rows])
    placed = select(accidents.c.lat_deg, accidents.c.lon_deg).where(
        accidents.c.tenant_id == tenant_id, accidents.c.status.in_(COUNTED)
    )
    where = [(math.nan, math.nan) if lat is None else (lat, lon) for lat, lon in connection.execute(placed)]
    lat_lon_rad = np.radians(np.array(where, np.float64).reshape(-1, 2))
    found = cells(lat_lon_rad[:, 0], lat_lon_rad[:, 1])
    known = [cell for cell in found if cell in driven]
    return BuiltPlaces(
        places_from(driven, Counter(known)),
        vehicles=len({row.vehicle_pk for row in rows}),
        distance_m=math.fsum(one.distance_m for one in driven.values()),
        accidents=len(known),
        left_out=len(found) - len(known),
    )
