"""A drive's risk, instant by instant: sources fused within driver, environment and vehicle, then these (fig. 1)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from core.measurements import FloatArray
from core.risk.attribution import attribute
from core.risk.belief import N_SETS, vacuous
from core.risk.combination import RULES, combine
from core.risk.discounting import discount
from core.risk.driver import Driver
from core.risk.environment import Environment
from core.risk.lookup import DRIVER, ENVIRONMENT, BoolArray, RiskTables
from core.risk.motion import Motion
from core.risk.vehicle import POSITION_HALF_CLASS_M, VehicleModel, VehicleRisk, doubt

VEHICLE: Final = "vehicle"
ENTITIES: Final = (DRIVER, ENVIRONMENT, VEHICLE)
DISTRICT_HALF_CLASS_M: Final = 250.0
"""Half of how wide a district is at least; a choice. A position farther off may be in another."""
_ROAD_INPUTS: Final = frozenset({"road", "surroundings"})


@dataclass(frozen=True, slots=True)
class RiskModel:
    """Everything that an assessment goes by but the drive itself."""

    tables: RiskTables
    vehicle: VehicleModel
    rule: str = RULES[0]


@dataclass(frozen=True, slots=True, eq=False)
class Assessment:
    """Masses of n instants, and how far they rest on something.

    Parameters
    ----------
    fused : (n, 8)
    entities : each of ``ENTITIES`` that takes part, (n, 8)
    conflict : (n,) that the rule redistributed between the entities
    coverage : by source, such as ``driver.age``: 1 less its discount rate, 0 where it knows nothing, (n,)
    vehicle : the three systems' risks
    """

    fused: FloatArray
    entities: Mapping[str, FloatArray]
    conflict: FloatArray
    coverage: Mapping[str, FloatArray]
    vehicle: VehicleRisk

    def attribution(self, rule: str = RULES[0]) -> dict[str, FloatArray]:
        """What each entity adds to the mean pignistic probabilities of LR, MR, HR over knowing nothing, (3,) each."""
        shares = attribute(np.stack(list(self.entities.values()), axis=1), rule)
        return {name: share.mean(axis=0) for name, share in zip(self.entities, shares, strict=True)}


def assess(model: RiskModel, driver: Driver, environment: Environment, motion: Motion) -> Assessment:
    """Assess n instants.

    A source that knows nothing of an instant has no part in its entity there, as PCR6 is not neutral to a vacuous one,
    and an entity of which nothing is ever known is left out. A vehicle without a velocity takes part on Theta, as in
    the paper. Coverage says how far each was known.

    Parameters
    ----------
    environment, motion : of the same n instants
    """
    n = len(environment.t_ns)
    coverage: dict[str, FloatArray] = {}
    entities: dict[str, FloatArray] = {}

    sources = [(table, *table.look_up(driver.values())) for table in model.tables.of(DRIVER)]
    for table, _, known in sources:
        coverage[f"{DRIVER}.{table.name}"] = np.full(n, float(known[0]))
    if any(known[0] for _, _, known in sources):
        local = _fused_where_known([mass for _, mass, _ in sources], [known for _, _, known in sources], model.rule)
        entities[DRIVER] = np.broadcast_to(local, (n, N_SETS))

    values = environment.values()
    masses, knowing = [], []
    for table in model.tables.of(ENVIRONMENT):
        mass, known = table.look_up(values)
        alpha = _misplaced(table.inputs, environment.road.position_sd_m)
        coverage[f"{ENVIRONMENT}.{table.name}"] = np.where(known, 1.0 - alpha, 0.0)
        masses.append(discount(mass, alpha))
        knowing.append(known)
    if any(known.any() for known in knowing):
        entities[ENVIRONMENT] = _fused_where_known(masses, knowing, model.rule)

    vehicle = model.vehicle.assess(motion, environment.road, environment.sun_rad())
    coverage |= {f"{VEHICLE}.{name}": share for name, share in vehicle.coverage.items()}
    entities[VEHICLE] = vehicle.mass
    fused, conflict = combine(np.stack(list(entities.values()), axis=1), model.rule)
    return Assessment(fused, entities, conflict, coverage, vehicle)


def _misplaced(inputs: tuple[str, ...], position_sd_m: FloatArray) -> FloatArray:
    """Discount rate of a table for where the vehicle is, (n,)."""
    alpha = np.zeros(len(position_sd_m))
    if "district" in inputs:
        alpha = np.maximum(alpha, doubt(DISTRICT_HALF_CLASS_M, position_sd_m))
    if _ROAD_INPUTS.intersection(inputs):
        alpha = np.maximum(alpha, doubt(POSITION_HALF_CLASS_M, position_sd_m))
    return alpha


def _fused_where_known(masses: list[FloatArray], knowing: list[BoolArray], rule: str) -> FloatArray:
    """Combine at each instant the sources that know it, (n, 8); Theta where none does."""
    stacked, known = np.stack(masses, axis=1), np.stack(knowing, axis=1)
    fused = vacuous(len(stacked))
    pattern = (known * (1 << np.arange(known.shape[1]))).sum(axis=1)
    for bits in np.unique(pattern[pattern > 0]):
        here = pattern == bits
        members = [i for i in range(known.shape[1]) if int(bits) >> i & 1]
        fused[here], _ = combine(stacked[here][:, members], rule)
    return fused
