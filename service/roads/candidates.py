"""The roads around a position, and how well its spread and heading speak for each of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import shapely

from service.roads.network import RoadNetwork
from service.roads.protocol import NO_NAME, FloatArray, IntArray, RoadClass
from service.roads.segments import ROAD_SD_M, Frame, Segments, first_of_each

SELDOM: Final = 0.25
"""What a service road or track weighs against a street at the same distance; a choice."""
REACH_SD: Final = 4.0
_REACH_M: Final = 25.0
_FARTHEST_M: Final = 1000.0
"""A position that is less sure than that is on no road in particular."""


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """Pairs of a point and a road near it: ``point`` (k,), ``row`` (k,) of the network, ``weight`` (k,) against one
    another, ``distance_m`` (k,), and the nearest point on the road, ``lon_lat_deg`` (k, 2)."""

    point: IntArray
    row: IntArray
    weight: FloatArray
    distance_m: FloatArray
    lon_lat_deg: FloatArray


def candidates(
    network: RoadNetwork,
    lon_lat_deg: FloatArray,
    covariance_en_m2: FloatArray,
    heading_deg: FloatArray,
) -> Candidates:
    """Roads near points that lie within some kilometres.

    Parameters
    ----------
    lon_lat_deg : (n, 2)
    covariance_en_m2 : (n, 2, 2), east and north
    heading_deg : (n,), NaN where not known
    """
    frame = Frame.about(lon_lat_deg)
    points = frame.metres(lon_lat_deg)
    spread = np.linalg.inv(covariance_en_m2 + ROAD_SD_M**2 * np.eye(2))
    reach = np.minimum(_REACH_M + REACH_SD * np.sqrt(np.linalg.eigvalsh(covariance_en_m2)[:, 1]), _FARTHEST_M)
    low, high = frame.degrees(points - reach[:, None]).min(axis=0), frame.degrees(points + reach[:, None]).max(axis=0)
    rows = network.within((float(low[0]), float(low[1]), float(high[0]), float(high[1])))
    nodes, first, last = network.nodes_of(rows)
    pieces = Segments.of(frame.metres(nodes), first, last)
    tree = shapely.STRtree(shapely.linestrings(np.stack([pieces.start, pieces.end], axis=1)))
    point, piece = tree.query(shapely.points(points), predicate="dwithin", distance=reach)
    nearest = pieces.projected(points[point], piece)
    away = nearest - points[point]
    misfit = np.einsum("ki,kij,kj->k", away, spread[point], away)
    misfit += pieces.heading_misfit(piece, heading_deg[point]) ** 2
    line = pieces.line[piece]
    order = np.lexsort((misfit, line, point))
    best = order[first_of_each((point * max(rows.size, 1) + line)[order])]
    point, line, away = point[best], line[best], away[best]
    seldom = np.isin(network.road_class[rows[line]], (RoadClass.SERVICE, RoadClass.TRACK))
    weight = np.exp(-0.5 * misfit[best]) * np.where(seldom, SELDOM, 1.0)
    return Candidates(point, rows[line], weight, np.hypot(*away.T), frame.degrees(nearest[best]))


def confidence(network: RoadNetwork, found: Candidates, row: IntArray) -> FloatArray:
    """Share of the weight around each point (n,) that the road in ``row`` has, with others of its name; 0 for -1."""
    n = row.size
    road = np.where(network.name_index >= 0, network.name_index, -2 - np.arange(network.way_id.size))
    own = np.where(row == NO_NAME, NO_NAME, road[row])
    total = np.bincount(found.point, found.weight, n)
    same = road[found.row] == own[found.point]
    mine = np.bincount(found.point[same], found.weight[same], n)
    return np.divide(mine, total, out=np.zeros(n), where=(total > 0.0) & (row != NO_NAME))
