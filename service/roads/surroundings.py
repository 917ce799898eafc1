"""Tells roads in built-up areas from those outside, where their own tags do not."""

from __future__ import annotations

from typing import Final

import numpy as np
import shapely

from core.earth import horizontal_distance_m
from service.roads.extract import Extract, Roads
from service.roads.protocol import FloatArray, IntArray, RoadClass, Surroundings

CELL_M: Final = 250.0
URBAN_KM_PER_KM2: Final = 4.0
"""Streets, without tracks and service roads, in the nine cells around a place from which on it counts as built up: a
choice, between Liechtenstein's ways with signs of 60 km/h and more (mostly below) and of 50 and less (mostly above)."""


def surroundings_of(extract: Extract) -> IntArray:
    """``Surroundings`` of each road: as tagged; else urban if it serves homes, on mapped built-up land, or among many
    streets; else rural."""
    roads = extract.roads
    middle = middles(roads)
    on_built_up = np.zeros(roads.way_id.size, np.bool_)
    if extract.built_up:
        tree = shapely.STRtree(extract.built_up)
        on_built_up[tree.query(shapely.points(middle), predicate="within")[0]] = True
    serves_homes = np.isin(roads.road_class, (RoadClass.RESIDENTIAL, RoadClass.LIVING_STREET))
    urban = serves_homes | on_built_up | (density_km_per_km2(roads, middle) >= URBAN_KM_PER_KM2)
    judged = np.where(urban, int(Surroundings.URBAN), int(Surroundings.RURAL))
    return np.asarray(np.where(roads.surroundings != Surroundings.UNKNOWN, roads.surroundings, judged))


def middles(roads: Roads) -> FloatArray:
    """A point of each road near its half, (n, 2) longitude and latitude."""
    lines = shapely.from_ragged_array(
        shapely.GeometryType.LINESTRING, roads.lon_lat_deg, (roads.first_node.astype(np.int64),)
    )
    return np.asarray(shapely.get_coordinates(shapely.line_interpolate_point(lines, 0.5, normalized=True)))


def density_km_per_km2(roads: Roads, places: FloatArray) -> FloatArray:
    """Length of streets per area in the three by three cells around each place (n, 2)."""
    counted = ~np.isin(roads.road_class, (RoadClass.TRACK, RoadClass.SERVICE))
    way_of_node = np.repeat(np.arange(roads.way_id.size), np.diff(roads.first_node))
    start, end = roads.lon_lat_deg[:-1], roads.lon_lat_deg[1:]
    of_street = (way_of_node[:-1] == way_of_node[1:]) & counted[way_of_node[:-1]]
    start, end = start[of_street], end[of_street]
    length_m = horizontal_distance_m(*np.radians([start[:, 1], start[:, 0], end[:, 1], end[:, 0]]))
    south_deg = float(roads.lon_lat_deg[:, 1].mean())
    size_deg = CELL_M / 111_200.0 / np.array([np.cos(np.radians(south_deg)), 1.0])
    origin = roads.lon_lat_deg.min(axis=0) - size_deg
    cells = ((roads.lon_lat_deg.max(axis=0) - origin) / size_deg).astype(np.int64) + 2
    key = _cell((start + end) / 2, origin, size_deg)
    grid = np.zeros((int(cells[0]) + 1, int(cells[1]) + 1))
    np.add.at(grid, (key[:, 0], key[:, 1]), length_m)
    around = np.sum([np.roll(grid, (i, j), (0, 1)) for i in (-1, 0, 1) for j in (-1, 0, 1)], axis=0)
    at = _cell(places, origin, size_deg)
    return np.asarray(around[at[:, 0], at[:, 1]] / 1000.0 / (9 * (CELL_M / 1000.0) ** 2))


def _cell(lon_lat_deg: FloatArray, origin: FloatArray, size_deg: FloatArray) -> IntArray:
    return np.asarray((lon_lat_deg - origin) / size_deg).astype(np.int64)
