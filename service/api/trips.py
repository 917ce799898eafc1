"""Trips of a vehicle, and the track of a trip."""

from __future__ import annotations

import math
import time
from typing import Annotated, Any, Final, Literal

from fastapi import APIRouter, Depends, Path, Query, Request, Response
from sqlalchemy import Connection

from core.driving.exposure import Facet, Light
from schemas import geojson
from schemas.geojson import GEOJSON_MEDIA_TYPE
from schemas.notifications import rfc3339
from schemas.problem import Problem
from schemas.trips import ManoeuvreList, Place, TrackCollection, Trip, TripList, TripRisk
from service.api.conditional import answer
from service.api.dependencies import ID_PATTERN, Database, VehiclePath, the_vehicle
from service.api.pagination import Page, encode_cursor, link_next
from service.api.security import Principal, require
from service.api.times import FromTime, ToTime, time_ns
from service.api.vehicles import MODES
from service.errors import NotAssessedError, NotFoundError
from service.storage import manoeuvres, records, trips
from service.storage.database import read
from service.storage.trips import TrackRow, TripRow
from service.trips.telling import risk_over_time, shown_manoeuvre

router = APIRouter(tags=["trips"])

Reader = Annotated[Principal, Depends(require("vehicles:read"))]
PositionReader = Annotated[Principal, Depends(require("positions:read"))]
RETRY_AFTER_S: Final = 5
TripPath = Annotated[str, Path(pattern=ID_PATTERN, description="The trip's id.")]


@router.get("/vehicles/{vehicle_id}/trips", response_model=TripList)
def list_trips(
    request: Request,
    vehicle_id: VehiclePath,
    caller: Reader,
    engine: Database,
    page: Page,
    from_: FromTime = None,
    to: ToTime = None,
) -> Response:
    """A vehicle's trips that touch the time asked for, newest first."""
    after = page.after(int, str)
    from_ns, to_ns = time_ns("from", from_), time_ns("to", to)
    with read(engine) as connection:
        vehicle = the_vehicle(connection, caller.tenant_id, vehicle_id)
        rows = trips.page(
            connection,
            caller.tenant_id,
            vehicle.ref.pk,
            from_ns=from_ns,
            to_ns=to_ns,
            after=after,
            limit=page.limit + 1,
        )
    shown = rows[: page.limit]
    next_cursor = encode_cursor(shown[-1].start_ns, shown[-1].id) if len(rows) > page.limit else None
    body = TripList(trips=[_trip(row, caller) for row in shown], next_cursor=next_cursor)
    return answer(request, body, headers=link_next(request, next_cursor))


@router.get("/trips/{trip_id}", response_model=Trip)
def get_trip(request: Request, trip_id: TripPath, caller: Reader, engine: Database) -> Response:
    """A trip's figures; where it began and ended only for keys with positions:read."""
    with read(engine) as connection:
        row = _the_trip(connection, caller.tenant_id, trip_id)
        assessed = records.find(connection, row.id)
    night = None if assessed is None else assessed.record.exposure.share(Facet.LIGHT, Light.NIGHT)
    return answer(request, _trip(row, caller).model_copy(update={"night_share": night}))


@router.get(
    "/trips/{trip_id}/risk",
    response_model=TripRisk,
    responses={409: {"model": Problem, "description": "Not assessed yet"}},
)
def get_risk(
    request: Request,
    trip_id: TripPath,
    caller: Reader,
    engine: Database,
    every: Annotated[int, Query(ge=1, le=3600, description="Every so many seconds of the trip.")] = 1,
) -> Response:
    """A trip's risk second by second: masses of belief, what they rest on, speed against the limit."""
    with read(engine) as connection:
        trip = _the_trip(connection, caller.tenant_id, trip_id)
        found = records.find(connection, trip.id)
    if found is None:
        detail = f"trip '{trip_id}' is not assessed yet; it takes some seconds after its end"
        raise NotAssessedError(detail, retry_after_s=RETRY_AFTER_S)
    return answer(request, risk_over_time(trip, found, every))


