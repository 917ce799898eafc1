"""The longest stretch of a recording in which the box lay still and no sample is missing: what noise is told from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from core.calibration.gyroscope_problem import GAP_SAMPLES
from core.calibration.recording import CalibrationRecording
from core.calibration.section_means import converter_steps
from core.errors import InvalidInputError
from core.measurements import FloatArray
from core.tunables import Tunables, tunable

STEP_SAMPLES: Final = 100_000
"""Samples that tell the converter's step: ten minutes show every value that rest has."""


@dataclass(frozen=True, slots=True)
class RestSettings(Tunables):
    """When a box counts as lying still, in blocks of samples."""

    block_s: float = tunable(1.0, unit="s", low=0.1, high=60.0, source="choice: a knock is over, a hand is not still")
    quiet_share: float = tunable(
        0.1, unit="1", low=0.01, high=0.5, source="choice: of all blocks, so many are quiet in any useful recording"
    )
    spread_factor: float = tunable(
        3.0, unit="1", low=1.5, high=20.0, source="choice: sd over that of quiet blocks; noise itself makes 1.3 at most"
    )
    tilt_mps2: float = tunable(
        0.1,
        unit="m/s2",
        low=0.01,
        high=5.0,
        source="choice: 0.6 deg from block to block; warmth takes minutes to do that",
    )
    turn_radps: float = tunable(
        0.02, unit="rad/s", low=1e-3, high=1.0, source="choice: 1 deg/s from block to block; a bias takes hours to"
    )
    gap_samples: float = tunable(
        GAP_SAMPLES, unit="1", low=1.1, high=100.0, source="choice: as between the positions of a calibration"
    )
    least_s: float = tunable(10.0, unit="s", low=1.0, high=3600.0, source="choice: shorter tells no noise worth having")


@dataclass(frozen=True, slots=True)
class LongestRest:
    """Rows ``first`` to ``end`` (exclusive) at rest; what the other rows lack is counted in seconds."""

    first: int
    end: int
    moving_s: float
    gaps: int


def longest_rest(recording: CalibrationRecording, settings: RestSettings | None = None) -> LongestRest:
    """The longest stretch at rest of a recording in m/s2 and rad/s.

    Raises
    ------
    InvalidInputError
        If it is shorter than ``least_s``.
    """
    s = RestSettings() if settings is None else settings
    t_s = recording.t_s
    interval_s = float(np.median(np.diff(t_s))) if t_s.size > 1 else s.block_s
    size = max(round(s.block_s / interval_s), 4)
    blocks = t_s.size // size
    if blocks * size * interval_s < s.least_s:
        raise InvalidInputError(
            f"the recording lasts {t_s.size * interval_s:.1f} s; expected at least {s.least_s:g} s at rest, hours for "
            "the instability of the bias"
        )
    moving = _moving(recording.accelerometer, blocks, size, s, s.tilt_mps2)
    if recording.gyroscope is not None:
        moving |= _moving(recording.gyroscope, blocks, size, s, s.turn_radps)
    gap_rows = np.flatnonzero(np.diff(t_s) > s.gap_samples * interval_s) + 1
    # Rows of moving blocks are lost, and each gap begins a new stretch.
    rows = (np.flatnonzero(moving)[:, None] * size + np.array([0, size])).ravel()
    edges = np.unique(np.concatenate([[0, blocks * size], gap_rows[gap_rows < blocks * size], rows]))
    still = np.array([not moving[min(low // size, blocks - 1)] for low in edges[:-1]])
    lengths = np.diff(edges) * still
    best = int(np.argmax(lengths))
    first, end = int(edges[best]), int(edges[best + 1])
    if end == blocks * size and not moving[-1]:
        end = t_s.size
    moving_s = float(moving.sum()) * size * interval_s
    if (end - first) * interval_s < s.least_s:
        raise InvalidInputError(
            f"the box was not at rest: it moved in {moving_s:.0f} s of {t_s.size * interval_s:.0f} s"
            + (f" and {gap_rows.size} times samples are missing" if gap_rows.size else "")
            + f", and its longest rest lasts {(end - first) * interval_s:.1f} s; record at least {s.least_s:g} s with "
            "the box lying still, away from steps and engines"
        )
    return LongestRest(first, end, moving_s, int(gap_rows.size))


def _moving(triad: FloatArray, blocks: int, size: int, settings: RestSettings, jump: float) -> npt.NDArray[np.bool_]:
    """Blocks in which a triad spreads more than at rest, or is elsewhere than in the block before; (blocks,)."""
    cut = triad[: blocks * size].reshape(blocks, size, 3)
    mean = cut.mean(axis=1)
    variance = cut.var(axis=1)
    step = converter_steps(triad[:STEP_SAMPLES])
    quiet = np.quantile(variance, settings.quiet_share, axis=0) + 0.25 * step**2
    moving: npt.NDArray[np.bool_] = (variance > settings.spread_factor**2 * quiet).any(axis=1)
    # The mean of a block of quiet noise may itself move that far.
    allowed = jump + 6.0 * np.sqrt(2.0 * quiet / size)
    jumps = np.flatnonzero((np.abs(np.diff(mean, axis=0)) > allowed).any(axis=1))
    moving[jumps] = moving[jumps + 1] = True
    return moving
