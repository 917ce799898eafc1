"""What the filter keeps of the last seconds, to go back for an aid that comes late: states, samples and aids."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from core.measurements import FloatArray, TimeArray
from core.navigation import kernel, state
from core.navigation.pending import Pending


@dataclass(slots=True, eq=False)
class Recent:
    """States at the last whole seconds, and all that was folded in since the oldest of them.

    A state folded on from gives the same bits as the first time, so that an aid can be let in at its own time
    afterwards. Rows that were told meanwhile stand.
    """

    kept: FloatArray = field(default_factory=lambda: np.zeros((kernel.KEPT_SECONDS, kernel.KEPT_WIDTH)))
    kept_ti: TimeArray = field(default_factory=lambda: np.zeros((kernel.KEPT_SECONDS, state.NT), np.int64))
    t_ns: TimeArray = field(default_factory=lambda: np.empty(0, np.int64))
    samples: FloatArray = field(default_factory=lambda: np.empty((0, 7)))
    aids: Pending = field(default_factory=Pending)

    def begin(self, x: FloatArray, ti: TimeArray, p: FloatArray) -> None:
        """Forget everything and start from this state."""
        fresh = Recent()
        self.t_ns, self.samples, self.aids = fresh.t_ns, fresh.samples, fresh.aids
        self.kept_ti[:] = 0
        kernel.keep(x, ti, p, self.kept, self.kept_ti)

    def add(self, t_ns: TimeArray, f_b: FloatArray, omega_b: FloatArray, unsound: FloatArray, aids: Pending) -> None:
        """What was folded in; what lies before the oldest kept state is dropped."""
        oldest_ns = self.oldest_ns
        seen, new = self.t_ns > oldest_ns, t_ns > oldest_ns
        own = np.column_stack([f_b[new], omega_b[new], unsound[new]])
        self.t_ns = np.concatenate([self.t_ns[seen], t_ns[new]])
        self.samples = np.concatenate([self.samples[seen], own])
        self.aids = self.aids.take(self.aids.t_ns > oldest_ns).join(aids.take(aids.t_ns > oldest_ns))

    @property
    def oldest_ns(self) -> int:
        """Time of the oldest state kept."""
        times = self.kept_ti[:, state.T_NOW]
        held = times[times > 0]
        return int(held.min()) if held.size else np.iinfo(np.int64).max

    def slot_before(self, t_ns: int) -> int | None:
        """Which kept state is the newest before a time; None if there is none."""
        times = np.where(self.kept_ti[:, state.T_NOW] < t_ns, self.kept_ti[:, state.T_NOW], 0)
        newest = int(np.argmax(times))
        return newest if times[newest] > 0 else None

    def arrays(self) -> dict[str, npt.NDArray[np.generic]]:
        """State by name, for snapshots."""
        return {
            "kept": self.kept,
            "kept_ti": self.kept_ti,
            "t_ns": self.t_ns,
            "samples": self.samples,
            "aids.t_ns": self.aids.t_ns,
            "aids.rows": self.aids.rows,
        }

    def load(self, arrays: dict[str, npt.NDArray[np.generic]]) -> None:
        """Take over what ``arrays`` gave."""
        for name in ("kept", "kept_ti", "t_ns", "samples"):
            setattr(self, name, arrays[name])
        t_ns: TimeArray = arrays["aids.t_ns"]  # type: ignore[assignment]
        self.aids = Pending(t_ns, t_ns, arrays["aids.rows"])  # type: ignore[arg-type]
