"""What an eCall would say of an accident: the minimum set of data of EN 15722 by its own names and units, as JSON.

Positions are in milliarcseconds, directions in steps of 2 degrees, the two recent locations in steps of 100
milliarcseconds: the first against the vehicle's location, the second against the first, positive north and east.
"""

from __future__ import annotations

import math
from typing import Any, Final

from schemas.vehicles import VehicleConfig
from service.storage.accidents import AccidentRow
from service.storage.trips import TrackRow

MSD_VERSION: Final = 2
MAS_PER_DEG: Final = 3_600_000
NO_POSITION: Final = 0x7FFFFFFF
NO_DIRECTION: Final = 255
DELTA_MAS: Final = 100
DELTA_RANGE: Final = (-512, 511)
TRUSTED_M: Final = 150.0
"""A position can be trusted that lies within this with 95 % (EN 15722, positionCanBeTrusted)."""
WITHIN_95: Final = math.sqrt(-2.0 * math.log(0.05))
"""Radius of 95 % of a two-dimensional normal distribution, in its sd."""
RECENT_S: Final = (5.0, 10.0)
"""How long before the accident the recent locations are: enough to see the direction at walking pace; a choice."""

VEHICLE_TYPES: Final = {
    "car": "passengerVehicleClassM1",
    "van": "lightCommercialVehiclesClassN1",
    "truck": "heavyDutyVehiclesClassN2",
    "bus": "busesAndCoachesClassM2",
    "motorcycle": "motorcyclesClassL3e",
}
"""Of a truck and a bus the lighter class: the settings do not say their mass."""

TANKS: Final = {
    "gasoline": "gasolineTankPresent",
    "diesel": "dieselTankPresent",
    "cng": "compressedNaturalGas",
    "lpg": "liquidPropaneGas",
    "electric": "electricEnergyStorage",
    "hydrogen": "hydrogenStorage",
    "other": "otherStorage",
}


def minimum_set_of_data(row: AccidentRow, config: VehicleConfig, recent: list[TrackRow]) -> dict[str, Any]:
    """The set; ``recent`` are the vehicle's places ``RECENT_S`` before, as far as they are known and may be told.

    Each revision of an accident is another message of the same incident, so ``messageIdentifier`` counts them.
    """
    place = None if row.lat_deg is None or row.lon_deg is None else (_mas(row.lat_deg), _mas(row.lon_deg))
    deltas: list[dict[str, int] | None] = []
    before = place
    for one in recent:
        at = (_mas(one.lat_deg), _mas(one.lon_deg))
        delta = None if before is None else _delta(at, before)
        deltas.append(delta)
        before = None if delta is None else at
    deltas += [None] * (len(RECENT_S) - len(deltas))
    return {
        "msdVersion": MSD_VERSION,
        "msd": {
            "msdStructure": {
                "messageIdentifier": min(row.revision + 1, 255),
                "control": {
                    "automaticActivation": True,
                    "testCall": False,
                    "positionCanBeTrusted": _can_be_trusted(row),
                    "vehicleType": VEHICLE_TYPES[config.vehicle_class],
                },
                "vehicleIdentificationNumber": _vin(config.vin),
                "vehiclePropulsionStorageType": None
                if config.propulsion is None
                else {name: kind in config.propulsion for kind, name in TANKS.items()},
                "timestamp": row.t_ns // 1_000_000_000,
                "vehicleLocation": {
                    "positionLatitude": NO_POSITION if place is None else place[0],
                    "positionLongitude": NO_POSITION if place is None else place[1],
                },
                "vehicleDirection": NO_DIRECTION if row.heading_deg is None else round(row.heading_deg / 2.0) % 180,
                "recentVehicleLocationN1": deltas[0],
                "recentVehicleLocationN2": deltas[1],
                "numberOfPassengers": None,
            },
            "optionalAdditionalData": {
                "oid": None,
                "data": {
                    "deltaVLongitudinalKmh": _kmh(row.detail["delta_v_b_mps"][0]),
                    "deltaVLateralKmh": _kmh(row.detail["delta_v_b_mps"][1]),
                    "deltaVKmh": _kmh(row.detail["delta_v_mps"]),
                    "deltaVInterval95Kmh": [_kmh(one) for one in row.detail["delta_v_interval_mps"]],
                    "principalDirectionOfForceDeg": row.detail["pdof_deg"],
                    "rollover": row.detail["rollover"],
                    "numberOfImpacts": row.detail["impacts"],
                },
            },
        },
    }


def _mas(angle_deg: float) -> int:
    return round(angle_deg * MAS_PER_DEG)


def _delta(at: tuple[int, int], against: tuple[int, int]) -> dict[str, int] | None:
    """None where it is too far away to be said: the range ends at 1.5 km."""
    north, east = (round((a - b) / DELTA_MAS) for a, b in zip(at, against, strict=True))
    low, high = DELTA_RANGE
    if not (low <= north <= high and low <= east <= high):
        return None
    return {"latitudeDelta": north, "longitudeDelta": east}


def _can_be_trusted(row: AccidentRow) -> bool:
    if row.lat_deg is None or row.sd_n_m is None or row.sd_e_m is None:
        return False
    return WITHIN_95 * max(row.sd_n_m, row.sd_e_m) <= TRUSTED_M


def _vin(vin: str | None) -> dict[str, str] | None:
    if vin is None:
        return None
    return {"isowmi": vin[:3], "isovds": vin[3:9], "isovisModelyear": vin[9], "isovisSeqPlant": vin[10:]}


def _kmh(speed_mps: float | None) -> float | None:
    return None if speed_mps is None else round(3.6 * speed_mps, 2)
