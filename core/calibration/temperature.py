"""Bias against temperature: a straight line through what each axis shows at rest while the box warms or cools."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from core.calibration.accelerometer import AccelerometerPrior
from core.calibration.fit import TriadFit
from core.calibration.gyroscope_problem import GyroscopePrior
from core.calibration.recording import CalibrationRecording
from core.calibration.static_intervals import StaticPositions
from core.errors import InvalidInputError
from core.measurements import FloatArray
from core.sensors import Triple, triple

LEAST_RANGE_K: Final = 2.0
"""Kelvin by which the box must have warmed or cooled: a sensor's own noise is 0.1 K, and less tells no slope."""
BLOCK_S: Final = 2.0
"""Length of the means at rest that are observations: the temperature of a box does not change within."""
LEAST_BLOCKS: Final = 8
LEAST_POSITIONS: Final = 8
"""From then on the sensitivity to gravity is told apart from warmth."""
LAGS: Final = 0.2
"""Share of the recording up to which scatter is looked at for going the same way."""


@dataclass(frozen=True, slots=True)
class BiasTemperature:
    """bias(temperature) = bias at ``reference_c`` + slope_per_k (temperature - reference_c).

    Parameters
    ----------
    slope_per_k : of each axis, in the recording's unit a kelvin
    reference_c : mean temperature at rest, at which the calibration's bias holds
    sd : of the slopes
    low_c, high_c : temperatures between which the line was seen; beyond it is a guess
    """

    slope_per_k: Triple
    reference_c: float
    sd: Triple
    low_c: float
    high_c: float

    def bias(self, at_reference: FloatArray, temperature_c: float) -> FloatArray:
        """The bias (3,) at a temperature, of that at the reference (3,)."""
        return np.asarray(at_reference + np.array(self.slope_per_k) * (temperature_c - self.reference_c))


def gyroscope_temperature(
    recording: CalibrationRecording, positions: StaticPositions, instability: float = GyroscopePrior().instability_radps
) -> BiasTemperature | None:
    """Slopes of the gyroscope's biases, its unit a kelvin; None if there is no temperature or no gyroscope.

    ``instability`` is by how much a bias wanders at constant temperature, in the recording's unit.

    Raises
    ------
    InvalidInputError
        If the temperature is not finite, moved too little, or there is too little rest.
    """
    if recording.temperature_c is None or recording.gyroscope is None:
        return None
    blocks = _Blocks.of(recording, recording.gyroscope, positions)
    constant = np.ones((len(blocks.temperature_c), 1))
    if len(positions) >= LEAST_POSITIONS:
        # Gravity moves a MEMS gyroscope's bias too: what follows the attitude is not to be taken for warmth.
        force = _Blocks.of(recording, recording.accelerometer, positions).means
        constant = np.hstack([constant, (force - force.mean(axis=0)) / np.abs(force).max()])
    return blocks.line(constant, instability)


def accelerometer_temperature(
    recording: CalibrationRecording,
    positions: StaticPositions,
    fit: TriadFit,
    instability_mps2: float = AccelerometerPrior().bias_instability_mps2,
) -> BiasTemperature | None:
    """Slopes of the accelerometer's biases, its unit a kelvin; None if there is no temperature.

    Along up, and nowhere else, is what a bias adds seen at rest: slopes come from how the norm differs from gravity in
    positions of other temperatures, beside a constant bias that the fit may have left.

    Raises
    ------
    InvalidInputError
        As for the gyroscope.
    """
    if recording.temperature_c is None:
        return None
    blocks = _Blocks.of(recording, recording.accelerometer, positions)
    triad = fit.calibration
    true = triad.correct(blocks.means)
    size = np.linalg.norm(true, axis=1)
    up = true / size[:, None]
    by_slope = up * (blocks.temperature_c - blocks.temperature_c.mean())[:, None] / np.array(triad.scale)
    # All else that the fit took from the same positions, and may have bent to swallow the warmth: scale and
    # misalignment as squares of up, bias as up.
    squares = np.column_stack([up[:, i] * up[:, j] for i in range(3) for j in range(i, 3)])
    wander = instability_mps2 * np.array(triad.scale)
    return blocks.solved(np.hstack([by_slope, squares, up]), size - float(np.mean(size)), wander)


