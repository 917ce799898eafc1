"""The navigation's figures: outages simulated and recorded, honesty of its spread, the worth of calibration."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final

from service.bench import calibration_gain, consistency, mobile_mapping, recorded_outages, simulated_outages
from service.bench.simulated_outages import Tell
from service.bench.targets import judged
from service.errors import UsageError

DRIVES: Final = Path(__file__).resolve().parents[3] / "shared" / "drives"
"""Where recorded drives are looked for when no place is said: beside the checkout."""

PARTS: Final[dict[str, Callable[[Tell], dict[str, Any]]]] = {
    "synthetic": simulated_outages.measure,
    "road": partial(simulated_outages.measure, scenario=simulated_outages.ON_THE_ROAD),
    "consistency": consistency.measure,
    "calibration": calibration_gain.measure,
}
RECORDED: Final = "real"
"""The part that needs recorded drives."""
MAPPING: Final = "seed3"
"""The part that has some of its gaps in recorded drives."""
PART_NAMES: Final = (*PARTS, RECORDED, MAPPING)


def measure(parts: Sequence[str], drives: Path | None, tell: Callable[[str, float, float], None]) -> dict[str, Any]:
    """Figures by part. Without ``parts`` all of them, the recorded drives only where they are.

    Raises UsageError where drives are asked for, by a part or a place, and are not there.
    """
    for part in parts:
        if part not in PART_NAMES:
            raise UsageError(f"--part {part}: expected one of {', '.join(PART_NAMES)}")
    folder = DRIVES if drives is None else drives
    asked = [name for name in PART_NAMES if name in parts or not parts]
    missing = [name for name in recorded_outages.DRIVES if not (folder / name).is_dir()]
    if RECORDED in asked and missing:
        if drives is not None or RECORDED in parts:
            raise UsageError(f"{folder}: no drive folder '{missing[0]}'; say by --drives where the recorded drives are")
        asked.remove(RECORDED)
    found: dict[str, Any] = {}
    for name in asked:

        def told(done: float, total: float, part: str = name) -> None:
            tell(part, done, total)

        if name == RECORDED:
            found[name] = recorded_outages.measure(folder, told)
        elif name == MAPPING:
            found[name] = mobile_mapping.measure(told, None if missing else folder)
        else:
            found[name] = PARTS[name](told)
    return found | {"targets": judged(found)}
