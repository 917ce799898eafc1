"""Roads for the service and the commands: opens a built folder, or says that roads are unknown."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Final, Self

import numpy as np

from service.roads import extra
from service.roads.folder import Manifest, RoadFolder
from service.roads.protocol import (
    FloatArray,
    IntArray,
    MatchedPoints,
    NullMatcher,
    RoadPlace,
)
from service.roads.workers import MatcherProcesses

STRETCH_NS: Final = 60_000_000_000
"""A drive is matched a minute at a time, on lines of absolute time."""
CONTEXT_NS: Final = 60_000_000_000
"""What is matched along on either side, so that an outage of a minute has both its ends in view."""
APART_NS: Final = 900_000_000
"""Positions nearer in time than this are taken together: more often than once a second tells a matcher nothing."""
_CORES: Final = 2


class RoadService:
    """A ``RoadMatcher`` on a built folder, with processes of its own; without a folder everything is unknown."""

    def __init__(self, folder: Path | None, processes: int | None = None) -> None:
        """Open a folder; raises UsageError for one that is none, or where the extra is not installed."""
        self.manifest: Manifest | None = None
        self.processes = processes or min(os.cpu_count() or 1, _CORES)
        self._processes: MatcherProcesses | None = None
        if folder is not None:
            extra.require()
            self.manifest = RoadFolder(folder).manifest()
            self._processes = MatcherProcesses(folder, self.processes)

    @property
    def known(self) -> bool:
        """Whether there are roads."""
        return self.manifest is not None

    def start(self) -> None:
        """Begin; before, and after ``stop``, everything is unknown."""
        if self._processes is not None:
            self._processes.start()

    def stop(self) -> None:
        """End the processes."""
        if self._processes is not None:
            self._processes.stop()

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.stop()

    def match(
        self,
        t_ns: IntArray,
        lat_deg: FloatArray,
        lon_deg: FloatArray,
        sd_m: FloatArray,
        heading_deg: FloatArray | None = None,
    ) -> MatchedPoints:
        """The roads under a drive, as ``RoadMatcher`` says; waits for its processes."""
        if self._processes is None:
            return NullMatcher().match(t_ns, lat_deg, lon_deg, sd_m)
        heading = np.full(t_ns.size, np.nan) if heading_deg is None else heading_deg
        usable = np.flatnonzero(np.isfinite(lat_deg) & np.isfinite(lon_deg) & np.isfinite(sd_m))
        taken = usable[_apart(t_ns[usable])]
        stretches = _stretches(t_ns[taken])
        columns = (t_ns, lat_deg, lon_deg, sd_m, heading)
        found = self._processes.run(
            "match", [[one[taken[first:last]] for one in columns] for first, last, _ in stretches]
        )
        parts = [
            MatchedPoints.unknown(kept.stop - kept.start, failed=True)
            if one is None
            else one.at(np.arange(kept.start - first, kept.stop - first))
            for one, (first, _, kept) in zip(found, stretches, strict=True)
        ]
        matched = MatchedPoints.joined([*parts, MatchedPoints.unknown(1)])
        nowhere = taken.size  # the last one
        source = np.full(t_ns.size, nowhere, np.int64)
        source[usable] = _nearest(t_ns[taken], t_ns[usable])
        return matched.at(source)

    def match_traces(self, traces: Sequence[Sequence[IntArray | FloatArray]]) -> int:
        """Match stretches as they are, columns as of ``match``; how many came back: what a bench counts."""
        if self._processes is None:
            return 0
        return sum(one is not None for one in self._processes.run("match", traces))

    def place(
        self,
        lat_deg: float,
        lon_deg: float,
        covariance_ne_m2: tuple[float, float, float],
        heading_deg: float | None = None,
    ) -> RoadPlace:
        """The likeliest road at one place, such as an accident's; the covariance is north, east, and between them."""
        unknown = RoadPlace.of(MatchedPoints.unknown(1), 0)
        if self._processes is None or not np.isfinite([lat_deg, lon_deg, *covariance_ne_m2]).all():
            return unknown
        north, east, between = covariance_ne_m2
        covariance = np.array([[east, between], [between, north]])
        heading = np.nan if heading_deg is None else heading_deg
        found: RoadPlace | None = self._processes.run("place", [[np.array([lon_deg, lat_deg]), covariance, heading]])[0]
        return found or unknown


def _apart(t_ns: IntArray) -> IntArray:
    """Indices of times of which none is nearer than ``APART_NS`` to the one before it."""
    if t_ns.size < 2 or np.diff(t_ns).min() >= APART_NS:
        return np.arange(t_ns.size)
    kept: list[int] = []
    last = -APART_NS
    for index, t in enumerate(t_ns.tolist()):
        if not kept or t - last >= APART_NS:
            kept.append(index)
            last = t
    return np.array(kept, np.int64)


def _stretches(t_ns: IntArray) -> list[tuple[int, int, slice]]:
    """Minutes of a drive: first and last index with their context, and which indices are the minute's own."""
    if t_ns.size == 0:
        return []
    minute = t_ns // STRETCH_NS
    starts = np.flatnonzero(np.diff(minute, prepend=minute[0] - 1))
    ends = [*starts[1:].tolist(), t_ns.size]
    found = []
    for start, end in zip(starts.tolist(), ends, strict=True):
        first = int(np.searchsorted(t_ns, t_ns[start] - CONTEXT_NS))
        last = int(np.searchsorted(t_ns, t_ns[end - 1] + CONTEXT_NS, side="right"))
        found.append((first, last, slice(start, end)))
    return found


def _nearest(t_ns: IntArray, wanted_ns: IntArray) -> IntArray:
    """Index of the time nearest to each wanted one."""
    after = np.clip(np.searchsorted(t_ns, wanted_ns), 1, max(t_ns.size - 1, 1))
    if t_ns.size < 2:
        return np.zeros(wanted_ns.size, np.int64)
    return np.where(wanted_ns - t_ns[after - 1] <= t_ns[after] - wanted_ns, after - 1, after)
