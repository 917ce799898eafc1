"""The last minute of samples and aids, kept until it is known how the box sits: to be gone through again by then."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from core.measurements import GNSS_COLUMNS, FloatArray, TimeArray
from core.navigation.aids import Aids

PAST_S: Final = 60.0
"""How much is kept, s, 10 to 300. A choice: mountings are found within half a minute of the first pull-away."""

_AIDS: Final = {"gnss": (len(GNSS_COLUMNS),), "magnetic_b_ut": (3,), "speed": (), "pressure_pa": ()}
"""Series of ``Aids`` and the shape of a row."""

_FLAGS: Final = ("saturated", "held")
"""Of ``BodySamples``, what is 0 or 1."""


@dataclass(frozen=True, slots=True, eq=False)
class BodySamples:
    """Calibrated inertial samples in body axes, in increasing time.

    ``saturated`` (n,) is 1 where the accelerometer clipped, ``held`` (n,) where the gyroscope hangs.
    """

    t_ns: TimeArray
    f_b: FloatArray
    omega_b: FloatArray
    saturated: FloatArray
    held: FloatArray


class Past:
    """Keeps what it is given, in order, of the last ``PAST_S``."""

    def __init__(self) -> None:
        self._parts: list[tuple[BodySamples, Aids]] = []
        self._from_ns: TimeArray = np.zeros(1, np.int64)

    def add(self, samples: BodySamples, aids: Aids) -> None:
        """What comes next."""
        self._parts.append((samples, aids))

    def trim(self, t_ns: int) -> None:
        """Let go of what lies longer than ``PAST_S`` before a time."""
        self._from_ns[0] = t_ns - round(PAST_S * 1e9)
        while self._parts and _newest_ns(self._parts[0]) < self._from_ns[0]:
            del self._parts[0]

    def forget(self) -> None:
        """Let go of everything."""
        self._parts.clear()
        self._from_ns[0] = 0

    def joined(self) -> tuple[BodySamples, Aids]:
        """All in one."""
        from_ns = self._from_ns[0]

        def rows(shape: tuple[int, ...], series: list[FloatArray]) -> FloatArray:
            return np.concatenate([np.empty((0, *shape)), *series])

        t_ns = np.concatenate([np.empty(0, np.int64), *(samples.t_ns for samples, _ in self._parts)])
        kept = t_ns >= from_ns
        fields = {
            name: rows(shape, [getattr(samples, name) for samples, _ in self._parts])[kept]
            for name, shape in (("f_b", (3,)), ("omega_b", (3,)), ("saturated", ()), ("held", ()))
        }
        series = {}
        for name, shape in _AIDS.items():
            pairs = [getattr(aids, name) for _, aids in self._parts]
            times = np.concatenate([np.empty(0, np.int64), *(pair[0] for pair in pairs)])
            series[name] = (
                times[times >= from_ns],
                rows(shape, [pair[1] for pair in pairs])[times >= from_ns],
            )
        return BodySamples(t_ns[kept], **fields), Aids(**series)

    def arrays(self) -> dict[str, npt.NDArray[np.generic]]:
        """State by name, for snapshots."""
        samples, aids = self.joined()
        kept: dict[str, npt.NDArray[np.generic]] = {"from_ns": self._from_ns}
        kept |= {name: getattr(samples, name) for name in BodySamples.__slots__}
        # A byte holds a flag as exactly as eight do, and a minute has many.
        kept |= {name: kept[name].astype(np.uint8) for name in _FLAGS}
        for name in _AIDS:
            kept[f"{name}.t_ns"], kept[f"{name}.rows"] = getattr(aids, name)
        return kept

    def load(self, arrays: dict[str, npt.NDArray[np.generic]]) -> None:
        """Take over what ``arrays`` gave."""
        self._from_ns = np.array(arrays["from_ns"], np.int64)
        samples = BodySamples(
            *(arrays[name].astype(np.float64) if name in _FLAGS else arrays[name] for name in BodySamples.__slots__)  # type: ignore[arg-type]
        )
        aids = Aids(*((arrays[f"{name}.t_ns"], arrays[f"{name}.rows"]) for name in _AIDS))  # type: ignore[arg-type]
        self._parts = [(samples, aids)]


def _newest_ns(part: tuple[BodySamples, Aids]) -> int:
    samples, aids = part
    series = (samples.t_ns, aids.gnss[0], aids.magnetic_b_ut[0], aids.speed[0], aids.pressure_pa[0])
    return max((int(t_ns.max()) for t_ns in series if len(t_ns)), default=0)