@dataclass(frozen=True, slots=True, eq=False)
class _Blocks:
    temperature_c: FloatArray
    means: FloatArray

    @classmethod
    def of(cls, recording: CalibrationRecording, shown: FloatArray, positions: StaticPositions) -> _Blocks:
        """Means of two seconds within positions."""
        temperature_c = recording.temperature_c
        assert temperature_c is not None
        length = max(1, round(BLOCK_S / float(np.median(np.diff(recording.t_s)))))
        warmth, means = [], []
        for start, end in zip(positions.start, positions.end, strict=True):
            for begin in range(start, end - length + 1, length):
                known = temperature_c[begin : begin + length]
                known = known[np.isfinite(known)]
                if known.size:
                    warmth.append(float(known.mean()))
                    means.append(shown[begin : begin + length].mean(axis=0))
        if len(means) < LEAST_BLOCKS:
            raise InvalidInputError(
                f"{len(means)} stretches of {BLOCK_S:g} s at rest with a temperature; expected {LEAST_BLOCKS} or more: "
                "record again, leaving the box in each position for longer"
            )
        span_k = max(warmth) - min(warmth)
        if span_k < LEAST_RANGE_K:
            raise InvalidInputError(
                f"the temperature moved by {span_k:.1f} K; expected {LEAST_RANGE_K:g} K or more to tell how biases "
                "follow it: record again while the box warms up from cold"
            )
        return cls(np.array(warmth), np.array(means))

    def line(self, constant: FloatArray, wander: float) -> BiasTemperature:
        """Each axis by itself: constants (m, c) and a slope."""
        offset = self.temperature_c - self.temperature_c.mean()
        design = np.column_stack([offset, constant])
        inverse = np.linalg.pinv(design.T @ design)
        found = inverse @ design.T @ self.means
        left = self.means - design @ found
        sd = np.sqrt(inverse[0, 0] * _scatter(left, design.shape[1]))
        return self._told(found[0], sd, wander)

    def solved(self, design: FloatArray, missed: FloatArray, wander: FloatArray) -> BiasTemperature:
        """All three slopes from one equation a block."""
        inverse = np.linalg.pinv(design.T @ design)
        found = inverse @ design.T @ missed
        left = (missed - design @ found)[:, None]
        sd = np.sqrt(np.diag(inverse)[:3] * _scatter(left, design.shape[1]))
        return self._told(found[:3], sd, wander)

    def _told(self, slopes: FloatArray, sd: FloatArray, wander: FloatArray | float) -> BiasTemperature:
        # Half of what wanders is a trend over the recording, which the temperature has too.
        sd = np.sqrt(sd**2 + 0.5 * (np.asarray(wander) / np.std(self.temperature_c)) ** 2)
        return BiasTemperature(
            triple(slopes),
            float(self.temperature_c.mean()),
            triple(sd),
            float(self.temperature_c.min()),
            float(self.temperature_c.max()),
        )


def _scatter(left: FloatArray, taken: int) -> FloatArray:
    """Variance (m,) of residuals (n, m), as large as if those that go the same way for a while were fewer
    (Bartlett 1946): a bias wanders, noise does not."""
    count = len(left)
    total = np.maximum(np.sum(left**2, axis=0), 1e-300)
    fewer = np.ones(left.shape[1])
    for lag in range(1, max(2, round(LAGS * count))):
        fewer += 2.0 * np.sum(left[lag:] * left[:-lag], axis=0) / total
    return np.asarray(total / max(1, count - taken) * np.maximum(fewer, 1.0))
