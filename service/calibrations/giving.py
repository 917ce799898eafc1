"""Giving a vehicle a calibration: the version and the event that tells of it, in one transaction."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from uuid import uuid4

from sqlalchemy import Connection

from schemas.notifications import CalibrationChangedBody, EventType
from service.errors import InvalidParameterError
from service.storage import calibrations
from service.storage.calibrations import CalibrationRow, NewCalibration
from service.storage.vehicles import VehicleRef
from service.webhooks import outbox
from service.webhooks.outbox import NewEvent


@dataclass(frozen=True, slots=True)
class Given:
    """What was stored; ``ref`` is the vehicle with it, for the directory once the transaction is committed."""

    row: CalibrationRow
    ref: VehicleRef
    event: NewEvent


def give(connection: Connection, ref: VehicleRef, new: NewCalibration) -> Given:
    """Store a version in the caller's transaction; raises InvalidParameterError where it is of raw counts."""
    try:
        new.calibration.check_units()
    except ValueError as error:
        raise InvalidParameterError(f"calibration: {error}") from None
    now_ns = time.time_ns()
    row = calibrations.put(connection, ref.pk, new, now_ns)
    body = CalibrationChangedBody(
        vehicle_id=ref.vehicle_id,
        calibration_version=row.version,
        origin=row.origin,
        valid_from_ns=row.valid_from_ns,
        run_id=row.run_id,
        created_by=row.created_by,
    )
    event = NewEvent(
        id=str(uuid4()),
        tenant_id=ref.tenant_id,
        vehicle_pk=ref.pk,
        type=EventType.CALIBRATION_CHANGED.value,
        t_ns=now_ns,
        received_ns=now_ns,
        body=body.model_dump(),
    )
    outbox.publish(connection, event, now_ns)
    known = calibrations.given(connection, [ref.pk])[ref.pk]
    return Given(row, replace(ref, calibrations=known), event)
