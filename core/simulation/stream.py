"""Measurements with the instant at which each sample is handed over: what a box sends, packet by packet."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from core.measurements import SERIES, FloatArray, Measurements, TimeArray

Rows = npt.NDArray[np.intp] | slice


@dataclass(frozen=True, slots=True, eq=False)
class Packet:
    """What is handed over at once, and by how much the box's clock is ahead of true time, ns."""

    measurements: Measurements
    clock_ahead_ns: int


@dataclass(frozen=True, slots=True, eq=False)
class Stream:
    """A recording as it is handed over.

    Parameters
    ----------
    measurements : Measurements
        Samples in the order in which they come, with the times that the box says: after a step of a clock they may
        go back.
    comes_ns : mapping of str to (n,) int64
        For each of ``SERIES`` when its samples come, UTC nanoseconds of true time, never decreasing.
    temperature_c : (n,) float64 or None
        Of the box when each inertial sample comes; None where it is that of the measurements.
    """

    measurements: Measurements
    comes_ns: Mapping[str, TimeArray]
    temperature_c: FloatArray | None = None

    @classmethod
    def of(cls, measurements: Measurements) -> Stream:
        """Each sample comes at the time that it says."""
        return cls(measurements, {name: getattr(measurements, fields[0]) for name, fields in SERIES.items()})

    def changed(self, **fields: Any) -> Stream:
        """With other values of some fields of the measurements, as many as before."""
        return replace(self, measurements=replace(self.measurements, **fields))

    def chosen(self, series: str, rows: Rows) -> Stream:
        """Of a series these samples only, by their indices, which may repeat."""
        comes_ns = {**self.comes_ns, series: self.comes_ns[series][rows]}
        warmth = self.temperature_c
        if series == "imu" and warmth is not None:
            warmth = warmth[rows]
        return Stream(replace(self.measurements, **self._rows(series, rows)), comes_ns, warmth)

    def during(self, series: str, span_ns: tuple[int, int]) -> npt.NDArray[np.bool_]:
        """Which samples of a series (n,) come within a span, its end not included."""
        comes_ns = self.comes_ns[series]
        return np.asarray((comes_ns >= span_ns[0]) & (comes_ns < span_ns[1]))

    def packets(self, packet_s: float = 1.0) -> Iterator[Packet]:
        """What comes in each ``packet_s``; no packet holds a step back, as a box counts from its packet's start."""
        all_ns = [comes_ns for comes_ns in self.comes_ns.values() if comes_ns.size]
        if not all_ns:
            return
        first, last = min(int(one[0]) for one in all_ns), max(int(one[-1]) for one in all_ns)
        back = [self.comes_ns[name][1:][np.diff(self._times_ns(name)) < 0] for name in SERIES]
        grid = np.arange(first, last + 1, round(packet_s * 1e9), dtype=np.int64)
        edges = np.unique(np.concatenate([grid, *back, [last + 1]]))
        cuts = {name: np.searchsorted(comes_ns, edges) for name, comes_ns in self.comes_ns.items()}
        ahead_ns = 0
        for k in range(len(edges) - 1):
            rows = {name: slice(int(cut[k]), int(cut[k + 1])) for name, cut in cuts.items()}
            if rows["imu"].stop > rows["imu"].start:
                at = rows["imu"].start
                ahead_ns = int(self.measurements.imu_t_ns[at] - self.comes_ns["imu"][at])
            fields = {k: v for name, part in rows.items() for k, v in self._rows(name, part).items()}
            if self.temperature_c is not None and rows["imu"].stop > 0:
                fields["temperature_c"] = float(self.temperature_c[rows["imu"].stop - 1])
            yield Packet(replace(self.measurements, **fields), ahead_ns)

    def _times_ns(self, series: str) -> TimeArray:
        times_ns: TimeArray = getattr(self.measurements, SERIES[series][0])
        return times_ns

    def _rows(self, series: str, rows: Rows) -> dict[str, Any]:
        return {field: getattr(self.measurements, field)[rows] for field in SERIES[series]}
