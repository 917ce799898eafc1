"""Ids that follow from a vehicle and a time alone: what is computed again after a crash meets its own rows."""

from __future__ import annotations

from typing import Final
from uuid import UUID, uuid5

from service.storage.vehicles import VehicleRef

NAMESPACE: Final = UUID("6f1d3b0e-52c4-5d8e-9a57-0f6c1f7c2b11")
"""Ids of accidents, trips and events are UUIDv5 in this namespace; it must never change."""


def stable_id(ref: VehicleRef, t_ns: int, kind: str) -> str:
    """The id of what happened to a vehicle at a time; the same whenever it is computed."""
    return str(uuid5(NAMESPACE, f"{ref.tenant_id}/{ref.vehicle_id}/{t_ns}/{kind}"))


def event_id(about: str, event_type: str) -> str:
    """The id of the event that tells of something once."""
    return str(uuid5(NAMESPACE, f"{about}/{event_type}"))
