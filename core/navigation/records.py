"""One record for every aid, let in or not: what it measured against what was expected, and what became of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from core.measurements import FloatArray, TimeArray
from core.navigation.track import joined_tables

RECORD_COLUMNS: Final = ("aid", "axis", "innovation", "variance", "ratio", "outcome")
"""``aid`` and ``outcome`` are indices of ``state.AIDS`` and ``state.OUTCOMES``; ``axis`` counts the components of an
aid (north, east, down; or lateral, vertical; or 0). ``innovation`` is z - h(x) in the aid's unit, ``variance`` the
one expected of it, ``ratio`` the innovation's square over gate times variance: above 1 it is out of its gate. Where
an aid was refused before it was compared (by time or range), all three are NaN."""

RECORD: Final = {name: index for index, name in enumerate(RECORD_COLUMNS)}


@dataclass(frozen=True, slots=True, eq=False)
class AidRecords:
    """Records in the order in which the aids came in: ``t_ns`` (m,), ``values`` (m, len(RECORD_COLUMNS))."""

    t_ns: TimeArray
    values: FloatArray

    def column(self, name: str) -> FloatArray:
        """One column by its name in ``RECORD_COLUMNS``, (m,)."""
        return self.values[:, RECORD[name]]

    def of(self, aid: int, axis: int = 0) -> AidRecords:
        """Those of one aid and axis."""
        kept: npt.NDArray[np.bool_] = (self.column("aid") == aid) & (self.column("axis") == axis)
        return AidRecords(self.t_ns[kept], self.values[kept])

    @classmethod
    def joined(cls, parts: Sequence[AidRecords]) -> AidRecords:
        """All records of some, one after the other."""
        return cls(*joined_tables([(one.t_ns, one.values) for one in parts], len(RECORD_COLUMNS)))
