"""The sun's elevation against what almanacs say of equinoxes, solstices, the equation of time and sunsets."""

from __future__ import annotations

import numpy as np
import pytest

from core.sun import SUNSET_RAD, sun_elevation_rad


def t_ns(text: str) -> np.ndarray:
    return np.array([text], dtype="datetime64[ns]").astype(np.int64)


def elevation_deg(text: str, lat_deg: float, lon_deg: float) -> float:
    return float(np.degrees(sun_elevation_rad(t_ns(text), np.radians([lat_deg]), np.radians([lon_deg]))[0]))


@pytest.mark.parametrize(
    ("text", "declination_deg"),
    [("2024-03-20T03:06", 0.0), ("2024-06-20T20:51", 23.44), ("2024-09-22T12:44", 0.0), ("2024-12-21T09:21", -23.44)],
)
def test_at_a_pole_the_sun_stands_at_its_declination(text, declination_deg):
    # Instants of equinox and solstice, and the obliquity, of the almanac for 2024; the formulas are good to 0.01 deg.
    assert elevation_deg(text, 90.0, 0.0) == pytest.approx(declination_deg, abs=0.012)
    assert elevation_deg(text, -90.0, 0.0) == pytest.approx(-declination_deg, abs=0.012)


@pytest.mark.parametrize(
    ("day", "equation_s"), [("2023-11-03", 16 * 60 + 26), ("2024-02-11", -(14 * 60 + 13)), ("2024-09-01", 0)]
)
def test_noon_comes_by_the_equation_of_time(day, equation_s):
    noon = t_ns(f"{day}T12:00") + np.arange(-1800, 1801) * 1_000_000_000
    height = sun_elevation_rad(noon, np.zeros(noon.size), np.zeros(noon.size))
    # At the equator the sun passes north or south of the zenith: it is highest at true noon.
    at = (noon[np.argmax(height)] - noon[1800]) * 1e-9
    assert at == pytest.approx(-equation_s, abs=20.0)  # the extremes; on 1 September it passes 0 within a day


def test_sunset_in_helsinki_at_midsummer():
    # 22:50 local summer time on 2024-06-21, by the almanac, to the minute.
    before, after = elevation_deg("2024-06-21T19:47", 60.17, 24.94), elevation_deg("2024-06-21T19:53", 60.17, 24.94)
    assert before > np.degrees(SUNSET_RAD) > after
