"""The accident that is followed, and a suspected pulse that was none, as they are kept between samples."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from core.accident.events import Impact, impact_of
from core.accident.momentum import Momentum


@dataclass(frozen=True, slots=True)
class Open:
    """The accident that is followed: as it was told last, its log-odds, and when its latest impact ended."""

    impact: Impact
    odds: float
    last_ns: int
    momentum: Momentum | None = None
    airbag: bool = False
    power_loss: bool = False

    @staticmethod
    def of(kept: Mapping[str, Any]) -> Open:
        """Of what ``asdict`` and JSON made of one."""
        momentum = None if kept["momentum"] is None else Momentum.of(kept["momentum"])
        return Open(**(dict(kept) | {"impact": impact_of(kept["impact"]), "momentum": momentum}))


@dataclass(frozen=True, slots=True)
class Weak:
    """A suspected pulse that was judged to be none; a shock around it gives its name."""

    t_ns: int
    odds: float
    delta_v_mps: float
    duration_s: float
    peak_mps2: float
    paper_agrees: bool
