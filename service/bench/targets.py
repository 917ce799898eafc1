"""What is asked, of the navigation and in general: each figure with where it stands among those measured."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from service.bench.recorded_outages import LIMIT


@dataclass(frozen=True, slots=True)
class Target:
    """A figure, by its path among the figures, and what it may be at most: a number, or a share of another figure.

    ``floor`` is the path of what it is where only what it is compared with is left out: what any interpolation leaves.
    """

    text: str
    figure: str
    at_most: float | str
    unit: str = "m"
    share: float = 1.0
    floor: str | None = None


def _synthetic(aiding: str, instant: str) -> str:
    return f"synthetic/aidings/{aiding}/at_{instant}/rms_m"


TARGETS: Final = (
    Target("48 simulated outages, constrained, after 30 s", _synthetic("constrained", "30_s"), 1.5),
    Target("48 simulated outages, constrained, after 60 s", _synthetic("constrained", "60_s"), 3.2),
    # KF-GINS on such input, as measured for the design.
    Target("48 simulated outages, position only, after 30 s", _synthetic("position_only", "30_s"), 7.7),
    Target("48 simulated outages, position only, after 60 s", _synthetic("position_only", "60_s"), 24.6),
    Target(
        "48 simulated outages, with wheel speed, after 30 s",
        _synthetic("wheel", "30_s"),
        _synthetic("constrained", "30_s"),
    ),
    Target(
        "48 simulated outages, with wheel speed, after 60 s",
        _synthetic("wheel", "60_s"),
        _synthetic("constrained", "60_s"),
    ),
    Target("kth_stockholm, 99 s from 200 s, RMS", "real/kth_stockholm/outage/causal/rms_m", 6.0),
    Target("kth_stockholm, 30 s every 45 s, median end", "real/kth_stockholm/sweep/causal/median_end_m", 8.0),
    Target("boston_vn100, 30 s every 45 s, median end", "real/boston_vn100/sweep/causal/median_end_m", 15.0),
    Target("comma2k19_segment, 30 s from 20 s, RMS", "real/comma2k19_segment/outage/causal/rms_m", 3.0),
    *(
        Target(
            f"{text}, smoothed",
            f"real/{place}/smoothed/{key}",
            f"real/{place}/causal/{key}",
            share=1 / 3,
            floor=f"real/{place}/{LIMIT}/{key}",
        )
        for text, place, key in (
            ("kth_stockholm, 99 s from 200 s, RMS", "kth_stockholm/outage", "rms_m"),
            ("kth_stockholm, 30 s every 45 s, median end", "kth_stockholm/sweep", "median_end_m"),
            ("boston_vn100, 30 s every 45 s, median end", "boston_vn100/sweep", "median_end_m"),
            ("comma2k19_segment, 30 s from 20 s, RMS", "comma2k19_segment/outage", "rms_m"),
        )
    ),
    Target("outages where calibration made it no better", "calibration/calibrated_not_better", 0, ""),
    Target("outages where GNSS alone was no worse, uncalibrated", "calibration/uncalibrated_not_beating_gnss", 0, ""),
    Target("outages where GNSS alone was no worse, calibrated", "calibration/calibrated_not_beating_gnss", 0, ""),
)


def judged(found: Mapping[str, Any], targets: Sequence[Target] = TARGETS) -> list[dict[str, Any]]:
    """Each target whose part was measured: its value, its limit, and whether it is met."""
    rows = []
    for target in targets:
        if target.figure.split("/")[0] not in found:
            continue
        value = _figure(found, target.figure)
        limit = _figure(found, target.at_most) if isinstance(target.at_most, str) else float(target.at_most)
        limit = None if limit is None else target.share * limit
        met = value is not None and limit is not None and value <= limit
        row = {"text": target.text, "value": value, "at_most": limit, "unit": target.unit, "met": met}
        if target.floor is not None:
            row["floor"] = _figure(found, target.floor)
        rows.append(row)
    return rows


def _figure(found: Any, path: str) -> float | None:
    for key in path.split("/"):
        found = found[key]
    return None if found is None else float(found)
