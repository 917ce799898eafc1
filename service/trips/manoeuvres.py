"""What a session says of manoeuvres, as the database keeps it, with the place by the stored track."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
from sqlalchemy import Connection

from core.driving.manoeuvres import Episode
from service.accidents.rows import degrees_or_none, finite_or_none
from service.stable_ids import stable_id
from service.storage import manoeuvres, trips
from service.storage.manoeuvres import ManoeuvreRow
from service.storage.vehicles import VehicleRef

WITHIN_NS: Final = 2_000_000_000
"""A manoeuvre with no position nearer than this has no place; rows come once a second."""


def store_episode(connection: Connection, ref: VehicleRef, episode: Episode, stored_ns: int) -> None:
    """Keep a manoeuvre; the track around it is there already. A trip that was assessed without it is due anew."""
    row = ManoeuvreRow(
        id=stable_id(ref, episode.start_t_ns, f"manoeuvre/{episode.kind}"),
        tenant_id=ref.tenant_id,
        vehicle_pk=ref.pk,
        vehicle_id=ref.vehicle_id,
        kind=str(episode.kind),
        start_ns=episode.start_t_ns,
        peak_ns=episode.peak_t_ns,
        end_ns=episode.end_t_ns,
        stored_ns=stored_ns,
        peak_mps2=episode.peak_mps2,
        direction=episode.direction,
        aggressive=episode.aggressive,
        counted=episode.counted,
        recovery=episode.recovery,
        speed_before_mps=finite_or_none(episode.speed_before_mps),
        speed_at_peak_mps=finite_or_none(episode.speed_at_peak_mps),
        speed_after_mps=finite_or_none(episode.speed_after_mps),
        across_mps2=finite_or_none(episode.across_mps2),
        radius_m=finite_or_none(episode.radius_m),
        heading_change_deg=degrees_or_none(episode.heading_change_rad),
        **_place(connection, ref.pk, episode.peak_t_ns),
    )
    if manoeuvres.put(connection, row):
        trips.mark_due(connection, ref.pk, row.start_ns, row.start_ns, stored_ns)


def _place(connection: Connection, vehicle_pk: int, t_ns: int) -> dict[str, Any]:
    """Between the positions around a time; as the nearest where there is one on one side only."""
    rows = trips.positions(connection, vehicle_pk, t_ns - WITHIN_NS, t_ns + WITHIN_NS)
    if not rows:
        return {}
    at = np.array([row.t_ns - t_ns for row in rows], float)
    lon_deg = np.degrees(np.unwrap(np.radians([row.lon_deg for row in rows])))
    nearest = rows[int(np.argmin(np.abs(at)))]
    return {
        "lat_deg": float(np.interp(0.0, at, [row.lat_deg for row in rows])),
        "lon_deg": math.remainder(float(np.interp(0.0, at, lon_deg)), 360.0),
        **{name: getattr(nearest, name) for name in ("sd_n_m", "sd_e_m", "cov_ne_m2")},
    }
