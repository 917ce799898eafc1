"""Vehicles: their rows, and the directory by which every packet finds its vehicle without a query."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from sqlalchemy import Connection, Engine, Row, delete, func, select

from schemas import keys
from schemas.vehicles import VehicleConfig
from service.ingest.sequencing import Sequencer
from service.storage import calibrations, tenants
from service.storage.calibrations import GivenCalibration
from service.storage.database import read, write
from service.storage.manoeuvres import forget_cause
from service.storage.statements import insert_into
from service.storage.tables import accidents, checkpoints, journal, vehicles


@dataclass(frozen=True, slots=True)
class VehicleRef:
    """A registered vehicle: its row, its names, its settings and its calibrations by the time from which they hold."""

    pk: int
    tenant_id: str
    vehicle_id: str
    config: VehicleConfig
    calibrations: tuple[GivenCalibration, ...] = ()


@dataclass(frozen=True, slots=True)
class VehicleRow:
    """A vehicle with when it was registered, changed and last seen, UTC nanoseconds."""

    ref: VehicleRef
    registered_ns: int
    updated_ns: int
    last_seen_ns: int | None


@dataclass(frozen=True, slots=True)
class PacketRow:
    """The newest packet of a vehicle that became durable."""

    boot_id: str
    sequence: int
    start_t_ns: int
    received_ns: int


def find(
    connection: Connection, tenant_id: str, vehicle_id: str, *, with_calibrations: bool = True
) -> VehicleRow | None:
    """The tenant's vehicle of that name; its calibrations cost more to find than all the rest."""
    row = connection.execute(
        select(vehicles).where(vehicles.c.tenant_id == tenant_id, vehicles.c.vehicle_id == vehicle_id)
    ).one_or_none()
    if row is None:
        return None
    return _vehicle(connection, row) if with_calibrations else _vehicle_with(row, ())


def page(connection: Connection, tenant_id: str, after_id: str | None, limit: int) -> list[VehicleRow]:
    """The tenant's vehicles by name, those after ``after_id``."""
    statement = select(vehicles).where(vehicles.c.tenant_id == tenant_id)
    if after_id is not None:
        statement = statement.where(vehicles.c.vehicle_id > after_id)
    rows = connection.execute(statement.order_by(vehicles.c.vehicle_id).limit(limit)).all()
    known = calibrations.given(connection, [row.pk for row in rows])
    return [_vehicle_with(row, known.get(row.pk, ())) for row in rows]


def put(connection: Connection, tenant_id: str, vehicle_id: str, config: VehicleConfig) -> VehicleRow:
    """Register the vehicle, or give the registered one these settings."""
    now_ns = time.time_ns()
    insert = insert_into(connection, vehicles).values(
        tenant_id=tenant_id,
        vehicle_id=vehicle_id,
        config=config.model_dump(mode="json"),
        registered_ns=now_ns,
        updated_ns=now_ns,
    )
    row = connection.execute(
        insert.on_conflict_do_update(
            index_elements=[vehicles.c.tenant_id, vehicles.c.vehicle_id],
            set_={"config": insert.excluded.config, "updated_ns": insert.excluded.updated_ns},
        ).returning(*vehicles.c)
    ).one()
    return _vehicle(connection, row)


def delete_row(connection: Connection, vehicle_pk: int) -> None:
    """Remove a vehicle's row, which takes along every row that is about it; tell the directory after the commit."""
    forget_cause(connection, select(accidents.c.id).where(accidents.c.vehicle_pk == vehicle_pk))
    connection.execute(delete(vehicles).where(vehicles.c.pk == vehicle_pk))


def newest_packet(connection: Connection, vehicle_pk: int) -> PacketRow | None:
    """The vehicle's newest packet in the journal; rows without payload are no packets."""
    row = connection.execute(
        select(journal.c.boot_id, journal.c.sequence, journal.c.start_t_ns, journal.c.received_ns)
        .where(journal.c.vehicle_pk == vehicle_pk, journal.c.sequence > 0, func.length(journal.c.payload) > 0)
        .order_by(journal.c.id.desc())
        .limit(1)
    ).one_or_none()
    return None if row is None else PacketRow(*row)


def durable_sequence(connection: Connection, vehicle_pk: int, boot_id: str, gap_wait_ns: int) -> int:
    """Up to where a boot's packets are durable or refused for good, as its box is told; 0 for nothing."""
    saved = connection.execute(
        select(checkpoints.c.journal_id, checkpoints.c.sequencer).where(checkpoints.c.vehicle_pk == vehicle_pk)
    ).one_or_none()
    sequencer = Sequencer(gap_wait_ns) if saved is None else Sequencer.from_json(saved.sequencer, gap_wait_ns)
    since = select(journal.c.boot_id, journal.c.sequence, journal.c.start_t_ns, journal.c.id).where(
        journal.c.vehicle_pk == vehicle_pk, journal.c.id > (0 if saved is None else saved.journal_id)
    )
    for row in connection.execute(since.order_by(journal.c.id)):
        sequencer.offer(*row)
    return sequencer.durable_sequence(boot_id)


def _vehicle(connection: Connection, row: Row[Any]) -> VehicleRow:
    return _vehicle_with(row, calibrations.given(connection, [row.pk]).get(row.pk, ()))


