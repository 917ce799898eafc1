"""The roads around a position, and how well its spread and heading speak for each of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import shapely

from service.roads.network import RoadNetwork
from service.roads.protocol import NO_NAME, FloatArray, IntArray, RoadClass

M_PER_DEG: Final = 111_200.0
ROAD_SD_M: Final = 3.0
"""How far a car is from its road's line in the map: a lane and the mapper's accuracy; a choice."""
HEADING_SD_DEG: Final = 15.0
"""How far a car's heading is from its road's: lane changes, curves drawn as corners; a choice."""
HEADING_WORST: Final = 3.0
"""A heading speaks against a road as much as this many standard deviations at most: cars turn and park."""
SELDOM: Final = 0.25
"""What a service road or track weighs against a street at the same distance; a choice."""
REACH_SD: Final = 4.0
_REACH_M: Final = 25.0
_HALF_PIECE_M: Final = 2.0


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
    centre = lon_lat_deg.mean(axis=0)
    scale = M_PER_DEG * np.array([np.cos(np.radians(centre[1])), 1.0])
    spread = covariance_en_m2 + ROAD_SD_M**2 * np.eye(2)
    reach = _REACH_M + REACH_SD * np.sqrt(np.linalg.eigvalsh(covariance_en_m2)[:, 1])
    margin = float(reach.max()) / scale
    low, high = lon_lat_deg.min(axis=0) - margin, lon_lat_deg.max(axis=0) + margin
    rows = network.within((float(low[0]), float(low[1]), float(high[0]), float(high[1])))
    lines = np.array([shapely.LineString((network.nodes_of(row) - centre) * scale) for row in rows], dtype=object)
    points = (lon_lat_deg - centre) * scale
    at = shapely.points(points)
    point, line = shapely.STRtree(lines).query(at, predicate="dwithin", distance=reach)
    along = shapely.line_locate_point(lines[line], at[point])
    nearest = on_lines(lines[line], along)
    away = nearest - points[point]
    misfit = np.einsum("ki,kij,kj->k", away, np.linalg.inv(spread)[point], away)
    off = heading_misfit(lines[line], along, heading_deg[point])
    seldom = np.isin(network.road_class[rows[line]], (RoadClass.SERVICE, RoadClass.TRACK))
    weight = np.exp(-0.5 * (misfit + off**2)) * np.where(seldom, SELDOM, 1.0)
    return Candidates(point, rows[line], weight, np.hypot(*away.T), nearest / scale + centre)


def confidence(network: RoadNetwork, found: Candidates, row: IntArray) -> FloatArray:
    """Share of the weight around each point (n,) that the road in ``row`` has, with others of its name; 0 for -1."""
    n = row.size
    road = np.where(network.name_index >= 0, network.name_index, -2 - np.arange(network.way_id.size))
    own = np.where(row == NO_NAME, NO_NAME, road[row])
    total = np.bincount(found.point, found.weight, n)
    same = road[found.row] == own[found.point]
    mine = np.bincount(found.point[same], found.weight[same], n)
    return np.divide(mine, total, out=np.zeros(n), where=(total > 0.0) & (row != NO_NAME))


def heading_misfit(lines: Any, along_m: FloatArray, heading_deg: FloatArray, one_way: bool = False) -> FloatArray:
    """By how many standard deviations headings (k,) are off the lines' at places on them; 0 where not known.

    A road may be driven either way, unless ``one_way``: along the line.
    """
    ahead = on_lines(lines, along_m + _HALF_PIECE_M) - on_lines(lines, np.maximum(along_m - _HALF_PIECE_M, 0.0))
    half_turn = 180.0 if one_way else 90.0
    off = np.degrees(np.arctan2(ahead[:, 0], ahead[:, 1])) - heading_deg
    off = np.abs((off + half_turn) % (2 * half_turn) - half_turn)
    return np.minimum(np.nan_to_num(off) / HEADING_SD_DEG, HEADING_WORST)


def on_lines(lines: Any, along_m: FloatArray) -> FloatArray:
    """The points (k, 2) at distances along lines."""
    return np.asarray(shapely.get_coordinates(shapely.line_interpolate_point(lines, along_m))).reshape(-1, 2)
