"""Biases as the filter follows them on trips, folded back into what is known of a box, and when they have drifted."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from core.measurements import FloatArray, TimeArray
from core.navigation.tuning import Tuning
from core.sensors import AXES
from core.tunables import Tunables, tunable

SENSORS: Final = ("accelerometer", "gyroscope")
N_BIASES: Final = 6
"""Biases stand in vectors as accelerometer x, y, z (m/s2), then gyroscope x, y, z (rad/s): what the sensor shows of
nothing, before its scale is divided out."""

_TUNING: Final = Tuning()


@dataclass(frozen=True, slots=True)
class DriftThresholds(Tunables):
    """How biases wander between trips, what of the filter's word is believed, and what counts as drifted."""

    accel_unknown_sd_mps2: float = tunable(
        _TUNING.accel_bias_sd_mps2,
        unit="m/s2",
        low=1e-6,
        high=5.0,
        source="as the filter takes it at first",
    )
    gyro_unknown_sd_radps: float = tunable(
        _TUNING.gyro_bias_sd_radps,
        unit="rad/s",
        low=1e-7,
        high=1.0,
        source="as the filter takes it at first",
    )
    accel_turn_on_sd_mps2: float = tunable(
        0.02, unit="m/s2", low=0, high=1.0, source="LSM303DLHC 0.5 mg/K (data sheet) over 4 K from one trip to the next"
    )
    gyro_turn_on_sd_radps: float = tunable(
        2.0e-3, unit="rad/s", low=0, high=0.1, source="L3GD20 0.03 deg/s/K (data sheet) over 4 K"
    )
    accel_walk_mps2_rts: float = tunable(
        5.0e-5, unit="m/s2/sqrt(s)", low=0, high=0.01, source="choice: 0.015 m/s2 over a day, 0.08 over a month"
    )
    gyro_walk_radps_rts: float = tunable(
        3.0e-6, unit="rad/s/sqrt(s)", low=0, high=0.001, source="choice: 0.05 deg/s over a day, 0.3 over a month"
    )
    accel_model_sd_mps2: float = tunable(
        0.02, unit="m/s2", low=0, high=1.0, source="choice: 0.2 % of scale on gravity looks like a bias to the filter"
    )
    gyro_model_sd_radps: float = tunable(
        4.0e-4,
        unit="rad/s",
        low=0,
        high=0.01,
        source="flicker within a trip: 3e-4 RMS in 4 min of a simulated L3GD20",
    )
    accel_observed_sd_mps2: float = tunable(
        0.05, unit="m/s2", low=1e-4, high=1.0, source="choice: a third of what is taken to be so before a trip"
    )
    gyro_observed_sd_radps: float = tunable(
        1.0e-3, unit="rad/s", low=1e-6, high=0.1, source="choice: a tenth of what is taken to be so before a trip"
    )
    gate_sd: float = tunable(3.0, unit="1", low=1, high=10, source="choice: one in 370 by chance")
    accel_floor_mps2: float = tunable(
        0.1, unit="m/s2", low=0, high=5.0, source="choice: 10 mg, 0.6 deg of tilt; less harms nothing that is decided"
    )
    gyro_floor_radps: float = tunable(
        5.0e-3, unit="rad/s", low=0, high=0.5, source="choice: 0.3 deg/s, 17 deg a minute without GNSS"
    )

    def of(self, name: str) -> FloatArray:
        """The tunable ``accel_NAME_…`` three times, then ``gyro_NAME_…``: (6,)."""
        (accel,) = (getattr(self, one) for one in self.__slots__ if one.startswith(f"accel_{name}_"))
        (gyro,) = (getattr(self, one) for one in self.__slots__ if one.startswith(f"gyro_{name}_"))
        return np.repeat([accel, gyro], 3)


@dataclass(frozen=True, slots=True, eq=False)
class Biases:
    """Biases (6,) with their standard deviations (6,) at an instant; a spread that is not finite: nothing is known."""

    t_ns: int
    bias: FloatArray
    sd: FloatArray


@dataclass(frozen=True, slots=True)
class Drift:
    """A bias that is another than it was known to be; ``sd`` is that of the difference."""

    sensor: str
    axis: str
    was: float
    is_: float
    sd: float


@dataclass(frozen=True, slots=True, eq=False)
class BiasUpdate:
    """What a trip made of the biases of calibration ``version``: they hold for samples from ``biases.t_ns`` on."""

    version: int
    biases: Biases
    drifts: tuple[Drift, ...]


