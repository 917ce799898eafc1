"""Noises, gates and schedules of the filter, once, with unit, range and source."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Final

import numpy as np

from core.measurements import FloatArray
from core.tunables import Tunables, tunable

_CHOICE: Final = "choice; checked on kth_stockholm, comma2k19_segment and boston_vn100"


@dataclass(frozen=True, slots=True)
class Tuning(Tunables):
    """Tunables of navigation. Sd is one sigma; noise densities are per root second."""

    gyro_noise_radps_rts: float = tunable(
        5.0e-4,
        unit="rad/s/sqrt(Hz)",
        low=1e-7,
        high=0.1,
        source="L3GD20 0.03 deg/s/sqrt(Hz) = 5.2e-4; " + _CHOICE,
    )
    accel_noise_mps2_rts: float = tunable(
        1.0e-2,
        unit="m/s2/sqrt(Hz)",
        low=1e-6,
        high=1.0,
        source="LSM303DLHC 220 ug/sqrt(Hz) = 2.2e-3, raised for vibration: " + _CHOICE,
    )
    gyro_bias_walk_radps2_rts: float = tunable(5.0e-6, unit="rad/s/sqrt(s)", low=0, high=1e-2, source=_CHOICE)
    accel_bias_walk_mps3_rts: float = tunable(2.0e-4, unit="m/s2/sqrt(s)", low=0, high=1e-1, source=_CHOICE)
    gyro_bias_radps_per_k: float = tunable(
        5.2e-4, unit="rad/s/K", low=0, high=1e-2, source="L3GD20 data sheet: zero rate by 0.03 deg/s/K at 250 deg/s"
    )
    accel_bias_mps2_per_k: float = tunable(
        4.9e-3, unit="m/s2/K", low=0, high=0.1, source="LSM303DLHC data sheet: zero g by 0.5 mg/K"
    )
    warming_s: float = tunable(
        60.0, unit="s", low=1, high=3600, source="choice: the longest outage that a bias drifts one way in"
    )
    warming_seen_s: float = tunable(
        20.0, unit="s", low=1, high=600, source="choice: 10 to 40 s tell as soon, and as surely, in simulated boxes"
    )
    gate_warming: float = tunable(
        16.0,
        unit="1",
        low=1,
        high=1e6,
        source="choice: 4 sd; boxes at one temperature reach 3.6 sd in recorded drives, 1.7 in simulated ones",
    )
    warming_least_kps: float = tunable(
        0.05, unit="K/s", low=0, high=10, source="choice: 15 K in 5 min; corrections lag behind a drift just found"
    )
    warming_fades_s: float = tunable(
        180.0, unit="s", low=1, high=36000, source="choice: a box takes minutes to warm up, some 300 s"
    )
    gyro_bias_sd_radps: float = tunable(
        1.0e-2, unit="rad/s", low=1e-7, high=1.0, source="turn-on bias of a consumer gyroscope about 0.5 deg/s"
    )
    accel_bias_sd_mps2: float = tunable(
        0.15, unit="m/s2", low=1e-6, high=5.0, source="turn-on bias 15 mg after calibration"
    )
    gyro_scale_sd: float = tunable(
        0.01, unit="1", low=0, high=0.1, source="sensitivity of consumer gyroscopes 1-3 %, after calibration below 1 %"
    )
    gyro_axes_sd_rad: float = tunable(
        0.01, unit="rad", low=0, high=0.1, source="axes of a bad box off square by 0.6 deg: soldering and die, 0.8 deg"
    )
    gyro_axes_fading_s: float = tunable(
        30.0, unit="s", low=1, high=600, source="choice: after so long fixes have put the tilt of a turn right"
    )
    speed_scale_sd: float = tunable(0.03, unit="1", low=1e-6, high=0.3, source="tyre wear and pressure 2-3 %")
    speed_scale_walk_rts: float = tunable(1.0e-5, unit="1/sqrt(s)", low=0, high=1e-2, source=_CHOICE)
    mount_angle_sd_rad: float = tunable(0.09, unit="rad", low=1e-5, high=0.5, source="box fitted by eye within 5 deg")
    mount_angle_walk_rad_rts: float = tunable(1.0e-5, unit="rad/sqrt(s)", low=0, high=1e-2, source=_CHOICE)

    gnss_sd_h_m: float = tunable(
        2.1, unit="m", low=0.01, high=100, source="u-blox 7 data sheet: CEP 2.5 m, that is 2.1 m an axis"
    )
    gnss_uere_m: float = tunable(
        1.5,
        unit="m",
        low=0.1,
        high=30,
        source="per axis and unit of HDOP; u-blox 7 data sheet: CEP 2.5 m, 2.1 m an axis, at a HDOP of 1.4; by the "
        "likelihood of their innovations kth_stockholm and boston_vn100 have 1.0",
    )
    gnss_height_factor: float = tunable(
        1.5,
        unit="1",
        low=1,
        high=5,
        source="vertical against horizontal by the sky's geometry where no VDOP says it; and beside it by the air's "
        "delay, which all satellites share: by the likelihood of its heights kth_stockholm has 1.0-1.3",
    )
    gnss_correlation_s: float = tunable(
        60.0,
        unit="s",
        low=1,
        high=3600,
        source="multipath 10 s, ionosphere 600 s; of 30, 60 and 120 the likeliest of kth_stockholm and boston_vn100 at "
        "their likeliest UERE, 1.0 m",
    )
    gnss_drift_s: float = tunable(
        5.0,
        unit="s",
        low=0.5,
        high=60,
        source="choice: over so long fixes are compared; the path is good to 0.2 m in it, by velocity or wheels",
    )
    gnss_drift_learn: float = tunable(
        30, unit="1", low=2, high=1e4, source="choice: the drift is then known to 18 %, of two axes, after 150 s"
    )
    gnss_drift_change: float = tunable(
        6.0, unit="1", low=2, high=100, source="over what is believed at most: 3e-3 by chance, as between houses"
    )
    gnss_worse_margin: float = tunable(
        1.3,
        unit="1",
        low=1,
        high=10,
        source="choice: fixes as good as stated are taken to be; 1.5 does less in streets",
    )
    gnss_worse_gain: float = tunable(
        0.1, unit="1", low=0, high=1, source="choice: a street lasts a minute; 0.15 recovers later from a clock's step"
    )
    gnss_worse_most: float = tunable(
        6.0, unit="1", low=1, high=100, source="choice: sd 2.4 times those stated; beyond, a receiver is wrong"
    )
    gnss_white_share: float = tunable(
        0.8, unit="1", low=0, high=4, source="choice: before fixes tell; most of a stated variance is new each time"
    )
    gnss_learn_fixes: float = tunable(
        60, unit="1", low=5, high=1e4, source="choice: the white share is then known to 13 %, of two axes"
    )
    gnss_share_margin: float = tunable(
        0.15, unit="1", low=0, high=1, source="the spread of the learnt share, so that white fixes stay white"
    )
    gnss_white_floor: float = tunable(
        0.02, unit="1", low=1e-3, high=1, source="code noise of a smoothed fix is at least a seventh of its error"
    )
    gnss_delay_sd_s: float = tunable(
        0.1,
        unit="s",
        low=0,
        high=1,
        source="time stamps by the host: NMEA lines come 0.1-0.5 s late; boston_vn100 0.54 s",
    )
    gnss_delay_given_sd_s: float = tunable(
        0.01, unit="s", low=0, high=1, source="choice: an offset that was measured and is set"
    )
    gnss_sd_v_mps: float = tunable(
        0.15, unit="m/s", low=0.01, high=10, source="u-blox 7 data sheet 0.1 m/s, raised for city streets"
    )
    gnss_sd_floor_m: float = tunable(
        0.3, unit="m", low=0.001, high=10, source="a receiver's stated accuracy below this is optimistic in a car"
    )
    gnss_sd_v_floor_mps: float = tunable(0.05, unit="m/s", low=0.001, high=10, source="as above, for velocity")
    gnss_min_satellites: float = tunable(4, unit="1", low=0, high=20, source="a position needs four; seed 3")
    gnss_max_age_s: float = tunable(
        1.0, unit="s", low=0.01, high=10, source="a fix older than the newest sample by more cannot be compared"
    )

    late_s: float = tunable(
        2.0, unit="s", low=0, high=2.5, source="receivers and buses deliver a fix within two seconds"
    )

    gate_position: float = tunable(13.82, unit="1", low=4, high=1e4, source="chi-squared, 2 degrees of freedom, 99.9 %")
    gate_scalar: float = tunable(10.83, unit="1", low=2, high=1e4, source="chi-squared, 1 degree of freedom, 99.9 %")
    gate_velocity: float = tunable(13.82, unit="1", low=4, high=1e4, source="chi-squared, 2 degrees of freedom, 99.9 %")
    recovery_s: float = tunable(
        5.0, unit="s", low=1, high=60, source="recovery within 10 s of good fixes, with time to see that they agree"
    )
    recovery_fixes: float = tunable(4, unit="1", low=2, high=50, source=_CHOICE)
    recovery_agreement_m: float = tunable(
        5.0,
        unit="m",
        low=0.5,
        high=100,
        source="two refused fixes agree if their innovations differ by less, plus 3 sd",
    )
    recovery_attitude_sd_rad: float = tunable(0.1, unit="rad", low=0, high=1, source=_CHOICE)
    resets_until_lost: float = tunable(
        3, unit="1", low=1, high=100, source="resets with no fix accepted between: heading is wrong, align anew"
    )
    refused_until_lost_s: float = tunable(
        15.0,
        unit="s",
        low=2,
        high=600,
        source="choice: three times recovery_s; with a wrong heading the refused fixes run away and never agree",
    )

    nhc_sd_mps: float = tunable(
        0.12, unit="m/s", low=0.01, high=5, source="lateral slip and suspension of a car; " + _CHOICE
    )
    nhc_lever_m: float = tunable(
        1.5, unit="m", low=0, high=10, source="box to rear axle when unknown: lateral speed is yaw rate times this"
    )
    heave_radps: float = tunable(
        8.0, unit="rad/s", low=1, high=50, source="body on its springs at 1.3 Hz: speed is acceleration over this"
    )
    squat_rad_per_mps2: float = tunable(
        0.004, unit="rad s2/m", low=0, high=0.05, source="measured: 2.4, 3.0 and 1.4 deg/g on kth, boston and comma2k19"
    )
    squat_sd_rad_per_mps2: float = tunable(
        0.002, unit="rad s2/m", low=0, high=0.05, source="spread of it over those cars; none at all is at 2 sd"
    )
    squat_share: float = tunable(
        0.1, unit="1", low=0, high=1, source="of each constraint's weight to learn by: at 5 Hz ten see one acceleration"
    )
    nhc_min_speed_mps: float = tunable(1.0, unit="m/s", low=0, high=10, source=_CHOICE)
    constraint_interval_s: float = tunable(0.2, unit="s", low=0.05, high=5, source="5 Hz, as the design measured")
    speed_sd_mps: float = tunable(0.25, unit="m/s", low=0.01, high=5, source="quantised speedometer; " + _CHOICE)
    reverse_log_odds: float = tunable(
        4.0, unit="1", low=0, high=20, source="choice: logarithm of 50, a car goes backwards 2 % of its time"
    )
    speed_interval_s: float = tunable(0.18, unit="s", low=0, high=5, source="faster samples carry the same errors")

    magnetic_sd_rad: float = tunable(
        0.35, unit="rad", low=0.01, high=1.5, source="20 deg: iron of the car and declination not corrected"
    )
    magnetic_correlation_s: float = tunable(
        120.0, unit="s", low=0, high=3600, source="choice: the car's iron errs the same way until it has turned"
    )
    magnetic_interval_s: float = tunable(1.0, unit="s", low=0.01, high=60, source="faster samples say the same")
    baro_sd_m: float = tunable(
        1.0, unit="m", low=0.05, high=20, source="fan, windows and the wind of driving: 10 Pa are 0.85 m"
    )
    baro_bias_sd_m: float = tunable(
        150.0, unit="m", low=1, high=1000, source="weather within 20 hPa of standard, 170 m; geoid within 100 m"
    )
    baro_bias_walk_m_rts: float = tunable(
        0.08, unit="m/sqrt(s)", low=0, high=1, source="weather, and the wind of driving: 2.5 m at 30 m/s"
    )
    baro_interval_s: float = tunable(1.0, unit="s", low=0.01, high=60, source="faster samples carry the same errors")

    zupt_sd_mps: float = tunable(0.03, unit="m/s", low=1e-3, high=1, source="rocking of a standing car")
    zaru_sd_radps: float = tunable(
        2.0e-3, unit="rad/s", low=1e-6, high=0.1, source="rocking of a standing car over 0.1 s; " + _CHOICE
    )
    still_accel_sd_mps2: float = tunable(
        0.08,
        unit="m/s2",
        low=1e-3,
        high=2,
        source="sd of ten means by hats of 0.2 s: standing 0.01-0.06, driving above 0.11 on the three drives",
    )
    still_gyro_sd_radps: float = tunable(
        5.0e-3,
        unit="rad/s",
        low=1e-5,
        high=0.2,
        source="sd of ten means by hats of 0.2 s: standing 0.0005-0.003, driving above 0.005 on the three drives",
    )
    still_mean_accel_mps2: float = tunable(
        0.2, unit="m/s2", low=0.01, high=2, source="beyond tilt error: a car pulls away with 0.5 m/s2 and more"
    )
    still_mean_gyro_radps: float = tunable(
        0.01, unit="rad/s", low=1e-4, high=0.2, source="beyond bias error: drift, rocking and the Earth's rate, 7e-5"
    )
    still_factor: float = tunable(
        2.0,
        unit="1",
        low=1,
        high=10,
        source="choice: over the level learnt when standing; rolling at 4 m/s on a smooth road is three times it",
    )
    still_leaving: float = tunable(
        3.0,
        unit="1",
        low=1,
        high=100,
        source="newest of ten means off their mean, over the level learnt when standing: 1e-5 by chance",
    )
    still_patience_s: float = tunable(
        2.0,
        unit="s",
        low=0,
        high=60,
        source="choice: a creep at 0.5 m/s lasts 2-3 s; quiet needed a unit of squared speed over its variance",
    )
    still_rolling_mps: float = tunable(
        1.0, unit="m/s", low=0, high=30, source="choice: a creep is slower, and what rolls faster is not so quiet"
    )
    still_longest_patience_s: float = tunable(
        4.0,
        unit="s",
        low=0,
        high=1e4,
        source="choice: creeps last 2-3 s, traffic lights longer; 2 s do alike in simulated outages",
    )
    still_max_speed_mps: float = tunable(
        0.5, unit="m/s", low=0.1, high=10, source="a smooth road at speed is no standstill"
    )

    covariance_interval_s: float = tunable(
        0.1, unit="s", low=0.005, high=1, source="10 Hz costs at most 3 mm against 200 Hz (design)"
    )
    output_interval_s: float = tunable(0.1, unit="s", low=0, high=60, source="track rows at 10 Hz; 0 for every sample")
    bridge_s: float = tunable(
        0.05, unit="s", low=0.001, high=1, source="a longer step between samples is bridged and paid for in variance"
    )
    bridge_accel_sd_mps2: float = tunable(1.5, unit="m/s2", low=0, high=20, source="what a car does unseen")
    bridge_tilt_sd_radps: float = tunable(
        0.03, unit="rad/s", low=0, high=5, source="roll and pitch rate of a car between two samples that are far apart"
    )
    bridge_yaw_sd_radps: float = tunable(
        0.1,
        unit="rad/s",
        low=0,
        high=5,
        source="a turn begun or ended unseen: lateral 2 m/s2 at 10 m/s, half of it interpolated",
    )
    held_rate_sd_radps: float = tunable(
        0.2, unit="rad/s", low=0, high=5, source="a turn that a hanging gyroscope misses: 2 m/s2 to the side at 10 m/s"
    )
    max_gap_s: float = tunable(5.0, unit="s", low=0.1, high=600, source="after a longer gap the filter aligns anew")
    saturated_accel_sd_mps2: float = tunable(
        50.0, unit="m/s2", low=0, high=1000, source="half of a 10 g pulse is beyond 2 g; 49 CFR 563 pulses"
    )
    coasting_after_s: float = tunable(2.5, unit="s", low=0.1, high=60, source="two missed fixes at 1 Hz")

    align_still_s: float = tunable(
        2.0, unit="s", low=1, high=60, source="averages noise of the accelerometers below 1 mg"
    )
    align_moving_s: float = tunable(5.0, unit="s", low=2, high=60, source=_CHOICE)
    align_gravity_mps2: float = tunable(
        1.5,
        unit="m/s2",
        low=0.1,
        high=5,
        source="mean specific force against gravity; uncalibrated LSM303DLHC: 60 mg of bias and 4 % of scale, 1 m/s2",
    )
    align_min_speed_mps: float = tunable(
        2.5, unit="m/s", low=0.5, high=20, source="GNSS course good to some 5 deg with 0.2 m/s"
    )
    align_max_yaw_sd_rad: float = tunable(
        0.15, unit="rad", low=0.01, high=0.5, source="the error model is linear to some 10 deg"
    )
    align_magnetic_sd_rad: float = tunable(
        0.35, unit="rad", low=0.02, high=1.5, source="20 deg: iron of the car and declination not corrected"
    )
    align_tilt_still_sd_rad: float = tunable(0.02, unit="rad", low=1e-4, high=0.5, source="bias of 20 mg")
    align_tilt_moving_sd_rad: float = tunable(
        0.05, unit="rad", low=1e-3, high=0.5, source="accelerations known to 0.5 m/s2"
    )
    align_tilt_unsure_sd_rad: float = tunable(
        0.12, unit="rad", low=1e-3, high=0.5, source="accelerations from positions alone, or unknown: 1.2 m/s2"
    )
    align_gyro_bias_moving_sd_radps: float = tunable(
        0.02, unit="rad/s", low=1e-5, high=1, source="course over five seconds good to 5 deg"
    )

    def as_array(self) -> FloatArray:
        """All values in the order of the fields, for compiled code."""
        return np.array([float(getattr(self, f.name)) for f in fields(self)])


PARAMETER: Final = {f.name: i for i, f in enumerate(fields(Tuning))}
"""Index of each tunable in ``Tuning.as_array()``."""
