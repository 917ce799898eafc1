"""Aids that were let in and wait for their sample, of all kinds in one order of time."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

import numpy as np
import numpy.typing as npt

from core.measurements import GNSS_COLUMNS, FloatArray, TimeArray
from core.navigation.state import AID_WIDTH, K_BARO, K_GNSS, K_MAGNETIC, K_SPEED

COLUMNS: Final = {K_GNSS: len(GNSS_COLUMNS), K_SPEED: 1, K_MAGNETIC: 3, K_BARO: 1}
"""How many values an aid of each kind has."""


def _no_times() -> TimeArray:
    return np.empty(0, np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class Pending:
    """Rows (m, AID_WIDTH) by time ``t_ns``, each with the time ``from_ns`` from which it is known.

    One that is known later than its time is late: the filter has to go back for it.
    """

    t_ns: TimeArray = field(default_factory=_no_times)
    from_ns: TimeArray = field(default_factory=_no_times)
    rows: FloatArray = field(default_factory=lambda: np.empty((0, AID_WIDTH)))

    def __len__(self) -> int:
        return len(self.t_ns)

    def take(self, chosen: npt.NDArray[np.bool_] | slice) -> Pending:
        """Some of them."""
        return Pending(self.t_ns[chosen], self.from_ns[chosen], self.rows[chosen])

    def join(self, other: Pending) -> Pending:
        """Both together by time, at one time by kind: however late one came, the order is the same."""
        if not len(other):
            return self
        t_ns = np.concatenate([self.t_ns, other.t_ns])
        from_ns = np.concatenate([self.from_ns, other.from_ns])
        rows = np.concatenate([self.rows, other.rows])
        order = np.lexsort((rows[:, 0], t_ns))
        return Pending(t_ns[order], from_ns[order], rows[order])

    def of(self, kind: int) -> tuple[TimeArray, FloatArray]:
        """Times and values (n, ...) of one kind; a single value a row becomes (n,)."""
        own = self.rows[:, 0] == kind
        values = self.rows[own, 1 : 1 + COLUMNS[kind]]
        return self.t_ns[own], values[:, 0] if COLUMNS[kind] == 1 else values


def pending(kind: int, t_ns: TimeArray, from_ns: TimeArray, values: FloatArray) -> Pending:
    """Aids of one kind; ``values`` (n,) or (n, columns)."""
    rows = np.zeros((len(t_ns), AID_WIDTH))
    rows[:, 0] = kind
    rows[:, 1 : 1 + COLUMNS[kind]] = values.reshape(len(t_ns), COLUMNS[kind])
    return Pending(t_ns, from_ns, rows)
