"""Sensitivity by vehicle class: what tyres can do, how long blows last, and how what lies on its side came to lie.

Measured by ``telefuse bench --accidents --part classes``.
"""

from __future__ import annotations

from dataclasses import replace
from types import MappingProxyType
from typing import Final

from core.accident.thresholds import DetectorThresholds

_CAR: Final = DetectorThresholds()

_HEAVY: Final = replace(
    _CAR,
    # UN R13 asks 5 m/s2 of laden trucks, good ones reach 7; a blow moves their mass less, and longer. Choice.
    trigger=replace(_CAR.trigger, tyre_mps2=8.0, jerk_mps3=40.0, margin_mps=0.3, decide_s=0.45, hard_mps2=4.0),
    # Blows turn it less and its tyres take more of them back; what tips its cab, or stops it at a stone, swings on the
    # cab's own springs. Choices, after simulated trucks.
    judgement=replace(
        _CAR.judgement, long_s=0.25, retained_from=0.6, unturned_radps=0.02, abrupt_radps=0.06, lifted_from=0.6,
        crawl_share=1.8,
    ),
)  # fmt: skip

PROFILES: Final = MappingProxyType(
    {
        "car": _CAR,
        # Laden vans reach 0.8 to 0.9 g; choice.
        "van": replace(_CAR, trigger=replace(_CAR.trigger, tyre_mps2=9.8)),
        "truck": _HEAVY,
        "bus": _HEAVY,
        "motorcycle": replace(
            _CAR,
            # Riders lean to 50 degrees and lift a wheel by as much; what lies has 65 and more (Viasat tells a
            # motorcycle on the ground from 60 on). On its stand it leans by 15. It hops over bumps, and is rough for
            # its box. Choices.
            trigger=replace(_CAR.trigger, tyre_mps2=11.5, tilt_deg=65.0, margin_mps=0.5, lean_deg=20.0, fall_s=0.16),
            rollover=replace(_CAR.rollover, tracks=1),
            # It is turned and lifted by what would only push a car, its fork gives way at once, and who is struck
            # seldom rides on as fast as before. Choices.
            judgement=replace(_CAR.judgement, lifted_from=0.9, short_s=0.05, drove_on=5.0),
            # It rolls by 2 rad/s into its bends.
            naming=replace(_CAR.naming, loose_radps=3.5),
        ),
    }
)
"""Every threshold, by the class that a vehicle is registered with."""


def for_vehicle(vehicle_class: str) -> DetectorThresholds:
    """Thresholds of a class; KeyError for one that is not in ``PROFILES``."""
    return PROFILES[vehicle_class]
