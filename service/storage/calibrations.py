"""Calibrations of vehicles: each version with the time from which it holds, and which one holds when."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final
from uuid import uuid4

from sqlalchemy import Connection, Row, func, select, tuple_

from schemas.calibration import Calibration
from service.storage.statements import insert_into
from service.storage.tables import calibrations, journal, vehicles

EVER_NS: Final = 0
"""``valid_from_ns`` of what holds for all packets."""

TOLD_NS: Final = 1000
"""Times are told to the microsecond, so versions begin on one: who asks for that time gets the version."""

NONE_GIVEN: Final = 0
"""The version that holds while none was given: the box as it measures."""


_NEVER_NS: Final = 2**63


@dataclass(frozen=True, slots=True)
class CalibrationRow:
    """One version; ``base`` as in ``tables.calibrations``."""

    version: int
    base: int | None
    valid_from_ns: int
    origin: str
    run_id: str | None
    created_by: str | None
    journal_id: int
    stored_ns: int
    calibration: Calibration


@dataclass(frozen=True, slots=True)
class GivenCalibration:
    """A version as sessions use it: by the time of the samples, and only for packets after ``journal_id``.

    ``learnt`` is the newest that the vehicle's trips have made of its biases.
    """

    version: int
    valid_from_ns: int
    journal_id: int
    calibration: Calibration
    learnt: CalibrationRow | None = None


@dataclass(frozen=True, slots=True)
class NewCalibration:
    """What is to become a version."""

    calibration: Calibration
    valid_from_ns: int
    origin: str
    run_id: str | None = None
    created_by: str | None = None


class Timeline:
    """Which of a vehicle's versions holds when.

    At any time the given version holds that begins last, of several the one put last; after it those count that
    bring its own biases up to date. So what is put takes over from whatever trips made of the one before, also for
    times past.
    """

    def __init__(self, versions: Iterable[tuple[int, int | None, int]]) -> None:
        """Each a (version, base, valid_from_ns)."""
        rows = sorted((from_ns, version, base) for version, base, from_ns in versions)
        given = [(EVER_NS, NONE_GIVEN), *((from_ns, version) for from_ns, version, base in rows if base is None)]
        updates: dict[int | None, list[tuple[int, int]]] = {}
        for from_ns, version, base in rows:
            updates.setdefault(base, []).append((from_ns, version))
        self._ends: dict[int, int] = {}
        self._begins: list[int] = []
        self._versions: list[int] = []
        for (from_ns, version), (end_ns, _) in pairwise([*given, (_NEVER_NS, 0)]):
            own = [(max(at_ns, from_ns), update) for at_ns, update in updates.get(version, ())]
            for (begin_ns, one), (next_ns, _) in pairwise([(from_ns, version), *own, (end_ns, 0)]):
                self._ends[one] = until_ns = max(begin_ns, min(next_ns, end_ns))
                if begin_ns < until_ns:
                    self._begins.append(begin_ns)
                    self._versions.append(one)

    def version_at(self, t_ns: int) -> int:
        """The version that holds at a time; ``NONE_GIVEN`` for none."""
        return self._versions[max(bisect_right(self._begins, t_ns) - 1, 0)]

    def end_ns(self, version: int) -> int | None:
        """Until when a version holds; None while nothing follows, its own beginning where it never does."""
        end_ns = self._ends[version]
        return None if end_ns == _NEVER_NS else end_ns


def timeline(connection: Connection, vehicle_pk: int) -> Timeline:
    """The vehicle's."""
    known = select(calibrations.c.version, calibrations.c.base, calibrations.c.valid_from_ns)
    rows = connection.execute(known.where(calibrations.c.vehicle_pk == vehicle_pk))
    return Timeline((row.version, row.base, row.valid_from_ns) for row in rows)


def find(connection: Connection, vehicle_pk: int, version: int) -> CalibrationRow | None:
    """A vehicle's version; None where there is none, as of ``NONE_GIVEN``."""
    row = connection.execute(
        select(calibrations).where(calibrations.c.vehicle_pk == vehicle_pk, calibrations.c.version == version)
    ).one_or_none()
    return None if row is None else _row(row)


def page(connection: Connection, vehicle_pk: int, before: int | None, limit: int) -> list[CalibrationRow]:
    """A vehicle's versions, newest first, those before ``before``."""
    statement = select(calibrations).where(calibrations.c.vehicle_pk == vehicle_pk)
    if before is not None:
        statement = statement.where(calibrations.c.version < before)
    return [_row(row) for row in connection.execute(statement.order_by(calibrations.c.version.desc()).limit(limit))]


