"""What an accident detector says: impacts, and what felt like one and was none, in the vehicle's own frame."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, NamedTuple

from core.measurements import FloatArray, TimeArray


class Severity(StrEnum):
    """Seed 1's classes: low-speed, severe (7-12 m/s within 1 s), airbag (25-40 km/h and above)."""

    LOW_SPEED = "low_speed"
    SEVERE = "severe"
    AIRBAG = "airbag"


class Kind(StrEnum):
    """What happened: a collision on the road, one of a parked vehicle that was hit, or a rollover without either."""

    COLLISION = "collision"
    PARKED_HIT = "parked_hit"
    ROLLOVER = "rollover"


class Status(StrEnum):
    """How far an accident is known: told at once as suspected, then confirmed or retracted by what followed."""

    SUSPECTED = "suspected"
    CONFIRMED = "confirmed"
    RETRACTED = "retracted"


class NoAccident(StrEnum):
    """What feels like an accident and is none; ``UNEXPLAINED`` fits no class and is too weak to be told.

    ``FELL_OVER`` is a motorcycle that fell where it stood.
    """

    POTHOLE = "pothole"
    SPEED_BUMP = "speed_bump"
    KERB = "kerb"
    RAILWAY_CROSSING = "railway_crossing"
    VIBRATION_TRAIN = "vibration_train"
    DOOR_SLAM = "door_slam"
    EMERGENCY_BRAKING = "emergency_braking"
    HARD_CORNERING = "hard_cornering"
    TOWING = "towing"
    FERRY = "ferry"
    BOX_KNOCKED = "box_knocked"
    BOX_DROPPED = "box_dropped"
    SENSOR_GLITCH = "sensor_glitch"
    TRAILER_COUPLING = "trailer_coupling"
    FELL_OVER = "fell_over"
    UNEXPLAINED = "unexplained"


@dataclass(frozen=True, slots=True, eq=False)
class VehicleMotion:
    """Calibrated samples with what the filter knows at each of them: a detector's input.

    Parameters
    ----------
    t_ns : (n,) int64
    f_b : (n, 3) specific force, m/s2, body axes, calibrated, not denoised
    omega_b : (n, 3) angular rate, rad/s
    down_b : (n, 3) unit vector of the local vertical (down) in body axes, from the fused attitude;
        NaN rows while the filter has no attitude
    speed_mps : (n,) fused horizontal speed; NaN while unknown
    gravity_mps2 : local gravity
    saturated : (n,) uint8, 1 where an axis of the accelerometer read its full scale
    ignition : whether it is on; None while unknown
    flags : bits ``FLAG_AIRBAG``, ``FLAG_POWER_LOSS``, ``FLAG_TOW`` of ``core.measurements``
    """

    t_ns: TimeArray
    f_b: FloatArray
    omega_b: FloatArray
    down_b: FloatArray
    speed_mps: FloatArray
    saturated: FloatArray
    gravity_mps2: float
    ignition: bool | None = None
    flags: int = 0


@dataclass(frozen=True, slots=True)
class InjuryRisk:
    """Probability of an injury of MAIS 3 or worse to a front occupant, with its 95 % interval and where it is from."""

    probability: float
    low: float
    high: float
    source: str


@dataclass(frozen=True, slots=True)
class FeltImpact:
    """One of an accident's impacts; figures as of ``Impact``, forward and right as the vehicle headed as it began."""

    t_ns: int
    duration_s: float
    delta_v_mps: float
    delta_v_interval_mps: tuple[float, float]
    delta_v_b_mps: tuple[float, float]
    pdof_deg: float
    pdof_sd_deg: float
    peak_mps2: float
    clipped: bool


@dataclass(frozen=True, slots=True)
class Impact:
    """One accident as felt by the vehicle, as far as it is known at ``decided_t_ns``.

    An accident is told at once as suspected (``revision`` 0) and again, with the same ``t_ns`` and the next
    ``revision``, as more is known: its whole pulse, later impacts that belong to it, what followed.

    Parameters
    ----------
    t_ns : start of the first impact
    decided_t_ns : the sample at which this was known
    delta_v_mps, delta_v_sd_mps : length of the worst impact's change of horizontal velocity
    delta_v_b_mps : its forward and right part
    pdof_deg : where the force came from, clockwise seen from above: 0 front, 90 right, 180 rear, 270 left
    confidence : probability in 0..1 that it was an accident
    delta_v_interval_mps : 95 % interval of ``delta_v_mps``; wide where the pulse clipped
    pdof_sd_deg : spread of the direction, also by which of several impacts was the worst; NaN while unknown
    impacts : how many impacts belong to it so far
    each : their own figures, in their order; none where they are not known
    rollover : whether the vehicle tipped over
    reasons : what speaks for and against it, in the words of ``core.accident.judgement``
    """

    t_ns: int
    decided_t_ns: int
    detector: str
    severity: Severity
    confidence: float
    delta_v_mps: float
    delta_v_sd_mps: float
    delta_v_b_mps: tuple[float, float]
    pdof_deg: float
    peak_mps2: float
    duration_s: float
    clipped: bool
    speed_before_mps: float
    paper_agrees: bool
    revision: int = 0
    kind: Kind = Kind.COLLISION
    status: Status = Status.SUSPECTED
    delta_v_interval_mps: tuple[float, float] = (math.nan, math.nan)
    pdof_sd_deg: float = math.nan
    impacts: int = 1
    each: tuple[FeltImpact, ...] = ()
    rollover: bool = False
    injury: InjuryRisk | None = None
    reasons: tuple[str, ...] = ()


def impact_of(kept: Mapping[str, Any]) -> Impact:
    """An impact of what ``asdict`` and JSON made of one."""
    return Impact(
        **(
            _with_tuples(kept, "delta_v_b_mps", "delta_v_interval_mps", "reasons")
            | {
                "each": tuple(
                    FeltImpact(**_with_tuples(one, "delta_v_b_mps", "delta_v_interval_mps")) for one in kept["each"]
                ),
                "severity": Severity(kept["severity"]),
                "kind": Kind(kept["kind"]),
                "status": Status(kept["status"]),
                "injury": None if kept["injury"] is None else InjuryRisk(**kept["injury"]),
            }
        )
    )


def _with_tuples(kept: Mapping[str, Any], *names: str) -> dict[str, Any]:
    return dict(kept) | {name: tuple(kept[name]) for name in names}


@dataclass(frozen=True, slots=True)
class Candidate:
    """What felt like an accident and was judged to be none: kept, so that a reviewer can look.

    Velocities are changes over the shock, horizontal and vertical; ``probability`` is that of an accident.
    """

    t_ns: int
    decided_t_ns: int
    reason: NoAccident
    probability: float
    delta_v_mps: float
    vertical_mps: float
    peak_mps2: float
    duration_s: float
    speed_before_mps: float
    paper_agrees: bool


class Findings(NamedTuple):
    """What some samples decided: accidents told or told again, and what was judged to be none."""

    impacts: list[Impact]
    candidates: list[Candidate]
