"""The filter's noises from what is stated of a box's sensors, and what a moving car adds to it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

from core.navigation.tuning import Tuning
from core.sensors import ALLAN_FLOOR, TriadNoise
from core.tunables import Tunables, tunable


@dataclass(frozen=True, slots=True)
class NoiseAllowance(Tunables):
    """What is added, as variances, to noise that was measured at rest and at one temperature.

    Vibration is mostly true motion, which the sensor tells truly; what of it becomes noise is aliased or rectified.
    How much that is cannot be seen in the samples: within 0.1 s the accelerometers spread by 0.17 m/s2 on
    kth_stockholm, 0.40 on comma2k19_segment, 0.04 on boston_vn100 and 0.14 in a simulated drive where it is all
    harmless. So it is a constant, not measured on the way. The biases' walk and spread take up temperature, and
    scale and alignment errors, whose effect in a turn or on gravity looks like a bias.
    """

    stated_factor: float = tunable(
        1.2, unit="1", low=1, high=10, source="choice: one unit at rest stands for its kind at all temperatures"
    )
    gyro_noise_radps_rts: float = tunable(
        5.0e-5,
        unit="rad/s/sqrt(Hz)",
        low=0,
        high=0.01,
        source="choice: 1e-4 to 1e-3 in all do alike on kth_stockholm and boston_vn100",
    )
    accel_noise_mps2_rts: float = tunable(
        5.0e-3,
        unit="m/s2/sqrt(Hz)",
        low=0,
        high=0.1,
        source="choice: 2e-3 to 2e-2 do alike on kth_stockholm and boston_vn100, and in simulated outages",
    )
    gyro_bias_walk_radps2_rts: float = tunable(
        5.0e-7,
        unit="rad/s/sqrt(s)",
        low=0,
        high=1e-2,
        source="choice: 1 deg/h in a minute, beside what the stated instability gives",
    )
    accel_bias_walk_mps3_rts: float = tunable(
        5.0e-5,
        unit="m/s2/sqrt(s)",
        low=0,
        high=1e-1,
        source="choice: 5e-5 to 2e-4 do alike on real drives; in simulated outages less is better",
    )
    gyro_bias_sd_radps: float = tunable(
        5.0e-3, unit="rad/s", low=0, high=0.5, source="choice: half of an uncalibrated one's, for temperature"
    )
    accel_bias_sd_mps2: float = tunable(
        0.15,
        unit="m/s2",
        low=0,
        high=2,
        source="as Tuning.accel_bias_sd_mps2: 1.5 % of scale on gravity; with 0.04 boston_vn100 goes astray",
    )
    instability_s: float = tunable(
        60.0, unit="s", low=1, high=1e4, source="choice: the longest outage that the walk is to be right for"
    )


NOTHING_ADDED: Final = NoiseAllowance(
    stated_factor=1.0,
    gyro_noise_radps_rts=0.0,
    accel_noise_mps2_rts=0.0,
    gyro_bias_walk_radps2_rts=0.0,
    accel_bias_walk_mps3_rts=0.0,
    gyro_bias_sd_radps=0.0,
    accel_bias_sd_mps2=0.0,
)
"""For sensors that are in the car what was stated of them, as simulated ones can be."""


def matched_tuning(
    tuning: Tuning,
    accelerometer: TriadNoise,
    gyroscope: TriadNoise,
    allowance: NoiseAllowance | None = None,
) -> Tuning:
    """``tuning`` with the noises of these sensors in a moving car; what is not stated stays.

    White noise N becomes hypot(factor N, allowance). The bias' walk is the larger of the rate random walk K and
    of the walk with the same Allan variance as the flicker B after T = ``instability_s``, K_B^2 T / 3 = (0.664 B)^2;
    a recording too short to show a K reports none or a small one.

    Raises
    ------
    InvalidInputError
        If a figure is beyond what ``Tuning`` allows.
    """
    a = NoiseAllowance() if allowance is None else allowance
    changes = {
        "gyro_noise_radps_rts": _beside(gyroscope.random_walk, a.stated_factor, a.gyro_noise_radps_rts),
        "accel_noise_mps2_rts": _beside(accelerometer.random_walk, a.stated_factor, a.accel_noise_mps2_rts),
        "gyro_bias_walk_radps2_rts": _beside(_bias_walk(gyroscope, a.instability_s), 1.0, a.gyro_bias_walk_radps2_rts),
        "accel_bias_walk_mps3_rts": _beside(
            _bias_walk(accelerometer, a.instability_s), 1.0, a.accel_bias_walk_mps3_rts
        ),
        "gyro_bias_sd_radps": _beside(gyroscope.turn_on_bias_sd, a.stated_factor, a.gyro_bias_sd_radps),
        "accel_bias_sd_mps2": _beside(accelerometer.turn_on_bias_sd, a.stated_factor, a.accel_bias_sd_mps2),
    }
    return replace(tuning, **{name: value for name, value in changes.items() if value is not None})


def _beside(stated: float | None, factor: float, allowance: float) -> float | None:
    return None if stated is None else math.hypot(factor * stated, allowance)


def _bias_walk(noise: TriadNoise, instability_s: float) -> float | None:
    flicker = noise.bias_instability
    walks = [
        noise.rate_random_walk,
        None if flicker is None else ALLAN_FLOOR * flicker * math.sqrt(3.0 / instability_s),
    ]
    return max((walk for walk in walks if walk is not None), default=None)
