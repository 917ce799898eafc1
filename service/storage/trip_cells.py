"""Which trips drove farthest in a cell: evidence of what a score says of places.

Sums of thousands of cells would be too large with evidence in them, so trips stand here by cell and distance, and only
the few cells that are told are looked up.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import lru_cache
from typing import Any, Final

from sqlalchemy import Connection, Select, and_, bindparam, delete, insert, select, union_all

from core.scoring.record import MOST_EVIDENCE, Evidence, heaviest
from service.storage import cell_sums
from service.storage.tables import trip_cells, trip_records

FEW: Final = 50
"""Trips that are read in less time than it takes to find them by their cells; measured with 10 000 in all."""
Driven = tuple[int, bytes]
"""When a trip began, and its cells as bytes of ``cell_sums``."""


def replace(connection: Connection, vehicle_pk: int, before: Iterable[Driven], now: Iterable[Driven]) -> None:
    """Have a vehicle's trips stand here as they are now in the place of those that were."""
    was, is_now = _rows(before), _rows(now)
    _remove(connection, vehicle_pk, was - is_now)
    _add(connection, vehicle_pk, is_now - was)


def farthest(
    connection: Connection, vehicle_pk: int, cells: Sequence[str], from_ns: int, to_ns: int, *, trips: int
) -> dict[str, list[Evidence]]:
    """Those of a vehicle's trips, begun from one instant up to another, that drove farthest in each of some cells.

    ``trips`` is how many began then: few are read themselves, as they would be long looked for among all others.
    """
    if not cells:
        return {}
    if trips <= FEW:
        return _of_few(connection, vehicle_pk, cells, from_ns, to_ns)
    values: dict[str, Any] = {"pk": vehicle_pk, "from_ns": from_ns, "to_ns": to_ns}
    values |= {f"cell_{number}": int(cell, 16) for number, cell in enumerate(cells)}
    found: dict[str, list[Evidence]] = {}
    for cell, distance_mm, trip_id in connection.execute(_farthest(len(cells)), values):
        found.setdefault(f"{cell:x}", []).append(Evidence(distance_mm, "trip", trip_id))
    return found


def _of_few(
    connection: Connection, vehicle_pk: int, cells: Sequence[str], from_ns: int, to_ns: int
) -> dict[str, list[Evidence]]:
    mine, begun = trip_records.c.vehicle_pk == vehicle_pk, trip_records.c.start_ns
    chosen = select(trip_records.c.trip_id, trip_records.c.cells).where(mine, begun >= from_ns, begun < to_ns)
    found: dict[str, list[Evidence]] = {}
    for trip_id, packed in connection.execute(chosen.order_by(begun)):
        driven = cell_sums.distances_mm(packed)
        for cell in cells:
            if distance_mm := driven.get(int(cell, 16)):
                found.setdefault(cell, []).append(Evidence(distance_mm, "trip", trip_id))
    return {cell: list(heaviest(pieces)) for cell, pieces in found.items()}


@lru_cache
def _farthest(cells: int) -> Select[Any]:
    table = trip_cells
    one = select(table.c.cell, table.c.distance_mm, table.c.start_ns).where(
        table.c.vehicle_pk == bindparam("pk"),
        table.c.start_ns >= bindparam("from_ns"),
        table.c.start_ns < bindparam("to_ns"),
    )
    # Down the primary key, so that a cell's first few are read and no more.
    down = one.order_by(table.c.distance_mm.desc(), table.c.start_ns.desc()).limit(MOST_EVIDENCE)
    each = [down.where(table.c.cell == bindparam(f"cell_{number}")).subquery() for number in range(cells)]
    every = union_all(*(select(part) for part in each)).subquery()
    trip = and_(trip_records.c.vehicle_pk == bindparam("pk"), trip_records.c.start_ns == every.c.start_ns)
    return select(every.c.cell, every.c.distance_mm, trip_records.c.trip_id).join(trip_records, trip)


def _rows(trips: Iterable[Driven]) -> set[tuple[int, int, int]]:
    return {
        (cell, distance_mm, start_ns)
        for start_ns, cells in trips
        for cell, distance_mm in cell_sums.distances_mm(cells).items()
    }


def _add(connection: Connection, vehicle_pk: int, rows: set[tuple[int, int, int]]) -> None:
    if rows:
        connection.execute(
            insert(trip_cells),
            [
                {"vehicle_pk": vehicle_pk, "cell": cell, "distance_mm": distance_mm, "start_ns": start_ns}
                for cell, distance_mm, start_ns in sorted(rows)
            ],
        )


def _remove(connection: Connection, vehicle_pk: int, rows: set[tuple[int, int, int]]) -> None:
    if rows:
        table = trip_cells
        the_row = and_(
            table.c.vehicle_pk == vehicle_pk,
            table.c.cell == bindparam("of_cell"),
            table.c.distance_mm == bindparam("of_mm"),
            table.c.start_ns == bindparam("of_ns"),
        )
        told = [{"of_cell": cell, "of_mm": mm, "of_ns": start_ns} for cell, mm, start_ns in sorted(rows)]
        connection.execute(delete(table).where(the_row), told)
