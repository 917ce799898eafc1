"""Cells of the H3 grid, by which exposure and the risk of places are told."""

from __future__ import annotations

from typing import Final

import h3
import numpy as np

from core.driving.exposure import UNKNOWN
from core.measurements import FloatArray
from service.errors import UsageError

RESOLUTION: Final = 8
"""0.74 km2 on the average, edges of 0.5 km: a neighbourhood. A choice; 7 is a small town's size, 9 a block's."""
_FINEST: Final = 15


def cells(lat_rad: FloatArray, lon_rad: FloatArray, resolution: int = RESOLUTION) -> list[str]:
    """The cell of each place, ``UNKNOWN`` where a coordinate is missing; raises UsageError."""
    if not 0 <= resolution <= _FINEST:
        raise UsageError(f"H3 resolution {resolution}; expected 0 to {_FINEST}")
    known = np.isfinite(lat_rad + lon_rad)
    places = zip(np.degrees(lat_rad).tolist(), np.degrees(lon_rad).tolist(), known.tolist(), strict=True)
    return [str(h3.latlng_to_cell(lat, lon, resolution)) if there else UNKNOWN for lat, lon, there in places]
