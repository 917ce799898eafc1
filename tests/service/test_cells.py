"""H3 cells of places: the same cell nearby, another one farther off, none where no place is known."""

from __future__ import annotations

import h3
import numpy as np
import pytest

from core.driving.exposure import UNKNOWN
from service.cells import cells
from service.errors import UsageError


def test_places_fall_into_the_cells_that_hold_them():
    lat_deg, lon_deg = np.array([60.1699, 60.1700, 60.2055, np.nan]), np.array([24.9384, 24.9385, 24.6559, 24.9])
    found = cells(np.radians(lat_deg), np.radians(lon_deg))
    assert found[0] == found[1] != found[2]
    assert found[3] == UNKNOWN
    # The middle of the cell is within its edge of half a kilometre.
    assert h3.great_circle_distance(h3.cell_to_latlng(found[0]), (60.1699, 24.9384), unit="m") < 700.0
    assert h3.get_resolution(found[0]) == 8
    assert h3.cell_to_parent(found[2], 5) == cells(np.radians(lat_deg), np.radians(lon_deg), 5)[2]


@pytest.mark.parametrize("resolution", [-1, 16])
def test_a_resolution_that_the_grid_lacks_is_refused(resolution):
    with pytest.raises(UsageError, match="expected 0 to 15"):
        cells(np.array([1.0]), np.array([0.4]), resolution)
