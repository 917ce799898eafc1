"""Every number an accident is found, read and followed by; names and weights have theirs in `naming` and `weights`.

'Choice' in a source means that nothing was published to copy.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from core.accident.naming import NamingThresholds
from core.accident.weights import JudgementThresholds
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
    usual_s: float = tunable(
        30.0, unit="s", low=5.0, high=600.0, source="choice: longer than any tilt in a bend, shorter than a trip"
    )
    standing_mps: float = tunable(
        0.3, unit="m/s", low=0.05, high=1.0, source="choice: fused speeds of standing cars stay below 0.1 m/s"
    )
    slow_s: float = tunable(
        0.3, unit="s", low=0.05, high=2.0, source="choice: brakes build up within it, a crash pulse is over"
    )
    rough_s: float = tunable(1.0, unit="s", low=0.1, high=10.0, source="choice: a car's length of road at walking pace")
    parks_s: float = tunable(
        5.0,
        unit="s",
        low=0.0,
        high=60.0,
        source="choice: so long after it stopped, a car has come to rest on its springs",
    )
    slope_deg: float = tunable(
        6.0, unit="deg", low=0.0, high=20.0, source="choice, 10 %: streets that cars are parked on are hardly steeper"
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
class TriggerThresholds(Tunables):
    """When something is looked at: a change of velocity that no tyre can bring about, a shock, a tilt, hard driving.

    Over w seconds brakes and steering change the horizontal velocity by at most ``tyre_mps2`` times w, and from the
    acceleration that there was by at most ``jerk_mps3`` w^2 / 2, as neither pedal nor wheel moves at once; letting go
    of them does. What exceeds either by ``margin_mps``, in a window of ``shortest_s`` to ``longest_s``, may have been
    an impact. A vehicle that has stood for ``rest_s`` can only pull away: ``standing_mps2`` takes the tyres' place.
    """

    tyre_mps2: float = tunable(
        10.8,
        unit="m/s2",
        low=5.0,
        high=20.0,
        source="choice, 1.1 g: above emergency braking and cornering of cars on dry asphalt, about 1 g",
    )
    margin_mps: float = tunable(
        0.4, unit="m/s", low=0.05, high=5.0, source="choice: what potholes leave of a change of velocity after 50 ms"
    )
    jerk_mps3: float = tunable(
        60.0, unit="m/s3", low=10.0, high=500.0, source="choice: brake assist builds up 1 g within 0.15 s"
    )
    hot_mps2: float = tunable(
        4.0, unit="m/s2", low=1.0, high=10.0, source="choice: a pulse goes on while so far from what was there before"
    )
    rest_s: float = tunable(0.5, unit="s", low=0.1, high=5.0, source="choice: longer than a moment of no speed")
    standing_mps2: float = tunable(
        4.0,
        unit="m/s2",
        low=1.0,
        high=20.0,
        source="choice: hard starts of cars come to 4 m/s2 over their first second",
    )
    standing_margin_mps: float = tunable(
        0.25, unit="m/s", low=0.05, high=5.0, source="choice: doors and boarding people move a car by less than 0.2 m/s"
    )
    shortest_s: float = tunable(
        0.05,
        unit="s",
        low=0.01,
        high=0.2,
        source="choice: door slams, stones and knocks on the box swing back within; crash pulses last longer",
    )
    longest_s: float = tunable(1.0, unit="s", low=0.2, high=1.0, source="seed 1, 3.3: severe is a change within 1 s")
    settled_s: float = tunable(
        0.04, unit="s", low=0.005, high=0.2, source="choice: a pulse is over when so long below tyre_mps2"
    )
    told_settled_s: float = tunable(
        0.06, unit="s", low=0.005, high=0.3, source="choice: once told, the end of its flank is waited for"
    )
    tell_s: float = tunable(
        0.085, unit="s", low=0.03, high=0.5, source="choice: suspected within 150 ms of contact, onset included"
    )
    decide_s: float = tunable(
        0.3, unit="s", low=0.1, high=0.6, source="49 CFR 563.7, table I: the maximum change is looked for within 300 ms"
    )
    slow_decide_s: float = tunable(
        0.1, unit="s", low=0.0, high=0.5, source="choice: time left to a slow pulse that is suspected after decide_s"
    )
    shock_mps2: float = tunable(
        10.0, unit="m/s2", low=5.0, high=100.0, source="choice: twice the median of 500 recorded potholes and bumps"
    )
    shock_apart_s: float = tunable(
        0.08, unit="s", low=0.02, high=0.5, source="choice: two axles over one edge at 100 km/h are so far apart"
    )
    shock_quiet_s: float = tunable(
        0.5, unit="s", low=0.1, high=2.0, source="choice: a car's suspension comes to rest within a period"
    )
    shock_longest_s: float = tunable(
        2.0, unit="s", low=0.5, high=2.4, source="choice: as long as rows are kept, less what precedes"
    )
    hard_mps2: float = tunable(
        6.5, unit="m/s2", low=3.0, high=15.0, source="choice, 0.66 g: emergency braking starts at 6 to 7 m/s2"
    )
    hard_s: float = tunable(0.5, unit="s", low=0.1, high=3.0, source="choice: longer than any shock")
    fall_mps2: float = tunable(
        3.0, unit="m/s2", low=0.5, high=6.0, source="choice: a falling box feels nothing, a car over a crest over 5"
    )
    fall_s: float = tunable(0.08, unit="s", low=0.02, high=0.5, source="choice: a fall of 3 cm")
    fell_before_s: float = tunable(
        0.6, unit="s", low=0.1, high=2.0, source="choice: a shock so soon after ends a fall, of up to a metre"
    )
    lean_parked_s: float = tunable(
        60.0, unit="s", low=5.0, high=3600.0, source="choice: whoever loads a vehicle first lets it stand"
    )
    lean_deg: float = tunable(3.0, unit="deg", low=0.5, high=20.0, source="choice: passengers lean a car by 1 deg")
    lean_quiet_s: float = tunable(
        20.0, unit="s", low=5.0, high=300.0, source="choice: longer than a ship rolls (7 to 14 s)"
    )
    lean_longest_s: float = tunable(120.0, unit="s", low=20.0, high=3600.0, source="choice: told while it goes on")
    tilt_deg: float = tunable(60.0, unit="deg", low=30.0, high=120.0, source="Digital Matter: rollover from 60 degrees")
    tilt_s: float = tunable(0.5, unit="s", low=0.1, high=5.0, source="choice: longer than attitude errs by a shock")


@dataclass(frozen=True, slots=True)
class PulseThresholds(Tunables):
    """How a pulse is read off the samples, and how far its figures may err."""

    onset_mps2: float = tunable(
        2.0, unit="m/s2", low=0.2, high=10.0, source="choice: what braking and road leave on a pulse's direction"
    )
    onset_s: float = tunable(
        0.06, unit="s", low=0.0, high=0.2, source="choice: flanks within reach of a pulse of 60-200 ms, at most"
    )
    tail_s: float = tunable(
        0.15, unit="s", low=0.0, high=0.5, source="choice: the falling flank of a pulse of 0.35 s within tyres' reach"
    )
    plateau_mps2: float = tunable(
        0.5, unit="m/s2", low=0.0, high=10.0, source="choice: what falls by less within 25 ms is no flank but brakes"
    )
    friction_mps2: float = tunable(
        8.0, unit="m/s2", low=2.0, high=12.0, source="choice, 0.8 g: braked wheels take back what pushed a standing car"
    )
    around_s: float = tunable(
        0.1, unit="s", low=0.0, high=0.5, source="choice: a wheel's vertical blow and its blow to the rear are so near"
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
    yaw_sd_rad: float = tunable(
        0.05, unit="rad", low=0.001, high=0.5, source="choice, 3 deg: yaw of the box in the vehicle"
    )
    spin_radps: float = tunable(
        1.5, unit="rad/s", low=0.3, high=10.0, source="choice, 86 deg/s: faster than a car is steered around a corner"
    )
    arm_m: float = tunable(
        1.3,
        unit="m",
        low=0.0,
        high=5.0,
        source="choice: a box behind the windscreen from what a spinning car turns about",
    )
    noise_sd_mps: float = tunable(
        0.1, unit="m/s", low=0.001, high=2.0, source="choice: road and body vibration on an integrated pulse"
    )


@dataclass(frozen=True, slots=True)
class RolloverThresholds(Tunables):
    """What lies on its side: a vehicle that rolled over, or a box that came off. Odds are log-odds of an accident."""

    odds: float = tunable(
        2.0, unit="1", low=-20.0, high=20.0, source="choice: a vehicle that lies on its side after it moved"
    )
    loose_odds: float = tunable(
        -4.0,
        unit="1",
        low=-20.0,
        high=20.0,
        source="choice: where it had stood, or the box fell or spun as no car does",
    )
    before_s: float = tunable(
        1.0, unit="s", low=0.2, high=5.0, source="choice: what a car did within it before it lay tipped it over"
    )
    fell_before_s: float = tunable(
        1.5, unit="s", low=0.1, high=5.0, source="choice: a box that fell tumbles on before it lies"
    )
    tumbles_radps: float = tunable(
        2.0,
        unit="rad/s",
        low=0.2,
        high=10.0,
        source="choice, 115 deg/s: cars roll over about their long axis; what turns so fast rather across it is a box",
    )
    tipped_s: float = tunable(
        1.5,
        unit="s",
        low=0.2,
        high=5.0,
        source="choice: from half of tilt_deg to it at 20 deg/s, slower than any rollover",
    )
    topples_radps: float = tunable(
        1.0, unit="rad/s", low=0.1, high=10.0, source="choice: 80 degrees within a second or so, of what has one track"
    )
    tracks: int = tunable(
        2, unit="1", low=1, high=2, source="what stands on one track falls over where it stands; a car's box comes off"
    )


@dataclass(frozen=True, slots=True)
class AftermathThresholds(Tunables):
    """What is watched after an accident was told, and for how long."""

    follow_s: float = tunable(
        10.0, unit="s", low=1.0, high=60.0, source="choice: cars at 50 km/h have come to rest by then, drivers too"
    )
    rest_s: float = tunable(3.0, unit="s", low=0.5, high=30.0, source="choice: standing for good, not turning round")
    moving_mps: float = tunable(
        1.0, unit="m/s", low=0.2, high=5.0, source="choice: that who stood before stands after says nothing"
    )
    off_road_mps2: float = tunable(
        4.0, unit="m/s2", low=1.0, high=20.0, source="choice: rms beyond cobbles and gravel, ISO 8608 classes E and F"
    )
    drove_on_share: float = tunable(
        0.8, unit="1", low=0.3, high=1.0, source="choice: never slower than so much of the speed before"
    )
    drove_on_mps: float = tunable(
        5.0, unit="m/s", low=1.0, high=20.0, source="choice: below, rest and driving look alike"
    )
    grouping_s: float = tunable(
        5.0, unit="s", low=0.5, high=60.0, source="49 CFR 563.5: events within 5 s are one accident's"
    )
    bias_s: float = tunable(
        2.0,
        unit="s",
        low=0.5,
        high=2.4,
        source="choice: rest over which an accelerometer's error is read",
    )
    rest_error_mps2: float = tunable(
        0.08,
        unit="m/s2",
        low=0.005,
        high=0.5,
        source="simulated: what is left of it in motion; spinning cars turn it",
    )
    error_mps2: float = tunable(
        0.12,
        unit="m/s2",
        low=0.01,
        high=1.0,
        source="simulated: bias and 0.25 deg of tilt, where no rest tells",
    )
    speed_sd_mps: float = tunable(
        0.15,
        unit="m/s",
        low=0.01,
        high=2.0,
        source="measured (bench --accidents --part errors): RMS 0.07, doubled",
    )
    rolling_mps: float = tunable(
        2.0, unit="m/s", low=0.5, high=10.0, source="choice: slower, a car may as well be pushed backwards"
    )
    sliding_s: float = tunable(
        1.0, unit="s", low=0.1, high=5.0, source="choice: tyres at 0.7 g take back a side-slip of 7 m/s"
    )
    sliding_radps: float = tunable(
        0.35, unit="rad/s", low=0.05, high=3.0, source="choice, 20 deg/s: who turns faster after a blow spins"
    )
    recovery_s: float = tunable(
        1.0, unit="s", low=0.1, high=30.0, source="choice: fixes a second apart take back what clipping hid"
    )
    outside_mps2: float = tunable(
        20.0, unit="m/s2", low=1.0, high=500.0, source="choice: 2 g, where boxes clip that do"
    )
    contradiction: float = tunable(
        6.0, unit="1", low=2.0, high=100.0, source="chi-square of 2 at 1 in 20: beyond, assumed shapes were wrong"
    )
    refuted: float = tunable(
        25.0, unit="1", low=6.0, high=1000.0, source="simulated: 8.5 at most in crashes; beyond, the filter is lost"
    )
    read_share: float = tunable(
        0.8, unit="1", low=0.0, high=1.0, source="choice: clipping only hides; less than was read is no measurement"
    )
    parked_s: float = tunable(
        180.0, unit="s", low=10.0, high=3600.0, source="choice: longer than traffic lights and most queues stand"
    )


@dataclass(frozen=True, slots=True)
class DetectorThresholds(Tunables):
    """The project's own detector: trigger, reading, judgement, what followed, and names for what was none."""

    trigger: TriggerThresholds = TriggerThresholds()
    pulse: PulseThresholds = PulseThresholds()
    judgement: JudgementThresholds = JudgementThresholds()
    rollover: RolloverThresholds = RolloverThresholds()
    aftermath: AftermathThresholds = AftermathThresholds()
    naming: NamingThresholds = NamingThresholds()
    level: LevelThresholds = LevelThresholds()
    severity: SeverityThresholds = SeverityThresholds()
    paper: PaperThresholds = PaperThresholds()
