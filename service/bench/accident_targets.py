"""What is asked of the accident engine: issue 5."""

from __future__ import annotations

from typing import Final

from service.bench.accident_scoring import OURS
from service.bench.targets import Target

TARGETS: Final = (
    Target("seed 1's drives, accidents missed", f"seed1/{OURS}/missed", 0, ""),
    Target("seed 1's drives, false alarms", f"seed1/{OURS}/false_alarms", 0, ""),
    Target("seed 1's drives, largest error of place", f"seed1/{OURS}/place_error_m/open/max", 10.0),
    Target("seed 1's drives, largest error of place in outages", f"seed1/{OURS}/place_error_m/outage/max", 25.0),
    Target("corpus, missed from 8 km/h up", f"corpus/{OURS}/recall/from_8_kmh/missed", 0.01, "of them"),
    Target("corpus, missed of the low-speed class", f"corpus/{OURS}/recall/low_speed/missed", 0.05, "of them"),
    Target(
        "corpus, change of velocity off by more than 10 % and 1 km/h, unclipped",
        f"corpus/{OURS}/delta_v_unclipped/outside_10_percent_and_1_kmh",
        0.0,
        "of them",
    ),
    Target("corpus, direction off by more than 15 deg", f"corpus/{OURS}/direction/beyond_15_deg", 0.0, "of them"),
    Target("corpus, suspected later than 150 ms", f"corpus/{OURS}/delay/beyond_150_ms", 0.0, "of them"),
    Target("false alarms in 100 000 km of non-accidents", f"long/{OURS}/false_alarms/per_100000_km", 1.0, ""),
    Target("barrier test, not found", "recordings/barrier_missed", 0, ""),
    Target("barrier test, interval without 64.6-66.2 km/h", "recordings/barrier_not_covered", 0, ""),
    Target("500 road shocks, accidents told", f"recordings/shocks/{OURS}/false_alarms", 0, ""),
    Target("harsh trips, accidents told", f"recordings/trips/{OURS}/false_alarms", 0, ""),
    Target("real drives, accidents told", f"recordings/drives/{OURS}/false_alarms", 0, ""),
)
