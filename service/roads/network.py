"""The roads of a built folder: a row a way, as arrays that stay on disk until they are looked at."""

from __future__ import annotations

import json
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from service.roads.protocol import NO_NAME, BoolArray, FloatArray, IntArray


@dataclass(frozen=True, slots=True, eq=False)
class RoadNetwork:
    """Ways by increasing id, with their limits settled.

    ``limit_kmh`` and ``limit_certainty`` are (n, 2), along the way's own direction and against it; the nodes of way i
    are ``lon_lat_deg[first_node[i]:first_node[i + 1]]``, its bounds (n, 4) west, south, east, north.
    """

    way_id: IntArray
    road_class: IntArray
    surroundings: IntArray
    limit_kmh: FloatArray
    limit_certainty: IntArray
    tunnel: BoolArray
    name_index: IntArray
    district_index: IntArray
    lon_lat_deg: FloatArray
    first_node: IntArray
    bounds_deg: FloatArray
    names: tuple[str, ...]

    def rows_of(self, way_id: IntArray) -> IntArray:
        """Row of each way, -1 for one that is not here."""
        row = np.searchsorted(self.way_id, way_id)
        row[row == self.way_id.size] = 0
        return np.where(self.way_id[row] == way_id, row, NO_NAME)

    def within(self, box_deg: tuple[float, float, float, float]) -> IntArray:
        """Rows of the ways whose bounds meet a box (west, south, east, north)."""
        west, south, east, north = box_deg
        low, high = self.bounds_deg[:, :2], self.bounds_deg[:, 2:]
        return np.flatnonzero((low[:, 0] <= east) & (high[:, 0] >= west) & (low[:, 1] <= north) & (high[:, 1] >= south))

    def nodes_of(self, rows: IntArray) -> tuple[FloatArray, IntArray, IntArray]:
        """Longitude and latitude of some ways' nodes, (k, 2), and of each way the first and the last of them."""
        count = self.first_node[rows + 1] - self.first_node[rows]
        first = np.cumsum(count) - count
        at = np.repeat(self.first_node[rows] - first, count) + np.arange(int(count.sum()))
        return np.asarray(self.lon_lat_deg[at]), first, first + count - 1

    def write(self, folder: Path) -> None:
        """A file a column."""
        folder.mkdir()
        for one in fields(self):
            if one.name != "names":
                np.save(folder / f"{one.name}.npy", getattr(self, one.name))
        (folder / "names.json").write_text(json.dumps(self.names, ensure_ascii=False), "utf-8")

    @classmethod
    def read(cls, folder: Path) -> RoadNetwork:
        """What ``write`` wrote; columns are read when they are used."""
        columns = {
            one.name: np.load(folder / f"{one.name}.npy", mmap_mode="r") for one in fields(cls) if one.name != "names"
        }
        return cls(**columns, names=tuple(json.loads((folder / "names.json").read_text("utf-8"))))
