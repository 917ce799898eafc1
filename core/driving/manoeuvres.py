"""Manoeuvres as a fold over horizontal motion: harsh braking, acceleration and cornering, and changes of lane."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from enum import StrEnum
from typing import Final

import numpy as np
import numpy.typing as npt

from core.accident.events import VehicleMotion
from core.driving import manoeuvre_scan as scan
from core.driving.hazards import Braking, pothole_explains
from core.driving.horizontal import HorizontalMotion, Levelling, LevellingTuning
from core.measurements import FloatArray
from core.tunables import Tunables, tunable


class Manoeuvre(StrEnum):
    """What was done."""

    BRAKING = "braking"
    ACCELERATION = "acceleration"
    CORNERING = "cornering"
    LANE_CHANGE = "lane_change"


_KINDS: Final = (Manoeuvre.BRAKING, Manoeuvre.ACCELERATION, Manoeuvre.CORNERING, Manoeuvre.LANE_CHANGE)


@dataclass(frozen=True, slots=True)
class ManoeuvreThresholds(Tunables):
    """What is harsh, and what is a change of lane."""

    low_pass_hz: float = tunable(
        2.0,
        unit="Hz",
        low=0.2,
        high=20.0,
        source="choice: two poles; a car answers below 2 Hz, roads shake above",
    )
    braking_mps2: float = tunable(
        4.0, unit="m/s2", low=0.5, high=12.0, source="HR from 4.0; Progressive 3.13, Digital Matter 4.4 (SOURCES)"
    )
    acceleration_mps2: float = tunable(
        2.8, unit="m/s2", low=0.5, high=12.0, source="MR's core 2.8; Scope .25 g, Progressive 4.02 (SOURCES)"
    )
    cornering_mps2: float = tunable(
        4.0, unit="m/s2", low=0.5, high=12.0, source="HR from 4.0; Scope .45 g, Digital Matter 5.5 (SOURCES)"
    )
    lane_change_mps2: float = tunable(
        3.0, unit="m/s2", low=0.5, high=12.0, source="MR's core 3.0 lateral (SOURCES): an aggressive change of lane"
    )
    exit_share: float = tunable(
        0.4, unit="1", low=0.05, high=1.0, source="choice: of its threshold; below it an episode begins and ends"
    )
    settled_s: float = tunable(
        0.4, unit="s", low=0.0, high=5.0, source="choice: so long below it; the time of a gear's change"
    )
    least_s: float = tunable(0.4, unit="s", low=0.0, high=5.0, source="choice: shorter is a bump or a kerb")
    kept_s: float = tunable(
        0.0, unit="s", low=0.0, high=20.0, source="choice: how long an acceleration is kept up at least; see PHONE"
    )
    kept_share: float = tunable(
        0.75, unit="1", low=0.05, high=1.0, source="choice: of its threshold, above which an acceleration is kept up"
    )
    longitudinal_gate_mps: float = tunable(
        10.0 / 3.6, unit="m/s", low=0.0, high=50.0, source="GNSS gates from 10 km/h (SOURCES): fastest of the episode"
    )
    shown_share: float = tunable(
        0.5, unit="1", low=0.0, high=1.0, source="choice: of its integral that the speed has to change by, where known"
    )
    cornering_gate_mps: float = tunable(
        15.0 / 3.6, unit="m/s", low=0.0, high=50.0, source="choice: 4 m/s2 at 15 km/h is a radius of 4 m, the tightest"
    )
    lateral_floor_mps2: float = tunable(
        0.4, unit="m/s2", low=0.1, high=3.0, source="choice: 3.5 m in 7 s, as on a motorway, peaks at 0.45"
    )
    lane_pulse_s: float = tunable(
        6.0, unit="s", low=1.0, high=20.0, source="choice: longest half of a change of lane; most last 3 to 8 s in all"
    )
    lane_gap_s: float = tunable(
        1.5, unit="s", low=0.0, high=10.0, source="choice: going straight between its two halves"
    )
    lane_heading_rad: float = tunable(
        0.1, unit="rad", low=0.01, high=1.0, source="choice: 6 deg; what a change of lane leaves of its turn at most"
    )
    lane_turn_rad: float = tunable(
        0.6, unit="rad", low=0.05, high=1.6, source="choice: 35 deg; turned further on its way it was a corner"
    )
    lane_least_m: float = tunable(2.0, unit="m", low=0.5, high=5.0, source="choice: lanes are 2.75 to 3.75 m wide")
    lane_most_m: float = tunable(6.0, unit="m", low=2.0, high=20.0, source="choice: less than two of them")
    repeat_s: float = tunable(
        60.0, unit="s", low=0.0, high=3600.0, source="Powerfleet: repeats within one minute count once (SOURCES)"
    )
    recovery_s: float = tunable(
        2.0, unit="s", low=0.0, high=60.0, source="choice: taking up speed at once after braking belongs to it"
    )
    gap_s: float = tunable(1.0, unit="s", low=0.05, high=60.0, source="choice: across longer nothing is followed")
    foreseen_s: float = tunable(
        2.0, unit="s", low=0.0, high=60.0, source="choice: who sees a hazard brakes so long before it is detected"
    )
    evading_s: float = tunable(
        5.0, unit="s", low=0.0, high=60.0, source="choice: or begins to brake or swerve so long after that, at most"
    )


PHONE: Final = ManoeuvreThresholds(braking_mps2=3.92, acceleration_mps2=2.45, cornering_mps2=4.41, kept_s=2.5)
"""For motion from ``EarthAxes``: Scope's .40, .25 and .45 g (SOURCES). Without a speed the first moments of any
brisk start look harsh: first gear pulls like that. It is left at some 25 km/h, which 2.8 m/s2 takes 2.5 s to; a
harsh start is kept up for longer (a choice)."""


@dataclass(frozen=True, slots=True)
class Episode:
    """One manoeuvre, told when it is over. It is identified by its kind and ``start_t_ns`` within its vehicle.

    Parameters
    ----------
    start_t_ns, peak_t_ns, end_t_ns : of the excursion beyond the exit threshold
    peak_mps2 : largest deceleration, acceleration or lateral acceleration, below ``low_pass_hz``, positive
    direction : "left" or "right" of cornering and of a change of lane; "" otherwise
    aggressive : whether it is beyond the harsh threshold: always, but for ordinary changes of lane
    speed_before_mps, speed_after_mps, speed_at_peak_mps : NaN while unknown
    across_mps2 : acceleration in the other axis at the peak: to the right, or forward
    radius_m : speed over rate of turn at the peak; inf straight ahead, NaN where the speed is unknown
    heading_change_rad : clockwise
    counted : False for a repeat within ``repeat_s`` of one of its kind that counts, and for a recovery
    recovery : an acceleration at once after a harsh braking
    defensive : explained by a hazard or an accident (``explained``)
    """

    kind: Manoeuvre
    start_t_ns: int
    peak_t_ns: int
    end_t_ns: int
    peak_mps2: float
    direction: str
    aggressive: bool
    speed_before_mps: float
    speed_after_mps: float
    speed_at_peak_mps: float
    across_mps2: float
    radius_m: float
    heading_change_rad: float
    counted: bool
    recovery: bool = False
    defensive: bool = False

    @property
    def duration_s(self) -> float:
        """From where it rose above the exit threshold to where it fell below."""
        return (self.end_t_ns - self.start_t_ns) * 1e-9


class ManoeuvreTracker:
    """Folds motion into episodes; the same samples give the same episodes however they are cut.

    Feed it either by ``step``, with fused samples, or by ``step_horizontal``.
    """

    def __init__(self, thresholds: ManoeuvreThresholds | None = None, levelling: LevellingTuning | None = None) -> None:
        self._thresholds = thresholds or ManoeuvreThresholds()
        self._levelling_tuning = levelling
        self._begin()

    def _begin(self) -> None:
        self._levelling = Levelling(self._levelling_tuning)
        self._limits = np.array([float(getattr(self._thresholds, field.name)) for field in fields(ManoeuvreThresholds)])
        self._times = np.zeros(scan.TIMES, dtype=np.int64)
        self._values = np.zeros(scan.VALUES)
        self._counted = np.full((len(_KINDS), 2), scan.NEVER, dtype=np.int64)
        """By kind the end of the last episode that counts, and of the last harsh one that is no recovery."""

    def step(self, motion: VehicleMotion) -> list[Episode]:
        """Take the next fused samples; return the episodes that ended in them, in the order of their decision."""
        return self.step_horizontal(self._levelling.step(motion))

    def turn(self, C_new_from_old: FloatArray) -> None:
        """Take samples in other body axes from now on: what was along may have been across, so begin anew."""
        self._begin()

    def step_horizontal(self, motion: HorizontalMotion) -> list[Episode]:
        """Take the next rows; return the episodes that ended in them, in the order of their decision.

        Rows with no acceleration, or not later than the one before, are left out.
        """
        forward, right, yaw, speed = (
            np.ascontiguousarray(rows, dtype=np.float64)
            for rows in (motion.forward_mps2, motion.right_mps2, motion.yaw_radps, motion.speed_mps)
        )
        t_ns = np.ascontiguousarray(motion.t_ns)
        told = np.empty((scan.BUFFER, scan.TOLD))
        told_ns = np.empty((scan.BUFFER, 3), dtype=np.int64)
        found: list[Episode] = []
        row = 0
        while row < t_ns.shape[0]:
            row, count = scan.scan(
                t_ns, forward, right, yaw, speed, row, self._times, self._values, self._limits, told, told_ns
            )
            found += [self._episode(told_ns[k], told[k]) for k in range(count)]
        return found

    def state(self) -> dict[str, npt.NDArray[np.generic]]:
        """Arrays from which ``load`` goes on, to the bit."""
        return {
            **self._levelling.state(),
            "manoeuvres.times": self._times,
            "manoeuvres.values": self._values,
            "manoeuvres.counted": self._counted,
        }

    def load(self, arrays: Mapping[str, npt.NDArray[np.generic]]) -> None:
        """Go on from a ``state``."""
        self._levelling.load(arrays)
        self._times = np.array(arrays["manoeuvres.times"], dtype=np.int64)
        self._values = np.array(arrays["manoeuvres.values"], dtype=np.float64)
        self._counted = np.array(arrays["manoeuvres.counted"], dtype=np.int64)

    def _episode(self, times_ns: npt.NDArray[np.int64], row: npt.NDArray[np.float64]) -> Episode:
        limits, counted = self._thresholds, self._counted
        start, peak, end = times_ns.tolist()
        code = int(row[scan.KIND])
        kind, side = _KINDS[code], float(row[scan.SIDE])
        harsh = (limits.braking_mps2, limits.acceleration_mps2, limits.cornering_mps2, limits.lane_change_mps2)[code]
        aggressive = bool(row[scan.PEAK] >= harsh)
        after_braking = start - int(counted[scan.BRAKING, 1]) <= round(1e9 * limits.recovery_s)
        recovery = kind is Manoeuvre.ACCELERATION and after_braking
        if aggressive and not recovery:
            counted[code, 1] = end
        counts = not recovery and start - int(counted[code, 0]) > round(1e9 * limits.repeat_s)
        if counts and aggressive:
            counted[code, 0] = end
        speed, yaw = float(row[scan.SPEED_AT_PEAK]), abs(float(row[scan.YAW_AT_PEAK]))
        return Episode(
            kind=kind,
            start_t_ns=start,
            peak_t_ns=peak,
            end_t_ns=end,
            peak_mps2=float(row[scan.PEAK]),
            direction="" if code < scan.CORNERING else ("right" if side > 0.0 else "left"),
            aggressive=aggressive,
            speed_before_mps=float(row[scan.SPEED_BEFORE]),
            speed_after_mps=float(row[scan.SPEED_AFTER]),
            speed_at_peak_mps=speed,
            across_mps2=float(row[scan.ACROSS]),
            radius_m=speed / yaw if yaw > 0.0 else (np.inf if speed == speed else np.nan),
            heading_change_rad=float(row[scan.HEADING]),
            counted=counts,
            recovery=recovery,
        )


def explained(
    episodes: Iterable[Episode],
    causes_t_ns: Sequence[int],
    potholes_t_ns: Sequence[int] = (),
    thresholds: ManoeuvreThresholds | None = None,
) -> list[Episode]:
    """The episodes, those marked as defensive that a hazard or an accident explains (``is_explained``), or a pothole
    that was struck (``pothole_explains``)."""

    def struck(one: Episode) -> bool:
        braking = Braking(one.start_t_ns, one.end_t_ns)
        return one.kind is Manoeuvre.BRAKING and any(pothole_explains(braking, t_ns) for t_ns in potholes_t_ns)

    return [
        replace(one, defensive=True)
        if is_explained(one.kind, one.start_t_ns, one.end_t_ns, causes_t_ns, thresholds) or struck(one)
        else one
        for one in episodes
    ]


def is_explained(
    kind: Manoeuvre,
    start_t_ns: int,
    end_t_ns: int,
    causes_t_ns: Iterable[int],
    thresholds: ManoeuvreThresholds | None = None,
) -> bool:
    """Whether a hazard or an accident explains a braking or a swerve.

    Parameters
    ----------
    causes_t_ns : when hazards and accidents were, as they were detected
    """
    limits = thresholds or ManoeuvreThresholds()
    begin, end = start_t_ns - round(1e9 * limits.evading_s), end_t_ns + round(1e9 * limits.foreseen_s)
    return kind in (Manoeuvre.BRAKING, Manoeuvre.LANE_CHANGE) and any(begin <= cause <= end for cause in causes_t_ns)