@router.get("/trips/{trip_id}/manoeuvres", response_model=ManoeuvreList)
def list_manoeuvres(request: Request, trip_id: TripPath, caller: Reader, engine: Database) -> Response:
    """Harsh braking, acceleration and cornering, and changes of lane on a trip."""
    with read(engine) as connection:
        trip = _the_trip(connection, caller.tenant_id, trip_id)
        rows = manoeuvres.between(connection, trip.vehicle_pk, trip.start_ns, trip.end_ns)
    shown = [shown_manoeuvre(row, places=caller.may("positions:read")) for row in rows]
    return answer(request, ManoeuvreList(manoeuvres=shown))


@router.get(
    "/trips/{trip_id}/track",
    responses={200: {"model": TrackCollection, "content": {GEOJSON_MEDIA_TYPE: {}}}},
    response_class=Response,
)
def get_track(request: Request, trip_id: TripPath, caller: PositionReader, engine: Database) -> Response:
    """Where a trip went, as GeoJSON, with the time of each position and how sure it is."""
    with read(engine) as connection:
        trip = _the_trip(connection, caller.tenant_id, trip_id)
        rows = trips.track(connection, trip)
    geometry = geojson.path([(row.lon_deg, row.lat_deg, row.alt_m) for row in rows])
    feature = geojson.feature(trip.id, geometry, _track_properties(trip, rows))
    return answer(request, {"type": "FeatureCollection", "features": [feature]}, media_type=GEOJSON_MEDIA_TYPE)


def _the_trip(connection: Connection, tenant_id: str, trip_id: str) -> TripRow:
    row = trips.find(connection, tenant_id, trip_id)
    if row is None:
        raise NotFoundError(f"there is no trip '{trip_id}'; GET /v1/vehicles/ID/trips lists a vehicle's")
    return row


def _trip(row: TripRow, caller: Principal) -> Trip:
    places = caller.may("positions:read")
    return Trip(
        id=row.id,
        vehicle_id=row.vehicle_id,
        start_at=row.start_ns,
        end_at=row.end_ns,
        ended=row.ended,
        start=Place(lat_deg=row.start_lat_deg, lon_deg=row.start_lon_deg) if places else None,
        end=Place(lat_deg=row.end_lat_deg, lon_deg=row.end_lon_deg) if places else None,
        distance_m=row.distance_m,
        moving_s=row.moving_s,
        coasting_s=row.coasting_s,
        max_speed_mps=row.max_speed_mps,
        # Due later than now it is assessed, but for roads that are looked up again.
        assessed=row.assessed_ns is not None and (row.due_ns is None or row.due_ns > time.time_ns()),
        road_lookup=_road_lookup(row),
    )


def _road_lookup(row: TripRow) -> Literal["done", "retrying", "failed"] | None:
    if row.assessed_ns is None:
        return None
    if row.road_failures is None:
        return "done"
    return "failed" if row.due_ns is None else "retrying"


def _track_properties(trip: TripRow, rows: list[TrackRow]) -> dict[str, Any]:
    # No model for each row: a day's track has tens of thousands; TrackProperties documents them.
    return {
        "trip_id": trip.id,
        "vehicle_id": trip.vehicle_id,
        "times": [rfc3339(row.t_ns) for row in rows],
        "speed_mps": [round(math.hypot(row.vn_mps, row.ve_mps), 3) for row in rows],
        "yaw_deg": [None if row.yaw_deg is None else round(row.yaw_deg, 2) for row in rows],
        "sd_n_m": [round(row.sd_n_m, 3) for row in rows],
        "sd_e_m": [round(row.sd_e_m, 3) for row in rows],
        "sd_d_m": [round(row.sd_d_m, 3) for row in rows],
        "cov_ne_m2": [float(f"{row.cov_ne_m2:.4g}") for row in rows],
        "mode": [MODES[row.mode] for row in rows],
    }
