"""Trips' risk and manoeuvres as the API tells them."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from core.measurements import FloatArray
from core.risk.belief import PROPOSITIONS
from schemas.notifications import rfc3339
from schemas.trips import Manoeuvre, Place
from service.roads.protocol import Certainty
from service.storage.manoeuvres import ManoeuvreRow
from service.storage.records import TripRecord
from service.storage.trips import TripRow
from service.trips.timeline import FUSED, Timeline

_CERTAINTIES: Final = {int(one): one.name.lower() for one in Certainty}


def risk_over_time(trip: TripRow, found: TripRecord, every: int) -> dict[str, Any]:
    """``schemas.trips.TripRisk``, every so many seconds."""
    # No model for it: a day's trip has tens of thousands of instants.
    told = Timeline.unpacked(found.timeline)
    some = slice(None, None, every)
    mean = found.record.belief[FUSED].mean() if FUSED in found.record.belief else None
    return {
        "trip_id": trip.id,
        "vehicle_id": trip.vehicle_id,
        "model_sha256": found.model_sha256,
        "assessed_at": rfc3339(found.assessed_ns),
        "times": [rfc3339(t_ns) for t_ns in told.t_ns[some].tolist()],
        "mean": {} if mean is None else {name: mean[bits] for bits, name in enumerate(PROPOSITIONS) if bits},
        "fused": _masses(told.mass[FUSED][some]),
        "entities": {name: _masses(mass[some]) for name, mass in told.mass.items() if name != FUSED},
        "conflict": _numbers(told.conflict[some], 4),
        "coverage": {name: _numbers(share[some], 3) for name, share in told.coverage.items()},
        "speed_kmh": _numbers(3.6 * told.speed_mps[some], 2),
        "limit_kmh": _numbers(told.limit_kmh[some], 0),
        "limit_certainty": [_CERTAINTIES[one] for one in told.limit_certainty[some].tolist()],
    }


def shown_manoeuvre(row: ManoeuvreRow, *, places: bool) -> Manoeuvre:
    """A manoeuvre, with its place for those who may know it."""
    same = {name: getattr(row, name) for name in Manoeuvre.model_fields if name in ManoeuvreRow.__slots__}
    placed = places and row.lat_deg is not None and row.lon_deg is not None
    if not placed:
        same |= dict.fromkeys(("sd_n_m", "sd_e_m", "cov_ne_m2"))
    if not places:
        same["excused_by"] = None
    return Manoeuvre(
        **same | {"direction": row.direction or None},
        start_at=row.start_ns,
        peak_at=row.peak_ns,
        end_at=row.end_ns,
        duration_s=(row.end_ns - row.start_ns) * 1e-9,
        place=Place(lat_deg=row.lat_deg, lon_deg=row.lon_deg) if placed else None,  # type: ignore[arg-type]
    )


def _masses(mass: FloatArray) -> dict[str, list[float | None]]:
    return {name: _numbers(mass[:, bits], 4) for bits, name in enumerate(PROPOSITIONS) if bits}


def _numbers(values: FloatArray, digits: int) -> list[float | None]:
    known = np.isfinite(values).tolist()
    return [one if there else None for one, there in zip(np.round(values, digits).tolist(), known, strict=True)]
