"""Which rows of a session's track are kept, for boxes whose samples never fall on a whole second."""

from __future__ import annotations

import numpy as np
import pytest

from core.navigation.track import TRACK, TRACK_COLUMNS, Mode, Track
from core.session import Outputs
from schemas.vehicles import VehicleConfig
from service.engine.effects import Effects
from service.ingest.journal_rows import JournalEntry
from service.storage.vehicles import VehicleRef

SECOND_NS = 1_000_000_000
START_NS = 1_750_000_000 * SECOND_NS


def kept_times(t_ns: np.ndarray, mode: Mode, interval_s: float = 1.0, parts: int = 1) -> list[int]:
    values = np.zeros((len(t_ns), len(TRACK_COLUMNS)))
    values[:, TRACK["mode"]] = mode
    effects = Effects(VehicleRef(1, "default", "car", VehicleConfig()), round(interval_s * SECOND_NS))
    for rows in np.array_split(np.arange(len(t_ns)), parts):
        outputs = Outputs(Track(t_ns[rows], values[rows]), (), (), {})
        effects.add(outputs, JournalEntry(1, 1, "boot", 1, START_NS, START_NS, b""))
    return [row["t_ns"] for row in effects._track]


def rows_of(sample_period_ns: int, phase_ns: int, seconds: int) -> np.ndarray:
    """The first sample of each 0.1 s, as the filter puts rows out."""
    samples = START_NS + phase_ns + np.arange(0, seconds * SECOND_NS, sample_period_ns)
    _, first = np.unique(samples // (SECOND_NS // 10), return_index=True)
    return samples[first]


@pytest.mark.parametrize(("period_ns", "phase_ns"), [(5_000_000, 0), (9_600_000, 31_234), (25_000_000, 7)])
def test_one_row_a_second_is_kept_whatever_the_phase_of_the_samples(period_ns: int, phase_ns: int) -> None:
    kept = kept_times(rows_of(period_ns, phase_ns, 30), Mode.AIDED)
    assert [t // SECOND_NS - START_NS // SECOND_NS for t in kept] == list(range(30))


def test_packets_do_not_matter_to_what_is_kept() -> None:
    rows = rows_of(9_600_000, 31_234, 20)
    assert kept_times(rows, Mode.COASTING, parts=7) == kept_times(rows, Mode.COASTING)


def test_all_rows_are_kept_at_the_sessions_own_interval() -> None:
    rows = rows_of(9_600_000, 31_234, 5)
    assert kept_times(rows, Mode.AIDED, interval_s=0.1) == rows.tolist()


def test_rows_of_an_aligning_vehicle_come_with_its_fixes_and_are_kept() -> None:
    fixes = START_NS + 766_400_000 + np.arange(5) * SECOND_NS
    assert kept_times(fixes, Mode.ALIGNING) == fixes.tolist()
