"""Trips and tracks, read."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from sqlalchemy import Connection, Row, Select, select, tuple_

from service.storage.tables import track_points, trips, vehicles


@dataclass(frozen=True, slots=True)
class TripRow:
    """A trip with its vehicle's name; the columns of ``trips``."""

    id: str
    vehicle_pk: int
    vehicle_id: str
    start_ns: int
    end_ns: int
    ended: bool
    start_lat_deg: float
    start_lon_deg: float
    end_lat_deg: float
    end_lon_deg: float
    distance_m: float
    moving_s: float
    coasting_s: float
    max_speed_mps: float


@dataclass(frozen=True, slots=True)
class TrackRow:
    """One fused position; the columns of ``track_points``."""

    t_ns: int
    lat_deg: float
    lon_deg: float
    alt_m: float
    vn_mps: float
    ve_mps: float
    vd_mps: float
    roll_deg: float | None
    pitch_deg: float | None
    yaw_deg: float | None
    sd_n_m: float
    sd_e_m: float
    sd_d_m: float
    cov_ne_m2: float
    sd_yaw_deg: float | None
    gnss_used: bool
    mode: int


def find(connection: Connection, tenant_id: str, trip_id: str) -> TripRow | None:
    """The tenant's trip."""
    row = connection.execute(_trips(tenant_id).where(trips.c.id == trip_id)).one_or_none()
    return None if row is None else _trip(row)


def page(
    connection: Connection,
    tenant_id: str,
    vehicle_pk: int,
    *,
    from_ns: int | None,
    to_ns: int | None,
    after: tuple[int, str] | None,
    limit: int,
) -> list[TripRow]:
    """A vehicle's trips that touch the time from ``from_ns`` to ``to_ns``, newest first, those after ``after``."""
    statement = _trips(tenant_id).where(trips.c.vehicle_pk == vehicle_pk)
    if from_ns is not None:
        statement = statement.where(trips.c.end_ns >= from_ns)
    if to_ns is not None:
        statement = statement.where(trips.c.start_ns <= to_ns)
    if after is not None:
        statement = statement.where(tuple_(trips.c.start_ns, trips.c.id) < tuple_(*after))
    statement = statement.order_by(trips.c.start_ns.desc(), trips.c.id.desc()).limit(limit)
    return [_trip(row) for row in connection.execute(statement)]


def track(connection: Connection, trip: TripRow) -> list[TrackRow]:
    """The fused positions of a trip, in time."""
    statement = select(*_TRACK_COLUMNS).where(
        track_points.c.vehicle_pk == trip.vehicle_pk,
        track_points.c.t_ns >= trip.start_ns,
        track_points.c.t_ns <= trip.end_ns,
    )
    return [TrackRow(*row) for row in connection.execute(statement.order_by(track_points.c.t_ns))]


def newest_position(connection: Connection, vehicle_pk: int) -> TrackRow | None:
    """Where the vehicle was last known to be."""
    row = connection.execute(
        select(*_TRACK_COLUMNS)
        .where(track_points.c.vehicle_pk == vehicle_pk)
        .order_by(track_points.c.t_ns.desc())
        .limit(1)
    ).one_or_none()
    return None if row is None else TrackRow(*row)


def position_before(connection: Connection, vehicle_pk: int, t_ns: int, within_ns: int) -> TrackRow | None:
    """Where the vehicle was at a time or shortly before."""
    row = connection.execute(
        select(*_TRACK_COLUMNS)
        .where(track_points.c.vehicle_pk == vehicle_pk, track_points.c.t_ns.between(t_ns - within_ns, t_ns))
        .order_by(track_points.c.t_ns.desc())
        .limit(1)
    ).one_or_none()
    return None if row is None else TrackRow(*row)


_TRACK_COLUMNS = [track_points.c[name] for name in TrackRow.__slots__]


def _trips(tenant_id: str) -> Select[Any]:
    return (
        select(trips, vehicles.c.vehicle_id)
        .join(vehicles, vehicles.c.pk == trips.c.vehicle_pk)
        .where(vehicles.c.tenant_id == tenant_id)
    )


def _trip(row: Row[Any]) -> TripRow:
    return TripRow(**row._mapping)