def folded_back(stored: Biases, seen: Biases, thresholds: DriftThresholds) -> tuple[Biases, tuple[Drift, ...]]:
    """The best of what was known and what a trip's filter says, each axis by itself, and which axes have drifted.

    What was known grows uncertain by ``turn_on`` and, with the time since, ``walk``, up to ``unknown``; then both are
    weighted by their variances (Bar-Shalom, Li & Kirubarajan 2001, sec. 3.4). An axis that differs by more than
    ``gate_sd`` of the difference's spread and by more than ``floor`` has drifted: of it only the filter's word stays,
    and it is as unsure as the difference, since the filter had to find it against what it believed.
    An axis of which the filter is less sure than ``observed`` keeps its bias.

    Parameters
    ----------
    stored : as known before the trip
    seen : the filter's, at rest after it; its spread is the filter's own

    Returns
    -------
    Biases at the time of ``seen``; drifts in the order of axes
    """
    t = thresholds
    elapsed_s = max(seen.t_ns - stored.t_ns, 0) * 1e-9
    known = np.isfinite(stored.sd)
    stated = np.where(known, stored.sd, 0.0) ** 2
    grown = stated + t.of("turn_on") ** 2 + t.of("walk") ** 2 * elapsed_s
    prior = np.minimum(grown, np.maximum(stated, t.of("unknown") ** 2))
    told = seen.sd**2 + t.of("model") ** 2
    observed = seen.sd <= t.of("observed")
    difference, spread = seen.bias - stored.bias, np.sqrt(prior + told)
    drifted = observed & known & (np.abs(difference) > np.maximum(t.gate_sd * spread, t.of("floor")))
    afresh = drifted | (observed & ~known)
    weight = np.where(afresh, 1.0, np.where(observed, prior / (prior + told), 0.0))
    kept_sd = np.where(known, np.sqrt(prior), np.nan)
    sd = np.where(observed, np.sqrt(np.where(known, (1.0 - weight) * prior, told)), kept_sd)
    sd = np.where(drifted, spread, sd)
    drifts = tuple(
        Drift(SENSORS[i // 3], AXES[i % 3], float(stored.bias[i]), float(seen.bias[i]), float(spread[i]))
        for i in np.flatnonzero(drifted)
    )
    return Biases(seen.t_ns, stored.bias + weight * difference, sd), drifts


class BiasFollower:
    """What is known of a box's biases from trip to trip: looks at standstills, folds back once a trip has ended."""

    def __init__(self, thresholds: DriftThresholds | None = None) -> None:
        self.thresholds = thresholds or DriftThresholds()
        self._values: FloatArray = np.full((4, N_BIASES), np.nan)  # stored bias and sd, seen bias and sd
        self._times: TimeArray = np.zeros(3, np.int64)  # of stored, of seen, end of a trip not folded back (0: none)

    def loosening(self, update: BiasUpdate) -> tuple[float, float]:
        """By how much the filter is to be less sure of the biases after an update: accelerometers, gyroscopes, sd."""
        drifted = [drift.sensor for drift in update.drifts]
        turn_on, unknown = self.thresholds.of("turn_on"), self.thresholds.of("unknown")
        accel, gyro = (float((unknown if sensor in drifted else turn_on)[3 * k]) for k, sensor in enumerate(SENSORS))
        return accel, gyro

    @property
    def stored(self) -> Biases:
        """What is known."""
        return Biases(int(self._times[0]), self._values[0], self._values[1])

    def begin(self, stored: Biases) -> None:
        """Start from a calibration's biases."""
        self._values[:2], self._values[2:] = (stored.bias, stored.sd), np.nan
        self._times[:] = stored.t_ns, 0, 0

    def see(self, seen: Biases) -> None:
        """Note what the filter says of a vehicle at rest."""
        self._values[2:] = seen.bias, seen.sd
        self._times[1] = seen.t_ns

    def trip_ended(self, end_t_ns: int) -> None:
        """Note that a trip's last movement was at a time, and that it is over."""
        self._times[2] = end_t_ns

    def fold_back(self, version: int, from_ns: int) -> BiasUpdate | None:
        """After a trip, its update, from ``from_ns`` on; None where none has ended or nothing was seen since."""
        _, seen_ns, end_ns = (int(t) for t in self._times)
        self._times[2] = 0
        if not end_ns or seen_ns < end_ns:
            return None
        seen = Biases(seen_ns, self._values[2], self._values[3])
        if not (seen.sd <= self.thresholds.of("observed")).any():
            return None
        biases, drifts = folded_back(self.stored, seen, self.thresholds)
        self._values[:2] = biases.bias, biases.sd
        self._times[0] = biases.t_ns
        return BiasUpdate(version, Biases(from_ns, biases.bias.copy(), biases.sd.copy()), drifts)

    def arrays(self) -> dict[str, npt.NDArray[np.generic]]:
        """The state by name."""
        return {"values": self._values, "times": self._times}

    def load(self, arrays: dict[str, npt.NDArray[np.generic]]) -> None:
        """Take over what ``arrays`` gave."""
        self._values, self._times = arrays["values"], arrays["times"]  # type: ignore[assignment]
