"""The vehicle: how fast for the road, how hard in the g-g diagram, and both joined, by three fuzzy systems (fig. 1)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from core.errors import InvalidInputError
from core.measurements import FloatArray
from core.risk.belief import vacuous
from core.risk.discounting import chance_of_exceeding, discount
from core.risk.environment import Road, Words
from core.risk.fuzzy import FuzzySystem, system_of
from core.risk.lookup import ROADS, crossfade
from core.risk.motion import Motion

_MPS_PER_KMH: Final = 1.0 / 3.6
NEGLIGIBLE: Final = 1e-3
"""A chance of error below this is no doubt: a choice, of three sd and some. So a good fix is not on Theta at all."""
POSITION_HALF_CLASS_M: Final = 25.0
"""Half of how far apart roads with different limits lie; a choice. A position farther off may be on another road."""


@dataclass(frozen=True, slots=True, eq=False)
class VehicleRisk:
    """Of n instants: the mass, the three systems' risks (0 low to 1 high), and how far each input was known, 0 to 1."""

    mass: FloatArray
    speed_risk: FloatArray
    motion_risk: FloatArray
    risk: FloatArray
    excess_kmh: FloatArray
    coverage: Mapping[str, FloatArray]
    bad_limits: int


@dataclass(frozen=True, slots=True)
class VehicleModel:
    """The three systems with what their inputs are measured by."""

    speed: FuzzySystem
    motion: FuzzySystem
    vehicle: FuzzySystem
    nodes: tuple[float, ...]
    numbers: Mapping[str, Any]

    def assess(self, motion: Motion, road: Road, sun_rad: FloatArray) -> VehicleRisk:
        """The vehicle's mass at n instants.

        Without a velocity it is on Theta, as in the paper. What else is not known adds no risk: speed without a limit
        is joined as low, a road without a class as one apart. Coverage says so.

        Parameters
        ----------
        motion, road : n instants
        sun_rad : (n,) elevation of the sun; NaN counts as day
        """
        excess, step_kmh, bad = self._excess(motion, road)
        night = self._darkness(sun_rad)
        speed_risk = self.speed.infer(excess=excess, darkness=night)
        share = self._lateral_share(motion.speed_mps)
        lateral = np.abs(motion.right_mps2) / share
        motion_risk = self.motion.infer(lateral=lateral, longitudinal=motion.forward_mps2)
        setting = self._setting(road.kind)
        limited = np.isfinite(excess)
        joined = self.vehicle.infer(
            speed=np.where(limited, speed_risk, 0.0), motion=motion_risk, setting=np.nan_to_num(setting, nan=0.0)
        )
        # What rounding leaves of a centroid at a node would be mass on the next proposition.
        risk = np.round(joined, 12)

        known = motion.known
        classes = self.numbers["classes"]
        room_steps = _room(excess, classes["steps"], classes["half_steps"])
        no_speed = doubt(room_steps * step_kmh * _MPS_PER_KMH, motion.speed_sd_mps)
        room_right = _room(lateral, classes["lateral_mps2"], classes["half_mps2"]) * share
        room_forward = _room(motion.forward_mps2, classes["longitudinal_mps2"], classes["half_mps2"])
        no_motion = doubt(np.minimum(room_right, room_forward), motion.acceleration_sd_mps2)
        no_road = doubt(POSITION_HALF_CLASS_M, road.position_sd_m)
        sure = np.where(known, (1.0 - no_motion) * np.where(limited, (1.0 - no_speed) * (1.0 - no_road), 1.0), 0.0)
        mass = crossfade(risk, self.nodes)
        mass[~known] = vacuous()
        coverage = {
            "speed": np.where(known & limited, (1.0 - no_speed) * (1.0 - no_road), 0.0),
            "motion": np.where(known, 1.0 - no_motion, 0.0),
            "setting": np.where(known & np.isfinite(setting), 1.0 - no_road, 0.0),
        }
        excess_kmh = excess * step_kmh
        return VehicleRisk(discount(mass, 1.0 - sure), speed_risk, motion_risk, risk, excess_kmh, coverage, bad)

    def _excess(self, motion: Motion, road: Road) -> tuple[FloatArray, FloatArray, int]:
        """Speed above the limit in steps, the step in km/h, and how many limits are none that can be."""
        rule = self.numbers["speeding"]
        limit = np.where(np.isposinf(road.limit_kmh), rule["unlimited_kmh"], road.limit_kmh)
        bad = (limit < rule["lowest_limit_kmh"]) | (limit > rule["highest_limit_kmh"])
        limit = np.where(bad, np.nan, limit)
        urban = np.where(road.surroundings == "", limit <= rule["urban_up_to_kmh"], road.surroundings == "urban")
        step_kmh = np.where(urban, rule["step_urban_kmh"], rule["step_rural_kmh"])
        return (motion.speed_mps / _MPS_PER_KMH - limit) / step_kmh, step_kmh, int(bad.sum())

    def _darkness(self, sun_rad: FloatArray) -> FloatArray:
        """0 by day to 1 by night, (n,)."""
        rule = self.numbers["darkness"]
        share = np.interp(np.degrees(sun_rad), [rule["night_below_deg"], rule["day_from_deg"]], [1.0, 0.0])
        return np.where(np.isnan(sun_rad), 0.0, share)

    def _lateral_share(self, speed_mps: FloatArray) -> FloatArray:
        rule = self.numbers["lateral"]
        return np.asarray(np.interp(speed_mps / _MPS_PER_KMH, rule["speed_kmh"], rule["share"]))

    def _setting(self, kind: Words) -> FloatArray:
        """0 cars alone to 1 shared with people on foot, (n,); NaN where the class is not known."""
        setting = np.full(len(kind), np.nan)
        for name in ROADS:
            setting[kind == name] = self.numbers["setting"][name]
        return setting


def _room(value: FloatArray, ends: list[float], half: float) -> FloatArray:
    """By how much a value may be wrong and stay in its class: half the class, or more in an open one, (n,)."""
    to_ends = np.abs(value[:, None] - np.array(ends)).min(axis=1)
    return np.asarray(np.maximum(half, to_ends))


def doubt(half_width: Any, sd: FloatArray) -> FloatArray:
    """The discount rate of an input: the chance that its error exceeds half a class width, 0 if negligible."""
    alpha = chance_of_exceeding(half_width, sd)
    return np.where(alpha < NEGLIGIBLE, 0.0, alpha)


def vehicle_of(document: Mapping[str, Any]) -> VehicleModel:
    """The model from what its TOML document says; raises InvalidInputError that names what is wrong."""
    needed = ("speeding", "lateral", "darkness", "setting", "classes", "speed", "motion", "vehicle", "masses")
    if missing := [key for key in needed if not isinstance(document.get(key), Mapping)]:
        raise InvalidInputError(f"no section [{missing[0]}]: expected {', '.join(needed)}")
    if absent := [name for name in ROADS if not isinstance(document["setting"].get(name), int | float)]:
        raise InvalidInputError(f"[setting] has no number for '{absent[0]}': expected one for each class of road")
    nodes = tuple(float(node) for node in document["masses"]["risk"])
    if len(nodes) != 5 or list(nodes) != sorted(set(nodes)):
        raise InvalidInputError(f"[masses] risk = {list(nodes)}: expected five risks that rise, for LR to HR")
    systems = {name: system_of(name, document[name]) for name in ("speed", "motion", "vehicle")}
    return VehicleModel(nodes=nodes, numbers=document, **systems)
