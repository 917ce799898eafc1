"""What is told about a vehicle at once, beside what is stored: events as CloudEvents, and the fused state."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from core.navigation.track import Mode
from schemas.notifications import rfc3339
from schemas.vehicles import FusedState
from service.storage.vehicles import VehicleRef
from service.webhooks.outbox import NewEvent


def cloud_event(ref: VehicleRef, event: NewEvent) -> dict[str, Any]:
    """The event in the CloudEvents 1.0 JSON format; ``id`` is the webhook's, so that a listener of both can tell."""
    return {
        "specversion": "1.0",
        "id": event.id,
        "source": f"/v1/vehicles/{ref.vehicle_id}",
        "type": event.type,
        "subject": ref.vehicle_id,
        "time": rfc3339(event.t_ns),
        "datacontenttype": "application/json",
        "data": dict(event.body),
    }


def fused_state(ref: VehicleRef, point: Mapping[str, Any]) -> dict[str, Any]:
    """A row of ``track_points`` as the state that subscribers see: the fields of ``schemas.vehicles.FusedState``."""
    return {name: value for name, value in point.items() if name in FusedState.model_fields} | {
        "vehicle_id": ref.vehicle_id,
        "time": rfc3339(point["t_ns"]),
        "alt_ellipsoid_m": point["alt_m"],
        "speed_mps": math.hypot(point["vn_mps"], point["ve_mps"]),
        "mode": Mode(point["mode"]).name.lower(),
    }
