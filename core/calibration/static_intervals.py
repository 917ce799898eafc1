"""Finds where a box that is laid in one position after another lies still, by differences of neighbouring means.

At rest the mean over a time tau differs from the one before it by the sensor's Allan deviation, times the square root
of two; a moving hand makes it differ by a hundred times that. So the threshold is a multiple of the Allan deviation
that the recording's own quiet part has, at two times: the short one finds the ends of a hold, the long one slow turns.
Means take no notice of an engine's hum.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from core.calibration.recording import CalibrationRecording
from core.calibration.section_means import converter_steps, section_means
from core.errors import InvalidInputError
from core.measurements import FloatArray
from core.sensors import AXES
from core.tunables import Tunables, tunable

IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]

MOTION: Final = 20.0
"""Times what white noise would be: a digital filter makes it up to 5, a hand's tremor 3, its motion 50 and more."""
CHI3_MEDIAN: Final = 2.366
"""Median of a chi-square of three degrees of freedom."""
CHI3_TWENTIETH: Final = 0.352
"""Its 5 % quantile."""


@dataclass(frozen=True, slots=True)
class StaticSettings(Tunables):
    """What counts as lying still, and for how long."""

    hold_s: float = tunable(
        2.0, unit="s", low=0.5, high=600.0, source="issue 4: holds as short as 2 s; shorter ones are not looked for"
    )
    short_s: float = tunable(0.1, unit="s", low=0.01, high=1.0, source="choice: a mean that finds the ends of a hold")
    long_s: float = tunable(
        0.5, unit="s", low=0.05, high=5.0, source="choice: a mean that sees a slow turn; a quarter of the shortest hold"
    )
    factor: float = tunable(
        6.0, unit="1", low=2.0, high=100.0, source="choice: of the sd at rest; white noise passes 6 once in 1e7"
    )
    held_factor: float = tunable(
        48.0,
        unit="1",
        low=2.0,
        high=1000.0,
        source="choice: the most for a box held in a hand; calib_mpu6050 needs 25 to 40, turning a box passes 100",
    )
    held_share: float = tunable(
        0.05,
        unit="1",
        low=0.001,
        high=0.5,
        source="choice: and at most so much of the recording's range; 0.5 m/s2 or 3 degrees",
    )
    knock_s: float = tunable(
        0.5, unit="s", low=0.0, high=5.0, source="choice: a knock at the table, after which the box lies as before"
    )
    margin_s: float = tunable(
        0.1, unit="s", low=0.0, high=2.0, source="choice: setting down, left out at both ends of a hold"
    )
    blocks: int = tunable(
        16, unit="1", low=2, high=1000, source="choice: a hold is cut into so many for the variance of its mean"
    )
    pooled_blocks: float = tunable(
        5.0, unit="1", low=0.0, high=1000.0, source="choice: what the noise of all holds counts beside a hold's own"
    )


@dataclass(frozen=True, slots=True, eq=False)
class StaticPositions:
    """The holds of a recording, in order.

    Parameters
    ----------
    start, end : (k,) sample indices, end exclusive
    mean_accelerometer : (k, 3) in the unit of the recording
    cov_accelerometer : (k, 3, 3) of these means: from means over blocks, so that noise may be correlated within a
        block, and with what rounding to whole steps of the converter adds where the noise is too small to average it
    mean_gyroscope, cov_gyroscope : the same, or None
    threshold : what means of ``long_s`` of the accelerometer may differ by, in its unit; NaN for given sections
    """

    start: IntArray
    end: IntArray
    mean_accelerometer: FloatArray
    cov_accelerometer: FloatArray
    mean_gyroscope: FloatArray | None
    cov_gyroscope: FloatArray | None
    threshold: float = float("nan")

    def __len__(self) -> int:
        return int(self.start.size)

    @staticmethod
    def of(
        recording: CalibrationRecording,
        starts: IntArray,
        ends: IntArray,
        *,
        still: BoolArray | None = None,
        threshold: float = float("nan"),
        settings: StaticSettings | None = None,
    ) -> StaticPositions:
        """Positions from given sections; of their samples only those that are ``still`` (n,), default all.

        Raises
        ------
        InvalidInputError
            If there is no section, one is empty or outside the recording, or an axis is saturated in one.
        """
        settings = StaticSettings() if settings is None else settings
        starts, ends = np.asarray(starts, dtype=np.int64), np.asarray(ends, dtype=np.int64)
        rows = recording.t_s.size
        if starts.size == 0 or starts.shape != ends.shape:
            raise InvalidInputError(f"{starts.size} starts and {ends.size} ends of static positions; expected as many")
        wrong = (starts < 0) | (ends > rows) | (ends - starts < 2)
        if wrong.any():
            i = int(np.argmax(wrong))
            raise InvalidInputError(
                f"static position {i + 1} is rows {starts[i]} to {ends[i]} of {rows}; expected some"
            )
        still = np.ones(rows, dtype=bool) if still is None else still
        parts = [start + np.flatnonzero(still[start:end]) for start, end in zip(starts, ends, strict=True)]
        accelerometer = section_means(recording.accelerometer, parts, settings.blocks, settings.pooled_blocks)
        _refuse_saturated(recording, parts)
        means = covariances = None
        if recording.gyroscope is not None:
            means, covariances = section_means(recording.gyroscope, parts, settings.blocks, settings.pooled_blocks)
        return StaticPositions(starts, ends, *accelerometer, means, covariances, threshold)


