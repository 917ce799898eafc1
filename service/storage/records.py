"""Records of trips and their sums by ``Period``, so that a year costs no more to ask for than a month."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import date
from itertools import pairwise
from typing import Any, Final

from sqlalchemy import (
    ColumnElement,
    Connection,
    ScalarSelect,
    Select,
    Table,
    and_,
    bindparam,
    delete,
    insert,
    or_,
    select,
    text,
    update,
)

from core.scoring.record import Record
from service.local_days import DEFAULT_ZONE, Period, cover, day_of
from service.storage import cell_sums, record_sums, trip_cells
from service.storage.statements import insert_into
from service.storage.tables import record_rollups, trip_records

_ROLLUPS_LOCK = 0x5C0E
"""PostgreSQL's lock under which a vehicle's sums are changed by one at a time; any fixed number would do."""


_Row = Any
"""A row with a record and, where asked for, cells."""


@dataclass(frozen=True, slots=True)
class TripRecord:
    """What a trip adds to scores; ``timeline`` is ``service.trips.timeline``'s."""

    trip_id: str
    vehicle_pk: int
    start_ns: int
    record: Record
    timeline: bytes
    model_sha256: str
    assessed_ns: int


def put(connection: Connection, row: TripRecord, *, zone: str = DEFAULT_ZONE) -> None:
    """Store a trip's record in the place of an earlier one, and bring the sums that it is part of up to date.

    ``zone`` is the vehicle's, by which its days are told apart.
    """
    _lock(connection, row.vehicle_pk)
    day = day_of(row.start_ns, zone)
    was = select(trip_records.c.day, trip_records.c.start_ns, trip_records.c.cells)
    before = connection.execute(was.where(trip_records.c.trip_id == row.trip_id)).one_or_none()
    cells = cell_sums.packed(row.record.cells)
    values = {
        "trip_id": row.trip_id,
        "vehicle_pk": row.vehicle_pk,
        "start_ns": row.start_ns,
        "day": day,
        "record": record_sums.told_of(row.record),
        "cells": cells,
        "timeline": row.timeline,
        "model_sha256": row.model_sha256,
        "assessed_ns": row.assessed_ns,
    }
    statement = insert_into(connection, trip_records).values(values)
    connection.execute(
        statement.on_conflict_do_update(
            index_elements=[trip_records.c.trip_id],
            set_={name: statement.excluded[name] for name in values if name != "trip_id"},
        )
    )
    was_driven = [] if before is None else [(before.start_ns, before.cells)]
    trip_cells.replace(connection, row.vehicle_pk, was_driven, [(row.start_ns, cells)])
    _sum_up(connection, row.vehicle_pk, {day} if before is None else {day, before.day}, zone)


def remove(connection: Connection, vehicle_pk: int, *trips: ColumnElement[bool], zone: str = DEFAULT_ZONE) -> int:
    """Remove the records of a vehicle's trips of which all of ``trips`` hold, and take them out of the sums.

    Conditions are on ``trip_records``; returns how many went.
    """
    _lock(connection, vehicle_pk)
    mine = and_(trip_records.c.vehicle_pk == vehicle_pk, *trips)
    told = trip_records.c.day, trip_records.c.start_ns, trip_records.c.cells
    gone = connection.execute(delete(trip_records).where(mine).returning(*told)).all()
    trip_cells.replace(connection, vehicle_pk, [(row.start_ns, row.cells) for row in gone], [])
    _sum_up(connection, vehicle_pk, {row.day for row in gone}, zone)
    return len(gone)


def find(connection: Connection, trip_id: str) -> TripRecord | None:
    """The record of a trip."""
    row = connection.execute(select(trip_records).where(trip_records.c.trip_id == trip_id)).one_or_none()
    if row is None:
        return None
    told = {name: getattr(row, name) for name in TripRecord.__slots__ if name != "record"}
    record = record_sums.record_of([row.record], cell_sums.unpacked([row.cells]))
    return TripRecord(record=record, **told)


