"""What speaks how much for an accident or against it: the judgement's weights, limits and odds."""

from __future__ import annotations

from dataclasses import dataclass

from core.tunables import Tunables, tunable


@dataclass(frozen=True, slots=True)
class JudgementThresholds(Tunables):
    """From what a pulse was like to the probability that it was an accident: weights of log-odds."""

    tell: float = tunable(
        0.5, unit="1", low=0.05, high=0.99, source="choice: told when an accident is likelier than not"
    )
    tell_early: float = tunable(
        0.85, unit="1", low=0.5, high=0.999, source="choice: what is not over yet is told only where it is plain"
    )
    tell_late: float = tunable(
        0.7, unit="1", low=0.5, high=0.999, source="choice: the same from late_s on, where it may be braking"
    )
    late_s: float = tunable(
        0.1, unit="s", low=0.05, high=0.3, source="choice: from a pulse's start on, as 150 ms are nearly over"
    )
    braking_aside: float = tunable(
        0.25,
        unit="1",
        low=0.0,
        high=1.0,
        source="simulated: emergency braking pushes aside by 0.15 of it and less; steering builds up slower than blows",
    )
    retract: float = tunable(
        0.3, unit="1", low=0.0, high=0.9, source="choice: below tell, so that what is told does not flicker"
    )
    base: float = tunable(
        0.5,
        unit="1",
        low=-20.0,
        high=20.0,
        source="fitted to simulated cases, less 1.4: accidents are rarer than there",
    )
    told_slope: float = tunable(
        1.75, unit="1", low=0.1, high=10.0, source="fitted to the corpus' accidents and 25 000 km of long drives"
    )
    told_shift: float = tunable(
        0.0,
        unit="1",
        low=-10.0,
        high=10.0,
        source="choice: none is needed; bench --accidents --part reliability fits one",
    )
    beyond_mps: float = tunable(
        0.8, unit="m/s", low=0.05, high=5.0, source="choice: where the logarithm of the change beyond reach is zero"
    )
    beyond: float = tunable(7.7, unit="1", low=0.0, high=50.0, source="fitted to simulated cases")
    vertical_from: float = tunable(
        0.6, unit="1", low=0.0, high=5.0, source="choice: crashes heave and pitch a car less"
    )
    vertical: float = tunable(7.7, unit="1", low=0.0, high=50.0, source="fitted to simulated cases")
    lifted_from: float = tunable(
        0.7,
        unit="1",
        low=0.0,
        high=5.0,
        source="simulated: 0.7 rad/s and m/s a m/s and less in 99 % of crashes, more where wheels or hands lift a box",
    )
    lifted: float = tunable(14.0, unit="1", low=0.0, high=50.0, source="fitted to simulated cases")
    retained_from: float = tunable(0.75, unit="1", low=0.0, high=1.0, source="choice: rebound takes back a quarter")
    retained: float = tunable(
        9.0, unit="1", low=0.0, high=50.0, source="choice: simulated cases hardly tell, recorded shocks swing back"
    )
    short_s: float = tunable(
        0.08, unit="s", low=0.01, high=0.2, source="choice: weak crash pulses of cars last longer, see clipping.py"
    )
    short: float = tunable(10.0, unit="1", low=0.0, high=50.0, source="fitted to simulated cases (13)")
    long_s: float = tunable(
        0.15, unit="s", low=0.05, high=1.0, source="choice: longer than most crash pulses, and than a foot takes"
    )
    long: float = tunable(
        5.0, unit="1", low=0.0, high=50.0, source="fitted to simulated cases (3.4); more, for brakes on rough roads"
    )
    rotation_radps: float = tunable(
        7.0,
        unit="rad/s",
        low=1.0,
        high=50.0,
        source="choice: 400 deg/s, faster than cars spin or roll; a loose box does",
    )
    rotation: float = tunable(3.0, unit="1", low=0.0, high=50.0, source="choice, to be fitted")
    abrupt_share: float = tunable(
        0.12, unit="1", low=0.0, high=0.5, source="choice: bodies swell and ring; converters fail within a sample"
    )
    abrupt_radps: float = tunable(
        0.15, unit="rad/s", low=0.0, high=2.0, source="choice: blows turn a car, if only by its springs"
    )
    most_mps: float = tunable(
        50.0, unit="m/s", low=20.0, high=500.0, source="choice, 180 km/h: no car's crash changes its velocity by more"
    )
    glitch_s: float = tunable(
        0.05, unit="s", low=0.0, high=0.2, source="choice: stiff crashes last longer, also where no gyroscope tells"
    )
    sharp_share: float = tunable(
        0.08, unit="1", low=0.0, high=0.5, source="simulated: no crash behind a low-pass falls below 0.19"
    )
    sharp_radps: float = tunable(
        0.5, unit="rad/s", low=0.0, high=5.0, source="choice: rough roads turn a car by less meanwhile"
    )
    sound_share: float = tunable(
        0.3, unit="1", low=0.0, high=1.0, source="simulated: 0.38 and more of crashes, next to nothing of spikes"
    )
    unturned_radps: float = tunable(
        0.05,
        unit="rad/s",
        low=0.0,
        high=1.0,
        source="choice: the least that a weak blow turned a simulated car was 0.1",
    )
    unturned_mps: float = tunable(
        3.0, unit="m/s", low=0.5, high=20.0, source="choice: harder ones are told all the same"
    )
    crawl_mps: float = tunable(
        1.5, unit="m/s", low=0.3, high=3.0, source="choice: slower than walking; kerb stones stop who parks"
    )
    crawl_share: float = tunable(
        1.4, unit="1", low=1.0, high=3.0, source="choice: stopping takes the speed, rolling back a third of it more"
    )
    crawl_sds: float = tunable(
        2.0, unit="1", low=0.0, high=5.0, source="choice: of the speed's own error, one case in 40"
    )
    crawl_aside: float = tunable(
        0.75, unit="1", low=0.0, high=1.0, source="choice: a kerb stone stops a car along its way, within 49 deg"
    )
    speed_sd_mps: float = tunable(
        0.1, unit="m/s", low=0.0, high=2.0, source="measured (bench --accidents --part errors): RMS 0.07 m/s"
    )
    crawl: float = tunable(
        4.0, unit="1", low=0.0, high=20.0, source="choice: kerb stones are met far oftener than cars"
    )
    stuck_s: float = tunable(
        0.2, unit="s", low=0.05, high=1.0, source="choice: crash pulses at 2 g last 0.12 s; an axis that hangs goes on"
    )
    impossible: float = tunable(
        -7.0, unit="1", low=-50.0, high=0.0, source="choice, 1 in 1000: a failing converter, or a box that falls freely"
    )
    rested: float = tunable(1.5, unit="1", low=0.0, high=20.0, source="choice: most who crash come to rest")
    drove_on: float = tunable(2.5, unit="1", low=0.0, high=20.0, source="choice: few who crash drive on as before")
    rolled_on: float = tunable(
        4.0, unit="1", low=0.0, high=20.0, source="choice: who rolls over comes to rest within ten seconds or so"
    )
    airbag: float = tunable(
        2.0,
        unit="1",
        low=0.0,
        high=20.0,
        source="choice: most flags of an airbag are right, though nothing was felt; a bus errs at times",
    )
    flagged: float = tunable(6.0, unit="1", low=0.0, high=20.0, source="choice: an airbag that fired, or power lost")
