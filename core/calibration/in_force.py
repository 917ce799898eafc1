"""The calibration in force: which version holds for which sample, with the biases that trips have made of it."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Final

import numpy as np
import numpy.typing as npt

from core.calibration.drift import Biases, BiasFollower, BiasUpdate
from core.measurements import SERIES, FloatArray, Measurements
from core.sensors import MagnetometerCalibration, TriadCalibration, Triple

LOOK_NS: Final = 10_000_000_000
"""Grid of absolute time on which a session looks at the filter's biases: the same instants however packets are cut."""

NO_SPREAD: Final[Triple] = (math.nan, math.nan, math.nan)


@dataclass(frozen=True, slots=True)
class BoxCalibration:
    """What is known of a box's sensors, for samples from ``valid_from_ns`` on.

    Parameters
    ----------
    version : names it in what is told and kept
    accelerometer, gyroscope, magnetometer : m/s2, rad/s and microtesla
    accelerometer_bias_sd, gyroscope_bias_sd : of their biases; NaN where nothing is known of them
    learnt : biases as former trips left them, in the place of the triads' own
    """

    version: int = 0
    valid_from_ns: int = 0
    accelerometer: TriadCalibration = field(default_factory=TriadCalibration)
    gyroscope: TriadCalibration = field(default_factory=TriadCalibration)
    accelerometer_bias_sd: Triple = NO_SPREAD
    gyroscope_bias_sd: Triple = NO_SPREAD
    learnt: Biases | None = None
    magnetometer: MagnetometerCalibration = field(default_factory=MagnetometerCalibration)

    @property
    def biases(self) -> Biases:
        """What is known of the biases at first."""
        if self.learnt is not None:
            return self.learnt
        bias = np.array([*self.accelerometer.bias, *self.gyroscope.bias])
        return Biases(self.valid_from_ns, bias, np.array([*self.accelerometer_bias_sd, *self.gyroscope_bias_sd]))

    def with_bias(self, bias: FloatArray) -> BoxCalibration:
        """The same with other biases (6,)."""
        ax, ay, az, gx, gy, gz = (float(one) for one in bias)
        return replace(
            self,
            accelerometer=replace(self.accelerometer, bias=(ax, ay, az)),
            gyroscope=replace(self.gyroscope, bias=(gx, gy, gz)),
        )


class CalibrationInForce:
    """The version of the newest sample, and its biases followed; of versions that begin together the last counts."""

    def __init__(self, versions: Sequence[BoxCalibration]) -> None:
        self._versions = tuple(versions)
        self._begins = [one.valid_from_ns for one in self._versions]
        self.follower = BiasFollower()
        self._state = np.array([-1, 0], np.int64)  # the version in force, -1 before any sample; the cell of time

    @property
    def version(self) -> int:
        """The version in force; -1 before the first sample."""
        return int(self._state[0])

    @property
    def calibration(self) -> BoxCalibration:
        """What is in force, with its biases as followed."""
        if self.version < 0:
            return self._versions[0] if self._versions else BoxCalibration()
        found = [one for one in self._versions if one.version == self.version]
        return (found[-1] if found else BoxCalibration()).with_bias(self.follower.stored.bias)

    def cut(self, t_ns: npt.NDArray[np.int64]) -> list[int]:
        """Indices of those samples (n,), increasing in time, before which something may change; 0 is not among them."""
        if len(t_ns) < 2 or self._cell(int(t_ns[0])) == self._cell(int(t_ns[-1])):
            return []
        cells = t_ns // LOOK_NS
        places = np.searchsorted(np.array(self._begins, np.int64), t_ns, side="right")
        return [int(i) + 1 for i in np.flatnonzero((np.diff(cells) != 0) | (np.diff(places) != 0))]

    def _cell(self, t_ns: int) -> tuple[int, int]:
        return t_ns // LOOK_NS, bisect_right(self._begins, t_ns)

    def is_look_due(self, t_ns: int) -> bool:
        """Whether the next sample, at a time, is the first in another cell of the grid than the one before."""
        return t_ns // LOOK_NS != int(self._state[1])

    def look(self, t_ns: int, seen: Biases | None, may_fold: bool) -> BiasUpdate | None:
        """Take what the filter says before the sample at a time; the update where a trip that has ended brings one."""
        self._state[1] = t_ns // LOOK_NS
        if seen is not None:
            self.follower.see(seen)
        return self.follower.fold_back(self.version, int(self._state[1]) * LOOK_NS) if may_fold else None

    def change(self, t_ns: int) -> bool:
        """Put in force what holds for a sample at a time; whether that is another version than before."""
        place = bisect_right(self._begins, t_ns)
        now = self._versions[place - 1] if place else BoxCalibration()
        if now.version == self.version:
            return False
        self._state[0] = now.version
        # What holds ever since is of unknown age: it is taken to be as good as stated when it is first used.
        biases = now.biases
        self.follower.begin(biases if biases.t_ns else replace(biases, t_ns=t_ns))
        return True

    def arrays(self) -> dict[str, npt.NDArray[np.generic]]:
        """The state by name."""
        return {"state": self._state, **{f"follower.{name}": a for name, a in self.follower.arrays().items()}}

    def load(self, arrays: dict[str, npt.NDArray[np.generic]]) -> None:
        """Take over what ``arrays`` gave."""
        self._state = arrays["state"]  # type: ignore[assignment]
        self.follower.load({name: arrays[f"follower.{name}"] for name in self.follower.arrays()})


def parts_at(measurements: Measurements, cuts: Sequence[int]) -> Iterator[Measurements]:
    """Measurements cut before some of their inertial samples, with the aids of each part's time."""
    imu_t_ns = measurements.imu_t_ns
    for begin, end in pairwise([0, *cuts, len(imu_t_ns)]):
        changed: dict[str, npt.NDArray[np.generic]] = {}
        for times, *rows in SERIES.values():
            t_ns = getattr(measurements, times)
            own = np.ones(len(t_ns), np.bool_)
            if begin:
                own &= t_ns >= imu_t_ns[begin]
            if end < len(imu_t_ns):
                own &= t_ns < imu_t_ns[end]
            changed |= {name: getattr(measurements, name)[own] for name in (times, *rows)}
        yield replace(measurements, **changed)  # type: ignore[arg-type]
