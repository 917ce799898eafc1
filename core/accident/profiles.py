"""Sensitivity by vehicle class: what tyres can do, and from which tilt on a vehicle lies on its side."""

from __future__ import annotations

from dataclasses import replace
from types import MappingProxyType
from typing import Final

from core.accident.thresholds import DetectorThresholds, TriggerThresholds

_CAR: Final = TriggerThresholds()

PROFILES: Final = MappingProxyType(
    {
        "car": _CAR,
        # Laden vans reach 0.8 to 0.9 g; choice.
        "van": replace(_CAR, tyre_mps2=9.8),
        # UN R13 asks 5 m/s2 of laden trucks, good ones reach 7; a blow moves their mass less. Choice.
        "truck": replace(_CAR, tyre_mps2=8.0, jerk_mps3=40.0, margin_mps=0.3),
        "bus": replace(_CAR, tyre_mps2=8.0, jerk_mps3=40.0, margin_mps=0.3),
        # Riders lean to 55 degrees, and lie from about 75 on; rough for their boxes. Choice.
        "motorcycle": replace(_CAR, tyre_mps2=11.5, tilt_deg=72.0, tilt_s=1.0, margin_mps=0.5),
    }
)
"""When something is looked at, by the class that a vehicle is registered with."""


def for_vehicle(vehicle_class: str) -> DetectorThresholds:
    """Thresholds of a class; KeyError for one that is not in ``PROFILES``."""
    return DetectorThresholds(trigger=PROFILES[vehicle_class])
