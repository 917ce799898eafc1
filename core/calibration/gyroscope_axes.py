"""A gyroscope's matrix as scale, misalignment and alignment, and a first guess of it from turns between positions."""

from __future__ import annotations

import itertools
import math
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.linalg import rq

from core.calibration.turns import integrate
from core.errors import InvalidInputError
from core.measurements import FloatArray
from core.rotation import rotation_vector_from_matrix
from core.sensors import TriadCalibration, triple

IntArray = npt.NDArray[np.int64]

COARSE_S: Final = 0.04
"""Interval of the rates that a first guess is made of: a hand's turn has little beyond 5 Hz."""
MOST_TURNS: Final = 5.0
"""Full turns that a hand makes from one position to the next, on the average; at most."""
GRID: Final = 1.03
"""Ratio of the scales tried: half of it is 7 % of a turn after five of them, inside where the iteration finds home."""
SCALE_OFF: Final = 1.3
"""A scale further from 1 is no error of a gyroscope in rad/s but another unit."""
NEAR_SCALES: Final = 19
"""Tried between 1 / SCALE_OFF and SCALE_OFF, 3 % apart."""
FAR_RAD: Final = 0.3
"""Angle between the ups of a turn from which on it bounds the scale: of less, a hand turns the box about up too."""
BETTER: Final = 0.5
"""Another order of axes is believed where it misses less than this share of what the usual one does; a choice."""
GOOD_SHARE: Final = 0.04
GOOD_RAD: Final = (0.2, 0.5)
"""RMS by which gravity is missed with the right unit and axes before any fit: such a share of what was turned, which
is the error of a scale, but no less and no more than this. Unrelated directions are 1.4 apart."""


def matrix_of(triad: TriadCalibration) -> FloatArray:
    """SF M C (3, 3)."""
    return np.asarray((triad.apply(np.eye(3)) - np.array(triad.bias)).T)


def axes_of(matrix: FloatArray, bias: FloatArray) -> TriadCalibration:
    """SF, M and C of SF M C = matrix (3, 3), by RQ decomposition. Scales are positive, unless the triad is
    left-handed: then that one is negative which leaves the axes turned least."""
    upper, turn = rq(matrix)
    signs = np.sign(np.diag(upper))
    upper, turn = upper * signs, signs[:, None] * turn
    if np.linalg.det(turn) < 0.0:
        flip = np.ones(3)
        flip[np.argmin(np.diag(turn))] = -1.0
        upper, turn = upper * flip, flip[:, None] * turn
    scale = np.diag(upper)
    unit = upper / scale[:, None]
    return TriadCalibration(
        triple(scale),
        (float(-unit[1, 2]), float(unit[0, 2]), float(-unit[0, 1])),
        triple(bias),
        triple(rotation_vector_from_matrix(np.ascontiguousarray(turn))),
    )


def first_guess(
    t_s: FloatArray,
    shown: FloatArray,
    begin: IntArray,
    end: IntArray,
    bias: FloatArray,
    ups: tuple[FloatArray, FloatArray],
    counts: bool,
) -> FloatArray:
    """G (3, 3), rad/s per shown unit: one scale for all axes, which may be permuted and reversed.

    Parameters
    ----------
    begin, end : (k,) first and last sample of each turn
    bias : (3,) at rest
    ups : unit up before and after each turn, (k, 3) each
    counts : whether the scale is not known to be near 1

    Raises
    ------
    InvalidInputError
        If the scale is not known to be another, but is: degrees a second or counts.
    """
    rates = _Coarse(t_s, shown - bias, begin, end, ups)
    asked = np.eye(3)
    if not counts and rates.missed(asked) < rates.good(1.0):
        return asked
    scales = rates.plausible_scales()
    scale, missed = rates.best(np.eye(3), scales)
    axes = np.eye(3)
    if missed > rates.good(scale):
        for turned in axes_orders():
            found, then_missed = rates.best(turned, scales[::2])
            if then_missed < BETTER * missed:
                scale, missed, axes = found, then_missed, turned
    if not counts and not 1.0 / SCALE_OFF < scale < SCALE_OFF:
        # After several whole turns another number of them may seem as good, until each axis has its own scale.
        near, near_missed = rates.best(axes, np.geomspace(SCALE_OFF, 1.0 / SCALE_OFF, NEAR_SCALES))
        if BETTER * near_missed < missed:
            return axes / near
        if missed < rates.good(scale):
            raise InvalidInputError(_other_unit(scale))
        return asked
    return axes / scale