def given(connection: Connection, vehicle_pks: Sequence[int]) -> dict[int, tuple[GivenCalibration, ...]]:
    """What sessions of these vehicles use, by vehicle; of one without any there is nothing."""
    mine = calibrations.c.vehicle_pk.in_(vehicle_pks)
    newest = (
        select(calibrations.c.vehicle_pk, func.max(calibrations.c.version))
        .where(mine, calibrations.c.base.is_not(None))
        .group_by(calibrations.c.vehicle_pk, calibrations.c.base)
    )
    learnt: dict[tuple[int, int], CalibrationRow] = {}
    key = tuple_(calibrations.c.vehicle_pk, calibrations.c.version)
    for row in connection.execute(select(calibrations).where(key.in_(newest))):
        learnt[row.vehicle_pk, row.base] = _row(row)
    found: dict[int, list[GivenCalibration]] = {}
    for pk, base in learnt:
        if base == NONE_GIVEN:
            found[pk] = [GivenCalibration(NONE_GIVEN, EVER_NS, 0, Calibration(), learnt[pk, base])]
    order = (calibrations.c.vehicle_pk, calibrations.c.valid_from_ns, calibrations.c.version)
    for row in connection.execute(select(calibrations).where(mine, calibrations.c.base.is_(None)).order_by(*order)):
        one = _row(row)
        found.setdefault(row.vehicle_pk, []).append(
            GivenCalibration(
                one.version,
                one.valid_from_ns,
                one.journal_id,
                one.calibration,
                learnt.get((row.vehicle_pk, one.version)),
            )
        )
    return {pk: tuple(versions) for pk, versions in found.items()}


def put(connection: Connection, vehicle_pk: int, new: NewCalibration, now_ns: int) -> CalibrationRow:
    """Store a given version. Sessions use it for packets that become durable after this."""
    newest = select(func.coalesce(func.max(journal.c.id), 0)).where(journal.c.vehicle_pk == vehicle_pk)
    journal_id: int = connection.execute(newest).scalar_one()
    row = CalibrationRow(
        version=_next_version(connection, vehicle_pk),
        base=None,
        valid_from_ns=new.valid_from_ns // TOLD_NS * TOLD_NS,
        origin=new.origin,
        run_id=new.run_id,
        created_by=new.created_by,
        journal_id=journal_id,
        stored_ns=now_ns,
        calibration=new.calibration,
    )
    connection.execute(insert_into(connection, calibrations).values(**_values(vehicle_pk, str(uuid4()), row)))
    return row


def add_learnt(
    connection: Connection,
    vehicle_pk: int,
    calibration_id: str,
    base: int,
    valid_from_ns: int,
    stored_ns: int,
    calibration: Calibration,
) -> int:
    """Store what a trip made of the biases of ``base``, nothing where it is there already; returns the version."""
    there = select(calibrations.c.version).where(calibrations.c.id == calibration_id)
    version = connection.execute(there).scalar_one_or_none()
    if version is None:
        version = _next_version(connection, vehicle_pk)
        row = CalibrationRow(version, base, valid_from_ns, "field", None, None, 0, stored_ns, calibration)
        connection.execute(insert_into(connection, calibrations).values(**_values(vehicle_pk, calibration_id, row)))
    return int(version)


def _next_version(connection: Connection, vehicle_pk: int) -> int:
    # Taken by one at a time: PostgreSQL holds the vehicle's row, SQLite has one writer anyway.
    connection.execute(select(vehicles.c.pk).where(vehicles.c.pk == vehicle_pk).with_for_update(key_share=True))
    newest = select(func.coalesce(func.max(calibrations.c.version), 0))
    return int(connection.execute(newest.where(calibrations.c.vehicle_pk == vehicle_pk)).scalar_one()) + 1


def _values(vehicle_pk: int, calibration_id: str, row: CalibrationRow) -> dict[str, Any]:
    values: dict[str, Any] = {name: getattr(row, name) for name in CalibrationRow.__slots__}
    content = row.calibration.model_dump(mode="json", exclude_none=True)
    return values | {"id": calibration_id, "vehicle_pk": vehicle_pk, "calibration": content}


def _row(row: Row[Any]) -> CalibrationRow:
    values = {name: getattr(row, name) for name in CalibrationRow.__slots__}
    return CalibrationRow(**values | {"calibration": Calibration.model_validate(row.calibration)})
