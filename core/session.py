"""One vehicle's session: a pure fold over its measurements. The order of stages is ``Session.step``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from core.accident.events import Impact
from core.driving.trips import Trip
from core.measurements import Measurements
from core.navigation.track import Mode, Track


@dataclass(frozen=True, slots=True)
class Accident:
    """An impact with its place: where the vehicle was at ``impact.t_ns``, and how sure that is."""

    impact: Impact
    lat_rad: float
    lon_rad: float
    alt_m: float
    sd_n_m: float
    sd_e_m: float
    cov_ne_m2: float
    heading_rad: float
    mode: Mode


@dataclass(frozen=True, slots=True, eq=False)
class Outputs:
    """What one step brought: track rows every 100 ms, accidents, trips begun or changed, and counts.

    ``counts`` names what the step met, such as ``gnss_position.fused``, ``gnss_position.rejected_gate``,
    ``imu.rejected_time``, ``imu.gap``; only non-zero ones.
    """

    track: Track
    accidents: tuple[Accident, ...]
    trips: tuple[Trip, ...]
    counts: Mapping[str, int]


@dataclass(frozen=True, slots=True)
class SessionConfig:
    """What is set for a vehicle and does not change while its session runs."""


class Session:
    """Folds ``Measurements`` of one vehicle, in order, into ``Outputs``."""

    def __init__(self, config: SessionConfig) -> None: ...

    def step(self, measurements: Measurements) -> Outputs:
        """Take the next measurements. Never raises for what they hold."""
        raise NotImplementedError

    def snapshot(self) -> bytes:
        """The whole state as bytes: restored, it goes on to the bit."""
        raise NotImplementedError

    @classmethod
    def restore(cls, config: SessionConfig, data: bytes) -> Session:
        """A session that goes on where ``snapshot`` was taken; raises SnapshotError."""
        raise NotImplementedError
