"""Where each point of a drive is on the path that was matched to it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely

from service.roads.candidates import M_PER_DEG, ROAD_SD_M, heading_misfit, on_lines
from service.roads.protocol import NO_NAME, FloatArray, IntArray
from service.roads.tiles import decoded


@dataclass(frozen=True, slots=True, eq=False)
class MatchedPath:
    """Edges, one after the other, as lines in metres about ``centre``, and the edge of each point as Valhalla says it.

    Valhalla tells a path well and its points' places on it less so: of points that it laid between two others it
    leaves out the edge, or keeps them on the street before a corner for seconds after it.
    """

    points: FloatArray
    edge: IntArray
    lines: np.ndarray[Any, np.dtype[np.object_]]
    centre: FloatArray
    scale: FloatArray

    @classmethod
    def of(cls, told: dict[str, Any], lon_lat_deg: FloatArray) -> MatchedPath:
        """From an answer of ``trace_attributes``; ``edge`` is ``NO_NAME`` for a point that is on no road."""
        count = len(told["edges"])
        centre = lon_lat_deg.mean(axis=0)
        scale = M_PER_DEG * np.array([np.cos(np.radians(centre[1])), 1.0])
        shape = (decoded(told["shape"]) - centre) * scale
        spans = [(one["begin_shape_index"], one["end_shape_index"]) for one in told["edges"]]
        # An edge that is only touched has one point, which makes no line.
        lines = [
            shapely.LineString(shape[first : last + 1] if last > first else shape[[first, first]])
            for first, last in spans
        ]
        on = np.array([one["type"] != "unmatched" for one in told["matched_points"]])
        edge = np.array([min(one.get("edge_index", count), count) for one in told["matched_points"]], np.int64)
        return cls((lon_lat_deg - centre) * scale, _filled(edge, on, count), np.array(lines), centre, scale)

    def nearest(
        self, rows: IntArray, sd_m: FloatArray, heading_deg: FloatArray
    ) -> tuple[IntArray, FloatArray, FloatArray]:
        """Of some points the edge that position and heading speak for most, between those of their neighbours; the
        point on it, (k, 2) longitude and latitude; and how far that is, m."""
        edge = self.edge[rows]
        first = np.concatenate([edge[:1], edge[:-1]])
        last = np.concatenate([edge[1:], edge[-1:]])
        count = last - first + 1
        which = np.repeat(np.arange(rows.size), count)
        tried = np.repeat(first - np.concatenate([[0], np.cumsum(count)[:-1]]), count) + np.arange(which.size)
        points = self.points[rows[which]]
        along = shapely.line_locate_point(self.lines[tried], shapely.points(points))
        on_edge = on_lines(self.lines[tried], along)
        distance = np.hypot(*(on_edge - points).T)
        off = heading_misfit(self.lines[tried], along, heading_deg[rows[which]], one_way=True)
        cost = (distance / np.hypot(sd_m[rows[which]], ROAD_SD_M)) ** 2 + off**2
        best = np.lexsort((tried, cost, which))
        best = best[np.concatenate([[True], np.diff(which[best]) > 0])]
        return tried[best], on_edge[best] / self.scale + self.centre, distance[best]


def _filled(edge: IntArray, on: np.ndarray[Any, np.dtype[np.bool_]], count: int) -> IntArray:
    """Edges of all points on roads, never decreasing; one that is not told is that of the point before it."""
    told = np.where(on & (edge < count), edge, 0)
    return np.where(on, np.maximum.accumulate(told), NO_NAME)
