"""A drive with its inertial samples denoised, and how much noise that took from each axis."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from scipy.signal import welch

from core.denoising import WAVELET, Denoiser
from core.full_scale import FullScale
from core.measurements import FloatArray
from core.preparation import valid_samples
from service.errors import UsageError
from service.recordings.drive_folder import IMU_CSV_COLUMNS, Drive

CHUNK: Final = 4096
"""Samples denoised at a time: only progress depends on it, no bit of the result does."""
SEGMENT: Final = 1024
"""Samples of a segment of Welch's spectrum: leaves the band's edge sharp to 0.2 % of the rate."""


@dataclass(frozen=True, slots=True, eq=False)
class Denoised:
    """A denoised drive, with what a stream would have waited for it and sd (6,) above ``band_hz``, raw and left."""

    drive: Drive
    rate_hz: float
    latency_s: float
    levels: int
    band_hz: float
    raw_sd: FloatArray
    left_sd: FloatArray

    def figures(self) -> dict[str, Any]:
        """As ``telefuse fuse --denoise --json`` prints them; dB is null where an axis never moved."""

        def by_axis(values: FloatArray) -> dict[str, float]:
            return {name: float(value) for name, value in zip(IMU_CSV_COLUMNS[1:], values, strict=True)}

        reduction_db: Mapping[str, float | None] = {
            name.split("_")[0]: 20.0 * math.log10(raw / left) if raw > 0.0 and left > 0.0 else None
            for name, raw, left in zip(IMU_CSV_COLUMNS[1:], self.raw_sd, self.left_sd, strict=True)
        }
        return {
            "wavelet": WAVELET,
            "levels": self.levels,
            "rate_hz": self.rate_hz,
            "latency_s": self.latency_s,
            "band_hz": [self.band_hz, 0.5 * self.rate_hz],
            "sd_before": by_axis(self.raw_sd),
            "sd_after": by_axis(self.left_sd),
            "noise_reduction_db": reduction_db,
        }


def denoise(drive: Drive, progress: Callable[[float], None] = lambda share: None) -> Denoised:
    """The drive with its inertial samples denoised as a stream would have it, put back to their own times.

    Samples that a session would leave out stay as they are, and so does what clipped, which the filter must see.
    A box that the engine shakes stands still again where the vehicle does; but the road's shaking goes too, so
    that even driving in an outage, with no other constraint on the speed, can be taken for a standstill.
    Raises UsageError if the samples are too few or too slow.
    """
    m = drive.measurements
    kept, _, _ = valid_samples(m.imu_t_ns, m.f_s, m.omega_s, np.iinfo(np.int64).min)
    t_ns, raw = m.imu_t_ns[kept], np.hstack([m.f_s, m.omega_s])[kept]
    if t_ns.size < 2:
        raise UsageError(f"{drive.name}: {t_ns.size} valid inertial samples: expected at least two to denoise")
    denoiser = Denoiser(rate_hz := 1e9 / float(np.median(np.diff(t_ns))))
    parts = []
    for begin in range(0, t_ns.size, CHUNK):
        parts.append(denoiser.step(t_ns[begin : begin + CHUNK], raw[begin : begin + CHUNK])[1])
        progress(min(1.0, (begin + CHUNK) / t_ns.size))
    clean = np.concatenate([*parts, denoiser.flush()[1]])
    clipped = FullScale().step(raw[:, :3], m.accel_full_scale_mps2) > 0.0
    clean[clipped, :3] = raw[clipped, :3]
    f_s, omega_s = m.f_s.copy(), m.omega_s.copy()
    f_s[kept], omega_s[kept] = clean[:, :3], clean[:, 3:]
    return Denoised(
        drive=replace(drive, measurements=replace(m, f_s=f_s, omega_s=omega_s)),
        rate_hz=rate_hz,
        latency_s=denoiser.latency_s,
        levels=denoiser.levels,
        band_hz=denoiser.lowest_detail_hz,
        raw_sd=_sd_above(raw, rate_hz, denoiser.lowest_detail_hz),
        left_sd=_sd_above(clean, rate_hz, denoiser.lowest_detail_hz),
    )


def _sd_above(rows: FloatArray, rate_hz: float, low_hz: float) -> FloatArray:
    """Sd (6,) of rows (n, 6) from ``low_hz`` up, by Welch's spectrum: another measure than the wavelets' own."""
    hz, density = welch(rows, rate_hz, nperseg=min(SEGMENT, rows.shape[0]), axis=0)
    return np.asarray(np.sqrt(np.sum(density[hz >= low_hz], axis=0) * (hz[1] - hz[0])))
