"""Where each point of a drive is on the path that was matched to it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from service.roads.protocol import NO_NAME, FloatArray, IntArray
from service.roads.segments import ROAD_SD_M, Frame, Segments, first_of_each
from service.roads.tiles import decoded


@dataclass(frozen=True, slots=True, eq=False)
class MatchedPath:
    """The pieces of a path's edges, one edge after the other, and the edge of each point as Valhalla says it.

    Valhalla tells a path well and its points' places on it less so: of points that it laid between two others it
    leaves out the edge, or keeps them on the street before a corner for seconds after it.
    """

    frame: Frame
    points_m: FloatArray
    edge: IntArray
    pieces: Segments

    @classmethod
    def of(cls, told: dict[str, Any], lon_lat_deg: FloatArray) -> MatchedPath:
        """From an answer of ``trace_attributes``; ``edge`` is ``NO_NAME`` for a point that is on no road."""
        frame = Frame.about(lon_lat_deg)
        spans = np.array([(one["begin_shape_index"], one["end_shape_index"]) for one in told["edges"]], np.int64)
        count = len(told["edges"])
        on = np.array([one["type"] != "unmatched" for one in told["matched_points"]])
        edge = np.array([min(one.get("edge_index", count), count) for one in told["matched_points"]], np.int64)
        pieces = Segments.of(frame.metres(decoded(told["shape"])), *spans.reshape(-1, 2).T)
        return cls(frame, frame.metres(lon_lat_deg), _filled(edge, on, count), pieces)

    def nearest(
        self, rows: IntArray, sd_m: FloatArray, heading_deg: FloatArray
    ) -> tuple[IntArray, FloatArray, FloatArray]:
        """Of some points the edge that position and heading speak for most, between those of their neighbours; the
        point on it, (k, 2) longitude and latitude; and how far that is, m."""
        edge = self.edge[rows]
        first = np.searchsorted(self.pieces.line, np.concatenate([edge[:1], edge[:-1]]))
        end = np.searchsorted(self.pieces.line, np.concatenate([edge[1:], edge[-1:]]), side="right")
        count = end - first
        which = np.repeat(np.arange(rows.size), count)
        tried = np.repeat(first - np.concatenate([[0], np.cumsum(count)[:-1]]), count) + np.arange(which.size)
        points = self.points_m[rows[which]]
        on_piece = self.pieces.projected(points, tried)
        distance = np.hypot(*(on_piece - points).T)
        off = self.pieces.heading_misfit(tried, heading_deg[rows[which]], one_way=True)
        cost = (distance / np.hypot(sd_m[rows[which]], ROAD_SD_M)) ** 2 + off**2
        order = np.lexsort((tried, cost, which))
        best = order[first_of_each(which[order])]
        return self.pieces.line[tried[best]], self.frame.degrees(on_piece[best]), distance[best]


def _filled(edge: IntArray, on: npt.NDArray[np.bool_], count: int) -> IntArray:
    """Edges of all points on roads, never decreasing; one that is not told is that of the point before it."""
    told = np.where(on & (edge < count), edge, 0)
    return np.where(on, np.maximum.accumulate(told), NO_NAME)
