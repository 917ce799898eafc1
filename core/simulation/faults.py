"""The catalogue of faults that a recording can be given, to see what the navigation makes of them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

import numpy as np

from core.errors import InvalidInputError
from core.simulation import gnss_faults, sensor_faults
from core.simulation.gnss_faults import Span
from core.simulation.stream import Stream


@dataclass(frozen=True, slots=True)
class FaultKind:
    """A way in which measurements go wrong.

    Parameters
    ----------
    text : str
        What happens, in a line.
    apply : callable
        (stream, span, size, rng) to the stream with the fault.
    unit, size, low, high : str, float, float, float
        Unit of the size, what it is where none is asked for, and its range. ``low`` equals ``high`` where there is
        no size to choose.
    duration_s : float
        How long it lasts where nothing is asked for.
    in_folder : bool
        Whether a drive folder can hold it: there time increases, and nothing says when a sample came.
    """

    text: str
    apply: Callable[[Stream, Span, float, np.random.Generator], Stream]
    unit: str
    size: float
    low: float
    high: float
    duration_s: float
    in_folder: bool = True


FAULTS: Final[Mapping[str, FaultKind]] = MappingProxyType(
    {
        "outliers": FaultKind(
            f"{gnss_faults.OUTLIER_SHARE:.0%} of the fixes are wild, by a normal error of the size on each axis",
            gnss_faults.outliers, "m", 50.0, 0.0, 1e5, 30.0,
        ),
        "jump": FaultKind(
            "all positions lie off by the size; velocities are true", gnss_faults.jump, "m", 60.0, 0.0, 1e5, 20.0
        ),
        "multipath_ramp": FaultKind(
            "positions drift off at the size and come back at once; velocities are true",
            gnss_faults.multipath_ramp, "m/s", 1.0, 0.0, 100.0, 20.0,
        ),
        "spoof": FaultKind(
            f"positions and velocities are dragged off by the size within {gnss_faults.PULL_OFF_S:g} s and let go",
            gnss_faults.spoof, "m", 60.0, 0.0, 1e4, 45.0,
        ),
        "frozen": FaultKind(
            "the receiver repeats its last fix, velocity included", gnss_faults.frozen, "1", 0.0, 0.0, 0.0, 15.0
        ),
        "frozen_at_rest": FaultKind(
            "the receiver repeats its last position and says that it stands",
            gnss_faults.frozen_at_rest, "1", 0.0, 0.0, 0.0, 15.0,
        ),
        "receiver_clock": FaultKind(
            "times of the fixes are ahead of the box's by the size (behind where negative)",
            gnss_faults.receiver_clock, "s", 1.0, -3600.0, 3600.0, 20.0, in_folder=False,
        ),
        "late": FaultKind(
            "fixes with right times come up to the size late", gnss_faults.late, "s", 2.0, 0.0, 60.0, 60.0,
            in_folder=False,
        ),
        "box_clock": FaultKind(
            "from the start on, all times are ahead by the size (behind where negative)",
            sensor_faults.box_clock, "s", 3.0, -1e6, 1e6, 0.0, in_folder=False,
        ),
        "drops": FaultKind(
            "the size's share of the inertial samples is missing here and there",
            sensor_faults.drops, "1", 0.3, 0.0, 1.0, 30.0,
        ),
        "gaps": FaultKind(
            f"inertial samples are missing for the size, every {sensor_faults.GAP_EVERY_S:g} s",
            sensor_faults.gaps, "s", 0.5, 0.0, sensor_faults.GAP_EVERY_S, 30.0,
        ),
        "duplicates": FaultKind(
            "each sample and fix comes as often as the size says",
            sensor_faults.duplicates, "1", 2.0, 1.0, 100.0, 30.0, in_folder=False,
        ),
        "saturation": FaultKind(
            "a loose box rattles by the size and its accelerometer clips",
            sensor_faults.saturation, "m/s2", 40.0, 0.0, 1e4, 2.0,
        ),
        "temperature": FaultKind(
            "the box warms up by the size and its biases follow",
            sensor_faults.temperature, "K", 25.0, -100.0, 100.0, 600.0,
        ),
        "stuck_gyroscope": FaultKind(
            "one axis of the gyroscope (0, 1, 2) says what it said last",
            sensor_faults.stuck_gyroscope, "axis", 2.0, 0.0, 2.0, 5.0,
        ),
        "stuck_accelerometer": FaultKind(
            "one axis of the accelerometer (0, 1, 2) says what it said last",
            sensor_faults.stuck_accelerometer, "axis", 0.0, 0.0, 2.0, 5.0,
        ),
        "not_a_number": FaultKind(
            f"samples and fixes are NaN for the size, every {sensor_faults.GAP_EVERY_S:g} s",
            sensor_faults.not_a_number, "s", 0.5, 0.0, sensor_faults.GAP_EVERY_S, 30.0,
        ),
        "frozen_speed": FaultKind(
            "the wheel speed stays what it was", sensor_faults.frozen_speed, "1", 0.0, 0.0, 0.0, 15.0
        ),
    }
)  # fmt: skip
"""Faults by name. All sizes are choices, such as are met: each is told apart in ``telefuse simulate --list``."""


@dataclass(frozen=True, slots=True)
class Fault:
    """A fault of a kind in ``FAULTS`` over a span: seconds since the first inertial sample comes.

    Raises
    ------
    InvalidInputError
        If the kind is unknown, or span or size out of range.
    """

    kind: str
    start_s: float
    duration_s: float
    size: float

    @classmethod
    def of(cls, kind: str, start_s: float, duration_s: float | None = None, size: float | None = None) -> Fault:
        """With the kind's own duration and size where none are given."""
        if kind not in FAULTS:
            raise InvalidInputError(f"unknown fault '{kind}': expected one of {', '.join(FAULTS)}")
        usual = FAULTS[kind]
        return cls(
            kind,
            start_s,
            usual.duration_s if duration_s is None else duration_s,
            usual.size if size is None else size,
        )

    def __post_init__(self) -> None:
        if self.kind not in FAULTS:
            raise InvalidInputError(f"unknown fault '{self.kind}': expected one of {', '.join(FAULTS)}")
        usual = FAULTS[self.kind]
        if not (math.isfinite(self.start_s) and math.isfinite(self.duration_s) and self.duration_s >= 0.0):
            raise InvalidInputError(
                f"fault {self.kind} from {self.start_s:g} s for {self.duration_s:g} s: expected a duration of 0 or more"
            )
        if not usual.low <= self.size <= usual.high:
            raise InvalidInputError(
                f"fault {self.kind} of {self.size:g}: expected {usual.low:g} to {usual.high:g} {usual.unit}"
            )

    @property
    def end_s(self) -> float:
        """Where it ends."""
        return self.start_s + self.duration_s


def inject(stream: Stream, faults: Sequence[Fault], rng: np.random.Generator) -> Stream:
    """The stream with these faults, one upon the other in their order; the same generator gives the same bits."""
    if not stream.comes_ns["imu"].size:
        return stream
    zero_ns = int(stream.comes_ns["imu"][0])
    for fault, own_rng in zip(faults, rng.spawn(len(faults)), strict=True):
        span = (zero_ns + round(fault.start_s * 1e9), zero_ns + round(fault.end_s * 1e9))
        stream = FAULTS[fault.kind].apply(stream, span, fault.size, own_rng)
    return stream
