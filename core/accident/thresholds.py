"""Every number an accident is decided by. 'Choice' in a source means that nothing was published to copy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from core.tunables import Tunables, tunable

MPS_PER_KMH: Final = 1.0 / 3.6


@dataclass(frozen=True, slots=True)
class LevelThresholds(Tunables):
    """How samples are freed of gravity where the filter has no attitude, and when a series is broken."""

    gap_s: float = tunable(
        0.1, unit="s", low=0.02, high=1.0, source="choice: no change of velocity is known across a longer silence"
    )
    levelling_s: float = tunable(
        2.0, unit="s", low=0.5, high=30.0, source="choice: holds a gyroscope bias of 4 deg/s to 8 deg of tilt"
    )
    levelling_band_mps2: float = tunable(
        2.0, unit="m/s2", low=0.2, high=5.0, source="choice: off 1 g by more, a sample says little about the vertical"
    )
    clipped_from_mps2: float = tunable(
        14.7,
        unit="m/s2",
        low=5.0,
        high=200.0,
        source="choice, 1.5 g: of a box clipping at 2 g, a sample at full scale is a horizontal clip from here up",
    )
    clipped_gain: float = tunable(
        2.0,
        unit="1",
        low=1.0,
        high=5.0,
        source="choice: a haversine spends what it clips at about twice the level it clips at, for peaks of 2-4 levels",
    )


@dataclass(frozen=True, slots=True)
class SeverityThresholds(Tunables):
    """Borders of the classes of severity (Seed 1, section 3.3)."""

    severe_mps: float = tunable(
        6.5, unit="m/s", low=2.0, high=12.0, source="seed 1, 3.3: low-speed accidents stay below; severe are 7-12 m/s"
    )
    airbag_mps: float = tunable(
        25.0 * MPS_PER_KMH, unit="m/s", low=4.0, high=20.0, source="seed 1, 3.3: airbags fire from 25-40 km/h"
    )
    airbag_s: float = tunable(
        0.15,
        unit="s",
        low=0.05,
        high=0.5,
        source="49 CFR 563 trigger window: an airbag needs the change to be that fast",
    )


@dataclass(frozen=True, slots=True)
class PaperThresholds(Tunables):
    """Seed 1's rule of two thresholds. Curvature is |yaw rate| / speed, in ``curvature_unit_deg`` per metre."""

    acceleration_mps2: float = tunable(
        3.7, unit="m/s2", low=0.1, high=100.0, source="seed 1, 3.3 and fig. 9: norm of three axes, gravity removed"
    )
    curvature: float = tunable(15.0, unit="curvature_unit_deg/m", low=0.0, high=1e4, source="seed 1, 3.3 and fig. 9")
    curvature_unit_deg: float = tunable(
        1.0,
        unit="deg",
        low=1e-3,
        high=90.0,
        source="seed 1, 4.3.1 says degrees (1.0); 3.3 prints 1/m (57.29578, a radius of 7 cm at most)",
    )
    speed_floor_mps: float = tunable(
        0.5,
        unit="m/s",
        low=0.01,
        high=5.0,
        source="choice: at a standstill curvature is undefined; below this speed it is taken at this speed",
    )
    window_s: float = tunable(
        1.0,
        unit="s",
        low=0.1,
        high=2.0,
        source="seed 1, 3.3: change of velocity within 1 s, centred on the first sample",
    )
    grouping_s: float = tunable(
        5.0, unit="s", low=0.5, high=60.0, source="49 CFR 563.5: events within 5 s are one accident's"
    )
    level: LevelThresholds = LevelThresholds()
    severity: SeverityThresholds = SeverityThresholds()


@dataclass(frozen=True, slots=True)
class DetectorThresholds(Tunables):
    """The project's own detector: a change of velocity that no tyre can bring about.

    Over w seconds brakes and steering change the horizontal velocity by at most ``tyre_mps2`` times w. What
    exceeds that by ``margin_mps``, in any window from ``shortest_s`` to ``longest_s``, was an impact.
    """

    tyre_mps2: float = tunable(
        10.8,
        unit="m/s2",
        low=5.0,
        high=20.0,
        source="choice, 1.1 g: above emergency braking and cornering of cars on dry asphalt, about 1 g",
    )
    margin_mps: float = tunable(
        0.6,
        unit="m/s",
        low=0.1,
        high=5.0,
        source="49 CFR 563.5: 8 km/h (2.22 m/s) within 150 ms triggers; 2.22 - 150 ms x tyre_mps2 leaves 0.60",
    )
    shortest_s: float = tunable(
        0.05,
        unit="s",
        low=0.01,
        high=0.2,
        source="choice: door slams, stones and knocks on the box swing back within; crash pulses last longer",
    )
    longest_s: float = tunable(1.0, unit="s", low=0.2, high=1.0, source="seed 1, 3.3: severe is a change within 1 s")
    onset_mps2: float = tunable(
        2.0, unit="m/s2", low=0.2, high=10.0, source="choice: what braking and road leave on a pulse's direction"
    )
    onset_s: float = tunable(
        0.03, unit="s", low=0.0, high=0.2, source="choice: flank below tyre_mps2 of a 60-150 ms pulse, at most"
    )
    settled_s: float = tunable(
        0.04, unit="s", low=0.005, high=0.2, source="choice: a pulse is over when so long below tyre_mps2"
    )
    decide_s: float = tunable(
        0.3, unit="s", low=0.1, high=0.6, source="49 CFR 563.7, table I: the maximum change is looked for within 300 ms"
    )
    slow_decide_s: float = tunable(
        0.1, unit="s", low=0.0, high=0.5, source="choice: time left to a slow pulse that is suspected after decide_s"
    )
    retained: float = tunable(
        0.5, unit="1", low=0.0, high=1.0, source="choice: a shock that gives back over half its change was no impact"
    )
    clipped_sds: float = tunable(
        0.7,
        unit="1",
        low=0.0,
        high=5.0,
        source="choice: what clipping hid must make the impact likely by three to one; a kerb at 2 g does not",
    )
    vertical_ratio: float = tunable(
        0.7,
        unit="1",
        low=0.0,
        high=5.0,
        source="choice: potholes and bumps change the vertical velocity more than the horizontal; crashes do not",
    )
    grouping_s: float = tunable(
        5.0, unit="s", low=0.5, high=60.0, source="49 CFR 563.5: events within 5 s are one accident's"
    )
    scale_sd: float = tunable(
        0.03,
        unit="1",
        low=0.001,
        high=0.5,
        source="choice: scale, misalignment and sampling of a MEMS triad in a pulse",
    )
    tilt_sd_rad: float = tunable(
        0.03, unit="rad", low=0.001, high=0.5, source="choice, 2 deg: attitude from the filter while driving"
    )
    blind_tilt_sd_rad: float = tunable(
        0.14, unit="rad", low=0.01, high=1.0, source="choice, 8 deg: attitude from levelling alone"
    )
    noise_sd_mps: float = tunable(
        0.1, unit="m/s", low=0.001, high=2.0, source="choice: road and body vibration on an integrated pulse"
    )
    level: LevelThresholds = LevelThresholds()
    severity: SeverityThresholds = SeverityThresholds()
    paper: PaperThresholds = PaperThresholds()
