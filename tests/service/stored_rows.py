"""Rows as the engine stores them, for tests of what is read."""

from __future__ import annotations

from uuid import uuid4

NS = 1_000_000_000
T0 = 1_800_000_000 * NS
"""2027-01-15T08:00:00Z"""


def trip_row(pk, start_s, end_s, **changes):
    row = {
        "id": str(uuid4()),
        "vehicle_pk": pk,
        "start_ns": T0 + start_s * NS,
        "end_ns": T0 + end_s * NS,
        "ended": True,
        "start_lat_deg": 57.7,
        "start_lon_deg": 11.97,
        "end_lat_deg": 57.71,
        "end_lon_deg": 11.99,
        "distance_m": 1650.5,
        "moving_s": 88.0,
        "coasting_s": 20.0,
        "max_speed_mps": 24.0,
    }
    return row | changes


def point_row(pk, second, lat_deg=57.7, lon_deg=11.97, **changes):
    row = {
        "vehicle_pk": pk,
        "t_ns": T0 + second * NS,
        "lat_deg": lat_deg,
        "lon_deg": lon_deg,
        "alt_m": 40.0,
        "vn_mps": 3.0,
        "ve_mps": 4.0,
        "vd_mps": 0.0,
        "yaw_deg": 53.1,
        "sd_n_m": 0.8,
        "sd_e_m": 0.7,
        "sd_d_m": 1.2,
        "cov_ne_m2": 0.01,
        "sd_yaw_deg": 0.4,
        "gnss_used": True,
        "mode": 1,
    }
    return row | changes


def accident_row(tenant, pk, second, lat_deg=57.7, lon_deg=11.97, severity="severe", **changes):
    t_ns = T0 + second * NS
    return {
        "id": str(uuid4()),
        "tenant_id": tenant,
        "vehicle_pk": pk,
        "t_ns": t_ns,
        "decided_t_ns": t_ns + NS // 2,
        "received_ns": t_ns + NS,
        "stored_ns": t_ns + NS,
        "revision": 1,
        "kind": "collision",
        "status": "confirmed",
        "severity": severity,
        "confidence": 0.98,
        "lat_deg": lat_deg,
        "lon_deg": lon_deg,
        "alt_m": 40.0,
        "sd_n_m": 1.5,
        "sd_e_m": 1.0,
        "cov_ne_m2": 0.2,
        "heading_deg": 53.1,
        "mode": 2,
        "detail": {
            "detector": "telefuse",
            "delta_v_mps": 9.0,
            "delta_v_sd_mps": 0.6,
            "delta_v_interval_mps": [7.8, 10.2],
            "delta_v_b_mps": [-9.0, 0.4],
            "pdof_deg": 2.5,
            "pdof_sd_deg": 4.0,
            "peak_mps2": 180.0,
            "duration_s": 0.11,
            "clipped": False,
            "speed_before_mps": 14.0,
            "impacts": 1,
            "each_impact": [],
            "rollover": False,
            "injury": {"probability": 0.02, "low": 0.005, "high": 0.08, "source": "made up"},
            "reasons": ["stood still afterwards"],
            "paper_agrees": True,
        },
    } | changes


def manoeuvre_row(tenant, pk, second, **changes):
    t_ns = T0 + second * NS
    row = {"id": str(uuid4()), "tenant_id": tenant, "vehicle_pk": pk, "kind": "braking", "stored_ns": t_ns}
    row |= {"start_ns": t_ns, "peak_ns": t_ns + NS, "end_ns": t_ns + 2 * NS, "peak_mps2": 6.5, "direction": ""}
    row |= {"aggressive": True, "counted": True, "recovery": False, "lat_deg": 57.7, "lon_deg": 11.97}
    return row | {"sd_n_m": 0.8, "sd_e_m": 0.7, "cov_ne_m2": 0.01} | changes


def candidate_row(tenant, pk, second, lat_deg=57.7, lon_deg=11.97, reason="pothole", **changes):
    t_ns = T0 + second * NS
    return {
        "id": str(uuid4()),
        "tenant_id": tenant,
        "vehicle_pk": pk,
        "t_ns": t_ns,
        "decided_t_ns": t_ns + NS // 2,
        "received_ns": t_ns + NS,
        "stored_ns": t_ns + NS,
        "reason": reason,
        "probability": 0.07,
        "lat_deg": lat_deg,
        "lon_deg": lon_deg,
        "alt_m": 40.0,
        "sd_n_m": 1.5,
        "sd_e_m": 1.0,
        "cov_ne_m2": 0.2,
        "heading_deg": 53.1,
        "mode": 1,
        "detail": {
            "delta_v_mps": 1.6,
            "vertical_mps": 0.9,
            "peak_mps2": 31.0,
            "duration_s": 0.06,
            "speed_before_mps": 12.0,
            "paper_agrees": True,
        },
    } | changes
