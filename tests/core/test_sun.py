"""The sun's elevation against published positions and what any sky must do."""

from __future__ import annotations

import math
from datetime import UTC, datetime

import numpy as np
import pytest

from core.sun import SUNSET_RAD, solar_elevation_rad

STATED_DEG = 0.01
"""What the function says of itself."""


def elevation_deg(when, lat_deg, lon_deg):
    t_ns = np.array([int(datetime.fromisoformat(when).timestamp()) * 1_000_000_000])
    return math.degrees(solar_elevation_rad(t_ns, np.radians([lat_deg]), np.radians([lon_deg]))[0])


def test_published_example_of_the_solar_position_algorithm():
    """Reda & Andreas 2004 (NREL/TP-560-34302), table A5.1: zenith 50.11162° with refraction 0.01632°, at 1830 m.
    Parallax, which is theirs and not ours, is 0.0019° there."""
    expected = 90.0 - 50.11162 - 0.01632
    assert elevation_deg("2003-10-17T19:30:30+00:00", 39.742476, -105.1786) == pytest.approx(expected, abs=STATED_DEG)


@pytest.mark.parametrize(
    ("when", "declination_deg"),
    [
        ("2024-03-20T03:06:00+00:00", 0.0),
        ("2024-06-20T20:51:00+00:00", 23.436),
        ("2024-09-22T12:44:00+00:00", 0.0),
        ("2024-12-21T09:21:00+00:00", -23.436),
    ],
)
def test_seen_from_the_pole_it_stands_at_its_declination(when, declination_deg):
    """Equinoxes and solstices of 2024 (US Naval Observatory), to the minute."""
    assert elevation_deg(when, 90.0, 0.0) == pytest.approx(declination_deg, abs=STATED_DEG)
    assert elevation_deg(when, -90.0, 0.0) == pytest.approx(-declination_deg, abs=STATED_DEG)


def test_equation_of_time_on_its_extreme_days():
    """The sun crosses the meridian of Greenwich at 12:14:15 on 11 February and 11:43:33 on 3 November 2024, within some
    seconds (almanacs: -14 min 14 s and +16 min 26 s)."""
    for day, noon_s in (("2024-02-11", 12 * 3600 + 14 * 60 + 14), ("2024-11-03", 12 * 3600 - 16 * 60 - 26)):
        start = int(datetime.fromisoformat(day).replace(tzinfo=UTC).timestamp())
        seconds = np.arange(noon_s - 600, noon_s + 600)
        elevation = solar_elevation_rad((start + seconds) * 1_000_000_000, np.zeros(1200), np.zeros(1200))
        # The vertex of a parabola, as the top is flat to the second; on the equator the season moves it by some 4 s.
        fit = np.polyfit(seconds - noon_s, elevation, 2)
        assert -fit[1] / (2.0 * fit[0]) == pytest.approx(0.0, abs=10.0)


def test_day_and_night_are_told_apart_where_drives_are():
    assert elevation_deg("2024-05-06T11:00:00+00:00", 60.17, 24.94) > 40.0
    assert elevation_deg("2024-12-21T21:00:00+00:00", 60.17, 24.94) < -30.0
    assert elevation_deg("2024-06-21T22:30:00+00:00", 69.65, 18.96) > 0.0, "the sun of midnight in Tromsø"


def test_no_position_no_sun():
    assert np.isnan(solar_elevation_rad(np.array([0]), np.array([np.nan]), np.array([0.0]))).all()


def test_sunset_in_helsinki_at_midsummer():
    """22:50 local summer time on 2024-06-21, by the almanac, to the minute."""
    before = elevation_deg("2024-06-21T19:47:00+00:00", 60.17, 24.94)
    after = elevation_deg("2024-06-21T19:53:00+00:00", 60.17, 24.94)
    assert before > math.degrees(SUNSET_RAD) > after
