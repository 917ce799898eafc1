"""The accident engine's figures: found, placed, measured, and not cried wolf; the paper's rule on the same input."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final

from service.bench import (
    accident_classes,
    accident_corpus,
    accident_drives,
    accident_long,
    accident_recordings,
    accident_reliability,
)
from service.bench.accident_targets import TARGETS
from service.bench.calibration_recordings import PLACE
from service.bench.navigation import DRIVES
from service.bench.simulated_outages import Tell
from service.bench.targets import judged
from service.errors import UsageError

PARTS: Final[dict[str, Callable[[Tell], dict[str, Any]]]] = {
    "seed1": accident_drives.seed1,
    "corpus": accident_corpus.measure,
    "errors": accident_drives.errors,
    "classes": accident_classes.measure,
    "reliability": accident_reliability.measure,
}
LONG: Final = "long"
RECORDED: Final = "recordings"
PART_NAMES: Final = (*PARTS, LONG, RECORDED)
MOST_KM: Final = 10_000_000.0


def measure(
    parts: Sequence[str],
    km: float,
    recordings: Path | None,
    drives: Path | None,
    tell: Callable[[str, float, float], None],
) -> dict[str, Any]:
    """Figures by part; without ``parts`` all of them, those from recordings only where these are.

    Raises UsageError where recordings are asked for, by a part or a place, and are not there.
    """
    for part in parts:
        if part not in PART_NAMES:
            raise UsageError(f"--part {part}: expected one of {', '.join(PART_NAMES)}")
    if not 0.0 < km <= MOST_KM:
        raise UsageError(f"--km {km:g}: expected above 0 and at most {MOST_KM:g}")
    place = PLACE if recordings is None else recordings
    asked = [name for name in PART_NAMES if name in parts or not parts]
    lacking = accident_recordings.missing(place)
    found: dict[str, Any] = {}
    if RECORDED in asked and lacking:
        if recordings is not None or RECORDED in parts:
            raise UsageError(f"{place}: no '{lacking[0]}'; say by --recordings where the recordings are")
        asked.remove(RECORDED)
        found["left_out"] = {RECORDED: lacking[0]}
    for name in asked:
        told = partial(tell, name)
        if name == LONG:
            found[name] = accident_long.measure(told, km)
        elif name == RECORDED:
            found[name] = accident_recordings.measure(place, DRIVES if drives is None else drives, told)
        else:
            found[name] = PARTS[name](told)
    return found | {"targets": judged(found, TARGETS)}