def find_static(recording: CalibrationRecording, settings: StaticSettings | None = None) -> StaticPositions:
    """The positions of a recording: it needs no rest at its start, and no gyroscope.

    First what lies as still as the quietest part of the recording, with sharp ends; then, apart from that, what lies
    less still, as in a hand. A recording that lies still from end to end is one position. Two holds with the same
    orientation are two positions if the box was moved between them, one if it was only knocked at.

    Raises
    ------
    InvalidInputError
        If it is too short, or no hold was found; the message says what to record.
    """
    settings = StaticSettings() if settings is None else settings
    period_s = _period_s(recording)
    short, long = (max(1, round(s / period_s)) for s in (settings.short_s, settings.long_s))
    rows = recording.t_s.size
    if rows * period_s < settings.hold_s or rows < 4 * long:
        raise InvalidInputError(
            f"the recording lasts {rows * period_s:.1f} s; expected at least {settings.hold_s:g} s in each position"
        )
    sensors = [recording.accelerometer]
    if recording.gyroscope is not None and np.ptp(recording.gyroscope, axis=0).max() > 0.0:
        sensors.append(recording.gyroscope)  # one that is not there is often recorded as zeros
    slow = [_Change.of(values, long, settings) for values in sensors]
    quick = [_Change.of(values, short, settings) for values in sensors]
    if any(change.moves for change in slow):
        raise InvalidInputError(_NEVER_STILL.format(settings.hold_s))

    holds, used = _holds(recording.t_s, sensors, slow, quick, settings)
    if not len(holds):
        raise InvalidInputError(_NEVER_STILL.format(settings.hold_s))
    threshold = slow[0].limit(settings.factor)
    positions = StaticPositions.of(recording, *holds.T, still=used, threshold=threshold, settings=settings)
    if positions.mean_gyroscope is None or len(sensors) == 1:
        return positions
    # Evenly turned about the vertical, as on a turntable: the gyroscope's mean is far off that of the others.
    off = np.linalg.norm(positions.mean_gyroscope - np.median(positions.mean_gyroscope, axis=0), axis=1)
    unturned = off <= slow[1].limit(settings.held_factor)
    if unturned.all():
        return positions
    return StaticPositions.of(recording, *holds[unturned].T, still=used, threshold=threshold, settings=settings)


_NEVER_STILL: Final = (
    "no static position: the box never lies still for {:g} s; lay it down in each position and let go of it"
)


@dataclass(frozen=True, slots=True, eq=False)
class _Change:
    """By how much the mean over m samples after each sample differs from that before it.

    Parameters
    ----------
    m : samples
    length : (n,) of the difference, NaN near the ends
    sd : its standard deviation per axis at rest: the Allan deviation there, times the square root of two
    white : what that would be by the difference of neighbouring samples, were their noise white
    floor : what the converter's steps may feign where there is no noise
    most : what is still at most, however noisy the sensor is
    """

    m: int
    length: FloatArray
    sd: float
    white: float
    floor: float
    most: float

    @classmethod
    def of(cls, values: FloatArray, m: int, settings: StaticSettings) -> _Change:
        """Its spread at rest is that of what is within ``factor`` of it, beginning from the quietest twentieth."""
        sums = np.vstack([np.zeros(3), np.cumsum(values - np.median(values, axis=0), axis=0)])
        means = (sums[m:] - sums[:-m]) / m
        length = np.full(values.shape[0], np.nan)
        length[m : values.shape[0] - m + 1] = np.linalg.norm(means[m:] - means[:-m], axis=1)
        floor, factor = 1.5 * float(converter_steps(values).max()), settings.factor
        square = length[np.isfinite(length)] ** 2
        variance = float(np.quantile(square, 0.05)) / CHI3_TWENTIETH
        for _ in range(50):
            inside = square[square <= max(factor**2 * variance, floor**2)]
            before, variance = variance, float(np.median(inside)) / CHI3_MEDIAN
            if abs(variance - before) <= 1e-3 * before:
                break
        sd = math.sqrt(variance)
        neighbours = float(np.median(np.sum(np.diff(values, axis=0) ** 2, axis=1))) / CHI3_MEDIAN
        low, high = np.quantile(means, (0.01, 0.99), axis=0)
        most = max(factor * sd, settings.held_share * 0.5 * float((high - low).max()))
        return cls(m, length, sd, math.sqrt(neighbours / m), floor, most)

    @property
    def moves(self) -> bool:
        """Whether even the quietest part is motion: unlike noise it grows with the time of the mean."""
        return self.sd > max(MOTION * self.white, self.floor)

    def limit(self, factor: float) -> float:
        """What is still, of a sensor that lies ``factor`` times less still than the quietest part."""
        return max(min(factor * self.sd, self.most), self.floor)


