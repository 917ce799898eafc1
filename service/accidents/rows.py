"""What a session says of accidents and candidates, as the database keeps it: no NaN, no radians."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Any

from core.accident.events import Impact
from core.accident.placing import Accident, Place, Suppressed
from service.stable_ids import stable_id
from service.storage.accidents import AccidentRow
from service.storage.candidates import CandidateRow
from service.storage.vehicles import VehicleRef


def accident_row(
    ref: VehicleRef, accident: Accident, *, trip_id: str | None, received_ns: int, stored_ns: int
) -> AccidentRow:
    """A revision of an accident."""
    impact = accident.impact
    return AccidentRow(
        id=stable_id(ref, impact.t_ns, "accident"),
        tenant_id=ref.tenant_id,
        vehicle_pk=ref.pk,
        vehicle_id=ref.vehicle_id,
        trip_id=trip_id,
        t_ns=impact.t_ns,
        decided_t_ns=impact.decided_t_ns,
        received_ns=received_ns,
        stored_ns=stored_ns,
        revision=impact.revision,
        kind=str(impact.kind),
        status=str(impact.status),
        severity=str(impact.severity),
        confidence=impact.confidence,
        detail=impact_figures(accident),
        **_placed(accident.place),
    )


def impact_figures(accident: Accident) -> dict[str, Any]:
    """``schemas.accidents.ImpactFigures`` of an accident."""
    impact = accident.impact
    return {
        "detector": impact.detector,
        "delta_v_mps": impact.delta_v_mps,
        "delta_v_sd_mps": finite_or_none(impact.delta_v_sd_mps),
        "delta_v_interval_mps": [finite_or_none(one) for one in impact.delta_v_interval_mps],
        "delta_v_b_mps": [finite_or_none(one) for one in impact.delta_v_b_mps],
        "pdof_deg": finite_or_none(impact.pdof_deg),
        "pdof_sd_deg": finite_or_none(impact.pdof_sd_deg),
        "peak_mps2": impact.peak_mps2,
        "duration_s": impact.duration_s,
        "clipped": impact.clipped,
        "speed_before_mps": finite_or_none(impact.speed_before_mps),
        "impacts": impact.impacts,
        "each_impact": each_impact(impact),
        "rollover": impact.rollover,
        "injury": None if impact.injury is None else asdict(impact.injury),
        "reasons": list(impact.reasons),
        "paper_agrees": impact.paper_agrees,
    }


def each_impact(impact: Impact) -> list[dict[str, Any]]:
    """``schemas.impacts.SingleImpact`` of each of an accident's impacts."""
    return [
        {
            "after_s": (one.t_ns - impact.t_ns) * 1e-9,
            "duration_s": one.duration_s,
            "delta_v_mps": one.delta_v_mps,
            "delta_v_interval_mps": [finite_or_none(bound) for bound in one.delta_v_interval_mps],
            "delta_v_b_mps": [finite_or_none(part) for part in one.delta_v_b_mps],
            "pdof_deg": finite_or_none(one.pdof_deg),
            "pdof_sd_deg": finite_or_none(one.pdof_sd_deg),
            "peak_mps2": one.peak_mps2,
            "clipped": one.clipped,
        }
        for one in impact.each
    ]


def candidate_row(ref: VehicleRef, suppressed: Suppressed, *, received_ns: int, stored_ns: int) -> CandidateRow:
    """What was judged to be no accident."""
    candidate = suppressed.candidate
    shock = ("delta_v_mps", "vertical_mps", "peak_mps2", "duration_s", "speed_before_mps")
    return CandidateRow(
        id=stable_id(ref, candidate.t_ns, "candidate"),
        tenant_id=ref.tenant_id,
        vehicle_pk=ref.pk,
        vehicle_id=ref.vehicle_id,
        t_ns=candidate.t_ns,
        decided_t_ns=candidate.decided_t_ns,
        received_ns=received_ns,
        stored_ns=stored_ns,
        reason=str(candidate.reason),
        probability=candidate.probability,
        detail={name: finite_or_none(getattr(candidate, name)) for name in shock}
        | {"paper_agrees": candidate.paper_agrees},
        **_placed(suppressed.place),
    )


def _placed(place: Place) -> dict[str, Any]:
    return {
        "lat_deg": degrees_or_none(place.lat_rad),
        "lon_deg": degrees_or_none(place.lon_rad),
        "alt_m": finite_or_none(place.alt_m),
        "sd_n_m": finite_or_none(place.sd_n_m),
        "sd_e_m": finite_or_none(place.sd_e_m),
        "cov_ne_m2": finite_or_none(place.cov_ne_m2),
        "heading_deg": math.degrees(place.heading_rad) % 360.0 if math.isfinite(place.heading_rad) else None,
        "mode": int(place.mode),
    }


def finite_or_none(value: float) -> float | None:
    """What JSON has no word for is null."""
    return value if math.isfinite(value) else None


def degrees_or_none(angle_rad: float) -> float | None:
    """An angle as it is told."""
    return math.degrees(angle_rad) if math.isfinite(angle_rad) else None