def of_period(
    connection: Connection,
    vehicle_pk: int,
    from_ns: int,
    to_ns: int,
    *,
    zone: str = DEFAULT_ZONE,
    cells: bool = False,
) -> Record:
    """The sum of the records of a vehicle's trips that began from one instant up to another.

    Whole days and longer periods of ``zone``, the vehicle's, come from their sums. Without ``cells`` there are none.
    """
    parts = cover(from_ns, to_ns, zone)
    edges = parts.edges_ns
    periods = [{"period": period, "begin": begin, "end": end} for period, (begin, end) in parts.periods]
    rows = _in_spans(connection, _SUMS[cells], vehicle_pk, periods, _MOST_PERIODS)
    if any(row.zone != zone for row in rows):  # it was given another just now: ``rebuild`` is still to come
        rows, edges = [], ((from_ns, to_ns),)
    spans = [{"begin": begin, "end": end} for begin, end in edges]
    single = _in_spans(connection, _SINGLE[cells], vehicle_pk, spans, _MOST_EDGES)
    # A day counts as one, however little of it is asked for.
    days = len({day_of(row.start_ns, zone) for row in single})
    every = (*rows, *single)
    driven = cell_sums.unpacked([row.cells for row in every]) if cells else None
    record = record_sums.record_of((row.record for row in every), driven)
    return replace(record, days=record.days + days)


def bounds_ns(connection: Connection, vehicle_pk: int) -> tuple[int, int] | None:
    """When the first and the last of a vehicle's trips with a record began; None where there is none."""
    oldest, newest = connection.execute(_BOUNDS, {"vehicle_pk": vehicle_pk}).one()
    return None if oldest is None or newest is None else (oldest, newest)


def rebuild(connection: Connection, vehicle_pk: int, *, zone: str = DEFAULT_ZONE) -> None:
    """Sum up all of a vehicle's records anew, by the days of a time zone."""
    _lock(connection, vehicle_pk)
    connection.execute(delete(record_rollups).where(record_rollups.c.vehicle_pk == vehicle_pk))
    table, mine = trip_records, trip_records.c.vehicle_pk == vehicle_pk
    rows = connection.execute(select(table.c.trip_id, table.c.start_ns, table.c.day).where(mine)).all()
    days = {trip_id: day_of(start_ns, zone) for trip_id, start_ns, _ in rows}
    moved = [{"of": trip_id, "to": days[trip_id]} for trip_id, _, day in rows if day != days[trip_id]]
    if moved:
        statement = update(table).where(table.c.trip_id == bindparam("of")).values(day=bindparam("to"))
        connection.execute(statement, moved)
    _sum_up(connection, vehicle_pk, set(days.values()), zone)


def zones(connection: Connection, vehicle_pk: int | None = None) -> list[tuple[int, str]]:
    """Vehicles, or one of them, with the time zones by which their records are summed."""
    chosen = select(record_rollups.c.vehicle_pk, record_rollups.c.zone).where(record_rollups.c.period == Period.YEAR)
    if vehicle_pk is not None:
        chosen = chosen.where(record_rollups.c.vehicle_pk == vehicle_pk)
    return [(pk, zone) for pk, zone in connection.execute(chosen.distinct())]


def _lock(connection: Connection, vehicle_pk: int) -> None:
    # Two that sum up a vehicle's day at once would each miss what the other adds. SQLite has one writer anyway.
    if connection.dialect.name == "postgresql":
        key = {"one": _ROLLUPS_LOCK, "two": vehicle_pk % (1 << 31)}
        connection.execute(text("SELECT pg_advisory_xact_lock(:one, :two)"), key)


def _sum_up(connection: Connection, vehicle_pk: int, days: set[date], zone: str) -> None:
    """Make the sums anew that some days are part of, each from what is below it."""
    if not days:
        return
    by_day: dict[date, list[_Row]] = defaultdict(list)
    table = trip_records
    chosen = select(table.c.day, table.c.record, table.c.cells)
    for row in connection.execute(chosen.where(table.c.vehicle_pk == vehicle_pk, table.c.day.in_(days))):
        by_day[row.day].append(row)
    _keep(connection, vehicle_pk, Period.DAY, {day: by_day[day] for day in days}, zone)
    for below, period in pairwise(reversed(Period)):
        begins = {period.begin_of(day) for day in days}
        parts = {begin: _parts(connection, vehicle_pk, below, begin, period.next_of(begin)) for begin in begins}
        _keep(connection, vehicle_pk, period, parts, zone)


