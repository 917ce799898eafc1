"""Straight pieces of roads, in metres east and north about a place, and points laid on them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from service.roads.protocol import FloatArray, IntArray

M_PER_DEG: Final = 111_200.0
"""Of a great circle, between those of the meridian at the equator and the poles: enough for some kilometres."""
ROAD_SD_M: Final = 3.0
"""How far a car is from its road's line in the map: a lane and the mapper's accuracy; a choice."""
HEADING_SD_DEG: Final = 15.0
"""How far a car's heading is from its road's: lane changes, curves drawn as corners; a choice."""
HEADING_WORST: Final = 3.0
"""A heading speaks against a road as much as this many standard deviations at most: cars turn and park."""


@dataclass(frozen=True, slots=True)
class Frame:
    """East and north of a place, m, for what lies within some kilometres."""

    centre_deg: tuple[float, float]

    @classmethod
    def about(cls, lon_lat_deg: FloatArray) -> Frame:
        """About the middle of some places (n, 2)."""
        lon, lat = lon_lat_deg.mean(axis=0)
        return cls((float(lon), float(lat)))

    @property
    def m_per_deg(self) -> FloatArray:
        """Of longitude and latitude."""
        return M_PER_DEG * np.array([np.cos(np.radians(self.centre_deg[1])), 1.0])

    def metres(self, lon_lat_deg: FloatArray) -> FloatArray:
        """East and north, (n, 2)."""
        return (lon_lat_deg - self.centre_deg) * self.m_per_deg

    def degrees(self, east_north_m: FloatArray) -> FloatArray:
        """Longitude and latitude, (n, 2)."""
        return east_north_m / self.m_per_deg + self.centre_deg


@dataclass(frozen=True, slots=True, eq=False)
class Segments:
    """Pieces of lines: ``start`` and ``end`` (m, 2), and the line that each is of, ``line`` (m,), never decreasing."""

    start: FloatArray
    end: FloatArray
    line: IntArray

    @classmethod
    def of(cls, nodes_m: FloatArray, first: IntArray, last: IntArray) -> Segments:
        """Of lines from the nodes ``first`` to ``last`` (n,); a line of one node is a piece of no length."""
        count = np.maximum(last - first, 1)
        line = np.repeat(np.arange(first.size), count)
        at = np.repeat(first - np.concatenate([[0], np.cumsum(count)[:-1]]), count) + np.arange(line.size)
        return cls(nodes_m[at], nodes_m[np.minimum(at + 1, last[line])], line)

    def projected(self, points_m: FloatArray, which: IntArray) -> FloatArray:
        """The point of each chosen piece that is nearest to a point, (k, 2)."""
        start = self.start[which]
        along = self.end[which] - start
        square = np.maximum((along**2).sum(axis=1), 1e-9)
        share = np.clip(((points_m - start) * along).sum(axis=1) / square, 0.0, 1.0)
        return np.asarray(start + share[:, None] * along)

    def heading_misfit(self, which: IntArray, heading_deg: FloatArray, one_way: bool = False) -> FloatArray:
        """By how many standard deviations headings (k,) are off those of chosen pieces; 0 where not known.

        A road may be driven either way, unless ``one_way``: along the line.
        """
        along = self.end[which] - self.start[which]
        half_turn = 180.0 if one_way else 90.0
        off = np.degrees(np.arctan2(along[:, 0], along[:, 1])) - heading_deg
        off = np.abs((off + half_turn) % (2 * half_turn) - half_turn)
        return np.asarray(np.minimum(np.nan_to_num(off) / HEADING_SD_DEG, HEADING_WORST))


def first_of_each(key: IntArray) -> IntArray:
    """Indices at which an ordered key changes."""
    return np.flatnonzero(np.diff(key, prepend=key[:1] - 1))
