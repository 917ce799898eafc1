"""Wavelet denoising of inertial samples in a stream: overlapping windows, level-dependent thresholds, many vehicles."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt
import pywt
from numba import njit

from core.errors import InvalidInputError
from core.measurements import FloatArray, TimeArray
from core.tunables import Tunables, tunable

WAVELET: Final = "sym4"
"""Daubechies' least asymmetric wavelet of 8 taps: four vanishing moments leave drift in the approximation, the near
symmetry leaves a pulse where it was, and few taps make the latency short."""

AXES: Final = 6
"""Columns of a row: specific force x, y, z in m/s2, then angular rate x, y, z in rad/s."""

HIGHEST_RATE_HZ: Final = 10_000.0
"""Beyond any inertial sensor of a vehicle; what is above is a mistaken unit."""

_EXTENSION: Final = "symmetric"
"""How a series goes on beyond its ends: mirrored, without a step; alike where it begins and where it breaks."""
_MAD_PER_SD: Final = 0.6744897501960817
"""Median absolute deviation of normal noise of unit sd (Donoho & Johnstone 1994)."""
_TAPS: Final = int(pywt.Wavelet(WAVELET).dec_len)

Samples = tuple[TimeArray, FloatArray]
"""Times (n,) in UTC nanoseconds, strictly increasing, and rows (n, 6)."""


@dataclass(frozen=True, slots=True)
class DenoisingTuning(Tunables):
    """What counts as noise, how it is estimated, and how long a sample may wait."""

    kept_below_hz: float = tunable(
        5.0,
        unit="Hz",
        low=0.5,
        high=50.0,
        source="choice: heave, pitch and roll of a car on its springs are 1-2 Hz, a driver's doing is slower; wheel hop"
        " (10-15 Hz), engine and body are above (Gillespie 1992, ch. 5)",
    )
    threshold_sds: float = tunable(
        3.0,
        unit="1",
        low=0.0,
        high=10.0,
        source="universal threshold sqrt(2 ln n) of Donoho & Johnstone (1994) for the n = 100 details of a second",
    )
    hop_margins: int = tunable(
        1,
        unit="margins",
        low=1,
        high=16,
        source="choice: samples that each window adds, in margins; 1 is the least latency, more is less work",
    )
    memory_s: float = tunable(
        20.0,
        unit="s",
        low=0.1,
        high=3600.0,
        source="choice: road and speed change the noise over tens of seconds; a window's own estimate is off by 25 %",
    )
    most_rise: float = tunable(
        2.0,
        unit="1",
        low=0.1,
        high=100.0,
        source="choice: excess of a window over the noise so far that is believed; rough ground is learnt at 10 s"
        " an e-fold, and a crash that fills a window raises the noise by 6 %",
    )
    most_fall: float = tunable(
        0.5,
        unit="1",
        low=0.01,
        high=0.99,
        source="choice: shortfall that is believed; a stop lets the noise fall by an e-fold in 40 s",
    )
    least_accel_sd_mps2: float = tunable(
        1e-4,
        unit="m/s2",
        low=1e-9,
        high=0.1,
        source="choice: a tenth of the best MEMS's noise; less is a converter that does not move",
    )
    least_gyro_sd_radps: float = tunable(
        1e-6, unit="rad/s", low=1e-11, high=1e-3, source="choice, as least_accel_sd_mps2"
    )
    gap_s: float = tunable(
        0.2,
        unit="s",
        low=0.01,
        high=10.0,
        source="choice: one period of kept_below_hz; across a longer silence no detail goes on",
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Window:
    """Samples to decompose together, of which ``[first, until)`` come out; the rest is margin."""

    t_ns: TimeArray
    rows: FloatArray
    first: int
    until: int
    sampled_s: float
    """Time that what comes out lasts."""


class Denoiser:
    """Removes high-frequency noise from one vehicle's inertial samples as they come; each comes out once, later.

    The multi-resolution analysis of seed 1 (sec. 2.2) in a stream. Windows overlap by a margin as wide as the
    transform reaches, and begin at multiples of its coarsest step since the series began: inside a window the
    coefficients are those of the whole series, so windows leave no seam but for the thresholds' slow change.
    Detail coefficients are shrunk, the approximation is kept. What comes out depends on the samples alone, to the
    bit, however they come in packets.

    The noise of each level and axis is the median absolute deviation of a window's details, which a pulse shorter
    than half the window hardly moves (Donoho & Johnstone 1994; by level, since vibration is coloured: Johnstone &
    Silverman 1997), followed over windows with bounded steps (``DenoisingTuning``). Shrinkage is the non-negative
    garrote d - t^2/d (Gao 1998): unlike soft thresholding it leaves large details, a crash's, nearly as they are, and
    unlike hard thresholding it has no jump that would make noise at the threshold come and go.

    Of a crash pulse of 60-150 ms and 3 g in noise of 0.37 m/s2 less than 5 % of the peak is lost, of 8 g 2 %, of 20 g
    1 %, and of the change of velocity less than 0.05 m/s (tests/core/test_denoising.py).

    A silence above ``gap_s`` ends the series: what waits comes out, and the next sample begins a new one. A series
    shorter than a margin comes out as it went in.

    Parameters
    ----------
    rate_hz : float
        Nominal rate of the samples; jitter about it is not resampled, times come out as they went in.
    tuning : DenoisingTuning

    Raises
    ------
    InvalidInputError
        If the rate leaves no level of details above ``kept_below_hz``.
    """

    def __init__(self, rate_hz: float, tuning: DenoisingTuning | None = None) -> None:
        self.tuning = DenoisingTuning() if tuning is None else tuning
        lowest_hz = 4.0 * self.tuning.kept_below_hz
        if not lowest_hz <= rate_hz <= HIGHEST_RATE_HZ:
            raise InvalidInputError(
                f"{rate_hz:g} samples a second cannot be denoised: expected {lowest_hz:g} Hz (details above"
                f" {self.tuning.kept_below_hz:g} Hz need it) to {HIGHEST_RATE_HZ:g} Hz"
            )
        self.rate_hz = rate_hz
        self.levels: Final = int(math.log2(rate_hz / (2.0 * self.tuning.kept_below_hz)))
        self.margin: Final = (_TAPS - 1) << self.levels
        self.hop: Final = self.margin * self.tuning.hop_margins
        self._t_ns: TimeArray = np.empty(0, np.int64)
        self._rows: FloatArray = np.empty((0, AXES))
        self._told = 0  # of the samples held, how many have come out and stay as margin
        self._noise_sd: FloatArray = np.zeros((self.levels, AXES))

    @property
    def latency_samples(self) -> int:
        """How many later samples a sample waits for, at most."""
        return self.hop + self.margin - 1

    @property
    def latency_s(self) -> float:
        """Time that a sample waits at the nominal rate, at most; before a silence, as long as that lasts."""
        return self.latency_samples / self.rate_hz

    @property
    def lowest_detail_hz(self) -> float:
        """Where the details begin: below, nothing is changed."""
        return self.rate_hz / float(2 << self.levels)

    @property
    def noise_sd(self) -> FloatArray:
        """Sd of the details (levels, 6), finest level first, m/s2 and rad/s; 0 before any was seen."""
        return self._noise_sd.copy()

    def step(self, t_ns: TimeArray, rows: FloatArray) -> Samples:
        """Take samples, finite and later than all before; those that have waited long enough come out."""
        return denoise_batch([self], [(t_ns, rows)])[0]

    def flush(self) -> Samples:
        """Let out what waits, as a silence would; the next sample begins a new series."""
        return _denoise([self], [self._close()])[0]

    def arrays(self) -> dict[str, npt.NDArray[np.generic]]:
        """Its whole state by name, from which ``load`` goes on to the bit."""
        return {
            "t_ns": self._t_ns,
            "rows": self._rows,
            "told": np.array([self._told], np.int64),
            "noise_sd": self._noise_sd,
        }

    def load(self, arrays: Mapping[str, npt.NDArray[np.generic]]) -> None:
        """Take over what ``arrays`` gave; raises InvalidInputError if it was of another number of levels."""
        noise_sd = np.array(arrays["noise_sd"], np.float64)
        if noise_sd.shape != self._noise_sd.shape:
            raise InvalidInputError(
                f"this state has {noise_sd.shape[0]} levels of details: expected {self.levels}, those of"
                f" {self.rate_hz:g} samples a second"
            )
        self._t_ns = np.array(arrays["t_ns"], np.int64)
        self._rows = np.array(arrays["rows"], np.float64)
        self._told = int(np.array(arrays["told"], np.int64)[0])
        self._noise_sd = noise_sd

    def _take(self, t_ns: TimeArray, rows: FloatArray) -> list[_Window]:
        """The windows that are full with these samples, or closed by a silence in them."""
        if rows.shape != (t_ns.shape[0], AXES):
            raise InvalidInputError(f"rows have the shape {rows.shape}: expected ({t_ns.shape[0]}, {AXES})")
        gap_ns = round(self.tuning.gap_s * 1e9)
        windows: list[_Window] = []
        silent = np.flatnonzero(np.diff(t_ns, prepend=self._t_ns[-1:]) > gap_ns) + (0 if self._t_ns.size else 1)
        begin = 0
        for end in [*silent.tolist(), t_ns.shape[0]]:
            self._t_ns = np.concatenate([self._t_ns, t_ns[begin:end]])
            self._rows = np.concatenate([self._rows, rows[begin:end]])
            windows += self._full()
            if end < t_ns.shape[0]:
                windows += self._close()
            begin = end
        return windows

    def _full(self) -> list[_Window]:
        windows = []
        start = 0
        while self._t_ns.shape[0] - start >= self._told + self.hop + self.margin:
            until = self._told + self.hop
            windows.append(self._window(start, start + until + self.margin, until))
            kept = min(until, self.margin)
            start += until - kept
            self._told = kept
        self._t_ns, self._rows = self._t_ns[start:], self._rows[start:]
        return windows

    def _close(self) -> list[_Window]:
        held = self._t_ns.shape[0]
        windows = [self._window(0, held, held)] if held > self._told else []
        self._t_ns, self._rows, self._told = self._t_ns[:0], self._rows[:0], 0
        return windows

    def _window(self, start: int, end: int, until: int) -> _Window:
        sampled_s = (until - self._told) / self.rate_hz
        return _Window(self._t_ns[start:end], self._rows[start:end], self._told, until, sampled_s)


def denoise_batch(denoisers: Sequence[Denoiser], packets: Sequence[Samples]) -> list[Samples]:
    """``Denoiser.step`` of many vehicles, a packet each, with one transform for all windows of a length.

    The same bits as singly. A vehicle may come once.
    """
    return _denoise(denoisers, [d._take(*packet) for d, packet in zip(denoisers, packets, strict=True)])


def _denoise(denoisers: Sequence[Denoiser], due: Sequence[Sequence[_Window]]) -> list[Samples]:
    """What comes out of each vehicle's windows; their noise goes on."""
    done: list[list[FloatArray]] = [[w.rows[w.first : w.until] for w in windows] for windows in due]
    alike: dict[tuple[int, DenoisingTuning], list[int]] = {}
    for vehicle, denoiser in enumerate(denoisers):
        alike.setdefault((denoiser.levels, denoiser.tuning), []).append(vehicle)
    for (levels, tuning), vehicles in alike.items():
        places = [
            (vehicle, index)
            for vehicle in vehicles
            for index, window in enumerate(due[vehicle])
            if window.t_ns.shape[0] >= denoisers[vehicle].margin
        ]
        if not places:
            continue
        by_length: dict[int, list[int]] = {}
        for place, (vehicle, index) in enumerate(places):
            by_length.setdefault(due[vehicle][index].t_ns.shape[0], []).append(place)
        found = np.empty((len(places), levels, AXES))
        pieces = {}
        for length, members in by_length.items():
            stack = np.stack([due[v][i].rows.T for v, i in (places[place] for place in members)])
            pieces[length] = pywt.wavedec(stack, WAVELET, _EXTENSION, levels, axis=-1)
            for level in range(levels):
                found[members, level] = _sd(pieces[length][levels - level])
        owners = np.array([vehicles.index(v) for v, _ in places])
        shares = np.array([min(1.0, due[v][i].sampled_s / tuning.memory_s) for v, i in places])
        noise_sd = np.stack([denoisers[v]._noise_sd for v in vehicles])
        least = np.repeat([tuning.least_accel_sd_mps2, tuning.least_gyro_sd_radps], AXES // 2)
        thresholds = tuning.threshold_sds * _follow(
            noise_sd, owners, found, shares, least, tuning.most_rise, tuning.most_fall
        )
        for row, vehicle in enumerate(vehicles):
            denoisers[vehicle]._noise_sd = noise_sd[row]
        for length, members in by_length.items():
            coefficients = pieces[length]
            for level in range(levels):
                at = levels - level
                coefficients[at] = _garrote(coefficients[at], thresholds[members, level, :, None])
            clean = pywt.waverec(coefficients, WAVELET, _EXTENSION, axis=-1)
            for rows, place in zip(clean, members, strict=True):
                vehicle, index = places[place]
                window = due[vehicle][index]
                done[vehicle][index] = rows[:, window.first : window.until].T
    return [
        (
            np.concatenate([np.empty(0, np.int64), *(w.t_ns[w.first : w.until] for w in windows)]),
            np.concatenate([np.empty((0, AXES)), *done[vehicle]]),
        )
        for vehicle, windows in enumerate(due)
    ]


def _sd(details: FloatArray) -> FloatArray:
    """Sd (k, 6) of details (k, 6, n) by their median absolute deviation from zero, their mean."""
    middle = details.shape[-1] // 2
    return np.asarray(np.partition(np.abs(details), middle, axis=-1)[..., middle] / _MAD_PER_SD)


def _garrote(details: FloatArray, threshold: FloatArray) -> FloatArray:
    """Non-negative garrote (Gao 1998); a threshold of zero changes nothing."""
    kept = np.abs(details) > threshold
    shrink = np.divide(threshold * threshold, details, out=np.zeros_like(details), where=kept)
    return np.where(kept, details - shrink, 0.0)


@njit(cache=True, nogil=True)
def _follow(
    noise_sd: FloatArray,
    owners: npt.NDArray[np.int64],
    found: FloatArray,
    shares: FloatArray,
    least: FloatArray,
    most_rise: float,
    most_fall: float,
) -> FloatArray:
    """Noise (k, levels, 6) at each of k windows in turn, from each one's own estimate; ``noise_sd`` goes on in place.

    A first-order low-pass with bounded innovation (Huber): (vehicles, levels, 6) for the vehicle that owns the window.
    """
    followed = np.empty(found.shape)
    for k in range(found.shape[0]):
        now = noise_sd[owners[k]]
        for level in range(found.shape[1]):
            for axis in range(found.shape[2]):
                so_far = now[level, axis]
                if so_far < least[axis]:  # none seen yet but a converter's that does not move, and rounding
                    now[level, axis] = found[k, level, axis]
                else:
                    excess = min(most_rise, max(-most_fall, found[k, level, axis] / so_far - 1.0))
                    now[level, axis] = so_far * (1.0 + shares[k] * excess)
                followed[k, level, axis] = now[level, axis]
    return followed