def _vehicle_with(row: Row[Any], known: tuple[GivenCalibration, ...]) -> VehicleRow:
    ref = VehicleRef(row.pk, row.tenant_id, row.vehicle_id, VehicleConfig.model_validate(row.config), known)
    return VehicleRow(ref, row.registered_ns, row.updated_ns, row.last_seen_ns)


class VehicleDirectory:
    """Finds vehicles by name or row, from memory after the first time. Every method is safe from any thread.

    One process serves a database, so what it changes here is what it finds here; a vehicle that another
    process adds (``telefuse vehicles import``) is found at its first packet.
    """

    def __init__(self, engine: Engine, open_registration: bool) -> None:
        self._engine = engine
        self._open_registration = open_registration
        self._lock = threading.Lock()
        self._by_name: dict[tuple[str, str], VehicleRef] = {}
        self._by_pk: dict[int, VehicleRef] = {}
        self._generation = 0
        self._listeners: list[Callable[[int], None]] = []

    def on_change(self, listener: Callable[[int], None]) -> None:
        """Have ``listener(pk)`` called after a vehicle was changed or removed; ``by_pk`` tells which."""
        self._listeners.append(listener)

    def resolve(self, tenant_id: str, vehicle_id: str) -> VehicleRef | None:
        """The vehicle that sends under this name; registers it where registration is open and the tenant is known."""
        known = self._by_name.get((tenant_id, vehicle_id))
        if known is not None:
            return known
        generation = self._generation
        with read(self._engine) as connection:
            row = find(connection, tenant_id, vehicle_id)
            may_register = self._open_registration and (
                tenant_id == tenants.DEFAULT_TENANT or tenants.exists(connection, tenant_id)
            )
        if row is not None:
            return self._remember(row.ref, generation)
        if not (may_register and keys.is_name(vehicle_id, keys.MAX_VEHICLE_ID)):
            return None
        return self._register_unknown(tenant_id, vehicle_id)

    def register(self, tenant_id: str, vehicle_id: str, config: VehicleConfig | None = None) -> VehicleRow:
        """Register a vehicle or change the settings of a registered one; makes the tenant where needed."""
        with write(self._engine) as connection:
            tenants.ensure(connection, tenant_id)
            row = put(connection, tenant_id, vehicle_id, VehicleConfig() if config is None else config)
        self.changed(row.ref)
        return row

    def update(
        self, tenant_id: str, vehicle_id: str, change: Callable[[VehicleConfig], VehicleConfig]
    ) -> VehicleRow | None:
        """Give a registered vehicle the settings that ``change`` makes of its present ones; None if there is none."""
        with write(self._engine) as connection:
            tenants.lock(connection, tenant_id)
            row = find(connection, tenant_id, vehicle_id)
            if row is None:
                return None
            row = put(connection, tenant_id, vehicle_id, change(row.ref.config))
        self.changed(row.ref)
        return row

    def by_pk(self, pk: int) -> VehicleRef | None:
        """The vehicle of that row; None once it is removed."""
        known = self._by_pk.get(pk)
        if known is not None:
            return known
        generation = self._generation
        with read(self._engine) as connection:
            row = connection.execute(select(vehicles).where(vehicles.c.pk == pk)).one_or_none()
            found = None if row is None else _vehicle(connection, row).ref
        return None if found is None else self._remember(found, generation)

    def remove(self, tenant_id: str, vehicle_id: str) -> bool:
        """Remove the vehicle and every row that is about it; False if there is none."""
        with write(self._engine) as connection:
            row = find(connection, tenant_id, vehicle_id)
            if row is None:
                return False
            delete_row(connection, row.ref.pk)
        self.removed(row.ref)
        return True

    def removed(self, ref: VehicleRef) -> None:
        """Take in that a vehicle's row was removed in a transaction of the caller's, which is now committed."""
        with self._lock:
            self._generation += 1
            self._by_name.pop((ref.tenant_id, ref.vehicle_id), None)
            self._by_pk.pop(ref.pk, None)
        self._tell([ref.pk])

    def changed(self, ref: VehicleRef) -> None:
        """Take in a vehicle that was changed in a transaction of the caller's, which is now committed."""
        with self._lock:
            self._generation += 1
            self._by_name[ref.tenant_id, ref.vehicle_id] = ref
            self._by_pk[ref.pk] = ref
        self._tell([ref.pk])

    def _register_unknown(self, tenant_id: str, vehicle_id: str) -> VehicleRef:
        with write(self._engine) as connection:
            tenants.ensure(connection, tenant_id)
            row = find(connection, tenant_id, vehicle_id)
            if row is None:
                row = put(connection, tenant_id, vehicle_id, VehicleConfig())
            generation = self._generation
        return self._remember(row.ref, generation)

    def _remember(self, ref: VehicleRef, generation: int) -> VehicleRef:
        # What was read before somebody else's change may be stale: it is answered, but not kept.
        with self._lock:
            if generation == self._generation:
                self._by_name[ref.tenant_id, ref.vehicle_id] = ref
                self._by_pk[ref.pk] = ref
        return ref

    def _tell(self, pks: Sequence[int]) -> None:
        for listener in self._listeners:
            for pk in pks:
                listener(pk)