def _holds(
    t_s: FloatArray, sensors: list[FloatArray], slow: list[_Change], quick: list[_Change], settings: StaticSettings
) -> tuple[IntArray, BoolArray]:
    """First and last (exclusive) sample of each hold (k, 2), in order, and which samples are calm (n,)."""
    period_s, short, long = float(np.median(np.diff(t_s))), quick[0].m, slow[0].m
    margin, least = round(settings.margin_s / period_s), round((settings.hold_s - 2.0 * settings.margin_s) / period_s)
    lost_s = max(settings.short_s, 2.5 * period_s)  # a sample or two may be
    limits = [change.limit(settings.held_factor) for change in slow]
    used, holds = np.zeros(t_s.size, dtype=bool), list[tuple[int, int]]()
    for factor in (settings.factor, settings.held_factor):
        still = np.diff(t_s, append=np.inf) <= lost_s
        for change in slow + quick:
            still &= _covered(change.length <= change.limit(factor), change.m, t_s.size)
        laid = list(holds)
        for start, end in _bridged(_runs(still), t_s, sensors, limits, settings.knock_s, long):
            if end - start < least or any(start < other[1] and other[0] < end for other in laid):
                continue
            # In a hand a box may be tilted so slowly that no change of its mean tells.
            ends_alike = _same(slice(start, start + long), slice(end - long, end), sensors[:1], limits[:1])
            if factor > settings.factor and not ends_alike:
                continue
            inside = still[start:end]
            calm = inside & ~_covered(~inside, short, end - start)  # a knock dies away
            if np.mean(calm) >= 0.5:  # and one after the other is no hold
                holds.append((start + margin, end - margin))
                used[start:end] = calm
    return np.array(sorted(holds), dtype=np.int64).reshape(-1, 2), used


def _covered(still: BoolArray, m: int, rows: int) -> BoolArray:
    """Samples within m before or after a boundary at which the mean did not change.

    Less an eighth, so that from both sides of a sudden turn something is left between.
    """
    marks, reach = np.zeros(rows + 1, dtype=np.int64), m - m // 8
    at = np.flatnonzero(still)
    np.add.at(marks, np.maximum(at - reach, 0), 1)
    np.add.at(marks, np.minimum(at + reach, rows), -1)
    return np.cumsum(marks[:-1]) > 0


def _runs(still: BoolArray) -> list[tuple[int, int]]:
    """Where runs of True start, and end (exclusive)."""
    edges = np.diff(np.concatenate(([0], still.astype(np.int8), [0])))
    starts, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    return list(zip(starts.tolist(), ends.tolist(), strict=True))


def _bridged(
    runs: list[tuple[int, int]],
    t_s: FloatArray,
    sensors: list[FloatArray],
    limits: list[float],
    knock_s: float,
    long: int,
) -> list[tuple[int, int]]:
    """Runs over a knock as one: a short gap, with the same means in the last and first ``long`` samples beside it."""
    bridged: list[tuple[int, int]] = []
    for start, end in runs:
        if bridged and t_s[start] - t_s[bridged[-1][1] - 1] <= knock_s:
            first, last = bridged[-1]
            if _same(slice(max(first, last - long), last), slice(start, min(end, start + long)), sensors, limits):
                bridged[-1] = (first, end)
                continue
        bridged.append((start, end))
    return bridged


def _same(one: slice, other: slice, sensors: list[FloatArray], limits: list[float]) -> bool:
    """Whether all sensors have the same mean in two sections."""
    return all(
        float(np.linalg.norm(values[other].mean(axis=0) - values[one].mean(axis=0))) <= limit
        for values, limit in zip(sensors, limits, strict=True)
    )


def _refuse_saturated(recording: CalibrationRecording, parts: list[IntArray]) -> None:
    """Raise where an axis of the accelerometer stands at the end of its range in a position."""
    values = recording.accelerometer
    sds, steps = np.median([values[part].std(axis=0) for part in parts], axis=0), converter_steps(values)
    noisy = (steps > 0.0) & (sds >= steps)
    for axis in np.flatnonzero(noisy):  # with such noise no value within the range takes half of the samples
        column = values[:, axis]
        for end in (column.min(), column.max()):
            shares = np.array([np.mean(column[part] == end) for part in parts])
            if (shares > 0.5).any():
                i = int(np.argmax(shares))
                first_s, last_s = recording.t_s[parts[i][[0, -1]]]
                raise InvalidInputError(
                    f"the accelerometer's {AXES[axis]} axis is saturated at {end:g} in position {i + 1} of"
                    f" {len(parts)} ({first_s:.1f} to {last_s:.1f} s); record again with a wider range"
                )


def _period_s(recording: CalibrationRecording) -> float:
    if recording.t_s.size < 2:
        raise InvalidInputError(
            f"the recording has {recording.t_s.size} samples; expected some seconds in each position"
        )
    return float(np.median(np.diff(recording.t_s)))
