"""Trips and tracks: read, and which of them wait to be assessed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from sqlalchemy import Connection, Row, Select, and_, func, or_, select, tuple_, update

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
    due_ns: int | None = None
    assessed_ns: int | None = None
    model_sha256: str | None = None
    road_failures: int | None = None


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
    sd_v_h_mps: float | None = None
    sd_tilt_deg: float | None = None
    sd_accel_bias_mps2: float | None = None


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
    return positions(connection, trip.vehicle_pk, trip.start_ns, trip.end_ns)


def due(connection: Connection, now_ns: int, silent_ns: int, limit: int) -> list[TripRow]:
    """Trips that wait to be assessed, the longest first: ended, or untouched for ``silent_ns``."""
    ready = and_(trips.c.due_ns <= now_ns, or_(trips.c.ended, trips.c.due_ns <= now_ns - silent_ns))
    statement = select(trips, vehicles.c.vehicle_id).join(vehicles, vehicles.c.pk == trips.c.vehicle_pk).where(ready)
    return [_trip(row) for row in connection.execute(statement.order_by(trips.c.due_ns, trips.c.id).limit(limit))]


def waiting(connection: Connection) -> tuple[int, int | None]:
    """How many ended trips wait to be assessed, and since when the first of them does."""
    row = connection.execute(select(func.count(), func.min(trips.c.due_ns)).where(trips.c.due_ns >= 0, trips.c.ended))
    count, since_ns = row.one()
    return count, since_ns


def mark_due(connection: Connection, vehicle_pk: int, from_ns: int, to_ns: int, now_ns: int) -> None:
    """Have a vehicle's trips assessed anew that touch the time from ``from_ns`` to ``to_ns``."""
    touched = and_(trips.c.vehicle_pk == vehicle_pk, trips.c.start_ns <= to_ns, trips.c.end_ns >= from_ns)
    connection.execute(update(trips).where(touched).values(due_ns=now_ns))


def mark_trip_due(connection: Connection, trip_id: str | None, now_ns: int) -> None:
    """Have a trip assessed anew."""
    connection.execute(update(trips).where(trips.c.id == trip_id).values(due_ns=now_ns))


def mark_assessed(
    connection: Connection,
    trip: TripRow,
    now_ns: int,
    model_sha256: str,
    *,
    again_ns: int | None = None,
    road_failures: int | None = None,
) -> bool:
    """Note that a trip is assessed; False, and nothing noted, where it has changed since it was read.

    ``again_ns`` is when its roads are to be looked up again, which failed so often.
    """
    values = {"due_ns": again_ns, "assessed_ns": now_ns, "model_sha256": model_sha256, "road_failures": road_failures}
    same = and_(trips.c.id == trip.id, trips.c.due_ns == trip.due_ns)
    return connection.execute(update(trips).where(same).values(values)).rowcount == 1


def give_up(connection: Connection, trip: TripRow) -> None:
    """Let a trip wait no more, until something about it changes."""
    same = and_(trips.c.id == trip.id, trips.c.due_ns == trip.due_ns)
    connection.execute(update(trips).where(same).values(due_ns=None))


def oldest_position_ns(connection: Connection, vehicle_pk: int) -> int | None:
    """How far back a vehicle's track is kept."""
    mine = track_points.c.vehicle_pk == vehicle_pk
    first: int | None = connection.execute(select(func.min(track_points.c.t_ns)).where(mine)).scalar()
    return first


def positions(connection: Connection, vehicle_pk: int, from_ns: int, to_ns: int) -> list[TrackRow]:
    """The fused positions of a time, both ends included."""
    statement = select(*_TRACK_COLUMNS).where(
        track_points.c.vehicle_pk == vehicle_pk, track_points.c.t_ns.between(from_ns, to_ns)
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