def _other_unit(scale: float) -> str:
    likely = "they look like raw counts: say so (--counts), or convert them"
    if 1.0 / SCALE_OFF < math.radians(scale) < SCALE_OFF:
        likely = "they look like degrees a second: multiply them by pi / 180"
    elif scale < 1.0:
        likely = "is their unit named too small, such as degrees a second for what is radians?"
    return f"rates are {scale:.3g} times what the turns between positions ask for; {likely}"


def axes_orders() -> list[FloatArray]:
    """The 48 ways to order and reverse three axes."""
    return [
        np.eye(3)[list(order)] * np.array(signs)
        for order in itertools.permutations(range(3))
        for signs in itertools.product((1.0, -1.0), repeat=3)
    ]


class _Coarse:
    """Turns at a low rate, for many tries."""

    def __init__(
        self,
        t_s: FloatArray,
        rates: FloatArray,
        begin: IntArray,
        end: IntArray,
        ups: tuple[FloatArray, FloatArray],
    ) -> None:
        # The integral of the rates keeps all of a turn's angle, however few samples are taken of it.
        angle = np.zeros_like(rates)
        angle[1:] = np.cumsum(0.5 * (rates[1:] + rates[:-1]) * np.diff(t_s)[:, None], axis=0)
        every = max(1, round(COARSE_S / float(np.median(np.diff(t_s)))))
        rows, self.begin, self.end, count = [], [], [], 0
        for a, b in zip(begin, end, strict=True):
            taken = np.unique(np.r_[np.arange(a, b, every), b])
            rows.append(taken)
            self.begin.append(count)
            count += len(taken)
            self.end.append(count - 1)
        taken = np.concatenate(rows)
        self.t_s = t_s[taken]
        self.rates = np.zeros((count, 3))
        self.rates[1:] = np.diff(angle[taken], axis=0) / np.maximum(np.diff(self.t_s), 1e-9)[:, None]
        self.ups = ups
        self.travelled = np.array(
            [
                np.sum(np.linalg.norm(rates[a:b], axis=1) * np.diff(t_s[a : b + 1]))
                for a, b in zip(begin, end, strict=True)
            ]
        )
        self.angle_rad = np.arccos(np.clip(np.einsum("ki,ki->k", *ups), -1.0, 1.0))

    def good(self, scale: float) -> float:
        """RMS, rad, by which gravity is missed at most, where ``scale`` is the right one but for its error."""
        return float(np.clip(GOOD_SHARE * np.median(self.travelled) / scale, *GOOD_RAD))

    def plausible_scales(self) -> FloatArray:
        """Shown over true: no turn can be less than the angle between its ups, nor is it many full ones."""
        far = self.angle_rad > FAR_RAD
        if not far.any():
            raise InvalidInputError(
                f"up moves by less than {math.degrees(FAR_RAD):.0f} degrees from each position to the next; "
                "record again, turning the box by 90 to 180 degrees between positions"
            )
        high = 1.2 * float(np.min(self.travelled[far] / self.angle_rad[far]))
        low = min(float(np.median(self.travelled)) / (2.0 * math.pi * MOST_TURNS), 0.9 * high)
        return np.geomspace(high, low, max(2, math.ceil(math.log(high / low) / math.log(GRID))))

    def best(self, axes: FloatArray, scales: FloatArray) -> tuple[float, float]:
        """The scale that misses gravity least, and that RMS, rad."""
        missed = [self.missed(axes / scale) for scale in scales]
        at = int(np.argmin(missed))
        return float(scales[at]), missed[at]

    def missed(self, inverse: FloatArray) -> float:
        begin, end = np.array(self.begin), np.array(self.end)
        turns = integrate(self.t_s, self.rates, begin, end, inverse, np.zeros((len(begin), 3)), np.zeros(3))
        brought = np.einsum("kji,kj->ki", turns.C_a_from_e, self.ups[0])
        return float(np.sqrt(np.mean(np.sum((brought - self.ups[1]) ** 2, axis=1))))