def _parts(connection: Connection, vehicle_pk: int, period: Period, begin: date, end: date) -> Sequence[_Row]:
    table = record_rollups
    chosen = select(table.c.record, table.c.cells).where(
        table.c.vehicle_pk == vehicle_pk, table.c.period == period, table.c.begin >= begin, table.c.begin < end
    )
    return connection.execute(chosen).all()


def _keep(
    connection: Connection,
    vehicle_pk: int,
    period: Period,
    parts: Mapping[date, Sequence[_Row]],
    zone: str,
) -> None:
    """Store the sums of what periods are made of; where that is nothing there is none."""
    table = record_rollups
    mine = and_(table.c.vehicle_pk == vehicle_pk, table.c.period == period, table.c.begin.in_(list(parts)))
    connection.execute(delete(table).where(mine))
    rows = [
        {
            "vehicle_pk": vehicle_pk,
            "period": period,
            "begin": begin,
            "zone": zone,
            "record": _told(period, made_of),
            "cells": cell_sums.added([one.cells for one in made_of]),
        }
        for begin, made_of in sorted(parts.items())
        if made_of
    ]
    if rows:
        connection.execute(insert(table), rows)


def _told(period: Period, made_of: Sequence[_Row]) -> dict[str, Any]:
    told = record_sums.added([one.record for one in made_of])
    if period is Period.DAY:
        told["sums"]["days"] = 1
    # In an order of their own, as the same sums are to be the same bytes whichever rows came first.
    return {**told, "sums": dict(sorted(told["sums"].items())), "evidence": dict(sorted(told["evidence"].items()))}


def _spans(table: Table, key: str, begin: str, most: int, *also: str) -> dict[bool, Select[Any]]:
    """The query for records of a vehicle in some spans of time, without cells and with them, made and compiled once."""
    any_of = [
        and_(
            table.c[begin] >= bindparam(f"begin{number}"),
            table.c[begin] < bindparam(f"end{number}"),
            *(table.c[name] == bindparam(f"{name}{number}") for name in also),
        )
        for number in range(most)
    ]
    mine = table.c.vehicle_pk == bindparam("vehicle_pk")
    return {
        cells: select(*(table.c[name] for name in (key, "record", *(("cells",) if cells else ())))).where(
            mine, or_(*any_of)
        )
        for cells in (False, True)
    }


def _in_spans(
    connection: Connection, query: Select[Any], vehicle_pk: int, spans: Sequence[Mapping[str, Any]], most: int
) -> Sequence[_Row]:
    if not spans:
        return []
    # Fewer than the query has room for: the last one again, which finds nothing twice.
    filled = [*spans, *[spans[-1]] * (most - len(spans))]
    values = {f"{name}{number}": value for number, span in enumerate(filled) for name, value in span.items()}
    return connection.execute(query, {"vehicle_pk": vehicle_pk} | values).all()


_MOST_PERIODS: Final = 2 * len(Period) - 1
"""Spans in which a cover has whole periods: years are together, shorter ones lie at both ends."""
_MOST_EDGES: Final = 2
_SUMS: Final = _spans(record_rollups, "zone", "begin", _MOST_PERIODS, "period")
_SINGLE: Final = _spans(trip_records, "start_ns", "start_ns", _MOST_EDGES)


def _bound(newest: bool) -> ScalarSelect[int]:
    at = trip_records.c.start_ns
    mine = select(at).where(trip_records.c.vehicle_pk == bindparam("vehicle_pk"))
    return mine.order_by(at.desc() if newest else at).limit(1).scalar_subquery()


_BOUNDS: Final = select(_bound(newest=False), _bound(newest=True))
