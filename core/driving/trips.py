"""Trips as a fold over the fused track (contract; see TripTracker)."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Trip:
    """One trip as known so far. ``ended`` is False while it may still go on.

    Angles rad, times UTC ns. ``distance_m`` is along the fused track; ``coasting_s`` the time without GNSS.
    A trip is identified by its ``start_t_ns`` within its vehicle.
    """

    start_t_ns: int
    end_t_ns: int
    start_lat_rad: float
    start_lon_rad: float
    end_lat_rad: float
    end_lon_rad: float
    distance_m: float
    moving_s: float
    coasting_s: float
    max_speed_mps: float
    ended: bool
